"""What is shown of a diagnosis whose cause nobody can name: the declared model alone; what hints
would change is no result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ident.tracing.diagnosis import Diagnosis, ErrorFigures, Verdict

# heading of the one column that stands where before and after do otherwise
DECLARED = "declared model"
AFTER, MOVED = "after", "moved by"
NO_AFTER = (AFTER, MOVED, "run-to-run")


def nothing_stands(d: Diagnosis) -> bool:
    """Whether no effect stands as the cause, so that there is no model after the declared one."""
    return d.verdict is Verdict.UNEXPLAINED


def shown_columns(d: Diagnosis, headings: Sequence[str]) -> tuple[str, ...]:
    """Headings of a table; under ``unexplained`` without those that a further model would fill."""
    if not nothing_stands(d):
        return tuple(headings)
    return tuple(
        DECLARED if heading == "before" else heading
        for heading in headings
        if heading not in NO_AFTER
    )


def shown_rows(
    d: Diagnosis, headings: Sequence[str], cells: Sequence[Sequence[str]]
) -> list[tuple[str, ...]]:
    """Rows of the table with ``headings``, their cells of the same columns left out as in
    ``shown_columns``.
    """
    if not nothing_stands(d):
        return [tuple(row) for row in cells]
    kept = [i for i, heading in enumerate(headings) if heading not in NO_AFTER]
    return [tuple(row[i] for i in kept) for row in cells]


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
