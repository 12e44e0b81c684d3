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
    at_all_nodes,
    closed_loop,
    combine_affine,
    multiply_left,
    multiply_right,
    scan,
    select_nodes,
    solve_recursion,
    transpose,
    transpose_each,
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
    positions : positions, among the requested quantities, of those that change the noise.
    motion : derivatives with respect to these quantities.
    """

    positions: tuple[int, ...]
    motion: DiscretisedNoise


def noise_slopes(
    problem: RecordProblem,
    states: np.ndarray,
    at: Variation,
    pairs: Sequence[tuple[Variation, Variation, float]],
) -> NoiseSlopes:
    """Return the derivatives of the process noise about a fixed trajectory.

    Parameters
    ----------
    states : ``(nx, K + 1)`` trajectory at the nodes.
    at : parameters and scale about which the noise is differentiated.
    pairs : two variations for each requested quantity, and the difference of the quantity between
        them, from `slope_pairs`.
    """
    # variation 0 is the base; quantity i has the variations 1 + 2 i and 2 + 2 i
    ends = [end for low, high, _ in pairs for end in (low, high)]
    F, H, density, stationary = linear_motion(problem, states, [at, *ends])
    parts = (F, H, density[None])
    positions = tuple(
        i
        for i in range(len(pairs))
        if any(np.any(part[:, 1 + 2 * i] != part[:, 2 + 2 * i]) for part in parts)
    )
    chosen = [0, *(end for i in positions for end in (1 + 2 * i, 2 + 2 * i))]
    width = np.array([pairs[i][2] for i in positions])[:, None, None]

    def slope(part: np.ndarray) -> np.ndarray:
        return np.asarray((part[:, 2::2] - part[:, 1::2]) / width)

    F, steps = F[:, chosen], np.diff(problem.grid.nodes)
    computed = _computed_steps(np.concatenate([F[:, :1], slope(F)], axis=1), steps)
    by_Phi, by_Q, start = discrete_motion(
        F[computed], steps[computed] if len(F) > 1 else steps, density[chosen], stationary, slope
    )
    by_Phi, by_Q = (_interpolated(slopes, computed, len(steps)) for slopes in (by_Phi, by_Q))
    return NoiseSlopes(
        positions, DiscretisedNoise(by_Phi, by_Q, slope(H[:, chosen]), slope(start[None])[0])
    )


def slope_pairs(
    at: Variation, positions: Sequence[int], sizes: Sequence[float], scale: bool
) -> list[tuple[Variation, Variation, float]]:
    """Return pairs of variations for central differences, each with the difference between the two.

    Each of the first pairs changes one parameter. A last pair changes the scale of the process
    noise where ``scale`` is True.

    Parameters
    ----------
    at : parameters and scale in the middle of each pair.
    positions : positions of the parameters to change, among all parameters.
    sizes : size of each of these; the difference step is relative to it.
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
    """Return the positions of the steps at which derivatives are computed.

    They are every eighth step where all ``values (K, D, n, n)`` are smooth and the ``steps (K,)``
    are equal, else every step.
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


# ---- Derivatives of the likelihood through the gains and innovation covariances

# largest array of covariance derivatives, in numbers; a larger one does not fit the processor's
# cache
_LARGEST_BATCH = 800_000


@dataclass(frozen=True, eq=False)
class LikelihoodSlopes:
    """Derivatives of the log likelihood with respect to D quantities that change the gains and
    innovation covariances of the filter.

    Attributes
    ----------
    gradient : ``(D,)`` of the log likelihood.
    information : ``(D, D)`` expected information.
    scores : ``(K + 1, D)`` contribution of each node to the gradient.
    """

    gradient: np.ndarray
    information: np.ndarray
    scores: np.ndarray


def likelihood_slopes(
    filter: Whitener, residual: Filtered, slopes: NoiseSlopes, by_variance: np.ndarray
) -> LikelihoodSlopes:
    """Return the derivatives of the log likelihood of one record with respect to D quantities:
    those of ``slopes``, then the d quantities of ``by_variance``.

    Parameters
    ----------
    filter : the filter of the record.
    residual : the residual through the filter, a single column.
    slopes : derivatives of the process noise with respect to the first quantities.
    by_variance : ``(d, m)`` derivatives of the measurement variances with respect to the last d
        quantities.
    """
    T, n, D = (
        len(filter.covariance),
        filter.covariance.shape[-1],
        len(slopes.positions) + len(by_variance),
    )
    by_variance = np.concatenate(
        [np.zeros((len(slopes.positions), len(filter.variance))), by_variance]
    )
    batch = max(1, _LARGEST_BATCH // max(1, T * n * n))
    parts = [
        _filter_derivatives(filter, residual, slopes, by_variance, slice(k, k + batch))
        for k in range(0, D, batch)
    ]
    e, m = residual.normalised, filter.valid.shape[1]
    flat = np.zeros((0, e[:T].size * m))
    if parts:
        flat = np.concatenate([by_covariance for by_covariance, _ in parts])
    counts = np.bincount(filter.entry, minlength=T).astype(float)[:, None, None]
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


@dataclass(frozen=True, eq=False)
class _ModelDerivatives:
    """Derivatives of the matrices that the filter is computed from, with respect to d quantities.

    Axes are those of `ident.process_noise.whitener`: nodes (length 1 where constant), rows, the d
    quantities, columns.

    Attributes
    ----------
    Phi : ``(K or 1, n, d, n)``.
    Q : ``(K or 1, n, d, n)``.
    start : ``(1, n, d, n)`` covariance at the first node.
    H : ``(K + 1 or 1, m, d, n)``, zero where a sample is missing.
    R : ``(K + 1 or 1, m, d, m)``, zero where a sample is missing.
    """

    Phi: np.ndarray
    Q: np.ndarray
    start: np.ndarray
    H: np.ndarray
    R: np.ndarray


def _model_derivatives(
    filter: Whitener, slopes: NoiseSlopes, by_variance: np.ndarray, part: slice
) -> _ModelDerivatives:
    """Return the derivatives of the matrices with respect to the quantities in ``part``."""
    by_measurement = by_variance[part]
    d, m = by_measurement.shape
    present = np.where(filter.valid[:1] if len(filter.masked_H) == 1 else filter.valid, 1.0, 0.0)
    R = np.zeros((len(present), m, d, m))
    for i in range(m):
        R[:, i, :, i] = by_measurement[:, i] * present[:, i, None]
    Phi, Q, start = (
        _padded(M, part, d) for M in (slopes.motion.Phi, slopes.motion.Q, slopes.motion.start[None])
    )
    H = _padded(slopes.motion.H, part, d) * present[:, :, None, None]
    return _ModelDerivatives(Phi, Q, start, H, R)


def _filter_derivatives(
    filter: Whitener, residual: Filtered, slopes: NoiseSlopes, by_variance: np.ndarray, part: slice
) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of the normalised innovation covariances ``(d, T m m)``, and minus the
    derivatives of the normalised innovations ``((K + 1) m, d)``, with respect to the d quantities
    in ``part``.

    The d quantities are a batch of the D quantities of `likelihood_slopes`.
    """
    by = _model_derivatives(filter, slopes, by_variance, part)
    T, n, d = len(filter.covariance), filter.covariance.shape[-1], by.R.shape[2]
    P, K = filter.covariance, filter.gain
    dP, dP_before = _covariance_derivatives(filter, by)
    H, dH = select_nodes(filter.masked_H, slice(T)), select_nodes(by.H, slice(T))
    dR = select_nodes(by.R, slice(T))
    dH_P_Ht = multiply_right(dH, filter.predicted @ transpose(H))
    dS = (
        dH_P_Ht
        + transpose_each(dH_P_Ht)
        + multiply_right(multiply_left(H, dP_before), transpose(H))
        + dR
    )
    normalised_dS = multiply_right(
        multiply_left(filter.inverse_root, dS), transpose(filter.inverse_root)
    )
    flat = normalised_dS.transpose(2, 0, 1, 3).reshape(d, -1)
    if n == 0:
        return flat, np.zeros((residual.normalised.size, d))
    # K = P H^T R^-1. The state changes with the gain.
    dK = (
        multiply_right(dP, transpose(H)) + _right_transposed(P, dH) - multiply_left(K, dR)
    ) / filter.variance
    return flat, _innovation_derivatives(filter, residual, by, dK)


def _covariance_derivatives(
    filter: Whitener, by: _ModelDerivatives
) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives ``(T, n, d, n)`` of the covariances after and before each update."""
    T, n, d = len(filter.covariance), filter.covariance.shape[-1], by.R.shape[2]
    P, K = filter.covariance, filter.gain
    H, dH = select_nodes(filter.masked_H, slice(T)), select_nodes(by.H, slice(T))
    dR = select_nodes(by.R, slice(T))
    open_loop = np.eye(n) - K @ H
    # dP = (I - KH) dP_before (I - KH)^T + K dR K^T - P dH^T K^T - K dH P; "update" is all but the
    # first term.
    K_dH_P = multiply_left(K, multiply_right(dH, P))
    update = multiply_right(multiply_left(K, dR), transpose(K)) - K_dH_P - transpose_each(K_dH_P)
    first = (
        multiply_right(multiply_left(open_loop[:1], by.start), transpose(open_loop[:1]))
        + update[:1]
    )[0]
    dP = np.empty((T, n, d, n))
    dP_before = np.empty((T, n, d, n))
    dP[0], dP_before[0] = first, by.start[0]
    if T == 1:
        return dP, dP_before
    Phi, dPhi, dQ = (select_nodes(M, slice(T - 1)) for M in (filter.motion.Phi, by.Phi, by.Q))
    dPhi_P_Phit = multiply_right(dPhi, P[:-1] @ transpose(Phi))
    forcing = dPhi_P_Phit + transpose_each(dPhi_P_Phit) + dQ
    closed = open_loop[1:]
    transition, added = scan(
        combine_affine,
        (
            closed @ Phi,
            multiply_right(multiply_left(closed, forcing), transpose(closed)) + update[1:],
        ),
    )
    first_at_all = np.broadcast_to(first, (T - 1, n, d, n))
    dP[1:] = multiply_right(multiply_left(transition, first_at_all), transpose(transition)) + added
    dP_before[1:] = multiply_right(multiply_left(Phi, dP[:-1]), transpose(Phi)) + forcing
    return dP, dP_before


def _innovation_derivatives(
    filter: Whitener, residual: Filtered, by: _ModelDerivatives, dK: np.ndarray
) -> np.ndarray:
    """Return minus the derivatives ``((K + 1) m, d)`` of the normalised innovations.

    Changes of H, of the transitions and of the gains change the predicted outputs. ``dK (T, n, d,
    m)`` are the derivatives of the gains. The product of the result with the normalised innovations
    is the gradient of the log likelihood.
    """
    T, n, d = len(filter.covariance), filter.covariance.shape[-1], by.R.shape[2]
    x, Phi = residual.state[..., None], filter.motion.Phi
    open_loop = np.eye(n) - filter.gain @ select_nodes(filter.masked_H, slice(T))
    predicted = np.zeros((len(x), n, 1))
    predicted[1:] = Phi @ x[:-1]
    by_state = np.zeros((len(x), n, d))  # of the predicted state
    by_state[1:] = multiply_right(by.Phi, x[:-1])[..., 0]
    change_by_H = multiply_right(by.H, predicted)[..., 0]
    source = (
        multiply_right(at_all_nodes(dK, filter), residual.innovation[..., None])[..., 0]
        + at_all_nodes(open_loop, filter) @ by_state
        - at_all_nodes(filter.gain, filter) @ change_by_H
    )
    by_state[1:] += Phi @ solve_recursion(closed_loop(filter), source)[:-1]
    return (
        at_all_nodes(filter.inverse_root, filter) @ (change_by_H + filter.masked_H @ by_state)
    ).reshape(-1, d)


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
    return transpose_each(multiply_right(stack, transpose(left)))
