"""Reports of a comparison of studies: terminal, JSON, CSV, figures and page."""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.files.sources import versions
from scenarios.files.writing import study_folder, write_json, write_text
from scenarios.plots import draw_into
from scenarios.plots.display import StudyValue
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
from scenarios.side_by_side import SideBySide, StudyColumn

if TYPE_CHECKING:
    from scenarios.plots.drawing import Named


# ---- JSON and CSV

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
    """Return the content of ``compared.json``: studies, and shared parameters in each of them."""
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
    """Return a comparison as CSV, a row for each parameter and study; missing values are empty."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*HEADINGS, *PUBLISHED])
    for name in (*compared.names, *compared.derived):
        for column in compared.columns:
            value = compared.value(name, column)
            if value is None:
                continue
            numbers = [value.true, value.condensed]
            for result in (value, value.published_value):
                if result is None:
                    numbers += [None] * 4
                else:
                    numbers += [result.estimate, result.std or None, result.percent, result.sigmas]
            cells = ("" if number is None else repr(number) for number in numbers)
            writer.writerow([name, value.unit, column.label, column.estimator, *cells])
    return text.getvalue()


def _study(column: StudyColumn) -> dict[str, Any]:
    return {
        "label": column.label,
        "folder": str(column.folder),
        "title": column.title,
        "outcome": column.outcome,
        "method": column.estimator,
        **({"method_name": column.method} if column.method else {}),
        **({"seed": column.seed} if column.seed is not None else {}),
    }


def _table(compared: SideBySide, names: tuple[str, ...]) -> dict[str, Any]:
    return {
        name: {
            "unit": compared.unit(name),
            "studies": {
                column.label: _row(value)
                for column in compared.columns
                if (value := compared.value(name, column)) is not None
            },
        }
        for name in names
    }


def _row(value: StudyValue) -> dict[str, Any]:
    errors = {"error_percent": value.percent, "error_sigmas": value.sigmas}
    row: dict[str, Any] = {"estimate": value.estimate} | _known(
        {"std": value.std or None, "true": value.true, "condensed": value.condensed, **errors}
    )
    published = value.published_value
    if published is not None:
        errors = {"error_percent": published.percent, "error_sigmas": published.sigmas}
        row["published"] = {"value": published.estimate} | _known(
            {"std": published.std or None, **errors}
        )
    return row


def _known(numbers: dict[str, float | None]) -> dict[str, float]:
    return {name: number for name, number in numbers.items() if number is not None}


# ---- Figures of a comparison

TITLE = "studies side by side"


def compared_figures(compared: SideBySide) -> Iterator[Named]:
    """Return the figures of a comparison: stem of each file and function that draws it."""
    from scenarios.plots.comparisons import (
        figure_studies_errors,
        figure_studies_estimates,
        figure_studies_responses,
    )

    labels = [column.label for column in compared.columns]
    names = (*compared.names, *compared.derived)
    rows = {name: [compared.value(name, column) for column in compared.columns] for name in names}
    units = {name: compared.unit(name) for name in names}
    yield "compared_estimates", partial(figure_studies_estimates, rows, units, labels, TITLE)
    with_reference = {
        name: row
        for name, row in rows.items()
        if any(value is not None and value.reference is not None for value in row)
    }
    if with_reference:
        yield "compared_errors", partial(figure_studies_errors, with_reference, labels, TITLE)
    responses = {
        column.label: column.responses
        for column in compared.columns
        if column.responses is not None
    }
    measured = Counter(name for study in responses.values() for name in study.measured)
    shared = [name for name, studies in measured.items() if studies > 1]
    if shared:
        yield "compared_responses", partial(figure_studies_responses, responses, shared, TITLE)


# ---- Page of a comparison: a column for each study

ESTIMATES = "estimate +- sigma"
REFERENCE = "what the study's model should find: true, or condensed where it lacks modes"
ERRORS = "error in % (in standard deviations)"
PUBLISHED_ERRORS = "error of the published value in % (in its own standard deviations)"
DISAGREEING_SIGMAS = 3.0  # combined sigmas from which two studies are said to disagree


def compared_page(compared: SideBySide, figure_files: Sequence[Drawn] = ()) -> Page:
    """Return the page of a comparison with its figures."""
    labels = [column.label for column in compared.columns]
    sigmas, largest = _largest_difference(compared)
    shared = (
        f"{len(compared.names)} parameters are estimated by at least two of {len(labels)} studies"
    )
    return Page(
        title="Studies side by side",
        kind=", ".join(labels),
        verdict="" if sigmas is None else "apart" if sigmas > DISAGREEING_SIGMAS else "alike",
        tone="plain" if sigmas is None else "fair" if sigmas > DISAGREEING_SIGMAS else "good",
        sentence=as_sentence(largest) if largest else "",
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
            ["flightid", "compare", *(_argument(column) for column in compared.columns)]
        ),
        created=now(),
    )


def _studies(columns: Sequence[StudyColumn]) -> Table:
    headings = (
        Column("study"),
        Column("title"),
        Column("estimator"),
        Column("outcome"),
        Column("seed", "1"),
    )
    rows = tuple(
        (
            column.label,
            column.title or "–",
            column.estimator or "–",
            column.outcome,
            known(column.seed, 0),
        )
        for column in columns
    )
    return Table("Studies", headings, rows)


def compared_tables(compared: SideBySide) -> list[Table]:
    """Return tables of the shared parameters, a column for each study.

    They have estimates, reference values if they differ, errors, and published values.
    """
    names = (*compared.names, *compared.derived)
    values = [
        value
        for name in names
        for column in compared.columns
        if (value := compared.value(name, column))
    ]
    tables = [
        _table_of(compared, ESTIMATES, lambda value: estimate(value.estimate, value.std), true=True)
    ]
    if any(_differs(compared, name) for name in names):
        tables.append(_table_of(compared, REFERENCE, lambda value: known(value.reference)))
    if any(value.reference is not None for value in values):
        tables.append(_table_of(compared, ERRORS, _error, PURE))
    if any(value.published is not None for value in values):
        tables.append(_table_of(compared, "published +- sigma", _published))
        tables.append(_table_of(compared, PUBLISHED_ERRORS, _published_error, PURE))
    return [each for each in tables if each.rows]


def _table_of(
    compared: SideBySide,
    caption: str,
    cell: Callable[[StudyValue], Cell],
    unit: str = BY_ROW,
    *,
    true: bool = False,
) -> Table:
    """Return a table without empty rows and columns.

    Parameters
    ----------
    cell : returns the cell of a value.
    unit : unit of the columns.
    true : whether the true values have a column.
    """
    cells: dict[str, list[Cell]] = {}
    for name in (*compared.names, *compared.derived):
        values = (_shown(compared, name, column) for column in compared.columns)
        row = [MISSING if value is None else cell(value) for value in values]
        if any(entry != MISSING for entry in row):
            cells[name] = row
    true_cells = [known(_common(compared, name)) for name in cells]
    return table(
        caption,
        (Column("parameter"), [compared.words(name) for name in cells]),
        (Column("true", BY_ROW), true_cells)
        if true and any(entry != MISSING for entry in true_cells)
        else None,
        *(
            (Column(column.label, unit, together=True), list(entries))
            for column, entries in zip(
                compared.columns, zip(*cells.values(), strict=True), strict=False
            )
            if any(entry != MISSING for entry in entries)
        ),
        units=[shown_in(compared.unit(name), name).unit for name in cells],
    )


def _shown(compared: SideBySide, name: str, study: StudyColumn) -> StudyValue | None:
    value = compared.value(name, study)
    return value.in_unit(*shown_in(value.unit, name)) if value is not None else None


def _common(compared: SideBySide, name: str) -> float | None:
    """Return the true value of a parameter if all studies that have one agree."""
    true_values = {
        value.true
        for column in compared.columns
        if (value := _shown(compared, name, column)) is not None and value.true is not None
    }
    return true_values.pop() if len(true_values) == 1 else None


def _differs(compared: SideBySide, name: str) -> bool:
    """Return whether the reference value differs between studies, or from the true one."""
    values = [
        value
        for study in compared.columns
        if (value := compared.value(name, study)) is not None and value.reference is not None
    ]
    return (
        any(value.condensed is not None for value in values)
        or len({value.reference for value in values}) > 1
    )


def _error(value: StudyValue) -> Cell:
    percent, sigmas = value.percent, value.sigmas
    parts = [f"{percent:+.2f} %"] if percent is not None else []
    parts += [f"({sigmas:+.1f})"] if sigmas is not None else []
    number = percent if percent is not None else sigmas
    return MISSING if number is None else Number(number, shown=" ".join(parts))


def _published(value: StudyValue) -> Cell:
    if value.published is None:
        return MISSING
    printed, std = value.published
    return Number(printed, std or None, shown=f"{printed:.5g}", shown_sigma=f"{std:.4g}")


def _published_error(value: StudyValue) -> Cell:
    published = value.published_value
    return MISSING if published is None else _error(published)


def _largest_difference(compared: SideBySide) -> tuple[float | None, str]:
    """Return the largest difference of a parameter between two studies, and a sentence on it.

    The difference is in combined sigmas; None if no two studies have sigmas of one parameter.
    """
    differences = []
    for name in compared.names:
        estimates = [
            (column.label, value)
            for column in compared.columns
            if (value := compared.value(name, column)) is not None and value.std > 0.0
        ]
        for (first, a), (second, b) in combinations(estimates, 2):
            sigmas = abs(a.estimate - b.estimate) / math.hypot(a.std, b.std)
            differences.append((sigmas, name, first, second))
    if not differences:
        return None, ""
    sigmas, name, first, second = max(differences, key=itemgetter(0))
    return (
        sigmas,
        f"The largest difference is {name} of {first} and {second}: {sigmas:.1f} combined sigmas, "
        "if their records are independent",
    )


def _argument(column: StudyColumn) -> str:
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


# ---- Folder of a comparison

MAIN = "compared.json"  # not comparison.json, which marks the folder of a study


def write_compared(compared: SideBySide, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write a comparison into ``folder``, completely or not at all; return the folder.

    The files are ``compared.csv``; the figures ``compared_estimates``, ``compared_errors`` (if a
    true value is known) and ``compared_responses`` (if there are outputs over time), in the formats
    ``figures``; ``report.html``, ``report.json`` and ``compared.json``. Folders of studies in
    ``folder`` are kept.
    """
    with study_folder(folder, MAIN) as scratch:
        write_text(scratch / "compared.csv", compared_csv(compared))
        figure_files = draw_into(scratch, compared_figures(compared), figures)
        write_page(scratch, compared_page(compared, figure_files))
        write_json(scratch / MAIN, compared_content(compared))
    return Path(folder)
