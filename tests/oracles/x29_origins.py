"""Where each number of the closed loop comes from, as its data file says."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sim.closed_loop.airframe import DATA_FILE, _document, _origin


def x29_origins(path: Path = DATA_FILE) -> dict[str, tuple[str, str]]:
    """Unit in the file and origin (in words) of every number, by dotted key such as
    ``"airframes.S.L_alpha"``.
    """
    found: dict[str, tuple[str, str]] = {}

    def walk(table: Mapping[str, Any], prefix: str) -> None:
        for key, entry in table.items():
            if isinstance(entry, dict) and "value" in entry:
                found[prefix + key] = (
                    str(entry.get("unit")),
                    _origin(entry, f"{path.name}, {prefix}{key}"),
                )
            elif isinstance(entry, dict):
                walk(entry, f"{prefix}{key}.")

    walk(_document(path), "")
    return found
