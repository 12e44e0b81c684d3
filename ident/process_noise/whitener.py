"""The Kalman filter as a linear pre-whitener of residuals.

The residual of a deterministic fit is e = H x + v, with measurement noise v and the deviation x by
process noise, see `ident.process_noise.linear_noise`. The innovation nu[k] is e[k] minus its
prediction from e[0 .. k - 1]. Innovations are white. The columns of the Jacobian pass through the
same linear filter (Jategaonkar, Flight Vehicle System Identification, ch. 5).

No loop runs over the samples. One banded triangular solve gives the states, and an associative scan
the covariances: the step from one filtered covariance P to the next is the map A (I + P J)^-1 P A^T
+ C, and the elements (A, C, J) of such maps combine associatively (Sarkka and Garcia-Fernandez,
"Temporal Parallelization of Bayesian Smoothers", IEEE Trans. Automatic Control 66(1), 2021).
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
    """Return the combination of the first k elements, for k = 1, 2, ...: an associative scan.

    Elements lie along the first axis. ``combine(first, second)`` combines stacks of elements.
    """
    count = len(elements[0])
    if count < 2:
        return elements
    pairs = combine(tuple(e[:-1:2] for e in elements), tuple(e[1::2] for e in elements))
    odd = scan(combine, pairs)
    even = combine(tuple(e[: (count - 1) // 2] for e in odd), tuple(e[2::2] for e in elements))
    combined = []
    for part, odd_part, even_part in zip(elements, odd, even, strict=True):
        whole = np.empty((count, *odd_part.shape[1:]))
        whole[0], whole[1::2], whole[2::2] = part[0], odd_part, even_part
        combined.append(whole)
    return tuple(combined)


def powers(combine: Combine, element: Elements, count: int) -> Elements:
    """Return the combination of k equal elements, for k = 1 .. ``count``, a power of two. The
    ``element`` has a first axis of length 1.
    """
    combined = element
    while len(combined[0]) < count:
        last = tuple(part[-1:] for part in combined)
        further = combine(last, combined)
        combined = tuple(np.concatenate(pair) for pair in zip(combined, further, strict=True))
    return combined


def covariance_steps(Phi: np.ndarray, Q: np.ndarray, H: np.ndarray, R: np.ndarray) -> Elements:
    """Return the elements from one filtered covariance to the next.

    ``Phi`` and ``Q`` are ``(K, n, n)``, ``H (K, m, n)``, and the measurement variances ``R (m,)``.
    """
    QHt = Q @ turned(H)
    inverse = _inverse(H @ QHt + np.diag(R))
    gain = QHt @ inverse
    HPhi = H @ Phi
    A = Phi - gain @ HPhi
    return A, _symmetric(Q - gain @ turned(QHt)), _symmetric(turned(HPhi) @ inverse @ HPhi)


def combine_covariances(first: Elements, second: Elements) -> Elements:
    """Return the element of two successive steps."""
    A, C, J = first
    B, D, L = second
    inverse = _inverse(np.eye(A.shape[-1]) + C @ L)
    between, onward = B @ inverse, inverse @ A
    return (
        B @ onward,
        _symmetric(between @ C @ turned(B)) + D,
        _symmetric(turned(A) @ L @ onward) + J,
    )


def advanced(steps: Elements, P: np.ndarray) -> np.ndarray:
    """Return the filtered covariance after each element of ``steps``, from ``P (n, n)``."""
    A, C, J = steps
    updated = _inverse(np.eye(len(P)) + P @ J) @ P
    return _symmetric(A @ updated @ turned(A)) + C


def combine_affine(first: Elements, second: Elements) -> Elements:
    """Return the combination of two maps X -> T X T^T + C for D quantities at once, with ``T (K, n,
    n)`` and ``C (K, n, D, n)``.
    """
    T1, C1 = first
    T2, C2 = second
    return T2 @ T1, from_right(from_left(T2, C1), turned(T2)) + C2


def from_left(matrix: np.ndarray, stack: np.ndarray) -> np.ndarray:
    """Return ``matrix (T or 1, a, b)`` times each of D matrices: ``(T, a, D, c)``.

    The D matrices of the ``stack (T or 1, b, D, c)`` lie side by side.
    """
    wide = stack.reshape(*stack.shape[:2], stack.shape[2] * stack.shape[3])
    product = matrix @ wide
    return product.reshape(*product.shape[:2], *stack.shape[2:])


def from_right(stack: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Return each of D matrices, ``stack (T or 1, a, D, b)``, times ``matrix (T or 1, b, c)``:
    ``(T, a, D, c)``.
    """
    tall = stack.reshape(stack.shape[0], stack.shape[1] * stack.shape[2], stack.shape[3])
    product = tall @ matrix
    return product.reshape(product.shape[0], *stack.shape[1:3], product.shape[2])


def transposed(stack: np.ndarray) -> np.ndarray:
    """Return the transpose of each of D matrices: ``(T, a, D, b)`` to ``(T, b, D, a)``."""
    return stack.transpose(0, 3, 2, 1)


def _inverse(M: np.ndarray) -> np.ndarray:
    return np.linalg.inv(M) if M.shape[-1] else M


def _symmetric(M: np.ndarray) -> np.ndarray:
    return 0.5 * (M + turned(M))


# ---- A Kalman filter used as a linear pre-whitener of residuals and of every sensitivity
# column

_SAMPLES_PER_CHUNK = 64  # samples between two tests whether a filter is steady; a power of two
_SETTLED_COVARIANCE_CHANGE = 1e-12  # largest relative change over a chunk, of a steady covariance


@dataclass(frozen=True, eq=False)
class Whitener:
    """The filter of one record: gains and innovation covariances at the nodes ``0 .. K``.

    Arrays over nodes have T entries, which end once the filter is steady.

    Attributes
    ----------
    variance : ``(m,)`` measurement noise.
    valid : ``(K + 1, m)`` False where a node has no valid sample.
    at : ``(K + 1,)`` the entry of each node.
    seen : ``(K + 1 or 1, m, n)`` H, with zeros where a sample is missing.
    covariance : ``(T, n, n)`` after each update.
    predicted : ``(T, n, n)`` covariance before each update.
    gain : ``(T, n, m)``.
    innovation_covariance : ``(T, m, m)``; rows of missing samples are those of the unit matrix.
    root : ``(T, m, m)`` inverse of the Cholesky factor of the innovation covariance.
    log_determinant : log determinant of the innovation covariance, summed over all nodes.
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
    """Columns through the filter; a single column is without the last axis.

    Attributes
    ----------
    innovation : ``(K + 1, m, c)``.
    standard : ``(K + 1, m, c)`` normalised innovations; those of a residual have unit variance.
    state : ``(K + 1, n, c)`` after each update.
    """

    innovation: np.ndarray
    standard: np.ndarray
    state: np.ndarray


def whitener(motion: DiscretisedNoise, variance: np.ndarray, valid: np.ndarray) -> Whitener:
    """Return the filter of one record.

    Parameters
    ----------
    motion : process noise.
    variance : ``(m,)`` measurement noise.
    valid : ``(K + 1, m)`` False where a node has no valid sample.

    Raises
    ------
    numpy.linalg.LinAlgError : where an innovation covariance is not positive definite.
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
        steps = covariance_steps(Phi, Q, seen[1:], variance)
        after = np.concatenate([first[None], advanced(scan(combine_covariances, steps), first)])
    Phi, Q = (M if len(M) == 1 else M[: len(after) - 1] for M in (motion.Phi, motion.Q))
    before = after
    if len(motion.start):
        before = np.concatenate([motion.start[None], Phi @ after[:-1] @ turned(Phi) + Q])
    H = rows(seen, slice(len(before)))
    PHt = before @ turned(H)
    S = H @ PHt + np.diag(variance)
    present = valid[: len(S)]
    S = np.where(present[:, :, None] & present[:, None, :], S, np.eye(m))
    root = np.linalg.inv(np.linalg.cholesky(S))
    gain = PHt @ (turned(root) @ root)
    at = np.minimum(np.arange(nodes), len(after) - 1)
    logs = -2.0 * np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
    return Whitener(
        motion, variance, valid, at, seen, after, before, gain, S, root, float(logs[at].sum())
    )


def filtered(filter: Whitener, columns: np.ndarray) -> Filtered:
    """Return ``columns (K + 1, m, c)`` through the filter; values at missing samples do not
    count.
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
    """Return the covariance ``(n, n)`` after an update by one sample."""
    if len(P) == 0:
        return P
    PHt = P @ H.T
    return _symmetric(P - PHt @ np.linalg.solve(H @ PHt + np.diag(variance), PHt.T))


def _until_settled(steps: tuple[np.ndarray, ...], first: np.ndarray, nodes: int) -> np.ndarray:
    """Return the filtered covariances ``(T, n, n)`` of a time-invariant system until they are
    steady, for at most ``nodes`` nodes.

    ``first (n, n)`` is that of the first node, and ``steps`` are the elements of one chunk.
    """
    parts, P, count = [first[None]], first, 1
    while count < nodes:
        chunk = advanced(steps, P)
        parts.append(chunk)
        count += len(chunk)
        # without noise, rounding may make a variance negative
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
    """Return x ``(K + 1, n, c)``, the solution of x[k + 1] = T[k] x[k] + source[k + 1] with x[0] =
    source[0].
    """
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
    """Return the values at all nodes, from a stack that ends once the filter is steady."""
    return stack if len(stack) == len(filter.at) else stack[filter.at]


def rows(stack: np.ndarray, part: slice) -> np.ndarray:
    """Return the matrices of the nodes in ``part``; a stack of one matrix holds for all nodes."""
    return stack if len(stack) == 1 else stack[part]


def turned(M: np.ndarray) -> np.ndarray:
    """Return the transpose of each matrix."""
    return np.swapaxes(M, -1, -2)
