"""The JSON beside a record: name, hold of the inputs and units, which a CSV file cannot carry."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scenarios.files.channel_names import split_header
from scenarios.files.declarations import closest
from scenarios.files.documents import DocumentError, json_value
from scenarios.files.measured.columns import suffix_unit
from sim.errors import RecordError
from sim.record import Hold

SCHEMA = "flightid/record/1"
KEYS = ("schema", "name", "hold", "units", "origin")
_AWAY = "mend it, or move it away where it does not belong to the record"
SIMULATED = "simulated"  # the value of the key ``origin``


@dataclass(frozen=True)
class Sidecar:
    """What a record's JSON says.

    Attributes
    ----------
    name : the record's name, None if it says none.
    hold : how the inputs behave between samples.
    says_hold : whether the file says so, or ``hold`` is only the default.
    simulated : whether a program made the data; figures say so.
    units : channel -> unit of a column whose header carries none.
    file : name of the JSON file; empty where there is none.
    """

    name: str | None = None
    hold: Hold = Hold.PREVIOUS
    units: Mapping[str, str] = field(default_factory=dict)
    says_hold: bool = False
    simulated: bool = False
    file: str = ""


def sidecar_path(record: Path) -> Path:
    """``record.json`` beside ``record.csv`` or ``record.csv.gz``."""
    plain = record.with_suffix("") if record.suffix.lower() == ".gz" else record
    return plain.with_suffix(".json")


def read_sidecar(record: Path) -> Sidecar:
    """The sidecar of a record file; the default one where there is none, or where that JSON is of another program.

    Raises
    ------
    RecordError : it cannot be read or is damaged, or it is a record's and says something that cannot be used.
    """
    path = sidecar_path(record)
    try:
        raw = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return Sidecar()
    except OSError as error:
        raise RecordError(f"cannot be read ({error.strerror or error})", where=str(path), remedy=_AWAY) from None
    try:
        content = json_value(raw)
    except DocumentError as error:
        raise RecordError(str(error), where=str(path), remedy=_AWAY) from None
    return _sidecar_of(content, path) if isinstance(content, dict) else Sidecar()


def _sidecar_of(content: Mapping[str, Any], path: Path) -> Sidecar:
    """The content of a record's JSON, checked."""
    schema = content.get("schema")
    if not isinstance(schema, str) or not schema.startswith("flightid/"):
        ours = [key for key in ("hold", "units") if key in content]
        if ours and not isinstance(schema, str):
            what = f"it has the key {ours[0]} and no schema"
            raise RecordError(what, where=f"{path}, key schema", remedy=f'add "schema": "{SCHEMA}", or move the file away')
        return Sidecar()
    if schema != SCHEMA:
        raise RecordError(f"schema {schema!r} is not known here", where=f"{path}, key schema", remedy=f"write the record again as {SCHEMA}")
    for key in content:
        if key not in KEYS:
            raise RecordError("there is no such key", where=f"{path}, key {key!r}", remedy=closest(key, KEYS))
    name, hold, units = content.get("name"), content.get("hold", Hold.PREVIOUS.value), content.get("units", {})
    if name is not None and not isinstance(name, str):
        raise RecordError(f"{name!r} is no name", where=f"{path}, key name", remedy="write a text")
    if hold not in [kind.value for kind in Hold]:
        raise RecordError(f"hold {hold!r} is not known", where=f"{path}, key hold", remedy="write previous or linear")
    if not isinstance(units, dict) or not all(isinstance(unit, str) for unit in units.values()):
        raise RecordError("a unit is not a text", where=f"{path}, key units", remedy='write {"alpha": "rad", ...}')
    if not isinstance(content.get("origin", ""), str):
        raise RecordError("the origin is not a text", where=f"{path}, key origin", remedy=f"write {SIMULATED}, or leave it out")
    return Sidecar(name, Hold(hold), units, "hold" in content, content.get("origin") == SIMULATED, path.name)


def refuse_unknown_units(sidecar: Sidecar, header: Sequence[str], record: Path, known: Collection[str]) -> None:
    """Raise RecordError for a unit of what is neither a channel of ``known`` nor a column under ``header``."""
    for name in sidecar.units:
        if name in known or any(split_header(cell)[0] == name or suffix_unit(cell, name) for cell in header):
            continue
        where = f"{sidecar_path(record)}, key units"
        raise RecordError(f"there is no channel {name!r}", where=where, remedy=closest(name, [*known, *(cell for cell in header if cell)]))
