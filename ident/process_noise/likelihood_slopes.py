"""Derivatives of the likelihood of a Kalman filter's innovations with respect to quantities that
change the filter.

Parameters, the scale of the process noise and the measurement variances change the gains and the
innovation covariances of the filter. `noise_slopes` differentiates the discretised process noise by
central differences of the linearised motion. Where the motion is smooth, these are computed at
every eighth step and interpolated linearly. `likelihood_slopes` propagates the derivatives through
the filter and returns the gradient and the expected information (Fisher information) of the log
likelihood (Maine and Iliff 1981; Jategaonkar, Flight Vehicle System Identification, ch. 5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.process_noise.linear_noise import (
    DiscretisedNoise,
    Variation,
    discrete_motion,
    linear_motion,
)
from ident.process_noise.whitener import (
    Filtered,
    Whitener,
    closed_loop,
    combine_affine,
    every_node,
    from_left,
    from_right,
    joined,
    rows,
    scan,
    transposed,
    turned,
)
from ident.whole_record.record_problem import RecordProblem

# ---- Derivatives of the process noise along a trajectory

_DIFFERENCE_STEP_SHARE = 1e-5  # step of central differences, relative to the parameter
# steps between computed derivatives where linear interpolation is good enough
_STEPS_BETWEEN_SLOPES = 8
# largest error of interpolated derivatives of F, relative to its largest entry; the error of those
# of Phi is 10 to 100 times smaller
_LARGEST_INTERPOLATION_ERROR = 0.005
_EVEN_SAMPLING_TOLERANCE = 1e-9  # largest relative difference of even steps


@dataclass(frozen=True, eq=False)
class NoiseSlopes:
    """Derivatives of the discretised process noise.

    Attributes
    ----------
    of : positions of the quantities, among those requested, that change the noise.
    motion : derivatives with respect to these quantities.
    """

    of: tuple[int, ...]
    motion: DiscretisedNoise


def noise_slopes(
    problem: RecordProblem,
    states: np.ndarray,
    at: Variation,
    pairs: Sequence[tuple[Variation, Variation, float]],
) -> NoiseSlopes:
    """Return the derivatives of the process noise about the fixed trajectory ``states (nx, K +
    1)``.

    ``pairs`` from `slope_pairs` has two variations for each quantity, and the difference of the
    quantity between them.
    """
    # variation 0 is the base; quantity i has the variations 1 + 2 i and 2 + 2 i
    ends = [end for low, high, _ in pairs for end in (low, high)]
    F, H, density, stationary = linear_motion(problem, states, [at, *ends])
    parts = (F, H, density[None])
    of = tuple(
        i
        for i in range(len(pairs))
        if any(np.any(part[:, 1 + 2 * i] != part[:, 2 + 2 * i]) for part in parts)
    )
    chosen = [0, *(end for i in of for end in (1 + 2 * i, 2 + 2 * i))]
    width = np.array([pairs[i][2] for i in of])[:, None, None]

    def slope(part: np.ndarray) -> np.ndarray:
        return np.asarray((part[:, 2::2] - part[:, 1::2]) / width)

    F, steps = F[:, chosen], np.diff(problem.grid.nodes)
    computed = _computed_steps(np.concatenate([F[:, :1], slope(F)], axis=1), steps)
    by_Phi, by_Q, start = discrete_motion(
        F[computed], steps[computed] if len(F) > 1 else steps, density[chosen], stationary, slope
    )
    by_Phi, by_Q = (_interpolated(slopes, computed, len(steps)) for slopes in (by_Phi, by_Q))
    return NoiseSlopes(
        of, DiscretisedNoise(by_Phi, by_Q, slope(H[:, chosen]), slope(start[None])[0])
    )


def slope_pairs(
    at: Variation, positions: Sequence[int], sizes: Sequence[float], scale: bool
) -> list[tuple[Variation, Variation, float]]:
    """Return pairs of variations for central differences, each with the difference between the two.

    The first pairs change one of the parameters at ``positions`` each, by a step relative to its
    entry in ``sizes``. The last pair changes the scale, where ``scale`` is True.
    """
    pairs = []
    for position, size in zip(positions, sizes, strict=True):
        step, ends = _DIFFERENCE_STEP_SHARE * size, []
        for sign in (-1.0, 1.0):
            p = at.p.copy()
            p[position] += sign * step
            ends.append(Variation(p, at.scale))
        pairs.append((ends[0], ends[1], ends[1].p[position] - ends[0].p[position]))
    if scale:
        step = _DIFFERENCE_STEP_SHARE * max(at.scale, 1.0)
        pairs.append(
            (Variation(at.p, at.scale - step), Variation(at.p, at.scale + step), 2.0 * step)
        )
    return pairs


def _computed_steps(values: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return the steps at which derivatives are computed: every eighth step where all ``values (K,
    D, n, n)`` are smooth, else every step.
    """
    every = np.arange(len(values))
    uneven = np.ptp(steps) > _EVEN_SAMPLING_TOLERANCE * steps.max()
    if len(values) < 2 * _STEPS_BETWEEN_SLOPES or uneven:
        return every
    eighths = np.append(every[:-1:_STEPS_BETWEEN_SLOPES], every[-1])
    error = np.abs(_interpolated(values[eighths], eighths, len(values)) - values).max(axis=0)
    largest = np.abs(values).max(axis=0).max(axis=(-2, -1), keepdims=True)
    return eighths if np.all(error <= _LARGEST_INTERPOLATION_ERROR * largest) else every


def _interpolated(values: np.ndarray, at: np.ndarray, count: int) -> np.ndarray:
    """Return ``values``, given at the steps ``at``, interpolated linearly at all ``count`` steps. A
    single value is constant and stays as it is.
    """
    if len(values) in (1, count):
        return values
    left = np.clip(np.searchsorted(at, np.arange(count), side="right") - 1, 0, len(at) - 2)
    share = ((np.arange(count) - at[left]) / (at[left + 1] - at[left])).reshape(
        -1, *(1,) * (values.ndim - 1)
    )
    return np.asarray(values[left] + share * (values[left + 1] - values[left]))


# ---- Derivatives of the likelihood through the filter's gains

# most numbers in covariance derivatives that are computed together; more do not fit the processor's
# cache
_LARGEST_BATCH = 800_000


@dataclass(frozen=True, eq=False)
class LikelihoodSlopes:
    """Derivatives of the log likelihood with respect to D quantities, as far as these change the
    gains and innovation covariances of the filter.

    Attributes
    ----------
    gradient : ``(D,)``.
    information : ``(D, D)`` expected information.
    scores : ``(K + 1, D)`` contribution of each node to the gradient.
    """

    gradient: np.ndarray
    information: np.ndarray
    scores: np.ndarray


def likelihood_slopes(
    filter: Whitener, residual: Filtered, slopes: NoiseSlopes, by_variance: np.ndarray
) -> LikelihoodSlopes:
    """Return the derivatives of the log likelihood of one record.

    Parameters
    ----------
    residual : the residual through the filter, a single column.
    slopes : derivatives of the process noise with respect to the first quantities.
    by_variance : ``(d, m)`` derivatives of the measurement variances with respect to the last d
        quantities.
    """
    T, n, D = len(filter.covariance), filter.covariance.shape[-1], len(slopes.of) + len(by_variance)
    by_variance = np.concatenate([np.zeros((len(slopes.of), len(filter.variance))), by_variance])
    batch = max(1, _LARGEST_BATCH // max(1, T * n * n))
    parts = [
        _covariance_derivatives(filter, residual, slopes, by_variance, slice(k, k + batch))
        for k in range(0, D, batch)
    ]
    e, m = residual.standard, filter.valid.shape[1]
    flat = np.zeros((0, e[:T].size * m))
    if parts:
        flat = np.concatenate([dS for dS, _ in parts])
    counts = np.bincount(filter.at, minlength=T).astype(float)[:, None, None]
    information = 0.5 * (flat * np.broadcast_to(counts, (T, m, m)).reshape(-1)) @ flat.T
    # squares of the normalised innovations minus their expected values
    excess = e[:, :, None] * e[:, None, :] - np.where(filter.valid[:, :, None], np.eye(m), 0.0)
    by_node = flat.reshape(len(flat), T, m * m)
    scores = np.empty((len(e), D))
    scores[:T] = 0.5 * np.einsum("dtm,tm->td", by_node, excess[:T].reshape(T, m * m))
    scores[T:] = 0.5 * excess[T:].reshape(len(e) - T, m * m) @ by_node[:, -1].T
    if n == 0:
        return LikelihoodSlopes(scores.sum(axis=0), information, scores)
    columns = np.concatenate([by_innovation for _, by_innovation in parts], axis=1)
    scores += np.einsum("kmd,km->kd", columns.reshape(len(e), m, D), e)
    return LikelihoodSlopes(scores.sum(axis=0), information + columns.T @ columns, scores)


def _covariance_derivatives(
    filter: Whitener, residual: Filtered, slopes: NoiseSlopes, by_variance: np.ndarray, part: slice
) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives with respect to d of the D quantities, those in ``part``: of the
    normalised innovation covariances ``(d, T m m)``, and of the normalised innovations ``((K + 1)
    m, d)``.
    """
    T, m, n = len(filter.covariance), filter.valid.shape[1], filter.covariance.shape[-1]
    of_variance = by_variance[part]
    d = len(of_variance)
    e, x, K = residual.standard, residual.state[..., None], filter.gain
    P, Phi = filter.covariance, filter.motion.Phi
    present = np.where(filter.valid[:1] if len(filter.seen) == 1 else filter.valid, 1.0, 0.0)
    by_Phi, by_Q, by_start = (
        _padded(M, part, d) for M in (slopes.motion.Phi, slopes.motion.Q, slopes.motion.start[None])
    )
    by_H = _padded(slopes.motion.H, part, d) * present[:, :, None, None]
    by_R = np.zeros((len(present), m, d, m))
    for i in range(m):
        by_R[:, i, :, i] = of_variance[:, i] * present[:, i, None]
    H, dH = rows(filter.seen, slice(T)), rows(by_H, slice(T))
    dR = rows(by_R, slice(T))
    open_loop = np.eye(n) - K @ H
    # Covariance after an update: dP = (I - KH) dP_before (I - KH)^T + K dR K^T - P dH^T K^T - K dH
    # P.
    K_dH_P = from_left(K, from_right(dH, P))
    update = from_right(from_left(K, dR), turned(K)) - K_dH_P - transposed(K_dH_P)
    first = (from_right(from_left(open_loop[:1], by_start), turned(open_loop[:1])) + update[:1])[0]
    dP = np.empty((T, n, d, n))
    dP_before = np.empty((T, n, d, n))
    dP[0], dP_before[0] = first, by_start[0]
    if T > 1:
        F, dF, dQ = (rows(M, slice(T - 1)) for M in (Phi, by_Phi, by_Q))
        dF_P_Ft = from_right(dF, P[:-1] @ turned(F))
        forcing = dF_P_Ft + transposed(dF_P_Ft) + dQ
        closed = open_loop[1:]
        transition, added = scan(
            combine_affine,
            (closed @ F, from_right(from_left(closed, forcing), turned(closed)) + update[1:]),
        )
        dP[1:] = (
            from_right(
                from_left(transition, np.broadcast_to(first, (T - 1, n, d, n))), turned(transition)
            )
            + added
        )
        dP_before[1:] = from_right(from_left(F, dP[:-1]), turned(F)) + forcing
    dH_P_Ht = from_right(dH, filter.predicted @ turned(H))
    dS = dH_P_Ht + transposed(dH_P_Ht) + from_right(from_left(H, dP_before), turned(H)) + dR
    flat = (
        from_right(from_left(filter.root, dS), turned(filter.root))
        .transpose(2, 0, 1, 3)
        .reshape(d, -1)
    )
    if n == 0:
        return flat, np.zeros((e.size, d))
    # K = P H^T R^-1. The state changes with the gain.
    dK = (from_right(dP, turned(H)) + _right_transposed(P, dH) - from_left(K, dR)) / filter.variance
    predicted = np.zeros((len(e), n, 1))
    predicted[1:] = Phi @ x[:-1]
    pushed_state = np.zeros((len(e), n, d))
    pushed_state[1:] = from_right(by_Phi, x[:-1])[..., 0]
    change_by_H = from_right(by_H, predicted)[..., 0]
    source = (
        from_right(every_node(dK, filter), residual.innovation[..., None])[..., 0]
        + every_node(open_loop, filter) @ pushed_state
        - every_node(K, filter) @ change_by_H
    )
    by_state = pushed_state
    by_state[1:] += Phi @ joined(closed_loop(filter), source)[:-1]
    return flat, (every_node(filter.root, filter) @ (change_by_H + filter.seen @ by_state)).reshape(
        -1, d
    )


def _padded(stack: np.ndarray, part: slice, d: int) -> np.ndarray:
    """Return the derivatives ``part`` of a stack ``(B, D, a, b)`` in the axes ``(B, a, d, b)``
    of `ident.process_noise.whitener`; zeros fill up to d quantities.
    """
    derivatives = stack[:, part].swapaxes(1, 2)
    padded = np.zeros((*derivatives.shape[:2], d, derivatives.shape[3]))
    padded[:, :, : derivatives.shape[2]] = derivatives
    return padded


def _right_transposed(left: np.ndarray, stack: np.ndarray) -> np.ndarray:
    """Return ``left`` times the transpose of each matrix of ``stack (B, m, D, n)``: ``(T, n, D,
    m)``.
    """
    return transposed(from_right(stack, turned(left)))
