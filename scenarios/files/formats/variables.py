"""Tables from the named variables of MAT, HDF5 and NumPy files.

The rules are

1. A vector as long as the clock is a column.
2. A matrix with as many rows as the clock gives one column for each of its columns. The names are
   those of a list of as many names in the file, else ``NAME1``, ``NAME2`` ...
3. A struct is a topic of its own. A struct with ``data`` or ``signals`` and without a clock is a
   column, with its ``units``.
4. ``u``, ``y`` and ``Ts`` are a record with a clock of step ``Ts``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.declarations import shortened_list
from scenarios.files.formats.cells import Topic, no_table, table_of_columns

DATA = ("data", "Data", "values", "Values", "signal", "value")
UNITS = ("units", "unit", "Units", "Unit")
CLOCK_STEP = ("Ts", "dt", "Dt", "DT", "ts", "sample_time", "T_s")
CLOCKS = ("time", "t", "Time", "TIME", "T", "timestamp", "tout", "SamplingInstants")
IDDATA = {"u": ("InputData", "u"), "y": ("OutputData", "y")}
SIGNALS = ("signals", "Signals")
NAME_LISTS = ("names", "varlab", "labels", "columns", "header")  # names of columns
FEWEST_TABLE_ROWS = 3  # fewest rows of a table
MOST_WIDE_ROWS = 100  # a matrix with more rows has one sample in a row, however wide it is


def topics_of_variables(path: Path, variables: Mapping[str, Any]) -> tuple[Topic, ...]:
    """Return the topics of named variables: arrays, texts and mappings of such values.

    Raises
    ------
    RecordError : if none of them is a table. The message has each variable with its size.
    """
    topics: list[Topic] = []
    variables = {name: _simplified(value) for name, value in variables.items()}
    merged, duplicates = _with_one_struct(variables)
    _collect(path, "", merged, topics, duplicates)
    if not topics:
        content = [f"{name} ({_size(value)})" for name, value in variables.items()]
        raise no_table(
            path,
            content,
            "save named vectors of one length, one struct of vectors, or one matrix with a column "
            "a signal",
        )
    if len(topics) == 1:
        return (Topic("", topics[0].table, topics[0].notes),)
    return tuple(topics)


def _simplified(value: Any) -> Any:
    """Return a variable as a struct of vectors or a matrix where it has one of these forms, else as
    it is:

    - an array of structs, one for each sample
    - a cell array with a row of names
    - a cell array of vectors of one length
    - Simulink's structure with time (``signals`` with ``values`` and ``label``)
    """
    value = value if hasattr(value, "toarray") else _dense(value)
    if isinstance(value, Mapping):
        return _with_signals(
            {name: item if name in SIGNALS else _simplified(item) for name, item in value.items()}
        )
    structs = _structs(value)
    if len(structs) >= FEWEST_TABLE_ROWS and all(
        sample.keys() == structs[0].keys() and all(map(_is_single_number, sample.values()))
        for sample in structs
    ):
        return {name: np.array([float(sample[name]) for sample in structs]) for name in structs[0]}
    if not isinstance(value, np.ndarray) or value.dtype != object or not value.size:
        return value
    if (
        value.ndim == 2
        and len(value) > FEWEST_TABLE_ROWS
        and all(isinstance(cell, str) for cell in value[0])
        and all(map(_is_single_number, value[1:].flat))
    ):
        return {str(name): value[1:, i].astype(float) for i, name in enumerate(value[0])}
    vectors = [
        np.squeeze(cell)
        for cell in value.flat
        if isinstance(cell, np.ndarray) and cell.dtype.kind in "fiub"
    ]
    if len(vectors) == value.size and all(
        vector.ndim == 1 and FEWEST_TABLE_ROWS <= vector.size == vectors[0].size
        for vector in vectors
    ):
        return np.column_stack(vectors)
    return value


def _with_signals(level: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a struct with the vectors in its ``signals`` as named variables beside its clock, if
    it is a structure of Simulink; else the struct as it is.
    """
    name = next((word for word in SIGNALS if word in level), "")
    signals = _structs(level.get(name))
    if (
        not signals
        or not any(word in level for word in CLOCKS)
        or not all("values" in signal for signal in signals)
    ):
        return {key: _simplified(value) if key == name else value for key, value in level.items()}
    labels = [
        str(signal.get("label") or signal.get("blockName") or f"signal{n + 1}")
        for n, signal in enumerate(signals)
    ]
    others = {key: value for key, value in level.items() if key != name}
    return others | {
        label: _simplified(signal["values"]) for label, signal in zip(labels, signals, strict=True)
    }


def _structs(value: Any) -> list[Mapping[str, Any]]:
    """Return the structs of an array of structs, or a single struct; empty for other values."""
    if isinstance(value, Mapping):
        return [value]
    items = list(value.flat) if isinstance(value, np.ndarray) and value.dtype == object else value
    structs = [_dense(item) for item in items] if isinstance(items, list) else []
    return structs if all(isinstance(struct, Mapping) for struct in structs) else []


def _is_single_number(cell: Any) -> bool:
    return np.ndim(cell) == 0 and isinstance(cell, int | float | np.number)


def _with_one_struct(variables: Mapping[str, Any]) -> tuple[Mapping[str, Any], dict[str, str]]:
    """Return the variables with those of the struct among them, if there is only one and it has the
    only clock; and name -> fault, for names in the struct and outside it.
    """
    structs = [
        name
        for name, value in variables.items()
        if isinstance(value, Mapping) and any(word in value for word in CLOCKS)
    ]
    if len(structs) != 1 or any(word in variables for word in CLOCKS):
        return variables, {}
    inside = variables[structs[0]]
    outside = {name: value for name, value in variables.items() if name != structs[0]}
    duplicates = {
        name: f"there twice, in the struct {structs[0]} and outside it"
        for name in inside
        if name in outside
    }
    return {**outside, **inside}, duplicates


def _fault(value: Any) -> str:
    """Return what a variable is, in a few words, if it is not a single vector; else an empty
    text.
    """
    if hasattr(value, "toarray"):
        is_vector = min(value.shape) <= 1
        return "" if is_vector else f"a sparse array of {'x'.join(map(str, value.shape))}"
    if isinstance(value, Mapping):
        return "a struct"
    shape = np.shape(value)
    if shape and np.size(value) == 0:
        return "empty"
    is_vector = len(shape) < 2 or (len(shape) == 2 and min(shape) <= 1)
    return "" if is_vector else f"an array of {'x'.join(map(str, shape))}"


def _collect(
    path: Path,
    name: str,
    level: Mapping[str, Any],
    topics: list[Topic],
    unreadable: Mapping[str, str] | None = None,
    clock: np.ndarray | None = None,
) -> None:
    """Append the table of a level of the file to ``topics``, then those of the structs in it.

    Parameters
    ----------
    name : name of the level; empty for the file itself.
    level : name -> variable.
    unreadable : name -> fault of variables that cannot be read.
    clock : clock of the level above, for a level without its own.
    """
    unreadable = dict(unreadable or {})
    level = _with_clock(_named_after(name, level), clock)
    faults = {key: fault for key, value in level.items() if (fault := _fault(value))} | unreadable
    variables = {key: _dense(value) for key, value in level.items() if key not in unreadable}
    arrays: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    structs: dict[str, Mapping[str, Any]] = {}
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
                arrays[key] = np.squeeze(np.asarray(_dense(data)))
                units[key] = next(
                    (str(value[word]) for word in UNITS if isinstance(value.get(word), str)), ""
                )
            else:
                structs[key] = value
        elif (
            isinstance(value, np.ndarray)
            and value.dtype == object
            and value.size
            and all(isinstance(item, Mapping) for item in value.flat)
        ):
            structs |= {f"{key}[{n + 1}]": struct for n, struct in enumerate(value.flat)}
        elif np.ndim(value) and np.size(value):
            arrays[key] = np.asarray(value)
    columns, rows, notes = _columns(arrays, variables)
    if columns:
        # The unit of a matrix is that of all its columns.
        column_units = {
            column: units[key]
            for key in units
            for column in columns
            if column == key or (column.startswith(key) and column[len(key) :].isdigit())
        }
        table = table_of_columns(
            path,
            columns,
            column_units,
            place=name,
            rows=rows,
            unreadable={
                key: fault
                for key, fault in faults.items()
                if key not in columns and key not in structs
            },
        )
        topics.append(Topic(name, table, tuple(notes)))
    inner_clock = next(
        (np.squeeze(level[word]) for word in CLOCKS if isinstance(level.get(word), np.ndarray)),
        clock,
    )
    for key, struct in structs.items():
        _collect(path, f"{name}.{key}" if name else key, struct, topics, clock=inner_clock)


def _named_after(name: str, level: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a level that is one signal and its clock, as a timeseries of MATLAB, with the name of
    the level as the name of the signal; another level as it is.
    """
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
        signal if key == data[0] else key: named if key == data[0] else value
        for key, value in level.items()
        if key not in UNITS
    }


def _with_clock(level: Mapping[str, Any], clock: np.ndarray | None) -> Mapping[str, Any]:
    """Return a level with the clock of the level above, if it has no clock of its own but a vector
    of the same length; else the level as it is.
    """
    if clock is None or clock.ndim != 1 or any(word in level for word in CLOCKS):
        return level
    arrays = [value for value in level.values() if not isinstance(value, Mapping)]
    if any(np.size(value) == clock.size for value in arrays):
        return {"time": clock, **level}
    return level


def _columns(
    arrays: Mapping[str, np.ndarray], level: Mapping[str, Any]
) -> tuple[dict[str, np.ndarray], int, list[str]]:
    """Return the columns of the ``arrays`` of a level, their number of rows, and notes.

    Arrays with this number of rows give columns. Vectors of other lengths are columns too: they are
    refused when a channel needs them.
    """
    numeric = {key: _upright(value) for key, value in arrays.items() if _is_numeric(value)}
    rows = _rows(numeric)
    chosen = {key: value for key, value in numeric.items() if value.shape[0] == rows}
    if not chosen or rows < FEWEST_TABLE_ROWS:
        return {}, 0, []
    has_clock = any(word in numeric for word in CLOCKS)
    columns: dict[str, np.ndarray] = {}
    for key, value in chosen.items():
        names = _names(key, value, level, lone=len(chosen) == 1)
        for index, name in enumerate(names):
            columns.setdefault(name, value[:, index])
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
    if has_clock or len(chosen) > 1:
        columns |= {
            key: value[:, 0]
            for key, value in numeric.items()
            if key not in chosen and value.shape[1] == 1
        }
    not_used = [
        f"{key} ({_size(value)})"
        for key, value in arrays.items()
        if key not in {*chosen, *columns} and np.size(value) > 1 and not _texts(value)
    ]
    if not_used:
        notes.append(f"arrays of another length are no columns: {shortened_list(not_used, 6)}")
    return columns, rows, notes


def _names(key: str, value: np.ndarray, level: Mapping[str, Any], *, lone: bool) -> list[str]:
    """Return the names of the columns of a matrix: a list of as many names in the file, else its
    own name ``key`` with numbers. ``lone`` : whether it is the only matrix.
    """
    count = value.shape[1]
    if count == 1:
        return [key]
    for other, texts in level.items():
        labels = _texts(texts)
        if len(labels) == count and (
            lone or key.lower() in other.lower() or other.lower() in NAME_LISTS
        ):
            return labels
    return [f"{key}{n + 1}" for n in range(count)]


def _rows(numeric: Mapping[str, np.ndarray]) -> int:
    """Return the number of rows of the table: that of the clock, else the number of rows with most
    values.
    """
    clock = next(
        (numeric[word] for word in CLOCKS if word in numeric and numeric[word].shape[1] == 1), None
    )
    if clock is not None and clock.shape[0] >= FEWEST_TABLE_ROWS:
        return int(clock.shape[0])
    counts: dict[int, int] = {}
    for value in numeric.values():
        counts[value.shape[0]] = counts.get(value.shape[0], 0) + value.shape[1]
    long = {rows: count for rows, count in counts.items() if rows >= FEWEST_TABLE_ROWS}
    return max(long, key=lambda rows: (long[rows] * rows, rows), default=0)


def _upright(value: np.ndarray) -> np.ndarray:
    """Return an array with one row for each sample: a vector as one column, a wide matrix
    transposed.
    """
    if value.ndim == 1:
        return value.reshape(-1, 1)
    rows, columns = value.shape
    is_wide = rows == 1 or (columns > rows and rows <= MOST_WIDE_ROWS)
    return value.T if is_wide else value


def _is_numeric(value: np.ndarray) -> bool:
    return value.dtype.kind in "fiub" and value.ndim in (1, 2) and value.size > 1


def _texts(value: Any) -> list[str]:
    """Return the texts of a cell array or a matrix of characters; empty for other values."""
    if (
        isinstance(value, np.ndarray)
        and value.ndim
        and value.dtype.kind in "OU"
        and all(isinstance(text, str) for text in value.flat)
    ):
        return [str(text).strip() for text in value.flat]
    return []


def _dense(value: Any) -> Any:
    """Return a sparse matrix as an array, an object of MATLAB as a mapping, and other values as
    they are.
    """
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
    """Return the size of a variable in words, as ``801 x 2``."""
    if isinstance(value, Mapping):
        return "struct"
    return " x ".join(str(n) for n in np.shape(value)) or "one value"
