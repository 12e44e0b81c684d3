"""What a flight by JSBSim declares: aircraft, condition, axis, maneuver, recording, and faults that are put into the record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

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
DURATIONS: Mapping[str, float] = {"rigid": 25.0, "longitudinal": 60.0, "lateral": 40.0, "both": 60.0}  # s
MANEUVERS = ("3-2-1-1", "doublet", "multisine")
INPUTS: Mapping[str, str] = {"elevator": "rad", "aileron": "rad", "rudder": "rad", "thrust": "N"}
OUTPUTS: Mapping[str, str] = {
    **{"airspeed": "m/s", "alpha": "rad", "beta": "rad", "p": "rad/s", "q": "rad/s", "r": "rad/s"},
    **{"phi": "rad", "theta": "rad", "psi": "rad", "ax": "m/s2", "ay": "m/s2", "az": "m/s2", "height": "m"},
}
SURFACES = ("elevator", "aileron", "rudder")


@dataclass(frozen=True)
class JsbsimFlight:
    """A flight to be flown by JSBSim.

    Attributes
    ----------
    aircraft : its name in the JSBSim package. altitude, airspeed : m above sea level, true m/s.
    axis : a key of ``CONTROLS``. maneuver : one of ``MANEUVERS``. size : of the maneuver, 1 is what suits the aircraft.
    duration : s. rate : samples a second. noise : factor on ``noise_std``, which is by output, SI.
    rough_air : class of exceedance of MIL-F-8785C, 0 calm to 7. wrong : largest share by which starting values are off.
    late : by channel, s: an output is shown so late; a surface answers so long after its record.
    backlash : by surface, rad: half the play between the record and the surface. vane_ahead : m, of both vanes, ahead of the centre of gravity.
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
