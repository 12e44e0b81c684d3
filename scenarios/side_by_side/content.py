"""Studies side by side for programs: strict JSON, and a table with a row for each study and parameter."""

from __future__ import annotations

import csv
import io
from typing import Any

from scenarios.files.versions import versions
from scenarios.side_by_side.comparison import SideBySide
from scenarios.side_by_side.value import Column, Value

SCHEMA = "flightid/compared/1"
HEADINGS = ("parameter", "unit", "study", "method", "true", "condensed", "estimate", "std", "error_percent", "error_sigmas")
PUBLISHED = ("published", "published_std", "published_error_percent", "published_error_sigmas")


def compared_content(compared: SideBySide) -> dict[str, Any]:
    """Content of ``compared.json``: the studies in order, and of each shared quantity what every study says."""
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
    """The same as a table, a row for each parameter and study; a cell is empty where there is nothing."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*HEADINGS, *PUBLISHED])
    for name in (*compared.names, *compared.derived):
        for column in compared.columns:
            value = compared.value(name, column)
            if value is None:
                continue
            printed = value.published_value
            ours = (value.true, value.condensed, value.estimate, value.std or None, value.percent, value.sigmas)
            theirs = (None,) * 4 if printed is None else (printed.estimate, printed.std or None, printed.percent, printed.sigmas)
            numbers = ["" if number is None else repr(number) for number in (*ours, *theirs)]
            writer.writerow([name, value.unit, column.label, column.estimator, *numbers])
    return text.getvalue()


def _study(column: Column) -> dict[str, Any]:
    told: dict[str, Any] = {"label": column.label, "folder": str(column.folder), "title": column.title, "outcome": column.outcome}
    told |= {"method": column.estimator}
    told |= {"method_name": column.method} if column.method else {}
    return told | ({"seed": column.seed} if column.seed is not None else {})


def _table(compared: SideBySide, names: tuple[str, ...]) -> dict[str, Any]:
    return {name: {"unit": compared.unit(name), "studies": _rows(compared, name)} for name in names}


def _rows(compared: SideBySide, name: str) -> dict[str, Any]:
    found = ((column.label, compared.value(name, column)) for column in compared.columns)
    return {label: _row(value) for label, value in found if value is not None}


def _row(value: Value) -> dict[str, Any]:
    row: dict[str, Any] = {"estimate": value.estimate}
    known = {"std": value.std or None, "true": value.true, "condensed": value.condensed}
    known |= {"error_percent": value.percent, "error_sigmas": value.sigmas}
    row |= {key: number for key, number in known.items() if number is not None}
    printed = value.published_value
    if printed is not None:
        told = {"std": printed.std or None, "error_percent": printed.percent, "error_sigmas": printed.sigmas}
        row["published"] = {"value": printed.estimate, **{key: number for key, number in told.items() if number is not None}}
    return row
