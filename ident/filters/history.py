"""Keeps what a filter does, sample by sample, and turns it into an Estimate."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ident.estimate import LARGEST, Estimate, FilterHistory, Outcome
from ident.filters.problem import FilterProblem

LOG_TWO_PI = float(np.log(2.0 * np.pi))


def breakdown(mean: np.ndarray, covariance: np.ndarray, *further: np.ndarray | float) -> Outcome | None:
    """How a filter broke down, None for a sound mean ``(n,)``, covariance ``(n, n)`` and further numbers."""
    numbers = (mean, covariance, *further)
    # Sums of squares are the cheaper bound, and a NaN fails either comparison.
    if not sum(np.vdot(v, v) for v in numbers) < LARGEST and not all(np.abs(v).max(initial=0.0) < LARGEST for v in numbers):
        return Outcome.DIVERGED
    return Outcome.INDEFINITE if covariance.diagonal().min() < 0.0 else None


class HistoryKeeper:
    """Collects predictions, innovations and updates of one pass; any filter can use it.

    A filter that breaks down leaves the samples after the last sound one at that sample's values, so no
    history holds anything but finite numbers.
    """

    def __init__(self, problem: FilterProblem) -> None:
        n, m, N = len(problem.names), len(problem.variance), len(problem.time)
        self._problem = problem
        self._last = -1
        self._mean, self._covariance = np.zeros((n, N)), np.zeros((N, n, n))
        self._predicted_mean, self._predicted_covariance = np.zeros((n, N)), np.zeros((N, n, n))
        self._transition = np.zeros((N, n, n))
        self._innovation, self._innovation_covariance = np.zeros((m, N)), np.tile(np.eye(m), (N, 1, 1))
        self._sensitivity = np.zeros((N, m, n))
        self._valid = np.zeros((m, N), dtype=bool)
        self._log_likelihood, self._nis, self._degrees = np.zeros(N), np.zeros(N), np.zeros(N, dtype=int)
        self._outputs = np.zeros((m, N))

    def predicted(self, k: int, mean: np.ndarray, covariance: np.ndarray, transition: np.ndarray) -> None:
        """Before the update at sample ``k``."""
        self._predicted_mean[:, k], self._predicted_covariance[k], self._transition[k] = mean, covariance, transition

    def transition(self, k: int) -> np.ndarray:
        """The transition kept for sample ``k``."""
        return self._transition[k]

    def outputs(self, k: int, y: np.ndarray) -> None:
        """All outputs ``(m,)`` that the filter expects at sample ``k``, also of channels without a sample."""
        self._outputs[:, k] = y

    def innovation(self, k: int, rows: np.ndarray, y: np.ndarray, S: np.ndarray, H: np.ndarray, log_likelihood: float, nis: float) -> None:
        """Innovation ``y`` of the channels ``rows``, its covariance ``S``, and the output sensitivity ``H`` that gave the gain."""
        self._innovation[rows, k], self._valid[rows, k], self._sensitivity[k, rows] = y, True, H
        self._innovation_covariance[k][np.ix_(rows, rows)] = S
        self._log_likelihood[k], self._nis[k], self._degrees[k] = log_likelihood, nis, len(rows)

    def filtered(self, k: int, mean: np.ndarray, covariance: np.ndarray) -> None:
        """After the update at sample ``k``, which was sound."""
        self._mean[:, k], self._covariance[k], self._last = mean, covariance, k

    def estimate(self, method: str, outcome: Outcome) -> Estimate:
        """The estimate after the last sound sample."""
        problem, last, N = self._problem, self._last, len(self._problem.time)
        final_mean = self._mean[:, last] if last >= 0 else problem.start
        final_covariance = self._covariance[last] if last >= 0 else problem.covariance
        for k in range(last + 1, N):
            self._mean[:, k] = self._predicted_mean[:, k] = final_mean
            self._covariance[k] = self._predicted_covariance[k] = final_covariance
            self._transition[k] = np.eye(len(problem.names))
            self._valid[:, k], self._innovation[:, k], self._sensitivity[k] = False, 0.0, 0.0
            self._innovation_covariance[k] = np.eye(len(problem.variance))
            self._log_likelihood[k] = self._nis[k] = self._degrees[k] = 0
            self._outputs[:, k] = self._outputs[:, last] if last >= 0 else 0.0
        history = FilterHistory(
            problem.time,
            problem.names,
            self._mean,
            np.sqrt(np.maximum(np.diagonal(self._covariance, axis1=1, axis2=2).T, 0.0)),
            self._innovation,
            np.sqrt(np.diagonal(self._innovation_covariance, axis1=1, axis2=2).T),
            self._valid,
            self._log_likelihood,
            self._nis,
            self._degrees,
            self._predicted_mean,
            self._predicted_covariance,
            self._covariance,
            self._transition,
            self._sensitivity,
            self._innovation_covariance,
        )
        message = "" if outcome is Outcome.CONVERGED else f"at {problem.time[min(last + 1, N - 1)]:g} s"
        return replace(_estimate(problem, method, outcome, final_mean, final_covariance, self._outputs, history), message=message)


class Kept(NamedTuple):
    """What a pass writes while it runs, the sample first: means ``(N, n)`` and covariances ``(N, n, n)`` before and after each update, the
    transition to it, innovations ``(N, m)`` with ``S (N, m, m)``, sensitivities ``(N, m, n)`` and expected outputs ``(N, m)``."""

    mean: np.ndarray
    covariance: np.ndarray
    predicted_mean: np.ndarray
    predicted_covariance: np.ndarray
    transition: np.ndarray
    innovation: np.ndarray
    S: np.ndarray
    sensitivity: np.ndarray
    outputs: np.ndarray


def empty_history(problem: FilterProblem) -> Kept:
    """Room for a pass; transitions are the identity."""
    n, (m, N) = len(problem.names), problem.valid.shape
    whole, mean, output = (N, n, n), (N, n), (N, m)
    transition = np.array(np.broadcast_to(np.eye(n), whole), order="C")
    arrays = (np.empty(mean), np.empty(whole), np.empty(mean), np.empty(whole), transition, np.empty(output), np.empty((N, m, m)))
    return Kept(*arrays, np.empty((N, m, n)), np.empty(output))


def finished(problem: FilterProblem, kept: Kept, method: str) -> Estimate | None:
    """The estimate of a pass that went through; None where a number is not finite, or a variance negative, by the rules of ``breakdown``."""
    variance = np.diagonal(kept.covariance, axis1=1, axis2=2)
    if not all(each.max(initial=0.0) < LARGEST and each.min(initial=0.0) > -LARGEST for each in kept) or variance.min(initial=0.0) < 0.0:
        return None
    try:
        root = np.linalg.cholesky(kept.S)
    except np.linalg.LinAlgError:
        return None
    # A channel that is missing has zero in y and one in S, which adds nothing.
    nis = np.square(np.linalg.solve(root, kept.innovation[:, :, None])[:, :, 0]).sum(axis=1)
    if not np.all(nis < LARGEST):
        return None
    degrees = np.count_nonzero(problem.valid, axis=0)
    log_likelihood = -0.5 * (nis + degrees * LOG_TWO_PI) - np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
    for P in (kept.predicted_covariance, kept.covariance):
        np.add(P, P.transpose(0, 2, 1), out=P)
        np.multiply(P, 0.5, out=P)
    history = FilterHistory(
        problem.time,
        problem.names,
        kept.mean.T.copy(),
        np.sqrt(variance.T),
        kept.innovation.T.copy(),
        np.sqrt(np.diagonal(kept.S, axis1=1, axis2=2).T),
        problem.valid.copy(),
        log_likelihood,
        nis,
        degrees,
        kept.predicted_mean.T.copy(),
        kept.predicted_covariance,
        kept.covariance,
        kept.transition,
        kept.sensitivity,
        kept.S,
    )
    return _estimate(problem, method, Outcome.CONVERGED, kept.mean[-1], kept.covariance[-1], kept.outputs.T.copy(), history)


def _estimate(
    problem: FilterProblem, method: str, outcome: Outcome, mean: np.ndarray, covariance: np.ndarray, fitted: np.ndarray, history: FilterHistory
) -> Estimate:
    n_x = len(problem.system.states)
    names = problem.names[n_x:]
    return Estimate(
        method,
        names,
        tuple(problem.system.parameters[name].unit for name in names),
        mean[n_x:].copy(),
        covariance[n_x:, n_x:].copy(),
        outcome,
        float(history.log_likelihood.sum()),
        problem.system.output_names,
        np.sqrt(problem.variance),
        (fitted,),
        history,
    )
