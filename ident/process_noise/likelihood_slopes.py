"""How the likelihood of a filter moves with the quantities that its gains depend on: process noise and measurement variances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.process_noise.associative_scan import combine_affine, scan
from ident.process_noise.associative_scan import from_left as _left
from ident.process_noise.associative_scan import from_right as _right
from ident.process_noise.associative_scan import transposed as _each_turned
from ident.process_noise.noise_slopes import NoiseSlopes
from ident.process_noise.whitener import Filtered, Whitener, closed_loop, every_node, joined, rows, turned

_AT_ONCE = 800_000  # numbers of a covariance's slopes that are worked out together: more do not stay in a processor's cache


@dataclass(frozen=True, eq=False)
class LikelihoodSlopes:
    """What the dependence of the filter on D quantities adds to a fit.

    ``gradient (D,)`` and expected ``information (D, D)`` of the log likelihood through gains and innovation covariances;
    ``scores (K + 1, D)`` are what each node adds to the gradient.
    """

    gradient: np.ndarray
    information: np.ndarray
    scores: np.ndarray


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
    beyond = e[:, :, None] * e[:, None, :] - np.where(filter.valid[:, :, None], np.eye(m), 0.0)
    by_node = flat.reshape(len(flat), T, m * m)
    scores = np.empty((len(e), D))
    scores[:T] = 0.5 * np.einsum("dtm,tm->td", by_node, beyond[:T].reshape(T, m * m))
    scores[T:] = 0.5 * beyond[T:].reshape(len(e) - T, m * m) @ by_node[:, -1].T
    if n == 0:
        return LikelihoodSlopes(scores.sum(axis=0), information, scores)
    columns = np.concatenate([moved for _, moved in parts], axis=1)
    scores += np.einsum("kmd,km->kd", columns.reshape(len(e), m, D), e)
    return LikelihoodSlopes(scores.sum(axis=0), information + columns.T @ columns, scores)


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
    H, dH = rows(filter.seen, slice(T)), rows(by_H, slice(T))
    dR = rows(by_R, slice(T))
    open_loop = np.eye(n) - K @ H
    # Covariance after an update: dP = (I - KH) dP_before (I - KH)^T + K dR K^T - P dH^T K^T - K dH P.
    dK_straight = _left(K, _right(dH, P))
    own = _right(_left(K, dR), turned(K)) - dK_straight - _each_turned(dK_straight)
    first = (_right(_left(open_loop[:1], by_start), turned(open_loop[:1])) + own[:1])[0]
    dP = np.empty((T, n, d, n))
    dP_before = np.empty((T, n, d, n))
    dP[0], dP_before[0] = first, by_start[0]
    if T > 1:
        F, dF, dQ = (rows(M, slice(T - 1)) for M in (Phi, by_Phi, by_Q))
        pushed = _right(dF, P[:-1] @ turned(F))
        forcing = pushed + _each_turned(pushed) + dQ
        inside = open_loop[1:]
        through, added = scan(combine_affine, (inside @ F, _right(_left(inside, forcing), turned(inside)) + own[1:]))
        dP[1:] = _right(_left(through, np.broadcast_to(first, (T - 1, n, d, n))), turned(through)) + added
        dP_before[1:] = _right(_left(F, dP[:-1]), turned(F)) + forcing
    crossed = _right(dH, filter.predicted @ turned(H))
    dS = crossed + _each_turned(crossed) + _right(_left(H, dP_before), turned(H)) + dR
    flat = _right(_left(filter.root, dS), turned(filter.root)).transpose(2, 0, 1, 3).reshape(d, -1)
    if n == 0:
        return flat, np.zeros((e.size, d))
    # K = P H^T R^-1, and the state through the gain that moves.
    dK = (_right(dP, turned(H)) + _right_turned(P, dH) - _left(K, dR)) / filter.variance
    predicted = np.zeros((len(e), n, 1))
    predicted[1:] = Phi @ x[:-1]
    pushed_state = np.zeros((len(e), n, d))
    pushed_state[1:] = _right(by_Phi, x[:-1])[..., 0]
    straight = _right(by_H, predicted)[..., 0]
    source = (
        _right(every_node(dK, filter), residual.innovation[..., None])[..., 0]
        + every_node(open_loop, filter) @ pushed_state
        - every_node(K, filter) @ straight
    )
    moved = pushed_state
    moved[1:] += Phi @ joined(closed_loop(filter), source)[:-1]
    return flat, (every_node(filter.root, filter) @ (straight + filter.seen @ moved)).reshape(-1, d)


def _beside(stack: np.ndarray, some: slice, d: int) -> np.ndarray:
    """Derivatives ``(B, D, a, b)`` by ``some``, those beyond zero, as ``(B, a, d, b)``: see `ident.process_noise.associative_scan`."""
    found = stack[:, some].swapaxes(1, 2)
    out = np.zeros((*found.shape[:2], d, found.shape[3]))
    out[:, :, : found.shape[2]] = found
    return out


def _right_turned(left: np.ndarray, stack: np.ndarray) -> np.ndarray:
    """``left`` times the transpose of each matrix of ``stack (B, m, D, n)``: ``(T, n, D, m)``."""
    return _each_turned(_right(stack, turned(left)))
