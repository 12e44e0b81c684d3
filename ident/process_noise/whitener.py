"""A Kalman filter used as a linear pre-whitener of residuals and of every sensitivity column.

The residual of a deterministic fit is e = H x + v with x the process noise. Its innovations, nu[k] = e[k] minus its prediction
from e[0 .. k - 1], are white; the columns of the Jacobian pass through the same linear filter (Jategaonkar, Flight
Vehicle System Identification, ch. 5). Covariances come from an associative scan, the states from one banded triangular solve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.process_noise.associative_scan import advanced, combine_affine, combine_covariances, covariance_steps, powers, scan
from ident.process_noise.associative_scan import from_left as _left
from ident.process_noise.associative_scan import from_right as _right
from ident.process_noise.associative_scan import transposed as _turned
from ident.process_noise.discretised import DiscretisedNoise
from ident.process_noise.noise_slopes import NoiseSlopes

_CHUNK = 64
_AT_ONCE = 800_000  # numbers of a covariance's slopes that are worked out together: more do not stay in a processor's cache
_SETTLED = 1e-12  # relative change of the covariance over a chunk


@dataclass(frozen=True, eq=False)
class Whitener:
    """The filter of one record: gains and innovation covariances at the nodes ``0 .. K``.

    Per-node arrays end where the filter has settled: node k has entry ``at[k]``. ``covariance`` and ``predicted`` ``(T, n, n)``
    after and before each update, ``gain (T, n, m)``, ``innovation_covariance`` and ``root`` ``(T, m, m)``, the latter the inverse of
    its Cholesky factor; rows of samples that are missing are those of the unit matrix. ``valid (K + 1, m)``.
    ``log_determinant`` is the sum over all samples of the log determinant of their innovation covariance.
    """

    motion: DiscretisedNoise
    variance: np.ndarray
    valid: np.ndarray
    at: np.ndarray
    seen: np.ndarray
    covariance: np.ndarray
    predicted: np.ndarray
    gain: np.ndarray
    innovation_covariance: np.ndarray
    root: np.ndarray
    log_determinant: float


@dataclass(frozen=True, eq=False)
class Filtered:
    """Columns through the filter: ``innovation (K + 1, m, c)``, ``standard`` of unit variance where the column is a residual,
    ``state (K + 1, n, c)`` after each update; without the last axis where one column is meant."""

    innovation: np.ndarray
    standard: np.ndarray
    state: np.ndarray


@dataclass(frozen=True, eq=False)
class LikelihoodSlopes:
    """What the dependence of the filter on D quantities adds to a fit.

    ``gradient (D,)`` and expected ``information (D, D)`` of the log likelihood through gains and innovation covariances.
    """

    gradient: np.ndarray
    information: np.ndarray


def whitener(motion: DiscretisedNoise, variance: np.ndarray, valid: np.ndarray) -> Whitener:
    """Gains for a process noise, measurement variances ``(m,)`` and validity ``(K + 1, m)`` of the samples at the nodes.

    Raises
    ------
    numpy.linalg.LinAlgError : an innovation covariance that is not positive definite.
    """
    nodes, m = valid.shape
    steady = len(motion.Phi) == 1 and len(motion.H) == 1 and bool(np.all(valid == valid[0]))
    seen = np.where(valid[:1] if steady else valid, 1.0, 0.0)[:, :, None] * motion.H
    first = _updated(motion.start, seen[0], variance)
    if motion.start.shape[0] == 0:
        after = np.zeros((1 if steady else nodes, 0, 0))
    elif steady:
        steps = powers(combine_covariances, covariance_steps(motion.Phi, motion.Q, seen, variance), _CHUNK)
        after = _until_settled(steps, first, nodes)
    else:
        Phi, Q = (np.broadcast_to(M, (nodes - 1, *M.shape[1:])) for M in (motion.Phi, motion.Q))
        one = covariance_steps(Phi, Q, seen[1:], variance)
        after = np.concatenate([first[None], advanced(scan(combine_covariances, one), first)])
    Phi, Q = (M if len(M) == 1 else M[: len(after) - 1] for M in (motion.Phi, motion.Q))
    before = np.concatenate([motion.start[None], Phi @ after[:-1] @ _t(Phi) + Q]) if len(motion.start) else after
    PH = before @ _t(seen if len(seen) == 1 else seen[: len(before)])
    S = (seen if len(seen) == 1 else seen[: len(before)]) @ PH + np.diag(variance)
    present = valid[: len(S)]
    S = np.where(present[:, :, None] & present[:, None, :], S, np.eye(m))
    root = np.linalg.inv(np.linalg.cholesky(S))
    gain = PH @ (_t(root) @ root)
    at = np.minimum(np.arange(nodes), len(after) - 1)
    logs = -2.0 * np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
    return Whitener(motion, variance, valid, at, seen, after, before, gain, S, root, float(logs[at].sum()))


def filtered(filter: Whitener, columns: np.ndarray) -> Filtered:
    """Innovations of ``columns (K + 1, m, c)``; what stands at missing samples does not matter."""
    e = np.where(filter.valid[:, :, None], columns, 0.0)
    n = filter.covariance.shape[-1]
    if n == 0:
        state = np.zeros((len(e), 0, e.shape[2]))
        return Filtered(e, _every(filter.root, filter) @ e, state)
    state = _joined(_closed_loop(filter), _every(filter.gain, filter) @ e)
    innovation = e.copy()
    innovation[1:] -= _rows(filter.seen, slice(1, None)) @ (filter.motion.Phi @ state[:-1])
    return Filtered(innovation, _every(filter.root, filter) @ innovation, state)


def likelihood_slopes(filter: Whitener, residual: Filtered, slopes: NoiseSlopes, by_variance: np.ndarray) -> LikelihoodSlopes:
    """Slopes by the quantities that move the process noise, then by those that move the measurement variances.

    ``residual`` is one column; ``by_variance (d, m)`` are derivatives of the measurement variances.
    """
    T, n, D = len(filter.covariance), filter.covariance.shape[-1], len(slopes.of) + len(by_variance)
    by_variance = np.concatenate([np.zeros((len(slopes.of), len(filter.variance))), by_variance])
    few = max(1, _AT_ONCE // max(1, T * n * n))
    parts = [_slopes_of_some(filter, residual, slopes, by_variance, slice(k, k + few)) for k in range(0, D, few)]
    flat = np.concatenate([dS for dS, _ in parts]) if parts else np.zeros((0, residual.standard[:T].size * filter.valid.shape[1]))
    e, m = residual.standard, filter.valid.shape[1]
    counts = np.bincount(filter.at, minlength=T).astype(float)[:, None, None]
    information = 0.5 * (flat * np.broadcast_to(counts, (T, m, m)).reshape(-1)) @ flat.T
    spread = np.add.reduceat(e[:, :, None] * e[:, None, :], np.arange(T))
    gradient = 0.5 * flat @ (spread - counts * np.eye(m)).reshape(-1)
    if n == 0:
        return LikelihoodSlopes(gradient, information)
    columns = np.concatenate([moved for _, moved in parts], axis=1)
    return LikelihoodSlopes(gradient + columns.T @ e.reshape(-1), information + columns.T @ columns)


def _slopes_of_some(filter: Whitener, residual: Filtered, slopes: NoiseSlopes, by_variance: np.ndarray, some: slice) -> tuple[np.ndarray, np.ndarray]:
    """By ``some`` of the D quantities: of innovation covariances, normalised ``(d, T m m)``, and of normalised innovations ``((K + 1) m, d)``."""
    T, m, n = len(filter.covariance), filter.valid.shape[1], filter.covariance.shape[-1]
    of_variance = by_variance[some]
    d = len(of_variance)
    e, x, K, P, Phi = residual.standard, residual.state[..., None], filter.gain, filter.covariance, filter.motion.Phi
    present = np.where(filter.valid[:1] if len(filter.seen) == 1 else filter.valid, 1.0, 0.0)
    by_Phi, by_Q, by_start = (_beside(M, some, d) for M in (slopes.motion.Phi, slopes.motion.Q, slopes.motion.start[None]))
    by_H = _beside(slopes.motion.H, some, d) * present[:, :, None, None]
    by_R = np.zeros((len(present), m, d, m))
    for i in range(m):
        by_R[:, i, :, i] = of_variance[:, i] * present[:, i, None]
    H, dH = _rows(filter.seen, slice(T)), _rows(by_H, slice(T))
    dR = _rows(by_R, slice(T))
    open_loop = np.eye(n) - K @ H
    # Covariance after an update: dP = (I - KH) dP_before (I - KH)^T + K dR K^T - P dH^T K^T - K dH P.
    dK_straight = _left(K, _right(dH, P))
    own = _right(_left(K, dR), _t(K)) - dK_straight - _turned(dK_straight)
    first = (_right(_left(open_loop[:1], by_start), _t(open_loop[:1])) + own[:1])[0]
    dP = np.empty((T, n, d, n))
    dP_before = np.empty((T, n, d, n))
    dP[0], dP_before[0] = first, by_start[0]
    if T > 1:
        F, dF, dQ = (_rows(M, slice(T - 1)) for M in (Phi, by_Phi, by_Q))
        pushed = _right(dF, P[:-1] @ _t(F))
        forcing = pushed + _turned(pushed) + dQ
        inside = open_loop[1:]
        through, added = scan(combine_affine, (inside @ F, _right(_left(inside, forcing), _t(inside)) + own[1:]))
        dP[1:] = _right(_left(through, np.broadcast_to(first, (T - 1, n, d, n))), _t(through)) + added
        dP_before[1:] = _right(_left(F, dP[:-1]), _t(F)) + forcing
    crossed = _right(dH, filter.predicted @ _t(H))
    dS = crossed + _turned(crossed) + _right(_left(H, dP_before), _t(H)) + dR
    flat = _right(_left(filter.root, dS), _t(filter.root)).transpose(2, 0, 1, 3).reshape(d, -1)
    if n == 0:
        return flat, np.zeros((e.size, d))
    # K = P H^T R^-1, and the state through the gain that moves.
    dK = (_right(dP, _t(H)) + _right_turned(P, dH) - _left(K, dR)) / filter.variance
    predicted = np.zeros((len(e), n, 1))
    predicted[1:] = Phi @ x[:-1]
    pushed_state = np.zeros((len(e), n, d))
    pushed_state[1:] = _right(by_Phi, x[:-1])[..., 0]
    straight = _right(by_H, predicted)[..., 0]
    source = (
        _right(_every(dK, filter), residual.innovation[..., None])[..., 0] + _every(open_loop, filter) @ pushed_state - _every(K, filter) @ straight
    )
    moved = pushed_state
    moved[1:] += Phi @ _joined(_closed_loop(filter), source)[:-1]
    return flat, (_every(filter.root, filter) @ (straight + filter.seen @ moved)).reshape(-1, d)


def _updated(P: np.ndarray, H: np.ndarray, variance: np.ndarray) -> np.ndarray:
    if len(P) == 0:
        return P
    PH = P @ H.T
    out = P - PH @ np.linalg.solve(H @ PH + np.diag(variance), PH.T)
    return 0.5 * (out + out.T)


def _until_settled(steps: tuple[np.ndarray, ...], first: np.ndarray, nodes: int) -> np.ndarray:
    """Filtered covariances of a steady system until they no longer change, at most at ``nodes`` nodes."""
    parts, P, done = [first[None]], first, 1
    while done < nodes:
        chunk = advanced(steps, P)
        parts.append(chunk)
        done += len(chunk)
        size = np.sqrt(np.diag(chunk[-1]))
        if np.all(np.abs(chunk[-1] - P) <= _SETTLED * np.outer(size, size)):
            break
        P = chunk[-1]
    return np.concatenate(parts)[:nodes]


def _closed_loop(filter: Whitener) -> np.ndarray:
    """(I - K H) Phi from node k to k + 1, ``(K, n, n)``."""
    n = filter.covariance.shape[-1]
    if len(filter.seen) == 1 and len(filter.motion.Phi) == 1:
        return ((np.eye(n) - filter.gain @ filter.seen) @ filter.motion.Phi)[filter.at[1:]]
    return (np.eye(n) - filter.gain[1:] @ _rows(filter.seen, slice(1, None))) @ filter.motion.Phi


def _joined(T: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Solve x[k + 1] = T[k] x[k] + source[k + 1], x[0] = source[0]: ``(K + 1, n, c)``."""
    from scipy.linalg.lapack import dtbtrs

    nodes, n, c = source.shape
    band = np.zeros((2 * n, nodes * n))
    band[0] = 1.0
    columns = np.arange(nodes - 1) * n
    for i in range(n):
        for j in range(n):
            band[n + i - j, columns + j] = -T[:, i, j]
    solution, _ = dtbtrs(band, source.reshape(nodes * n, c), uplo="L", diag="U")
    return np.ascontiguousarray(solution).reshape(nodes, n, c)


def _every(stack: np.ndarray, filter: Whitener) -> np.ndarray:
    """What is kept until the filter has settled, at every node."""
    return stack if len(stack) == len(filter.at) else stack[filter.at]


def _rows(stack: np.ndarray, part: slice) -> np.ndarray:
    return stack if len(stack) == 1 else stack[part]


def _beside(stack: np.ndarray, some: slice, d: int) -> np.ndarray:
    """Derivatives ``(B, D, a, b)`` by ``some``, those beyond zero, as ``(B, a, d, b)``: see `ident.process_noise.associative_scan`."""
    found = stack[:, some].swapaxes(1, 2)
    out = np.zeros((*found.shape[:2], d, found.shape[3]))
    out[:, :, : found.shape[2]] = found
    return out


def _right_turned(left: np.ndarray, stack: np.ndarray) -> np.ndarray:
    """``left`` times the transpose of each matrix of ``stack (B, m, D, n)``: ``(T, n, D, m)``."""
    return _turned(_right(stack, _t(left)))


def _t(M: np.ndarray) -> np.ndarray:
    return np.swapaxes(M, -1, -2)
