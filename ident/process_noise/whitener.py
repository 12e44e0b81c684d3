"""The Kalman filter as a linear pre-whitener of residuals.

Sarkka and Garcia-Fernandez, "Temporal Parallelization of Bayesian Smoothers", IEEE Trans. Automatic
Control 66(1), 2021: the step from one filtered covariance to the next is an element (A, C, J), P ->
A (I + P J)^-1 P A^T + C, and elements combine associatively.

The residual of a deterministic fit is e = H x + v with x the process noise, see
`ident.process_noise.linear_noise`. Its innovations, nu[k] = e[k] minus the prediction of e[k] from
e[0 .. k - 1], are white. The columns of the Jacobian pass through the same linear filter
(Jategaonkar, Flight Vehicle System Identification, ch. 5). Covariances come from an associative
scan, the states from one banded triangular solve.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ident.process_noise.linear_noise import DiscretisedNoise

# ---- Kalman covariances of a whole record without a loop over its samples: associative scans

Elements = tuple[np.ndarray, ...]
Combine = Callable[[Elements, Elements], Elements]


def scan(combine: Combine, elements: Elements) -> Elements:
    """Return the combinations of the first 1, 2, ... ``elements`` along the first axis (an
    associative scan); ``combine(first, second)`` takes stacks.
    """
    count = len(elements[0])
    if count < 2:
        return elements
    pairs = combine(tuple(e[:-1:2] for e in elements), tuple(e[1::2] for e in elements))
    odd = scan(combine, pairs)
    even = combine(tuple(e[: (count - 1) // 2] for e in odd), tuple(e[2::2] for e in elements))
    out = []
    for first, at_odd, at_even in zip(elements, odd, even, strict=True):
        whole = np.empty((count, *at_odd.shape[1:]))
        whole[0], whole[1::2], whole[2::2] = first[0], at_odd, at_even
        out.append(whole)
    return tuple(out)


def powers(combine: Combine, element: Elements, count: int) -> Elements:
    """Return the combinations of the first 1, 2, ... of ``count`` equal elements, given with a
    first axis of length 1; ``count`` is a power of two.
    """
    out = element
    while len(out[0]) < count:
        last = tuple(e[-1:] for e in out)
        out = tuple(np.concatenate(pair) for pair in zip(out, combine(last, out), strict=True))
    return out


def covariance_steps(Phi: np.ndarray, Q: np.ndarray, H: np.ndarray, R: np.ndarray) -> Elements:
    """Return the elements from one filtered covariance to the next: ``Phi``, ``Q`` ``(K, n, n)``,
    ``H (K, m, n)``, ``R (m,)``.
    """
    Ht = _t(H)
    QH = Q @ Ht
    S = _inverse(H @ QH + np.diag(R))
    gain = QH @ S
    A = Phi - gain @ (H @ Phi)
    seen = H @ Phi
    return A, _symmetric(Q - gain @ _t(QH)), _symmetric(_t(seen) @ S @ seen)


def combine_covariances(first: Elements, second: Elements) -> Elements:
    """Return the element of two consecutive steps."""
    A, C, J = first
    B, D, L = second
    inverse = _inverse(np.eye(A.shape[-1]) + C @ L)
    between, onward = B @ inverse, inverse @ A
    return (
        B @ onward,
        _symmetric(between @ C @ _t(B)) + D,
        _symmetric(_t(A) @ L @ onward) + J,
    )


def advanced(steps: Elements, P: np.ndarray) -> np.ndarray:
    """Return the filtered covariances after each element of ``steps``, starting from ``P
    (n, n)``.
    """
    A, C, J = steps
    inside = _inverse(np.eye(len(P)) + P @ J) @ P
    return _symmetric(A @ inside @ _t(A)) + C


def combine_affine(first: Elements, second: Elements) -> Elements:
    """Combine the maps X -> T X T^T + D of D quantities at once: ``T (K, n, n)``, ``D (K, n, D,
    n)``.
    """
    T, D = first
    U, E = second
    return U @ T, from_right(from_left(U, D), _t(U)) + E


def from_left(matrix: np.ndarray, stack: np.ndarray) -> np.ndarray:
    """``matrix (T or 1, a, b)`` times each of D matrices, which lie side by side: ``(T or 1, b, D,
    c)`` to ``(T, a, D, c)``.
    """
    wide = stack.reshape(*stack.shape[:2], stack.shape[2] * stack.shape[3])
    out = matrix @ wide
    return out.reshape(*out.shape[:2], *stack.shape[2:])


def from_right(stack: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Each of D matrices times ``matrix (T or 1, b, c)``: ``(T or 1, a, D, b)`` to ``(T, a, D,
    c)``.
    """
    tall = stack.reshape(stack.shape[0], stack.shape[1] * stack.shape[2], stack.shape[3])
    out = tall @ matrix
    return out.reshape(out.shape[0], *stack.shape[1:3], out.shape[2])


def transposed(stack: np.ndarray) -> np.ndarray:
    """Return the transpose of each of D matrices: ``(T, a, D, b)`` to ``(T, b, D, a)``."""
    return stack.transpose(0, 3, 2, 1)


def _inverse(M: np.ndarray) -> np.ndarray:
    return np.linalg.inv(M) if M.shape[-1] else M


def _t(M: np.ndarray) -> np.ndarray:
    return np.swapaxes(M, -1, -2)


def _symmetric(M: np.ndarray) -> np.ndarray:
    return 0.5 * (M + _t(M))


# ---- A Kalman filter used as a linear pre-whitener of residuals and of every sensitivity
# column

_SAMPLES_PER_CHUNK = 64
_SETTLED_COVARIANCE_CHANGE = 1e-12  # relative change of the covariance over a chunk


@dataclass(frozen=True, eq=False)
class Whitener:
    """The filter of one record: gains and innovation covariances at the nodes ``0 .. K``.

    Arrays over nodes end once the filter is steady: node k has entry ``at[k]``. ``covariance`` and
    ``predicted`` ``(T, n, n)`` after and before each update, ``gain (T, n, m)``,
    ``innovation_covariance`` and ``root`` ``(T, m, m)``, the latter the inverse of its Cholesky
    factor; rows of samples that are missing are those of the unit matrix. ``valid (K + 1, m)``.
    ``log_determinant`` is the sum over all samples of the log determinant of their innovation
    covariance.
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
    """Columns through the filter: ``innovation (K + 1, m, c)``, ``standard`` of unit variance where
    the column is a residual, ``state (K + 1, n, c)`` after each update; without the last axis where
    one column is meant."""

    innovation: np.ndarray
    standard: np.ndarray
    state: np.ndarray


def whitener(motion: DiscretisedNoise, variance: np.ndarray, valid: np.ndarray) -> Whitener:
    """Return the gains for a process noise, measurement variances ``(m,)`` and validity ``(K + 1,
    m)`` of the samples at the nodes.

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
        steps = powers(
            combine_covariances,
            covariance_steps(motion.Phi, motion.Q, seen, variance),
            _SAMPLES_PER_CHUNK,
        )
        after = _until_settled(steps, first, nodes)
    else:
        Phi, Q = (np.broadcast_to(M, (nodes - 1, *M.shape[1:])) for M in (motion.Phi, motion.Q))
        one = covariance_steps(Phi, Q, seen[1:], variance)
        after = np.concatenate([first[None], advanced(scan(combine_covariances, one), first)])
    Phi, Q = (M if len(M) == 1 else M[: len(after) - 1] for M in (motion.Phi, motion.Q))
    before = (
        np.concatenate([motion.start[None], Phi @ after[:-1] @ turned(Phi) + Q])
        if len(motion.start)
        else after
    )
    PH = before @ turned(seen if len(seen) == 1 else seen[: len(before)])
    S = (seen if len(seen) == 1 else seen[: len(before)]) @ PH + np.diag(variance)
    present = valid[: len(S)]
    S = np.where(present[:, :, None] & present[:, None, :], S, np.eye(m))
    root = np.linalg.inv(np.linalg.cholesky(S))
    gain = PH @ (turned(root) @ root)
    at = np.minimum(np.arange(nodes), len(after) - 1)
    logs = -2.0 * np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
    return Whitener(
        motion, variance, valid, at, seen, after, before, gain, S, root, float(logs[at].sum())
    )


def filtered(filter: Whitener, columns: np.ndarray) -> Filtered:
    """Return the innovations of ``columns (K + 1, m, c)``; values at missing samples are
    ignored.
    """
    e = np.where(filter.valid[:, :, None], columns, 0.0)
    n = filter.covariance.shape[-1]
    if n == 0:
        state = np.zeros((len(e), 0, e.shape[2]))
        return Filtered(e, every_node(filter.root, filter) @ e, state)
    state = joined(closed_loop(filter), every_node(filter.gain, filter) @ e)
    innovation = e.copy()
    innovation[1:] -= rows(filter.seen, slice(1, None)) @ (filter.motion.Phi @ state[:-1])
    return Filtered(innovation, every_node(filter.root, filter) @ innovation, state)


def _updated(P: np.ndarray, H: np.ndarray, variance: np.ndarray) -> np.ndarray:
    if len(P) == 0:
        return P
    PH = P @ H.T
    out = P - PH @ np.linalg.solve(H @ PH + np.diag(variance), PH.T)
    return 0.5 * (out + out.T)


def _until_settled(steps: tuple[np.ndarray, ...], first: np.ndarray, nodes: int) -> np.ndarray:
    """Return the filtered covariances of a time-invariant system until they are steady, for at most
    ``nodes`` nodes.
    """
    parts, P, done = [first[None]], first, 1
    while done < nodes:
        chunk = advanced(steps, P)
        parts.append(chunk)
        done += len(chunk)
        # without noise, rounding may make it negative
        size = np.sqrt(np.maximum(np.diag(chunk[-1]), 0.0))
        if np.all(np.abs(chunk[-1] - P) <= _SETTLED_COVARIANCE_CHANGE * np.outer(size, size)):
            break
        P = chunk[-1]
    return np.concatenate(parts)[:nodes]


def closed_loop(filter: Whitener) -> np.ndarray:
    """Return (I - K H) Phi from node k to k + 1, ``(K, n, n)``."""
    n = filter.covariance.shape[-1]
    if len(filter.seen) == 1 and len(filter.motion.Phi) == 1:
        return ((np.eye(n) - filter.gain @ filter.seen) @ filter.motion.Phi)[filter.at[1:]]
    return (np.eye(n) - filter.gain[1:] @ rows(filter.seen, slice(1, None))) @ filter.motion.Phi


def joined(T: np.ndarray, source: np.ndarray) -> np.ndarray:
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


def every_node(stack: np.ndarray, filter: Whitener) -> np.ndarray:
    """Return the values at every node from those up to the steady state."""
    return stack if len(stack) == len(filter.at) else stack[filter.at]


def rows(stack: np.ndarray, part: slice) -> np.ndarray:
    """Return the matrices of some nodes; a single one is valid for all."""
    return stack if len(stack) == 1 else stack[part]


def turned(M: np.ndarray) -> np.ndarray:
    """Return the transpose of each matrix."""
    return np.swapaxes(M, -1, -2)
