"""Reports of a comparison of studies: terminal, JSON, CSV, figures and page."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.files.sources import versions
from scenarios.files.writing import study_folder, write_json, write_text
from scenarios.plots import draw_into
from scenarios.report.document import (
    BY_ROW,
    MISSING,
    PURE,
    Bullets,
    Cell,
    Column,
    Number,
    Page,
    Table,
    as_sentence,
    estimate,
    known,
    now,
    reproduction,
    section,
    table,
)
from scenarios.report.figure_formats import USUAL, Drawn, Formats
from scenarios.report.folder import figures, write_page
from scenarios.report.quantities import console, shown_in
from scenarios.report.summary import GAP, print_paragraph
from scenarios.report.terminal import show_blocks
from scenarios.side_by_side.comparison import SideBySide, StudyColumn, StudyResponses, Value
from scenarios.side_by_side.comparison import StudyColumn as Study

if TYPE_CHECKING:
    from scenarios.plots.drawing import Named
    from scenarios.plots.side_by_side import ParameterColumn, StudyResponse


# ---- Studies side by side for programs

SCHEMA = "flightid/compared/1"
HEADINGS = (
    "parameter",
    "unit",
    "study",
    "method",
    "true",
    "condensed",
    "estimate",
    "std",
    "error_percent",
    "error_sigmas",
)
PUBLISHED = ("published", "published_std", "published_error_percent", "published_error_sigmas")


def compared_content(compared: SideBySide) -> dict[str, Any]:
    """Return the content of ``compared.json``: the studies in order, and the value of each shared
    parameter in every study.
    """
    return {
        "schema": SCHEMA,
        "studies": [_study(column) for column in compared.columns],
        "parameters": _table(compared, compared.names),
        "derived": _table(compared, compared.derived),
        "not_shared": {label: list(names) for label, names in compared.single.items()},
        "other_unit": list(compared.apart),
        "versions": versions(),
    }


def compared_csv(compared: SideBySide) -> str:
    """Return the same as CSV text, a row for each parameter and study, empty cells for missing
    values.
    """
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*HEADINGS, *PUBLISHED])
    for name in (*compared.names, *compared.derived):
        for column in compared.columns:
            value = compared.value(name, column)
            if value is None:
                continue
            printed = value.published_value
            ours = (
                value.true,
                value.condensed,
                value.estimate,
                value.std or None,
                value.percent,
                value.sigmas,
            )
            theirs = (
                (None,) * 4
                if printed is None
                else (printed.estimate, printed.std or None, printed.percent, printed.sigmas)
            )
            numbers = ["" if number is None else repr(number) for number in (*ours, *theirs)]
            writer.writerow([name, value.unit, column.label, column.estimator, *numbers])
    return text.getvalue()


def _study(column: StudyColumn) -> dict[str, Any]:
    content: dict[str, Any] = {
        "label": column.label,
        "folder": str(column.folder),
        "title": column.title,
        "outcome": column.outcome,
    }
    content |= {"method": column.estimator}
    content |= {"method_name": column.method} if column.method else {}
    return content | ({"seed": column.seed} if column.seed is not None else {})


def _table(compared: SideBySide, names: tuple[str, ...]) -> dict[str, Any]:
    return {name: {"unit": compared.unit(name), "studies": _rows(compared, name)} for name in names}


def _rows(compared: SideBySide, name: str) -> dict[str, Any]:
    result = ((column.label, compared.value(name, column)) for column in compared.columns)
    return {label: _row(value) for label, value in result if value is not None}


def _row(value: Value) -> dict[str, Any]:
    row: dict[str, Any] = {"estimate": value.estimate}
    row_ = {"std": value.std or None, "true": value.true, "condensed": value.condensed}
    row_ |= {"error_percent": value.percent, "error_sigmas": value.sigmas}
    row |= {key: number for key, number in row_.items() if number is not None}
    printed = value.published_value
    if printed is not None:
        told = {
            "std": printed.std or None,
            "error_percent": printed.percent,
            "error_sigmas": printed.sigmas,
        }
        row["published"] = {
            "value": printed.estimate,
            **{key: number for key, number in told.items() if number is not None},
        }
    return row


# ---- Which figures a comparison of studies gets

TITLE = "studies side by side"


def compared_figures(compared: SideBySide) -> Iterator[Named]:
    """Return the figures of a comparison: stem of each file and function that draws it."""
    from scenarios.plots.side_by_side import (
        figure_studies_errors,
        figure_studies_estimates,
        figure_studies_responses,
    )

    labels = [column.label for column in compared.columns]
    names = (*compared.names, *compared.derived)
    rows = {
        name: [_parameter_column(compared.value(name, column)) for column in compared.columns]
        for name in names
    }
    units = {name: compared.unit(name) for name in names}
    yield "compared_estimates", partial(figure_studies_estimates, rows, units, labels, TITLE)
    with_reference = {
        name: row
        for name, row in rows.items()
        if any(each is not None and each.reference is not None for each in row)
    }
    if with_reference:
        yield "compared_errors", partial(figure_studies_errors, with_reference, labels, TITLE)
    flown = [
        _response(column.label, column.responses)
        for column in compared.columns
        if column.responses is not None
    ]
    shared = [
        name
        for name in dict.fromkeys(name for each in flown for name in each.measured)
        if sum(name in each.measured for each in flown) > 1
    ]
    if shared:
        yield "compared_responses", partial(figure_studies_responses, flown, shared, TITLE)


def _parameter_column(value: Value | None) -> ParameterColumn | None:
    from scenarios.plots.side_by_side import ParameterColumn

    return (
        None
        if value is None
        else ParameterColumn(
            value.estimate, value.std, value.true, value.condensed, value.published
        )
    )


def _response(label: str, responses: StudyResponses) -> StudyResponse:
    from scenarios.plots.side_by_side import StudyResponse

    return StudyResponse(
        label,
        responses.time,
        responses.inputs,
        responses.measured,
        responses.predicted,
        responses.units,
        responses.simulated,
    )


# ---- The page of studies side by side: a column a study

ESTIMATES = "estimate +- sigma"
REFERENCE = "what the study's model should find: true, or condensed where it lacks modes"
ERRORS = "error in % (in standard deviations)"
PUBLISHED_ERRORS = "error of the published value in % (in its own standard deviations)"
DISAGREEING_SIGMAS = 3.0  # combined sigmas from which two studies are said to disagree


def compared_page(compared: SideBySide, figure_files: Sequence[Drawn] = ()) -> Page:
    """Return the page of a comparison with its figures."""
    labels = [column.label for column in compared.columns]
    sigmas, told = _farthest(compared)
    shared = (
        f"{len(compared.names)} parameters are estimated by at least two of {len(labels)} studies"
    )
    return Page(
        title="Studies side by side",
        kind=", ".join(labels),
        verdict="" if sigmas is None else "apart" if sigmas > DISAGREEING_SIGMAS else "alike",
        tone="plain" if sigmas is None else "fair" if sigmas > DISAGREEING_SIGMAS else "good",
        sentence=as_sentence(told) if told else "",
        summary=(as_sentence(shared), *map(as_sentence, compared.cautions)),
        warnings=tuple(
            [f"In different units, therefore not compared: {', '.join(compared.apart)}."]
            if compared.apart
            else []
        ),
        sections=(
            *section("Figures", *figures(figure_files)),
            *section("The studies", _studies(compared.columns)),
            *section("Estimates", *compared_tables(compared)),
            *section(
                "What only one has",
                Bullets(
                    tuple(
                        f"Only {label} has {', '.join(names)}."
                        for label, names in compared.single.items()
                    )
                ),
            ),
        ),
        reproduction=reproduction(
            ["flightid", "compare", *(_named(column) for column in compared.columns)]
        ),
        created=now(),
    )


def _studies(columns: Sequence[Study]) -> Table:
    headings = (
        Column("study"),
        Column("title"),
        Column("estimator"),
        Column("outcome"),
        Column("seed", "1"),
    )
    rows = tuple(
        (c.label, c.title or "–", c.estimator or "–", c.outcome, known(c.seed, 0)) for c in columns
    )
    return Table("Studies", headings, rows)


def compared_tables(compared: SideBySide) -> list[Table]:
    """Return tables of the shared parameters, a column for each study: estimates, reference values
    where they differ, errors, and published values.
    """
    names = (*compared.names, *compared.derived)
    result = [
        value for name in names for c in compared.columns if (value := compared.value(name, c))
    ]
    tables = [_table_of(compared, ESTIMATES, _estimate, true=True)]
    if any(_differs(compared, name) for name in names):
        tables.append(_table_of(compared, REFERENCE, lambda v: known(v.reference)))
    if any(value.reference is not None for value in result):
        tables.append(_table_of(compared, ERRORS, _error, PURE))
    if any(value.published is not None for value in result):
        tables.append(_table_of(compared, "published +- sigma", _published))
        tables.append(_table_of(compared, PUBLISHED_ERRORS, _published_error, PURE))
    return [each for each in tables if each.rows]


def _table_of(
    compared: SideBySide,
    caption: str,
    cell: Callable[[Value], Cell],
    unit: str = BY_ROW,
    *,
    true: bool = False,
) -> Table:
    """Return a table without empty rows and columns; ``true`` adds the true value common to all
    studies.
    """

    def told(name: str, column: StudyColumn) -> Cell:
        value = _shown(compared, name, column)
        return MISSING if value is None else cell(value)

    cells = {
        name: [told(name, column) for column in compared.columns]
        for name in (*compared.names, *compared.derived)
    }
    cells = {name: row for name, row in cells.items() if any(each != MISSING for each in row)}
    common = [known(_common(compared, name)) for name in cells]
    return table(
        caption,
        (Column("parameter"), [compared.words(name) for name in cells]),
        (Column("true", BY_ROW), common) if true and any(c != MISSING for c in common) else None,
        *(
            (Column(column.label, unit, together=True), [row[at] for row in cells.values()])
            for at, column in enumerate(compared.columns)
            if any(row[at] != MISSING for row in cells.values())
        ),
        units=[shown_in(compared.unit(name), name).unit for name in cells],
    )


def _shown(compared: SideBySide, name: str, study: StudyColumn) -> Value | None:
    """Return the value of a parameter in a study, in the unit that is shown."""
    value = compared.value(name, study)
    return value.in_unit(*shown_in(value.unit, name)) if value is not None else None


def _common(compared: SideBySide, name: str) -> float | None:
    """Return the true value if all studies that state one agree."""
    true_values = {
        value.true
        for column in compared.columns
        if (value := _shown(compared, name, column)) is not None and value.true is not None
    }
    return true_values.pop() if len(true_values) == 1 else None


def _differs(compared: SideBySide, name: str) -> bool:
    """Return whether the reference value differs between studies, or from the true one."""
    result = [
        value
        for study in compared.columns
        if (value := compared.value(name, study)) is not None and value.reference is not None
    ]
    return (
        any(value.condensed is not None for value in result)
        or len({value.reference for value in result}) > 1
    )


def _estimate(value: Value) -> Cell:
    return estimate(value.estimate, value.std)


def _error(value: Value) -> Cell:
    percent, sigmas = value.percent, value.sigmas
    parts = [f"{percent:+.2f} %"] if percent is not None else []
    parts += [f"({sigmas:+.1f})"] if sigmas is not None else []
    number = percent if percent is not None else sigmas
    return MISSING if number is None else Number(number, shown=" ".join(parts))


def _published(value: Value) -> Cell:
    if value.published is None:
        return MISSING
    printed, std = value.published
    return Number(printed, std or None, shown=f"{printed:.5g}", shown_sigma=f"{std:.4g}")


def _published_error(value: Value) -> Cell:
    printed = value.published_value
    return MISSING if printed is None else _error(printed)


def _farthest(compared: SideBySide) -> tuple[float | None, str]:
    """Return the two studies that differ most in one parameter, in combined sigmas; None without
    sigmas.
    """
    best: tuple[float, str, str, str] | None = None
    for name in compared.names:
        there = [
            (c.label, value)
            for c in compared.columns
            if (value := compared.value(name, c)) is not None and value.std > 0.0
        ]
        for (one, a), (other, b) in combinations(there, 2):
            apart = abs(a.estimate - b.estimate) / math.hypot(a.std, b.std)
            if best is None or apart > best[0]:
                best = apart, name, one, other
    if best is None:
        return None, ""
    apart, name, one, other = best
    return (
        apart,
        f"The largest difference is {name} of {one} and {other}: {apart:.1f} combined sigmas, "
        "if their records are independent",
    )


def _named(column: Study) -> str:
    return f"{column.folder}:{column.method}" if column.method else str(column.folder)


# ---- Studies side by side in the terminal

ESTIMATE_COLUMNS = 17  # terminal columns of an estimate with its sigma
FIXED_COLUMNS = 40  # terminal columns of parameter, unit and true value


def print_compared(compared: SideBySide) -> None:
    """Print the studies, then tables of estimates, errors and published values."""
    out = console()
    numbered = (
        sum(len(GAP) + max(len(column.label), ESTIMATE_COLUMNS) for column in compared.columns)
        > out.width - FIXED_COLUMNS
    )
    for place, column in enumerate(compared.columns, start=1):
        headings = [
            column.title or column.estimator,
            *([column.estimator] if column.title and column.estimator else []),
        ]
        headings += [f"seed {column.seed}"] if column.seed is not None else []
        print_paragraph(
            out,
            f"{f'{place} ' if numbered else ''}{column.label}: {', '.join(headings)}; "
            f"{column.outcome}",
            indent=0,
        )
    if numbered:
        shown = tuple(
            replace(column, label=str(n)) for n, column in enumerate(compared.columns, start=1)
        )
        singles = {
            str(n): compared.single[c.label]
            for n, c in enumerate(compared.columns, start=1)
            if c.label in compared.single
        }
        compared = replace(compared, columns=shown, single=singles)
    for caution in compared.cautions:
        print_paragraph(out, f"note: {caution}", indent=0)
    show_blocks(out, compared_tables(compared), apart=True)
    for label, single in compared.single.items():
        print_paragraph(out, f"only {label} has {', '.join(single)}", indent=0)
    if compared.apart:
        print_paragraph(
            out,
            f"in different units, therefore not compared: {', '.join(compared.apart)}",
            indent=0,
        )


# ---- A comparison of studies as files: JSON, CSV and figures

MAIN = "compared.json"  # a study's own JSON is comparison.json: what compares studies is none


def write_compared(compared: SideBySide, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write a comparison into ``folder``, completely or not at all; return the folder.

    Files: ``compared.csv``; the figures ``compared_estimates``, ``compared_errors`` if a true value
    is known and ``compared_responses`` if there are outputs over time, in the formats ``figures``;
    ``report.html`` and ``report.json``; ``compared.json`` last. The studies' own folders may be
    inside.
    """
    with study_folder(folder, MAIN) as scratch:
        write_text(scratch / "compared.csv", compared_csv(compared))
        figure_files = draw_into(scratch, compared_figures(compared), figures)
        write_page(scratch, compared_page(compared, figure_files))
        write_json(scratch / MAIN, compared_content(compared))
    return Path(folder)
