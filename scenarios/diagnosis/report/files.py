"""The study folder of a diagnosis: JSON, predictions, residuals, evidence, figures and a report to
read.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from ident.tracing.diagnosis import Candidate, FittedRecord, Prediction, Quantity
from scenarios.diagnosis.keeping import kept_diagnosis
from scenarios.diagnosis.report.content import DECIDES, bounded, diagnosis_content
from scenarios.diagnosis.report.declared_only import nothing_stands
from scenarios.diagnosis.report.figures import bounded_series, draw_diagnosis, numbered, pictured
from scenarios.diagnosis.tracing import Tracing
from scenarios.files.writing import study_folder, write_json
from scenarios.kept import write_kept
from scenarios.report.document import Page, now
from scenarios.report.figure_formats import USUAL, Drawn, Formats
from scenarios.report.folder import write_page
from scenarios.report.quantities import UNDETERMINED, determined

MAIN = "diagnosis.json"


def _as_it_is(page: Page) -> Page:
    return page


def write_diagnosis(
    tracing: Tracing,
    folder: str | Path,
    *,
    figures: Formats = USUAL,
    dressed: Callable[[Page], Page] = _as_it_is,
) -> Path:
    """Write a diagnosis into ``folder``, whole or not at all; returns the folder.

    Files: ``validate_prediction.csv`` (further records ``validate_prediction_2.csv`` ...),
    ``residuals.csv`` (likewise), ``evidence.csv``, ``decides.csv`` of an ambiguous one, figures in
    the formats ``figures``, ``report.html`` and ``report.json``, ``diagnosis.json`` last.
    ``dressed`` adds to the page what else is known.
    """
    from scenarios.diagnosis.report.page import diagnosis_page

    d, created = tracing.diagnosis, now()
    with study_folder(folder, MAIN) as scratch:
        drawn: tuple[Drawn, ...] = ()
        if figures:
            drawn = draw_diagnosis(pictured(tracing), scratch, figures, declared=nothing_stands(d))
        for number, prediction in enumerate(d.predictions):
            write_prediction(scratch / f"{numbered('validate_prediction', number)}.csv", prediction)
        for number, fitted in enumerate(d.fitted):
            write_residuals(scratch / f"{numbered('residuals', number)}.csv", fitted)
        write_evidence(scratch / "evidence.csv", d.candidates)
        content = diagnosis_content(tracing, created)
        write_page(scratch, dressed(diagnosis_page(tracing, content["warnings"], drawn, created)))
        kept = kept_diagnosis(tracing)
        if kept is not None:
            write_kept(scratch, kept)
        if tracing.decides is not None:
            from scenarios.maneuver_design.report import write_maneuver

            write_maneuver(scratch, tracing.decides.best, Path(DECIDES).stem)
        write_json(scratch / MAIN, content)
    return Path(folder)


def write_prediction(path: Path, prediction: Prediction) -> None:
    """One row for each row of the record, missing samples included: ``time``, ``before_CHANNEL``,
    ``after_CHANNEL``, SI (nz in g).
    """
    header = [
        "time",
        *(f"{when}_{name}" for when in ("before", "after") for name in prediction.channels),
    ]
    rows = np.concatenate(
        [
            prediction.record.time[None, :],
            bounded_series(prediction.before),
            bounded_series(prediction.after),
        ]
    )
    _write(path, header, ([repr(cell) for cell in row] for row in rows.T.tolist()))


def write_residuals(path: Path, fitted: FittedRecord) -> None:
    """Residuals of a fitted record, measured minus simulated: ``time``, then ``before_CHANNEL
    after_CHANNEL used_CHANNEL``.

    Cells of a missing sample are empty; ``used`` is 0 where a sample is missing or was set aside.
    """
    header, columns = ["time"], [[repr(value) for value in fitted.record.time.tolist()]]
    for row, name in enumerate(fitted.channels):
        if name not in fitted.record.output_names:
            continue
        valid = fitted.record[name].valid
        header += [f"before_{name}", f"after_{name}", f"used_{name}"]
        for residual in (fitted.before[row], fitted.after[row]):
            columns.append(
                [
                    repr(value) if there else ""
                    for value, there in zip(bounded_series(residual).tolist(), valid, strict=True)
                ]
            )
        columns.append(["1" if used else "0" for used in (fitted.used[row] & valid).tolist()])
    _write(path, header, zip(*columns, strict=True))


def write_evidence(path: Path, candidates: Sequence[Candidate]) -> None:
    """Every candidate of every round, one row each; parameters of those that were fitted."""
    header = ["round", "within", "name", "gain", "weight", "fitted", "collinear_with", "parameters"]
    rows = []
    for c in candidates:
        parameters = "; ".join(_cell(name, q) for name, q in c.parameters.items())
        numbers = [repr(bounded(c.gain)), repr(bounded(c.weight)), str(int(c.fitted))]
        rows.append(
            [
                str(c.round),
                " ".join(c.within),
                c.name,
                *numbers,
                " ".join(c.collinear_with),
                parameters,
            ]
        )
    _write(path, header, rows)


def _cell(name: str, q: Quantity) -> str:
    told = f"{q.value:.6g} +- {q.std:.2g} {q.unit}" if determined(q.value, q.std) else UNDETERMINED
    return f"{name} = {told}"


def _write(path: Path, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    path.write_text(text.getvalue(), encoding="utf-8", newline="\n")
