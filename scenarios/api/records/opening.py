"""Whatever holds a record, opened as a record file, with what is said of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

from scenarios.api.records.channels import INPUTS, refuse_units
from scenarios.api.records.conversion import unpacked
from scenarios.api.records.in_memory import file_of_columns
from scenarios.files.channel_names import CHANNEL_UNITS, TIME
from scenarios.files.channels import read_channel_map
from scenarios.files.measured.record_file import RecordFile, read_record_file
from scenarios.preparation.plan import plan_of
from sim.errors import DeclarationError
from sim.record import Hold

Units = Mapping[str, str]
# A channel map: channel -> column, with its unit where the column does not say it; or the path of a file with such a map.
Choices = Mapping[str, str | tuple[str, str] | Mapping[str, str]] | str | PathLike[str]


def opened_source(
    source: Any, *, units: Units | None = None, channels: Choices | None = None, hold: str | None = None, name: str | None = None
) -> tuple[RecordFile, tuple[str, ...] | None]:
    """A path, table, arrays or another package's container as a record file, and the inputs that it names (None: it names none).

    Nothing in it is looked at but what ``units`` and ``channels`` speak of. Raises RecordError and DeclarationError.
    """
    content, told = unpacked(source)
    known = {**told.units, **(units or {})}
    held = plan_of(hold=told.hold if hold is None else hold).hold
    if isinstance(content, Path):
        file = read_record_file(content)
        sidecar = replace(file.sidecar, units={**file.sidecar.units, **known})
        file = replace(file, sidecar=sidecar if held is None else replace(sidecar, hold=Hold(held), says_hold=True))
    else:
        file = file_of_columns(content, name or told.name, known, held, unreadable=told.unreadable)
    chosen = choices_of(channels, units or {})
    if chosen is not None:
        choices = read_channel_map(chosen) if isinstance(chosen, Path) else read_channel_map(chosen, chosen)
        file = _computed(replace(file, choices=choices))
    refuse_units(units or {}, file)
    return file, told.inputs


def _computed(file: RecordFile) -> RecordFile:
    """The file with a column for each channel that its map computes, and the topics of a log on one grid."""
    from scenarios.files.measured.derived import with_derived

    names = [name for name in file.choices if name != TIME]
    controls = [name for name in names if name in INPUTS]
    known = {**{name: "1" for name in names}, **CHANNEL_UNITS}
    derived, choices = with_derived(file, file.choices, controls, [name for name in names if name not in controls], known=known)
    return replace(derived, choices=dict(choices or {}))


def choices_of(channels: Any, units: Units | None = None) -> Path | dict[str, Any] | None:
    """A channel map as files have it, with ``units`` that were told of columns and not of channels; or its path. Raises DeclarationError."""
    if channels is None:
        return None
    if isinstance(channels, str | PathLike):
        return Path(channels)
    if not isinstance(channels, Mapping):
        what = f"a {type(channels).__name__} is no channel map"
        raise DeclarationError(what, where="channels", remedy='give {"alpha": "HEADER", ...} or the path of a map')
    return {key: _entry(value, units or {}) for key, value in channels.items()}


def _entry(value: Any, units: Units) -> Any:
    if isinstance(value, str):
        return {"column": value, **({"unit": units[value]} if value in units else {})}
    if isinstance(value, tuple | list) and len(value) == 2:
        return {"column": value[0], "unit": value[1]}
    return value
