"""Names and units of the channels that records may have."""

from __future__ import annotations

import re
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

CLOCK_NAMES = (
    "time", "t", "timestamp", "timeus", "timems", "timens", "time_us", "time_ms", "time_ns", "time_s", "timestamp_us", "timestamp_ms",  # noqa: E501
    "timestamp_ns", "elapsed", "elapsed time", "elapsed_time", "seconds", "sec", "utc", "utc time", "utc_time", "datetime", "date_time",  # noqa: E501
    "date", "gps_time", "tout", "irig", "irig time", "irig_time", "zeit",
    "time_boot_ms", "x_value",
)  # fmt: skip
# an element of an array, as q[0]; of q[1] the unit may be 1
_ELEMENT = re.compile(r"\w+\[(0|[2-9]|\d\d+)\]")
_BRACKETS = re.compile(r"(.*?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))")


def split_header(cell: str) -> tuple[str, str | None]:
    """Name and unit of ``name [unit]`` or ``name (unit)``; the unit is None without brackets."""
    found = _BRACKETS.fullmatch(cell)
    if found is None or not found[1] or _ELEMENT.fullmatch(cell):
        return cell, None
    return found[1], (found[2] if found[2] is not None else found[3]).strip()


def is_clock(name: str) -> bool:
    """Whether a header names a clock, in whatever case and with any unit in brackets."""
    plain = re.sub(r"\s*[\[(].*", "", name).strip().lower()
    return plain in CLOCK_NAMES or plain.replace(" ", "_") in CLOCK_NAMES
