"""`flightid report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def report(
    folders: Annotated[list[Path], typer.Argument(metavar="DIR...", help="Folders that --out was given.")],
) -> None:
    """The page of a study again, from its folder, without computing anything."""
    from scenarios.commands.report import rebuild_pages

    rebuild_pages(folders)
