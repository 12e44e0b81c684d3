"""Interval transitions: states carried over all intervals of a record at once, and outputs read at its samples.

Rows of states and of driven inputs have their columns first and the times last, so that one step of an integrator serves every interval and
every column together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.propagation import Drive

if TYPE_CHECKING:
    from ident.whole_record.record_problem import RecordProblem

_AT_ONCE = 16_000  # numbers of a state that are integrated together: more do not stay in a processor's cache


def changed_rows(drive: Drive, change: Callable[[Any], Any]) -> Drive:
    """A drive with every row changed; one that stands in several places, as held inputs do, is changed once."""
    begun, middle, ended, begin, end = _changed([*drive.stages, drive.begin, drive.end], change)
    return Drive((begun, middle, ended), begin, end)


def _changed(lists: Sequence[list[Any]], change: Callable[[Any], Any]) -> list[list[Any]]:
    done: dict[int, Any] = {}
    return [[done[id(row)] if id(row) in done else done.setdefault(id(row), change(row)) for row in rows] for rows in lists]


def sample_outputs(problem: RecordProblem, p: Sequence[Any], X: list[Any], drive: Drive, apart: Sequence[int]) -> np.ndarray:
    """Outputs at the record's samples ``(m, c, N)`` from states at the nodes, rows ``(c, K + 1)``; rows of the drive ``(c, M)``.

    ``apart`` are the columns that may move otherwise than column 0, which is the first of them: the others differ after the dynamics only.
    """
    system, grid, upright, c = problem.system, problem.grid, _upright(p), len(X[0])
    sample = grid.sample
    if not system.sensor_stages:
        nodes, out = sample // grid.substeps, None
        for at in _parts(c, len(sample)):
            here = [row[:, at] if len(sample) == len(grid.nodes) else row[:, nodes[at]] for row in X]
            y = system.h(grid.edges[sample[at]], here, [row[..., sample[at]] for row in drive.begin], upright)
            out = _put(out, y, (c, len(sample)), at)
        assert out is not None
        return out
    edges = _all_edges(problem, p, X, drive, apart)
    last = [row[:, -1:] for row in X]
    begin_x = [np.concatenate([_in_a_row(rows), row], axis=1) for rows, row in zip(zip(*edges[:-1], strict=True), last, strict=True)]
    end_x = [_in_a_row(rows) for rows in zip(*edges[1:], strict=True)]
    begin = stacked(system.h(grid.edges, begin_x, drive.begin, upright), (c, len(grid.edges)))
    end = stacked(system.h(grid.edges[1:], end_x, drive.end, upright), (c, len(grid.edges) - 1))
    # A sensor's memory runs over the time, which is the first axis to it.
    rows, _ = system.sensor_path(p, [row.T for row in begin], [row.T for row in end], grid.steps)
    return stacked([np.broadcast_to(row, (len(grid.edges), c)).T[:, sample] for row in rows], (c, len(sample)))


def _all_edges(problem: RecordProblem, p: Sequence[Any], X: list[Any], drive: Drive, apart: Sequence[int]) -> list[list[Any]]:
    """As ``cross_intervals`` from ``X (c, K + 1)``, worked out for the columns ``apart`` alone; the others move as column 0 does."""
    starts, c = [row[:, :-1] for row in X], len(X[0])
    if len(apart) == c:
        return cross_intervals(problem, starts, drive, p)
    chosen = list(apart)
    few = [value[chosen] if np.ndim(value) else value for value in p]
    fewer = changed_rows(drive, lambda row: row[chosen] if np.ndim(row) == 2 else row)
    place = np.zeros(c, dtype=int)
    place[chosen] = np.arange(len(chosen))
    shape = (len(chosen), starts[0].shape[1])
    return [[np.broadcast_to(row, shape)[place] for row in rows] for rows in cross_intervals(problem, [row[chosen] for row in starts], fewer, few)]


def _in_a_row(rows: Sequence[np.ndarray]) -> np.ndarray:
    """Values ``(c, K)`` at each of S sub-steps as they follow each other: ``(c, K S)``."""
    return np.stack(rows, axis=2).reshape(len(rows[0]), -1)


def interval_ends(problem: RecordProblem, x: Sequence[Any], drive: Drive, p: Sequence[Any], columns: int = 0) -> np.ndarray:
    """States after all node intervals ``(nx, c, K)`` from those before, rows ``(c, K)``; rows of the drive ``(c, M)``.

    ``columns`` : c, where a state that all columns begin at may be given as a row ``(1, K)``.
    """
    shape, out = (columns or len(x[0]), x[0].shape[1]), None
    for at in _parts(*shape):
        out = _put(out, _crossed(problem, [row[:, at] for row in x], drive, p, at)[-1], shape, at)
    assert out is not None
    return out


def _parts(c: int, K: int) -> list[slice]:
    """Columns ``(c, K)`` cut along the time, so that a part stays in a processor's cache."""
    rows = max(1, -(-K // max(1, -(-c * K // _AT_ONCE))))
    return [slice(k, min(k + rows, K)) for k in range(0, max(K, 1), rows)]


def _put(out: np.ndarray | None, rows: Sequence[Any], shape: tuple[int, ...], at: slice) -> np.ndarray:
    """Rows of one part at its place in the whole, ``(len(rows), *shape)``, which the first part makes; a row may be the same for all columns."""
    if out is None:
        out = np.empty((len(rows), *shape), dtype=np.result_type(float, *rows))
    for i, row in enumerate(rows):
        out[i, :, at] = row
    return out


def cross_intervals(problem: RecordProblem, x: list[Any], drive: Drive, p: Sequence[Any]) -> list[list[Any]]:
    """States before the first and after every sub-step of all node intervals, rows ``(c, K)``; rows of the drive ``(c, M)``."""
    c, K = x[0].shape
    parts = _parts(c, K)
    if len(parts) == 1:
        return _crossed(problem, x, drive, p, slice(0, K))
    done = [_crossed(problem, [row[:, at] for row in x], drive, p, at) for at in parts]
    shapes = [part[0][0].shape for part in done]

    def joined(rows: Sequence[Any]) -> np.ndarray:
        return np.concatenate([np.broadcast_to(row, shape) for row, shape in zip(rows, shapes, strict=True)], axis=1)

    return [[joined(rows) for rows in zip(*edge, strict=True)] for edge in zip(*done, strict=True)]


def _crossed(problem: RecordProblem, x: list[Any], drive: Drive, p: Sequence[Any], at: slice) -> list[list[Any]]:
    """The same for some of the intervals, whose states are ``x``."""
    grid, substeps, upright = problem.grid, problem.grid.substeps, _upright(p)
    path = [x]
    for s in range(substeps):

        def mine(row: Any, s: int = s) -> Any:
            return np.ascontiguousarray(row.reshape(*row.shape[:-1], -1, substeps)[..., at, s])

        begun, middle, ended = _changed(drive.stages, mine)
        x = problem.step(problem.system.f, mine(grid.edges[:-1]), x, (begun, middle, ended), upright, mine(grid.steps))
        path.append(x)
    return path


def stacked(rows: Sequence[Any], shape: tuple[int, ...]) -> np.ndarray:
    """Rows of which some may be the same for all columns, or numbers, in one array ``(len(rows), *shape)``."""
    out = np.empty((len(rows), *shape), dtype=np.result_type(float, *rows))
    for i, row in enumerate(rows):
        out[i] = row
    return out


def _upright(p: Sequence[Any]) -> list[Any]:
    """Parameters against rows ``(c, K)``: those with a value a column as ``(c, 1)``."""
    return [value[:, None] if np.ndim(value) else value for value in p]
