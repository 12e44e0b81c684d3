"""The iterated extended Kalman filter for many runs at once, as `ident.filters.iterated_ekf` is for one.

The smoothed trajectory to linearise about comes from the modified Bryson-Frazier recursion, which inverts nothing but
the innovations' covariance (Bierman, "Fixed Interval Smoothing with Discrete Measurements", Int. J. Control 18(1), 1973).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ident.banks.bank import BankEstimate, bank_estimate, bank_runs
from ident.banks.one_pass import run_pass
from ident.banks.runs import BankTrace, empty_trace
from ident.filters.ekf import SETTLED, FilterSettings
from sim.declaration.model import System
from sim.record import Record

ITERATIONS = 15


def run_iterated_bank(
    record: Record,
    system: System,
    settings: FilterSettings | None = None,
    *,
    held: Mapping[str, np.ndarray] | None = None,
    about: np.ndarray | None = None,
    iterations: int = ITERATIONS,
    tolerance: float = SETTLED,
) -> tuple[BankEstimate, np.ndarray]:
    """Run B filters, each linearised anew about its own smoothed result until none moves further.

    Parameters
    ----------
    record, system, settings, held : as for ``run_bank``; ``settings.passes`` is not used.
    about : ``(n, N, B)`` or ``(n, N, 1)``, a trajectory for the first pass, e.g. that of a run nearby; the filter's own when None.
    tolerance : a run has settled when no parameter moves by more than this many sigmas.
    iterations : limit of passes. A run that has not settled by then, or broke down, is not sound.

    Returns
    -------
    The last pass and its smoothed trajectories ``(n, N, B)``.

    Raises
    ------
    ModelError : as for ``run_bank``.
    """
    settings = settings or FilterSettings()
    problem, runs = bank_runs(record, system, settings, held=held)
    n_x, count = len(system.states), runs.start.shape[1]
    if about is not None:
        about = np.array(np.broadcast_to(about, (len(problem.names), len(problem.time), count)))
    before, settled, passes = None, np.zeros(count, dtype=bool), 0
    while True:
        passes += 1
        trace = empty_trace(problem, count)
        result = run_pass(problem, settings, runs, False, about, trace)
        with np.errstate(all="ignore"):
            about = smoothed(trace)
        # A run that broke down is linearised at the start; it only must not disturb the others.
        about[:, :, ~result.sound] = runs.start[:, None, ~result.sound]
        if before is not None:
            std = np.sqrt(np.maximum(np.diagonal(result.covariance, axis1=1, axis2=2).T[n_x:], np.finfo(float).tiny))
            settled = np.max(np.abs(result.mean[n_x:] - before) / std, axis=0, initial=0.0) < tolerance
            if np.all(settled | ~result.sound):
                break
        if passes == iterations:
            break
        before = result.mean[n_x:]
    return bank_estimate(problem, result, np.full(count, passes), sound=result.sound & settled), about


def smoothed(trace: BankTrace) -> np.ndarray:
    """Means given all samples, ``(n, N, B)``, of the linear problem that a pass solved.

    lambda[k] = l - H^T S^-1 (H P l + y) with l = Phi[k+1]^T lambda[k+1] and zero at the end; x_s = x - P_filtered l.
    """
    N, n, B = trace.mean.shape
    n_x = trace.moved.shape[2]
    inverse = _inverse(trace.S)
    out = np.empty((n, N, B))
    later = np.zeros((B, n, 1))
    for k in range(N - 1, -1, -1):
        out[:, k] = trace.mean[k] - (trace.covariance[k] @ later)[:, :, 0].T
        weighed = inverse[k] @ (trace.HP[k] @ later + trace.y[k][:, :, None])
        here = later - np.swapaxes(trace.H[k], 1, 2) @ weighed
        later = here + np.swapaxes(trace.moved[k], 1, 2) @ here[:, :n_x]
    return out


def _inverse(S: np.ndarray) -> np.ndarray:
    try:
        return np.linalg.inv(S)
    except np.linalg.LinAlgError:
        return np.linalg.pinv(np.nan_to_num(S))
