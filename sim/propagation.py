"""Propagation of a System: time grid, integrators, exact motion of linear systems, LSODA.

Nodes are the record's samples, with further ones put into gaps so that node intervals differ
little; every node interval is cut into the same number of sub-steps, which keeps whole-record
algorithms rectangular. Cells subdivide sub-steps; effects with memory act on the mean of the input
over a cell.

x' = A x + B u(t) + c gives x(t + h) = e^{A h} x(t) + integral over s in 0..h of e^{A (h - s)} (B
u(t + s) + c), the integral by Gauss's rule (Golub and Van Loan, Matrix Computations, 4th ed.,
section 9.3).

Source: L. Petzold, Automatic selection of methods for solving stiff and nonstiff systems of
ordinary differential equations, SIAM J. Sci. Stat. Comput. 4 (1983) 136-148, as SciPy's `odeint`
carries it.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.declaration.model import System
from sim.errors import RecordError
from sim.maths import trailing
from sim.record import Hold

# ---- The time grid of a simulation

INPUT_CELL_TIME = 0.001
MOST_STEPS = 20_000_000  # most steps of a simulation, some 100 bytes and a microsecond each
# most cells of a sub-step: longer ones than half a second belong to motion over minutes
MOST_CELLS = 500


@dataclass(frozen=True, eq=False)
class Grid:
    """Time grid of a simulation.

    Attributes
    ----------
    nodes : ``(K + 1,)`` s.
    substeps : sub-steps in each node interval.
    steps : ``(M,)`` sub-step sizes, ``M = K * substeps``, s.
    edges : ``(M + 1,)`` boundaries of the sub-steps, s; nodes are met exactly.
    sample : ``(N,)`` index into ``edges`` of each record sample.
    source : ``(M,)`` record row whose held input acts during the sub-step.
    """

    nodes: np.ndarray
    substeps: int
    steps: np.ndarray
    edges: np.ndarray
    sample: np.ndarray
    source: np.ndarray


def make_grid(time: np.ndarray, max_step: float) -> Grid:
    """Grid for record times ``(N,)`` with sub-steps of at most ``max_step`` s.

    Raises RecordError where that takes more than ``MOST_STEPS`` of them.
    """
    with np.errstate(over="ignore"):  # of times at the ends of the range of floats
        gaps = np.diff(time)
    usual = float(np.median(gaps))
    counted = np.maximum(1, np.ceil(gaps / (1.5 * usual) - 1e-9))
    refuse_endless(
        float(counted.sum()) * max(1.0, float(gaps.max() / counted[np.argmax(gaps)]) / max_step),
        gaps,
        max_step,
    )
    pieces = counted.astype(int)
    first = np.repeat(np.cumsum(pieces) - pieces, pieces)
    within = (np.arange(len(first)) - first) / np.repeat(pieces, pieces)
    nodes = np.append(np.repeat(time[:-1], pieces) + np.repeat(gaps, pieces) * within, time[-1])
    intervals = np.diff(nodes)
    substeps = max(1, math.ceil(float(intervals.max()) / max_step - 1e-6))
    steps = np.repeat(intervals / substeps, substeps)
    edges = np.append(
        (nodes[:-1, None] + intervals[:, None] * np.arange(substeps) / substeps).ravel(), nodes[-1]
    )
    sample = np.concatenate([[0], np.cumsum(pieces)]) * substeps
    source = np.repeat(np.arange(len(gaps)), pieces * substeps)
    return Grid(nodes, substeps, steps, edges, sample, source)


def refuse_endless(count: float, gaps: np.ndarray, max_step: float) -> None:
    """Raise RecordError where intervals ``gaps``, s, take more than ``MOST_STEPS`` steps; ``count``
    is how many.
    """
    if count > MOST_STEPS:
        problem = (
            f"samples {gaps.min():.3g} to {gaps.max():.3g} s apart take {count:.2g} steps of "
            f"{max_step:.2g} s or less"
        )
        raise RecordError(
            problem,
            where="column time",
            remedy="check the unit of the times, or read a part of them with --from and --to",
        )


@dataclass(frozen=True, eq=False)
class Drive:
    """Inputs at the vehicle, one row an input, batch axes trailing.

    ``stages`` are the inputs at the beginning, middle and end of each sub-step as the integrator
    sees them, each ``(M, ...)``; ``begin`` ``(M + 1, ...)`` and ``end`` ``(M, ...)`` are those that
    act on the outputs directly, ``begin`` just after a sample's switch, ``end`` just before the
    next.
    """

    stages: tuple[list[Any], list[Any], list[Any]]
    begin: list[Any]
    end: list[Any]


def drive_from_record(
    system: System, p: Any, u: np.ndarray, time: np.ndarray, hold: Hold, grid: Grid
) -> Drive:
    """Inputs at the vehicle for a record's inputs ``u (n_inputs, N)``, through the input path.

    Without input-path effects held inputs pass unchanged and linear ones are exact at the stages.
    """
    if not system.input_stages:
        return recorded_drive(u, time, hold, grid)
    rows = list(u)
    if hold is Hold.PREVIOUS:
        source = np.repeat(np.append(grid.source, len(time) - 1), _cells_per_step(grid))
        return drive_from_cells(system, p, [row[source] for row in rows], cell_edges(grid), grid)
    return _changed_by_input_path(recorded_drive(u, time, hold, grid), system, p, rows, time, grid)


def recorded_drive(u: np.ndarray, time: np.ndarray, hold: Hold, grid: Grid) -> Drive:
    """Return a record's inputs ``u (n_inputs, N)`` as they are: held ones unchanged, linear ones
    exact at the stages.
    """
    if hold is Hold.PREVIOUS:
        inputs = [row[grid.source] for row in u]
        return Drive(
            (inputs, inputs, inputs),
            [np.append(h, row[-1]) for h, row in zip(inputs, u, strict=True)],
            inputs,
        )
    begin = [np.interp(grid.edges, time, row) for row in u]
    middle = [0.5 * (b[:-1] + b[1:]) for b in begin]
    return Drive(
        ([b[:-1] for b in begin], middle, [b[1:] for b in begin]), begin, [b[1:] for b in begin]
    )


def drive_from_means(
    rows: list[np.ndarray], begin: list[np.ndarray], end: list[np.ndarray]
) -> Drive:
    """Inputs given as means over each sub-step and values at its two ends."""
    return Drive((rows, rows, rows), begin, end)


def cell_edges(grid: Grid) -> np.ndarray:
    """Boundaries of the cells that input-path effects act on, s: ``INPUT_CELL_TIME`` or less where
    sub-steps are short, these met exactly.

    One further sub-step after the last sample gives the feed-through there.
    """
    steps = np.append(grid.steps, grid.steps[-1])
    per_step = _cells_per_step(grid)
    return np.append(
        (grid.edges[:, None] + steps[:, None] * np.arange(per_step) / per_step).ravel(),
        grid.edges[-1] + steps[-1],
    )


def drive_from_cells(
    system: System, p: Any, cells: list[Any], edges: np.ndarray, grid: Grid
) -> Drive:
    """Inputs at the vehicle for means ``(n_cells, ...)`` over the cells between ``edges =
    cell_edges(grid)``, through the input path.
    """
    split = [_by_step(row, grid) for row in system.input_path(p, cells, edges)]
    means = [_mean(row[:-1]) for row in split]
    return Drive(
        (means, means, means), [row[:, 0] for row in split], [row[:-1, -1] for row in split]
    )


def _cells_per_step(grid: Grid) -> int:
    return min(max(1, math.ceil(float(grid.steps.max()) / INPUT_CELL_TIME - 1e-6)), MOST_CELLS)


def _by_step(row: Any, grid: Grid) -> np.ndarray:
    row = np.asarray(row)
    return row.reshape((len(grid.edges), -1) + row.shape[1:])


def _mean(split: np.ndarray) -> np.ndarray:
    # Equal cells give their value and no rounding: an effect that is absent then changes nothing.
    return split[:, 0] + (split - split[:, :1]).mean(axis=1)


def _changed_by_input_path(
    linear: Drive, system: System, p: Any, rows: list[Any], time: np.ndarray, grid: Grid
) -> Drive:
    # Cells hold means only. The input path's change is added to the linear input.
    edges = cell_edges(grid)
    cells = [0.5 * (a[:-1] + a[1:]) for a in (_prolonged(edges, time, row) for row in rows)]
    acted = system.input_path(p, cells, edges)
    start, middle, end = ([*stage] for stage in linear.stages)
    begin, last = [*linear.begin], [*linear.end]
    for i, (before, after) in enumerate(zip(cells, acted, strict=True)):
        if after is before:  # no effect acts on this input
            continue
        change = _by_step(after - trailing(before, np.ndim(after) - 1), grid)
        mean = _mean(change[:-1])
        for rows, added in (
            (start, mean),
            (middle, mean),
            (end, mean),
            (begin, change[:, 0]),
            (last, change[:-1, -1]),
        ):
            rows[i] = trailing(rows[i], added.ndim - 1) + added
    return Drive((start, middle, end), begin, last)


def _prolonged(edges: np.ndarray, time: np.ndarray, row: np.ndarray) -> np.ndarray:
    # The feed-through of the last sample is extrapolated.
    further = row[-1] + (row[-1] - row[-2]) / (time[-1] - time[-2]) * (edges[-1] - time[-1])
    return np.interp(edges, np.append(time, edges[-1]), np.append(row, further))


# ---- Integrators and the simulation of a System

Rates = Callable[[Any, Sequence[Any], Sequence[Any], Sequence[Any]], list[Any]]
Stages = tuple[Sequence[Any], Sequence[Any], Sequence[Any]]
Step = Callable[[Rates, Any, Sequence[Any], Stages, Sequence[Any], Any], list[Any]]


def euler_step(
    f: Rates, t: Any, x: Sequence[Any], u: Stages, p: Sequence[Any], dt: Any
) -> list[Any]:
    """One explicit Euler step of size ``dt``; order 1. ``u`` are inputs at begin, middle, end."""
    return [value + dt * rate for value, rate in zip(x, f(t, x, u[0], p), strict=True)]


def rk4_step(f: Rates, t: Any, x: Sequence[Any], u: Stages, p: Sequence[Any], dt: Any) -> list[Any]:
    """Return one classical Runge-Kutta step of size ``dt``; order 4. ``u`` are inputs at begin,
    middle, end.
    """
    half = 0.5 * dt
    k1 = f(t, x, u[0], p)
    k2 = f(t + half, [a + half * b for a, b in zip(x, k1, strict=True)], u[1], p)
    k3 = f(t + half, [a + half * b for a, b in zip(x, k2, strict=True)], u[1], p)
    k4 = f(t + dt, [a + dt * b for a, b in zip(x, k3, strict=True)], u[2], p)
    sixth = dt / 6.0
    return [
        a + sixth * (b + 2.0 * (c + d) + e) for a, b, c, d, e in zip(x, k1, k2, k3, k4, strict=True)
    ]


def propagate(
    system: System,
    p: Sequence[Any],
    x0: Sequence[Any],
    drive: Drive,
    grid: Grid,
    step: Step = rk4_step,
) -> list[np.ndarray]:
    """States at all sub-step edges: one array ``(M + 1, ...)`` a state.

    ``p`` and ``x0`` are rows; batch axes of their entries, and of the drive, trail. A state that
    grows without limit, or comes to where its rates are not defined, is returned as it is
    (infinite), for the caller to judge.
    """
    f, steps, times = system.f, grid.steps.tolist(), grid.edges.tolist()
    shape = np.broadcast_shapes(
        *(np.shape(v) for v in [*p, *x0]), *(np.shape(u)[1:] for u in drive.begin)
    )
    complex_ = any(np.iscomplexobj(v) for v in [*p, *x0, *drive.begin])
    if shape == ():
        p, x = _scalars(p), _scalars(x0)
    else:
        p, x = list(p), [np.broadcast_to(v, shape) for v in x0]
    stages = [[_per_step(row) for row in stage] for stage in drive.stages]
    history = np.empty((len(x), len(steps) + 1, *shape), dtype=complex if complex_ else float)
    history[:, 0] = x
    with np.errstate(over="ignore", invalid="ignore"):
        for m, dt in enumerate(steps):
            u = (
                [row[m] for row in stages[0]],
                [row[m] for row in stages[1]],
                [row[m] for row in stages[2]],
            )
            try:
                x = step(f, times[m], x, u, p, dt)
            except (OverflowError, ZeroDivisionError):
                history[:, m + 1 :] = np.inf
                break
            for i, value in enumerate(x):
                history[i, m + 1] = value
    return list(history)


def outputs_at_samples(
    system: System, p: Sequence[Any], states: Sequence[np.ndarray], drive: Drive, grid: Grid
) -> list[np.ndarray]:
    """Outputs at the record's samples, ``(N, ...)`` a row, from states at all sub-step edges.

    Only the samples are evaluated when no sensor has memory; else both ends of every sub-step.
    States without limit give outputs that are not finite, without a warning.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        if not system.sensor_stages:
            at = grid.sample
            return _outputs(
                system,
                p,
                grid.edges[at],
                [row[at] for row in states],
                [row[at] for row in drive.begin],
            )
        begin = _outputs(system, p, grid.edges, list(states), drive.begin)
        end = _outputs(system, p, grid.edges[1:], [row[1:] for row in states], drive.end)
        begin, _ = system.sensor_path(p, begin, end, grid.steps)
        return [row[grid.sample] for row in begin]


def simulate(
    system: System,
    p: Sequence[Any],
    x0: Sequence[Any],
    drive: Drive,
    grid: Grid,
    step: Step = rk4_step,
) -> list[np.ndarray]:
    """Outputs at the record's samples, one array ``(N, ...)`` an output."""
    return outputs_at_samples(system, p, propagate(system, p, x0, drive, grid, step), drive, grid)


def _scalars(values: Sequence[Any]) -> list[Any]:
    return [complex(v) if np.iscomplexobj(v) else float(v) for v in values]


def _per_step(row: Any) -> Any:
    return row.tolist() if np.ndim(row) == 1 else row


def _outputs(
    system: System, p: Sequence[Any], times: np.ndarray, x: Sequence[Any], u: Sequence[Any]
) -> list[np.ndarray]:
    """Outputs at many times at once, each ``(n, ...)``: time leads, batch axes trail."""
    batch = np.broadcast_shapes(*(np.shape(r)[1:] for r in [*x, *u]), *(np.shape(v) for v in p))
    depth = len(batch)
    rows = [trailing(row, depth) for row in [*x, *u]]
    y = system.h(
        trailing(times, depth),
        rows[: len(x)],
        rows[len(x) :],
        [np.asarray(v)[None] if np.ndim(v) else v for v in p],
    )
    return [
        np.broadcast_to(trailing(np.asarray(value), depth), (len(times), *batch))
        if np.ndim(value)
        else np.full((len(times), *batch), value)
        for value in y
    ]


# ---- Exact motion of a system that is linear

Inputs = Callable[[np.ndarray], list[np.ndarray]]

_GAUSS_NODES = 8  # nodes of Gauss's rule: exact for polynomials up to degree 15
_NODE_SPACING = 0.05  # s at most, so that inputs of some ten hertz are met to rounding
_AFFINE_TOLERANCE = 1e-11  # largest difference from A x + B u + c, relative to its terms
_SAME_STEP_TOLERANCE = 1e-12  # s: intervals that differ by less are the same


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
    system: System,
    p: Sequence[float],
    x0: Sequence[float],
    inputs: Inputs,
    breaks: Sequence[float],
    time: np.ndarray,
) -> np.ndarray | None:
    """States ``(n, N)`` at ``time``, exact to rounding; None where the system is not linear with
    constant coefficients along this motion.

    ``inputs`` gives each input at times (s), a row an input; ``breaks`` are the times at which one
    may jump or bend. That the rates are those of ``A x + B u + c`` is found by evaluating them at
    rest and seen to hold at every point of the rule, so no declaration is needed.
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
    """Return the coefficients from the rates at zero and at one unit of each state and input; None
    where they are not finite.
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
    return np.array(
        [np.broadcast_to(row, count) for row in system.f(t, list(x), list(u), list(p))], dtype=float
    ).reshape(len(x), count)


def _edges(
    time: np.ndarray, breaks: Sequence[float], A: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Sample times and breaks in order, long intervals cut, and where the samples are among
    them.
    """
    inside = np.asarray([at for at in breaks if time[0] < at < time[-1]], dtype=float)
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
    """States ``(n, K + 1)`` at the edges for inputs ``u (m, nodes, K)``."""
    from scipy.linalg import expm  # imported late: it takes longer than a flight

    _, first, which = np.unique(
        np.round(lengths / _SAME_STEP_TOLERANCE), return_index=True, return_inverse=True
    )
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


def _is_affine_along(
    system: System, p: Sequence[float], affine: Affine, t: np.ndarray, x: np.ndarray, u: np.ndarray
) -> bool:
    """Return whether the rates are those of the coefficients everywhere along the motion."""
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

# relative tolerance of a step; the error of a flight is then below 1e-9 of its motion
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
    """States ``(n, N)`` at ``time``; None where the solver cannot keep its tolerance or the rates
    are not defined.

    ``stretch(begin, end)`` gives the inputs between two ``breaks`` (s), the times at which one may
    jump or bend. No step is longer than the usual sample interval, so that what acts for longer
    than that is not stepped over.
    """
    # imported late: it takes longer than a flight
    from scipy.integrate import ODEintWarning, odeint

    ends = [*(at for at in breaks if time[0] + 1e-9 < at < time[-1] - 1e-9), float(time[-1])]
    usual = float(np.median(np.diff(time)))
    states = np.empty((len(x0), len(time)))
    states[:, 0] = x = np.asarray(x0, dtype=float)
    begin, done, fixed = float(time[0]), 1, list(p)
    for end in ends:
        u, last = stretch(begin, end), int(np.searchsorted(time, end + 1e-9))
        at = np.concatenate(
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
                way = odeint(
                    rates,
                    x,
                    at,
                    tfirst=True,
                    rtol=RELATIVE_TOLERANCE,
                    atol=ABSOLUTE_TOLERANCE,
                    tcrit=[end],
                    hmax=usual,
                    mxstep=_MOST_STEPS,
                )
        except (ArithmeticError, ODEintWarning, ValueError):
            return None
        if not np.all(np.isfinite(way)):
            return None
        states[:, done:last] = way[1 : 1 + last - done].T
        begin, done, x = end, last, way[-1]
    return states
