"""Many parameters that may vary, over many signals, ranked in one pass: what one costs beside the others is a product of two rows.

A parameter that changes by a small shape of a signal does in each interval what its constant change does there, times the shape's mean over the
interval. So one column a parameter is integrated, not one an instance and shape, and all are joined by one triangular solve.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np

from ident.estimate import counted_numerics
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.screening.places import Whitened, share_explained, whitened
from ident.tracing.screening.score_test import Finding, screen
from ident.whole_record.intervals import interval_ends, sample_outputs
from ident.whole_record.linearise import join_intervals
from ident.whole_record.record_problem import INCREMENT, RecordProblem, record_problem
from sim.declaration.effect import ParameterEffect, full_name
from sim.declaration.proposal import SearchContext, Traceable, fitted_to
from sim.propagation.grid import Drive


class Varying(Traceable, ParameterEffect, Protocol):
    """A candidate that makes a parameter vary, each of its own parameters the size of one shape."""


def screen_varying(fitted: FittedModel, candidates: Sequence[Varying], context: SearchContext) -> list[Finding]:
    """Findings for all candidates that can act on the fitted model, the largest gain first; as ``screen`` has them, to first order.

    Where the fitted model's sensors have a memory each candidate is screened by itself.
    """
    able = [candidate for candidate in candidates if candidate.name not in fitted.names]
    if fitted.system.sensor_stages or not able:
        return screen(fitted, able, context)
    effects: list[Any] = [fitted_to(candidate, context) for candidate in able]
    columns = [_signatures(fitted, r, effects) for r in range(len(fitted.fit.layout.problems))]
    white, counts = whitened(fitted), [len(effect.parameters) for effect in effects]
    flat = np.concatenate([_whitened(fitted, r, part) for r, part in enumerate(columns)], axis=1)
    ends = np.cumsum(counts)
    found = [_finding(fitted, white, effect, flat[end - k : end]) for effect, k, end in zip(effects, counts, ends, strict=True)]
    return sorted((finding for finding in found if finding is not None), key=lambda finding: -finding.gain)


def _finding(fitted: FittedModel, white: Whitened, effect: Any, rows: np.ndarray) -> Finding | None:
    """What the shapes ``rows (k, D)`` of one candidate explain of the residual; None where they are no signature."""
    N = float(fitted.fit.counts.sum())
    with counted_numerics():
        share, sizes = share_explained(white, rows)
    if not share > 0.0:
        return None
    gain = -0.5 * N * float(np.log1p(-min(share, 0.999999)))
    added = sizes @ rows
    start = {full_name(effect, item.name): float(size) for item, size in zip(effect.parameters, sizes, strict=True)}
    return Finding(effect, gain, len(sizes), (start,), (gain,), added - white.Q @ (white.Q.T @ added))


def _whitened(fitted: FittedModel, r: int, columns: np.ndarray) -> np.ndarray:
    """Columns ``(m, N, c)`` of one record as the residual is, ``(c, m N)``."""
    turned = fitted.fit.whiten(r, columns)
    return np.ascontiguousarray(turned.reshape(-1, turned.shape[2]).T)


def _signatures(fitted: FittedModel, r: int, effects: Sequence[Any]) -> np.ndarray:
    """Changes of the outputs of one record by all shapes of all candidates, ``(m, N, c)``."""
    layout, system = fitted.fit.layout, fitted.system
    old = layout.problems[r]
    p, _ = layout.split(fitted.fit.theta, r)
    problem = record_problem(old.record, system, max(layout.settings.max_step, thresholds.COARSE), (), (), valid=old.valid, at=p)
    states = fitted.fit.lines[r].states
    names = list(dict.fromkeys(effect.parameter for effect in effects))
    at = [system.parameters.index(name) for name in names]
    steps = thresholds.SLOPE_STEP * np.array([abs(p[index]) or 1.0 for index in at])
    drive = problem.drive
    assert drive is not None
    rows, by_state = _stepped(problem, p, states, at, steps)
    A, B = _interval_slopes(problem, states, rows, by_state, steps, drive)
    C, D = _output_slopes(problem, states, rows, by_state, steps, drive)
    which = np.array([names.index(effect.parameter) for effect in effects for _ in effect.parameters])
    inside, sampled = _shape_values(problem, states, effects, drive)
    moved = join_intervals(A, B[:, which] * inside, np.zeros((len(states), B.shape[2])), (), np.zeros(len(states)))[:, 1:]
    grid = problem.grid
    here = moved[:, :, grid.sample // grid.substeps] if moved.shape[2] != len(grid.sample) else moved
    return np.asarray(np.einsum("mxn,xcn->mnc", C, here, optimize=True) + (D[:, which] * sampled).transpose(0, 2, 1))


def _stepped(problem: RecordProblem, p: np.ndarray, states: np.ndarray, at: Sequence[int], steps: np.ndarray) -> tuple[list[Any], np.ndarray]:
    """Parameters as rows, one column a base, a state and a parameter, and the steps of the states."""
    n_x = len(states)
    rows: list[Any] = p.tolist()
    for j, index in enumerate(at):
        row = np.full(1 + n_x + len(at), p[index])
        row[1 + n_x + j] += steps[j]
        rows[index] = row
    size = np.sqrt(np.mean(states**2, axis=1))
    return rows, INCREMENT * np.where(size > 0, size, 1.0)


def _spread(states: np.ndarray, by_state: np.ndarray, width: int) -> np.ndarray:
    X = np.array(np.broadcast_to(states[:, None], (len(states), width, states.shape[1])))
    X[np.arange(len(states)), 1 + np.arange(len(states))] += by_state[:, None]
    return X


def _interval_slopes(
    problem: RecordProblem, states: np.ndarray, rows: list[Any], by_state: np.ndarray, steps: np.ndarray, drive: Drive
) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of the states after each interval by those before, ``(nx, nx, K)``, and by the parameters ``(nx, c, K)``."""
    n_x = len(states)
    X = _spread(states[:, :-1], by_state, 1 + n_x + len(steps))
    ends = interval_ends(problem, list(X), drive, rows)
    change = ends[:, 1:] - ends[:, :1]
    return change[:, :n_x] / by_state[:, None], change[:, n_x:] / steps[:, None]


def _output_slopes(
    problem: RecordProblem, states: np.ndarray, rows: list[Any], by_state: np.ndarray, steps: np.ndarray, drive: Drive
) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of the outputs at the samples by the states there, ``(m, nx, N)``, and by the parameters ``(m, c, N)``."""
    n_x = len(states)
    X = _spread(states, by_state, 1 + n_x + len(steps))
    y = sample_outputs(problem, rows, list(X), drive, range(X.shape[1]))
    change = y[:, 1:] - y[:, :1]
    return change[:, :n_x] / by_state[:, None], change[:, n_x:] / steps[:, None]


def _shape_values(problem: RecordProblem, states: np.ndarray, effects: Sequence[Any], drive: Drive) -> tuple[np.ndarray, np.ndarray]:
    """Means of all shapes over each interval, ``(c, K)``, and their values at the samples ``(c, N)``."""
    system, grid = problem.system, problem.grid
    substeps, K = grid.substeps, states.shape[1] - 1
    first, last = np.arange(K) * substeps, np.arange(K) * substeps + substeps - 1
    nodes = grid.sample // substeps if len(grid.sample) != K + 1 else np.arange(K + 1)
    begun = _bus(system, states[:, :-1], [row[first] for row in drive.begin])
    ended = _bus(system, states[:, 1:], [row[last] for row in drive.end])
    sampled = _bus(system, states[:, nodes], [row[grid.sample] for row in drive.begin])
    inside = [0.5 * (_shapes(effect, begun) + _shapes(effect, ended)) for effect in effects]
    return np.concatenate(inside), np.concatenate([_shapes(effect, sampled) for effect in effects])


def _bus(system: Any, states: np.ndarray, inputs: Sequence[np.ndarray]) -> SimpleNamespace:
    """States and inputs by name, each ``(n, 1)`` against the shapes; the port of gusts, which adds to one of them, is zero if it is none of these."""
    named = [*zip(system.state_names, states, strict=True), *zip(system.input_names, inputs, strict=True)]
    return SimpleNamespace(**{"gust": 0.0, **{name: row[:, None] for name, row in named}})


def _shapes(effect: Any, bus: SimpleNamespace) -> np.ndarray:
    """Values of an effect's shapes, ``(k, n)``."""
    return np.asarray(effect.change(bus, tuple(np.eye(len(effect.parameters))))).T
