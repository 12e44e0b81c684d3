"""`flightid report`: pages made again from what stands in their folders."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path


def rebuild_pages(folders: Sequence[Path]) -> None:
    """Make ``report.html`` of each folder again and say where it is.

    Raises FlightidError for the first folder that has no content of a page.
    """
    from scenarios.pages.folder import rebuilt

    for folder in folders:
        print(f"written to {rebuilt(folder)}")
