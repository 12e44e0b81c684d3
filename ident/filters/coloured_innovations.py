"""Parameter covariance of a filter, corrected for innovations that are not white.

A filter's covariance holds for white measurement noise. Coloured noise repeats itself from sample to sample, so that the record says
less than the filter believes. As for whole-record fits (`ident.statistics.coloured_covariance`; Morelli and Klein, J. Guidance, Control and
Dynamics 20(1), 1997) the information stays, and the scatter of the gradient is formed with the autocovariance of the residuals. These are
the residuals of the filter that knows the smoothed initial state exactly; without process noise those of output error.

The autocovariance is that of an autoregression, which a short record determines better than many lags one by one. What the fit itself took
from the residuals is added back: the expected loss follows from the slopes and from the autocovariance, which therefore is found by iteration.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ident.estimate import Estimate, FilterHistory, Outcome
from ident.filters.smoother import smooth

_ORDER = 8  # highest order of the autoregression
_ROUNDS = 8  # in which autocovariance and expected loss are brought together
_SIGNIFICANT = 4.0  # of the standard deviations 1/sqrt(N) that an autocorrelation of white noise has
_ROUNDING = 1e-9  # of a covariance, below which a difference of two is no process noise


@dataclass(frozen=True, eq=False)
class ColouredInnovations:
    """What coloured innovations do to the standard deviations of a filter's parameters.

    Attributes
    ----------
    names : the ``s`` parameters that the filter estimates.
    covariance : ``(s, s)`` of the parameters, corrected.
    factor : ``(s,)`` corrected standard deviations over those of white noise; at least one.
    lag_one : autocorrelation of the whitened residuals one sample apart, by output that was measured.
    significant : whether the autocorrelation of some output is more than white noise shows.
    """

    names: tuple[str, ...]
    covariance: np.ndarray
    factor: np.ndarray
    lag_one: dict[str, float]
    significant: bool


def coloured_innovations(estimate: Estimate) -> ColouredInnovations | None:
    """Correct the parameter covariance of a filter for coloured innovations.

    Parameters
    ----------
    estimate : of an extended or unscented filter, with its history; its parameters are no random walks.

    Returns
    -------
    The correction; None where the filter broke down or its numbers allow none.
    """
    history = estimate.history
    if history is None or estimate.outcome not in (Outcome.CONVERGED, Outcome.MAX_ITERATIONS):
        return None
    free = np.flatnonzero(np.diagonal(history.predicted_covariance[0]) > 0.0)
    known = [history.names[i] for i in free]
    names = tuple(name for name in estimate.names if name in known)
    at = [known.index(name) for name in names]
    with np.errstate(all="ignore"):
        try:
            residual, slopes = _whitened(history, np.square(estimate.noise_std))
        except np.linalg.LinAlgError:
            return None
        slopes = slopes[:, :, free]
        prior = np.sqrt(np.diagonal(history.predicted_covariance[0])[free])
        scaled = slopes * prior
        information = np.einsum("imj,imk->jk", scaled, scaled)
        if not (np.all(np.isfinite(information)) and np.all(np.isfinite(residual))):
            return None
        try:
            inverse = np.linalg.inv(information + np.eye(len(free)))
        except np.linalg.LinAlgError:
            return None
        found = _sandwich(inverse, scaled, residual, history.valid)
    scale = prior[at]
    covariance = found[np.ix_(at, at)] * np.outer(scale, scale)
    white = np.diagonal(inverse)[at] * scale**2
    if not (np.all(np.isfinite(covariance)) and np.all(white > 0.0)):
        return None
    rows = [each for each in zip(estimate.output_names, residual, history.valid, strict=True) if each[2].any()]
    lag_one = {name: _lag_one(row, known) for name, row, known in rows}
    significant = any(abs(lag_one[name]) > _SIGNIFICANT / np.sqrt(np.count_nonzero(known)) for name, _, known in rows)
    return ColouredInnovations(names, covariance, np.sqrt(np.maximum(np.diagonal(covariance) / white, 1.0)), lag_one, significant)


def with_coloured_covariance(estimate: Estimate) -> Estimate:
    """The estimate with its covariance corrected for coloured innovations; unchanged where there is no correction."""
    found = coloured_innovations(estimate)
    return estimate if found is None or found.names != estimate.names else replace(estimate, covariance=found.covariance)


def _sandwich(inverse: np.ndarray, slopes: np.ndarray, residual: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Covariance ``(n, n)`` under the residuals' own autocovariance; each variance at least that of white noise.

    ``inverse (n, n)`` is the inverse information, unit prior included; slopes ``(m, N, n)`` and residuals ``(m, N)`` have unit variance.
    """
    m, N, n = slopes.shape
    rows = [i for i in range(m) if valid[i].any()]
    pairs = {i: np.maximum(_lagged(valid[i, :, None].astype(float), valid[i, :, None].astype(float)), 1.0) for i in rows}
    taper = 1.0 - np.arange(_ORDER + 1) / N
    observed = {i: taper * _lagged(residual[i, :, None], residual[i, :, None]) / pairs[i] for i in rows}
    order = {i: _best_order(observed[i], int(valid[i].sum())) for i in rows}
    covariance = {i: observed[i] for i in rows}
    middle = np.eye(n)
    for _ in range(_ROUNDS):
        smeared = {i: _convolved(slopes[i], *_autoregression(covariance[i], order[i], N)) for i in rows}
        middle = np.eye(n) + sum(slopes[i].T @ smeared[i] for i in rows)
        spread = inverse @ middle @ inverse
        for i in rows:
            lost = 2.0 * _lagged(slopes[i] @ inverse, smeared[i]) - _lagged(slopes[i] @ spread, slopes[i])
            covariance[i] = observed[i] + taper * lost / pairs[i]
    found = inverse @ middle @ inverse
    factor = np.sqrt(np.maximum(np.diagonal(inverse) / np.diagonal(found), 1.0))
    return np.asarray(found * np.outer(factor, factor))


def _lagged(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Sums over ``t`` and columns of ``one[t] other[t + k]``, the mean of both directions, at lags 0 to the highest order; ``(N, n)`` each."""
    N = len(one)
    sums = [0.5 * (np.vdot(one[: N - k], other[k:]) + np.vdot(other[: N - k], one[k:])) for k in range(min(_ORDER, N - 1) + 1)]
    return np.array(sums + [0.0] * (_ORDER + 1 - len(sums)))


def _levinson(covariance: np.ndarray, order: int, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of the prediction error filter ``(order + 1,)``, and its error variance at each order up to it (Levinson-Durbin)."""
    a, error = np.array([1.0]), np.empty(order + 1)
    error[0] = max(float(covariance[0]), np.finfo(float).tiny)
    for p in range(1, order + 1):
        reflection = -float(a @ covariance[p:0:-1]) / error[p - 1]
        reflection = float(np.clip(reflection, 1.0 / samples - 1.0, 1.0 - 1.0 / samples))
        a = np.append(a, 0.0) + reflection * np.append(a, 0.0)[::-1]
        error[p] = error[p - 1] * (1.0 - reflection**2)
    return a, error


def _best_order(covariance: np.ndarray, samples: int) -> int:
    """The order that the Bayesian information criterion prefers."""
    highest = min(_ORDER, max(0, samples // 10))
    _, error = _levinson(covariance, highest, samples)
    return int(np.argmin(samples * np.log(error) + np.arange(highest + 1) * np.log(samples)))


def _autoregression(covariance: np.ndarray, order: int, samples: int) -> tuple[np.ndarray, float]:
    """The prediction error filter of an autoregression and the variance of its input."""
    a, error = _levinson(covariance, order, samples)
    return a, float(error[order])


def _convolved(slopes: np.ndarray, a: np.ndarray, error: float) -> np.ndarray:
    """Product ``(N, n)`` of the autocovariance matrix of an autoregression and ``slopes (N, n)``, over frequencies."""
    N = len(slopes)
    size = 1 << (8 * N - 1).bit_length()
    autocovariance = np.fft.irfft(error / np.abs(np.fft.rfft(a, size)) ** 2, size)
    kernel = np.zeros(1 << (2 * N - 1).bit_length())
    kernel[:N], kernel[len(kernel) - N + 1 :] = autocovariance[:N], autocovariance[N - 1 : 0 : -1]
    spectrum = np.fft.rfft(kernel).real
    return np.asarray(np.fft.irfft(spectrum[:, None] * np.fft.rfft(slopes, len(kernel), axis=0), len(kernel), axis=0)[:N])


def _whitened(history: FilterHistory, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals ``(m, N)`` and their slopes ``(m, N, n)`` with the initial state and the parameters at their smoothed values, of unit variance.

    The history is a linear filter: what it predicted, its matrices and its innovations give the same filter from another start, whose
    covariance is that of the process noise alone.
    """
    H, Phi, n, N = history.sensitivity, history.transition, len(history.names), len(history.time)
    noise = _process_noise(history)
    x, D, P = smooth(history).mean[:, 0], np.eye(n), np.zeros((n, n))
    m, R = len(variance), np.diag(variance)
    residual, slopes = np.zeros((m, N)), np.zeros((m, N, n))
    for k in range(N):
        if k:
            x = history.predicted_mean[:, k] + Phi[k] @ (x - history.mean[:, k - 1])
            D = Phi[k] @ D
            if noise is not None:
                P = Phi[k] @ P @ Phi[k].T + noise[k]
        e = history.innovation[:, k] + H[k] @ (history.predicted_mean[:, k] - x)
        S, J = R + H[k] @ P @ H[k].T, H[k] @ D
        root = np.linalg.cholesky(S)
        residual[:, k], slopes[:, k] = np.linalg.solve(root, e), np.linalg.solve(root, J)
        if noise is not None:
            K = np.linalg.solve(S, H[k] @ P).T
            x, kept = x + K @ e, np.eye(n) - K @ H[k]
            D, P = kept @ D, kept @ P @ kept.T + K @ R @ K.T
    return np.where(history.valid, residual, 0.0), slopes


def _process_noise(history: FilterHistory) -> np.ndarray | None:
    """Q_k ``(N, n, n)`` of each step, what a prediction added to the covariance; None where that is rounding alone."""
    Phi, after, before = history.transition[1:], history.covariance[:-1], history.predicted_covariance[1:]
    added = before - Phi @ after @ Phi.transpose(0, 2, 1)
    scale = np.sqrt(np.maximum(np.diagonal(before, axis1=1, axis2=2), 0.0))
    added[np.abs(added) <= _ROUNDING * (scale[:, :, None] * scale[:, None])] = 0.0
    if not np.any(added):
        return None
    return np.concatenate([np.zeros((1, *added.shape[1:])), 0.5 * (added + added.transpose(0, 2, 1))])


def _lag_one(row: np.ndarray, known: np.ndarray) -> float:
    both, power = known[1:] & known[:-1], float(np.sum(np.square(row[known])))
    return float(np.sum(row[1:][both] * row[:-1][both]) / power) if power > 0.0 else 0.0
