"""The folder of a survey: its document, derivatives, figures and page beside the folders of its flights."""

from __future__ import annotations

from pathlib import Path

from scenarios.files.folders import study_folder
from scenarios.files.writing import write_json, write_text
from scenarios.pages.folder import write_page
from scenarios.pages.reproduction import now
from scenarios.plots.formats import USUAL, Formats
from scenarios.plots.page.named import Drawn
from scenarios.survey.growing import MAIN
from scenarios.survey.one_flight import FOLDER
from scenarios.survey.report.content import derivatives_text, survey_content
from scenarios.survey.report.page import survey_page
from scenarios.survey.survey import Survey


def write_survey(survey: Survey, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write ``derivatives.csv``, figures, the page and ``survey.json``, whole or not at all; the folder. ``flights/`` is left as it is."""
    with study_folder(folder, MAIN) as scratch:
        write_text(scratch / "derivatives.csv", derivatives_text(survey))
        drawn: tuple[Drawn, ...] = ()
        if figures:
            from scenarios.plots.page.drawing import drawn_for_page
            from scenarios.survey.report.figures import survey_figures

            drawn = drawn_for_page(survey_figures(survey), scratch, figures)
        linked = [name for name in survey.grown.kept if (Path(folder) / FOLDER / name / "report.html").is_file()]
        write_page(scratch, survey_page(survey, drawn, linked))
        write_json(scratch / MAIN, survey_content(survey, now()))
    return Path(folder)
