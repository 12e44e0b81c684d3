"""Iterated extended Kalman filter: each pass linearises about the smoothed trajectory of the one before.

For the dynamics and noise declared this is the Gauss-Newton method for the most probable trajectory and
parameters (Bell, "The Iterated Kalman Smoother as a Gauss-Newton Method", SIAM J. Optimization 4(3), 1994).
A start that is far off no longer leaves its mark: the prior keeps its mean and weight, only the point of
linearisation moves, so no datum counts twice.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ident.estimate import Estimate, Outcome
from ident.filters.ekf import SETTLED, FilterSettings, OnePass, filter_by_filterpy
from ident.filters.problem import filter_problem
from ident.filters.smoother import SmoothedHistory, smooth
from sim.declaration.model import System
from sim.record import Record


def run_iterated_ekf(
    record: Record,
    system: System,
    settings: FilterSettings | None = None,
    iterations: int = 15,
    *,
    first: System | None = None,
    by: OnePass = filter_by_filterpy,
) -> Estimate:
    """Estimate states and free parameters by a filter that is linearised anew about its own smoothed result.

    Parameters
    ----------
    record, system, settings : as for ``run_ekf``; ``settings.passes`` is not used.
    iterations : limit of passes; it stops when no parameter moves by more than a hundredth of its sigma.
    first : the same system with another start and narrower priors, for the first pass alone: it gives the first point to linearise at.
    by : what runs a pass, as for ``run_ekf``.

    Returns
    -------
    Estimate after the last pass; its outcome is ``MAX_ITERATIONS`` when it had not settled. Where a pass broke down, the
    estimate is that of the pass before it, with the outcome of the one that broke down.

    Raises
    ------
    ModelError : as for ``run_ekf``.
    """
    settings = settings or FilterSettings()
    problem = filter_problem(record, system, settings.max_step)
    begun = by(problem if first is None else filter_problem(record, first, settings.max_step), settings)
    return settled(begun, lambda done: by(problem, settings, about=done.mean), iterations)


def settled(estimate: Estimate, further: Callable[[SmoothedHistory], Estimate], iterations: int) -> Estimate:
    """Passes about the smoothed result of the one before, until no parameter moves by more than a hundredth of its sigma."""
    if estimate.outcome is not Outcome.CONVERGED:
        return estimate
    for done in range(2, iterations + 1):
        assert estimate.history is not None
        again = further(smooth(estimate.history))
        if again.outcome is not Outcome.CONVERGED:
            said = f"pass {done} broke down {again.message}: values and sigmas are those of the pass before it, which had not settled"
            return replace(estimate, outcome=again.outcome, message=said)
        moved = np.max(np.abs(again.values - estimate.values) / np.maximum(estimate.std, np.finfo(float).tiny), initial=0.0)
        estimate = replace(again, iterations=done)
        if moved < SETTLED:
            return estimate
    return replace(estimate, outcome=Outcome.MAX_ITERATIONS)
