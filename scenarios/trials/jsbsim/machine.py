"""JSBSim itself: load, trim, fly commands step by step; the only file that imports it, and only when a flight is flown."""

from __future__ import annotations

import importlib
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from scenarios.trials.jsbsim.aircraft import FOOT, KNOT, NEEDS, package_folder, surfaces_of
from sim.errors import DeclarationError

SLUG = 14.59390293720636  # kg
POUND, INERTIA = SLUG * FOOT, SLUG * FOOT**2  # N in a pound force, kg m2 in a slug ft2
FRAMES = 400.0  # Hz at least
ADAMS_BASHFORTH = 3  # JSBSim's integrator of second order; its own choice for rotation, Euler's, has the rates half a step late
MILSPEC, WIND_AT_20_FT = 3, 25.0  # JSBSim's Dryden turbulence after MIL-F-8785C; ft/s
ENGINES, THROTTLE, MIXTURE = 4, 0.6, 0.87
AT_REST = 0.02  # ft/s2 and rad/s2
MOST_BANK, MOST_PITCH = math.radians(75.0), math.radians(60.0)
# The pilot who brings the wings back to level: aileron in parts of its travel per rad and per rad/s.
BANK_GAIN, ROLL_GAIN, MOST_AILERON = 0.5, 0.3, 0.4

# What is read after each step, with its SI factor. The total body forces hold neither weight nor anything of the sensors.
READ: Mapping[str, tuple[str, float]] = {
    **{"airspeed": ("velocities/vt-fps", FOOT), "alpha": ("aero/alpha-rad", 1.0), "beta": ("aero/beta-rad", 1.0)},
    **{name: (f"velocities/{name}-rad_sec", 1.0) for name in "pqr"},
    **{name: (f"attitude/{name}-rad", 1.0) for name in ("phi", "theta", "psi")},
    **{f"force_{axis}": (f"forces/fb{axis}-total-lbs", POUND) for axis in "xyz"},
    **{f"moment_{axis}": (f"moments/{axis}-total-lbsft", POUND * FOOT) for axis in "lmn"},
    **{"thrust": ("forces/fbx-prop-lbs", POUND), "thrust_moment": ("moments/m-prop-lbsft", POUND * FOOT)},
    **{"height": ("position/h-sl-ft", FOOT), "mass": ("inertia/mass-slugs", SLUG), "air_density": ("atmosphere/rho-slugs_ft3", SLUG / FOOT**3)},
}


@dataclass(frozen=True)
class Body:
    """Geometry and inertia as JSBSim has them, SI; ``cross_inertia`` is the integral of x z dm: the property has the other sign."""

    mass: float
    wing_area: float
    span: float
    chord: float
    roll_inertia: float
    pitch_inertia: float
    yaw_inertia: float
    cross_inertia: float


@dataclass(frozen=True, eq=False)
class Flown:
    """Signals at every frame by name: those of ``READ``, the surfaces (rad), ``time``; the last dimension is time."""

    signals: Mapping[str, np.ndarray]
    body: Body

    def __getitem__(self, name: str) -> np.ndarray:
        return self.signals[name]


@dataclass(frozen=True)
class Condition:
    """An aircraft in level flight: altitude (m), true airspeed (m/s), step of a frame (s), and the air: class of exceedance and its seed."""

    aircraft: str
    altitude: float
    airspeed: float
    step: float
    rough_air: int = 0
    air_seed: int = 1


def fly(condition: Condition, commands: Mapping[str, np.ndarray], leveller: float) -> Flown:
    """Fly commands from trim; every autopilot off, fuel frozen.

    Parameters
    ----------
    commands : by control (elevator, aileron, rudder, throttle) what is added to its trim, in parts of full travel, one value a frame.
    leveller : share of the pilot's gains that brings the wings to level; 0 leaves them alone.

    Raises
    ------
    DeclarationError : JSBSim is not installed, the aircraft does not trim here, or the flight goes astray.
    """
    machine = trimmed(condition)
    surfaces = surfaces_of(condition.aircraft)
    count = len(next(iter(commands.values())))
    neutral = {name: machine[f"fcs/{name}-cmd-norm"] for name in ("elevator", "aileron", "rudder", "throttle")}
    names = [*(surface.property for surface in surfaces.values()), *(name for name, _ in READ.values())]
    seen = np.empty((len(names), count))
    for k in range(count):
        _steer(machine, neutral, {name: values[k] for name, values in commands.items()}, leveller)
        machine.run()
        seen[:, k] = [machine[name] for name in names]
    factors = [*(surface.scale for surface in surfaces.values()), *(factor for _, factor in READ.values())]
    signals = dict(zip((*surfaces, *READ), seen * np.array(factors)[:, None], strict=True))
    signals["psi"] = np.unwrap(signals["psi"])
    _refuse_astray(condition, signals)
    return Flown({"time": condition.step * np.arange(count), **signals}, _body(machine))


def _steer(machine: Any, neutral: Mapping[str, float], added: Mapping[str, float], leveller: float) -> None:
    roll = BANK_GAIN * machine["attitude/phi-rad"] + ROLL_GAIN * machine["velocities/p-rad_sec"]
    held = leveller * min(MOST_AILERON, max(-MOST_AILERON, roll))
    for name in ("elevator", "aileron", "rudder"):
        machine[f"fcs/{name}-cmd-norm"] = neutral[name] + added.get(name, 0.0) - (held if name == "aileron" else 0.0)
    if "throttle" in added:
        for engine in range(ENGINES):
            machine[f"fcs/throttle-cmd-norm[{engine}]"] = min(1.0, max(0.0, neutral["throttle"] + added["throttle"]))


def trimmed(condition: Condition) -> Any:
    """The simulator with the aircraft in level unaccelerated flight, gear up, engines running; DeclarationError where it is not."""
    folder = package_folder()
    os.environ.setdefault("JSBSIM_DEBUG", "0")
    package = importlib.import_module("jsbsim")
    machine = package.FGFDMExec(str(folder))
    machine.set_debug_level(0)
    for name in NEEDS.get(condition.aircraft, ()):
        machine[name] = 0.0
    try:
        _load_and_trim(machine, condition)
        rest = [machine[f"accelerations/{name}"] for name in ("udot-ft_sec2", "vdot-ft_sec2", "wdot-ft_sec2", "qdot-rad_sec2")]
    except (KeyError, RuntimeError, package.BaseError) as error:
        raise _no_trim(condition, " ".join(str(error).split())) from None
    if not max(map(abs, rest)) < AT_REST:
        raise _no_trim(condition, "accelerations are left")
    if condition.rough_air:
        machine["simulation/randomseed"] = machine["atmosphere/randomseed"] = condition.air_seed
        machine["atmosphere/turb-type"] = MILSPEC
        machine["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = WIND_AT_20_FT
        machine["atmosphere/turbulence/milspec/severity"] = condition.rough_air
    return machine


def _load_and_trim(machine: Any, condition: Condition) -> None:
    machine.load_model(condition.aircraft)
    machine.set_dt(condition.step)
    machine["ic/h-sl-ft"], machine["ic/vt-kts"], machine["ic/gamma-deg"] = condition.altitude / FOOT, condition.airspeed / KNOT, 0.0
    machine["gear/gear-cmd-norm"] = machine["gear/gear-pos-norm"] = 0.0
    machine.run_ic()
    machine["simulation/integrator/rate/rotational"] = machine["simulation/integrator/position/rotational"] = ADAMS_BASHFORTH
    machine["propulsion/fuel_freeze"] = 1
    machine["propulsion/set-running"] = -1
    for engine in range(ENGINES):
        machine[f"fcs/throttle-cmd-norm[{engine}]"], machine[f"fcs/mixture-cmd-norm[{engine}]"] = THROTTLE, MIXTURE
    machine.do_trim(1)


def _no_trim(condition: Condition, why: str) -> DeclarationError:
    what = f"{condition.aircraft} does not trim at {condition.altitude:.0f} m and {condition.airspeed:.0f} m/s true ({why})"
    return DeclarationError(what, where="keys altitude and airspeed", remedy="give another altitude or airspeed, or another aircraft")


def _refuse_astray(condition: Condition, signals: Mapping[str, np.ndarray]) -> None:
    finite = all(np.all(np.isfinite(values)) for values in signals.values())
    if not finite or np.max(np.abs(signals["phi"])) > MOST_BANK or np.max(np.abs(signals["theta"])) > MOST_PITCH:
        what = f"{condition.aircraft} goes astray in this maneuver"
        raise DeclarationError(what, where="key size", remedy="give a smaller size or a shorter duration")


def _body(machine: Any) -> Body:
    inertia = {axis: machine[f"inertia/i{axis}-slugs_ft2"] * INERTIA for axis in ("xx", "yy", "zz", "xz")}
    size = [machine[f"metrics/{name}"] for name in ("Sw-sqft", "bw-ft", "cbarw-ft")]
    mass = machine["inertia/mass-slugs"] * SLUG
    return Body(mass, size[0] * FOOT**2, size[1] * FOOT, size[2] * FOOT, inertia["xx"], inertia["yy"], inertia["zz"], -inertia["xz"])

