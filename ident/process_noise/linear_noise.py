"""Process noise of a System along a trajectory: linear motion about it, in continuous and discrete
time.

States that white noise reaches deviate from the deterministic trajectory as x_dot = F x + w, y = H
x, with F and H linearised there and w of the System's spectral density. Only those states are kept.
A free initial state is an unknown of the fit, so its deviation starts at zero; states of a noise
effect start from their stationary spread.

A sensor with a lag, delay or hold adds a state: see ``_through_sensors``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.whole_record.record_problem import RecordProblem
from sim.declaration.model import System
from sim.maths import COMPLEX_STEP

_TAYLOR_TERMS = 14  # terms of a Taylor series that is exact to rounding
_DERIVATIVE_TERMS = 4  # the same for derivatives at each step, exact to 1e-4 or better
_LARGEST_BATCH = 16_000  # numbers processed together; more do not fit the processor's cache
# Chebyshev points for a smooth function of step sizes within a factor of three, exact to rounding
_CHEBYSHEV_POINTS = 14
_SHORTEST_MEMORY_SHARE = 0.2  # shortest time constant of a sensor, in sub-steps


@dataclass(frozen=True, eq=False)
class DiscretisedNoise:
    """Linear process noise over the nodes ``0 .. K`` of a record, ``n`` states.

    ``Phi``, ``Q`` ``(K, n, n)`` are for the step from node k to k + 1; ``H (K + 1, m, n)``; ``start
    (n, n)``. The leading axis has length 1 where nothing changes over the record. In derivatives by
    D quantities a further axis D precedes the matrices.
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


LinearMotion = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
NoiseReport = Callable[[np.ndarray], np.ndarray]


def discretised_noise(
    problem: RecordProblem, states: np.ndarray, at: Variation
) -> DiscretisedNoise:
    """Return the process noise about ``states (nx, K + 1)``; it has no states if white noise acts
    on none.
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
    kept = _states_reached(np.any(F[:, 0] != 0, axis=0), density[0] > 0)
    stationary = np.array([system.state_names[i] in system.stationary for i in kept])
    if len(kept) < len(states):
        F, H, density = F[..., kept[:, None], kept], H[..., kept], density[:, kept]
    return _through_sensors(problem, variations, (F, H, density, stationary))


def _through_sensors(
    problem: RecordProblem, variations: Sequence[Variation], motion: LinearMotion
) -> LinearMotion:
    """Return the motion with a state added for each sensor with a lag, delay or hold.

    A lag is exact; a delay, and a hold in the mean, is Pade's approximation of first order. The
    deviation of a sensor starts at zero. Times much shorter than a sub-step are lengthened to a
    fifth of it, which keeps the motion from being stiff and the slope at zero finite.

    Parameters
    ----------
    variations : V sets of parameters.
    motion : F ``(B, V, n, n)``, H ``(B, V, m, n)``, density ``(V, n)`` and which states are
        stationary, without sensors.
    """
    memories = [problem.system.sensor_memory(variation.p.tolist()) for variation in variations]
    F, H, density, stationary = motion
    shortest = _SHORTEST_MEMORY_SHARE * float(np.mean(np.diff(problem.grid.nodes)))
    for k, memory in enumerate(memories[0]):
        row, n = memory.row, F.shape[-1]
        time = np.array([float(each[k].time_constant) for each in memories])
        rate = 1.0 / np.hypot(time, shortest)[:, None]
        at_middles = H[:, :, row] if len(H) == 1 else 0.5 * (H[:-1, :, row] + H[1:, :, row])
        steps = max(len(F), len(at_middles))
        wider = np.zeros((steps, F.shape[1], n + 1, n + 1))
        wider[..., :n, :n] = F
        wider[..., n, :n] = rate * at_middles
        wider[..., n, n] = -rate[:, 0]
        seen = np.concatenate([H, np.zeros((*H.shape[:-1], 1))], axis=-1)
        seen[:, :, row] *= memory.direct
        seen[:, :, row, n] = 1.0 - memory.direct
        F, H = wider, seen
        density = np.concatenate([density, np.zeros((len(density), 1))], axis=1)
        stationary = np.append(stationary, False)
    return F, H, density, stationary


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
    """Return the recorded inputs ``(nu, len(times))``; lags of actuators hardly change the
    linearisation.
    """
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
    # Complex steps, one column a state. Times are the last axis, for speed.
    t, X, U = where
    n_x, values = len(X), np.array([variation.p for variation in variations])
    same = np.all(values == values[0], axis=0)
    p = [
        float(values[0, i]) if same[i] else values[:, i][:, None, None]
        for i in range(values.shape[1])
    ]
    rows, out = max(1, _LARGEST_BATCH // (len(variations) * n_x)), None
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


def _states_reached(coupled: np.ndarray, forced: np.ndarray) -> np.ndarray:
    """Return the positions of the states that the noise reaches through the couplings
    ``(nx, nx)``.
    """
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
        if len(at) < len(F):  # else the other arrays differ as well
            at, back = _distinct(np.concatenate([F.reshape(len(F), -1), steps[:, None]], axis=1))
        some = slice(None) if len(at) == len(F) else at
        Phi, Q = discretised(
            F[some],
            density,
            steps[some, None],
            _TAYLOR_TERMS if F.shape[1] == 1 else _DERIVATIVE_TERMS,
            told,
        )
        return (Phi, Q) if len(at) == len(F) else (Phi[back], Q[back])
    if even:
        return discretised(F, density, np.full((1, 1), steps.mean()), told=told)
    # One F and many steps: the result is a smooth function of the step.
    angle = np.pi * (np.arange(_CHEBYSHEV_POINTS) + 0.5) / _CHEBYSHEV_POINTS
    knots = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(angle)
    share = _barycentric(knots, (-1.0) ** np.arange(_CHEBYSHEV_POINTS) * np.sin(angle), steps)
    Phi, Q = discretised(
        np.broadcast_to(F, (_CHEBYSHEV_POINTS, *F.shape[1:])), density, knots[:, None], told=told
    )
    return np.tensordot(share, Phi, 1), np.tensordot(share, Q, 1)


def _distinct(rows: np.ndarray) -> tuple[list[int], list[int]]:
    """Return the first position of each distinct row of ``rows (K, c)``, and the index of its
    distinct row for every row.

    Dead bands and limits change F at few inputs: most steps are equal.
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
    terms: int = _TAYLOR_TERMS,
    told: NoiseReport = np.asarray,
) -> tuple[np.ndarray, np.ndarray]:
    """exp(F dt) and the integral of exp(F s) diag(density) exp(F s)^T over the step, both to
    rounding.

    Shapes ``(K, ..., n, n)``, ``(..., n)``, ``(K, ...)``. Taylor series of Phi and of the solution
    of Q_dot = F Q + Q F^T + diag(density) on a short step, then doubling. ``told`` of each part is
    put together, else all of it.
    """
    rows = max(1, _LARGEST_BATCH // max(1, F[0].size))
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
    """Return the same as ``discretised``, for a step that is halved and doubled again ``halvings``
    times.
    """
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
    """Return the covariances at the start ``(V, n, n)``: of the states ``at`` that of F P + P F^T +
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
