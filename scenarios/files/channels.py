"""The channels that a record may hold, and the channel map that finds them under other headers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenarios.files.channel_names import CHANNEL_UNITS


@dataclass(frozen=True)
class ColumnChoice:
    """Where one channel stands in a file.

    Attributes
    ----------
    column : header of the column, with or without its unit in brackets.
    unit : unit of the column; None leaves it to the header.
    """

    column: str
    unit: str | None = None


def read_channel_map(path: str | Path | Mapping[str, Any], known: Iterable[str] = CHANNEL_UNITS) -> dict[str, ColumnChoice]:
    """Channel name -> column, from a TOML file with lines such as ``alpha = {column = "AoA1", unit = "deg"}`` or ``alpha = "AoA1"``, or as a mapping.

    ``known``: all channels that there are.

    Raises
    ------
    DeclarationError : the file cannot be read, or a channel or key is unknown, missing or of the wrong kind.
    """
    from scenarios.files.channels_schema import channel_map
    from scenarios.files.declarations import checked, read_toml

    schema = channel_map(tuple(known))
    content, where = (path, "channels") if isinstance(path, Mapping) else (read_toml(path), path)
    chosen = checked(schema, content, where)
    entries = {field.alias or name: getattr(chosen, name) for name, field in schema.model_fields.items()}
    return {name: ColumnChoice(entry.column, entry.unit) for name, entry in entries.items() if entry is not None}
