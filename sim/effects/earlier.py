"""What a channel showed at earlier times, for sensors that read late."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from sim.maths.elementary import trailing

APERTURE = 0.001  # s; a jump that meets a sample is spread over it, as cells do for a delayed input


def each_run_earlier(steps: Any, begin: Any, end: Any, shown: Callable[..., Any], *values: Any) -> tuple[np.ndarray, np.ndarray]:
    """Values at the times ``shown(edges, *values)``, for a channel that runs straight from ``begin`` to ``end`` of each sub-step.

    ``begin`` ``(M + 1, ...)``, ``end`` ``(M, ...)`` and ``steps`` ``(M,)`` as in ``SensorEffect.act``; ``values`` broadcast with the batch
    axes, and runs in which they are alike are worked out together. ``edges`` ``(M + 1,)`` count from the record's start, s. Before the start
    the first value holds. Just before an edge at which the channel jumps (within ``APERTURE``) the value goes over linearly from that before
    the jump to that after it, so that the outputs are continuous in the time that is shown.
    """
    begin, end, steps = np.asarray(begin), np.asarray(end), np.asarray(steps)
    given = [np.asarray(value) for value in values]
    shape = np.broadcast_shapes(*(value.shape for value in given), begin.shape[1:], end.shape[1:])
    begin, end = (np.broadcast_to(trailing(row, len(shape)), (len(row), *shape)).reshape(len(row), -1) for row in (begin, end))
    runs = [np.broadcast_to(value, shape).reshape(-1) for value in given]
    edges = np.concatenate([[0.0], np.cumsum(steps)])
    out = np.empty((2, *begin.shape), dtype=np.result_type(begin, end, *given))
    groups: dict[tuple[Any, ...], list[int]] = {}
    for column, run in enumerate(zip(*(row.tolist() for row in runs), strict=True)):
        groups.setdefault(run, []).append(column)
    for run, alike in groups.items():  # most runs are alike in a batch of differences
        out[0][:, alike], out[1][:, alike] = _earlier(edges, steps, begin[:, alike], end[:, alike], shown(edges, *run))
    return out[0].reshape(-1, *shape), out[1, 1:].reshape(-1, *shape)


def _earlier(edges: np.ndarray, steps: np.ndarray, begin: np.ndarray, end: np.ndarray, then: Any) -> tuple[np.ndarray, np.ndarray]:
    """Runs ``(M + 1, c)`` and ``(M, c)`` at the times ``then (M + 1,)``, none after the end: just after and just before each of them."""
    then = np.where(then.real > edges[-1], edges[-1], then)
    # Each earlier time lies in sub-step k, its end included; before the first sub-step k = -1.
    k = np.searchsorted(edges, then.real, side="left") - 1
    inside, k = (k >= 0)[:, None], np.maximum(k, 0)
    gap = (edges[k + 1] - then)[:, None]
    after, before = begin[k + 1], end[k]
    ramp = gap * ((end - begin[:-1]) / steps[:, None])[k]
    aperture = np.minimum(APERTURE, steps[k])[:, None]
    spread = np.where(gap.real < aperture, after - ramp - gap / aperture * (after - before), before - ramp)
    first = begin[:1]
    return np.where(inside, spread, first), np.where(inside, before - ramp, first)
