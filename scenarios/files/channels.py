"""The channels that a record may have: their names and units, and the channel map that finds them
under other headers.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scenarios.files.schemas import ColumnEntry

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


@dataclass(frozen=True)
class ColumnChoice:
    """Where one channel is in a file, and what is computed from it.

    Attributes
    ----------
    column : header of the column, with or without its unit in brackets; its number, counted from 1;
    or an expression over columns
        (``scenarios.files.measured.expressions``). In a log of several topics ``topic.field``.
        Empty: the record has no such channel,
        whatever its columns are called.
    unit : unit of the column or of the expression's result; None leaves it to the header, or to the
    units of the columns. scale, offset : the channel is ``scale * column + offset``, in ``unit``,
    in SI where none is given. delay : s, by which the column was recorded late: the channel at
    ``t`` is the column at ``t + delay``. table : calibration ``(x1, ...), (y1, ...)``: the channel
    is linear between the points, in ``unit``; before ``scale``. hold : ``"previous"`` or
    ``"linear"``: between samples of a column that is slower than the record; None: by the data.
    """

    column: str | int
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0
    delay: float = 0.0
    table: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    hold: str | None = None

    @property
    def absent(self) -> bool:
        """Whether the channel is not to be read."""
        return self.column == ""

    @property
    def computed(self) -> bool:
        """Whether anything but the column's own numbers is wanted."""
        return (self.scale, self.offset, self.delay, self.table) != (1.0, 0.0, 0.0, None)


def read_channel_map(
    path: str | Path | Mapping[str, Any], known: Iterable[str] = CHANNEL_UNITS
) -> dict[str, ColumnChoice]:
    """Channel name -> column, from a TOML file or as a mapping.

    Lines are such as ``alpha = "AoA1"``, ``alpha = {column = "AoA1", unit = "deg"}``, ``q = {column
    = 4, unit = "deg/s"}``, ``elevator = {column = "0.5*(elevon_left + elevon_right)", unit =
    "deg"}`` or ``elevator = {sum = ["a", "b"], scale = 0.5}``; with ``airspeed = false`` the record
    counts as one without that channel.

    ``known``: all channels that there are.

    Raises
    ------
    DeclarationError : the file cannot be read, or a channel or key is unknown, missing or of the
    wrong kind.
    """
    from scenarios.files.declarations import checked, read_toml
    from scenarios.files.schemas import channel_map

    schema = channel_map(tuple(known))
    content, where = (path, "channels") if isinstance(path, Mapping) else (read_toml(path), path)
    chosen = checked(schema, content, where)
    entries = {
        field.alias or name: getattr(chosen, name) for name, field in schema.model_fields.items()
    }
    return {name: _choice(entry) for name, entry in entries.items() if entry is not None}


def _choice(entry: ColumnEntry) -> ColumnChoice:
    """What the reader is given: ``bias`` is taken off, ``sign`` turns the scale."""
    from scenarios.files.schemas import ABSENT

    if entry.column == ABSENT:
        return ColumnChoice("")
    column = entry.column if entry.sum is None else " + ".join(f"`{name}`" for name in entry.sum)
    assert column is not None
    table = None if entry.table is None else (tuple(entry.table[0]), tuple(entry.table[1]))
    return ColumnChoice(
        column,
        entry.unit,
        entry.sign * entry.scale,
        entry.offset - (entry.bias or 0.0),
        entry.delay,
        table,
        entry.hold,
    )
