"""`flightid survey`: all flights of a test campaign, printed and written."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from scenarios.plots.formats import Formats
from scenarios.terminal.progress import progress_bar


def survey_records(file: Path, out: Path | None, jobs: int | None, figures: Formats, *, progress: bool = True, cluster: str | None = None) -> None:
    """Read, diagnose what is new, pool, write, print; ``progress`` False: nothing is shown of how far it is. ``cluster`` : a Dask address."""
    from scenarios.survey.report.text import survey_text
    from scenarios.survey.survey import survey_flights
    from scenarios.tasks.sharing import available_cores
    from scenarios.terminal.paragraphs import terminal_width
    from scenarios.terminal.summary import details_in, written_to

    with TemporaryDirectory(prefix="flightid-") as passing:
        folder = out if out is not None else Path(passing) / "survey"
        with progress_bar(progress) as tell:
            try:
                found = survey_flights(file, folder, jobs or available_cores(), figures if out is not None else (), tell, cluster)
            except KeyboardInterrupt as stopped:
                if out is not None:
                    raise
                raise KeyboardInterrupt("nothing is kept without --out") from stopped
            if out is not None:
                from scenarios.survey.report.files import write_survey

                tell("writing the survey", 0.98)
                write_survey(found, out, figures=figures)
    print(survey_text(found, terminal_width(), details_in(out)), end="")
    if out is not None:
        print(written_to(out))
