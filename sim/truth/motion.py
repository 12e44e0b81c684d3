"""Motion of a System for a truth: exact for linear systems, else to a tolerance by LSODA.

x' = A x + B u(t) + c gives x(t + h) = e^{A h} x(t) + integral over s in 0..h of e^{A (h - s)} (B
u(t + s) + c). The integral is computed by Gauss's rule (Golub and Van Loan, Matrix Computations,
4th ed., section 9.3).

LSODA is that of SciPy's `odeint`: L. Petzold, Automatic selection of methods for solving stiff and
nonstiff systems of ordinary differential equations, SIAM J. Sci. Stat. Comput. 4 (1983) 136-148.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.declaration.model import System
from sim.propagation import refuse_endless

# ---- Exact motion of a linear system

Inputs = Callable[[np.ndarray], list[np.ndarray]]

_GAUSS_NODES = 8  # nodes of Gauss's rule: exact for polynomials up to degree 15
_NODE_SPACING = 0.05  # s, longest interval of the rule: inputs up to some 10 Hz are then exact
_AFFINE_TOLERANCE = 1e-11  # largest difference from A x + B u + c, relative to its terms
_SAME_STEP_TOLERANCE = 1e-12  # s: intervals that differ by less are the same


@dataclass(frozen=True, eq=False)
class Affine:
    """Rates ``A x + B u + c``: ``A (n, n)``, ``B (n, m)``, ``c (n,)``, constant in time."""

    A: np.ndarray
    B: np.ndarray
    c: np.ndarray

    def rates(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the rates ``(n, N)`` for states ``(n, N)`` and inputs ``(m, N)``."""
        return self.A @ x + self.B @ u + self.c[:, None]


def exact_motion(
    system: System,
    p: Sequence[float],
    x0: Sequence[float],
    inputs: Inputs,
    breaks: Sequence[float],
    time: np.ndarray,
) -> np.ndarray | None:
    """Return the states ``(n, N)`` of a linear system, exact to rounding.

    The result is None if the rates are not ``A x + B u + c`` with constant coefficients. The
    coefficients follow from the rates at rest; whether they hold is tested at every point of the
    integration rule. So a model need not declare that it is linear.

    Parameters
    ----------
    p, x0 : parameters and initial states.
    inputs : function of times (s) that returns a row of values for each input.
    breaks : times (s) at which an input or its slope may jump.
    time : ``(N,)``, s.
    """
    n, m = len(x0), len(system.inputs)
    with np.errstate(all="ignore"):
        affine = _at_rest(system, p, float(time[0]), n, m)
        if affine is None:
            return None
        edges, sample = _edges(time, breaks, affine.A)
        node, weight = np.polynomial.legendre.leggauss(_GAUSS_NODES)
        share, lengths = 0.5 * (1.0 + node), np.diff(edges)
        times = edges[:-1] + lengths * share[:, None]
        u = np.array(
            [np.broadcast_to(row, times.size) for row in inputs(times.ravel())], dtype=float
        ).reshape(m, *times.shape)
        x = _edge_states(affine, np.asarray(x0, dtype=float), u, lengths, share, weight)
        between = x[:, None, :-1] + share[:, None] * np.diff(x)[:, None, :]
        flat_x, flat_u = between.reshape(n, times.size), u.reshape(m, times.size)
        if not np.all(np.isfinite(x)) or not _is_affine_along(
            system, p, affine, times.ravel(), flat_x, flat_u
        ):
            return None
    return x[:, sample]


def _at_rest(system: System, p: Sequence[float], begin: float, n: int, m: int) -> Affine | None:
    """Return the coefficients of n states and m inputs; None if they are not finite.

    They follow from the rates at zero and at one unit of each state and input, at time ``begin``.
    """
    rows = list(np.eye(n + m, n + m + 1, 1))
    try:
        result = _rates(system, p, begin, rows[:n], rows[n:], n + m + 1)
    except (ArithmeticError, ValueError, TypeError):
        return None
    change = result[:, 1:] - result[:, :1]
    return (
        Affine(change[:, :n], change[:, n:], result[:, 0]) if np.all(np.isfinite(result)) else None
    )


def _rates(
    system: System,
    p: Sequence[float],
    t: Any,
    x: Sequence[np.ndarray],
    u: Sequence[np.ndarray],
    count: int,
) -> np.ndarray:
    """Return the rates ``(n, count)`` at ``count`` points."""
    return np.array(
        [np.broadcast_to(row, count) for row in system.f(t, list(x), list(u), list(p))], dtype=float
    ).reshape(len(x), count)


def _edges(
    time: np.ndarray, breaks: Sequence[float], A: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the edges of the integration intervals, s, and the indices of the samples in them.

    Edges are the samples and the breaks; long intervals are divided.
    """
    inside = np.asarray([instant for instant in breaks if time[0] < instant < time[-1]], float)
    if len(inside):
        nearest = np.clip(np.searchsorted(time, inside), 1, len(time) - 1)
        inside = inside[np.minimum(inside - time[nearest - 1], time[nearest] - inside) > 1e-9]
    edges = np.unique(np.concatenate([time, inside]))
    longest = min(
        _NODE_SPACING,
        2.0 / max(float(np.abs(np.linalg.eigvals(A)).max(initial=0.0)), 1e-300),
    )
    counted = np.maximum(1, np.ceil(np.diff(edges) / longest - 1e-9))
    refuse_endless(float(counted.sum()), np.diff(edges), longest)
    pieces = counted.astype(int)
    if np.any(pieces > 1):
        first = np.repeat(np.cumsum(pieces) - pieces, pieces)
        share = (np.arange(len(first)) - first) / np.repeat(pieces, pieces)
        edges = np.append(
            np.repeat(edges[:-1], pieces) + np.repeat(np.diff(edges), pieces) * share, edges[-1]
        )
    return edges, np.searchsorted(edges, time)


def _edge_states(
    affine: Affine,
    x0: np.ndarray,
    u: np.ndarray,
    lengths: np.ndarray,
    share: np.ndarray,
    weight: np.ndarray,
) -> np.ndarray:
    """Return the states ``(n, K + 1)`` at the edges of K intervals.

    Parameters
    ----------
    x0 : initial states.
    u : ``(m, nodes, K)``, inputs at the nodes of Gauss's rule.
    lengths : ``(K,)``, s, of the intervals.
    share, weight : position of the nodes in an interval, 0 to 1, and their weights.
    """
    from scipy.linalg import expm  # imported late: it takes longer than a flight

    _, first, which = np.unique(
        np.round(lengths / _SAME_STEP_TOLERANCE), return_index=True, return_inverse=True
    )
    different = lengths[first]
    forcing = np.einsum("im,mjk->jki", affine.B, u) + affine.c
    added = np.empty((len(lengths), len(x0)))
    transitions = np.empty((len(different), len(x0), len(x0)))
    for k, h in enumerate(different):
        to_end = expm(affine.A * (h * np.append(1.0 - share, 1.0))[:, None, None])
        same, transitions[k] = which == k, to_end[-1]
        added[same] = np.einsum("j,jab,jkb->ka", 0.5 * h * weight, to_end[:-1], forcing[:, same])
    x = np.empty((len(lengths) + 1, len(x0)))
    x[0] = state = x0
    for k, kind in enumerate(which.tolist()):
        x[k + 1] = state = transitions[kind] @ state + added[k]
    return x.T


def _is_affine_along(
    system: System, p: Sequence[float], affine: Affine, t: np.ndarray, x: np.ndarray, u: np.ndarray
) -> bool:
    """Return whether the rates agree with the coefficients at all points ``t``, ``x``, ``u`` of the
    motion.
    """
    try:
        rates = _rates(system, p, t, list(x), list(u), len(t))
    except (ArithmeticError, ValueError, TypeError):
        return False
    size = (
        np.abs(affine.A) @ np.abs(x).max(axis=1, initial=0.0)
        + np.abs(affine.B) @ np.abs(u).max(axis=1, initial=0.0)
        + np.abs(affine.c)
    )
    return bool(np.all(np.abs(rates - affine.rates(x, u)) <= _AFFINE_TOLERANCE * size[:, None]))


# ---- Motion to a tolerance by LSODA

InputsAt = Callable[[float], list[float]]
Stretch = Callable[[float, float], InputsAt]

# Relative tolerance of a step, for which the error of a flight is below 1e-9 of its motion.
RELATIVE_TOLERANCE = 1e-10
ABSOLUTE_TOLERANCE = 1e-12  # absolute tolerance of each state, SI
_MOST_STEPS = 5000  # most steps between two samples


def smooth_motion(
    system: System,
    p: Sequence[float],
    x0: Sequence[float],
    stretch: Stretch,
    breaks: Sequence[float],
    time: np.ndarray,
) -> np.ndarray | None:
    """Return the states ``(n, N)`` to the tolerance of LSODA.

    The result is None if the solver cannot keep its tolerance, or the rates are not defined. No
    step is longer than the median sampling interval, so that no event of this length is missed.

    Parameters
    ----------
    p, x0 : parameters and initial states.
    stretch : function of two times (s) that returns the inputs between them, as a function of time.
    breaks : times (s) at which an input or its slope may jump.
    time : ``(N,)``, s.
    """
    # imported late: it takes longer than a flight
    from scipy.integrate import ODEintWarning, odeint

    inner = (instant for instant in breaks if time[0] + 1e-9 < instant < time[-1] - 1e-9)
    ends = [*inner, float(time[-1])]
    usual = float(np.median(np.diff(time)))
    states = np.empty((len(x0), len(time)))
    states[:, 0] = x = np.asarray(x0, dtype=float)
    begin, done, fixed = float(time[0]), 1, list(p)
    for end in ends:
        u, last = stretch(begin, end), int(np.searchsorted(time, end + 1e-9))
        instants = np.concatenate(
            [[begin], time[done:last], [end]]
            if time[last - 1] < end
            else [[begin], time[done:last]]
        )

        def rates(t: float, x: np.ndarray, u: InputsAt = u) -> list[float]:
            return system.f(t, x.tolist(), u(t), fixed)

        try:
            with (
                warnings.catch_warnings(),
                np.errstate(over="raise", invalid="raise", divide="raise"),
            ):
                warnings.simplefilter("error", ODEintWarning)
                path = odeint(
                    rates,
                    x,
                    instants,
                    tfirst=True,
                    rtol=RELATIVE_TOLERANCE,
                    atol=ABSOLUTE_TOLERANCE,
                    tcrit=[end],
                    hmax=usual,
                    mxstep=_MOST_STEPS,
                )
        except (ArithmeticError, ODEintWarning, ValueError):
            return None
        if not np.all(np.isfinite(path)):
            return None
        states[:, done:last] = path[1 : 1 + last - done].T
        begin, done, x = end, last, path[-1]
    return states
