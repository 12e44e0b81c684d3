"""Process noise of a System along a trajectory: the linearised motion that it drives, in continuous
and discrete time.

Let x be the deviation of the states from the deterministic trajectory, and y that of the outputs.
Then x_dot = F x + w and y = H x, with F and H linearised about the trajectory, and white noise w
with the spectral density of the System. Only the n states that the noise reaches are kept. The
deviation of a state of the vehicle starts at zero, since its initial value is known or an unknown
of the fit. States of a noise effect start with their stationary covariance.

A sensor with a lag, delay or hold adds a state: see `_through_sensors`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.whole_record.record_problem import RecordProblem
from sim.declaration.model import System
from sim.maths import COMPLEX_STEP

_TAYLOR_TERMS = 14  # terms of the Taylor series of Phi and Q, for results exact to rounding
_DERIVATIVE_TERMS = 4  # terms for derivatives at many steps, exact to 1e-4 or better
_LARGEST_TAYLOR_STEP = 0.25  # longest step of the Taylor series, times the largest row sum of F
_LARGEST_BATCH = 16_000  # numbers processed together; more do not fit the processor's cache
# Chebyshev points that interpolate a function of the step to rounding, for steps within a factor
# of three
_CHEBYSHEV_POINTS = 14
_SHORTEST_MEMORY_SHARE = 0.2  # shortest time constant of a sensor, over the mean node interval
_EVEN_SAMPLING_TOLERANCE = 1e-9  # largest relative difference of even steps


@dataclass(frozen=True, eq=False)
class DiscretisedNoise:
    """Linear process noise over the nodes ``0 .. K`` of a record, with ``n`` states.

    The leading axis has length 1 where a matrix is constant over the record. Derivatives with
    respect to D quantities have a further axis D before the matrices.

    Attributes
    ----------
    Phi : ``(K, n, n)`` transition from node k to k + 1.
    Q : ``(K, n, n)`` covariance of the noise that this step adds.
    H : ``(K + 1, m, n)`` derivatives of the outputs with respect to the states, at the nodes.
    start : ``(n, n)`` covariance of the states at the first node.
    """

    Phi: np.ndarray
    Q: np.ndarray
    H: np.ndarray
    start: np.ndarray


@dataclass(frozen=True, eq=False)
class Variation:
    """Parameters at which the noise is evaluated.

    Attributes
    ----------
    p : ``(np,)`` all parameters.
    scale : factor on the standard deviation of declared process noise.
    """

    p: np.ndarray
    scale: float


# F, H, density, and a mask of the stationary states, as `linear_motion` returns them
LinearMotion = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
# function of matrices (K, V, n, n) whose result is kept in their place
Reduction = Callable[[np.ndarray], np.ndarray]


def discretised_noise(
    problem: RecordProblem, states: np.ndarray, at: Variation
) -> DiscretisedNoise:
    """Return the process noise about the trajectory ``states (nx, K + 1)``. It has n = 0 states
    where no white noise acts.
    """
    F, H, density, stationary = linear_motion(problem, states, [at])
    Phi, Q, start = discrete_motion(F, np.diff(problem.grid.nodes), density, stationary)
    return DiscretisedNoise(Phi[:, 0], Q[:, 0], H[:, 0], start[0])


def linear_motion(
    problem: RecordProblem, states: np.ndarray, variations: Sequence[Variation]
) -> LinearMotion:
    """Return the linear motion about the trajectory ``states (nx, K + 1)`` for V variations.

    Returns
    -------
    F : ``(B, V, n, n)`` in the middle of the intervals; B is 1 where a matrix is constant.
    H : ``(B, V, m, n)`` at the nodes.
    density : ``(V, n)`` spectral density of the white noise on each state.
    stationary : ``(n,)`` True where a state starts with its stationary covariance.

    The n states are those that the noise of the first variation reaches.
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
    F = _jacobians(system, system.f, _interval_middles(problem, states), variations)
    H = _jacobians(system, system.h, (nodes, states, _inputs(problem, nodes)), variations)
    kept = _states_reached(np.any(F[:, 0] != 0, axis=0), density[0] > 0)
    stationary = np.array([system.state_names[i] in system.stationary for i in kept])
    if len(kept) < len(states):
        F, H, density = F[..., kept[:, None], kept], H[..., kept], density[:, kept]
    return _through_sensors(problem, variations, (F, H, density, stationary))


def _through_sensors(
    problem: RecordProblem, variations: Sequence[Variation], motion: LinearMotion
) -> LinearMotion:
    """Return the motion with a further state for each sensor with a lag, delay or hold.

    A lag is exact. A delay, and the mean delay of a hold, is represented by Pade's approximation of
    first order. The deviation of a sensor state starts at zero. A time constant much shorter than a
    node interval is raised to a fifth of the interval. The motion is then not stiff, and the
    derivative at a time constant of zero stays finite.

    ``motion`` is the linear motion without sensors, for the V ``variations``.
    """
    memories = [problem.system.sensor_memory(variation.p.tolist()) for variation in variations]
    F, H, density, stationary = motion
    shortest = _SHORTEST_MEMORY_SHARE * float(np.mean(np.diff(problem.grid.nodes)))
    for k, memory in enumerate(memories[0]):
        row, n = memory.row, F.shape[-1]
        time = np.array(
            [float(variation_memories[k].time_constant) for variation_memories in memories]
        )
        rate = 1.0 / np.hypot(time, shortest)[:, None]
        at_middles = H[:, :, row] if len(H) == 1 else 0.5 * (H[:-1, :, row] + H[1:, :, row])
        steps = max(len(F), len(at_middles))
        wider_F = np.zeros((steps, F.shape[1], n + 1, n + 1))
        wider_F[..., :n, :n] = F
        wider_F[..., n, :n] = rate * at_middles
        wider_F[..., n, n] = -rate[:, 0]
        wider_H = np.concatenate([H, np.zeros((*H.shape[:-1], 1))], axis=-1)
        wider_H[:, :, row] *= memory.direct
        wider_H[:, :, row, n] = 1.0 - memory.direct
        F, H = wider_F, wider_H
        density = np.concatenate([density, np.zeros((len(density), 1))], axis=1)
        stationary = np.append(stationary, False)
    return F, H, density, stationary


def discrete_motion(
    F: np.ndarray,
    steps: np.ndarray,
    density: np.ndarray,
    stationary: np.ndarray,
    reduce: Reduction = np.asarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ``reduce(Phi)`` and ``reduce(Q)`` of the node intervals, and the covariance ``(V, n,
    n)`` at the start.

    Phi and Q are ``(K or 1, V, n, n)``. ``steps (K,)`` are the node intervals, s. The other
    arguments are as `linear_motion` returns them.
    """
    if F.shape[-1] == 0:
        return reduce(F), reduce(F), F[0]
    Phi, Q = _discretise_intervals(F, density, steps, reduce)
    return Phi, Q, _stationary_covariance(F[0], density, np.flatnonzero(stationary))


def _density(system: System, variation: Variation) -> np.ndarray:
    """Return the spectral density ``(nx,)`` of the white noise on each state."""
    declared = np.array(
        [system.declared_noise.process_density.get(name, 0.0) for name in system.state_names]
    )
    density = np.array(system.noise(variation.p.tolist())[0], dtype=float)
    return density + (variation.scale**2 - 1.0) * declared


def _inputs(problem: RecordProblem, times: np.ndarray) -> np.ndarray:
    """Return the recorded inputs ``(nu, len(times))``, interpolated at ``times``. The input path is
    left out, since lags of actuators hardly change the linearisation.
    """
    rows = problem.record.input_array(problem.system.input_names)
    return np.array([np.interp(times, problem.record.time, row) for row in rows]).reshape(
        len(rows), len(times)
    )


def _interval_middles(
    problem: RecordProblem, states: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, states and inputs in the middle of the node intervals."""
    nodes = problem.grid.nodes
    times = 0.5 * (nodes[:-1] + nodes[1:])
    return times, 0.5 * (states[:, :-1] + states[:, 1:]), _inputs(problem, times)


def _jacobians(
    system: System,
    function: Any,
    where: tuple[np.ndarray, np.ndarray, np.ndarray],
    variations: Sequence[Variation],
) -> np.ndarray:
    """Return the derivatives ``(B, V, rows, nx)`` of ``function`` with respect to the states.

    ``function`` is the right-hand side f or the output equation h of the System. ``where`` are the
    times ``(B,)``, states ``(nx, B)`` and inputs ``(nu, B)`` of the points. B is 1 where the
    derivatives are constant.
    """
    base = _jacobian(system, function, where, variations[:1])
    constant_to_rounding = 1e-13
    if np.all(np.ptp(base, axis=0) <= constant_to_rounding * np.max(np.abs(base), axis=0)):
        base, where = base[:1], (where[0][:1], where[1][:, :1], where[2][:, :1])
    return base if len(variations) == 1 else _jacobian(system, function, where, variations)


def _jacobian(
    system: System,
    function: Any,
    where: tuple[np.ndarray, np.ndarray, np.ndarray],
    variations: Sequence[Variation],
) -> np.ndarray:
    """Return the derivatives as `_jacobians` does, but at every time, by complex steps in each
    state. Times are the last axis of the arrays that are computed, for speed.
    """
    t, X, U = where
    n_x, values = len(X), np.array([variation.p for variation in variations])
    common = np.all(values == values[0], axis=0)
    p = [
        float(values[0, i]) if common[i] else values[:, i][:, None, None]
        for i in range(values.shape[1])
    ]
    batch, jacobian = max(1, _LARGEST_BATCH // (len(variations) * n_x)), None
    for k in range(0, len(t), batch):
        at = slice(k, k + batch)
        x = [np.repeat(row[None, None, at].astype(complex), n_x, axis=1) for row in X]
        for i in range(n_x):
            x[i][:, i] += 1j * COMPLEX_STEP
        slopes = function(t[at], x, list(U[:, at]), p)
        if jacobian is None:
            jacobian = np.empty((len(t), len(variations), len(slopes), n_x))
        for i, row in enumerate(slopes):
            slope = np.broadcast_to(np.imag(row), (len(variations), n_x, len(t[at])))
            by_time = slope.transpose(2, 0, 1)
            np.divide(by_time, COMPLEX_STEP, out=jacobian[at, :, i])
    assert jacobian is not None
    return jacobian


def _states_reached(coupled: np.ndarray, forced: np.ndarray) -> np.ndarray:
    """Return the positions of the states that the noise reaches.

    ``coupled (nx, nx)`` is True where the rate of the first state depends on the second one, and
    ``forced (nx,)`` where white noise acts on a state.
    """
    reached = forced.copy()
    for _ in range(len(reached)):
        reached = reached | np.any(coupled & reached, axis=1)
    return np.flatnonzero(reached)


def _discretise_intervals(
    F: np.ndarray, density: np.ndarray, steps: np.ndarray, reduce: Reduction
) -> tuple[np.ndarray, np.ndarray]:
    """Return ``reduce(Phi)`` and ``reduce(Q)`` of the node intervals ``steps (K,)``, from ``F (K or
    1, V, n, n)`` and ``density (V, n)``.

    Phi and Q are computed once for equal intervals with equal F.
    """
    low, high = float(steps.min()), float(steps.max())
    even = high - low <= _EVEN_SAMPLING_TOLERANCE * high
    if len(F) > 1:
        steps = np.full(len(steps), steps.mean()) if even else steps
        first, number = _distinct_rows(
            np.concatenate([F[:, 0].reshape(len(F), -1), steps[:, None]], axis=1)
        )
        if len(first) < len(F):  # else all steps differ already in the first variation
            first, number = _distinct_rows(
                np.concatenate([F.reshape(len(F), -1), steps[:, None]], axis=1)
            )
        chosen = slice(None) if len(first) == len(F) else first
        Phi, Q = discretise(
            F[chosen],
            density,
            steps[chosen, None],
            _TAYLOR_TERMS if F.shape[1] == 1 else _DERIVATIVE_TERMS,
            reduce,
        )
        return (Phi, Q) if len(first) == len(F) else (Phi[number], Q[number])
    if even:
        return discretise(F, density, np.full((1, 1), steps.mean()), reduce=reduce)
    # With one F and many steps, the result is a smooth function of the step: interpolate it.
    angle = np.pi * (np.arange(_CHEBYSHEV_POINTS) + 0.5) / _CHEBYSHEV_POINTS
    points = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(angle)
    weights = _interpolation_weights(
        points, (-1.0) ** np.arange(_CHEBYSHEV_POINTS) * np.sin(angle), steps
    )
    Phi, Q = discretise(
        np.broadcast_to(F, (_CHEBYSHEV_POINTS, *F.shape[1:])),
        density,
        points[:, None],
        reduce=reduce,
    )
    return np.tensordot(weights, Phi, 1), np.tensordot(weights, Q, 1)


def _distinct_rows(rows: np.ndarray) -> tuple[list[int], list[int]]:
    """Return the first position of each distinct row of ``rows (K, c)``, and for every row the
    number of its distinct row.

    Dead bands and limits change F at a few steps only, so that most rows are equal.
    """
    number_of: dict[bytes, int] = {}
    first: list[int] = []
    numbers = []
    for k, row in enumerate(np.ascontiguousarray(rows)):
        number = number_of.setdefault(row.tobytes(), len(first))
        if number == len(first):
            first.append(k)
        numbers.append(number)
    return first, numbers


def _interpolation_weights(points: np.ndarray, weights: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the weights ``(len(at), len(points))`` that interpolate values at ``points`` to the
    places ``at``, by the barycentric formula. ``weights`` are the barycentric weights of the
    points.
    """
    distance = at[:, None] - points
    exact = distance == 0
    share = weights / np.where(exact, 1.0, distance)
    share = np.where(np.any(exact, axis=1)[:, None], exact, share)
    return share / share.sum(axis=1, keepdims=True)


def discretise(
    F: np.ndarray,
    density: np.ndarray,
    dt: np.ndarray,
    terms: int = _TAYLOR_TERMS,
    reduce: Reduction = np.asarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return Phi = exp(F dt), and Q, the integral of exp(F s) diag(density) exp(F s)^T over a step.

    Taylor series give Phi, and the solution Q of Q_dot = F Q + Q F^T + diag(density), for a short
    step. The step is then doubled until it has its full length.

    Parameters
    ----------
    F : ``(K, ..., n, n)``.
    density : ``(..., n)``.
    dt : ``(K, ...)`` steps, s.
    terms : terms of the Taylor series; the default is exact to rounding.
    reduce : function of Phi and of Q for a batch of steps; its results are returned in their place.
    """
    batch = max(1, _LARGEST_BATCH // max(1, F[0].size))
    parts = [(F[k : k + batch], dt[k : k + batch]) for k in range(0, len(F), batch)]
    size = max(
        float(np.max(np.sum(np.abs(part), axis=-1).max(axis=-1) * steps, initial=0.0))
        for part, steps in parts
    )
    halvings = max(0, int(np.ceil(np.log2(max(size, 1e-300) / _LARGEST_TAYLOR_STEP))))
    reduced = [
        [reduce(M) for M in _by_doubling(part, density, steps, halvings, terms)]
        for part, steps in parts
    ]
    Phi, Q = (np.concatenate(stack) for stack in zip(*reduced, strict=True))
    return Phi, Q


def _by_doubling(
    F: np.ndarray, density: np.ndarray, dt: np.ndarray, halvings: int, terms: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return Phi and Q as `discretise` does, by a Taylor series of ``terms`` terms for the step
    halved ``halvings`` times, which is then doubled as often.
    """
    n = F.shape[-1]
    h = (dt / 2**halvings)[..., None, None]
    step = F * h
    Phi = np.broadcast_to(np.eye(n), step.shape).copy()
    Phi_term = Phi
    Q = np.zeros_like(step)
    Q_term = np.broadcast_to(density[..., None] * np.eye(n), step.shape) * h
    for k in range(1, terms + 1):
        Q = Q + Q_term
        Phi_term = step @ Phi_term / k
        Phi = Phi + Phi_term
        product = step @ Q_term / (k + 1)
        Q_term = product + np.swapaxes(product, -1, -2)
    for _ in range(halvings):
        Q = Q + Phi @ Q @ np.swapaxes(Phi, -1, -2)
        Phi = Phi @ Phi
    return Phi, 0.5 * (Q + np.swapaxes(Q, -1, -2))


def _stationary_covariance(F: np.ndarray, density: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the covariances ``(V, n, n)`` of the states at the start.

    The covariance P of the stationary states, at the positions ``at``, solves F P + P F^T +
    diag(density) = 0. It is zero where F is not stable, and for all other states.
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
