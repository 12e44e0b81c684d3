"""Declaration of a flight by JSBSim: aircraft, condition, maneuvers, and added faults.

A fault of a surface lies between its record and the surface. It is added to the record, so that the
recorded input is the one that leads to the flown motion through the fault.
"""

from __future__ import annotations

import importlib.util
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from scenarios.files.declarations import CHANNEL_UNITS, closest
from sim.errors import DeclarationError
from sim.maneuvers import Maneuver, Sum, doublet, orthogonal_multisines, three_two_one_one

# ---- What a flight by JSBSim declares

# Axis -> controls that are moved, and the models that the record is for.
CONTROLS: Mapping[str, tuple[str, ...]] = {
    "rigid": ("elevator",),
    "longitudinal": ("elevator", "throttle"),
    "lateral": ("rudder", "aileron"),
    "both": ("elevator", "rudder", "aileron"),
}
MODELS: Mapping[str, tuple[str, ...]] = {
    "rigid": ("rigid",),
    "longitudinal": ("longitudinal",),
    "lateral": ("lateral",),
    "both": ("rigid", "longitudinal", "lateral"),
}
# Usual duration by axis, s.
DURATIONS: Mapping[str, float] = {
    "rigid": 25.0,
    "longitudinal": 60.0,
    "lateral": 40.0,
    "both": 60.0,
}
MANEUVERS = ("3-2-1-1", "doublet", "multisine")
INPUTS: Mapping[str, str] = {"elevator": "rad", "aileron": "rad", "rudder": "rad", "thrust": "N"}
OUTPUTS: Mapping[str, str] = {
    name: CHANNEL_UNITS[name]
    for name in (
        *("airspeed", "alpha", "beta", "p", "q", "r", "phi", "theta", "psi"),
        *("ax", "ay", "az", "height"),
    )
}
SURFACES = ("elevator", "aileron", "rudder")


@dataclass(frozen=True)
class JsbsimFlight:
    """A flight by JSBSim.

    Attributes
    ----------
    aircraft : name in the JSBSim package.
    altitude, airspeed : m above sea level, true m/s.
    axis : a key of ``CONTROLS``.
    maneuver : one of ``MANEUVERS``.
    size : factor on the amplitudes that suit the aircraft.
    duration : s.
    rate : samples a second.
    noise : factor on ``noise_std``.
    noise_std : measurement noise by output, SI.
    rough_air : class of exceedance of MIL-F-8785C, 0 calm to 7.
    wrong : largest relative error of the starting values.
    late : delay by channel, s: of a sensor, or of a surface after its record.
    backlash : half the play between record and surface, by surface, rad.
    vane_ahead : distance of both vanes ahead of the centre of gravity, m.
    """

    name: str
    title: str
    about: str
    aircraft: str
    altitude: float
    airspeed: float
    axis: str
    maneuver: str
    size: float
    duration: float
    rate: float
    noise: float
    noise_std: Mapping[str, float]
    rough_air: int = 0
    wrong: float = 0.3
    late: Mapping[str, float] = field(default_factory=dict)
    backlash: Mapping[str, float] = field(default_factory=dict)
    vane_ahead: float = 0.0
    seed: int = 1


# ---- The aircraft of the JSBSim package

FOOT = 0.3048  # m
KNOT = 1852.0 / 3600.0  # m/s
REMEDY = "pip install 'flightid[jsbsim]'"


def _at(feet: float, knots: float) -> tuple[float, float]:
    return feet * FOOT, knots * KNOT


# Altitude (m) and true airspeed (m/s) of steady level flight, in the middle of each envelope.
CONDITIONS: Mapping[str, tuple[float, float]] = {
    "c172x": _at(5000, 105),
    "c172p": _at(5000, 105),
    "t6texan2": _at(8000, 220),
    "OV10": _at(5000, 210),
    "A320": _at(20000, 380),
    "MD11": _at(20000, 400),
    "737": _at(20000, 380),
    "B747": _at(20000, 400),
    "fokker100": _at(15000, 260),
    "F4N": _at(15000, 430),
    "T38": _at(15000, 380),
    "T37": _at(12000, 280),
    "f104": _at(20000, 520),
    "Concorde": _at(20000, 480),
}
_PUSHBACK = tuple(
    f"/sim/model/pushback/{name}"
    for name in ("position-norm", "kp", "ki", "kd", "force", "target-speed-fps")
)
# Properties of other programs that an aircraft's files read, and which must exist.
NEEDS: Mapping[str, tuple[str, ...]] = {
    "fokker100": ("/gear/gear/wow", *_PUSHBACK),
    "f104": ("systems/radar/range",),
}
# Travel (rad) of surfaces whose deflection is given as a share of it; 20 degrees if unknown.
TRAVEL: Mapping[tuple[str, str], float] = {("T38", "elevator"): 0.297}
USUAL_TRAVEL = math.radians(20.0)


@dataclass(frozen=True)
class Surface:
    """The property of a surface that the aerodynamics read, and its factor to radians."""

    property: str
    scale: float


def package_folder() -> Path:
    """Return the folder in which JSBSim is installed; DeclarationError if it is not."""
    spec = importlib.util.find_spec("jsbsim")
    if spec is None or spec.origin is None:
        raise DeclarationError(
            "JSBSim is not installed, and this flight is one of its",
            where="flightid simulate",
            remedy=REMEDY,
        )
    return Path(spec.origin).parent


def refuse_unknown_aircraft(name: str, where: str) -> None:
    """Raise DeclarationError if the package has no such aircraft."""
    names = sorted(
        path.name
        for path in (package_folder() / "aircraft").iterdir()
        if (path / f"{path.name}.xml").is_file()
    )
    if name not in names:
        raise DeclarationError(
            f"JSBSim has no aircraft {name!r}", where=where, remedy=closest(name, names)
        )


def surfaces_of(name: str) -> dict[str, Surface]:
    """Return the surfaces that the aerodynamics of an aircraft read.

    Of several properties of a surface, the one that is read most often is taken.
    """
    counted = Counter(_read_properties(package_folder() / "aircraft" / name / f"{name}.xml"))
    surfaces = {}
    for surface in SURFACES:
        candidates = [
            (count, prop)
            for prop, count in counted.items()
            if surface in prop and "mag-" not in prop and "cmd" not in prop
        ]
        if candidates:
            prop = max(candidates)[1]
            surfaces[surface] = Surface(prop, _scale(name, surface, prop))
    return surfaces


def _scale(name: str, surface: str, prop: str) -> float:
    if prop.endswith("-norm"):
        return TRAVEL.get((name, surface), USUAL_TRAVEL)
    return math.radians(1.0) if prop.endswith("-deg") else 1.0


def _read_properties(path: Path) -> Iterator[str]:
    """Yield every property that an aircraft's aerodynamics read, as often as they read it."""
    for section in ElementTree.parse(path).getroot().iter("aerodynamics"):
        other = section.get("file")
        if other:
            section = ElementTree.parse((path.parent / other).with_suffix(".xml")).getroot()
        for element in section.iter():
            if element.tag in ("property", "independentVar", "p") and element.text:
                yield element.text.strip().lstrip("-")


# ---- Faults of sensors and surfaces

Signals = Mapping[str, np.ndarray]
STILL_DEFLECTION = 1e-9  # rad per frame, below which a surface does not move


def with_faults(signals: Signals, flight: JsbsimFlight) -> dict[str, np.ndarray]:
    """Return the signals with the declared faults: vanes, play, then delays."""
    shown, time = dict(signals), signals["time"]
    if flight.vane_ahead:
        # A point ahead of the centre of gravity moves up with q, and to the right with r.
        shown["alpha"] = shown["alpha"] - flight.vane_ahead * shown["q"] / shown["airspeed"]
        shown["beta"] = shown["beta"] + flight.vane_ahead * shown["r"] / shown["airspeed"]
    for name, half in flight.backlash.items():
        shown[name] = ahead_of_play(shown[name], half)
    for name, delay in flight.late.items():
        # A surface that responds late was recorded early.
        shown[name] = np.interp(
            time + delay if name in SURFACES else time - delay, time, shown[name]
        )
    return shown


def ahead_of_play(surface: np.ndarray, half: float) -> np.ndarray:
    """Return the drive that moves a surface as given through a play of ``half`` to either side.

    While the surface moves, the drive is ``half`` ahead of it. While the surface does not move, the
    drive crosses the play at constant speed. It starts in the middle of the play.
    """
    moving = np.sign(np.where(np.abs(np.diff(surface)) > STILL_DEFLECTION, np.diff(surface), 0.0))
    at = np.flatnonzero(moving)
    if len(at) == 0:
        return surface.copy()
    # Frame k + 1 is reached by motion k.
    return np.asarray(
        surface + half * np.interp(np.arange(len(surface)), [0, *(at + 1)], [0.0, *moving[at]])
    )


def named(flight: JsbsimFlight) -> dict[str, dict[str, float]]:
    """Return the added faults and turbulence by their names in the library of effects."""
    effects: dict[str, dict[str, float]] = {}
    for name, delay in flight.late.items():
        effects[f"{'input' if name in SURFACES else 'sensor'}-delay:{name}"] = {"delay": delay}
    for name, half in flight.backlash.items():
        effects[f"input-backlash:{name}"] = {"half_width": half}
    if flight.vane_ahead:
        effects["vane-offset"] = {"arm": flight.vane_ahead}
    if flight.rough_air:
        effects["gust-turbulence"] = {"class_of_exceedance": float(flight.rough_air)}
    return effects


# ---- Commands of a flight

HAND_TRAVEL_TIME = 0.15  # s that a pilot's hand takes from one level to the next
QUIET_START_TIME = 2.0  # s before the first maneuver
HIGHEST_FREQUENCY_RATIO = 2.2  # of a multisine, over the frequency of the mode
RMS_TO_PEAK = 0.5  # rms of a multisine over its peak
THROTTLE_HOLD_TIME = 5.0  # s that a throttle is held
# Times of the first and of the second maneuver of a control, as shares of the record.
SLOTS: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "rigid": {"elevator": (0.0, 0.55)},
    "longitudinal": {"elevator": (0.0, 0.72), "throttle": (0.3, 0.52)},
    "lateral": {"rudder": (0.0, 0.55), "aileron": (0.3, 0.8)},
    "both": {"elevator": (0.0, 0.55), "rudder": (0.2, 0.7), "aileron": (0.38, 0.86)},
}


def commands(
    flight: JsbsimFlight, sizes: Mapping[str, float], units: Mapping[str, float], time: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the command of each control at each frame, from trim.

    Commands are in rad, that of the throttle in parts of its travel.

    Parameters
    ----------
    sizes : peak by control.
    units : unit of a 3-2-1-1 that suits the mode that the control excites, s.
    """
    maneuvers = _multisines(flight, sizes, units) if flight.maneuver == "multisine" else {}
    for control in CONTROLS[flight.axis]:
        if control not in maneuvers:
            maneuvers[control] = _steps(flight, control, sizes[control], units[control])
    return {control: by_hand(maneuver(time), time) for control, maneuver in maneuvers.items()}


def by_hand(values: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return a command with ramps for steps: its mean over the last ``HAND_TRAVEL_TIME``."""
    width = max(1, round(HAND_TRAVEL_TIME / float(time[1] - time[0])))
    total = np.concatenate([np.zeros(width), np.cumsum(values)])
    return np.asarray((total[width:] - total[:-width]) / width)


def rehearsal(control: str, size: float, unit: float, time: np.ndarray) -> dict[str, np.ndarray]:
    """Return a 3-2-1-1 of one control, soon after the start."""
    return {control: by_hand(three_two_one_one(size, unit, 0.5)(time), time)}


def _steps(flight: JsbsimFlight, control: str, size: float, unit: float) -> Maneuver:
    first, again = (
        QUIET_START_TIME + share * (flight.duration - QUIET_START_TIME)
        for share in SLOTS[flight.axis][control]
    )
    if control == "throttle":
        # Shorter in a short record.
        held = min(THROTTLE_HOLD_TIME, 0.1 * flight.duration)
        return Sum((doublet(size, held, first), doublet(-0.7 * size, 0.6 * held, again)))
    if flight.maneuver == "doublet":
        return Sum((doublet(size, 1.7 * unit, first), doublet(-0.8 * size, unit, again)))
    return Sum((three_two_one_one(size, unit, first), doublet(-0.8 * size, 1.5 * unit, again)))


def _multisines(
    flight: JsbsimFlight, sizes: Mapping[str, float], units: Mapping[str, float]
) -> dict[str, Maneuver]:
    surfaces = [control for control in CONTROLS[flight.axis] if control != "throttle"]
    period = flight.duration - QUIET_START_TIME - 1.0
    # The unit is 1.6 over the frequency of the mode.
    frequency = 1.6 / min(units[surface] for surface in surfaces)
    harmonic = round(period * HIGHEST_FREQUENCY_RATIO * frequency / (2.0 * np.pi))
    multisines = orthogonal_multisines(
        [RMS_TO_PEAK * sizes[surface] for surface in surfaces],
        period,
        2,
        max(3 * len(surfaces), harmonic),
        QUIET_START_TIME,
    )
    return dict(zip(surfaces, multisines, strict=True))
