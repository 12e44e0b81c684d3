"""An input moved along the time axis, on cells that hold its means."""

from __future__ import annotations

from typing import Any

import numpy as np


def moved_back(edges: np.ndarray, u: np.ndarray, delay: Any) -> np.ndarray:
    """Means of u(t - delay) over each cell, exact for an input that is constant within cells; before the first edge its first value holds.

    A cell moved back by the delay starts in cell j and ends in cell k. Its mean is u[k] plus what the cells before k differ
    from it, so that a delay of zero returns u itself. On a cell's edge the derivative is the one towards longer delays.

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
    """Means of u(t + delay), as ``moved_back`` with the time reversed: behind the last edge the last value holds."""
    return moved_back(-edges[::-1], u[::-1], delay)[::-1]
