"""`flightid check`: what the kinematics alone say of the sensors, printed and written."""

from __future__ import annotations

from pathlib import Path

from scenarios.compatibility.check import check_files
from scenarios.compatibility.text import print_check
from scenarios.plots.formats import Formats
from scenarios.preparation.request import Request
from scenarios.terminal.summary import details_in, written_to


def check_records(request: Request, out: Path | None, figures: Formats) -> None:
    """Read, check, write the study, print."""
    found = check_files(request)
    if out is not None:
        from scenarios.compatibility.files import write_check

        write_check(found, out, figures=figures)
    print_check(found, details=details_in(out))
    if out is not None:
        print(written_to(out))
