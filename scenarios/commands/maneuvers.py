"""`flightid maneuvers`: the maneuvers in a long record, printed and written."""

from __future__ import annotations

from pathlib import Path

from scenarios.maneuvers.finding import maneuvers_of
from scenarios.maneuvers.text import print_maneuvers
from scenarios.plots.formats import Formats
from scenarios.terminal.summary import details_in, written_to


def search_record(record: Path, channels: Path | None, columns: str | None, rate: float | None, out: Path | None, figures: Formats) -> None:
    """Read, search, write the folder, print; ``columns`` and ``rate`` (Hz) as of ``identify``."""
    from scenarios.files.channels import read_channel_map
    from scenarios.files.measured.record_file import opened, with_names
    from scenarios.preparation.plan import plan_of

    plan = plan_of(rate=rate, columns=columns)
    file = with_names(opened(record), plan.columns)
    found = maneuvers_of(file, read_channel_map(channels) if channels is not None else None, plan.rate)
    if out is not None:
        from scenarios.maneuvers.files import write_maneuvers

        write_maneuvers(found, out, figures=figures)
    print_maneuvers(found, details=details_in(out))
    if out is not None:
        print(written_to(out))
