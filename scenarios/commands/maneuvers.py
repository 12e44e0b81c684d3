"""`flightid maneuvers`: the maneuvers in a long record, printed and written."""

from __future__ import annotations

from pathlib import Path

from scenarios.maneuvers.finding import maneuvers_of
from scenarios.maneuvers.text import print_maneuvers
from scenarios.plots.formats import Formats
from scenarios.preparation.plan import Plan
from scenarios.terminal.summary import details_in, written_to


def search_record(record: Path, channels: Path | None, plan: Plan, out: Path | None, figures: Formats) -> None:
    """Read, search, write the folder, print."""
    from scenarios.files.channels import read_channel_map

    found = maneuvers_of(record, read_channel_map(channels) if channels is not None else None, plan)
    if out is not None:
        from scenarios.maneuvers.files import write_maneuvers

        write_maneuvers(found, out, figures=figures)
    print_maneuvers(found, details=details_in(out))
    if out is not None:
        print(written_to(out))
