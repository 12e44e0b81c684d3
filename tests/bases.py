"""Base models and records that tests share: rigid aircraft, low-order equivalent, falling body and
whole axes, with made-up inputs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.optimize import fsolve

from sim.declaration.compile import compile_model
from sim.declaration.effect import Parameter, ParameterSet
from sim.declaration.model import Model, Noise, System
from sim.maths import G0
from sim.propagation import Step, drive_from_record, make_grid, rk4_step, simulate
from sim.record import Hold
from sim.vehicles.aircraft import aircraft_model
from sim.vehicles.factory import model_from_constants
from sim.vehicles.other_vehicles import Ballistic
from sim.vehicles.uncoupled import ShortPeriod
from tests.airliner import AIRLINER, ELEVATOR, THRUST

RIGID_VALUES = {
    "mass": 130642.0,
    "wing_area": 180.79,
    "chord": 4.663,
    "pitch_inertia": 8.677e6,
    "airspeed": 200.6,
    "air_density": 1.0556,
    "CL_alpha": 2.922,
    "CL_q": -14.7,
    "CL_de": 0.435,
    "Cm_alpha": -1.66,
    "Cm_q": -34.75,
    "Cm_de": -2.578,
}
LOES_CONSTANTS = {"airspeed": 295.5, "gravity": 9.8, "vane_arm": 7.3}
LOES_VALUES = {
    "L_alpha": -1.9,
    "M_alpha": -12.4,
    "L_delta": -2e-3,
    "M_delta": 0.32,
    "L_q": 1.01,
    "M_q": -3.0,
    "inv_tau": 10.6,
    # a whole number of sub-steps: the input then jumps between steps, and integrators keep their
    # order
    "delay": 0.12,
}
BALLISTIC_VALUES = {
    "air_density_reference": 1.752,
    "density_scale_height": 6705.6,
    "gravity": 9.80665,
    "beta": 2441.2,
}
# A light single-engined aircraft, with a cross inertia and a trim that no stability axes have:
# every term acts.
LATERAL_VALUES = {
    **{
        "mass": 1247.0,
        "wing_area": 17.1,
        "span": 10.2,
        "roll_inertia": 1420.0,
        "yaw_inertia": 4790.0,
        "cross_inertia": 120.0,
    },
    **{"airspeed": 53.6, "air_density": 1.225, "trim_alpha": 0.03, "trim_theta": 0.05},
    **{"CY_beta": -0.56, "CY_p": -0.02, "CY_r": 0.2, "CY_da": 0.01, "CY_dr": 0.157},
    **{"Cl_beta": -0.074, "Cl_p": -0.41, "Cl_r": 0.107, "Cl_da": -0.134, "Cl_dr": 0.012},
    **{"Cn_beta": 0.071, "Cn_p": -0.0575, "Cn_r": -0.125, "Cn_da": 0.0035, "Cn_dr": -0.072},
}
LONGITUDINAL_VALUES = {
    **{
        "mass": 1247.0,
        "wing_area": 17.1,
        "chord": 1.74,
        "pitch_inertia": 4067.0,
        "air_density": 1.225,
        "reference_airspeed": 53.6,
        "thrust_arm": 0.1,
    },
    **{
        "CD_0": 0.05,
        "CD_V": 0.003,
        "CD_alpha": 0.33,
        "CL_0": 0.3,
        "CL_V": 0.01,
        "CL_alpha": 4.44,
        "CL_q": 3.8,
        "CL_de": 0.355,
    },
    **{"Cm_0": 0.01, "Cm_V": 0.0258, "Cm_alpha": -0.54, "Cm_q": -14.3, "Cm_de": -0.912},
}

MULTIROTOR_VALUES = {
    **{"L_p": -5.1, "L_lat": 90.0, "L_0": 0.03, "L_qr": -0.7},
    **{"M_q": -1.7, "M_lon": 75.0, "M_0": -0.02, "M_pr": 0.65},
    **{"N_r": -0.6, "N_ped": 17.0, "N_0": 0.01, "N_pq": 0.05},
    **{"Z_col": -25.0, "Z_0": -0.3},
}


def rigid_model(values: Mapping[str, float] = RIGID_VALUES) -> Model:
    """The rigid aircraft at rest in trim; derivatives free, the rest held."""
    parameters = tuple(
        Parameter(name, value, free=name.startswith(("CL", "Cm"))) for name, value in values.items()
    )
    initial = ParameterSet((Parameter("alpha", 0.0, "rad"), Parameter("q", 0.0, "rad/s")))
    return Model(
        ShortPeriod(),
        ParameterSet(parameters),
        initial,
        Noise({"alpha": 0.002, "q": 0.002, "nz": 0.01}),
    )


def ballistic_model(values: Mapping[str, float] = BALLISTIC_VALUES) -> Model:
    """A body falling from 60 km at 1.8 km/s; beta free, the rest held."""
    parameters = tuple(
        Parameter(name, value, free=name == "beta") for name, value in values.items()
    )
    initial = ParameterSet(
        (Parameter("altitude", 60960.0, "m"), Parameter("velocity", -1828.8, "m/s"))
    )
    return Model(Ballistic(), ParameterSet(parameters), initial, Noise({"altitude": 7.62}))


def loes_model(values: Mapping[str, float] = LOES_VALUES) -> Model:
    """The low-order equivalent system at rest in trim, constant terms zero; the delay is held, so
    that filters take it too.
    """
    model = model_from_constants("loes", LOES_CONSTANTS, values).with_noise(
        Noise({"alpha": 0.001, "q": 0.002, "nz": 0.02})
    )
    return model.with_parameters(model.parameters.hold(["delay"]))


def lateral_model(values: Mapping[str, float] = LATERAL_VALUES) -> Model:
    """The whole lateral axis, wings level in trim."""
    noise = Noise({"beta": 0.001, "p": 0.001, "r": 0.001, "phi": 0.001, "ny": 0.002})
    return model_from_constants("lateral", {}, values).with_noise(noise)


def longitudinal_model(values: Mapping[str, float] = LONGITUDINAL_VALUES) -> Model:
    """The whole longitudinal axis in level flight at the reference airspeed, where elevator and
    thrust are those of ``LEVEL``.
    """
    initial = {
        "airspeed": values["reference_airspeed"],
        "alpha": LEVEL[0],
        "theta": LEVEL[0],
        "q": 0.0,
    }
    noise = Noise(
        {"airspeed": 0.1, "alpha": 0.001, "theta": 0.001, "q": 0.001, "nz": 0.01, "nx": 0.002}
    )
    return model_from_constants("longitudinal", {}, values, initial=initial).with_noise(noise)


def multirotor_model(values: Mapping[str, float] = MULTIROTOR_VALUES) -> Model:
    """A quadrotor in hover whose motors follow at once."""
    noise = Noise({"p": 3e-4, "q": 3e-4, "r": 3e-4, "az": 0.02})
    return model_from_constants("multirotor", {}, values).with_noise(noise)


def level_flight(values: Mapping[str, float] = LONGITUDINAL_VALUES) -> tuple[float, float, float]:
    """Angle of attack (rad), elevator (rad) and thrust (N) of steady level flight: lift, moment and
    drag balanced to the last digits.
    """
    v, pressure = (
        values,
        0.5 * values["air_density"] * values["reference_airspeed"] ** 2 * values["wing_area"],
    )

    def unbalance(x: Any) -> list[float]:
        alpha, elevator, push = x
        drag = v["CD_0"] + v["CD_V"] + v["CD_alpha"] * alpha
        lift = v["CL_0"] + v["CL_V"] + v["CL_alpha"] * alpha + v["CL_de"] * elevator
        moment = v["Cm_0"] + v["Cm_V"] + v["Cm_alpha"] * alpha + v["Cm_de"] * elevator
        weight = v["mass"] * G0 / pressure
        return [
            lift + push * math.sin(alpha) - weight,
            drag - push * math.cos(alpha),
            moment + push * v["thrust_arm"] / v["chord"],
        ]

    alpha, elevator, push = fsolve(unbalance, [0.0, 0.0, 0.05], xtol=1e-14)
    return float(alpha), float(elevator), float(push * pressure)


LEVEL = level_flight()


@dataclass(frozen=True, eq=False)
class Flight:
    """What a simulation needs beside the model: times ``(N,)``, inputs ``(n_inputs, N)``, hold,
    largest sub-step.
    """

    time: np.ndarray
    u: np.ndarray
    hold: Hold = Hold.PREVIOUS
    max_step: float = 0.01


def three_two_one_one(
    time: np.ndarray, start: float = 1.0, unit: float = 0.5, size: float = 0.1
) -> np.ndarray:
    """A 3-2-1-1 of alternating sign on the given times."""
    ends = start + unit * np.cumsum([0, 3, 2, 1, 1])
    signs = [1.0, -1.0, 1.0, -1.0]
    return size * np.sum(
        [
            sign * ((time >= a - 1e-9) & (time < b - 1e-9))
            for sign, a, b in zip(signs, ends[:-1], ends[1:], strict=True)
        ],
        axis=0,
    )


def rigid_flight(duration: float = 6.0, rate: float = 50.0) -> Flight:
    """A 3-2-1-1 elevator maneuver of the rigid aircraft."""
    time = np.arange(round(duration * rate) + 1) / rate
    return Flight(time, three_two_one_one(time)[None])


def loes_flight(duration: float = 8.0, rate: float = 50.0) -> Flight:
    """A 3-2-1-1 of one unit of stick."""
    time = np.arange(round(duration * rate) + 1) / rate
    return Flight(time, three_two_one_one(time, size=1.0)[None])


def ballistic_flight(duration: float = 20.0, rate: float = 10.0) -> Flight:
    """A fall of the ballistic body, tracked."""
    time = np.arange(round(duration * rate) + 1) / rate
    return Flight(time, np.zeros((0, time.size)), max_step=0.05)


def lateral_flight(duration: float = 4.0, rate: float = 25.0) -> Flight:
    """A 3-2-1-1 of the rudder, then a doublet of the aileron before it has ended."""
    time = np.arange(round(duration * rate) + 1) / rate
    doublet = 0.06 * (
        ((time >= 2.2 - 1e-9) & (time < 2.8 - 1e-9)) * 1.0
        - ((time >= 2.8 - 1e-9) & (time < 3.4 - 1e-9))
    )
    return Flight(time, np.array([doublet, three_two_one_one(time, 0.6, 0.4, 0.08)]), max_step=0.04)


def longitudinal_flight(duration: float = 4.0, rate: float = 25.0) -> Flight:
    """A 3-2-1-1 of the elevator from level flight, and a step of thrust."""
    time = np.arange(round(duration * rate) + 1) / rate
    thrust = LEVEL[2] + 600.0 * (time >= 2.6 - 1e-9)
    return Flight(
        time, np.array([LEVEL[1] + three_two_one_one(time, 0.6, 0.4, 0.08), thrust]), max_step=0.04
    )


def multirotor_flight(duration: float = 4.0, rate: float = 25.0) -> Flight:
    """A 3-2-1-1 of each of roll, pitch and yaw before the last has ended, and a step of thrust from
    hover.
    """
    time = np.arange(round(duration * rate) + 1) / rate
    moments = [
        three_two_one_one(time, 0.4 + 0.6 * n, 0.24, size)
        for n, size in enumerate((0.002, 0.002, 0.008))
    ]
    return Flight(time, np.array([*moments, 0.38 + 0.05 * (time >= 2.6 - 1e-9)]), max_step=0.04)


AIRLINER_NOISE = Noise(
    {
        "airspeed": 0.2,
        **dict.fromkeys(("alpha", "beta", "phi", "theta", "p", "q", "r"), 0.002),
        **dict.fromkeys(("ax", "ay", "az"), 0.03),
    }
)


def airliner_flight(duration: float = 4.0, rate: float = 25.0) -> Flight:
    """Surfaces moved one after the other about a trim of the airliner."""
    time = np.arange(round(duration * rate) + 1) / rate

    def doublet(size: float, *times: float) -> np.ndarray:
        edges = np.searchsorted(times, time + 1e-9)
        return size * np.array([0.0, 1.0, -1.0, 0.0])[edges]

    elevator = ELEVATOR + doublet(0.03, 0.4, 1.2, 1.6)
    aileron, rudder = doublet(0.04, 1.2, 2.0, 2.8), doublet(0.04, 0.8, 2.4, 3.2)
    thrust = np.full(len(time), THRUST)
    return Flight(time, np.array([elevator, aileron, rudder, thrust]), max_step=0.04)


def _airliner() -> tuple[Model, Flight]:
    return aircraft_model(AIRLINER).with_noise(AIRLINER_NOISE), airliner_flight()


@cache
def base_for(equations: str) -> tuple[Model, Flight]:
    """Model and flight by the name of the equations; made once, not to be written to."""
    made: dict[str, Callable[[], tuple[Model, Flight]]] = {
        "rigid": lambda: (rigid_model(), rigid_flight()),
        "loes": lambda: (loes_model(), loes_flight()),
        "ballistic": lambda: (ballistic_model(), ballistic_flight()),
        "lateral": lambda: (lateral_model(), lateral_flight()),
        "longitudinal": lambda: (longitudinal_model(), longitudinal_flight()),
        "multirotor": lambda: (multirotor_model(), multirotor_flight()),
        "aircraft": _airliner,
    }
    return made[equations]()


def fly(
    system: System,
    flight: Flight,
    p: list[Any] | None = None,
    x0: list[Any] | None = None,
    step: Step = rk4_step,
) -> list[np.ndarray]:
    """Noise-free outputs at the samples, one array a row; parameters and initial state as declared
    unless given.
    """
    p = list(system.parameters.values()) if p is None else p
    x0 = list(system.initial.values()) if x0 is None else x0
    grid = make_grid(flight.time, flight.max_step)
    return simulate(
        system,
        p,
        x0,
        drive_from_record(system, p, flight.u, flight.time, flight.hold, grid),
        grid,
        step,
    )


def fly_model(model: Model, flight: Flight) -> list[np.ndarray]:
    """Noise-free outputs of a model as declared."""
    return fly(compile_model(model), flight)
