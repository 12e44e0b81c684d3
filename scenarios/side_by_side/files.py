"""A comparison of studies as files: JSON, CSV and figures."""

from __future__ import annotations

from pathlib import Path

from scenarios.files.folders import study_folder
from scenarios.files.writing import write_json
from scenarios.pages.folder import write_page
from scenarios.plots.formats import USUAL, Formats
from scenarios.plots.page.named import Drawn
from scenarios.side_by_side.comparison import SideBySide
from scenarios.side_by_side.content import compared_content, compared_csv
from scenarios.side_by_side.page import compared_page

MAIN = "compared.json"  # a study's own JSON is comparison.json: what compares studies is none


def write_compared(compared: SideBySide, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write a comparison into ``folder``, whole or not at all; returns the folder.

    Files: ``compared.csv``, in the formats ``figures`` the figures ``compared_estimates``, ``compared_errors`` where some truth is known
    and ``compared_responses`` where outputs over time are; ``report.html`` and ``report.json``; ``compared.json``
    last. The folder may hold the studies' own folders.
    """
    with study_folder(folder, MAIN) as scratch:
        (scratch / "compared.csv").write_text(compared_csv(compared), encoding="utf-8", errors="backslashreplace", newline="\n")
        drawn: tuple[Drawn, ...] = ()
        if figures:
            from scenarios.plots.page.drawing import drawn_for_page
            from scenarios.side_by_side.figures import compared_figures

            drawn = drawn_for_page(compared_figures(compared), scratch, figures)
        write_page(scratch, compared_page(compared, drawn))
        write_json(scratch / MAIN, compared_content(compared))
    return Path(folder)
