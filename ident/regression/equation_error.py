"""Equation error: regression of measured rates on the equations of motion. A starter and a reference, no more.

The equations need no integration, so any start will do, and an unstable aircraft is as easy as a stable one. But the
states in the regressors carry measurement noise, which biases the estimate (mostly towards zero), and no sigma
shows that: on rigid aircraft at usual noise up to one sigma, where sigma is itself two to three times that of an
output-error fit, which removes the bias when it goes on from here. Klein and Morelli, Aircraft System Identification, ch. 5.

Rates are slopes of local straight lines. A slope over a window is a weighted mean of the rate over that window,
sum_j w_j x_j = sum_j K_j (x_{j+1} - x_j), K_j = -sum_{i<=j} w_i, so the right-hand side is averaged with the same K:
a jump of the input inside a window then does no harm, and no frequency is lost on one side only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ident.estimate import LARGEST, Estimate, Outcome
from ident.regression.state_histories import StateData, state_data
from ident.statistics.coloured_covariance import corrected_covariance
from ident.statistics.information import conditional_scale, inverse_information
from ident.statistics.normal_equations import add_normal_equations, unresolved
from sim.declaration.system import System
from sim.errors import ModelError
from sim.maths.elementary import COMPLEX_STEP
from sim.propagation.grid import drive_from_record, make_grid
from sim.record import Record


@dataclass(frozen=True)
class RegressionSettings:
    """How an equation-error fit runs.

    Attributes
    ----------
    iterations : limit of Gauss-Newton steps; equations linear in the parameters take three (weights settle).
    tolerance : settled when a step moves no parameter by more than this share of its sigma.
    coloured : correct the covariance for residuals that are not white; they never are, windows overlap.
    """

    iterations: int = 30
    tolerance: float = 1e-3
    coloured: bool = True


@dataclass(frozen=True, eq=False)
class _Equations:
    """Residuals of one record: ``residual``, ``valid`` ``(e, N)``, ``jacobian (e, N, c)`` of the right-hand side, ``fitted (m, N)``."""

    residual: np.ndarray
    valid: np.ndarray
    jacobian: np.ndarray
    fitted: np.ndarray


@dataclass(frozen=True, eq=False)
class _Layout:
    """Unknowns: shared parameters, then the biases of each record. ``order`` are their positions among all parameters."""

    system: System
    shared: tuple[str, ...]
    local: tuple[str, ...]
    records: tuple[Record, ...]
    data: tuple[list[StateData], ...]
    order: list[int] = field(default_factory=list)

    def columns(self, r: int) -> np.ndarray:
        return np.concatenate([np.arange(len(self.shared)), len(self.shared) + r * len(self.local) + np.arange(len(self.local))])


def run_equation_error(records: Sequence[Record], system: System, settings: RegressionSettings | None = None) -> Estimate:
    """Regress rates and further outputs on the equations of a System.

    Parameters
    ----------
    records : one or more; ``bias_*`` parameters belong to one record each.
    system : every state must be measured under its own name or be the rate of one that is (see ``state_data``).
        Outputs that are no states (nz) give one equation each. Bounds are kept, priors not used.

    Returns
    -------
    Estimate of the shared free parameters. ``noise_std`` holds for a state's channel what its smoothing left, for any
    other output what its equation left. The log-likelihood is that of the equation residuals: it compares with
    no other method's. Outcomes as of ``fit_output_error``.

    Raises
    ------
    ModelError : a state that cannot be had from a record, a sensor with memory, no free parameter.
    """
    settings = settings or RegressionSettings()
    layout = _layout(records, system)
    parameters, count = system.parameters, len(layout.records)
    items = [parameters[name] for name in layout.shared] + [parameters[name] for name in layout.local] * count
    theta = np.array([item.value for item in items])
    low, high = np.array([item.bounds[0] for item in items]), np.array([item.bounds[1] for item in items])
    parts = _evaluate(layout, theta)
    if parts is None:
        return _unfinished(layout, theta)
    outcome, done = Outcome.MAX_ITERATIONS, 0
    while done < settings.iterations:
        done += 1
        information, gradient = _normal_equations(layout, parts, len(theta))
        pressed = ((theta <= low) & (gradient < 0)) | ((theta >= high) & (gradient > 0))
        at = np.flatnonzero((np.diag(information) > 0) & ~pressed)
        step = np.zeros_like(theta)
        if at.size:
            step[at] = inverse_information(information[np.ix_(at, at)], theta[at])[0] @ gradient[at]
        whole = np.clip(theta + step, low, high) - theta
        theta, parts, share = _descend(layout, theta, step, low, high, parts)
        if np.max(np.abs(whole) / conditional_scale(information, theta)) < settings.tolerance:
            outcome = Outcome.CONVERGED
            break
        if share == 0.0:
            break
    return _finished(layout, theta, parts, outcome, done, settings)


def _layout(records: Sequence[Record], system: System) -> _Layout:
    if system.sensor_stages:
        raise ModelError(f"effect {system.sensor_stages[0]} keeps a memory on the sensor path", where="equation error", remedy="use output-error")
    recorded = {name for record in records for name in record.output_names}
    free = [name for name in system.parameters.free_names if not name.startswith("bias_") or name.removeprefix("bias_") in recorded]
    shared = tuple(name for name in free if not name.startswith("bias_"))
    local = tuple(name for name in free if name.startswith("bias_"))
    if not shared:
        raise ModelError("no parameter is free", where=f"model with {', '.join(system.parameters.names)}", remedy="release at least one")
    order = [system.parameters.index(name) for name in (*shared, *local)]
    return _Layout(system, shared, local, tuple(records), tuple(state_data(record, system) for record in records), order)


def _evaluate(layout: _Layout, theta: np.ndarray) -> list[_Equations] | None:
    with np.errstate(all="ignore"):
        parts = [_equations(layout, r, theta[layout.columns(r)]) for r in range(len(layout.records))]
    sound = all(np.all(np.abs(part.residual) < LARGEST) and np.all(np.abs(part.jacobian) < LARGEST) for part in parts)
    return parts if sound else None


def _equations(layout: _Layout, r: int, mine: np.ndarray) -> _Equations:
    """Residuals of record ``r`` and their derivatives by complex step, a column an unknown."""
    system, record, data, c = layout.system, layout.records[r], layout.data[r], len(mine)
    p: list[Any] = list(system.parameters.values())
    for column, index in enumerate(layout.order):
        p[index] = mine[column] + 1j * COMPLEX_STEP * (np.arange(c) == column)
    time = record.time
    grid = make_grid(time, float(np.diff(time).max()))
    drive = drive_from_record(system, p, record.input_array(system.input_names), time, record.hold, grid)
    # The grid has further nodes where samples are far apart; the equations are taken from sample to sample.
    u_begin = [_deep(np.asarray(row)[grid.sample]) for row in drive.begin]
    u_end = [_deep(np.asarray(row)[grid.sample[1:] - 1]) for row in drive.end]
    x = [_deep(state.smooth) - (0.0 if state.bias is None else p[state.bias]) for state in data]
    n = len(time)
    before = system.f(time[:-1, None], [row[:-1] for row in x], [row[:-1] for row in u_begin], p)
    after = system.f(time[1:, None], [row[1:] for row in x], u_end, p)
    gained = [np.broadcast_to(0.5 * np.diff(time)[:, None] * (a + b), (n - 1, c)) for a, b in zip(before, after, strict=True)]
    z, there = record.output_array(system.output_names)
    y = [np.broadcast_to(row, (n, c)) for row in system.h(time[:, None], x, u_begin, p)]

    residual, valid, right = [], [], []
    for state, increments in zip(data, gained, strict=True):
        if not state.defines:
            windows = state.slopes
            left = np.sum(windows.slope * windows.gather(state.raw), axis=1)
            mean = _averaged(windows.slope, windows.first, increments)
            residual.append(left - mean.real[:, 0])
            right.append(mean.imag / COMPLEX_STEP)
            valid.append(windows.usable)
    for i, name in enumerate(system.output_names):
        if name not in system.state_names:
            residual.append(z[i] - y[i].real[:, 0])
            right.append(y[i].imag / COMPLEX_STEP)
            valid.append(there[i])
    fitted = np.array([row.real[:, 0] for row in y])
    mask = np.array(valid)
    return _Equations(np.where(mask, np.array(residual), 0.0), mask, np.where(mask[:, :, None], np.array(right), 0.0), fitted)


def _averaged(slope: np.ndarray, first: np.ndarray, increments: np.ndarray) -> np.ndarray:
    """What the slope weights ``(N, W)`` make of a signal with the given increments between rows, ``(N, c)``."""
    kernel = -np.cumsum(slope, axis=1)[:, :-1]
    total = np.zeros((len(slope), increments.shape[1]), dtype=complex)
    for j in range(kernel.shape[1]):
        total += kernel[:, j, None] * increments[first + j]
    return total


def _variances(parts: list[_Equations]) -> tuple[np.ndarray, np.ndarray]:
    """Mean square of each equation's residual over all records, and how many there are."""
    counts = sum(part.valid.sum(axis=1) for part in parts)
    squares = sum((part.residual**2).sum(axis=1) for part in parts)
    return np.maximum(squares / np.maximum(counts, 1), 1e-60), np.asarray(counts)


def _cost(parts: list[_Equations]) -> float:
    variance, counts = _variances(parts)
    return 0.5 * float(counts @ np.log(variance))


def _normal_equations(layout: _Layout, parts: list[_Equations], n: int) -> tuple[np.ndarray, np.ndarray]:
    variance, _ = _variances(parts)
    information, gradient = np.zeros((n, n)), np.zeros(n)
    for r, part in enumerate(parts):
        weight = np.broadcast_to(1.0 / variance[:, None], part.residual.shape)
        add_normal_equations(information, gradient, layout.columns(r), part.jacobian, part.residual, weight)
    return information, gradient


def _descend(
    layout: _Layout, theta: np.ndarray, step: np.ndarray, low: np.ndarray, high: np.ndarray, parts: list[_Equations]
) -> tuple[np.ndarray, list[_Equations], float]:
    """The step, halved until the cost does not rise; the point, its residuals, and the share of the step that was taken."""
    cost, share, resolved = _cost(parts), 1.0, unresolved(float(_variances(parts)[1].sum()))
    for _ in range(12):
        trial = np.clip(theta + share * step, low, high)
        new = _evaluate(layout, trial)
        if new is not None and _cost(new) <= cost + resolved:
            return trial, new, share
        share *= 0.5
    return theta, parts, 0.0


def _finished(layout: _Layout, theta: np.ndarray, parts: list[_Equations], outcome: Outcome, done: int, settings: RegressionSettings) -> Estimate:
    system, n = layout.system, len(layout.shared)
    information, _ = _normal_equations(layout, parts, len(theta))
    variance, counts = _variances(parts)
    covariance, determined = inverse_information(information, theta)
    if not determined:
        outcome = Outcome.NOT_IDENTIFIABLE
    if settings.coloured:
        coloured = [(layout.columns(r), part.jacobian, part.residual, part.valid) for r, part in enumerate(parts)]
        covariance = corrected_covariance(covariance, coloured, variance)
    log_likelihood = -_cost(parts) - 0.5 * float(counts.sum()) * (1.0 + np.log(2.0 * np.pi))
    units = tuple(system.parameters[name].unit for name in layout.shared)
    return Estimate(
        "equation-error",
        layout.shared,
        units,
        theta[:n].copy(),
        covariance[:n, :n],
        outcome,
        log_likelihood,
        system.output_names,
        _noise_std(layout, parts),
        tuple(part.fitted for part in parts),
        iterations=done,
    )


def _noise_std(layout: _Layout, parts: list[_Equations]) -> np.ndarray:
    """Scatter of each channel about what the equations and the smoothed states say, one where it was not recorded."""
    squares, counts = np.zeros(len(layout.system.outputs)), np.zeros(len(layout.system.outputs))
    for record, part in zip(layout.records, parts, strict=True):
        z, valid = record.output_array(layout.system.output_names)
        squares += (np.where(valid, z - part.fitted, 0.0) ** 2).sum(axis=1)
        counts += valid.sum(axis=1)
    return np.where(counts > 0, np.sqrt(squares / np.maximum(counts, 1)), 1.0)


def _unfinished(layout: _Layout, theta: np.ndarray) -> Estimate:
    """At the start, when the equations give no finite number there."""
    n, system = len(layout.shared), layout.system
    units = tuple(system.parameters[name].unit for name in layout.shared)
    blank = tuple(np.zeros((len(system.outputs), len(record))) for record in layout.records)
    wide = np.diag(np.maximum(1.0, theta[:n] ** 2))
    ones = np.ones(len(system.outputs))
    return Estimate("equation-error", layout.shared, units, theta[:n], wide, Outcome.DIVERGED, -LARGEST, system.output_names, ones, blank)


def _deep(row: Any) -> np.ndarray:
    row = np.asarray(row)
    return row[:, None] if row.ndim == 1 else row
