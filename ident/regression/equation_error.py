"""Equation error: regression of measured rates on the equations of motion, by least squares or with
instrumental variables.

Rates are slopes of local straight lines. A slope over a window is a weighted mean of the rate over
this window, sum_j w_j x_j = sum_j K_j (x_{j+1} - x_j) with K_j = -sum_{i<=j} w_i. The right-hand
side is averaged with the same weights K. Averaging therefore acts on both sides equally, also where
an input jumps within a window.

Least squares needs no integration, so that it works from any start and for unstable aircraft (Klein
and Morelli, Aircraft System Identification, ch. 5). However, the states in its regressors are noisy
and smoothed, which biases the estimate by up to several sigmas. With instrumental variables, the
regressors are the measured states without smoothing. The instruments are the regressors of a
simulation at the last estimate. They depend on the inputs and not on the noise, so that the
estimate has no bias (Young, Recursive Estimation and Time-Series Analysis, 2nd ed., ch. 8;
Soderstrom and Stoica, Instrumental Variable Methods for System Identification, 1983).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.estimate import LARGEST_NUMBER, Estimate, Outcome
from ident.regression.state_histories import (
    EquationResiduals,
    RegressionLayout,
    StateData,
    equation_variances,
    regression_layout,
    residuals_at,
    state_data,
    windows,
)
from ident.statistics.intervals import (
    UNDETERMINED,
    add_normal_equations,
    conditional_scale,
    inverse_information,
    split_covariance,
)
from ident.statistics.minimise import cost_rounding
from ident.statistics.residual_spectrum import RecordScores, corrected_covariance, sandwich
from sim.declaration.model import System
from sim.propagation import drive_from_record, make_grid, propagate
from sim.record import Channel, Record

SIMULATED_STEP = 0.02  # longest step, s, of a simulation that gives instruments
# largest rms difference between a simulation that gives instruments and a smoothed state, over the
# standard deviation of this state
RUNAWAY_SCATTERS = 3.0
# number of simulations: at the estimate of least squares, and at the first one with instruments
INSTRUMENT_SIMULATIONS = 2
# widths of windows that are tried with instruments, relative to those of least squares
WINDOW_WIDTH_SHARES = (1.0, 0.5, 0.25, 0.125)
NOISE_PAIRS = 6  # pairs of added noise and its negative that show the bias of least squares
_MOST_HALVINGS = 12  # of a Gauss-Newton step


@dataclass(frozen=True)
class RegressionSettings:
    """Settings of an equation-error fit.

    Attributes
    ----------
    iterations : most Gauss-Newton steps. Equations linear in the parameters take three, until the
        weights converge.
    tolerance : the fit has converged when a step changes no parameter by more than this share of
        its sigma.
    coloured : whether the covariance is corrected for coloured residuals. Residuals are always
        coloured, since windows overlap.
    instruments : whether instrumental variables are used after least squares. If no simulation
        follows a record, as for an unstable aircraft, the estimate is that of least squares. Its
        bias is then found by added noise, subtracted, and included in the sigmas.
    """

    iterations: int = 30
    tolerance: float = 1e-3
    coloured: bool = True
    instruments: bool = False


def run_equation_error(
    records: Sequence[Record], system: System, settings: RegressionSettings | None = None
) -> Estimate:
    """Estimate the free parameters of a System by regression of rates and outputs on its equations.

    Parameters
    ----------
    records : one or more; each has its own ``bias_*`` parameters.
    system : model whose states are all measured as outputs with the same names, or are rates of
        measured states (see `state_data`). Each output that is not a state, such as nz, gives one
        equation. Bounds are respected; priors are not used.

    Returns
    -------
    Estimate of the shared free parameters. ``noise_std`` is the rms residual of the smoothing for a
    measured state, and the rms residual of its equation for any other output. The log likelihood is
    that of the residuals of the equations and cannot be compared with that of another method. The
    outcomes are those of ``fit_output_error``.

    Raises
    ------
    ModelError : where a record does not give a state, a sensor has dynamics, or no parameter is
        free.
    """
    settings = settings or RegressionSettings()
    layout = regression_layout(records, system)
    theta, parts, outcome, iterations = _least_squares(layout, settings)
    if parts is None:
        return _failed_estimate(layout, theta)
    if not settings.instruments:
        return _least_squares_estimate(layout, theta, parts, outcome, iterations, settings)
    return _with_instruments(layout, theta, parts, outcome, iterations, settings)


def _bounds(layout: RegressionLayout) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return starting values and lower and upper bounds of all unknowns, ``(n,)`` each."""
    parameters, count = layout.system.parameters, len(layout.records)
    items = [parameters[name] for name in layout.shared] + [
        parameters[name] for name in layout.local
    ] * count
    low = np.array([item.bounds[0] for item in items])
    high = np.array([item.bounds[1] for item in items])
    return np.array([item.value for item in items]), low, high


def _least_squares(
    layout: RegressionLayout, settings: RegressionSettings, start: np.ndarray | None = None
) -> tuple[np.ndarray, list[EquationResiduals] | None, Outcome, int]:
    """Return the unknowns ``(n,)`` of least squares, the residuals of each record, the outcome and
    the number of steps; the residuals are None where they are not finite at the start.
    """
    declared, low, high = _bounds(layout)
    theta = declared if start is None else start
    parts = residuals_at(layout, theta)
    if parts is None:
        return theta, None, Outcome.DIVERGED, 0
    outcome, iterations = Outcome.MAX_ITERATIONS, 0
    while iterations < settings.iterations:
        iterations += 1
        information, gradient = _normal_equations(layout, parts, len(theta))
        at_bound = ((theta <= low) & (gradient < 0)) | ((theta >= high) & (gradient > 0))
        free = np.flatnonzero((np.diag(information) > 0) & ~at_bound)
        step = np.zeros_like(theta)
        if free.size:
            step[free] = (
                inverse_information(information[np.ix_(free, free)], theta[free])[0]
                @ gradient[free]
            )
        bounded_step = np.clip(theta + step, low, high) - theta
        theta, parts, share = _descend(layout, theta, step, low, high, parts)
        change = np.abs(bounded_step) / conditional_scale(information, theta)
        if np.max(change) < settings.tolerance:
            outcome = Outcome.CONVERGED
            break
        if share == 0.0:
            break
    return theta, parts, outcome, iterations


def _cost(parts: list[EquationResiduals]) -> float:
    """Return minus the log likelihood of the residuals, without constants."""
    variance, counts = equation_variances(parts)
    return 0.5 * float(counts @ np.log(variance))


def _normal_equations(
    layout: RegressionLayout, parts: list[EquationResiduals], n: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the information ``(n, n)`` and gradient ``(n,)`` of least squares."""
    variance, _ = equation_variances(parts)
    information, gradient = np.zeros((n, n)), np.zeros(n)
    for r, part in enumerate(parts):
        weight = np.broadcast_to(1.0 / variance[:, None], part.residual.shape)
        add_normal_equations(
            information, gradient, layout.columns(r), part.jacobian, part.residual, weight
        )
    return information, gradient


def _descend(
    layout: RegressionLayout,
    theta: np.ndarray,
    step: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    parts: list[EquationResiduals],
) -> tuple[np.ndarray, list[EquationResiduals], float]:
    """Return the point after a step that is halved until the cost does not rise, its residuals, and
    the share of the step; the share is 0 where the cost always rises.
    """
    samples, share = float(equation_variances(parts)[1].sum()), 1.0
    largest = _cost(parts) + cost_rounding(samples)
    for _ in range(_MOST_HALVINGS):
        trial = np.clip(theta + share * step, low, high)
        trial_parts = residuals_at(layout, trial, with_jacobian=False)
        if trial_parts is not None and _cost(trial_parts) <= largest:
            new_parts = residuals_at(layout, trial)
            if new_parts is not None:
                return trial, new_parts, share
        share *= 0.5
    return theta, parts, 0.0


def _least_squares_estimate(
    layout: RegressionLayout,
    theta: np.ndarray,
    parts: list[EquationResiduals],
    outcome: Outcome,
    iterations: int,
    settings: RegressionSettings,
) -> Estimate:
    """Return the estimate of least squares."""
    system, n = layout.system, len(layout.shared)
    information, _ = _normal_equations(layout, parts, len(theta))
    variance, counts = equation_variances(parts)
    covariance, determined = inverse_information(information, theta)
    if not determined:
        outcome = Outcome.NOT_IDENTIFIABLE
    if settings.coloured:
        coloured = [
            (layout.columns(r), part.jacobian, part.residual, part.valid)
            for r, part in enumerate(parts)
        ]
        if determined:
            covariance = corrected_covariance(covariance, coloured, variance)
        else:
            determined_part, open_part = split_covariance(information, theta)
            covariance = corrected_covariance(determined_part, coloured, variance) + open_part
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
        iterations=iterations,
    )


def _with_instruments(
    layout: RegressionLayout,
    theta: np.ndarray,
    parts: list[EquationResiduals],
    outcome: Outcome,
    iterations: int,
    settings: RegressionSettings,
) -> Estimate:
    """Return the estimate with instrumental variables. Where no simulation follows the records, it
    is that of least squares without its bias.
    """
    least_squares = _least_squares_estimate(
        layout, theta, parts, outcome, iterations, replace(settings, coloured=False)
    )
    converged = least_squares.outcome is Outcome.CONVERGED
    instrumental = _instrumental_variables(layout, theta, settings) if converged else None
    if instrumental is None:
        least_squares = _least_squares_estimate(layout, theta, parts, outcome, iterations, settings)
        return _without_bias(layout, theta, least_squares, settings) if converged else least_squares
    theta, covariance, outcome, further_iterations = instrumental
    last_parts = residuals_at(layout, theta)
    if last_parts is None:
        return least_squares
    n = len(layout.shared)
    return replace(
        least_squares,
        values=theta[:n].copy(),
        covariance=covariance[:n, :n],
        outcome=outcome,
        noise_std=_noise_std(layout, last_parts),
        fitted=tuple(part.fitted for part in last_parts),
        iterations=iterations + further_iterations,
    )


def _instrumental_variables(
    layout: RegressionLayout, theta: np.ndarray, settings: RegressionSettings
) -> tuple[np.ndarray, np.ndarray, Outcome, int] | None:
    """Return the unknowns, covariance, outcome and number of steps with instrumental variables;
    None where no simulation gives instruments.
    """
    _, low, high = _bounds(layout)
    simulated = _simulated_states(layout, theta)
    if simulated is None:
        return None
    layout = _with_best_windows(layout, theta, simulated, settings)
    outcome, iterations = Outcome.MAX_ITERATIONS, 0
    while True:
        iterations += 1
        latest: list[list[np.ndarray]] | None = simulated
        if 1 < iterations <= INSTRUMENT_SIMULATIONS:
            latest = _simulated_states(layout, theta)
        equations = None if latest is None else _normal_problem(layout, theta, latest)
        if latest is None or equations is None:
            return None
        simulated = latest
        step = np.clip(theta + equations.inverse @ equations.gradient, low, high) - theta
        if np.max(np.abs(step) / equations.size) < settings.tolerance:
            outcome = Outcome.CONVERGED
        if outcome is Outcome.CONVERGED or iterations >= settings.iterations:
            inverse, scores = equations.inverse, equations.scores
            covariance = sandwich(inverse, scores, coloured=settings.coloured)
            return theta, covariance, outcome, iterations
        theta = theta + step


@dataclass(frozen=True, eq=False)
class _NormalProblem:
    """Equations of one step with instrumental variables.

    Attributes
    ----------
    inverse, gradient : ``(n, n)`` and ``(n,)``; their product is the step of all unknowns.
    size : ``(n,)`` sigma of each unknown with all others known.
    scores : contributions of the records to the gradient, for its covariance.
    """

    inverse: np.ndarray
    gradient: np.ndarray
    size: np.ndarray
    scores: list[RecordScores]


def _normal_problem(
    layout: RegressionLayout, theta: np.ndarray, simulated: list[list[np.ndarray]]
) -> _NormalProblem | None:
    """Return the equations with instrumental variables at ``theta``; None where they are not finite
    or singular. ``simulated`` are the states of each record that give the instruments.
    """
    measured = residuals_at(
        layout, theta, [_measured_states(layout, r, theta) for r in range(len(layout.records))]
    )
    instruments = residuals_at(layout, theta, simulated)
    if measured is None or instruments is None:
        return None
    variance, _ = equation_variances(measured)
    cross, gradient, scores = np.zeros((len(theta), len(theta))), np.zeros(len(theta)), []
    for r, (regressors, instrument) in enumerate(zip(measured, instruments, strict=True)):
        columns, weights = layout.columns(r), instrument.jacobian / variance[:, None, None]
        flat = weights.reshape(-1, len(columns))
        cross[np.ix_(columns, columns)] += flat.T @ regressors.jacobian.reshape(-1, len(columns))
        gradient[columns] += flat.T @ regressors.residual.ravel()
        scores.append(
            RecordScores(
                columns, weights, regressors.jacobian, regressors.residual, regressors.valid
            )
        )
    size = conditional_scale(np.abs(cross), theta)
    scaled = cross * np.outer(size, size)
    if not np.all(np.isfinite(scaled)) or np.linalg.cond(scaled) > 1.0 / UNDETERMINED:
        return None
    return _NormalProblem(np.linalg.inv(scaled) * np.outer(size, size), gradient, size, scores)


def _with_best_windows(
    layout: RegressionLayout,
    theta: np.ndarray,
    simulated: list[list[np.ndarray]],
    settings: RegressionSettings,
) -> RegressionLayout:
    """Return the layout with slopes over windows of the width that minimises the determinant of the
    covariance of the shared parameters.

    Slopes over wide windows have little noise, but it is correlated. The other equations then have
    too little weight.
    """
    n, best, least = len(layout.shared), layout, np.inf
    for share in WINDOW_WIDTH_SHARES:
        data = tuple(
            [_with_narrower_windows(record, state, share) for state in states]
            for record, states in zip(layout.records, layout.data, strict=True)
        )
        trial = replace(layout, data=data)
        equations = _normal_problem(trial, theta, simulated)
        if equations is None:
            continue
        covariance = sandwich(equations.inverse, equations.scores, coloured=settings.coloured)
        covariance = covariance[:n, :n]
        scale = equations.size[:n]
        sign, log_determinant = np.linalg.slogdet(covariance / np.outer(scale, scale))
        log_determinant += 2.0 * float(np.log(scale).sum())
        if sign > 0 and log_determinant < least:
            best, least = trial, log_determinant
    return best


def _with_narrower_windows(record: Record, state: StateData, share: float) -> StateData:
    """Return the state with slopes over narrower windows: a ``share`` of the half-width, and at
    least two samples. A state whose equation is not used is returned unchanged.
    """
    if state.rate_state:
        return state
    half = (state.slope_windows.value_weights.shape[1] - 1) // 2
    narrower_half = max(2, round(share * half))
    if share == 1.0 or narrower_half >= half:
        return state
    return replace(state, slope_windows=windows(record.time, state.valid, narrower_half, 1))


def _measured_states(layout: RegressionLayout, r: int, theta: np.ndarray) -> list[np.ndarray]:
    """Return the measured states of record ``r`` without sensor biases, and the smoothed ones where
    samples are missing.
    """
    p = _parameters(layout, r, theta)
    states = []
    for state in layout.data[r]:
        bias = 0.0 if state.bias is None else p[state.bias]
        states.append(np.where(state.valid, state.raw, state.smooth) - bias)
    return states


def _parameters(layout: RegressionLayout, r: int, theta: np.ndarray) -> np.ndarray:
    """Return all parameters of record ``r``."""
    p = layout.system.parameters.values()
    p[layout.positions] = theta[layout.columns(r)]
    return p


def _simulated_states(layout: RegressionLayout, theta: np.ndarray) -> list[list[np.ndarray]] | None:
    """Return the simulated states of all records, from their first smoothed states; None where one
    differs from its record by more than ``RUNAWAY_SCATTERS``.
    """
    simulated = []
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
        for state, smooth in zip(states, measured, strict=True):
            if not np.all(np.isfinite(state)):
                return None
            if np.std(state - smooth) > RUNAWAY_SCATTERS * np.std(smooth):
                return None
        simulated.append(states)
    return simulated


def _without_bias(
    layout: RegressionLayout,
    theta: np.ndarray,
    least_squares: Estimate,
    settings: RegressionSettings,
) -> Estimate:
    """Return the estimate of least squares without the bias by noise in the regressors. The bias is
    included in the sigmas.

    Additional noise of the same size doubles the bias. The random part of the change cancels in the
    mean over a noise and its negative (SIMEX of Cook and Stefanski, J. American Statistical
    Association 89, 1994, with antithetic pairs).
    """
    rng, n = np.random.default_rng(0), len(layout.shared)
    changes = []
    for _ in range(NOISE_PAIRS):
        sigma = least_squares.noise_std
        noise = [
            sigma[:, None] * rng.standard_normal((len(sigma), len(record)))
            for record in layout.records
        ]
        pair = []
        for sign in (1.0, -1.0):
            noisy = tuple(
                _with_noise(record, least_squares.output_names, sign * record_noise)
                for record, record_noise in zip(layout.records, noise, strict=True)
            )
            noisy_layout = replace(
                layout,
                records=noisy,
                data=tuple(state_data(record, layout.system) for record in noisy),
            )
            noisy_theta, parts, outcome, _ = _least_squares(noisy_layout, settings, theta)
            if parts is None or outcome is not Outcome.CONVERGED:
                return least_squares
            pair.append(noisy_theta[:n])
        changes.append(0.5 * (pair[0] + pair[1]) - theta[:n])
    bias = np.mean(changes, axis=0)
    bias_covariance = np.cov(np.array(changes).T).reshape(n, n) / NOISE_PAIRS
    return replace(
        least_squares,
        values=least_squares.values - bias,
        covariance=least_squares.covariance + np.outer(bias, bias) + bias_covariance,
    )


def _with_noise(record: Record, names: Sequence[str], noise: np.ndarray) -> Record:
    """Return the record with ``noise (m, N)`` added to the outputs ``names``."""
    channels = []
    for channel in record.outputs:
        added = noise[names.index(channel.name)] if channel.name in names else 0.0
        values = np.where(channel.valid, channel.values + added, np.nan)
        channels.append(Channel.of(channel.name, channel.unit, values))
    return replace(record, outputs=tuple(channels))


def _noise_std(layout: RegressionLayout, parts: list[EquationResiduals]) -> np.ndarray:
    """Return the rms difference ``(m,)`` of outputs and fitted values; 1 if not recorded."""
    squares, counts = np.zeros(len(layout.system.outputs)), np.zeros(len(layout.system.outputs))
    for record, part in zip(layout.records, parts, strict=True):
        z, valid = record.output_array(layout.system.output_names)
        squares += (np.where(valid, z - part.fitted, 0.0) ** 2).sum(axis=1)
        counts += valid.sum(axis=1)
    return np.where(counts > 0, np.sqrt(squares / np.maximum(counts, 1)), 1.0)


def _failed_estimate(layout: RegressionLayout, theta: np.ndarray) -> Estimate:
    """Return the estimate of a fit whose residuals are not finite at the start."""
    n, m, system = len(layout.shared), len(layout.system.outputs), layout.system
    return Estimate(
        "equation-error",
        layout.shared,
        tuple(system.parameters[name].unit for name in layout.shared),
        theta[:n],
        np.diag(np.maximum(1.0, theta[:n] ** 2)),
        Outcome.DIVERGED,
        -LARGEST_NUMBER,
        system.output_names,
        np.ones(m),
        tuple(np.zeros((m, len(record))) for record in layout.records),
    )
