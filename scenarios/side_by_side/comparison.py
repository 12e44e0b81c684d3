"""Read studies from their folders and arrange their estimates in columns."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.declarations import CHANNEL_UNITS, TIME
from scenarios.files.measured.columns import SIMULATED as SIMULATED_ORIGIN
from scenarios.files.sources import json_or_none, read_json, resolved
from scenarios.files.writing import PREDICTED, RESPONSE, TRUE
from sim.errors import DeclarationError
from sim.vehicles.factory import (
    BALLISTIC_DERIVATIVES,
    LOES_DERIVATIVES,
    LOES_OFFSETS,
    RIGID_DERIVATIVES,
    WHOLE_AXES,
    mode_units,
)

# ---- Measured, predicted and noise-free outputs over time, read back from a study folder

SIMULATION = "simulation"  # file of a closed-loop scenario's outputs
SIMULATED = "simulated_"  # prefix of simulated outputs


@dataclass(frozen=True, eq=False)
class StudyResponses:
    """Outputs of one study over ``time (N,)``, s: ``(N,)`` each, SI, by name, NaN if missing.

    ``predicted``: of the estimate; ``true``: empty if unknown. ``units`` of the channels;
    ``simulated``: whether the record is simulated.
    """

    time: np.ndarray
    inputs: Mapping[str, np.ndarray]
    measured: Mapping[str, np.ndarray]
    predicted: Mapping[str, np.ndarray]
    true: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    simulated: bool = False


def read_responses(folder: Path, method: str = "") -> StudyResponses | None:
    """Return the responses of a study's main method or of a named one; None if there are none."""
    stems = (f"{RESPONSE}_{method}",) if method else (RESPONSE, SIMULATION)
    path = next(
        (folder / f"{stem}.csv" for stem in stems if (folder / f"{stem}.csv").is_file()), None
    )
    table = _columns(path) if path is not None else {}
    if TIME not in table:
        return None
    predicted = {
        name.removeprefix(mark): row
        for mark in (PREDICTED, SIMULATED)
        for name, row in table.items()
        if name.startswith(mark)
    }
    true = {name.removeprefix(TRUE): row for name, row in table.items() if name.startswith(TRUE)}
    measured = {name: table[name] for name in predicted if name in table}
    others = (
        name
        for name in table
        if not name.startswith((PREDICTED, SIMULATED, TRUE)) and name not in (TIME, *measured)
    )
    inputs = {name: table[name] for name in others}
    return StudyResponses(
        table[TIME],
        inputs,
        measured,
        {name: predicted[name] for name in measured},
        true,
        *_channel_units(folder),
    )


def _channel_units(folder: Path) -> tuple[dict[str, str], bool]:
    """Return the units of the channels, from the folder's record if it states them, and whether
    that record is simulated.
    """
    result = json_or_none(folder / "record.json")
    content = result if isinstance(result, dict) else {}
    units = content.get("units", {})
    units_by_name = (
        {name: str(unit) for name, unit in units.items()} if isinstance(units, dict) else {}
    )
    return {**CHANNEL_UNITS, **units_by_name}, content.get("origin") == SIMULATED_ORIGIN or (
        folder / "truth.json"
    ).is_file()


def _columns(path: Path) -> dict[str, np.ndarray]:
    """Return columns of numbers by heading (NaN: empty cell); empty for any other file."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            head, *rows = list(csv.reader(file))
        values = np.array(
            [[float(cell) if cell else math.nan for cell in row] for row in rows], dtype=float
        )
    except (OSError, ValueError):
        return {}
    return (
        dict(zip(head, values.T, strict=True))
        if values.ndim == 2 and values.shape[1] == len(head)
        else {}
    )


# ---- One parameter of one study, and a study as a column of a comparison


@dataclass(frozen=True)
class Value:
    """Estimate of one parameter in one study, all numbers in ``unit``.

    ``std``: 0 if not stated. ``condensed``: reference value of a model that lacks modes of the
    aircraft. ``published``: with a standard deviation of 0 if none is printed.
    """

    estimate: float
    std: float
    unit: str
    true: float | None = None
    condensed: float | None = None
    published: tuple[float, float] | None = None

    @property
    def reference(self) -> float | None:
        """Reference value of the error: the condensed value if there is one, else the true one."""
        return self.true if self.condensed is None else self.condensed

    @property
    def percent(self) -> float | None:
        """Error in per cent of the reference; None without a reference or if it is zero."""
        return (
            None
            if not self.reference
            else 100.0 * (self.estimate - self.reference) / abs(self.reference)
        )

    @property
    def sigmas(self) -> float | None:
        """Error in standard deviations of the estimate; None without reference or deviation."""
        return (
            None
            if self.reference is None or not self.std > 0.0
            else (self.estimate - self.reference) / self.std
        )

    def in_unit(self, factor: float, unit: str) -> Value:
        """Return all numbers times ``factor``, in another ``unit``."""
        true, condensed = (
            factor * each if each is not None else None for each in (self.true, self.condensed)
        )
        published = (
            (factor * self.published[0], factor * self.published[1])
            if self.published is not None
            else None
        )
        return Value(factor * self.estimate, factor * self.std, unit, true, condensed, published)

    @property
    def published_value(self) -> Value | None:
        """The published number as a value with the same reference."""
        return (
            None
            if self.published is None
            else replace(self, estimate=self.published[0], std=self.published[1], published=None)
        )


@dataclass(frozen=True, eq=False)
class StudyColumn:
    """One method of one study.

    Attributes
    ----------
    label : unique name in a comparison.
    folder, method : of the study; ``method`` is empty for the main one.
    title : of the study.
    estimator : name of the estimator in the study.
    outcome : code of the estimate, or the verdict.
    seed : None for a measured record.
    values, derived : parameters and derived quantities by name.
    responses : outputs over time; None if the folder has none.
    vehicle, model : names in the study; empty if it has none.
    """

    label: str
    folder: Path
    method: str
    title: str
    estimator: str
    outcome: str
    seed: int | None
    values: Mapping[str, Value]
    derived: Mapping[str, Value]
    responses: StudyResponses | None = None
    vehicle: str = ""
    model: str = ""


# ---- Common parameters of studies, their order and units

MOST_ORDERED_MODES = 9  # elastic modes that are sorted
FEWEST_STUDIES = 2


@dataclass(frozen=True, eq=False)
class SideBySide:
    """Several studies, parameter by parameter.

    ``names``: parameters that at least two studies estimate, in the order of the equations;
    ``units`` of these; ``derived``: derived quantities likewise; ``single``: parameters that only
    one study estimates, by label of its column; ``apart``: names with different units in different
    studies, which are not compared.
    """

    columns: tuple[StudyColumn, ...]
    names: tuple[str, ...]
    derived: tuple[str, ...]
    single: dict[str, tuple[str, ...]]
    apart: tuple[str, ...]

    def value(self, name: str, column: StudyColumn) -> Value | None:
        """Return the value of a parameter or derived quantity in a column; None if missing."""
        return column.values.get(name) if name in self.names else column.derived.get(name)

    @property
    def cautions(self) -> list[str]:
        """Sentences on studies that are of different vehicles or models."""
        sentences = []
        for what, names, why in (
            ("vehicles", [c.vehicle for c in self.columns], "their parameters need not agree"),
            (
                "models",
                [c.model for c in self.columns],
                "a parameter of one name may be defined differently",
            ),
        ):
            if len({name for name in names if name}) > 1:
                each = ", ".join(
                    f"{column.label} of {name}"
                    for column, name in zip(self.columns, names, strict=True)
                    if name
                )
                sentences.append(f"studies of different {what} ({each}): {why}")
        return sentences

    def words(self, name: str) -> str:
        """Return the heading of a row: name of a parameter, words for a derived quantity."""
        return name if name in self.names else name.replace("_", " ")

    def unit(self, name: str) -> str:
        """Return the unit of a parameter or derived quantity."""
        return next(
            value.unit for column in self.columns if (value := self.value(name, column)) is not None
        )


def compare_columns(columns: Sequence[StudyColumn]) -> SideBySide:
    """Compare columns parameter by parameter.

    Raises
    ------
    DeclarationError : fewer than two of them, or no parameter that two of them estimate.
    """
    if len(columns) < FEWEST_STUDIES:
        raise DeclarationError(
            "one study has nothing beside it",
            where=columns[0].label if columns else "compare",
            remedy="name at least two",
        )
    values_by_column = [dict(column.values) for column in columns]
    separate = tuple(
        name
        for name in _ordered({name for values in values_by_column for name in values})
        if len(_units(name, values_by_column)) > 1
    )
    counted = {
        name: sum(name in values for values in values_by_column)
        for values in values_by_column
        for name in values
    }
    names = _ordered(
        {
            name
            for name, count in counted.items()
            if count >= FEWEST_STUDIES and name not in separate
        }
    )
    if not names:
        what = f"{', '.join(column.label for column in columns)} share no parameter"
        remedy = (
            f"in the same unit: {', '.join(separate)}"
            if separate
            else "; ".join(f"{c.label} has {_few(list(c.values))}" for c in columns)
        )
        raise DeclarationError(
            what, where="compare", remedy=f"name studies of one model ({remedy})"
        )
    single = {
        c.label: result
        for c in columns
        if (result := _ordered({name for name in c.values if counted[name] == 1}))
    }
    derived = [dict(column.derived) for column in columns]
    both = {
        name
        for values in derived
        for name in values
        if sum(name in other for other in derived) >= FEWEST_STUDIES
        and len(_units(name, derived)) == 1
    }
    return SideBySide(tuple(columns), names, _ordered(both - set(names)), single, separate)


def _units(name: str, values_by_column: Sequence[dict[str, Value]]) -> set[str]:
    return {values[name].unit for values in values_by_column if name in values}


def _few(names: Sequence[str]) -> str:
    shown = _ordered(set(names))
    return ", ".join(shown[:3]) + (", ..." if len(shown) > 3 else "") if shown else "none"


def _ordered(names: set[str]) -> tuple[str, ...]:
    """Return the names in the order of the equations; other names after them, numbers in names
    sorted as numbers.
    """
    known = [
        *RIGID_DERIVATIVES,
        *(name for name, _, _ in mode_units(MOST_ORDERED_MODES)),
        *BALLISTIC_DERIVATIVES,
        *LOES_DERIVATIVES,
        *LOES_OFFSETS,
    ]
    known += [name for _, _, derivatives in WHOLE_AXES.values() for name in derivatives]
    place = {name: at for at, name in reversed(list(enumerate(known)))}

    def key(name: str) -> tuple[int, list[tuple[int, str]]]:
        parts = [
            (int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)
        ]
        return place.get(name, len(known)), parts

    return tuple(sorted(names, key=key))


# ---- Study folders to columns of a comparison

STUDIES = {"comparison.json": "flightid/comparison/1", "diagnosis.json": "flightid/diagnosis/2"}
WRITERS = "name a folder that run, identify, watch or diagnose wrote with --out"
BEFORE = "before"  # the method of a diagnosis that is the declared model
OWN = "own"  # the name of a closed-loop study's main method among its methods


def read_columns(studies: Sequence[str], every: bool = False) -> tuple[StudyColumn, ...]:
    """Read the columns of studies in the given order, each with a unique label.

    Parameters
    ----------
    studies : folders of studies or the JSON in them; ``FOLDER:METHOD`` is one of its further
        methods.
    every : all methods of each study, its main one first.

    Raises
    ------
    DeclarationError : no study there, no such method, the same one named twice.
    """
    columns: list[StudyColumn] = []
    for text in studies:
        for column in _reading_columns(text, every):
            if any(
                (column.folder, column.method) == (done.folder, done.method) for done in columns
            ):
                raise DeclarationError(
                    "it is named twice", where=text, remedy="name each study once"
                )
            columns.append(column)
    return _distinct_labels(columns)


def _reading_columns(text: str, every: bool) -> list[StudyColumn]:
    """Return the columns of one argument of the command."""
    path, method = Path(text), ""
    if not path.exists() and ":" in text:
        before, _, method = text.rpartition(":")
        path = Path(before)
    file = _study_file(path, text)
    content = _content(file)
    methods = _methods(content)
    if method and method not in methods:
        available = ", ".join(methods)
        remedy = (
            f"use one of {available}"
            if methods
            else "leave the method out: the study has its main one only"
        )
        raise DeclarationError(f"the study has no method {method!r}", where=text, remedy=remedy)
    main = _column(content, file, "", content)
    if method:
        return [_column(methods[method], file, method, content)]
    return (
        [main, *(_column(table, file, name, content) for name, table in methods.items())]
        if every
        else [main]
    )


def _study_file(path: Path, text: str) -> Path:
    """JSON file of a study, by its folder or its own path."""
    result = (
        [path / name for name in STUDIES if (path / name).is_file()]
        if path.is_dir()
        else [path]
        if path.name in STUDIES
        else []
    )
    if not result:
        what = (
            "there is no study in this folder"
            if path.is_dir()
            else "it is no study folder"
            if path.exists()
            else "there is no such folder"
        )
        raise DeclarationError(what, where=text, remedy=WRITERS)
    return result[0]


def _content(file: Path) -> dict[str, Any]:
    """Return the content of a study's JSON file."""
    content = read_json(file, wanted=WRITERS.removeprefix("name "))
    if not isinstance(content, dict) or content.get("schema") != STUDIES[file.name]:
        raise DeclarationError(f"it is no {STUDIES[file.name]}", where=str(file), remedy=WRITERS)
    return content


def _methods(content: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Further methods by name; of a diagnosis the declared model."""
    if content["schema"] == STUDIES["diagnosis.json"]:
        return {BEFORE: content}
    methods = content.get("methods")
    if isinstance(methods, list):  # closed-loop study; skip its main method
        methods = {
            str(table.get("name")): table
            for table in methods
            if isinstance(table, dict) and table.get("name") != OWN
        }
    return (
        {name: table for name, table in methods.items() if isinstance(table, dict)}
        if isinstance(methods, dict)
        else {}
    )


def _column(
    table: Mapping[str, Any], file: Path, method: str, content: Mapping[str, Any]
) -> StudyColumn:
    """One method of a study; ``content``: of its JSON file, ``table``: the part of this method."""
    folder = file.parent
    parameters, derived = table.get("parameters"), table.get("derived")
    estimator = table.get("method", table.get("label", ""))
    outcome = table.get("outcome", content.get("outcome", ""))
    if content["schema"] == STUDIES["diagnosis.json"]:
        when = method or "after"
        parameters = parameters.get(when) if isinstance(parameters, dict) else None
        derived = table.get("derived_before" if method == BEFORE else "derived")
        estimator, outcome = f"diagnose, {when}", content.get("verdict", "")
    seed = content.get("seed")
    return StudyColumn(
        label=resolved(folder).name,
        folder=folder,
        method=method,
        title=str(content.get("title", "")),
        estimator=str(estimator),
        outcome=str(outcome),
        seed=seed if isinstance(seed, int) else None,
        values=_values(parameters, f"{file}, key parameters"),
        derived=_values(derived, f"{file}, key derived"),
        responses=read_responses(folder, method),
        vehicle=str(content.get("vehicle", "")),
        model=str(content.get("model", "")),
    )


def _values(table: Any, where: str) -> dict[str, Value]:
    """Return the values by name of a table of a study; entries without an estimate are left out."""
    if table is None:
        return {}
    if not isinstance(table, dict):
        raise DeclarationError("no table", where=where, remedy=WRITERS)
    return {
        name: value
        for name, entry in table.items()
        if isinstance(entry, dict) and (value := _value(entry)) is not None
    }


def _value(entry: Mapping[str, Any]) -> Value | None:
    estimate = _number(entry.get("estimate", entry.get("value")))
    if estimate is None:
        return None
    printed = entry.get("published")
    published = _number(printed.get("value")) if isinstance(printed, dict) else None
    return Value(
        estimate,
        _number(entry.get("std")) or 0.0,
        str(entry.get("unit", "")),
        _number(entry.get("true")),
        _number(entry.get("condensed")),
        None
        if published is None or not isinstance(printed, dict)
        else (published, _number(printed.get("std")) or 0.0),
    )


def _number(value: Any) -> float | None:
    """Return a finite number, or None."""
    return (
        float(value)
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        else None
    )


def _distinct_labels(columns: Sequence[StudyColumn]) -> tuple[StudyColumn, ...]:
    """Return columns with unique labels: folders, parent folders if needed, and method."""
    paths = [resolved(column.folder) for column in columns]
    depth = 1
    while len({path.parts[-depth:] for path in paths}) < len(set(paths)):
        depth += 1
    labels = ["/".join(path.parts[-depth:]) for path in paths]
    out = []
    for column, label in zip(columns, labels, strict=True):
        shown = f"{label}:{column.method}" if column.method else label
        out.append(replace(column, label=shown))
    return tuple(out)
