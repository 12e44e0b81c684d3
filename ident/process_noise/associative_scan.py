"""Kalman covariances of a whole record without a loop over its samples: associative scans.

Sarkka and Garcia-Fernandez, "Temporal Parallelization of Bayesian Smoothers", IEEE Trans. Automatic Control 66(1), 2021:
the step from one filtered covariance to the next is an element (A, C, J), P -> A (I + P J)^-1 P A^T + C, and
elements combine associatively.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Elements = tuple[np.ndarray, ...]
Combine = Callable[[Elements, Elements], Elements]


def scan(combine: Combine, elements: Elements) -> Elements:
    """All prefixes of ``elements`` along the first axis; ``combine(first, second)`` takes stacks."""
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
    """Prefixes of ``count`` equal elements, each given with a first axis of length 1; ``count`` a power of two."""
    out = element
    while len(out[0]) < count:
        last = tuple(e[-1:] for e in out)
        out = tuple(np.concatenate(pair) for pair in zip(out, combine(last, out), strict=True))
    return out


def covariance_steps(Phi: np.ndarray, Q: np.ndarray, H: np.ndarray, R: np.ndarray) -> Elements:
    """Elements from one filtered covariance to the next: ``Phi``, ``Q`` ``(K, n, n)``, ``H (K, m, n)``, ``R (m,)``."""
    Ht = _t(H)
    QH = Q @ Ht
    S = _inverse(H @ QH + np.diag(R))
    gain = QH @ S
    A = Phi - gain @ (H @ Phi)
    seen = H @ Phi
    return A, _symmetric(Q - gain @ _t(QH)), _symmetric(_t(seen) @ S @ seen)


def combine_covariances(first: Elements, second: Elements) -> Elements:
    """The element of two steps in a row."""
    A, C, J = first
    B, D, L = second
    n = A.shape[-1]
    between = B @ _inverse(np.eye(n) + C @ L)
    return between @ A, _symmetric(between @ C @ _t(B)) + D, _symmetric(_t(A) @ L @ _inverse(np.eye(n) + C @ L) @ A) + J


def advanced(steps: Elements, P: np.ndarray) -> np.ndarray:
    """Filtered covariances after each element of ``steps``, starting from ``P (n, n)``."""
    A, C, J = steps
    inside = _inverse(np.eye(len(P)) + P @ J) @ P
    return _symmetric(A @ inside @ _t(A)) + C


def combine_affine(first: Elements, second: Elements) -> Elements:
    """Of X -> T X T^T + D for D quantities at once: ``T (K, n, n)``, ``D (K, n, D, n)``."""
    T, D = first
    U, E = second
    return U @ T, from_right(from_left(U, D), _t(U)) + E


def from_left(matrix: np.ndarray, stack: np.ndarray) -> np.ndarray:
    """``matrix (T or 1, a, b)`` times each of D matrices, which lie side by side: ``(T or 1, b, D, c)`` to ``(T, a, D, c)``."""
    wide = stack.reshape(*stack.shape[:2], stack.shape[2] * stack.shape[3])
    out = matrix @ wide
    return out.reshape(*out.shape[:2], *stack.shape[2:])


def from_right(stack: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Each of D matrices times ``matrix (T or 1, b, c)``: ``(T or 1, a, D, b)`` to ``(T, a, D, c)``."""
    tall = stack.reshape(stack.shape[0], stack.shape[1] * stack.shape[2], stack.shape[3])
    out = tall @ matrix
    return out.reshape(out.shape[0], *stack.shape[1:3], out.shape[2])


def transposed(stack: np.ndarray) -> np.ndarray:
    """The transpose of each of D matrices: ``(T, a, D, b)`` to ``(T, b, D, a)``."""
    return stack.transpose(0, 3, 2, 1)


def _inverse(M: np.ndarray) -> np.ndarray:
    return np.linalg.inv(M) if M.shape[-1] else M


def _t(M: np.ndarray) -> np.ndarray:
    return np.swapaxes(M, -1, -2)


def _symmetric(M: np.ndarray) -> np.ndarray:
    return 0.5 * (M + _t(M))
