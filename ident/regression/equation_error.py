"""Equation error: regression of measured rates on the equations of motion, by least squares or with
instrumental variables.

Rates are slopes of local straight lines. A slope over a window is a weighted mean of the rate over
that window, sum_j w_j x_j = sum_j K_j (x_{j+1} - x_j), K_j = -sum_{i<=j} w_i, so the right-hand
side is averaged with the same K: a jump of the input inside a window then does no harm, and no
frequency is lost on one side only.

Least squares needs no integration, so that it works from any start and for unstable aircraft (Klein
and Morelli, Aircraft System Identification, ch. 5). But noise and smoothing of the states in its
regressors bias the estimate, by up to several sigmas. With instrumental variables (Young, Recursive
Estimation and Time-Series Analysis, 2nd ed., ch. 8; Soderstrom and Stoica, Instrumental Variable
Methods for System Identification, 1983) the regressors are the measured states as they are, and
what they are multiplied with are those of a simulation at the last estimate: it follows the inputs,
not the noise, so no bias is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ident.estimate import LARGEST_NUMBER, Estimate, Outcome
from ident.regression.state_histories import StateData, state_data, windows
from ident.statistics.intervals import (
    UNDETERMINED,
    add_normal_equations,
    conditional_scale,
    determined_and_open,
    inverse_information,
)
from ident.statistics.minimise import unresolved
from ident.statistics.residual_spectrum import RecordScores, corrected_covariance, sandwich
from sim.declaration.model import System
from sim.errors import ModelError
from sim.maths import COMPLEX_STEP
from sim.propagation import drive_from_record, make_grid, propagate
from sim.record import Channel, Record

SIMULATED_STEP = 0.02  # s, step of the simulation that gives instruments
# largest distance of a usable simulation from the record, in scatters of a state
RUNAWAY_SCATTERS = 3.0
# number of bias simulations: at least squares, and at the first corrected estimate
BIAS_SIMULATIONS = 2
NARROWER = (1.0, 0.5, 0.25, 0.125)  # shares of a slope's window that are tried with instruments
NOISE_PAIRS = 6  # pairs of added noise and its negative for the bias of least squares


@dataclass(frozen=True)
class RegressionSettings:
    """How an equation-error fit runs.

    Attributes
    ----------
    iterations : limit of Gauss-Newton steps; equations linear in the parameters take three, until
        the weights converge.
    tolerance : converged when a step moves no parameter by more than this share of its sigma.
    coloured : correct the covariance for residuals that are not white; as windows overlap, they
        never are.
    instruments : continue from least squares with instrumental variables. If no simulation follows
        a record (unstable aircraft), least squares remain, less their bias by noise as far as added
        noise shows it, and sigmas are increased by that bias.
    """

    iterations: int = 30
    tolerance: float = 1e-3
    coloured: bool = True
    instruments: bool = False


@dataclass(frozen=True, eq=False)
class _Equations:
    """Residuals of one record: ``residual``, ``valid`` ``(e, N)``, ``jacobian (e, N, c)`` of the
    right-hand side, ``fitted (m, N)``.
    """

    residual: np.ndarray
    valid: np.ndarray
    jacobian: np.ndarray
    fitted: np.ndarray


@dataclass(frozen=True, eq=False)
class _Layout:
    """Unknowns: shared parameters, then the biases of each record. ``order`` are their positions
    among all parameters.
    """

    system: System
    shared: tuple[str, ...]
    local: tuple[str, ...]
    records: tuple[Record, ...]
    data: tuple[list[StateData], ...]
    order: list[int] = field(default_factory=list)

    def columns(self, r: int) -> np.ndarray:
        return np.concatenate(
            [
                np.arange(len(self.shared)),
                len(self.shared) + r * len(self.local) + np.arange(len(self.local)),
            ]
        )


def run_equation_error(
    records: Sequence[Record], system: System, settings: RegressionSettings | None = None
) -> Estimate:
    """Regress rates and further outputs on the equations of a System.

    Parameters
    ----------
    records : one or more; ``bias_*`` parameters belong to one record each.
    system : every state must be measured under its own name or be the rate of one that is (see
    ``state_data``).
        Outputs that are no states (nz) give one equation each. Bounds are kept, priors not used.

    Returns
    -------
    Estimate of the shared free parameters. ``noise_std`` holds for a state's channel what its
    smoothing left, for any other output what its equation left. The log-likelihood is that of the
    equation residuals: it compares with no other method's. Outcomes as of ``fit_output_error``.

    Raises
    ------
    ModelError : a state that cannot be had from a record, a sensor with memory, no free parameter.
    """
    settings = settings or RegressionSettings()
    layout = _layout(records, system)
    theta, parts, outcome, done = _least_squares(layout, settings)
    if parts is None:
        return _unfinished(layout, theta)
    if not settings.instruments:
        return _finished(layout, theta, parts, outcome, done, settings)
    return _with_instruments(layout, theta, parts, outcome, done, settings)


def _bounds(layout: _Layout) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Start, lowest and highest values of all unknowns."""
    parameters, count = layout.system.parameters, len(layout.records)
    items = [parameters[name] for name in layout.shared] + [
        parameters[name] for name in layout.local
    ] * count
    low = np.array([item.bounds[0] for item in items])
    high = np.array([item.bounds[1] for item in items])
    return np.array([item.value for item in items]), low, high


def _least_squares(
    layout: _Layout, settings: RegressionSettings, start: np.ndarray | None = None
) -> tuple[np.ndarray, list[_Equations] | None, Outcome, int]:
    """Unknowns, their residuals (None where the start has no finite ones), the outcome and the
    number of steps.
    """
    declared, low, high = _bounds(layout)
    theta = declared if start is None else start
    parts = _evaluate(layout, theta)
    if parts is None:
        return theta, None, Outcome.DIVERGED, 0
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
    return theta, parts, outcome, done


def _layout(records: Sequence[Record], system: System) -> _Layout:
    if system.sensor_stages:
        raise ModelError(
            f"effect {system.sensor_stages[0]} keeps a memory on the sensor path",
            where="equation error",
            remedy="use output-error",
        )
    recorded = {name for record in records for name in record.output_names}
    free = [
        name
        for name in system.parameters.free_names
        if not name.startswith("bias_") or name.removeprefix("bias_") in recorded
    ]
    shared = tuple(name for name in free if not name.startswith("bias_"))
    local = tuple(name for name in free if name.startswith("bias_"))
    if not shared:
        raise ModelError(
            "no parameter is free",
            where=f"model with {', '.join(system.parameters.names)}",
            remedy="release at least one",
        )
    order = [system.parameters.index(name) for name in (*shared, *local)]
    return _Layout(
        system,
        shared,
        local,
        tuple(records),
        tuple(state_data(record, system) for record in records),
        order,
    )


def _evaluate(
    layout: _Layout,
    theta: np.ndarray,
    histories: Sequence[Sequence[np.ndarray]] | None = None,
    *,
    slopes: bool = True,
) -> list[_Equations] | None:
    """Return the residuals of all records; ``histories``, if given, replace the smoothed states and
    have no sensor biases. Without ``slopes`` the jacobians are zero.
    """
    with np.errstate(all="ignore"):
        parts = [
            _equations(
                layout,
                r,
                theta[layout.columns(r)],
                None if histories is None else histories[r],
                slopes=slopes,
            )
            for r in range(len(layout.records))
        ]
    sound = all(
        np.all(np.abs(part.residual) < LARGEST_NUMBER)
        and np.all(np.abs(part.jacobian) < LARGEST_NUMBER)
        for part in parts
    )
    return parts if sound else None


def _equations(
    layout: _Layout,
    r: int,
    mine: np.ndarray,
    history: Sequence[np.ndarray] | None = None,
    *,
    slopes: bool = True,
) -> _Equations:
    """Residuals of record ``r`` and their derivatives by complex step, a column an unknown."""
    system, record, data = layout.system, layout.records[r], layout.data[r]
    c = len(mine) if slopes else 1
    p: list[Any] = list(system.parameters.values())
    for column, index in enumerate(layout.order):
        p[index] = mine[column]
        if slopes:
            p[index] = p[index] + 1j * COMPLEX_STEP * (np.arange(c) == column)
    time = record.time
    u_begin, u_end = ([_deep(row) for row in stage] for stage in _inputs(record, system, p))
    x: list[Any]
    if history is None:
        x = [_deep(state.smooth) - (0.0 if state.bias is None else p[state.bias]) for state in data]
    else:
        x = [
            _deep(row) - (0.0 if state.bias is None else 1j * np.imag(p[state.bias]))
            for row, state in zip(history, data, strict=True)
        ]
    n = len(time)
    before = system.f(time[:-1, None], [row[:-1] for row in x], [row[:-1] for row in u_begin], p)
    after = system.f(time[1:, None], [row[1:] for row in x], u_end, p)
    gained = [
        np.broadcast_to(0.5 * np.diff(time)[:, None] * (a + b), (n - 1, c))
        for a, b in zip(before, after, strict=True)
    ]
    z, there = record.output_array(system.output_names)
    y = [np.broadcast_to(row, (n, c)) for row in system.h(time[:, None], x, u_begin, p)]

    residual, valid, right = [], [], []
    for state, increments in zip(data, gained, strict=True):
        if not state.rate_state:
            fit = state.slopes
            left = np.sum(fit.slope * fit.gather(state.raw), axis=1)
            mean = _averaged(fit.slope, fit.first, increments)
            residual.append(left - mean.real[:, 0])
            right.append(mean.imag / COMPLEX_STEP)
            valid.append(fit.usable)
    for i, name in enumerate(system.output_names):
        if name not in system.state_names:
            residual.append(z[i] - y[i].real[:, 0])
            right.append(y[i].imag / COMPLEX_STEP)
            valid.append(there[i])
    fitted = np.array([row.real[:, 0] for row in y])
    mask = np.array(valid)
    return _Equations(
        np.where(mask, np.array(residual), 0.0),
        mask,
        np.where(mask[:, :, None], np.array(right), 0.0),
        fitted,
    )


def _inputs(record: Record, system: System, p: Sequence[Any]) -> tuple[list[Any], list[Any]]:
    """Inputs at the vehicle just after each sample ``(N, ...)``, and just before the next ``(N - 1,
    ...)``.
    """
    grid = make_grid(record.time, float(np.diff(record.time).max()))
    drive = drive_from_record(
        system, p, record.input_array(system.input_names), record.time, record.hold, grid
    )
    # A gap has nodes of its own between the samples.
    return [row[grid.sample] for row in drive.begin], [
        row[grid.sample[1:] - 1] for row in drive.end
    ]


def _averaged(slope: np.ndarray, first: np.ndarray, increments: np.ndarray) -> np.ndarray:
    """Apply the slope weights ``(N, W)`` to a signal with the given increments between rows, ``(N,
    c)``.
    """
    from scipy.sparse import csr_array

    kernel = -np.cumsum(slope, axis=1)[:, :-1]
    rows, width = kernel.shape
    columns = (first[:, None] + np.arange(width)).ravel()
    begin = np.arange(rows + 1) * width
    weights = csr_array((kernel.ravel(), columns, begin), shape=(rows, len(increments)))
    return np.asarray(weights @ increments)


def _variances(parts: list[_Equations]) -> tuple[np.ndarray, np.ndarray]:
    """Mean square of each equation's residual over all records, and how many there are."""
    counts = sum(part.valid.sum(axis=1) for part in parts)
    squares = sum((part.residual**2).sum(axis=1) for part in parts)
    return np.maximum(squares / np.maximum(counts, 1), 1e-60), np.asarray(counts)


def _cost(parts: list[_Equations]) -> float:
    variance, counts = _variances(parts)
    return 0.5 * float(counts @ np.log(variance))


def _normal_equations(
    layout: _Layout, parts: list[_Equations], n: int
) -> tuple[np.ndarray, np.ndarray]:
    variance, _ = _variances(parts)
    information, gradient = np.zeros((n, n)), np.zeros(n)
    for r, part in enumerate(parts):
        weight = np.broadcast_to(1.0 / variance[:, None], part.residual.shape)
        add_normal_equations(
            information, gradient, layout.columns(r), part.jacobian, part.residual, weight
        )
    return information, gradient


def _descend(
    layout: _Layout,
    theta: np.ndarray,
    step: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    parts: list[_Equations],
) -> tuple[np.ndarray, list[_Equations], float]:
    """Return the step, halved until the cost does not rise; the point, its residuals, and the share
    of the step that was taken.
    """
    cost, share, resolved = _cost(parts), 1.0, unresolved(float(_variances(parts)[1].sum()))
    for _ in range(12):
        trial = np.clip(theta + share * step, low, high)
        tried = _evaluate(layout, trial, slopes=False)
        if tried is not None and _cost(tried) <= cost + resolved:
            new = _evaluate(layout, trial)
            if new is not None:
                return trial, new, share
        share *= 0.5
    return theta, parts, 0.0


def _finished(
    layout: _Layout,
    theta: np.ndarray,
    parts: list[_Equations],
    outcome: Outcome,
    done: int,
    settings: RegressionSettings,
) -> Estimate:
    system, n = layout.system, len(layout.shared)
    information, _ = _normal_equations(layout, parts, len(theta))
    variance, counts = _variances(parts)
    covariance, determined = inverse_information(information, theta)
    if not determined:
        outcome = Outcome.NOT_IDENTIFIABLE
    if settings.coloured:
        coloured = [
            (layout.columns(r), part.jacobian, part.residual, part.valid)
            for r, part in enumerate(parts)
        ]
        known, unknown = (
            (covariance, 0.0) if determined else determined_and_open(information, theta)
        )
        covariance = corrected_covariance(known, coloured, variance) + unknown
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


def _with_instruments(
    layout: _Layout,
    theta: np.ndarray,
    parts: list[_Equations],
    outcome: Outcome,
    done: int,
    settings: RegressionSettings,
) -> Estimate:
    """Return the estimate with instrumental variables, or that of corrected least squares if a
    simulation does not follow the records.
    """
    squares = _finished(layout, theta, parts, outcome, done, replace(settings, coloured=False))
    settled = squares.outcome is Outcome.CONVERGED
    found = _instrumental(layout, theta, settings) if settled else None
    if found is None:
        squares = _finished(layout, theta, parts, outcome, done, settings)
        return _without_bias(layout, theta, squares, settings) if settled else squares
    theta, covariance, outcome, more = found
    at_end = _evaluate(layout, theta)
    if at_end is None:
        return squares
    n = len(layout.shared)
    return replace(
        squares,
        values=theta[:n].copy(),
        covariance=covariance[:n, :n],
        outcome=outcome,
        noise_std=_noise_std(layout, at_end),
        fitted=tuple(part.fitted for part in at_end),
        iterations=done + more,
    )


def _instrumental(
    layout: _Layout, theta: np.ndarray, settings: RegressionSettings
) -> tuple[np.ndarray, np.ndarray, Outcome, int] | None:
    """Return unknowns, covariance, outcome and steps with instrumental variables; None where no
    simulation gives any.
    """
    _, low, high = _bounds(layout)
    simulated = _simulated(layout, theta)
    if simulated is None:
        return None
    layout = _with_best_windows(layout, theta, simulated, settings)
    outcome, done = Outcome.MAX_ITERATIONS, 0
    while True:
        done += 1
        again = _simulated(layout, theta) if 1 < done <= BIAS_SIMULATIONS else simulated
        posed = None if again is None else _normal_problem(layout, theta, again)
        if again is None or posed is None:
            return None
        simulated = again
        step = np.clip(theta + posed.inverse @ posed.gradient, low, high) - theta
        if np.max(np.abs(step) / posed.size) < settings.tolerance:
            outcome = Outcome.CONVERGED
        if outcome is Outcome.CONVERGED or done >= settings.iterations:
            return (
                theta,
                sandwich(posed.inverse, posed.scores, coloured=settings.coloured),
                outcome,
                done,
            )
        theta = theta + step


@dataclass(frozen=True, eq=False)
class _NormalProblem:
    """``inverse @ gradient`` is the step of all unknowns, ``size`` their sigmas with the others
    known, ``scores`` what each record adds.
    """

    inverse: np.ndarray
    gradient: np.ndarray
    size: np.ndarray
    scores: list[RecordScores]


def _normal_problem(
    layout: _Layout, theta: np.ndarray, simulated: list[list[np.ndarray]]
) -> _NormalProblem | None:
    """Return the equations of instrumental variables at ``theta``; None where they are not finite
    or not regular.
    """
    measured = _evaluate(
        layout, theta, [_measured(layout, r, theta) for r in range(len(layout.records))]
    )
    instruments = _evaluate(layout, theta, simulated)
    if measured is None or instruments is None:
        return None
    variance, _ = _variances(measured)
    cross, gradient, scores = np.zeros((len(theta), len(theta))), np.zeros(len(theta)), []
    for r, (seen, by) in enumerate(zip(measured, instruments, strict=True)):
        at, weights = layout.columns(r), by.jacobian / variance[:, None, None]
        flat = weights.reshape(-1, len(at))
        cross[np.ix_(at, at)] += flat.T @ seen.jacobian.reshape(-1, len(at))
        gradient[at] += flat.T @ seen.residual.ravel()
        scores.append(RecordScores(at, weights, seen.jacobian, seen.residual, seen.valid))
    size = conditional_scale(np.abs(cross), theta)
    scaled = cross * np.outer(size, size)
    if not np.all(np.isfinite(scaled)) or np.linalg.cond(scaled) > 1.0 / UNDETERMINED:
        return None
    return _NormalProblem(np.linalg.inv(scaled) * np.outer(size, size), gradient, size, scores)


def _with_best_windows(
    layout: _Layout,
    theta: np.ndarray,
    simulated: list[list[np.ndarray]],
    settings: RegressionSettings,
) -> _Layout:
    """Return the layout with slopes over those windows, of several widths, with which the
    covariance of the shared parameters is least.

    Wide windows leave little noise in a slope, but correlated noise; other equations then have too
    little weight.
    """
    n, best, least = len(layout.shared), layout, np.inf
    for share in NARROWER:
        data = tuple(
            [state if state.rate_state else _narrower(record, state, share) for state in each]
            for record, each in zip(layout.records, layout.data, strict=True)
        )
        trial = replace(layout, data=data)
        posed = _normal_problem(trial, theta, simulated)
        if posed is None:
            continue
        covariance = sandwich(posed.inverse, posed.scores, coloured=settings.coloured)[:n, :n]
        scale = posed.size[:n]
        sign, log = np.linalg.slogdet(covariance / np.outer(scale, scale))
        log += 2.0 * float(np.log(scale).sum())
        if sign > 0 and log < least:
            best, least = trial, log
    return best


def _narrower(record: Record, state: StateData, share: float) -> StateData:
    """Return the state with its slopes over windows of a ``share`` of the half width, of two
    samples at least.
    """
    half = (state.slopes.value.shape[1] - 1) // 2
    width = max(2, round(share * half))
    return (
        state
        if share == 1.0 or width >= half
        else replace(state, slopes=windows(record.time, state.valid, width, 1))
    )


def _measured(layout: _Layout, r: int, theta: np.ndarray) -> list[np.ndarray]:
    """Return the states of record ``r`` as measured, smoothed at missing samples, without sensor
    biases.
    """
    p = _parameters(layout, r, theta)
    out = []
    for state in layout.data[r]:
        bias = 0.0 if state.bias is None else p[state.bias]
        out.append(np.where(state.valid, state.raw, state.smooth) - bias)
    return out


def _parameters(layout: _Layout, r: int, theta: np.ndarray) -> np.ndarray:
    p = layout.system.parameters.values()
    p[layout.order] = theta[layout.columns(r)]
    return p


def _simulated(layout: _Layout, theta: np.ndarray) -> list[list[np.ndarray]] | None:
    """Return the states of all records simulated from their first smoothed ones; None if one
    differs from its record by more than ``RUNAWAY_SCATTERS``.
    """
    out = []
    for r, (record, data) in enumerate(zip(layout.records, layout.data, strict=True)):
        p = _parameters(layout, r, theta)
        grid = make_grid(record.time, min(SIMULATED_STEP, float(np.diff(record.time).max())))
        drive = drive_from_record(
            layout.system,
            p,
            record.input_array(layout.system.input_names),
            record.time,
            record.hold,
            grid,
        )
        measured = [state.smooth - (0.0 if state.bias is None else p[state.bias]) for state in data]
        states = [
            row[grid.sample]
            for row in propagate(
                layout.system, p.tolist(), [float(row[0]) for row in measured], drive, grid
            )
        ]
        for here, there in zip(states, measured, strict=True):
            if not np.all(np.isfinite(here)) or np.std(here - there) > RUNAWAY_SCATTERS * np.std(
                there
            ):
                return None
        out.append(states)
    return out


def _without_bias(
    layout: _Layout, theta: np.ndarray, squares: Estimate, settings: RegressionSettings
) -> Estimate:
    """Return least squares without the bias from noise in the regressors; the bias is added to the
    sigmas.

    Added noise of the same size doubles the bias; the mean over noise and its negative cancels its
    random part (SIMEX: Cook and Stefanski, J. American Statistical Association 89, 1994, with
    antithetic pairs).
    """
    rng, n = np.random.default_rng(0), len(layout.shared)
    moves = []
    for _ in range(NOISE_PAIRS):
        noise = [
            squares.noise_std[:, None] * rng.standard_normal((len(squares.noise_std), len(record)))
            for record in layout.records
        ]
        both = []
        for sign in (1.0, -1.0):
            noisy = tuple(
                _noisier(record, squares.output_names, sign * each)
                for record, each in zip(layout.records, noise, strict=True)
            )
            again = replace(
                layout,
                records=noisy,
                data=tuple(state_data(record, layout.system) for record in noisy),
            )
            found, parts, outcome, _ = _least_squares(again, settings, theta)
            if parts is None or outcome is not Outcome.CONVERGED:
                return squares
            both.append(found[:n])
        moves.append(0.5 * (both[0] + both[1]) - theta[:n])
    bias = np.mean(moves, axis=0)
    uncertain = np.cov(np.array(moves).T).reshape(n, n) / NOISE_PAIRS
    return replace(
        squares,
        values=squares.values - bias,
        covariance=squares.covariance + np.outer(bias, bias) + uncertain,
    )


def _noisier(record: Record, names: Sequence[str], noise: np.ndarray) -> Record:
    """Return the record with ``noise`` added to the outputs of these names."""
    channels = []
    for channel in record.outputs:
        more = noise[names.index(channel.name)] if channel.name in names else 0.0
        channels.append(
            Channel.of(
                channel.name, channel.unit, np.where(channel.valid, channel.values + more, np.nan)
            )
        )
    return replace(record, outputs=tuple(channels))


def _noise_std(layout: _Layout, parts: list[_Equations]) -> np.ndarray:
    """Return the scatter of each channel about the equations and smoothed states; one where it was
    not recorded.
    """
    squares, counts = np.zeros(len(layout.system.outputs)), np.zeros(len(layout.system.outputs))
    for record, part in zip(layout.records, parts, strict=True):
        z, valid = record.output_array(layout.system.output_names)
        squares += (np.where(valid, z - part.fitted, 0.0) ** 2).sum(axis=1)
        counts += valid.sum(axis=1)
    return np.where(counts > 0, np.sqrt(squares / np.maximum(counts, 1)), 1.0)


def _unfinished(layout: _Layout, theta: np.ndarray) -> Estimate:
    """Return the estimate at the start, if the equations give no finite number there."""
    n, system = len(layout.shared), layout.system
    units = tuple(system.parameters[name].unit for name in layout.shared)
    blank = tuple(np.zeros((len(system.outputs), len(record))) for record in layout.records)
    wide = np.diag(np.maximum(1.0, theta[:n] ** 2))
    ones = np.ones(len(system.outputs))
    return Estimate(
        "equation-error",
        layout.shared,
        units,
        theta[:n],
        wide,
        Outcome.DIVERGED,
        -LARGEST_NUMBER,
        system.output_names,
        ones,
        blank,
    )


def _deep(row: Any) -> np.ndarray:
    row = np.asarray(row)
    return row[:, None] if row.ndim == 1 else row
