"""Iterated extended Kalman filters for many runs at once.

The smoothed trajectory of the iterated filter comes from the modified Bryson-Frazier recursion,
which inverts only the covariance of the innovations (Bierman, "Fixed Interval Smoothing with
Discrete Measurements", Int. J. Control 18(1), 1973).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ident.banks.bank import BankEstimate, bank_estimate, bank_runs, run_pass
from ident.banks.equation_kernels import BankTrace, empty_trace
from ident.filters.ekf import SETTLED_SIGMAS, FilterSettings
from sim.declaration.model import System
from sim.record import Record

MOST_ITERATIONS = 15  # most passes of an iterated filter


def run_iterated_bank(
    record: Record,
    system: System,
    settings: FilterSettings | None = None,
    *,
    fixed_values: Mapping[str, np.ndarray] | None = None,
    nominal: np.ndarray | None = None,
    iterations: int = MOST_ITERATIONS,
    tolerance: float = SETTLED_SIGMAS,
) -> tuple[BankEstimate, np.ndarray]:
    """Run B filters, each linearised about its own smoothed trajectory, in passes until they
    converge.

    Parameters
    ----------
    record, system, settings, fixed_values : as for ``run_bank``; ``settings.passes`` is not used.
    nominal : ``(n, N, B)`` or ``(n, N, 1)`` trajectories about which the first pass is linearised,
        for example those of a similar run; None takes the means of the filters.
    iterations : largest number of passes. A run that has then not converged, or has broken down, is
        not sound.
    tolerance : a run has converged when no parameter changes by more than this many sigmas.

    Returns
    -------
    The estimates of the last pass, and its smoothed trajectories ``(n, N, B)``.

    Raises
    ------
    ModelError : as for ``run_bank``.
    """
    settings = settings or FilterSettings()
    problem, runs = bank_runs(record, system, settings, fixed_values=fixed_values)
    n_x, count = len(system.states), runs.start.shape[1]
    if nominal is not None:
        nominal = np.array(np.broadcast_to(nominal, (len(problem.names), len(problem.time), count)))
    before, converged, passes = None, np.zeros(count, dtype=bool), 0
    while True:
        passes += 1
        trace = empty_trace(problem, count)
        result = run_pass(problem, settings, runs, False, nominal, trace)
        with np.errstate(all="ignore"):
            nominal = smoothed(trace)
        # Linearise a failed run about its start, so that it does not disturb the others.
        nominal[:, :, ~result.sound] = runs.start[:, None, ~result.sound]
        if before is not None:
            std = np.sqrt(
                np.maximum(
                    np.diagonal(result.covariance, axis1=1, axis2=2).T[n_x:], np.finfo(float).tiny
                )
            )
            converged = (
                np.max(np.abs(result.mean[n_x:] - before) / std, axis=0, initial=0.0) < tolerance
            )
            if np.all(converged | ~result.sound):
                break
        if passes == iterations:
            break
        before = result.mean[n_x:]
    return bank_estimate(
        problem, result, np.full(count, passes), sound=result.sound & converged
    ), nominal


def smoothed(trace: BankTrace) -> np.ndarray:
    """Return the smoothed means ``(n, N, B)`` of the linearised problem of a pass.

    The adjoint recursion is lambda[k] = l[k] - H^T S^-1 (H P l[k] + y), with l[k] = Phi[k+1]^T
    lambda[k+1] and l = 0 at the last sample. The smoothed mean is x - P l[k], with x and P after
    the update.
    """
    N, n, B = trace.mean.shape
    n_x = trace.transition.shape[2]
    inverse = _inverse(trace.S)
    means = np.empty((n, N, B))
    later = np.zeros((B, n, 1))
    for k in range(N - 1, -1, -1):
        means[:, k] = trace.mean[k] - (trace.covariance[k] @ later)[:, :, 0].T
        weighted = inverse[k] @ (trace.HP[k] @ later + trace.y[k][:, :, None])
        adjoint = later - np.swapaxes(trace.H[k], 1, 2) @ weighted
        later = adjoint + np.swapaxes(trace.transition[k], 1, 2) @ adjoint[:, :n_x]
    return means


def _inverse(S: np.ndarray) -> np.ndarray:
    """Return the inverses of covariances ``(N, B, m, m)``; pseudo-inverses if one is singular."""
    try:
        return np.linalg.inv(S)
    except np.linalg.LinAlgError:
        return np.linalg.pinv(np.nan_to_num(S))
