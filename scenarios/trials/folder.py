"""The study folder of a trial: what the loop was given, what it said, what was true."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from scenarios.diagnosis.report.files import write_diagnosis
from scenarios.diagnosis.tracing import Tracing
from scenarios.files.folders import study_folder
from scenarios.files.writing import write_json
from scenarios.pages.model import Page
from scenarios.plots.formats import Formats

MAIN = "comparison.json"


def write_trial(
    tracing: Tracing,
    given: Callable[[Path], object],
    truth: dict[str, Any],
    comparison: dict[str, Any],
    folder: str | Path,
    *,
    figures: Formats,
    dressed: Callable[[Page], Page],
) -> Path:
    """Write the diagnosis with what ``dressed`` adds to its page, what was ``given`` to the loop (records and vehicle file), the truth and
    ``comparison.json`` (last); returns the folder."""
    write_diagnosis(tracing, folder, figures=figures, dressed=dressed)
    with study_folder(folder, MAIN) as scratch:
        given(scratch)
        write_json(scratch / "truth.json", truth)
        write_json(scratch / MAIN, comparison)
    return Path(folder)
