"""A comparison of studies as files: JSON, CSV and figures."""

from __future__ import annotations

from pathlib import Path

from scenarios.files.folders import study_folder
from scenarios.files.writing import write_json
from scenarios.side_by_side.comparison import SideBySide
from scenarios.side_by_side.content import compared_content, compared_csv

MAIN = "compared.json"  # a study's own JSON is comparison.json: what compares studies is none


def write_compared(compared: SideBySide, folder: str | Path, *, figures: bool = True) -> Path:
    """Write a comparison into ``folder``, whole or not at all; returns the folder.

    Files: ``compared.csv``, with figures ``compared_estimates.png``, ``compared_errors.png`` where some truth is known and
    ``compared_responses.png`` where outputs over time are; ``compared.json`` last. The folder may hold the studies' own folders.
    """
    with study_folder(folder, MAIN) as scratch:
        (scratch / "compared.csv").write_text(compared_csv(compared), encoding="utf-8")
        if figures:
            from scenarios.side_by_side.figures import draw_compared

            draw_compared(compared, scratch)
        write_json(scratch / MAIN, compared_content(compared))
    return Path(folder)
