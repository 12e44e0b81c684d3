"""`flightid diagnose`: from records to the effect that the model lacks, printed and written."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.diagnosis.report.pictures.process import figure_process
from scenarios.plots.formats import Formats
from scenarios.terminal.progress import progress_bar

if TYPE_CHECKING:
    from scenarios.diagnosis.tracing import Tracing
    from scenarios.preparation.plan import Request


def diagnose_records(
    request: Request, out: Path | None, figures: Formats, *, progress: bool = True
) -> None:
    """Read, trace, write the study, print; ``progress`` False: nothing is shown of how far it
    is.
    """
    with (
        figure_process(bool(figures) and out is not None) as drawer,
        progress_bar(progress, counted=False) as tell,
    ):
        # Loaded while the second process already starts.
        from scenarios.diagnosis.diagnose import diagnose_files

        def outlook(likely: Tracing) -> None:
            from scenarios.diagnosis.report.pictures.pictured import pictured

            assert drawer is not None
            drawer.draw_ahead(pictured(likely), figures)

        tracing = diagnose_files(request, tell, outlook=outlook if drawer is not None else None)
        if out is not None:
            from scenarios.diagnosis.report.files import write_diagnosis

            tell("writing the study", 0.97)
            write_diagnosis(tracing, out, figures=figures, drawer=drawer)
    from scenarios.diagnosis.report.text import diagnosis_text
    from scenarios.terminal.summary import details_in, written_to
    from scenarios.terminal.tables import terminal_width

    print(diagnosis_text(tracing, terminal_width(), details_in(out)))
    stages = ", ".join(
        f"{stage} {seconds:.2f}" for stage, seconds in tracing.diagnosis.seconds.items()
    )
    if stages:
        print(f"seconds: {stages}")
    if out is not None:
        print(written_to(out))
