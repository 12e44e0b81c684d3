"""What is shown of a diagnosis whose cause nobody can name: the declared model alone; what hints
would change is no result.
"""

from __future__ import annotations

from dataclasses import replace

from ident.tracing.diagnosis import Diagnosis, ErrorFigures, Verdict
from scenarios.report.document import Table

# heading of the one column that stands where before and after do otherwise
DECLARED = "declared model"
AFTER, MOVED = "after", "moved by"
NO_AFTER = (AFTER, MOVED, "run-to-run")


def nothing_stands(d: Diagnosis) -> bool:
    """Whether no effect stands as the cause, so that there is no model after the declared one."""
    return d.verdict is Verdict.UNEXPLAINED


def shown_table(d: Diagnosis, whole: Table) -> Table:
    """A table of the diagnosis; under ``unexplained`` without the columns that a further model
    would fill.
    """
    if not nothing_stands(d):
        return whole
    kept = [at for at, each in enumerate(whole.columns) if each.heading not in NO_AFTER]
    columns = [
        replace(column, heading=DECLARED) if column.heading == "before" else column
        for column in (whole.columns[at] for at in kept)
    ]
    rows = tuple(tuple(row[at] for at in kept) for row in whole.rows)
    return replace(whole, columns=tuple(columns), rows=rows)


def as_declared(d: Diagnosis) -> Diagnosis:
    """The diagnosis as its figures show it: under ``unexplained`` residuals and predictions of the
    declared model alone, no derivatives after it.
    """
    if not nothing_stands(d):
        return d
    return replace(
        d,
        after={},
        error_after=ErrorFigures({}, {}, {}, {}),
        fitted=tuple(replace(item, after=item.before) for item in d.fitted),
        predictions=tuple(replace(item, after=item.before) for item in d.predictions),
        tests_after=(),
    )
