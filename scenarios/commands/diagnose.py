"""`flightid diagnose`: from records to the effect that the model lacks, printed and written."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.report.figure_formats import Formats
from scenarios.report.progress import progress_bar

if TYPE_CHECKING:
    from scenarios.preparation.plan import Request


def diagnose_records(
    request: Request, out: Path | None, figures: Formats, *, progress: bool = True
) -> None:
    """Read, trace, write the study, print; ``progress`` False: nothing is shown of how far it
    is.
    """
    with progress_bar(progress, counted=False) as tell:
        from scenarios.diagnosis.diagnose import diagnose_files

        tracing = diagnose_files(request, tell)
        if out is not None:
            from scenarios.diagnosis.report.files import write_diagnosis

            tell("writing the study", 0.97)
            write_diagnosis(tracing, out, figures=figures)
    from scenarios.diagnosis.report.text import diagnosis_text
    from scenarios.report.summary import details_in, written_to
    from scenarios.report.text_tables import terminal_width

    print(diagnosis_text(tracing, terminal_width(), details_in(out)))
    if out is not None:
        print(written_to(out))
