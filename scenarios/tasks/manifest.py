"""What a folder of rows belongs to, and whether it is what is asked now."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scenarios.files.documents import read_json
from scenarios.files.versions import versions
from scenarios.files.writing import json_text, write_json
from scenarios.tasks.work import Work
from sim.errors import FlightidError

MANIFEST = "manifest.json"
SCHEMA = "flightid/tasks/1"
DECIDING = ("flightid", "numpy", "scipy", "filterpy", "control")  # versions on which the last digits hang


def manifest_of(work: Work, root: int, count: int) -> dict[str, Any]:
    """What stands in the manifest of a study: what its rows depend on, and how many there are to be."""
    identity = json.loads(json_text(dict(work.identity()), "the identity of the work"))
    return {
        "schema": SCHEMA,
        "name": work.name,
        "identity": identity,
        "root": root,
        "columns": dict(work.columns),
        "block": work.block,
        "versions": versions(),
        "count": count,
    }


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """The manifest of a folder; None where there is none. Raises FlightidError where it cannot be read."""
    path = folder / MANIFEST
    if not os.path.lexists(path):
        return None
    content: Any = read_json(path, FlightidError, "another folder")
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise FlightidError(f"this is no manifest of schema {SCHEMA}", where=str(path), remedy="begin in another folder")
    return content


def write_manifest(folder: Path, content: Mapping[str, Any]) -> None:
    """Write it whole or not at all, and down to the disk."""
    write_json(folder / MANIFEST, content)
    flush_folder(folder)


def flush_folder(folder: Path) -> None:
    """Names of files down to the disk, which a power cut else may take. Windows opens no folder, and keeps a journal of names."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def refuse_another(kept: Mapping[str, Any], asked: Mapping[str, Any], folder: Path) -> None:
    """Raise FlightidError, which tells the first difference, where rows that are kept are not those of what is asked."""
    versions_kept, versions_asked = kept.get("versions", {}), asked["versions"]
    pairs = [(key, kept.get(key), asked[key]) for key in ("name", "root", "identity", "columns", "block")]
    pairs += [(f"version of {name}", versions_kept.get(name), versions_asked.get(name)) for name in DECIDING]
    for key, old, new in pairs:
        found = _difference("seed" if key == "root" else key, old, new)
        if found:
            raise FlightidError(f"what is kept here is another study: {found}", where=str(folder), remedy="ask for the same, or name another folder")


def _difference(place: str, old: Any, new: Any) -> str:
    """The first difference of two JSON values in words; empty where they are equal."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted({*old, *new}):
            found = _difference(f"{place}.{key}".removeprefix("identity."), old.get(key), new.get(key))
            if found:
                return found
        return ""
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        return next((found for at, (a, b) in enumerate(zip(old, new, strict=True)) if (found := _difference(f"{place}[{at}]", a, b))), "")
    return "" if type(old) is type(new) and old == new else f"{place} was {_shown(old)} and now is {_shown(new)}"


def _shown(value: Any) -> str:
    text = "nothing" if value is None else json.dumps(value, ensure_ascii=False)
    return text if len(text) < 80 else f"{text[:77]}..."
