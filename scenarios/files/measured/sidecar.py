"""The JSON beside a record: name, hold of the inputs and units, which a CSV file cannot carry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from scenarios.files.documents import json_value
from sim.errors import RecordError
from sim.record import Hold

SCHEMA = "flightid/record/1"
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
    """

    name: str | None = None
    hold: Hold = Hold.PREVIOUS
    units: Mapping[str, str] = field(default_factory=dict)
    says_hold: bool = False
    simulated: bool = False


def sidecar_path(record: Path) -> Path:
    """``record.json`` beside ``record.csv`` or ``record.csv.gz``."""
    plain = record.with_suffix("") if record.suffix.lower() == ".gz" else record
    return plain.with_suffix(".json")


def read_sidecar(record: Path) -> Sidecar:
    """The sidecar of a record file; the default one where there is none, or where that JSON is no record's.

    Raises
    ------
    RecordError : it is a record's and says something that cannot be used.
    """
    path = sidecar_path(record)
    try:
        content = json_value(path.read_bytes())
    except (OSError, ValueError):
        return Sidecar()
    schema = content.get("schema") if isinstance(content, dict) else None
    if not isinstance(schema, str) or not schema.startswith("flightid/record/"):
        return Sidecar()
    if schema != SCHEMA:
        raise RecordError(f"schema {schema!r} is not known here", where=f"{path}, key schema", remedy=f"write the record again as {SCHEMA}")
    name, hold, units = content.get("name"), content.get("hold", Hold.PREVIOUS.value), content.get("units", {})
    if name is not None and not isinstance(name, str):
        raise RecordError(f"{name!r} is no name", where=f"{path}, key name", remedy="write a text")
    if hold not in [kind.value for kind in Hold]:
        raise RecordError(f"hold {hold!r} is not known", where=f"{path}, key hold", remedy="write previous or linear")
    if not isinstance(units, dict) or not all(isinstance(unit, str) for unit in units.values()):
        raise RecordError("a unit is not a text", where=f"{path}, key units", remedy='write {"alpha": "rad", ...}')
    return Sidecar(name, Hold(hold), units, "hold" in content, content.get("origin") == SIMULATED)
