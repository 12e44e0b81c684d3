"""`flightid design`: which maneuver to fly, printed and written."""

from __future__ import annotations

from pathlib import Path

from scenarios.maneuver_design.asked import Asked
from scenarios.plots.formats import Formats
from scenarios.terminal.progress import progress_bar


def design_maneuver(asked: Asked, out: Path | None, figures: Formats, *, progress: bool = True) -> None:
    """Design, write, print; ``progress`` False: nothing is shown of how far it is."""
    from scenarios.maneuver_design.design import design
    from scenarios.maneuver_design.text import design_text
    from scenarios.terminal.paragraphs import terminal_width
    from scenarios.terminal.summary import details_in, written_to

    with progress_bar(progress) as tell:
        found = design(asked, tell)
        if out is not None:
            from scenarios.maneuver_design.files import write_design

            write_design(found, out, figures=figures)
    print(design_text(found, terminal_width(), details_in(out)), end="")
    if out is not None:
        print(written_to(out))
