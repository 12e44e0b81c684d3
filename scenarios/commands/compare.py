"""`flightid compare`, and `flightid run --compare`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from scenarios.plots.formats import Formats


def compare_studies(studies: Sequence[str], out: Path | None, every: bool, figures: Formats) -> None:
    """Studies side by side, read from their folders: print the tables, and write them with figures where a folder is named.

    Raises
    ------
    DeclarationError : what is named is no study, or the studies share no parameter.
    """
    from scenarios.side_by_side.comparison import compare_columns
    from scenarios.side_by_side.reading import read_columns
    from scenarios.side_by_side.text import print_compared
    from scenarios.terminal.summary import written_to

    compared = compare_columns(read_columns(studies, every))
    if out is not None:
        from scenarios.side_by_side.files import write_compared

        write_compared(compared, out, figures=figures)
    print_compared(compared)
    if out is not None:
        print(written_to(out))
