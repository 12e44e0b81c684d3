"""Study folders to columns of a comparison: every kind of study that a command leaves behind."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from scenarios.files.documents import read_json
from scenarios.files.sources import resolved
from scenarios.side_by_side.responses import read_responses
from scenarios.side_by_side.value import Column, Value
from sim.errors import DeclarationError

STUDIES = {"comparison.json": "flightid/comparison/1", "diagnosis.json": "flightid/diagnosis/1"}
WRITERS = "name a folder that run, identify, watch or diagnose wrote with --out"
BEFORE = "before"  # the method of a diagnosis that is the declared model
OWN = "own"  # the name of a closed-loop study's main method among its methods


def read_columns(studies: Sequence[str], every: bool = False) -> tuple[Column, ...]:
    """The columns of studies in the order given, each with a label of its own.

    Parameters
    ----------
    studies : folders of studies or the JSON in them; ``FOLDER:METHOD`` is one of its further methods.
    every : all methods of each study, its main one first.

    Raises
    ------
    DeclarationError : no study there, no such method, the same one named twice.
    """
    columns: list[Column] = []
    for text in studies:
        for column in _columns(text, every):
            if any((column.folder, column.method) == (done.folder, done.method) for done in columns):
                raise DeclarationError("it is named twice", where=text, remedy="name each study once")
            columns.append(column)
    return _told_apart(columns)


def _columns(text: str, every: bool) -> list[Column]:
    """The columns that one argument asks for."""
    path, method = Path(text), ""
    if not path.exists() and ":" in text:
        before, _, method = text.rpartition(":")
        path = Path(before)
    file = _study_file(path, text)
    content = _content(file)
    methods = _methods(content)
    if method and method not in methods:
        known = ", ".join(methods)
        remedy = f"use one of {known}" if methods else "leave the method out: the study has its main one only"
        raise DeclarationError(f"the study has no method {method!r}", where=text, remedy=remedy)
    main = _column(content, file, "", content)
    if method:
        return [_column(methods[method], file, method, content)]
    return [main, *(_column(table, file, name, content) for name, table in methods.items())] if every else [main]


def _study_file(path: Path, text: str) -> Path:
    """The JSON of a study by its folder or its own path."""
    found = [path / name for name in STUDIES if (path / name).is_file()] if path.is_dir() else [path] if path.name in STUDIES else []
    if not found:
        what = "there is no study in this folder" if path.is_dir() else "it is no study folder" if path.exists() else "there is no such folder"
        raise DeclarationError(what, where=text, remedy=WRITERS)
    return found[0]


def _content(file: Path) -> dict[str, Any]:
    """A study's JSON."""
    content = read_json(file, wanted=WRITERS.removeprefix("name "))
    if not isinstance(content, dict) or content.get("schema") != STUDIES[file.name]:
        raise DeclarationError(f"it is no {STUDIES[file.name]}", where=str(file), remedy=WRITERS)
    return content


def _methods(content: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Further methods by name; of a diagnosis the declared model."""
    if content["schema"] == STUDIES["diagnosis.json"]:
        return {BEFORE: content}
    methods = content.get("methods")
    if isinstance(methods, list):  # of a closed-loop study, whose main one stands among them as OWN
        methods = {str(table.get("name")): table for table in methods if isinstance(table, dict) and table.get("name") != OWN}
    return {name: table for name, table in methods.items() if isinstance(table, dict)} if isinstance(methods, dict) else {}


def _column(table: Mapping[str, Any], file: Path, method: str, content: Mapping[str, Any]) -> Column:
    """One method of a study whose JSON is ``content``; ``table`` is its part of it."""
    folder = file.parent
    parameters, derived = table.get("parameters"), table.get("derived")
    estimator, outcome = table.get("method", table.get("label", "")), table.get("outcome", content.get("outcome", ""))
    if content["schema"] == STUDIES["diagnosis.json"]:
        when = method or "after"
        parameters, derived = (part.get(when) if isinstance(part, dict) else None for part in (parameters, derived))
        estimator, outcome = f"diagnose, {when}", content.get("verdict", "")
    seed = content.get("seed")
    return Column(
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
    )


def _values(table: Any, where: str) -> dict[str, Value]:
    """Name -> Value of a table of a study; an entry without an estimate says nothing."""
    if table is None:
        return {}
    if not isinstance(table, dict):
        raise DeclarationError("no table", where=where, remedy=WRITERS)
    return {name: value for name, entry in table.items() if isinstance(entry, dict) and (value := _value(entry)) is not None}


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
        None if published is None or not isinstance(printed, dict) else (published, _number(printed.get("std")) or 0.0),
    )


def _number(value: Any) -> float | None:
    """A finite number, or None."""
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) else None


def _told_apart(columns: Sequence[Column]) -> tuple[Column, ...]:
    """Labels by folder, with as many of the folders above as it takes, and by method where a study stands there with several."""
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
