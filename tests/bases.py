"""Base models and records that tests share: rigid aircraft, low-order equivalent system and falling body, with made-up inputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.declaration.compile import compile_model
from sim.declaration.model import Model, Noise
from sim.declaration.parameters import Parameter, ParameterSet
from sim.declaration.system import System
from sim.propagation.grid import drive_from_record, make_grid
from sim.propagation.integrate import Step, rk4_step, simulate
from sim.record import Hold
from sim.vehicles.ballistic import Ballistic
from sim.vehicles.factory import model_from_constants
from sim.vehicles.short_period import ShortPeriod

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
    "delay": 0.12,  # a whole number of sub-steps: the input then jumps between steps, and integrators keep their order
}
BALLISTIC_VALUES = {"air_density_reference": 1.752, "density_scale_height": 6705.6, "gravity": 9.80665, "beta": 2441.2}


def rigid_model(values: Mapping[str, float] = RIGID_VALUES) -> Model:
    """The rigid aircraft at rest in trim; derivatives free, the rest held."""
    parameters = tuple(Parameter(name, value, free=name.startswith(("CL", "Cm"))) for name, value in values.items())
    initial = ParameterSet((Parameter("alpha", 0.0, "rad"), Parameter("q", 0.0, "rad/s")))
    return Model(ShortPeriod(), ParameterSet(parameters), initial, Noise({"alpha": 0.002, "q": 0.002, "nz": 0.01}))


def ballistic_model(values: Mapping[str, float] = BALLISTIC_VALUES) -> Model:
    """A body falling from 60 km at 1.8 km/s; beta free, the rest held."""
    parameters = tuple(Parameter(name, value, free=name == "beta") for name, value in values.items())
    initial = ParameterSet((Parameter("altitude", 60960.0, "m"), Parameter("velocity", -1828.8, "m/s")))
    return Model(Ballistic(), ParameterSet(parameters), initial, Noise({"altitude": 7.62}))


def loes_model(values: Mapping[str, float] = LOES_VALUES) -> Model:
    """The low-order equivalent system at rest in trim, constant terms zero; the delay is held, so that filters take it too."""
    model = model_from_constants("loes", LOES_CONSTANTS, values).with_noise(Noise({"alpha": 0.001, "q": 0.002, "nz": 0.02}))
    return model.with_parameters(model.parameters.hold(["delay"]))


@dataclass(frozen=True, eq=False)
class Flight:
    """What a simulation needs beside the model: times ``(N,)``, inputs ``(n_inputs, N)``, hold, largest sub-step."""

    time: np.ndarray
    u: np.ndarray
    hold: Hold = Hold.PREVIOUS
    max_step: float = 0.01


def three_two_one_one(time: np.ndarray, start: float = 1.0, unit: float = 0.5, size: float = 0.1) -> np.ndarray:
    """A 3-2-1-1 of alternating sign on the given times."""
    ends = start + unit * np.cumsum([0, 3, 2, 1, 1])
    signs = [1.0, -1.0, 1.0, -1.0]
    return size * np.sum([sign * ((time >= a - 1e-9) & (time < b - 1e-9)) for sign, a, b in zip(signs, ends[:-1], ends[1:], strict=True)], axis=0)


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


def base_for(equations: str) -> tuple[Model, Flight]:
    """Model and flight by the name of the equations."""
    return {
        "rigid": (rigid_model(), rigid_flight()),
        "loes": (loes_model(), loes_flight()),
        "ballistic": (ballistic_model(), ballistic_flight()),
    }[equations]


def fly(system: System, flight: Flight, p: list[Any] | None = None, x0: list[Any] | None = None, step: Step = rk4_step) -> list[np.ndarray]:
    """Noise-free outputs at the samples, one array a row; parameters and initial state as declared unless given."""
    p = list(system.parameters.values()) if p is None else p
    x0 = list(system.initial.values()) if x0 is None else x0
    grid = make_grid(flight.time, flight.max_step)
    return simulate(system, p, x0, drive_from_record(system, p, flight.u, flight.time, flight.hold, grid), grid, step)


def fly_model(model: Model, flight: Flight) -> list[np.ndarray]:
    """Noise-free outputs of a model as declared."""
    return fly(compile_model(model), flight)
