"""Estimate of a pure delay by a bank of filters with different delays.

NASA TM-101722 ran nine filters with delays from 0 to 200 ms, and used the most likely filter and
the weighted sum. Both are returned here, and also a refined delay between the grid points. Wrong
starting values bias ordinary filters, since delay, lag and short period are correlated. The refined
banks are therefore linearised about their own smoothed result (`ident.banks.engines`). Their
grids shrink about the maximum until the log likelihood is a parabola. Its vertex is the delay, and
its curvature gives the sigma.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.banks.bank import BankEstimate
from ident.banks.engines import BATCHED, BankEngine
from ident.estimate import Estimate, Outcome
from ident.filters.ekf import FilterSettings
from sim.declaration.model import System
from sim.errors import ModelError
from sim.record import Record

DELAYS = tuple(0.025 * i for i in range(9))  # default grid of delays, s
_LARGEST_PARABOLA_FALL = 4.5  # largest drop of log likelihood fitted by a parabola: three sigmas
_FINEST_SPACING = 1e-4  # smallest difference of two delays, s
_REFINED_POINTS = 7  # delays in a refined bank
_MOST_BANKS = 8  # most refined banks
_REFINED_REACH = 6.0  # half-width of a refined bank, in sigmas
# tolerance of the last bank, in sigmas; it changes the log likelihood by 0.005
_SETTLED_SIGMAS = 0.1
WIDENINGS = 4  # most repetitions with wider priors
FAR_SIGMAS = 3.0  # largest change of a parameter that agrees with its prior, in sigmas of the prior


@dataclass(frozen=True, eq=False)
class DelayBank:
    """Result of a bank of filters with different delays.

    Attributes
    ----------
    delays, log_likelihood : ``(B,)`` of the declared grid, s; minus infinity for a filter that
        broke down.
    weights : ``(B,)`` likelihoods normalised to a sum of one.
    bank : estimates of the declared grid.
    most_likely : delay of the largest likelihood, s.
    weighted_mean : mean of the delays by their weights, s.
    refined, refined_std : delay between the grid points and its standard deviation, s. The
        standard deviation holds for white innovations and a correct model.
    at_edge : whether no maximum is inside the grid; the refined delay then has no sigma.
    estimate : the iterated filter at the refined delay, with its history. Where the delay has a
        sigma, it is the last parameter, and its uncertainty is in the covariance of the others.
        The message names contradicted priors.
    contradicted : parameters that are more than ``FAR_SIGMAS`` sigmas of the prior from the start,
        with this distance. Their estimates depend on the start.
    system : the System of ``estimate``, with the widened priors.
    nominal : ``(n, N)`` smoothed trajectory about which the refined filters were linearised; None
        where no filter was sound.
    """

    delays: np.ndarray
    log_likelihood: np.ndarray
    weights: np.ndarray
    bank: BankEstimate
    most_likely: float
    weighted_mean: float
    refined: float
    refined_std: float
    at_edge: bool
    estimate: Estimate
    contradicted: tuple[tuple[str, float], ...]
    system: System
    nominal: np.ndarray | None


def run_delay_bank(
    record: Record,
    system: System,
    delays: Sequence[float] = DELAYS,
    *,
    name: str = "delay",
    widenings: int = WIDENINGS,
    engine: BankEngine = BATCHED,
) -> DelayBank:
    """Run a filter for each delay, then refine the delay between the grid points.

    Parameters
    ----------
    record : as for ``run_ekf``.
    system : model compiled with ``online=True``, with a fixed parameter ``name``.
    delays : at least three, increasing, s.
    name : name of the parameter that is the delay.
    widenings : largest number of repetitions with wider priors. Priors that the record contradicts
        are widened, so that the result does not depend on a wrong start: the sigma of such a prior
        becomes the distance of the estimate from the start. With 0 the declared priors are kept.
    engine : engine that runs the filters; both engines give the same result.

    Raises
    ------
    ModelError : as for ``run_ekf``. Also where there are fewer than three delays, they do not
        increase, or ``name`` is free or unknown.
    """
    grid = np.asarray(delays, dtype=float)
    if grid.ndim != 1 or grid.size < 3 or np.any(np.diff(grid) <= 0):
        raise ModelError(
            "there are fewer than three delays, or they do not increase",
            where="delay bank",
            remedy="give three or more in order, in s",
        )
    settings = FilterSettings()
    bank = engine.run(record, system, settings, fixed_values={name: grid})
    weights, best = likelihood_weights(bank.log_likelihood), int(np.argmax(bank.log_likelihood))
    bracket = (float(grid[max(best - 1, 0)]), float(grid[min(best + 1, grid.size - 1)]))

    def refined(start: float, nominal: np.ndarray | None) -> _RefinedDelay:
        return _refine_delay(engine, record, system, settings, name, grid, start, bracket, nominal)

    bank_result = refined(float(grid[best]), None)
    for _ in range(widenings):
        contradicted_parameters = contradicted(system, bank_result.parameters)
        if not contradicted_parameters:
            break
        system = widened(system, contradicted_parameters)
        half_width = 0.5 * (bracket[1] - bracket[0])
        bracket = (
            max(bank_result.delay - half_width, float(grid[0])),
            min(bank_result.delay + half_width, float(grid[-1])),
        )
        bank_result = refined(bank_result.delay, bank_result.nominal)
    fixed_system = replace(
        system, parameters=system.parameters.with_values({name: bank_result.delay})
    )
    nominal = None if bank_result.nominal is None else bank_result.nominal[:, :, 0]
    estimate = engine.alone(record, fixed_system, settings, nominal)
    contradicted_parameters = contradicted(system, estimate.as_dict())
    if contradicted_parameters and estimate.outcome is Outcome.CONVERGED:
        text = ", ".join(
            f"{parameter} by {abs(sigmas):.1f}" for parameter, sigmas in contradicted_parameters
        )
        message = (
            f"but far from the start, in sigmas of its prior: {text}; start again from this result"
        )
        estimate = replace(estimate, message=message)
    if bank_result.std > 0 and estimate.outcome is Outcome.CONVERGED:
        estimate = _with_delay(
            estimate, name, system.parameters[name].unit, bank_result, len(system.states)
        )
    return DelayBank(
        grid,
        bank.log_likelihood,
        weights,
        bank,
        float(grid[best]),
        float(weights @ grid),
        bank_result.delay,
        bank_result.std,
        bank_result.std == 0.0,
        estimate,
        contradicted_parameters,
        system,
        nominal,
    )


def contradicted(system: System, values: Mapping[str, float]) -> tuple[tuple[str, float], ...]:
    """Return the names of the free parameters whose ``values`` are more than ``FAR_SIGMAS`` sigmas
    of the prior from its mean, each with this distance in sigmas.
    """
    free = [system.parameters[name] for name in system.parameters.free_names if name in values]
    far = [
        (item.name, (values[item.name] - item.value) / item.prior_std)
        for item in free
        if item.prior_std > 0
    ]
    return tuple((name, float(sigmas)) for name, sigmas in far if abs(sigmas) > FAR_SIGMAS)


def widened(system: System, contradicted_parameters: Sequence[tuple[str, float]]) -> System:
    """Return the System with wider priors of the contradicted parameters. The sigma of each becomes
    the distance of the estimate from the prior mean.
    """
    parameters = system.parameters
    wider = {name: abs(far) * parameters[name].prior_std for name, far in contradicted_parameters}
    return replace(system, parameters=parameters.with_prior(wider))


def likelihood_weights(log_likelihood: np.ndarray) -> np.ndarray:
    """Return likelihoods ``(..., B)`` normalised to a sum of one; equal if none is finite."""
    top = np.max(log_likelihood, axis=-1, keepdims=True)
    finite = np.isfinite(top)
    weights = np.exp(np.where(finite, log_likelihood - np.where(finite, top, 0.0), 0.0))
    return np.asarray(weights / weights.sum(axis=-1, keepdims=True))


def parabola_vertex(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Return the vertex of the parabola through three points ``(3,)``, and minus its
    second derivative.
    """
    d1, d2 = (y[1] - y[0]) / (x[1] - x[0]), (y[2] - y[1]) / (x[2] - x[1])
    curvature = -2.0 * (d2 - d1) / (x[2] - x[0])
    if not curvature > 0:
        return float(x[1]), 0.0
    return float(0.5 * (x[0] + x[1]) + d1 / curvature), float(curvature)


@dataclass(frozen=True, eq=False)
class _RefinedDelay:
    """Refined delay, and the filter nearest to it.

    Attributes
    ----------
    delay : refined delay, s.
    std : its standard deviation, s; 0 without a maximum inside the grid.
    slope : ``(n,)`` derivative of the mean with respect to the delay; empty without a maximum.
    nominal : ``(n, N, 1)`` smoothed trajectory of the nearest filter.
    parameters : free parameter -> value of the nearest filter at the last sample.
    """

    delay: float
    std: float
    slope: np.ndarray
    nominal: np.ndarray | None
    parameters: Mapping[str, float]


def _refine_delay(
    engine: BankEngine,
    record: Record,
    system: System,
    settings: FilterSettings,
    name: str,
    grid: np.ndarray,
    best: float,
    bracket: tuple[float, float],
    nominal: np.ndarray | None,
) -> _RefinedDelay:
    """Return the delay of the maximum likelihood, by iterated banks on shrinking grids.

    The centre of each grid is the vertex of a parabola through the likelihoods of the grid before,
    and its width follows from the curvature. Where the maximum is at an end, the grid is moved
    first. Only the last bank is iterated to convergence.

    Parameters
    ----------
    grid : ``(B,)`` delays of the declared grid, s.
    best : most likely delay of the declared grid, s.
    bracket : lowest and highest delay of the first refined grid, s.
    nominal : ``(n, N, 1)`` trajectory about which the first refined bank is linearised; None takes
        the means of the filters.
    """
    low, high = bracket
    without_maximum = _RefinedDelay(best, 0.0, np.zeros(0), nominal, {})
    for _ in range(_MOST_BANKS):
        fine = np.linspace(low, high, _REFINED_POINTS)
        bank, trajectories = engine.iterated(
            record, system, settings, fixed_values={name: fine}, nominal=nominal, tolerance=np.inf
        )
        if not np.any(bank.sound):
            return without_maximum
        top = int(np.argmax(bank.log_likelihood))
        nominal = trajectories[:, :, top : top + 1]
        without_maximum = _RefinedDelay(
            float(fine[top]), 0.0, np.zeros(0), nominal, _final_parameters(system, nominal)
        )
        if top in (0, _REFINED_POINTS - 1):
            shift = (
                (fine[top] - 0.5 * (low + high)) if top else -min(0.5 * (high - low), low - grid[0])
            )
            shift = min(shift, grid[-1] - high)
            if shift == 0.0:
                return without_maximum
            low, high = low + shift, high + shift
            continue
        near = slice(top - 1, top + 2)
        spacing = fine[1] - fine[0]
        fall = bank.log_likelihood[top] - bank.log_likelihood[near].min()
        if fall <= _LARGEST_PARABOLA_FALL or spacing <= _FINEST_SPACING:
            bank, trajectories = engine.iterated(
                record,
                system,
                settings,
                fixed_values={name: fine[near]},
                nominal=trajectories[:, :, near],
                tolerance=_SETTLED_SIGMAS,
            )
            delay, curvature = parabola_vertex(fine[near], bank.log_likelihood)
            if curvature > 0 and np.all(bank.sound) and abs(delay - fine[top]) <= spacing:
                slope = (bank.mean[:, 2] - bank.mean[:, 0]) / (2.0 * spacing)
                nearest = trajectories[:, :, 1:2]
                return _RefinedDelay(
                    delay, curvature**-0.5, slope, nearest, _final_parameters(system, nearest)
                )
            if curvature > 0 and np.all(bank.sound):
                low, high = delay - 0.5 * (high - low), delay + 0.5 * (high - low)
                continue
            return without_maximum
        delay, curvature = parabola_vertex(fine[near], bank.log_likelihood[near])
        half_width = spacing
        if curvature > 0:
            half_width = max(min(_REFINED_REACH * curvature**-0.5, spacing), 3.0 * _FINEST_SPACING)
        low, high = delay - half_width, delay + half_width
    return without_maximum


def _final_parameters(system: System, trajectory: np.ndarray) -> Mapping[str, float]:
    """Return the free parameters at the last sample of a trajectory ``(n, N, 1)``."""
    values = trajectory[len(system.states) :, -1, 0].tolist()
    return dict(zip(system.parameters.free_names, values, strict=True))


def _with_delay(
    estimate: Estimate, name: str, unit: str, refined: _RefinedDelay, n_x: int
) -> Estimate:
    """Return the estimate with the delay as last parameter, its uncertainty added to the others."""
    n = len(estimate.names)
    covariance = np.zeros((n + 1, n + 1))
    covariance[:n, :n] = estimate.covariance
    delay_sigmas = np.append(refined.slope[n_x:], 1.0) * refined.std
    return replace(
        estimate,
        names=(*estimate.names, name),
        units=(*estimate.units, unit),
        values=np.append(estimate.values, refined.delay),
        covariance=covariance + np.outer(delay_sigmas, delay_sigmas),
    )
