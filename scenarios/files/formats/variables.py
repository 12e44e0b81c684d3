"""Tables from named variables, of MAT and HDF5 files: vectors, a matrix with or without names,
structs of any depth, parts of ``iddata``.

The rules: (1) vectors as long as the clock are columns; (2) a matrix with that many rows gives one
column for each of its columns, named by a list of as many names in the file, else ``NAME1``,
``NAME2`` ...; a lone matrix of which nothing is named has plain numbers; (3) a struct is a topic of
its own, and a struct with ``data`` or ``signals`` is a column with its ``units``; (4) ``u``, ``y``
and ``Ts`` make a record with a clock of that step.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.formats.cells import Topic, no_table, table_of_columns

DATA = ("data", "Data", "values", "Values", "signal", "value")
UNITS = ("units", "unit", "Units", "Unit")
CLOCK_STEP = ("Ts", "dt", "Dt", "DT", "ts", "sample_time", "T_s")
CLOCKS = ("time", "t", "Time", "TIME", "T", "timestamp", "tout", "SamplingInstants")
IDDATA = {"u": ("InputData", "u"), "y": ("OutputData", "y")}
SIGNALS = ("signals", "Signals")
FEWEST_TABLE_ROWS = 3  # rows of a matrix that is a table


def topics_of_variables(path: Path, variables: Mapping[str, Any]) -> tuple[Topic, ...]:
    """Topics of named values: arrays, texts and mappings of such values.

    Raises
    ------
    RecordError : nothing in them is a table; the message names each array with its size.
    """
    topics: list[Topic] = []
    variables = {name: _simplified(value) for name, value in variables.items()}
    merged, twice = _with_one_struct(variables)
    _collect(path, "", merged, topics, twice)
    if not topics:
        seen = [f"{name} ({_size(value)})" for name, value in variables.items()]
        raise no_table(
            path,
            seen,
            "save named vectors of one length, one struct of vectors, or one matrix with a column "
            "a signal",
        )
    if len(topics) == 1:
        return (Topic("", topics[0].table, topics[0].notes),)
    return tuple(topics)


def _simplified(value: Any) -> Any:
    """Return a variable, at any depth, as a struct of vectors or a matrix.

    Converted are arrays of structs (one per sample), cell arrays with a row of names, Simulink's
    structure with time (``signals`` with ``values`` and ``label``), and cell arrays of vectors of
    one length.
    """
    value = value if hasattr(value, "toarray") else _dense(value)
    if isinstance(value, Mapping):
        return _with_signals(
            {name: each if name in SIGNALS else _simplified(each) for name, each in value.items()}
        )
    structs = _structs(value)
    if len(structs) >= FEWEST_TABLE_ROWS and all(
        each.keys() == structs[0].keys() and all(map(_is_one, each.values())) for each in structs
    ):
        return {name: np.array([float(each[name]) for each in structs]) for name in structs[0]}
    if not isinstance(value, np.ndarray) or value.dtype != object or not value.size:
        return value
    if (
        value.ndim == 2
        and len(value) > FEWEST_TABLE_ROWS
        and all(isinstance(cell, str) for cell in value[0])
        and all(map(_is_one, value[1:].flat))
    ):
        return {str(name): value[1:, at].astype(float) for at, name in enumerate(value[0])}
    vectors = [
        np.squeeze(each)
        for each in value.flat
        if isinstance(each, np.ndarray) and each.dtype.kind in "fiub"
    ]
    if len(vectors) == value.size and all(
        each.ndim == 1 and FEWEST_TABLE_ROWS <= each.size == vectors[0].size for each in vectors
    ):
        return np.column_stack(vectors)
    return value


def _with_signals(level: Mapping[str, Any]) -> Mapping[str, Any]:
    """The struct if it is one of Simulink's, with named vectors in ``signals`` beside its clock."""
    name = next((word for word in SIGNALS if word in level), "")
    signals = _structs(level.get(name))
    if (
        not signals
        or not any(word in level for word in CLOCKS)
        or not all("values" in each for each in signals)
    ):
        return {key: _simplified(each) if key == name else each for key, each in level.items()}
    labels = [
        str(each.get("label") or each.get("blockName") or f"signal{n + 1}")
        for n, each in enumerate(signals)
    ]
    rest = {key: each for key, each in level.items() if key != name}
    return rest | {
        label: _simplified(each["values"]) for label, each in zip(labels, signals, strict=True)
    }


def _structs(value: Any) -> list[Mapping[str, Any]]:
    """The structs of an array of structs, or the one that is no array; empty for anything else."""
    if isinstance(value, Mapping):
        return [value]
    items = list(value.flat) if isinstance(value, np.ndarray) and value.dtype == object else value
    each = [_dense(item) for item in items] if isinstance(items, list) else []
    return each if all(isinstance(item, Mapping) for item in each) else []


def _is_one(cell: Any) -> bool:
    return np.ndim(cell) == 0 and isinstance(cell, int | float | np.number)


def _with_one_struct(variables: Mapping[str, Any]) -> tuple[Mapping[str, Any], dict[str, str]]:
    """Return the variables with those of the only struct among them, and names that are in both,
    with the reason why they cannot be read.
    """
    structs = [
        name
        for name, value in variables.items()
        if isinstance(value, Mapping) and any(word in value for word in CLOCKS)
    ]
    if len(structs) != 1 or any(word in variables for word in CLOCKS):
        return variables, {}
    inside = variables[structs[0]]
    rest = {name: value for name, value in variables.items() if name != structs[0]}
    both = {
        name: f"there twice, in the struct {structs[0]} and outside it"
        for name in inside
        if name in rest
    }
    return {**rest, **inside}, both


def _fault(value: Any) -> str:
    """Why a variable is not one vector, in a few words; empty if it is."""
    shape = (
        "x".join(map(str, np.shape(value)))
        if not hasattr(value, "toarray")
        else "x".join(map(str, value.shape))
    )
    if hasattr(value, "toarray"):
        return f"a sparse array of {shape}" if min(value.shape) > 1 else ""
    if isinstance(value, Mapping):
        return "a struct"
    if np.ndim(value) and np.size(value) == 0:
        return "empty"
    return (
        f"an array of {shape}"
        if np.ndim(value) > 2 or (np.ndim(value) == 2 and min(np.shape(value)) > 1)
        else ""
    )


def _collect(
    path: Path,
    name: str,
    level: Mapping[str, Any],
    topics: list[Topic],
    unreadable: Mapping[str, str] | None = None,
    clock: np.ndarray | None = None,
) -> None:
    """Add the table that a level of the file holds, then those of the structs in it;
    ``unreadable``: names of it that cannot be read, and why; ``clock``: of the level above, for one
    without."""
    level = _with_clock(_named_after(name, level), clock)
    faults = {key: fault for key, value in level.items() if (fault := _fault(value))} | dict(
        unreadable or {}
    )
    variables = {
        key: _dense(value) for key, value in level.items() if key not in (unreadable or {})
    }
    flat: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    inner: dict[str, Mapping[str, Any]] = {}
    for key, value in variables.items():
        if isinstance(value, Mapping):
            data = next(
                (
                    value[word]
                    for word in DATA
                    if word in value and np.ndim(value[word]) in (1, 2) and np.size(value[word])
                ),
                None,
            )
            clocked = any(word in value for word in CLOCKS)
            if data is not None and not clocked:
                flat[key] = np.squeeze(np.asarray(_dense(data)))
                units[key] = next(
                    (str(value[word]) for word in UNITS if isinstance(value.get(word), str)), ""
                )
            else:
                inner[key] = value
        elif (
            isinstance(value, np.ndarray)
            and value.dtype == object
            and value.size
            and all(isinstance(each, Mapping) for each in value.flat)
        ):
            inner |= {f"{key}[{n + 1}]": each for n, each in enumerate(value.flat)}
        elif np.ndim(value) and np.size(value):
            flat[key] = np.asarray(value)
    columns, rows, notes = _columns(flat, variables)
    if columns:
        spread = {
            column: units[key]
            for key in units
            for column in columns
            if column == key or (column.startswith(key) and column[len(key) :].isdigit())
        }
        others = {
            key: fault for key, fault in faults.items() if key not in columns and key not in inner
        }
        topics.append(
            Topic(
                name,
                table_of_columns(path, columns, spread, place=name, rows=rows, unreadable=others),
                tuple(notes),
            )
        )
    own = next(
        (np.squeeze(level[word]) for word in CLOCKS if isinstance(level.get(word), np.ndarray)),
        clock,
    )
    for key, value in inner.items():
        _collect(path, f"{name}.{key}" if name else key, value, topics, clock=own)


def _named_after(name: str, level: Mapping[str, Any]) -> Mapping[str, Any]:
    """The level with its data under its own name where it is one signal and its clock, as MATLAB's
    timeseries and one group a signal are."""
    data = [word for word in DATA if word in level and np.size(level[word]) > 1]
    clocks = [word for word in CLOCKS if word in level]
    signal = name.rpartition(".")[2]
    if (
        len(data) != 1
        or len(clocks) != 1
        or not signal
        or signal in level
        or np.size(level[data[0]]) != np.size(level[clocks[0]])
    ):
        return level
    named = {"data": np.squeeze(level[data[0]])} | {
        word: level[word] for word in UNITS if word in level
    }
    return {
        signal if key == data[0] else key: named if key == data[0] else each
        for key, each in level.items()
        if key not in UNITS
    }


def _with_clock(level: Mapping[str, Any], clock: np.ndarray | None) -> Mapping[str, Any]:
    """Return the level with the clock of the level above if it has none, and vectors as long as
    that one.
    """
    if clock is None or clock.ndim != 1 or any(word in level for word in CLOCKS):
        return level
    return (
        {"time": clock, **level}
        if any(
            np.size(each) == clock.size for each in level.values() if not isinstance(each, Mapping)
        )
        else level
    )


def _columns(
    flat: Mapping[str, np.ndarray], level: Mapping[str, Any]
) -> tuple[dict[str, np.ndarray], int, list[str]]:
    """Return the columns of one level and their rows: arrays with as many rows as its clock, or as
    most of them have, and all other vectors.

    A vector of another length is refused with both lengths when a channel asks for it.
    """
    numeric = {key: _upright(value) for key, value in flat.items() if _is_numeric(value)}
    rows = _rows(numeric)
    chosen = {key: value for key, value in numeric.items() if value.shape[0] == rows}
    if not chosen or rows < FEWEST_TABLE_ROWS:
        return {}, 0, []
    clocked = any(word in numeric for word in CLOCKS)
    columns: dict[str, np.ndarray] = {}
    for key, value in chosen.items():
        names = _names(key, value, level, lone=len(chosen) == 1)
        for index, label in enumerate(names):
            columns.setdefault(label, value[:, index])
    step = next(
        (
            float(level[word])
            for word in CLOCK_STEP
            if word in level and np.ndim(level[word]) == 0 and _positive(level[word])
        ),
        None,
    )
    notes = []
    if step is not None and not any(word in columns for word in CLOCKS):
        columns = {"time": step * np.arange(rows), **columns}
        notes.append(f"the clock is made of the step of {step:g} s that the file states")
    if clocked or len(chosen) > 1:
        columns |= {
            key: value[:, 0]
            for key, value in numeric.items()
            if key not in chosen and value.shape[1] == 1
        }
    left = [
        f"{key} ({_size(value)})"
        for key, value in flat.items()
        if key not in {*chosen, *columns} and np.size(value) > 1 and not _is_names(value)
    ]
    if left:
        notes.append(
            "arrays of another length are no columns: "
            f"{', '.join(left[:6])}{', ...' if len(left) > 6 else ''}"
        )
    return columns, rows, notes


def _names(key: str, value: np.ndarray, level: Mapping[str, Any], *, lone: bool) -> list[str]:
    """Names of a matrix's columns: from a list of as many names in the file, else by number."""
    count = value.shape[1]
    if count == 1:
        return [key]
    for other, texts in level.items():
        labels = _texts(texts)
        if len(labels) == count and (
            lone
            or key.lower() in other.lower()
            or other.lower() in ("names", "varlab", "labels", "columns", "header")
        ):
            return labels
    return [f"{key}{n + 1}" for n in range(count)]


def _rows(numeric: Mapping[str, np.ndarray]) -> int:
    """Return the number of rows: that of the clock, else the most frequent (largest) one."""
    clock = next(
        (
            value
            for word in CLOCKS
            for key, value in numeric.items()
            if key == word and value.shape[1] == 1
        ),
        None,
    )
    if clock is not None and clock.shape[0] >= FEWEST_TABLE_ROWS:
        return int(clock.shape[0])
    counts: dict[int, int] = {}
    for value in numeric.values():
        counts[value.shape[0]] = counts.get(value.shape[0], 0) + value.shape[1]
    long = {rows: count for rows, count in counts.items() if rows >= FEWEST_TABLE_ROWS}
    return max(long, key=lambda rows: (long[rows] * rows, rows), default=0)


def _upright(value: np.ndarray) -> np.ndarray:
    """Return an array with one row per sample: vectors as one column, wide matrices turned."""
    if value.ndim == 1:
        return value.reshape(-1, 1)
    return (
        value.T
        if value.shape[0] == 1 or (value.shape[1] > value.shape[0] and value.shape[0] <= 100)
        else value
    )


def _is_numeric(value: np.ndarray) -> bool:
    return value.dtype.kind in "fiub" and value.ndim in (1, 2) and value.size > 1


def _is_names(value: Any) -> bool:
    return bool(_texts(value))


def _texts(value: Any) -> list[str]:
    """A list of names, from a cell array or a matrix of characters; empty for anything else."""
    if (
        isinstance(value, np.ndarray)
        and value.ndim
        and value.dtype.kind in "OU"
        and all(isinstance(each, str) for each in value.flat)
    ):
        return [str(each).strip() for each in value.flat]
    return []


def _dense(value: Any) -> Any:
    """Sparse matrices as arrays; MATLAB's objects as mappings."""
    if hasattr(value, "toarray"):
        return value.toarray()
    if hasattr(value, "_fieldnames"):
        return {name: getattr(value, name) for name in value._fieldnames}
    return value


def _positive(value: Any) -> bool:
    try:
        return 0.0 < float(value) < np.inf
    except (TypeError, ValueError):
        return False


def _size(value: Any) -> str:
    return (
        "struct"
        if isinstance(value, Mapping)
        else " x ".join(str(n) for n in np.shape(value)) or "one value"
    )
