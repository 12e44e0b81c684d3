"""JSBSim itself: load, trim, fly; and true derivatives of the forces that it made.

In a small motion they are the derivatives about trim; over the maneuver itself, the straight lines
that lie nearest to what the aircraft did. Terms in alpha_dot and beta_dot fall to the others, as in
any fit of models that have none.
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

from scenarios.trials.jsbsim.declaration import (
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
LEAST_FRAME_RATE = 400.0  # Hz at least
# JSBSim's integrator of second order; its own choice for rotation, Euler's, has the rates half a
# step late
ADAMS_BASHFORTH = 3
MILSPEC_TURBULENCE = 3  # JSBSim's number of the Dryden turbulence of MIL-F-8785C
WIND_AT_20_FT = 25.0  # ft/s
MOST_ENGINES = 4
STARTING_THROTTLE = 0.6
MIXTURE = 0.87
AT_REST = 0.02  # ft/s2 and rad/s2
MOST_BANK = math.radians(75.0)  # rad, largest bank angle of a flight
MOST_PITCH = math.radians(60.0)  # rad, largest pitch angle of a flight
# The pilot who brings the wings back to level: aileron (rad) per rad and per rad/s, and at most.
BANK_GAIN = 0.15  # rad of aileron per rad of bank
ROLL_GAIN = 0.1  # rad of aileron per rad/s of roll rate
MOST_AILERON = 0.12  # rad
# The pilot who holds attitude and speed while rudder and aileron are moved: elevator (rad) per rad
# and per rad/s, throttle per m/s.
PITCH_GAIN = 0.3  # rad of elevator per rad of pitch
PITCHING_GAIN = 0.15  # rad of elevator per rad/s of pitch rate
SPEED_GAIN = 0.1  # throttle per m/s of airspeed
# 1/s: how fast the pilot takes up what play or a damper keeps of a surface
PILOT_INTEGRAL_RATE = 4.0
PROBE_COMMAND_SHARE = 0.2  # share of the full command that finds a surface's travel
PROBE_TIME = 0.5  # s that the command lasts
LEAST_REACH = 0.02  # rad: a smaller travel at full command counts as none

# What is read after each step, with its SI factor. The total body forces hold neither weight nor
# anything of the sensors.
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
    """Geometry and inertia as JSBSim has them, SI; ``cross_inertia`` is the integral of x z dm: the
    property has the other sign.
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
    """Signals at every frame by name: those of ``READ``, the surfaces (rad), ``time``; the last
    dimension is time.
    """

    signals: Mapping[str, np.ndarray]
    body: Body

    def __getitem__(self, name: str) -> np.ndarray:
        return self.signals[name]


@dataclass(frozen=True)
class Condition:
    """An aircraft in level flight: altitude (m), true airspeed (m/s), step of a frame (s), and the
    air: class of exceedance and its seed.
    """

    aircraft: str
    altitude: float
    airspeed: float
    step: float
    rough_air: int = 0
    air_seed: int = 1


def fly(condition: Condition, wanted: Mapping[str, np.ndarray], leveller: float) -> JsbsimSignals:
    """Fly from trim; every autopilot off, fuel frozen, and a pilot who puts the surfaces where they
    are wanted.

    Parameters
    ----------
    wanted : by surface what is added to its trim, rad, and of the throttle, parts of full travel;
        one value a frame.
    leveller : share of the pilot's gains that brings the wings to level; 0 leaves them alone.

    Raises
    ------
    DeclarationError : JSBSim is not installed, the aircraft does not trim here, or the flight goes
        astray.
    """
    surfaces = surfaces_of(condition.aircraft)
    machine = trimmed(condition)
    hands = _hands(condition, surfaces)
    for name in wanted:
        if name not in (*hands, "throttle"):
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
    seen = np.empty((len(names), len(next(iter(wanted.values())))))
    pilot = _Pilot(machine, hands, condition.step, leveller)
    for k in range(seen.shape[1]):
        pilot.steer({name: float(values[k]) for name, values in wanted.items()})
        machine.run()
        seen[:, k] = [machine[name] for name in names]
    factors = [
        *(surface.scale for surface in surfaces.values()),
        *(factor for _, factor in READ.values()),
    ]
    signals = dict(zip((*surfaces, *READ), seen * np.array(factors)[:, None], strict=True))
    signals["psi"] = np.unwrap(signals["psi"]) - 2.0 * math.pi * round(
        float(signals["psi"][0]) / (2.0 * math.pi)
    )
    _refuse_astray(condition, signals)
    return JsbsimSignals(
        {"time": condition.step * np.arange(seen.shape[1]), **signals}, _body(machine)
    )


@dataclass(frozen=True)
class Hand:
    """A surface in the pilot's hand: its property with its scale to radians, and the radians that
    full command is worth.
    """

    surface: Surface
    reach: float


@functools.cache
def _reaches(condition: Condition) -> Mapping[str, float]:
    """Return, by surface, the deflection in rad at full command, measured with a small step of each
    from trim.
    """
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
        if abs(change) > LEAST_REACH * PROBE_COMMAND_SHARE
    }


def _hands(condition: Condition, surfaces: Mapping[str, Surface]) -> dict[str, Hand]:
    reaches = _reaches(replace(condition, rough_air=0, air_seed=0))
    return {name: Hand(surfaces[name], reach) for name, reach in reaches.items()}


class _Pilot:
    """Commands by which surfaces go where they are wanted, through play, dampers and unequal
    travel: in proportion, and until nothing is left.
    """

    def __init__(
        self, machine: Any, hands: Mapping[str, Hand], step: float, leveller: float
    ) -> None:
        self._machine, self._hands, self._share, self._leveller = (
            machine,
            hands,
            PILOT_INTEGRAL_RATE * step,
            leveller,
        )
        self._at = {name: machine[f"fcs/{name}-cmd-norm"] for name in (*hands, "throttle")}
        self._neutral = {name: machine[hand.surface.property] for name, hand in hands.items()}
        self._attitude, self._speed = machine["attitude/theta-rad"], machine["velocities/vt-fps"]

    def steer(self, wanted: Mapping[str, float]) -> None:
        """Set the commands of the next frame."""
        machine = self._machine
        for name, hand in self._hands.items():
            change = wanted.get(name, 0.0)
            if name == "elevator" and name not in wanted:
                raised = machine["attitude/theta-rad"] - self._attitude
                change = math.copysign(1.0, hand.reach) * (
                    PITCH_GAIN * raised + PITCHING_GAIN * machine["velocities/q-rad_sec"]
                )
            if name == "aileron":
                roll = (
                    BANK_GAIN * machine["attitude/phi-rad"]
                    + ROLL_GAIN * machine["velocities/p-rad_sec"]
                )
                change -= math.copysign(self._leveller, hand.reach) * min(
                    MOST_AILERON, max(-MOST_AILERON, roll)
                )
            left = change - hand.surface.scale * (
                machine[hand.surface.property] - self._neutral[name]
            )
            self._at[name] += self._share * left / hand.reach
            machine[f"fcs/{name}-cmd-norm"] = self._at[name] + change / hand.reach
        if "throttle" in wanted or "elevator" not in wanted:
            pushed = wanted.get(
                "throttle", SPEED_GAIN * FOOT * (self._speed - machine["velocities/vt-fps"])
            )
            for engine in range(MOST_ENGINES):
                machine[f"fcs/throttle-cmd-norm[{engine}]"] = min(
                    1.0, max(0.0, self._at["throttle"] + pushed)
                )


def trimmed(condition: Condition) -> Any:
    """Return the simulator with the aircraft in level unaccelerated flight, gear up, engines
    running; DeclarationError where it is not.
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
    """Keep what JSBSim writes from the terminal: by Python's streams, by those of C in older
    versions.
    """
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
            ctypes.CDLL(None).fflush(None)  # what still waits in the buffers of C
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


def _refuse_astray(condition: Condition, signals: Mapping[str, np.ndarray]) -> None:
    finite = all(np.all(np.isfinite(values)) for values in signals.values())
    if (
        not finite
        or np.max(np.abs(signals["phi"])) > MOST_BANK
        or np.max(np.abs(signals["theta"])) > MOST_PITCH
    ):
        what = f"{condition.aircraft} goes astray in this maneuver"
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
    """Derivatives of one model by name; ``weight``: what each moves its load by, over the load's
    spread; ``left``: the largest share of a load's variance that straight lines leave.
    """

    values: Mapping[str, float]
    weight: Mapping[str, float]
    left: float

    def without(self, *symbols: str) -> Slopes:
        """Return the same but for derivatives by these symbols."""
        return Slopes(
            {
                name: value
                for name, value in self.values.items()
                if name.partition("_")[2] not in symbols
            },
            self.weight,
            self.left,
        )


def slopes_of(model: str, signals: JsbsimSignals, motion: JsbsimSignals | None = None) -> Slopes:
    """Return the derivatives of a model (rigid, longitudinal or lateral); of ``motion`` where it is
    another flight from the same trim.
    """
    return {"rigid": _rigid, "longitudinal": _longitudinal, "lateral": _lateral}[model](
        signals, motion or signals
    )


def constants_of(model: str, signals: JsbsimSignals) -> dict[str, float]:
    """Return the constants of a model's vehicle file other than its derivatives, SI: body, air and
    trim as they are at the start of a flight.
    """
    body = signals.body
    result = {
        "mass": body.mass,
        "wing_area": body.wing_area,
        "air_density": float(signals["air_density"][0]),
    }
    speed = float(signals["airspeed"][0])
    if model == "lateral":
        result |= {
            "span": body.span,
            "roll_inertia": body.roll_inertia,
            "yaw_inertia": body.yaw_inertia,
            "cross_inertia": body.cross_inertia,
        }
        return {
            **result,
            "airspeed": speed,
            "trim_alpha": float(signals["alpha"][0]),
            "trim_theta": float(signals["theta"][0]),
        }
    result |= {"chord": body.chord, "pitch_inertia": body.pitch_inertia}
    if model == "rigid":
        return {**result, "airspeed": speed}
    return {**result, "reference_airspeed": speed, "thrust_arm": thrust_arm(signals)}


def thrust_arm(signals: JsbsimSignals) -> float:
    """Moment of the engines over their thrust in trim, m, nose up positive; 0 if there is no
    thrust.
    """
    thrust = float(signals["thrust"][0])
    return float(signals["thrust_moment"][0]) / thrust if thrust else 0.0


def _rigid(trim: JsbsimSignals, signals: JsbsimSignals) -> Slopes:
    """Lift force across the path with engines; the dependence on speed is fitted and left out."""
    speed, body = float(trim["airspeed"][0]), signals.body
    columns = {
        "alpha": signals["alpha"],
        "q": signals["q"] * body.chord / (2.0 * speed),
        **_moved(signals, {"de": "elevator"}),
        "V": signals["airspeed"] / speed,
    }
    lift = -signals["force_z"] * np.cos(signals["alpha"]) + signals["force_x"] * np.sin(
        signals["alpha"]
    )
    area = 0.5 * float(trim["air_density"][0]) * speed**2 * body.wing_area
    return _straight(
        {"CL": (lift / area, columns), "Cm": (signals["moment_m"] / (area * body.chord), columns)}
    ).without("0", "V")


def _longitudinal(trim: JsbsimSignals, signals: JsbsimSignals) -> Slopes:
    """Return the coefficients of the whole longitudinal motion at the current speed and density,
    without thrust and its moment.
    """
    speed, body, alpha = float(trim["airspeed"][0]), signals.body, signals["alpha"]
    slow = {"V": signals["airspeed"] / speed, "alpha": alpha}
    columns = {
        **slow,
        "q": signals["q"] * body.chord / (2.0 * speed),
        **_moved(signals, {"de": "elevator"}),
    }
    x, z, area = signals["force_x"] - signals["thrust"], signals["force_z"], _pressure_area(signals)
    moment = signals["moment_m"] - thrust_arm(trim) * signals["thrust"]
    return _straight(
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
        **_moved(signals, {"da": "aileron", "dr": "rudder"}),
    }
    loads = {
        "CY": signals["force_y"],
        "Cl": signals["moment_l"] / signals.body.span,
        "Cn": signals["moment_n"] / signals.body.span,
    }
    return _straight({letter: (load / area, columns) for letter, load in loads.items()}).without(
        "0"
    )


def _pressure_area(signals: JsbsimSignals) -> np.ndarray:
    return np.asarray(
        0.5 * signals["air_density"] * signals["airspeed"] ** 2 * signals.body.wing_area
    )


def _moved(signals: JsbsimSignals, names: Mapping[str, str]) -> dict[str, np.ndarray]:
    """Return the surfaces that the loads of this aircraft read, under the names of derivatives."""
    return {
        symbol: signals[surface] for symbol, surface in names.items() if surface in signals.signals
    }


def _straight(loads: Mapping[str, tuple[np.ndarray, Columns]]) -> Slopes:
    """Least squares of every load on a constant and its columns, each scaled to its own spread."""
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
