"""Process noise along a trajectory and the Kalman filter as a linear pre-whitener of residuals.

Sarkka and Garcia-Fernandez, "Temporal Parallelization of Bayesian Smoothers", IEEE Trans. Automatic
Control 66(1), 2021: the step from one filtered covariance to the next is an element (A, C, J), P ->
A (I + P J)^-1 P A^T + C, and elements combine associatively.

States that white noise reaches deviate from the deterministic trajectory as x_dot = F x + w, y = H
x, with F and H linearised there and w of the System's spectral density. Only those states are kept.
A free initial state is an unknown of the fit, so its deviation starts at zero; states of a noise
effect start from their stationary spread.

The residual of a deterministic fit is e = H x + v with x the process noise. Its innovations, nu[k]
= e[k] minus its prediction from e[0 .. k - 1], are white; the columns of the Jacobian pass through
the same linear filter (Jategaonkar, Flight Vehicle System Identification, ch. 5). Covariances come
from an associative scan, the states from one banded triangular solve.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.whole_record.record_problem import RecordProblem
from sim.declaration.model import System
from sim.maths import COMPLEX_STEP

# ---- Kalman covariances of a whole record without a loop over its samples: associative scans

Elements = tuple[np.ndarray, ...]
Combine = Callable[[Elements, Elements], Elements]


def scan(combine: Combine, elements: Elements) -> Elements:
    """All prefixes of ``elements`` along the first axis; ``combine(first, second)`` takes
    stacks.
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
    """Prefixes of ``count`` equal elements, each given with a first axis of length 1; ``count`` a
    power of two.
    """
    out = element
    while len(out[0]) < count:
        last = tuple(e[-1:] for e in out)
        out = tuple(np.concatenate(pair) for pair in zip(out, combine(last, out), strict=True))
    return out


def covariance_steps(Phi: np.ndarray, Q: np.ndarray, H: np.ndarray, R: np.ndarray) -> Elements:
    """Elements from one filtered covariance to the next: ``Phi``, ``Q`` ``(K, n, n)``, ``H (K, m,
    n)``, ``R (m,)``.
    """
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
    return (
        between @ A,
        _symmetric(between @ C @ _t(B)) + D,
        _symmetric(_t(A) @ L @ _inverse(np.eye(n) + C @ L) @ A) + J,
    )


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
    """The transpose of each of D matrices: ``(T, a, D, b)`` to ``(T, b, D, a)``."""
    return stack.transpose(0, 3, 2, 1)


def _inverse(M: np.ndarray) -> np.ndarray:
    return np.linalg.inv(M) if M.shape[-1] else M


def _t(M: np.ndarray) -> np.ndarray:
    return np.swapaxes(M, -1, -2)


def _symmetric(M: np.ndarray) -> np.ndarray:
    return 0.5 * (M + _t(M))


# ---- Process noise of a System along a trajectory

_TERMS = 14  # of a Taylor series, to rounding
_FEW_TERMS = 4  # for slopes that differ from step to step: good to a ten-thousandth or better
_AT_ONCE = 16_000  # numbers that are worked on together: more do not stay in a processor's cache
# Chebyshev points over the step sizes: a smooth function of a step within a factor of three, to
# rounding
_KNOTS = 14


@dataclass(frozen=True, eq=False)
class DiscretisedNoise:
    """Linear process noise over the nodes ``0 .. K`` of a record, ``n`` states.

    ``Phi``, ``Q`` ``(K, n, n)`` lead from node k to k + 1; ``H (K + 1, m, n)``; ``start (n, n)``.
    The leading axis has length 1 where nothing changes over the record. In derivatives by D
    quantities a further axis D precedes the matrices.
    """

    Phi: np.ndarray
    Q: np.ndarray
    H: np.ndarray
    start: np.ndarray


@dataclass(frozen=True, eq=False)
class Variation:
    """All parameters ``p`` and the factor ``scale`` on the declared process noise's standard
    deviation.
    """

    p: np.ndarray
    scale: float


NoiseReport = Callable[[np.ndarray], np.ndarray]


def discretised_noise(
    problem: RecordProblem, states: np.ndarray, at: Variation
) -> DiscretisedNoise:
    """Process noise about ``states (nx, K + 1)``; without any state where white noise reaches
    none.
    """
    F, H, density, stationary = linear_motion(problem, states, [at])
    Phi, Q, start = discrete_motion(F, np.diff(problem.grid.nodes), density, stationary)
    return DiscretisedNoise(Phi[:, 0], Q[:, 0], H[:, 0], start[0])


def linear_motion(
    problem: RecordProblem, states: np.ndarray, variations: Sequence[Variation]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """F and H ``(B, V, ...)``, density ``(V, n)`` of V variations, of the n states that the first
    one's forcing reaches; which are stationary.
    """
    system, nodes = problem.system, problem.grid.nodes
    V, m = len(variations), len(system.outputs)
    density = np.array([_density(system, variation) for variation in variations])
    if not np.any(density[0] > 0):
        return (
            np.zeros((1, V, 0, 0)),
            np.zeros((1, V, m, 0)),
            np.zeros((V, 0)),
            np.zeros(0, dtype=bool),
        )
    F = _jacobians(system, system.f, _middles(problem, states), variations)
    H = _jacobians(system, system.h, (nodes, states, _inputs(problem, nodes)), variations)
    kept = _reached(np.any(F[:, 0] != 0, axis=0), density[0] > 0)
    stationary = np.array([system.state_names[i] in system.stationary for i in kept])
    if len(kept) == len(states):
        return F, H, density, stationary
    return F[..., kept[:, None], kept], H[..., kept], density[:, kept], stationary


def discrete_motion(
    F: np.ndarray,
    steps: np.ndarray,
    density: np.ndarray,
    stationary: np.ndarray,
    told: NoiseReport = np.asarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Phi and Q ``(K or 1, V, n, n)`` over node intervals, or what is ``told`` of them, and
    covariance at the start ``(V, n, n)``.
    """
    if F.shape[-1] == 0:
        return told(F), told(F), F[0]
    Phi, Q = _over_steps(F, density, steps, told)
    return Phi, Q, _stationary_spread(F[0], density, np.flatnonzero(stationary))


def _density(system: System, variation: Variation) -> np.ndarray:
    declared = np.array(
        [system.declared_noise.process_density.get(name, 0.0) for name in system.state_names]
    )
    density = np.array(system.noise(variation.p.tolist())[0], dtype=float)
    return density + (variation.scale**2 - 1.0) * declared


def _inputs(problem: RecordProblem, times: np.ndarray) -> np.ndarray:
    """Recorded inputs ``(nu, len(times))``; a lag on their way hardly changes a linearisation."""
    rows = problem.record.input_array(problem.system.input_names)
    return np.array([np.interp(times, problem.record.time, row) for row in rows]).reshape(
        len(rows), len(times)
    )


def _middles(
    problem: RecordProblem, states: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    nodes = problem.grid.nodes
    times = 0.5 * (nodes[:-1] + nodes[1:])
    return times, 0.5 * (states[:, :-1] + states[:, 1:]), _inputs(problem, times)


def _jacobians(
    system: System,
    function: Any,
    where: tuple[np.ndarray, np.ndarray, np.ndarray],
    variations: Sequence[Variation],
) -> np.ndarray:
    """Derivative of ``f`` or ``h`` by the states, ``(B, V, rows, nx)``; B is 1 where it is the same
    all along.
    """
    base = _jacobian(system, function, where, variations[:1])
    if np.all(np.ptp(base, axis=0) <= 1e-13 * np.max(np.abs(base), axis=0)):
        base, where = base[:1], (where[0][:1], where[1][:, :1], where[2][:, :1])
    return base if len(variations) == 1 else _jacobian(system, function, where, variations)


def _jacobian(
    system: System,
    function: Any,
    where: tuple[np.ndarray, np.ndarray, np.ndarray],
    variations: Sequence[Variation],
) -> np.ndarray:
    # Exact to rounding: complex steps, one column a state. Times stand last: whatever is the same
    # for all of them meets long rows.
    t, X, U = where
    n_x, values = len(X), np.array([variation.p for variation in variations])
    same = np.all(values == values[0], axis=0)
    p = [
        float(values[0, i]) if same[i] else values[:, i][:, None, None]
        for i in range(values.shape[1])
    ]
    rows, out = max(1, _AT_ONCE // (len(variations) * n_x)), None
    for k in range(0, len(t), rows):
        at = slice(k, k + rows)
        x = [np.repeat(row[None, None, at].astype(complex), n_x, axis=1) for row in X]
        for i in range(n_x):
            x[i][:, i] += 1j * COMPLEX_STEP
        slopes = function(t[at], x, list(U[:, at]), p)
        if out is None:
            out = np.empty((len(t), len(variations), len(slopes), n_x))
        for i, row in enumerate(slopes):
            turned = np.broadcast_to(np.imag(row), (len(variations), n_x, len(t[at]))).transpose(
                2, 0, 1
            )
            np.divide(turned, COMPLEX_STEP, out=out[at, :, i])
    assert out is not None
    return out


def _reached(coupled: np.ndarray, forced: np.ndarray) -> np.ndarray:
    """Positions of the states that the forcing reaches through the couplings ``(nx, nx)``."""
    reached = forced.copy()
    for _ in range(len(reached)):
        reached = reached | np.any(coupled & reached, axis=1)
    return np.flatnonzero(reached)


def _over_steps(
    F: np.ndarray, density: np.ndarray, steps: np.ndarray, told: NoiseReport
) -> tuple[np.ndarray, np.ndarray]:
    """Phi and Q over each step, ``(K or 1, V, n, n)``, or what is ``told`` of them, from ``F (K or
    1, V, n, n)`` and ``density (V, n)``.
    """
    low, high = float(steps.min()), float(steps.max())
    even = high - low <= 1e-9 * high
    if len(F) > 1:
        steps = np.full(len(steps), steps.mean()) if even else steps
        at, back = _distinct(np.concatenate([F[:, 0].reshape(len(F), -1), steps[:, None]], axis=1))
        if len(at) < len(F):  # else the others differ as well, whatever more they have
            at, back = _distinct(np.concatenate([F.reshape(len(F), -1), steps[:, None]], axis=1))
        some = slice(None) if len(at) == len(F) else at
        Phi, Q = discretised(
            F[some], density, steps[some, None], _TERMS if F.shape[1] == 1 else _FEW_TERMS, told
        )
        return (Phi, Q) if len(at) == len(F) else (Phi[back], Q[back])
    if even:
        return discretised(F, density, np.full((1, 1), steps.mean()), told=told)
    # One F and many steps: the result is a smooth function of the step.
    angle = np.pi * (np.arange(_KNOTS) + 0.5) / _KNOTS
    knots = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(angle)
    share = _barycentric(knots, (-1.0) ** np.arange(_KNOTS) * np.sin(angle), steps)
    Phi, Q = discretised(
        np.broadcast_to(F, (_KNOTS, *F.shape[1:])), density, knots[:, None], told=told
    )
    return np.tensordot(share, Phi, 1), np.tensordot(share, Q, 1)


def _distinct(rows: np.ndarray) -> tuple[list[int], list[int]]:
    """Where each different row of ``rows (K, c)`` comes first, and which of these each row is.

    A dead band or a limit changes F at a few inputs only: most of a record's steps are one of few.
    """
    first: dict[bytes, int] = {}
    at: list[int] = []
    back = []
    for k, row in enumerate(np.ascontiguousarray(rows)):
        number = first.setdefault(row.tobytes(), len(at))
        if number == len(at):
            at.append(k)
        back.append(number)
    return at, back


def _barycentric(knots: np.ndarray, weights: np.ndarray, at: np.ndarray) -> np.ndarray:
    away = at[:, None] - knots
    hit = away == 0
    share = weights / np.where(hit, 1.0, away)
    share = np.where(np.any(hit, axis=1)[:, None], hit, share)
    return share / share.sum(axis=1, keepdims=True)


def discretised(
    F: np.ndarray,
    density: np.ndarray,
    dt: np.ndarray,
    terms: int = _TERMS,
    told: NoiseReport = np.asarray,
) -> tuple[np.ndarray, np.ndarray]:
    """exp(F dt) and the integral of exp(F s) diag(density) exp(F s)^T over the step, both to
    rounding.

    Shapes ``(K, ..., n, n)``, ``(..., n)``, ``(K, ...)``. Taylor series of Phi and of the solution
    of Q_dot = F Q + Q F^T + diag(density) on a short step, then doubling. ``told`` of each part is
    put together, else all of it.
    """
    rows = max(1, _AT_ONCE // max(1, F[0].size))
    parts = [(F[k : k + rows], dt[k : k + rows]) for k in range(0, len(F), rows)]
    size = max(
        float(np.max(np.sum(np.abs(part), axis=-1).max(axis=-1) * steps, initial=0.0))
        for part, steps in parts
    )
    halvings = max(0, int(np.ceil(np.log2(max(size, 1e-300) / 0.25))))
    done = [
        [told(M) for M in _doubled(part, density, steps, halvings, terms)] for part, steps in parts
    ]
    Phi, Q = (np.concatenate(stack) for stack in zip(*done, strict=True))
    return Phi, Q


def _doubled(
    F: np.ndarray, density: np.ndarray, dt: np.ndarray, halvings: int, terms: int
) -> tuple[np.ndarray, np.ndarray]:
    """As ``discretised``, on a step so many times halved and then doubled again."""
    n = F.shape[-1]
    h = (dt / 2**halvings)[..., None, None]
    step = F * h
    Phi = np.broadcast_to(np.eye(n), step.shape).copy()
    term = Phi
    Q = np.zeros_like(step)
    part = np.broadcast_to(density[..., None] * np.eye(n), step.shape) * h
    for k in range(1, terms + 1):
        Q = Q + part
        term = step @ term / k
        Phi = Phi + term
        once = step @ part / (k + 1)
        part = once + np.swapaxes(once, -1, -2)
    for _ in range(halvings):
        Q = Q + Phi @ Q @ np.swapaxes(Phi, -1, -2)
        Phi = Phi @ Phi
    return Phi, 0.5 * (Q + np.swapaxes(Q, -1, -2))


def _stationary_spread(F: np.ndarray, density: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Covariances at the start ``(V, n, n)``: of the states ``at`` that of F P + P F^T +
    diag(density) = 0, zero where they are not stable.
    """
    start = np.zeros_like(F)
    block, n = F[:, at[:, None], at], len(at)
    if n == 0 or not np.all(np.linalg.eigvals(block).real < 0):
        return start
    eye = np.eye(n)
    # Row-major: (F P + P F^T)[i, j] = sum of (F[i, k] I[j, l] + I[i, k] F[j, l]) P[k, l].
    lyapunov = (
        block[:, :, None, :, None] * eye[:, None]
        + eye[:, None, :, None] * block[:, None, :, None, :]
    ).reshape(-1, n * n, n * n)
    force = (density[:, at, None] * eye).reshape(-1, n * n, 1)
    start[:, at[:, None], at] = np.linalg.solve(lyapunov, -force).reshape(-1, n, n)
    return start


# ---- A Kalman filter used as a linear pre-whitener of residuals and of every sensitivity
# column

_CHUNK = 64
_SETTLED = 1e-12  # relative change of the covariance over a chunk


@dataclass(frozen=True, eq=False)
class Whitener:
    """The filter of one record: gains and innovation covariances at the nodes ``0 .. K``.

    Per-node arrays end where the filter has settled: node k has entry ``at[k]``. ``covariance`` and
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
    """Gains for a process noise, measurement variances ``(m,)`` and validity ``(K + 1, m)`` of the
    samples at the nodes.

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
            combine_covariances, covariance_steps(motion.Phi, motion.Q, seen, variance), _CHUNK
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
    """Innovations of ``columns (K + 1, m, c)``; what stands at missing samples does not matter."""
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
    """Filtered covariances of a steady system until they no longer change, at most at ``nodes``
    nodes.
    """
    parts, P, done = [first[None]], first, 1
    while done < nodes:
        chunk = advanced(steps, P)
        parts.append(chunk)
        done += len(chunk)
        # rounding may leave it below zero where nothing is noisy
        size = np.sqrt(np.maximum(np.diag(chunk[-1]), 0.0))
        if np.all(np.abs(chunk[-1] - P) <= _SETTLED * np.outer(size, size)):
            break
        P = chunk[-1]
    return np.concatenate(parts)[:nodes]


def closed_loop(filter: Whitener) -> np.ndarray:
    """(I - K H) Phi from node k to k + 1, ``(K, n, n)``."""
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
    """What is kept until the filter has settled, at every node."""
    return stack if len(stack) == len(filter.at) else stack[filter.at]


def rows(stack: np.ndarray, part: slice) -> np.ndarray:
    """The matrices of some nodes; a single one stands for all."""
    return stack if len(stack) == 1 else stack[part]


def turned(M: np.ndarray) -> np.ndarray:
    """The transpose of each matrix."""
    return np.swapaxes(M, -1, -2)
