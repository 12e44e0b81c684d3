"""Shifts and edges in time that effects share: earlier values, smooth onsets, shifted inputs."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from sim.maths import clip, once_for_alike, trailing

# ---- What a channel showed at earlier times, for sensors that read late

APERTURE = 0.001  # s; a jump that meets a sample is spread over it, as cells do for a delayed input


def each_run_earlier(
    steps: Any, begin: Any, end: Any, shown: Callable[..., Any], *values: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Values at the times ``shown(edges, *values)``, for a channel that runs straight from
    ``begin`` to ``end`` of each sub-step.

    ``begin`` ``(M + 1, ...)``, ``end`` ``(M, ...)`` and ``steps`` ``(M,)`` as in
    ``SensorEffect.act``; ``values`` broadcast with the batch axes, and runs in which they are alike
    are worked out together. ``edges`` ``(M + 1,)`` count from the record's start, s. Before the
    start the first value holds. Just before an edge at which the channel jumps (within
    ``APERTURE``) the value goes over linearly from that before the jump to that after it, so that
    the outputs are continuous in the time that is shown.
    """
    begin, end, steps = np.asarray(begin), np.asarray(end), np.asarray(steps)
    given = [np.asarray(value) for value in values]
    shape = np.broadcast_shapes(*(value.shape for value in given), begin.shape[1:], end.shape[1:])
    begin, end = (
        np.broadcast_to(trailing(row, len(shape)), (len(row), *shape)).reshape(len(row), -1)
        for row in (begin, end)
    )
    runs = [np.broadcast_to(value, shape).reshape(-1) for value in given]
    edges = np.concatenate([[0.0], np.cumsum(steps)])
    out = np.empty((2, *begin.shape), dtype=np.result_type(begin, end, *given))
    groups: dict[tuple[Any, ...], list[int]] = {}
    for column, run in enumerate(zip(*(row.tolist() for row in runs), strict=True)):
        groups.setdefault(run, []).append(column)
    for run, alike in groups.items():  # most runs are alike in a batch of differences
        out[0][:, alike], out[1][:, alike] = _earlier(
            edges, steps, begin[:, alike], end[:, alike], shown(edges, *run)
        )
    return out[0].reshape(-1, *shape), out[1, 1:].reshape(-1, *shape)


def _earlier(
    edges: np.ndarray, steps: np.ndarray, begin: np.ndarray, end: np.ndarray, then: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Runs ``(M + 1, c)`` and ``(M, c)`` at the times ``then (M + 1,)``, none after the end: just
    after and just before each of them.
    """
    then = np.where(then.real > edges[-1], edges[-1], then)
    # Each earlier time lies in sub-step k, its end included; before the first sub-step k = -1.
    k = np.searchsorted(edges, then.real, side="left") - 1
    inside, k = (k >= 0)[:, None], np.maximum(k, 0)
    gap = (edges[k + 1] - then)[:, None]
    after, before = begin[k + 1], end[k]
    ramp = gap * ((end - begin[:-1]) / steps[:, None])[k]
    aperture = np.minimum(APERTURE, steps[k])[:, None]
    spread = np.where(
        gap.real < aperture, after - ramp - gap / aperture * (after - before), before - ramp
    )
    first = begin[:1]
    return np.where(inside, spread, first), np.where(inside, before - ramp, first)


# ---- Events at a time

WIDTH = 0.01  # s, one usual sub-step
SLOW_WIDTH = 0.1  # s, for bodies that are tracked over minutes


def risen(time: Any, at: Any, width: float) -> Any:
    """0 before the event at time ``at``, 1 after it, a straight ramp of ``width`` s centred on it
    between.

    Integrated in sub-steps of which ``width`` is a whole multiple, its area does not depend on how
    ``at`` lies between them.
    """
    return once_for_alike(lambda at: clip((time - at) / width + 0.5, 0.0, 1.0), at)


def edge_width(interval: float, usual: float = WIDTH) -> float:
    """The whole fraction of a sampling interval that is nearest below ``usual``: the sub-step of a
    fit that steps by at most that.
    """
    return interval / max(1, math.ceil(interval / usual - 1e-6)) if interval > 0 else usual


# ---- An input moved along the time axis, on cells that hold its means


def moved_back(edges: np.ndarray, u: np.ndarray, delay: Any) -> np.ndarray:
    """Means of u(t - delay) over each cell, exact for an input that is constant within cells;
    before the first edge its first value holds.

    A cell moved back by the delay starts in cell j and ends in cell k. Its mean is u[k] plus what
    the cells before k differ from it, so that a delay of zero returns u itself. On a cell's edge
    the derivative is the one towards longer delays.

    Parameters
    ----------
    edges : ``(n + 1,)`` s, increasing. u : ``(n,)``. delay : s, not negative; may be complex.
    """
    width, last = np.diff(edges), len(u) - 1
    area = np.concatenate([np.zeros(1), np.cumsum(u * width)])
    cell = np.searchsorted(edges, edges - delay.real, side="left") - 1
    j, k = np.clip(cell[:-1], -1, last), np.clip(cell[1:], -1, last)
    first, final = u[np.maximum(j, 0)], np.maximum(k, 0)
    at_final = u[final]
    next_edge = edges[j + 1]
    between = area[final] - area[j + 1] - at_final * (edges[final] - next_edge)
    excess = between + (first - at_final) * (next_edge - (edges[:-1] - delay))
    return np.asarray(at_final + np.where(k > j, excess, 0.0) / width)


def moved_ahead(edges: np.ndarray, u: np.ndarray, delay: Any) -> np.ndarray:
    """Means of u(t + delay), as ``moved_back`` with the time reversed: behind the last edge the
    last value holds.
    """
    return moved_back(-edges[::-1], u[::-1], delay)[::-1]
