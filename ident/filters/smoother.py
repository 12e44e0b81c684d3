"""Fixed-interval smoother, and parameter covariance corrected for coloured innovations.

The smoother is that of Rauch, Tung and Striebel (AIAA Journal 3(8), 1965) in the form of Bryson and
Frazier (Bierman, "Fixed Interval Smoothing with Discrete Measurements", Int. J. Control 18(1),
1973). This form does not invert the predicted covariance, which is singular where a state is known
exactly, and nearly singular for parameters without process noise.

The covariance of a filter holds for white measurement noise. Coloured noise is correlated between
samples, so that the record has less information. The covariance is corrected as for whole-record
fits (`ident.statistics.residual_spectrum`): the information matrix is unchanged, and the covariance
of the gradient is computed with the spectra of the residuals. The residuals are the innovations of
a filter that starts from the smoothed initial state with zero covariance. Without process noise
they equal the residuals of an output-error fit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ident.estimate import Estimate, FilterHistory, Outcome
from ident.statistics.residual_spectrum import corrected_covariance

# ---- Fixed-interval smoother


@dataclass(frozen=True, eq=False, repr=False)
class SmoothedHistory:
    """Estimates of the n states and free parameters at each of N samples, from the whole record.

    Attributes
    ----------
    time : ``(N,)``, s.
    names : names of the states, then of the free parameters.
    mean, std : ``(n, N)`` estimates and their standard deviations.
    covariance : ``(N, n, n)`` of these estimates.
    """

    time: np.ndarray
    names: tuple[str, ...]
    mean: np.ndarray
    std: np.ndarray
    covariance: np.ndarray

    def __repr__(self) -> str:
        span = f", {self.time[0]:g} to {self.time[-1]:g} s" if len(self.time) else ""
        return f"<SmoothedHistory: {', '.join(self.names)}; {len(self.time)} samples{span}>"


def smooth(history: FilterHistory) -> SmoothedHistory:
    """Return the smoothed history of an extended or unscented filter.

    The smoothed state and covariance are x_s = x + P r and P_s = P - P W P, where x and P are those
    of the filter after the update. The adjoint variables r ``(n,)`` and W ``(n, n)`` summarise the
    later samples, and are zero at the last one. Their recursion runs backwards. At sample k, with
    the gain K = P_pred H^T S^-1 and the innovation nu,

        r <- H^T S^-1 nu + (I - K H)^T r        W <- H^T S^-1 H + (I - K H)^T W (I - K H)

    and then, with the transition matrix Phi from sample k - 1 to k, r <- Phi^T r and W <- Phi^T W
    Phi. A smoothed variance is at most the variance of the filter. If r or W is not finite at a
    sample, this sample and all earlier ones keep the values of the filter.
    """
    N = len(history.time)
    mean, covariance = history.mean.copy(), history.covariance.copy()
    with np.errstate(all="ignore"):
        r, W = _adjoint_recursion(history)
        x = mean[:, :-1] + (covariance[:-1] @ r[:, :, None])[:, :, 0].T
        reduced = covariance[:-1] - covariance[:-1] @ W @ covariance[:-1]
        lost_samples = np.flatnonzero(
            ~(np.all(np.isfinite(x), axis=0) & np.all(np.isfinite(reduced), axis=(1, 2)))
        )
    finite_samples = slice(lost_samples[-1] + 1 if lost_samples.size else 0, N - 1)
    mean[:, finite_samples] = x[:, finite_samples]
    symmetric = 0.5 * (reduced[finite_samples] + reduced[finite_samples].transpose(0, 2, 1))
    covariance[finite_samples] = _with_bounded_variances(
        symmetric, np.diagonal(covariance[finite_samples], axis1=1, axis2=2)
    )
    std = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2).T, 0.0))
    return SmoothedHistory(history.time, history.names, mean, std, covariance)


def _adjoint_recursion(history: FilterHistory) -> tuple[np.ndarray, np.ndarray]:
    """Return r ``(N - 1, n)`` and W ``(N - 1, n, n)`` of `smooth` at every sample but the last.

    Both steps of the recursion are combined: r <- c + M^T r and W <- C + M^T W M, with M = (I - K
    H) Phi, c = Phi^T H^T S^-1 nu and C = Phi^T H^T S^-1 H Phi at each sample.
    """
    H, Phi, nu = history.sensitivity[1:], history.transition[1:], history.innovation.T[1:]
    S, P_pred = history.innovation_covariance[1:], history.predicted_covariance[1:]
    N, n = len(Phi), len(history.names)
    # A missing channel has zeros in H and a one in S, so that it has no effect.
    HtSinv = np.linalg.solve(S, H).transpose(0, 2, 1)
    M = Phi - (P_pred @ HtSinv) @ (H @ Phi)
    PhitHtSinv = Phi.transpose(0, 2, 1) @ HtSinv
    c, C = (PhitHtSinv @ nu[:, :, None])[:, :, 0], PhitHtSinv @ (H @ Phi)
    M_transposed = M.transpose(0, 2, 1)
    r, W = np.empty((N, n)), np.empty((N, n, n))
    if N:
        r[-1], W[-1] = c[-1], C[-1]
    workspace, dot, add = np.empty((n, n)), np.dot, np.add
    for k in range(N - 1, 0, -1):
        M_T, W_out = M_transposed[k - 1], W[k - 1]
        add(dot(M_T, r[k]), c[k - 1], r[k - 1])
        dot(M_T, W[k], workspace)
        dot(workspace, M[k - 1], W_out)
        add(W_out, C[k - 1], W_out)
    return r, W


def _with_bounded_variances(P: np.ndarray, largest: np.ndarray) -> np.ndarray:
    """Return the covariances ``P (N, n, n)`` with rows and columns scaled so that each variance is
    at most ``largest (N, n)``. Rows and columns with a negative variance become zero.
    """
    variance = np.diagonal(P, axis1=1, axis2=2)
    factor = np.sqrt(
        np.divide(
            np.minimum(variance, largest), variance, out=np.zeros_like(variance), where=variance > 0
        )
    )
    return np.asarray(P * (factor[:, :, None] * factor[:, None]))


# ---- Parameter covariance of a filter, corrected for innovations that are not white

# smallest significant autocorrelation, in its standard deviations 1/sqrt(N) for white noise
_SIGNIFICANT_SIGMAS = 4.0
# P_pred - Phi P Phi^T is taken as rounding error, and not as process noise, below this share of the
# predicted variances
_ROUNDING_SHARE = 1e-9


@dataclass(frozen=True, eq=False)
class ColouredInnovations:
    """Correction of the covariance of a filter for coloured innovations.

    Attributes
    ----------
    names : names of the s estimated parameters.
    covariance : ``(s, s)`` corrected covariance.
    factor : ``(s,)`` ratio of the corrected standard deviations to those for white noise, at least
        1.
    lag_one : measured output -> autocorrelation of its whitened residuals at lag one.
    significant : whether the autocorrelation of an output is significantly larger than for white
        noise.
    """

    names: tuple[str, ...]
    covariance: np.ndarray
    factor: np.ndarray
    lag_one: dict[str, float]
    significant: bool


def coloured_innovations(estimate: Estimate) -> ColouredInnovations | None:
    """Return the correction of the parameter covariance for coloured innovations; None where the
    filter broke down or the correction is not finite.

    ``estimate`` is the estimate of an extended or unscented filter with its history. Its parameters
    must be constants, and not random walks.
    """
    history = estimate.history
    if history is None or estimate.outcome not in (Outcome.CONVERGED, Outcome.MAX_ITERATIONS):
        return None
    free = np.flatnonzero(np.diagonal(history.predicted_covariance[0]) > 0.0)
    free_names = [history.names[i] for i in free]
    names = tuple(name for name in estimate.names if name in free_names)
    positions = [free_names.index(name) for name in names]
    with np.errstate(all="ignore"):
        try:
            residuals, slopes = _whitened_innovations(history, np.square(estimate.noise_std))
        except np.linalg.LinAlgError:
            return None
        slopes = slopes[:, :, free]
        prior_std = np.sqrt(np.diagonal(history.predicted_covariance[0])[free])
        scaled_slopes = slopes * prior_std
        information = np.einsum("imj,imk->jk", scaled_slopes, scaled_slopes)
        if not (np.all(np.isfinite(information)) and np.all(np.isfinite(residuals))):
            return None
        try:
            inverse = np.linalg.inv(information + np.eye(len(free)))
        except np.linalg.LinAlgError:
            return None
        record = np.arange(len(free)), scaled_slopes, residuals, history.valid
        try:
            corrected = corrected_covariance(
                inverse, [record], np.ones(len(residuals)), np.eye(len(free))
            )
        except np.linalg.LinAlgError:
            return None
    scale = prior_std[positions]
    covariance = corrected[np.ix_(positions, positions)] * np.outer(scale, scale)
    white_variance = np.diagonal(inverse)[positions] * scale**2
    if not (np.all(np.isfinite(covariance)) and np.all(white_variance > 0.0)):
        return None
    outputs = zip(estimate.output_names, residuals, history.valid, strict=True)
    rows = [(name, row, valid) for name, row, valid in outputs if valid.any()]
    lag_one = {name: _lag_one(row, valid) for name, row, valid in rows}
    significant = any(
        abs(lag_one[name]) > _SIGNIFICANT_SIGMAS / np.sqrt(np.count_nonzero(valid))
        for name, _, valid in rows
    )
    return ColouredInnovations(
        names,
        covariance,
        np.sqrt(np.maximum(np.diagonal(covariance) / white_variance, 1.0)),
        lag_one,
        significant,
    )


def with_coloured_covariance(estimate: Estimate) -> Estimate:
    """Return the estimate with its covariance corrected for coloured innovations; unchanged where
    there is no correction.
    """
    correction = coloured_innovations(estimate)
    if correction is None or correction.names != estimate.names:
        return estimate
    return replace(estimate, covariance=correction.covariance)


def _whitened_innovations(
    history: FilterHistory, variance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the innovations ``(m, N)`` of a second filter and their derivatives ``(m, N, n)`` with
    respect to the initial states and parameters, whitened to unit variance.

    The second filter starts from the smoothed initial states and parameters with zero covariance,
    which only process noise increases. It uses the Jacobians of the history. ``variance (m,)`` is
    that of the measurement noise.
    """
    H, Phi, n, N = history.sensitivity, history.transition, len(history.names), len(history.time)
    noise = _process_noise(history)
    x, slopes_of_x, P = smooth(history).mean[:, 0], np.eye(n), np.zeros((n, n))
    m, R = len(variance), np.diag(variance)
    residuals, slopes = np.zeros((m, N)), np.zeros((m, N, n))
    for k in range(N):
        if k:
            x = history.predicted_mean[:, k] + Phi[k] @ (x - history.mean[:, k - 1])
            slopes_of_x = Phi[k] @ slopes_of_x
            if noise is not None:
                P = Phi[k] @ P @ Phi[k].T + noise[k]
        e = history.innovation[:, k] + H[k] @ (history.predicted_mean[:, k] - x)
        S, J = R + H[k] @ P @ H[k].T, H[k] @ slopes_of_x
        root = np.linalg.cholesky(S)
        residuals[:, k], slopes[:, k] = np.linalg.solve(root, e), np.linalg.solve(root, J)
        if noise is not None:
            K = np.linalg.solve(S, H[k] @ P).T
            x, I_KH = x + K @ e, np.eye(n) - K @ H[k]
            slopes_of_x, P = I_KH @ slopes_of_x, I_KH @ P @ I_KH.T + K @ R @ K.T
    return np.where(history.valid, residuals, 0.0), slopes


def _process_noise(history: FilterHistory) -> np.ndarray | None:
    """Return the process noise Q_k ``(N, n, n)`` of each prediction; None if all is rounding."""
    Phi, after = history.transition[1:], history.covariance[:-1]
    before = history.predicted_covariance[1:]
    noise = before - Phi @ after @ Phi.transpose(0, 2, 1)
    std = np.sqrt(np.maximum(np.diagonal(before, axis1=1, axis2=2), 0.0))
    noise[np.abs(noise) <= _ROUNDING_SHARE * (std[:, :, None] * std[:, None])] = 0.0
    if not np.any(noise):
        return None
    return np.concatenate(
        [np.zeros((1, *noise.shape[1:])), 0.5 * (noise + noise.transpose(0, 2, 1))]
    )


def _lag_one(residuals: np.ndarray, valid: np.ndarray) -> float:
    """Return the autocorrelation at lag one of the ``valid`` samples of a ``row (N,)``."""
    pairs, power = valid[1:] & valid[:-1], float(np.sum(np.square(residuals[valid])))
    if not power > 0.0:
        return 0.0
    return float(np.sum(residuals[1:][pairs] * residuals[:-1][pairs]) / power)
