"""Names and units of the channels that records may have."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

TIME = "time"


STICK = "stick"


# Channel -> unit inside; the stick is never converted, its unit is a label.
CHANNEL_UNITS: Mapping[str, str] = MappingProxyType(
    {
        TIME: "s",
        "elevator": "rad",
        STICK: "1",
        "alpha": "rad",
        "q": "rad/s",
        "nz": "g",
        "altitude": "m",
        "height": "m",
        "aileron": "rad",
        "rudder": "rad",
        "thrust": "N",
        "roll_command": "1",
        "pitch_command": "1",
        "yaw_command": "1",
        "thrust_command": "1",
        "beta": "rad",
        "p": "rad/s",
        "r": "rad/s",
        "phi": "rad",
        "psi": "rad",
        "ny": "g",
        "nx": "g",
        "theta": "rad",
        "airspeed": "m/s",
        "dynamic_pressure": "Pa",
        "ax": "m/s2",
        "ay": "m/s2",
        "az": "m/s2",
    }
)
