"""JSBSim itself: load, trim, fly; and true derivatives by regression of its forces and moments.

In a small motion they are the derivatives about trim, over the maneuver itself the best linear
fits. Terms in alpha_dot and beta_dot go to the other derivatives, as in any fit of models without
such terms.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import importlib
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from scenarios.trials.jsbsim_declaration import (
    FOOT,
    KNOT,
    NEEDS,
    Surface,
    package_folder,
    surfaces_of,
)
from sim.errors import DeclarationError

# ---- JSBSim itself

SLUG = 14.59390293720636  # kg
POUND = SLUG * FOOT  # N in a pound force
INERTIA = SLUG * FOOT**2  # kg m2 in a slug ft2
LEAST_FRAME_RATE = 400.0  # Hz
# JSBSim's integrator of second order; its default for rotation, Euler, has the rates half a step
# late.
ADAMS_BASHFORTH = 3
MILSPEC_TURBULENCE = 3  # JSBSim's number of the Dryden turbulence of MIL-F-8785C
WIND_AT_20_FT = 25.0  # ft/s
MOST_ENGINES = 4
STARTING_THROTTLE = 0.6
MIXTURE = 0.87
AT_REST = 0.02  # ft/s2 and rad/s2, largest acceleration in trim
MOST_BANK = math.radians(75.0)  # rad, largest bank angle of a flight
MOST_PITCH = math.radians(60.0)  # rad, largest pitch angle of a flight
# Gains of the pilot who levels the wings, and his largest aileron.
BANK_GAIN = 0.15  # rad of aileron per rad of bank
ROLL_GAIN = 0.1  # rad of aileron per rad/s of roll rate
MOST_AILERON = 0.12  # rad
# Gains of the pilot who holds attitude and speed while rudder and aileron move.
PITCH_GAIN = 0.3  # rad of elevator per rad of pitch
PITCHING_GAIN = 0.15  # rad of elevator per rad/s of pitch rate
SPEED_GAIN = 0.1  # throttle per m/s of airspeed
# 1/s: integral gain by which the pilot overcomes play and dampers of a surface
PILOT_INTEGRAL_RATE = 4.0
PROBE_COMMAND_SHARE = 0.2  # share of the full command by which a surface's travel is measured
PROBE_TIME = 0.5  # s that the command lasts
LEAST_TRAVEL = 0.02  # rad: a smaller travel at full command counts as none

# Properties that are read after each step, with their SI factors. The total body forces contain
# neither weight nor sensor effects.
READ: Mapping[str, tuple[str, float]] = {
    "airspeed": ("velocities/vt-fps", FOOT),
    "alpha": ("aero/alpha-rad", 1.0),
    "beta": ("aero/beta-rad", 1.0),
    **{name: (f"velocities/{name}-rad_sec", 1.0) for name in "pqr"},
    **{name: (f"attitude/{name}-rad", 1.0) for name in ("phi", "theta", "psi")},
    **{f"force_{axis}": (f"forces/fb{axis}-total-lbs", POUND) for axis in "xyz"},
    **{f"moment_{axis}": (f"moments/{axis}-total-lbsft", POUND * FOOT) for axis in "lmn"},
    "thrust": ("forces/fbx-prop-lbs", POUND),
    "thrust_moment": ("moments/m-prop-lbsft", POUND * FOOT),
    "height": ("position/h-sl-ft", FOOT),
    "mass": ("inertia/mass-slugs", SLUG),
    "air_density": ("atmosphere/rho-slugs_ft3", SLUG / FOOT**3),
}


@dataclass(frozen=True)
class Body:
    """Geometry and inertia of an aircraft, SI.

    ``cross_inertia`` is the integral of x z dm; JSBSim's property has the opposite sign.
    """

    mass: float
    wing_area: float
    span: float
    chord: float
    roll_inertia: float
    pitch_inertia: float
    yaw_inertia: float
    cross_inertia: float


@dataclass(frozen=True, eq=False)
class JsbsimSignals:
    """Signals ``(F,)`` at every frame by name: those of ``READ``, the surfaces (rad), ``time``."""

    signals: Mapping[str, np.ndarray]
    body: Body

    def __getitem__(self, name: str) -> np.ndarray:
        return self.signals[name]


@dataclass(frozen=True)
class Condition:
    """An aircraft in level flight.

    Attributes
    ----------
    altitude, airspeed : m above sea level, true m/s.
    step : length of a frame, s.
    rough_air, air_seed : class of exceedance of the turbulence, and its seed.
    """

    aircraft: str
    altitude: float
    airspeed: float
    step: float
    rough_air: int = 0
    air_seed: int = 1


def fly(condition: Condition, wanted: Mapping[str, np.ndarray], levelling: float) -> JsbsimSignals:
    """Fly from trim, without autopilot and with constant fuel; a pilot moves the surfaces.

    Parameters
    ----------
    wanted : deflection of each surface from trim, rad, and of the throttle, in parts of its travel;
        one value per frame.
    levelling : factor on the gains by which the pilot levels the wings; 0 for none.

    Raises
    ------
    DeclarationError : JSBSim is not installed, the aircraft does not trim here, or it departs.
    """
    surfaces = surfaces_of(condition.aircraft)
    machine = trimmed(condition)
    commanded = _commanded_surfaces(condition, surfaces)
    for name in wanted:
        if name not in (*commanded, "throttle"):
            what = (
                f"{condition.aircraft} has no {name} that its command moves and its air loads read"
            )
            raise DeclarationError(
                what,
                where="key aircraft",
                remedy="give another aircraft, or an axis that does without",
            )
    names = [
        *(surface.property for surface in surfaces.values()),
        *(name for name, _ in READ.values()),
    ]
    rows = np.empty((len(names), len(next(iter(wanted.values())))))
    pilot = _Pilot(machine, commanded, condition.step, levelling)
    for k in range(rows.shape[1]):
        pilot.steer({name: float(values[k]) for name, values in wanted.items()})
        machine.run()
        rows[:, k] = [machine[name] for name in names]
    factors = [
        *(surface.scale for surface in surfaces.values()),
        *(factor for _, factor in READ.values()),
    ]
    signals = dict(zip((*surfaces, *READ), rows * np.array(factors)[:, None], strict=True))
    signals["psi"] = np.unwrap(signals["psi"]) - 2.0 * math.pi * round(
        float(signals["psi"][0]) / (2.0 * math.pi)
    )
    _refuse_departure(condition, signals)
    time = condition.step * np.arange(rows.shape[1])
    return JsbsimSignals({"time": time, **signals}, _body(machine))


@dataclass(frozen=True)
class CommandedSurface:
    """A surface that its command moves, and its deflection at full command, rad."""

    surface: Surface
    travel: float


@functools.cache
def _travels(condition: Condition) -> Mapping[str, float]:
    """Return the deflection at full command by surface, rad, from small steps out of trim."""
    machine, surfaces = trimmed(condition), surfaces_of(condition.aircraft)
    neutral = {name: machine[surface.property] for name, surface in surfaces.items()}
    for name in surfaces:
        machine[f"fcs/{name}-cmd-norm"] += PROBE_COMMAND_SHARE
    moved = dict.fromkeys(surfaces, 0.0)
    for _ in range(round(PROBE_TIME / condition.step)):
        machine.run()
        for name, surface in surfaces.items():
            moved[name] = max(
                moved[name], surface.scale * (machine[surface.property] - neutral[name]), key=abs
            )
    return {
        name: change / PROBE_COMMAND_SHARE
        for name, change in moved.items()
        if abs(change) > LEAST_TRAVEL * PROBE_COMMAND_SHARE
    }


def _commanded_surfaces(
    condition: Condition, surfaces: Mapping[str, Surface]
) -> dict[str, CommandedSurface]:
    travels = _travels(replace(condition, rough_air=0, air_seed=0))
    return {name: CommandedSurface(surfaces[name], travel) for name, travel in travels.items()}


class _Pilot:
    """Proportional-integral control of the surfaces, through play and dampers."""

    def __init__(
        self, machine: Any, commanded: Mapping[str, CommandedSurface], step: float, levelling: float
    ) -> None:
        self._machine, self._commanded = machine, commanded
        self._integral_gain, self._levelling = PILOT_INTEGRAL_RATE * step, levelling
        self._at = {name: machine[f"fcs/{name}-cmd-norm"] for name in (*commanded, "throttle")}
        self._neutral = {name: machine[c.surface.property] for name, c in commanded.items()}
        self._attitude, self._speed = machine["attitude/theta-rad"], machine["velocities/vt-fps"]

    def steer(self, wanted: Mapping[str, float]) -> None:
        """Set the commands of the next frame."""
        machine = self._machine
        for name, commanded in self._commanded.items():
            surface, travel = commanded.surface, commanded.travel
            change = wanted.get(name, 0.0)
            if name == "elevator" and name not in wanted:
                pitch = machine["attitude/theta-rad"] - self._attitude
                change = math.copysign(1.0, travel) * (
                    PITCH_GAIN * pitch + PITCHING_GAIN * machine["velocities/q-rad_sec"]
                )
            if name == "aileron":
                roll = (
                    BANK_GAIN * machine["attitude/phi-rad"]
                    + ROLL_GAIN * machine["velocities/p-rad_sec"]
                )
                change -= math.copysign(self._levelling, travel) * min(
                    MOST_AILERON, max(-MOST_AILERON, roll)
                )
            error = change - surface.scale * (machine[surface.property] - self._neutral[name])
            self._at[name] += self._integral_gain * error / travel
            machine[f"fcs/{name}-cmd-norm"] = self._at[name] + change / travel
        if "throttle" in wanted or "elevator" not in wanted:
            throttle = wanted.get(
                "throttle", SPEED_GAIN * FOOT * (self._speed - machine["velocities/vt-fps"])
            )
            for engine in range(MOST_ENGINES):
                machine[f"fcs/throttle-cmd-norm[{engine}]"] = min(
                    1.0, max(0.0, self._at["throttle"] + throttle)
                )


def trimmed(condition: Condition) -> Any:
    """Return the simulator with the aircraft trimmed in level flight, gear up, engines running.

    Raises DeclarationError if the aircraft does not trim.
    """
    folder = package_folder()
    os.environ.setdefault("JSBSIM_DEBUG", "0")
    package = importlib.import_module("jsbsim")
    try:
        with _silence():
            machine = package.FGFDMExec(str(folder))
            machine.set_debug_level(0)
            for name in NEEDS.get(condition.aircraft, ()):
                machine[name] = 0.0
            _load_and_trim(machine, condition)
        rest = [
            machine[f"accelerations/{name}"]
            for name in ("udot-ft_sec2", "vdot-ft_sec2", "wdot-ft_sec2", "qdot-rad_sec2")
        ]
    except (KeyError, RuntimeError, package.BaseError) as error:
        raise _no_trim(condition, " ".join(str(error).split())) from None
    if not max(map(abs, rest)) < AT_REST:
        raise _no_trim(condition, "accelerations are left")
    if condition.rough_air:
        machine["simulation/randomseed"] = machine["atmosphere/randomseed"] = condition.air_seed
        machine["atmosphere/turb-type"] = MILSPEC_TURBULENCE
        machine["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = WIND_AT_20_FT
        machine["atmosphere/turbulence/milspec/severity"] = condition.rough_air
    return machine


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Suppress the output of JSBSim, which newer versions write by Python and older ones by C."""
    saved = [os.dup(number) for number in (1, 2)]
    with (
        open(os.devnull, "w", encoding="utf-8") as nowhere,
        contextlib.redirect_stdout(nowhere),
        contextlib.redirect_stderr(nowhere),
    ):
        for number in (1, 2):
            os.dup2(nowhere.fileno(), number)
        try:
            yield
        finally:
            ctypes.CDLL(None).fflush(None)  # the buffers of C
            for number, old in zip((1, 2), saved, strict=True):
                os.dup2(old, number)
                os.close(old)


def _load_and_trim(machine: Any, condition: Condition) -> None:
    machine.load_model(condition.aircraft)
    machine.set_dt(condition.step)
    machine["ic/h-sl-ft"], machine["ic/vt-kts"], machine["ic/gamma-deg"] = (
        condition.altitude / FOOT,
        condition.airspeed / KNOT,
        0.0,
    )
    machine["gear/gear-cmd-norm"] = machine["gear/gear-pos-norm"] = 0.0
    machine.run_ic()
    machine["simulation/integrator/rate/rotational"] = machine[
        "simulation/integrator/position/rotational"
    ] = ADAMS_BASHFORTH
    machine["propulsion/fuel_freeze"] = 1
    machine["propulsion/set-running"] = -1
    for engine in range(MOST_ENGINES):
        machine[f"fcs/throttle-cmd-norm[{engine}]"], machine[f"fcs/mixture-cmd-norm[{engine}]"] = (
            STARTING_THROTTLE,
            MIXTURE,
        )
    machine.do_trim(1)


def _no_trim(condition: Condition, why: str) -> DeclarationError:
    what = (
        f"{condition.aircraft} does not trim at {condition.altitude:.0f} m and "
        f"{condition.airspeed:.0f} m/s true ({why})"
    )
    return DeclarationError(
        what,
        where="keys altitude and airspeed",
        remedy="give another altitude or airspeed, or another aircraft",
    )


def _refuse_departure(condition: Condition, signals: Mapping[str, np.ndarray]) -> None:
    finite = all(np.all(np.isfinite(values)) for values in signals.values())
    if (
        not finite
        or np.max(np.abs(signals["phi"])) > MOST_BANK
        or np.max(np.abs(signals["theta"])) > MOST_PITCH
    ):
        what = f"{condition.aircraft} departs from controlled flight in this maneuver"
        raise DeclarationError(
            what, where="key size", remedy="give a smaller size or a shorter duration"
        )


def _body(machine: Any) -> Body:
    inertia = {
        axis: machine[f"inertia/i{axis}-slugs_ft2"] * INERTIA for axis in ("xx", "yy", "zz", "xz")
    }
    size = [machine[f"metrics/{name}"] for name in ("Sw-sqft", "bw-ft", "cbarw-ft")]
    mass = machine["inertia/mass-slugs"] * SLUG
    return Body(
        mass,
        size[0] * FOOT**2,
        size[1] * FOOT,
        size[2] * FOOT,
        inertia["xx"],
        inertia["yy"],
        inertia["zz"],
        -inertia["xz"],
    )


# ---- True derivatives

Columns = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Slopes:
    """Derivatives of one model by name.

    Attributes
    ----------
    values : the derivatives.
    weight : contribution of each to the spread of its load, over that spread.
    left : largest share of a load's variance that the linear fit does not explain.
    """

    values: Mapping[str, float]
    weight: Mapping[str, float]
    left: float

    def without(self, *symbols: str) -> Slopes:
        """Return the slopes without the derivatives with respect to these symbols."""
        values = {
            name: value
            for name, value in self.values.items()
            if name.partition("_")[2] not in symbols
        }
        return replace(self, values=values)


def slopes_of(model: str, signals: JsbsimSignals, motion: JsbsimSignals | None = None) -> Slopes:
    """Return the derivatives of a model: rigid, longitudinal or lateral.

    ``signals``: flight that gives the trim. ``motion``: flight that is fitted; None: the same.
    """
    return {"rigid": _rigid, "longitudinal": _longitudinal, "lateral": _lateral}[model](
        signals, motion or signals
    )


def constants_of(model: str, signals: JsbsimSignals) -> dict[str, float]:
    """Return the constants of a model's vehicle file, SI: body, and air and trim at the start."""
    body = signals.body
    constants = {
        "mass": body.mass,
        "wing_area": body.wing_area,
        "air_density": float(signals["air_density"][0]),
    }
    speed = float(signals["airspeed"][0])
    if model == "lateral":
        return {
            **constants,
            "span": body.span,
            "roll_inertia": body.roll_inertia,
            "yaw_inertia": body.yaw_inertia,
            "cross_inertia": body.cross_inertia,
            "airspeed": speed,
            "trim_alpha": float(signals["alpha"][0]),
            "trim_theta": float(signals["theta"][0]),
        }
    constants |= {"chord": body.chord, "pitch_inertia": body.pitch_inertia}
    if model == "rigid":
        return {**constants, "airspeed": speed}
    return {**constants, "reference_airspeed": speed, "thrust_arm": thrust_arm(signals)}


def thrust_arm(signals: JsbsimSignals) -> float:
    """Return moment over thrust of the engines in trim, m, nose up positive; 0 without thrust."""
    thrust = float(signals["thrust"][0])
    return float(signals["thrust_moment"][0]) / thrust if thrust else 0.0


def _rigid(trim: JsbsimSignals, signals: JsbsimSignals) -> Slopes:
    """Return the derivatives of lift, engines included, and pitching moment.

    The dependence on speed is fitted and left out.
    """
    speed, body = float(trim["airspeed"][0]), signals.body
    columns = {
        "alpha": signals["alpha"],
        "q": signals["q"] * body.chord / (2.0 * speed),
        **_deflections(signals, {"de": "elevator"}),
        "V": signals["airspeed"] / speed,
    }
    lift = -signals["force_z"] * np.cos(signals["alpha"]) + signals["force_x"] * np.sin(
        signals["alpha"]
    )
    area = 0.5 * float(trim["air_density"][0]) * speed**2 * body.wing_area
    return _linear_fit(
        {"CL": (lift / area, columns), "Cm": (signals["moment_m"] / (area * body.chord), columns)}
    ).without("0", "V")


def _longitudinal(trim: JsbsimSignals, signals: JsbsimSignals) -> Slopes:
    """Return the derivatives of the longitudinal coefficients, without thrust and its moment.

    The coefficients refer to the current speed and density.
    """
    speed, body, alpha = float(trim["airspeed"][0]), signals.body, signals["alpha"]
    slow = {"V": signals["airspeed"] / speed, "alpha": alpha}
    columns = {
        **slow,
        "q": signals["q"] * body.chord / (2.0 * speed),
        **_deflections(signals, {"de": "elevator"}),
    }
    x, z, area = signals["force_x"] - signals["thrust"], signals["force_z"], _pressure_area(signals)
    moment = signals["moment_m"] - thrust_arm(trim) * signals["thrust"]
    return _linear_fit(
        {
            "CD": ((-x * np.cos(alpha) - z * np.sin(alpha)) / area, slow),
            "CL": ((x * np.sin(alpha) - z * np.cos(alpha)) / area, columns),
            "Cm": (moment / (area * body.chord), columns),
        }
    )


def _lateral(trim: JsbsimSignals, signals: JsbsimSignals) -> Slopes:
    half, area = signals.body.span / (2.0 * signals["airspeed"]), _pressure_area(signals)
    columns = {
        "beta": signals["beta"],
        "p": signals["p"] * half,
        "r": signals["r"] * half,
        **_deflections(signals, {"da": "aileron", "dr": "rudder"}),
    }
    loads = {
        "CY": signals["force_y"],
        "Cl": signals["moment_l"] / signals.body.span,
        "Cn": signals["moment_n"] / signals.body.span,
    }
    return _linear_fit({letter: (load / area, columns) for letter, load in loads.items()}).without(
        "0"
    )


def _pressure_area(signals: JsbsimSignals) -> np.ndarray:
    return np.asarray(
        0.5 * signals["air_density"] * signals["airspeed"] ** 2 * signals.body.wing_area
    )


def _deflections(signals: JsbsimSignals, names: Mapping[str, str]) -> dict[str, np.ndarray]:
    """Return the deflections of the aircraft's surfaces under the symbols of derivatives."""
    return {
        symbol: signals[surface] for symbol, surface in names.items() if surface in signals.signals
    }


def _linear_fit(loads: Mapping[str, tuple[np.ndarray, Columns]]) -> Slopes:
    """Return the least-squares fit of every load by a constant and its columns, each scaled."""
    values: dict[str, float] = {}
    weight: dict[str, float] = {}
    left = 0.0
    for letter, (load, columns) in loads.items():
        spread = {name: float(np.std(column)) or 1.0 for name, column in columns.items()}
        matrix = np.stack(
            [
                np.ones(len(load)),
                *((column - column[0]) / spread[name] for name, column in columns.items()),
            ],
            axis=1,
        )
        solved = np.linalg.lstsq(matrix, load, rcond=None)[0]
        size = float(np.std(load)) or 1.0
        left = max(left, float(np.var(load - matrix @ solved)) / size**2)
        slopes = {
            name: float(value) / spread[name]
            for name, value in zip(columns, solved[1:], strict=True)
        }
        values[f"{letter}_0"] = float(solved[0]) - sum(
            slopes[name] * float(columns[name][0]) for name in columns
        )
        values |= {f"{letter}_{name}": slope for name, slope in slopes.items()}
        weight |= {
            f"{letter}_{name}": abs(slope) * spread[name] / size for name, slope in slopes.items()
        }
    return Slopes(values, weight, left)
