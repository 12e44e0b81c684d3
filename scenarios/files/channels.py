"""The channels that a record may hold, and the channel map that finds them under other headers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.files.channel_names import CHANNEL_UNITS

if TYPE_CHECKING:
    from scenarios.files.schemas import ColumnEntry


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
