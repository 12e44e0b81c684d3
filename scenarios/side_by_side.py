"""Read studies from their folders and arrange their estimates in columns."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.declarations import CHANNEL_UNITS, TIME
from scenarios.files.measured.columns import SIMULATED as SIMULATED_ORIGIN
from scenarios.files.sources import json_or_none, read_json, resolved
from scenarios.files.writing import PREDICTED, RESPONSE, TRUE
from scenarios.plots.display import StudyResponses, StudyValue
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
        name.removeprefix(prefix): row
        for prefix in (PREDICTED, SIMULATED)
        for name, row in table.items()
        if name.startswith(prefix)
    }
    true = {name.removeprefix(TRUE): row for name, row in table.items() if name.startswith(TRUE)}
    measured = {name: table[name] for name in predicted if name in table}
    inputs = {
        name: row
        for name, row in table.items()
        if not name.startswith((PREDICTED, SIMULATED, TRUE)) and name not in (TIME, *measured)
    }
    return StudyResponses(
        table[TIME],
        inputs,
        measured,
        {name: predicted[name] for name in measured},
        true,
        *_channel_units(folder),
    )


def _channel_units(folder: Path) -> tuple[dict[str, str], bool]:
    """Return the units of the channels, and whether the record is simulated.

    Units that ``record.json`` of the folder states replace the usual ones.
    """
    content = json_or_none(folder / "record.json")
    content = content if isinstance(content, dict) else {}
    stated = content.get("units")
    units = dict(CHANNEL_UNITS)
    if isinstance(stated, dict):
        units |= {name: str(unit) for name, unit in stated.items()}
    truth_known = (folder / "truth.json").is_file()
    return units, truth_known or content.get("origin") == SIMULATED_ORIGIN


def _columns(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a CSV file of numbers by heading; an empty cell is NaN.

    Return no column if the file cannot be read or has other cells.
    """
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


# ---- A study as a column of a comparison


@dataclass(frozen=True, eq=False)
class StudyColumn:
    """One method of one study.

    Attributes
    ----------
    label : unique label in a comparison.
    folder : folder of the study.
    method : name of the method in the study; empty for the main method.
    title : title of the study.
    estimator : name of the estimator.
    outcome : outcome code of the estimate, or verdict of a diagnosis.
    seed : seed of a simulated record; None for a measured one.
    values, derived : parameters and derived quantities by name.
    responses : outputs over time; None if the folder has none.
    vehicle, model : names of vehicle and model; empty if the study has none.
    """

    label: str
    folder: Path
    method: str
    title: str
    estimator: str
    outcome: str
    seed: int | None
    values: Mapping[str, StudyValue]
    derived: Mapping[str, StudyValue]
    responses: StudyResponses | None = None
    vehicle: str = ""
    model: str = ""


# ---- Common parameters of studies, their order and units

MOST_ORDERED_MODES = 9  # elastic modes that are sorted
FEWEST_STUDIES = 2


@dataclass(frozen=True, eq=False)
class SideBySide:
    """Comparison of several studies.

    Attributes
    ----------
    columns : the studies.
    names : parameters that at least two studies estimate, in the order of the equations.
    derived : derived quantities that at least two studies have.
    single : parameters that only one study estimates, by label of the study.
    apart : parameters whose unit is not the same in all studies; they are not compared.
    """

    columns: tuple[StudyColumn, ...]
    names: tuple[str, ...]
    derived: tuple[str, ...]
    single: dict[str, tuple[str, ...]]
    apart: tuple[str, ...]

    def value(self, name: str, column: StudyColumn) -> StudyValue | None:
        """Return the value of a parameter or derived quantity in a column; None if missing."""
        return column.values.get(name) if name in self.names else column.derived.get(name)

    @property
    def cautions(self) -> list[str]:
        """Sentences on studies of different vehicles or models."""
        sentences = []
        for what, why in (
            ("vehicle", "their parameters need not agree"),
            ("model", "a parameter of one name may be defined differently"),
        ):
            names = {column.label: getattr(column, what) for column in self.columns}
            if len({name for name in names.values() if name}) > 1:
                listed = ", ".join(f"{label} of {name}" for label, name in names.items() if name)
                sentences.append(f"studies of different {what}s ({listed}): {why}")
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
    """Compare studies parameter by parameter.

    Raises
    ------
    DeclarationError : there are fewer than two studies, or no two estimate the same parameter.
    """
    if len(columns) < FEWEST_STUDIES:
        raise DeclarationError(
            "a single study cannot be compared",
            where=columns[0].label if columns else "compare",
            remedy="name at least two",
        )
    values_by_column = [column.values for column in columns]
    counted = Counter(name for values in values_by_column for name in values)
    separate = tuple(name for name in _ordered(counted) if len(_units(name, values_by_column)) > 1)
    names = _ordered(
        name for name, count in counted.items() if count >= FEWEST_STUDIES and name not in separate
    )
    if not names:
        what = f"{', '.join(column.label for column in columns)} share no parameter"
        remedy = (
            f"in the same unit: {', '.join(separate)}"
            if separate
            else "; ".join(
                f"{column.label} has {_first_names(column.values)}" for column in columns
            )
        )
        raise DeclarationError(
            what, where="compare", remedy=f"name studies of one model ({remedy})"
        )
    single = {
        column.label: found
        for column in columns
        if (found := _ordered(name for name in column.values if counted[name] == 1))
    }
    derived_by_column = [column.derived for column in columns]
    counted_derived = Counter(name for values in derived_by_column for name in values)
    derived = _ordered(
        name
        for name, count in counted_derived.items()
        if count >= FEWEST_STUDIES
        and len(_units(name, derived_by_column)) == 1
        and name not in names
    )
    return SideBySide(tuple(columns), names, derived, single, separate)


def _units(name: str, values_by_column: Sequence[Mapping[str, StudyValue]]) -> set[str]:
    return {values[name].unit for values in values_by_column if name in values}


def _first_names(names: Iterable[str]) -> str:
    ordered = _ordered(names)
    return ", ".join(ordered[:3]) + (", ..." if len(ordered) > 3 else "") if ordered else "none"


def _ordered(names: Iterable[str]) -> tuple[str, ...]:
    """Return names in the order of the equations, then other names.

    Numbers in names are sorted as numbers.
    """
    known = [
        *RIGID_DERIVATIVES,
        *(name for name, _, _ in mode_units(MOST_ORDERED_MODES)),
        *BALLISTIC_DERIVATIVES,
        *LOES_DERIVATIVES,
        *LOES_OFFSETS,
    ]
    known += [name for _, _, derivatives in WHOLE_AXES.values() for name in derivatives]

    def key(name: str) -> tuple[int, list[tuple[int, str]]]:
        parts = [
            (int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)
        ]
        return [*known, name].index(name), parts

    return tuple(sorted(names, key=key))


# ---- Study folders to columns of a comparison

STUDIES = {"comparison.json": "flightid/comparison/1", "diagnosis.json": "flightid/diagnosis/2"}
WRITERS = "name a folder that run, identify, watch or diagnose wrote with --out"
BEFORE = "before"  # method of a diagnosis: the declared model without effects
OWN = "own"  # name of the main method among the methods of a closed-loop study


def read_columns(studies: Sequence[str], every: bool = False) -> tuple[StudyColumn, ...]:
    """Read studies in the given order, each with a unique label.

    Parameters
    ----------
    studies : folders of studies or the JSON files in them; ``FOLDER:METHOD`` for a further method.
    every : whether all methods of each study are read, its main method first.

    Raises
    ------
    DeclarationError : there is no such study or method, or one is named twice.
    """
    columns: list[StudyColumn] = []
    for text in studies:
        for column in _columns_of(text, every):
            if any(
                (column.folder, column.method) == (other.folder, other.method) for other in columns
            ):
                raise DeclarationError(
                    "it is named twice", where=text, remedy="name each study once"
                )
            columns.append(column)
    return _distinct_labels(columns)


def _columns_of(text: str, every: bool) -> list[StudyColumn]:
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
    """Return the JSON file of a study by its folder or path. Raises DeclarationError."""
    if path.is_dir():
        files = [path / name for name in STUDIES if (path / name).is_file()]
    else:
        files = [path] if path.name in STUDIES else []
    if not files:
        what = (
            "there is no study in this folder"
            if path.is_dir()
            else "it is no study folder"
            if path.exists()
            else "there is no such folder"
        )
        raise DeclarationError(what, where=text, remedy=WRITERS)
    return files[0]


def _content(file: Path) -> dict[str, Any]:
    """Return the content of a study's JSON file. Raises DeclarationError for another schema."""
    content = read_json(file, wanted=WRITERS.removeprefix("name "))
    if not isinstance(content, dict) or content.get("schema") != STUDIES[file.name]:
        raise DeclarationError(f"it is no {STUDIES[file.name]}", where=str(file), remedy=WRITERS)
    return content


def _methods(content: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the further methods of a study by name; for a diagnosis the declared model."""
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
    """Return a method of a study.

    ``content``: content of the study's JSON file. ``table``: the part of it on this method.
    """
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


def _values(table: Any, where: str) -> dict[str, StudyValue]:
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


def _value(entry: Mapping[str, Any]) -> StudyValue | None:
    """Return the value that an entry of a study describes; None without an estimate."""
    estimate = _number(entry.get("estimate", entry.get("value")))
    if estimate is None:
        return None
    printed = entry.get("published")
    printed = printed if isinstance(printed, dict) else {}
    published = _number(printed.get("value"))
    return StudyValue(
        estimate,
        _number(entry.get("std")) or 0.0,
        str(entry.get("unit", "")),
        _number(entry.get("true")),
        _number(entry.get("condensed")),
        None if published is None else (published, _number(printed.get("std")) or 0.0),
    )


def _number(value: Any) -> float | None:
    return (
        float(value)
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        else None
    )


def _distinct_labels(columns: Sequence[StudyColumn]) -> tuple[StudyColumn, ...]:
    """Return studies with unique labels: folder, with parent folders if needed, and method."""
    paths = [resolved(column.folder) for column in columns]
    depth = 1
    while len({path.parts[-depth:] for path in paths}) < len(set(paths)):
        depth += 1
    labels = ["/".join(path.parts[-depth:]) for path in paths]
    return tuple(
        replace(column, label=f"{label}:{column.method}" if column.method else label)
        for column, label in zip(columns, labels, strict=True)
    )
