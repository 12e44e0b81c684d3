"""Rows of tasks as columns: what is held in memory while they come, and the one table of all."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from scenarios.tasks.work import Ended, Work

Columns = dict[str, np.ndarray]

KINDS: Mapping[str, type] = {"float": float, "time": float, "int": int, "bool": bool, "text": str}
FLOATS = ("float", "time")
OWN: Mapping[str, str] = {"number": "int", "seed": "int", "error": "text", "passing": "bool", "seconds": "time"}  # of every work
SHOWN = ("number", "seed", "error")  # of them, what a table begins with


@dataclass(frozen=True, eq=False)
class Table:
    """Rows of the tasks that have ended, in the order of their numbers.

    ``columns`` : each ``(N,)``, beginning with ``number``, ``seed`` and ``error`` (empty where there is a row); cells of tasks without a row
    are None, NaN in columns of floats. ``asked`` : how many tasks there were to be. ``times`` ``(N,)`` each, s : ``seconds`` of wall time, and
    the work's columns of type ``time``, which no two runs have in common.
    """

    columns: Mapping[str, np.ndarray]
    asked: int
    times: Mapping[str, np.ndarray]

    def __len__(self) -> int:
        return len(self.columns["number"])

    @property
    def whole(self) -> bool:
        """Whether all tasks have ended."""
        return len(self) == self.asked

    @property
    def sound(self) -> np.ndarray:
        """``(N,)`` of bool: the tasks that have a row."""
        return np.array([not error for error in self.columns["error"]], dtype=bool)


def all_columns(work: Work) -> dict[str, str]:
    """Names and types of what is kept of a task: its own and those of the work.

    Raises ValueError where the work names a column as one of ours, or a type that there is not.
    """
    for name, kind in work.columns.items():
        if name in OWN or kind not in KINDS:
            raise ValueError(f"the column {name!r} of type {kind!r} of {work.name}")
    return {**OWN, **work.columns}


def columns_of(work: Work, ended: Sequence[Ended]) -> Columns:
    """What has ended, as columns ``(k,)``: floats with NaN for no number, else objects with None.

    A row that has not the work's columns, or a cell of another type, is an error of its task.
    """
    kinds = all_columns(work)
    cells: dict[str, list[object]] = {name: [] for name in kinds}
    for each in ended:
        wrong = _wrong(work, each)
        row = None if wrong else each.row
        own = (each.task.number, each.task.seed, wrong or each.error, each.passing, each.seconds)
        for name, cell in zip(OWN, own, strict=True):
            cells[name].append(cell)
        for name in work.columns:
            cells[name].append(None if row is None else row[name])
    return {name: array_of(cells[name], kind) for name, kind in kinds.items()}


def array_of(cells: Iterable[object], kind: str) -> np.ndarray:
    """One column: floats as floats, all else as objects of Python's own types."""
    if kind in FLOATS:
        return np.array([np.nan if cell is None else cell for cell in cells], dtype=float)
    column = [None if cell is None else KINDS[kind](cell) for cell in cells]
    array = np.empty(len(column), dtype=object)
    array[:] = column
    return array


def joined(kinds: Mapping[str, str], pieces: Sequence[Columns]) -> Columns:
    """Columns one after another; of none, empty ones."""
    if not pieces:
        return {name: array_of((), kind) for name, kind in kinds.items()}
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in kinds}


def in_order(columns: Columns, count: int) -> Columns:
    """Rows of the first ``count`` tasks by their numbers, each once: what a circumstance ended gives way to what was computed later."""
    numbers = columns["number"].astype(np.int64)
    order = np.lexsort((columns["passing"].astype(bool), numbers))
    first = np.ones(len(order), dtype=bool)
    first[1:] = numbers[order][1:] != numbers[order][:-1]
    kept = order[first & (numbers[order] < count)]
    return {name: column[kept] for name, column in columns.items()}


def table_of(work: Work, columns: Columns, asked: int) -> Table:
    """The table of rows that are in order."""
    times = {name: columns[name] for name, kind in all_columns(work).items() if kind == "time"}
    shown = [name for name in (*SHOWN, *work.columns) if name not in times]
    return Table({name: columns[name].astype(np.int64) if name in ("number", "seed") else columns[name] for name in shown}, asked, times)


def _wrong(work: Work, each: Ended) -> str:
    if each.row is None:
        return ""
    if set(each.row) != set(work.columns):
        return f"its row has the columns {', '.join(sorted(each.row))} and not those declared"
    for name, kind in work.columns.items():
        cell = each.row[name]
        if cell is None or (kind in FLOATS and isinstance(cell, int | float | np.floating | np.integer)):
            continue
        if not isinstance(cell, {"int": int | np.integer, "bool": bool | np.bool_, "text": str, "float": float, "time": float}[kind]):
            return f"column {name} has {cell!r} and no {kind}"
    return ""
