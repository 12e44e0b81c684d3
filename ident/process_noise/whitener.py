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

# (A, C, J) of a covariance step, or (T, C) of an affine map; each array has the steps as first axis
Elements = tuple[np.ndarray, ...]
Combine = Callable[[Elements, Elements], Elements]


def scan(combine: Combine, elements: Elements) -> Elements:
    """Return the combination of the first k elements for each k: an associative scan.

    Elements lie along the first axis. ``combine(first, second)`` combines two stacks of elements,
    entry by entry.
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
    """Return the elements (A, C, J) of the steps from each filtered covariance to the next.

    ``Phi`` and ``Q`` are ``(K, n, n)``, ``H (K, m, n)``, and the measurement variances ``R (m,)``.
    """
    QHt = Q @ transpose(H)
    inverse = _inverse(H @ QHt + np.diag(R))
    gain = QHt @ inverse
    HPhi = H @ Phi
    A = Phi - gain @ HPhi
    return A, _symmetric(Q - gain @ transpose(QHt)), _symmetric(transpose(HPhi) @ inverse @ HPhi)


def combine_covariances(first: Elements, second: Elements) -> Elements:
    """Return the element (A, C, J) of two successive steps as one."""
    A1, C1, J1 = first
    A2, C2, J2 = second
    inverse = _inverse(np.eye(A1.shape[-1]) + C1 @ J2)
    A2_inverse, inverse_A1 = A2 @ inverse, inverse @ A1
    return (
        A2 @ inverse_A1,
        _symmetric(A2_inverse @ C1 @ transpose(A2)) + C2,
        _symmetric(transpose(A1) @ J2 @ inverse_A1) + J1,
    )


def apply_steps(steps: Elements, P: np.ndarray) -> np.ndarray:
    """Return the filtered covariance ``(K, n, n)`` after each of the K elements ``steps``, each
    applied to the covariance ``P (n, n)``.
    """
    A, C, J = steps
    updated = _inverse(np.eye(len(P)) + P @ J) @ P
    return _symmetric(A @ updated @ transpose(A)) + C


def combine_affine(first: Elements, second: Elements) -> Elements:
    """Return the combination of two maps X -> T X T^T + C for D quantities at once, with ``T (K, n,
    n)`` and ``C (K, n, D, n)``.
    """
    T1, C1 = first
    T2, C2 = second
    return T2 @ T1, multiply_right(multiply_left(T2, C1), transpose(T2)) + C2


def multiply_left(matrix: np.ndarray, stack: np.ndarray) -> np.ndarray:
    """Return ``matrix (T or 1, a, b)`` times each of D matrices: ``(T, a, D, c)``.

    The D matrices of the ``stack (T or 1, b, D, c)`` lie side by side.
    """
    wide = stack.reshape(*stack.shape[:2], stack.shape[2] * stack.shape[3])
    product = matrix @ wide
    return product.reshape(*product.shape[:2], *stack.shape[2:])


def multiply_right(stack: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Return each of D matrices, ``stack (T or 1, a, D, b)``, times ``matrix (T or 1, b, c)``:
    ``(T, a, D, c)``.
    """
    tall = stack.reshape(stack.shape[0], stack.shape[1] * stack.shape[2], stack.shape[3])
    product = tall @ matrix
    return product.reshape(product.shape[0], *stack.shape[1:3], product.shape[2])


def transpose_each(stack: np.ndarray) -> np.ndarray:
    """Return the transpose of each of D matrices: ``(T, a, D, b)`` to ``(T, b, D, a)``."""
    return stack.transpose(0, 3, 2, 1)


def _inverse(M: np.ndarray) -> np.ndarray:
    return np.linalg.inv(M) if M.shape[-1] else M


def _symmetric(M: np.ndarray) -> np.ndarray:
    return 0.5 * (M + transpose(M))


# ---- A Kalman filter used as a linear pre-whitener of residuals and sensitivities

_SAMPLES_PER_CHUNK = 64  # samples between two tests whether a filter is steady; a power of two
_STEADY_COVARIANCE_CHANGE = 1e-12  # largest relative change of a steady covariance over a chunk


@dataclass(frozen=True, eq=False)
class Whitener:
    """The filter of one record: gains and innovation covariances at the nodes ``0 .. K``.

    Arrays over nodes have T entries. They end once the filter is steady: the last entry then holds
    for all further nodes.

    Attributes
    ----------
    motion : process noise.
    variance : ``(m,)`` variance of the measurement noise.
    valid : ``(K + 1, m)`` False where a node has no valid sample.
    entry : ``(K + 1,)`` position of each node's entry among the T.
    masked_H : ``(K + 1 or 1, m, n)`` H, with zeros where a sample is missing.
    covariance : ``(T, n, n)`` of the state, after each update.
    predicted : ``(T, n, n)`` covariance before each update.
    gain : ``(T, n, m)`` Kalman gain.
    innovation_covariance : ``(T, m, m)``; the rows of missing samples are those of the unit matrix.
    inverse_root : ``(T, m, m)`` inverse of the Cholesky factor of the innovation covariance.
    log_determinant : log determinant of the innovation covariance, summed over all nodes.
    """

    motion: DiscretisedNoise
    variance: np.ndarray
    valid: np.ndarray
    entry: np.ndarray
    masked_H: np.ndarray
    covariance: np.ndarray
    predicted: np.ndarray
    gain: np.ndarray
    innovation_covariance: np.ndarray
    inverse_root: np.ndarray
    log_determinant: float


@dataclass(frozen=True, eq=False)
class Filtered:
    """Result of passing c columns through the filter; for a single column, arrays lack the last
    axis.

    Attributes
    ----------
    innovation : ``(K + 1, m, c)`` innovations, in the units of the outputs.
    normalised : ``(K + 1, m, c)`` innovations times the inverse root of their covariance; those of
        a residual have unit variance.
    state : ``(K + 1, n, c)`` state of the filter after each update.
    """

    innovation: np.ndarray
    normalised: np.ndarray
    state: np.ndarray


def whitener(motion: DiscretisedNoise, variance: np.ndarray, valid: np.ndarray) -> Whitener:
    """Return the filter of one record.

    Parameters
    ----------
    motion : process noise.
    variance : ``(m,)`` variance of the measurement noise.
    valid : ``(K + 1, m)`` False where a node has no valid sample.

    Raises
    ------
    numpy.linalg.LinAlgError : where an innovation covariance is not positive definite.
    """
    nodes, m = valid.shape
    steady = len(motion.Phi) == 1 and len(motion.H) == 1 and bool(np.all(valid == valid[0]))
    masked_H = np.where(valid[:1] if steady else valid, 1.0, 0.0)[:, :, None] * motion.H
    first = _updated(motion.start, masked_H[0], variance)
    if motion.start.shape[0] == 0:
        after = np.zeros((1 if steady else nodes, 0, 0))
    elif steady:
        steps = powers(
            combine_covariances,
            covariance_steps(motion.Phi, motion.Q, masked_H, variance),
            _SAMPLES_PER_CHUNK,
        )
        after = _until_steady(steps, first, nodes)
    else:
        Phi, Q = (np.broadcast_to(M, (nodes - 1, *M.shape[1:])) for M in (motion.Phi, motion.Q))
        steps = covariance_steps(Phi, Q, masked_H[1:], variance)
        after = np.concatenate([first[None], apply_steps(scan(combine_covariances, steps), first)])
    Phi, Q = (M if len(M) == 1 else M[: len(after) - 1] for M in (motion.Phi, motion.Q))
    before = after
    if len(motion.start):
        before = np.concatenate([motion.start[None], Phi @ after[:-1] @ transpose(Phi) + Q])
    H = select_nodes(masked_H, slice(len(before)))
    PHt = before @ transpose(H)
    S = H @ PHt + np.diag(variance)
    present = valid[: len(S)]
    S = np.where(present[:, :, None] & present[:, None, :], S, np.eye(m))
    root = np.linalg.inv(np.linalg.cholesky(S))
    gain = PHt @ (transpose(root) @ root)
    entry = np.minimum(np.arange(nodes), len(after) - 1)
    logs = -2.0 * np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
    log_determinant = float(logs[entry].sum())
    return Whitener(
        motion, variance, valid, entry, masked_H, after, before, gain, S, root, log_determinant
    )


def filtered(filter: Whitener, columns: np.ndarray) -> Filtered:
    """Return the innovations of ``columns (K + 1, m, c)`` and the states of the filter; values at
    missing samples do not count.
    """
    e = np.where(filter.valid[:, :, None], columns, 0.0)
    n = filter.covariance.shape[-1]
    if n == 0:
        state = np.zeros((len(e), 0, e.shape[2]))
        return Filtered(e, at_all_nodes(filter.inverse_root, filter) @ e, state)
    state = solve_recursion(closed_loop(filter), at_all_nodes(filter.gain, filter) @ e)
    innovation = e.copy()
    innovation[1:] -= select_nodes(filter.masked_H, slice(1, None)) @ (
        filter.motion.Phi @ state[:-1]
    )
    return Filtered(innovation, at_all_nodes(filter.inverse_root, filter) @ innovation, state)


def _updated(P: np.ndarray, H: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return the covariance ``(n, n)`` after an update by one sample."""
    if len(P) == 0:
        return P
    PHt = P @ H.T
    return _symmetric(P - PHt @ np.linalg.solve(H @ PHt + np.diag(variance), PHt.T))


def _until_steady(steps: tuple[np.ndarray, ...], first: np.ndarray, nodes: int) -> np.ndarray:
    """Return the filtered covariances ``(T, n, n)`` of a time-invariant system until they are
    steady, for at most ``nodes`` nodes.

    ``first (n, n)`` is the covariance of the first node. ``steps`` are the elements of one chunk.
    """
    parts, P, count = [first[None]], first, 1
    while count < nodes:
        chunk = apply_steps(steps, P)
        parts.append(chunk)
        count += len(chunk)
        # without noise, rounding may make a variance negative
        size = np.sqrt(np.maximum(np.diag(chunk[-1]), 0.0))
        if np.all(np.abs(chunk[-1] - P) <= _STEADY_COVARIANCE_CHANGE * np.outer(size, size)):
            break
        P = chunk[-1]
    return np.concatenate(parts)[:nodes]


def closed_loop(filter: Whitener) -> np.ndarray:
    """Return the closed-loop transition (I - K H) Phi of the filter from node k to k + 1, ``(K, n,
    n)``.
    """
    n = filter.covariance.shape[-1]
    if len(filter.masked_H) == 1 and len(filter.motion.Phi) == 1:
        return ((np.eye(n) - filter.gain @ filter.masked_H) @ filter.motion.Phi)[filter.entry[1:]]
    return (
        np.eye(n) - filter.gain[1:] @ select_nodes(filter.masked_H, slice(1, None))
    ) @ filter.motion.Phi


def solve_recursion(T: np.ndarray, source: np.ndarray) -> np.ndarray:
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


def at_all_nodes(stack: np.ndarray, filter: Whitener) -> np.ndarray:
    """Return the values at all K + 1 nodes, from a stack of T entries that ends once the filter is
    steady.
    """
    return stack if len(stack) == len(filter.entry) else stack[filter.entry]


def select_nodes(stack: np.ndarray, part: slice) -> np.ndarray:
    """Return the matrices of the nodes in ``part``; a stack of one matrix holds for all nodes."""
    return stack if len(stack) == 1 else stack[part]


def transpose(M: np.ndarray) -> np.ndarray:
    """Return the transpose of each matrix."""
    return np.swapaxes(M, -1, -2)
