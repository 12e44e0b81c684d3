"""A pure delay found by a bank of filters: one extended Kalman filter for each delay, judged by likelihood.

NASA TM-101722 ran nine filters from 0 to 200 ms and took the most likely one, having considered the likelihood-weighted sum.
Both are given here, and a delay between the grid points: further banks close in on the maximum until the log-likelihood
is a parabola over neighbouring filters, whose vertex and curvature are the delay and its standard deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.bank import BankEstimate, run_bank
from ident.ekf import FilterSettings, run_ekf
from ident.estimate import Estimate, Outcome
from sim.errors import ModelError
from sim.parameters import ParameterSet
from sim.record import Record
from sim.system import System

DELAYS = tuple(0.025 * i for i in range(9))  # s
_PARABOLA = 2.0  # a fall of the log-likelihood to the neighbours (two sigmas) over which it counts as a parabola
_FINEST = 1e-4  # s, closer together filters do not stand
_ZOOMS = 5


@dataclass(frozen=True, eq=False)
class DelayBank:
    """What a bank of delays says.

    Attributes
    ----------
    delays, log_likelihood : ``(B,)`` of the declared grid, s; minus infinity for a filter that broke down.
    weights : ``(B,)`` likelihoods normalised to a sum of one.
    bank : the filters of the declared grid.
    most_likely : the delay of the largest likelihood, s.
    weighted_mean : the sum of all delays by their weights, s.
    refined, refined_std : delay between the grid points with its standard deviation, s; the latter is that of white
        innovations and knows nothing of a model that is wrong.
    at_edge : the likelihood is largest at the end of the grid; nothing is refined beyond it.
    estimate : the filter at the refined delay with its history. Where refinement gave a sigma, ``delay`` is the last name and
        the covariance holds what the delay's uncertainty adds to the others; else the delay is not among the names.
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


def run_delay_bank(
    record: Record, system: System, delays: Sequence[float] = DELAYS, settings: FilterSettings | None = None, *, name: str = "delay"
) -> DelayBank:
    """Run a filter for each delay in one batched pass, then refine.

    Parameters
    ----------
    record, settings : as for ``run_ekf``.
    system : compiled with ``online=True``; its parameter ``name`` is held, and its value does not matter.
    delays : at least three, increasing, s.

    Raises
    ------
    ModelError : fewer than three delays, or not increasing; ``name`` is free or unknown; else as for ``run_ekf``.
    """
    grid = np.asarray(delays, dtype=float)
    if grid.ndim != 1 or grid.size < 3 or np.any(np.diff(grid) <= 0):
        raise ModelError("fewer than three delays, or not increasing", where="delay bank", remedy="give three or more in order, in s")
    settings = settings or FilterSettings()
    bank = run_bank(record, system, settings, held={name: grid})
    weights = likelihood_weights(bank.log_likelihood)
    best = int(np.argmax(bank.log_likelihood))
    at_edge = best in (0, grid.size - 1)
    refined, std, slope = float(grid[best]), 0.0, None
    if not at_edge:
        refined, std, slope = _closing_in(record, system, settings, name, grid, bank)
    held = replace(system, parameters=_valued(system.parameters, name, refined))
    estimate = run_ekf(record, held, settings)
    if slope is not None and std > 0 and estimate.outcome is Outcome.CONVERGED:
        estimate = _with_delay(estimate, name, system.parameters[name].unit, refined, std, slope[len(system.states) :])
    mean = float(weights @ grid)
    return DelayBank(grid, bank.log_likelihood, weights, bank, float(grid[best]), mean, refined, std, at_edge, estimate)


def likelihood_weights(log_likelihood: np.ndarray) -> np.ndarray:
    """Likelihoods normalised to a sum of one, without overflow; equal where no filter is sound."""
    top = np.max(log_likelihood)
    if not np.isfinite(top):
        return np.full(log_likelihood.shape, 1.0 / log_likelihood.size)
    weights = np.exp(log_likelihood - top)
    return np.asarray(weights / weights.sum())


def vertex(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Vertex of the parabola through three points ``(3,)`` and minus its second derivative."""
    d1, d2 = (y[1] - y[0]) / (x[1] - x[0]), (y[2] - y[1]) / (x[2] - x[1])
    curvature = -2.0 * (d2 - d1) / (x[2] - x[0])
    if not curvature > 0:
        return float(x[1]), 0.0
    return float(0.5 * (x[0] + x[1]) + d1 / curvature), float(curvature)


def _closing_in(
    record: Record, system: System, settings: FilterSettings, name: str, grid: np.ndarray, bank: BankEstimate
) -> tuple[float, float, np.ndarray | None]:
    """Delay, sigma and change of the mean (n,) per second of delay, from banks ever closer around the maximum."""
    for _ in range(_ZOOMS):
        near = slice(int(np.argmax(bank.log_likelihood)) - 1, int(np.argmax(bank.log_likelihood)) + 2)
        fall = bank.log_likelihood[near].max() - bank.log_likelihood[near].min()
        if fall <= _PARABOLA or grid[near][1] - grid[near][0] <= _FINEST:
            break
        # The ends are inside the last bank's neighbours; an end of the finer grid can be its maximum only by rounding.
        grid = np.linspace(grid[near][0], grid[near][2], grid.size)
        bank = run_bank(record, system, settings, held={name: grid})
        if int(np.argmax(bank.log_likelihood)) in (0, grid.size - 1):
            return float(grid[np.argmax(bank.log_likelihood)]), 0.0, None
    best = int(np.argmax(bank.log_likelihood))
    near = slice(best - 1, best + 2)
    delay, curvature = vertex(grid[near], bank.log_likelihood[near])
    if curvature == 0.0 or not np.all(bank.sound[near]):
        return delay, 0.0, None
    slope = (bank.mean[:, best + 1] - bank.mean[:, best - 1]) / (grid[best + 1] - grid[best - 1])
    return delay, curvature**-0.5, slope


def _with_delay(estimate: Estimate, name: str, unit: str, delay: float, std: float, slope: np.ndarray) -> Estimate:
    n = len(estimate.names)
    covariance = np.zeros((n + 1, n + 1))
    covariance[:n, :n] = estimate.covariance
    whole = np.append(slope, 1.0) * std
    covariance += np.outer(whole, whole)
    return replace(
        estimate,
        names=(*estimate.names, name),
        units=(*estimate.units, unit),
        values=np.append(estimate.values, delay),
        covariance=covariance,
    )


def _valued(parameters: ParameterSet, name: str, value: float) -> ParameterSet:
    return parameters.with_values({name: value})
