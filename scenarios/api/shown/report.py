"""The page of a result alone, one HTML file that holds its figures."""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from scenarios.terminal.summary import PAGE
from sim.errors import DeclarationError


def write_report(save: Callable[[Path], Any], path: str | PathLike[str]) -> Path:
    """Write the page that ``save`` puts into a study's folder; returns the path. Raises DeclarationError where it puts none there."""
    with TemporaryDirectory(prefix="flightid-") as scratch:
        folder = Path(scratch) / "study"
        save(folder)
        if not (folder / PAGE).is_file():
            raise DeclarationError("a study of this kind has no page", where="report", remedy="save(FOLDER) writes its files")
        page = (folder / PAGE).read_bytes()
    Path(path).write_bytes(page)
    return Path(path)
