"""Exact motion of a system that is linear: matrix exponentials between samples, without a step to choose.

x' = A x + B u(t) + c gives x(t + h) = e^{A h} x(t) + integral over s in 0..h of e^{A (h - s)} (B u(t + s) + c), the integral by Gauss's rule
(Golub and Van Loan, Matrix Computations, 4th ed., section 9.3).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.declaration.system import System
from sim.propagation.grid import refuse_endless

Inputs = Callable[[np.ndarray], list[np.ndarray]]

_NODES = 8  # of Gauss's rule: exact for polynomials up to degree 15
_LONGEST = 0.05  # s between them at most, so that inputs of some ten hertz are met to rounding
_AFFINE = 1e-11  # of the size of the terms: what a system may differ from A x + B u + c along its motion
_LENGTHS = 1e-12  # s: intervals that differ by less are the same


@dataclass(frozen=True, eq=False)
class Affine:
    """Rates ``A x + B u + c``: ``A (n, n)``, ``B (n, m)``, ``c (n,)``, constant in time."""

    A: np.ndarray
    B: np.ndarray
    c: np.ndarray

    def rates(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Rates ``(n, N)`` for states ``(n, N)`` and inputs ``(m, N)``."""
        return self.A @ x + self.B @ u + self.c[:, None]


def exact_motion(
    system: System, p: Sequence[float], x0: Sequence[float], inputs: Inputs, breaks: Sequence[float], time: np.ndarray
) -> np.ndarray | None:
    """States ``(n, N)`` at ``time``, exact to rounding; None where the system is not linear with constant coefficients along this motion.

    ``inputs`` gives each input at times (s), a row an input; ``breaks`` are the times at which one may jump or bend. That the rates are
    those of ``A x + B u + c`` is found by evaluating them at rest and seen to hold at every point of the rule, so no declaration is needed.
    """
    n, m = len(x0), len(system.inputs)
    with np.errstate(all="ignore"):
        affine = _at_rest(system, p, float(time[0]), n, m)
        if affine is None:
            return None
        edges, sample = _edges(time, breaks, affine.A)
        node, weight = np.polynomial.legendre.leggauss(_NODES)
        share, lengths = 0.5 * (1.0 + node), np.diff(edges)
        times = edges[:-1] + lengths * share[:, None]
        u = np.array([np.broadcast_to(row, times.size) for row in inputs(times.ravel())], dtype=float).reshape(m, *times.shape)
        x = _carried(affine, np.asarray(x0, dtype=float), u, lengths, share, weight)
        between = x[:, None, :-1] + share[:, None] * np.diff(x)[:, None, :]
        flat_x, flat_u = between.reshape(n, times.size), u.reshape(m, times.size)
        if not np.all(np.isfinite(x)) or not _holds(system, p, affine, times.ravel(), flat_x, flat_u):
            return None
    return x[:, sample]


def _at_rest(system: System, p: Sequence[float], begin: float, n: int, m: int) -> Affine | None:
    """Coefficients from the rates at zero and at one unit of each state and input; None where they are not finite."""
    rows = list(np.eye(n + m, n + m + 1, 1))
    try:
        found = _rates(system, p, begin, rows[:n], rows[n:], n + m + 1)
    except (ArithmeticError, ValueError, TypeError):
        return None
    change = found[:, 1:] - found[:, :1]
    return Affine(change[:, :n], change[:, n:], found[:, 0]) if np.all(np.isfinite(found)) else None


def _rates(system: System, p: Sequence[float], t: Any, x: Sequence[np.ndarray], u: Sequence[np.ndarray], count: int) -> np.ndarray:
    return np.array([np.broadcast_to(row, count) for row in system.f(t, list(x), list(u), list(p))], dtype=float).reshape(len(x), count)


def _edges(time: np.ndarray, breaks: Sequence[float], A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sample times and breaks in order, long intervals cut, and where the samples are among them."""
    inside = np.asarray([at for at in breaks if time[0] < at < time[-1]], dtype=float)
    if len(inside):
        nearest = np.clip(np.searchsorted(time, inside), 1, len(time) - 1)
        inside = inside[np.minimum(inside - time[nearest - 1], time[nearest] - inside) > 1e-9]
    edges = np.unique(np.concatenate([time, inside]))
    longest = min(_LONGEST, 2.0 / max(float(np.abs(np.linalg.eigvals(A)).max(initial=0.0)), 1e-300))
    counted = np.maximum(1, np.ceil(np.diff(edges) / longest - 1e-9))
    refuse_endless(float(counted.sum()), np.diff(edges), longest)
    pieces = counted.astype(int)
    if np.any(pieces > 1):
        first = np.repeat(np.cumsum(pieces) - pieces, pieces)
        share = (np.arange(len(first)) - first) / np.repeat(pieces, pieces)
        edges = np.append(np.repeat(edges[:-1], pieces) + np.repeat(np.diff(edges), pieces) * share, edges[-1])
    return edges, np.searchsorted(edges, time)


def _carried(affine: Affine, x0: np.ndarray, u: np.ndarray, lengths: np.ndarray, share: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """States ``(n, K + 1)`` at the edges for inputs ``u (m, nodes, K)``."""
    from scipy.linalg import expm  # imported late: it takes longer than a flight

    _, first, which = np.unique(np.round(lengths / _LENGTHS), return_index=True, return_inverse=True)
    different = lengths[first]
    forcing = np.einsum("im,mjk->jki", affine.B, u) + affine.c
    added = np.empty((len(lengths), len(x0)))
    over = np.empty((len(different), len(x0), len(x0)))
    for k, h in enumerate(different):
        to_end = expm(affine.A * (h * np.append(1.0 - share, 1.0))[:, None, None])
        mine, over[k] = which == k, to_end[-1]
        added[mine] = np.einsum("j,jab,jkb->ka", 0.5 * h * weight, to_end[:-1], forcing[:, mine])
    x = np.empty((len(lengths) + 1, len(x0)))
    x[0] = state = x0
    for k, at in enumerate(which.tolist()):
        x[k + 1] = state = over[at] @ state + added[k]
    return x.T


def _holds(system: System, p: Sequence[float], affine: Affine, t: np.ndarray, x: np.ndarray, u: np.ndarray) -> bool:
    """Whether the rates are those of the coefficients everywhere along the motion."""
    try:
        said = _rates(system, p, t, list(x), list(u), len(t))
    except (ArithmeticError, ValueError, TypeError):
        return False
    size = np.abs(affine.A) @ np.abs(x).max(axis=1, initial=0.0) + np.abs(affine.B) @ np.abs(u).max(axis=1, initial=0.0) + np.abs(affine.c)
    return bool(np.all(np.abs(said - affine.rates(x, u)) <= _AFFINE * size[:, None]))
