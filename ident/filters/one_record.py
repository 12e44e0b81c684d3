"""One pass of the extended Kalman filter over one record, with transition matrices and process
noise.

The fundamental matrix Phi is the Taylor series of exp(F T) or the matrix exponential. The process
noise Q_k is the integral of Phi(tau) Q Phi(tau)^T over the step, in closed form. They are eqs. 8
and 13 of the simulated-flight-data paper.

The filter equals the one by filterpy in `ident.filters.ekf`. It makes Joseph's update in two
products. Let G = [H, -I, y], and let W have the blocks P and R on its diagonal. Then G W gives H P
and S, and the updated P is B W B^T with B = [I - K H, K]. The results are written into arrays,
which are checked once at the end.

For these small matrices a call takes longer than its arithmetic. Therefore one product of a table
with w = (1, states, parameters, inputs) gives all terms that are linear in w: the Jacobian, the
matrices whose products with w are the values, and the factors of the Runge-Kutta step and of the
fundamental matrix.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np

from ident.bilinear_table import Bilinear, constant_within_steps, system_tables
from ident.filters.problem import FilterBuffers, FilterProblem
from sim.propagation import Step, euler_step, rk4_step

# ---- Fundamental matrix and discrete process noise over one step

RowTransition = Callable[[np.ndarray, float], tuple[np.ndarray, np.ndarray | None]]


class Transition(Protocol):
    """Function that returns the fundamental matrix ``Phi`` and the process noise ``Q_k`` of a step,
    from ``F (..., n, n)``, the spectral density ``(n,)`` and the step (s).

    ``of_rows`` is for batches of matrices F whose rows below the first r are zero. It returns a
    function of these rows ``(..., r, n)`` and the step. That function returns the first r rows of
    ``Phi - I`` and of ``Q_k``. The rows of Q_k have only r columns where all further ones are zero,
    and Q_k is None without noise. Below these rows Phi is the identity and Q_k is diag(density) dt.
    """

    def __call__(
        self, F: np.ndarray, density: np.ndarray, dt: float
    ) -> tuple[np.ndarray, np.ndarray]: ...
    def of_rows(self, r: int, density: np.ndarray) -> RowTransition: ...


@dataclass(frozen=True)
class Taylor:
    """Taylor series with ``terms`` terms: 2 gives I + F T, 3 adds F^2 T^2 / 2, and so on."""

    terms: int = 2

    def __call__(
        self, F: np.ndarray, density: np.ndarray, dt: float
    ) -> tuple[np.ndarray, np.ndarray]:
        powers = [np.broadcast_to(np.eye(F.shape[-1]), F.shape)]
        for k in range(1, self.terms):
            powers.append(powers[-1] @ F / k)
        Phi = sum(power * dt**k for k, power in enumerate(powers))
        noise = np.zeros_like(F)
        if np.any(density):
            Q = np.diag(density)
            for i, left in enumerate(powers):
                for j, right in enumerate(powers):
                    noise = noise + left @ Q @ np.swapaxes(right, -1, -2) * (
                        dt ** (i + j + 1) / (i + j + 1)
                    )
        return np.asarray(Phi), noise

    def of_rows(self, r: int, density: np.ndarray) -> RowTransition:
        terms, noise_of = self.terms, series_noise(r, density, self.terms)

        def rows(F: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray | None]:
            if terms < 2:
                return np.zeros_like(F), noise_of([], F, dt)
            A, powers = F[..., :r], [F * dt]
            for k in range(2, terms):
                powers.append(A @ powers[-1] * (dt / k))
            return sum(powers[1:], powers[0]), noise_of(powers, F, dt)

        return rows


def series_noise(
    r: int, density: np.ndarray, terms: int
) -> Callable[[list[np.ndarray], np.ndarray, float], np.ndarray | None]:
    """Return a function that computes the first r rows of Q_k for a Taylor series of Phi.

    The series is ``Phi = I + M_1 + ...`` with ``terms`` terms, M_k = F^k dt^k / k!. F is zero below
    its first r rows. The function takes the first r rows ``(..., r, n)`` of the M_k, an array of
    the same shape (from which the shape of the result is taken), and the step (s). It returns None
    without process noise.
    """
    driven = np.flatnonzero(density)
    # parameters with a random walk are driven below the first r rows
    walking, width, walks = driven >= r, driven.size, bool(np.any(driven >= r))
    # There is usually one driven entry: a slice is faster than an index array.
    chosen = slice(driven[0], driven[0] + 1) if width == 1 else driven
    identity = np.eye(r, len(density))[:, driven]
    # With M_0 = I, Q_k = sum over i, j of M_i Q M_j^T dt / (i + j + 1).
    order = np.arange(terms)
    weights = np.kron(1.0 / (order[:, None] + order + 1.0), np.diag(density[driven]))

    def noise_of(powers: list[np.ndarray], like: np.ndarray, dt: float) -> np.ndarray | None:
        if width == 0:
            return None
        columns = np.empty((*like.shape[:-1], terms * width))
        columns[..., :width] = identity
        for k, M in enumerate(powers, start=1):
            columns[..., k * width : (k + 1) * width] = M[..., chosen]
        weighted = columns @ (weights * dt)
        noise_states = weighted @ np.swapaxes(columns, -1, -2)
        if not walks:
            return np.asarray(noise_states)
        noise = np.zeros((*like.shape[:-1], len(density)))
        noise[..., :r] = noise_states
        noise[..., driven[walking]] = weighted[..., :width][..., walking]
        return noise

    return noise_of


@dataclass(frozen=True)
class Exponential:
    """Matrix exponential, with the noise by Van Loan's block exponential (IEEE Trans. Automatic
    Control 23(3), 1978).
    """

    def __call__(
        self, F: np.ndarray, density: np.ndarray, dt: float
    ) -> tuple[np.ndarray, np.ndarray]:
        from scipy.linalg import expm

        n = F.shape[-1]
        if not np.any(density):
            return expm(F * dt), np.zeros_like(F)
        block = np.zeros((*F.shape[:-2], 2 * n, 2 * n))
        block[..., :n, :n] = -F
        block[..., :n, n:] = np.diag(density)
        block[..., n:, n:] = np.swapaxes(F, -1, -2)
        both = expm(block * dt)
        Phi = np.swapaxes(both[..., n:, n:], -1, -2)
        noise = Phi @ both[..., :n, n:]
        return Phi, 0.5 * (noise + np.swapaxes(noise, -1, -2))

    def of_rows(self, r: int, density: np.ndarray) -> RowTransition:
        def rows(F: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray | None]:
            n = F.shape[-1]
            whole = np.zeros((*F.shape[:-2], n, n))
            whole[..., :r, :] = F
            Phi, noise = self(whole, density, dt)
            return Phi[..., :r, :] - np.eye(r, n), noise[..., :r, :] if np.any(density) else None

        return rows


def log_gaussian(y: np.ndarray, S: np.ndarray) -> tuple[float, float]:
    """Return the log density of an innovation ``y (m,)`` with covariance ``S (m, m)``, and its
    normalised square.

    Raises
    ------
    numpy.linalg.LinAlgError : where ``S`` is not positive definite.
    """
    from scipy.linalg.lapack import dposv

    root, weighted, failed = dposv(S, y)
    if failed:
        raise np.linalg.LinAlgError("the covariance of an innovation is not positive definite")
    nis = float(y @ weighted.ravel())
    half_log_determinant = sum(map(math.log, root.diagonal().tolist()))
    return -0.5 * (nis + len(y) * math.log(2.0 * math.pi)) - half_log_determinant, nis


# ---- One pass of the extended Kalman filter over one record


@dataclass(frozen=True, eq=False)
class FilterEquations:
    """Equations of one filter with n_x states, n states and free parameters together, and m
    outputs.

    Attributes
    ----------
    point : ``(n,)`` the point of linearisation.
    propagate : function of a sub-step ``s`` and an array. It propagates the states of the point
        over the sub-step in place, writes the state rows ``(n_x, n)`` of the fundamental matrix
        into the array, and returns Q_k ``(n, n)``, or None without process noise.
    observe : function of a sample ``k`` and an array. It writes the outputs ``(m,)`` at the point
        into the array and, where ``varying``, their Jacobian into ``G``.
    G : ``(m, n + m + 1)`` Jacobian of the outputs, minus the unit matrix, and a column for the
        innovation.
    varying : whether the Jacobian of the outputs changes.
    """

    point: np.ndarray
    propagate: Callable[[int, np.ndarray], np.ndarray | None]
    observe: Callable[[int, np.ndarray], None]
    G: np.ndarray
    varying: bool


def filter_one(
    problem: FilterProblem,
    equations: FilterEquations,
    start: np.ndarray,
    nominal: np.ndarray | None,
    buffers: FilterBuffers,
) -> bool:
    """Filter a record, write the results into ``buffers``, and return whether it succeeded.

    Parameters
    ----------
    start : ``(n,)`` mean before the first sample.
    nominal : ``(n, N)`` trajectory at the samples about which the filter is linearised; None takes
        the estimate of the filter.

    Returns
    -------
    False where the covariance of an innovation is not positive definite. Other results may be
    infinite or NaN: the caller checks them.
    """
    from scipy.linalg.lapack import dposv

    point, observe, G = equations.point, equations.observe, equations.G
    varying, dot, subtract = equations.varying, np.dot, np.subtract
    m, n = len(G), len(point)
    predict = _prediction(problem, equations, nominal, buffers.transition)
    point[:] = start
    x = point if nominal is None else start.copy()
    W = np.zeros((n + m + 1, n + m + 1))
    noise = np.arange(n, n + m)
    W[noise, noise] = problem.variance
    W_P, G_transposed, H, y, GW = W[:n, :n], G.T, G[:, :n], G[:, -1], np.empty_like(G)
    # Whole matrices are multiplied, since BLAS copies parts of matrices. K G is in the first n rows
    # of a product whose other rows are not used.
    GW_transposed, product, BW = GW.T, np.empty_like(W), np.empty((n, n + m + 1))
    unit = np.eye(n, n + m + 1)
    B = product[:n]
    B_transposed, B_last = B.T, B[:, -1]
    missing = {
        k: np.flatnonzero(~problem.valid[:, k])
        for k in np.flatnonzero(~problem.valid.all(axis=0)).tolist()
    }
    z = np.where(problem.valid, problem.z, 0.0).T.copy()
    P = problem.covariance
    predictions = zip(buffers.predicted_mean, buffers.predicted_covariance, strict=True)
    updates = zip(buffers.mean, buffers.covariance, strict=True)
    samples = zip(predictions, updates, buffers.S, buffers.outputs, z, strict=True)
    for k, ((x_before, P_before), (mean, P_after), S, expected, measured) in enumerate(samples):
        if k:
            predict(k, x, P, P_before)
        else:
            P_before[:] = P
        x_before[:] = x
        if nominal is not None:
            point[:] = nominal[:, k]
        observe(k, expected)
        if nominal is not None:
            expected += H @ (x - point)
        subtract(measured, expected, y)
        missing_channels = missing.get(k)
        full_G = None if missing_channels is None else _neutralise_channels(missing_channels, G, W)
        if varying:
            buffers.sensitivity[k] = H
        W_P[:] = P_before
        dot(G, W, GW)
        dot(GW, G_transposed, S)
        _, S_G, failed = dposv(S, G)
        if failed:
            return False
        dot(GW_transposed, S_G, product)
        subtract(unit, B, B)
        dot(B, W, BW)
        dot(BW, B_transposed, P_after)
        subtract(x, B_last, mean)
        x[:], P = mean, P_after
        if full_G is not None:
            G[:], W[noise, noise] = full_G, problem.variance
    buffers.innovation[:] = np.where(problem.valid.T, z - buffers.outputs, 0.0)
    if not varying:
        buffers.sensitivity[:] = H * problem.valid.T[:, :, None]
    return True


def _neutralise_channels(absent: np.ndarray, G: np.ndarray, W: np.ndarray) -> np.ndarray:
    """Remove the channels ``absent`` from an update in place: a zero Jacobian and innovation, and a
    one in S. Return a copy of ``G`` from before.
    """
    n, full_G = len(W) - len(G) - 1, G.copy()
    G[absent, :n] = G[absent, -1] = 0.0
    W[n + absent, n + absent] = 1.0
    return full_G


def _prediction(
    problem: FilterProblem,
    equations: FilterEquations,
    nominal: np.ndarray | None,
    transition: np.ndarray,
) -> Callable[[int, np.ndarray, np.ndarray, np.ndarray], None]:
    """Return the function that propagates mean and covariance over the sub-steps to sample k. It
    also writes the fundamental matrix of the interval into ``transition (N, n, n)``.
    """
    propagate, point, n = equations.propagate, equations.point, len(problem.names)
    n_x, dot = len(problem.system.states), np.dot
    ends, half, further = problem.grid.sample.tolist(), np.empty((n, n)), np.eye(n)
    state_rows, matrices = list(transition[:, :n_x]), list(transition)
    transposed, further_rows = list(transition.transpose(0, 2, 1)), further[:n_x]

    def predict(k: int, x: np.ndarray, P: np.ndarray, P_before: np.ndarray) -> None:
        if nominal is not None:
            point[:] = nominal[:, k - 1]
        first_step = ends[k - 1]
        for s in range(first_step, ends[k]):
            rows, step, step_transposed = (
                (state_rows[k], matrices[k], transposed[k])
                if s == first_step
                else (further_rows, further, further.T)
            )
            deviation = None if nominal is None else x - point
            noise = propagate(s, rows)
            if deviation is not None:
                x[:] = point + step @ deviation
            dot(step, P, half)
            dot(half, step_transposed, P_before)
            if noise is not None:
                np.add(P_before, noise, P_before)
            if s != first_step:
                matrices[k][:] = further @ matrices[k]
            P = P_before

    return predict


# ---- The equations of a filter of one record, from their table

Noise = Callable[[float], np.ndarray]  # function of the step, s, that returns Q_k
_ORDERS = {rk4_step: 4, euler_step: 1}  # order of each integrator with a closed form here
_TERMS = {Taylor(2): 2, Taylor(3): 3}  # terms of each transition with a closed form here


def table_equations(
    problem: FilterProblem, step: Step, transition: Transition
) -> FilterEquations | None:
    """Return the equations from their table; None where they are not bilinear, an input changes
    within a step, or the integrator or the transition has no closed form here.
    """
    if step not in _ORDERS or transition not in _TERMS or not constant_within_steps(problem.drive):
        return None
    result = system_tables(problem.system, problem.p)
    if result is None:
        return None
    f, h = result
    w = np.zeros(len(f.table))
    w[0] = 1.0
    propagate = _propagation(f, w, problem, _ORDERS[step], _TERMS[transition])
    observe, G, varying = _outputs(h, w, problem)
    return FilterEquations(w[1 : 1 + f.n], propagate, observe, G, varying)


def _propagation(
    f: Bilinear, w: np.ndarray, problem: FilterProblem, steps: int, terms: int
) -> Callable[[int, np.ndarray], np.ndarray | None]:
    """Return ``FilterEquations.move``, which moves the states in ``w`` by an integrator of order
    ``steps``, with ``terms`` Taylor terms of the fundamental matrix.
    """
    width, n, n_x = len(w), f.n, len(problem.system.states)
    coefficients = f.table.reshape(width, n_x, n + width)
    slopes, halves, A = coefficients[:, :, :n], coefficients[:, :, n:], coefficients[:, :, :n_x]
    zero, identity = np.zeros((width, n_x, n_x)), np.zeros((width, n_x, n_x))
    identity[0] = np.eye(n_x)
    # Each block is a pair: terms that are multiplied by the step, and terms that are not. The
    # product of the last block but one with [F; I] is Phi.
    half = (0.5 * A, identity) if terms > 2 else (zero, identity)
    blocks = [
        ([[halves]], [[0.0 * halves]]),
        *_stages(A, zero, identity, steps),
        ([[half[0], zero]], [[half[1], identity]]),
        ([[slopes]], [[0.0 * slopes]]),
    ]
    per_step, constant = (
        np.concatenate([np.block(pair[i]).reshape(width, -1) for pair in blocks], axis=1)
        for i in (0, 1)
    )
    shapes = [np.block(pair[0]).shape[1:] for pair in blocks]
    ends = np.cumsum([0, *(rows * columns for rows, columns in shapes)]).tolist()
    workspace = np.concatenate([np.zeros(ends[-1]), np.eye(n_x, n).ravel()])
    of_values, *stages, blend, F = (
        workspace[a:b].reshape(shape) for (a, b), shape in zip(pairwise(ends), shapes, strict=True)
    )
    product, F_on_one = workspace[: ends[-1]], workspace[ends[-2] :].reshape(2 * n_x, n)
    states, table, sizes = w[1 : 1 + n_x], np.empty_like(constant), problem.grid.steps.tolist()
    values = np.zeros(n_x)
    stages_with_results = [(stage, np.zeros(len(stage))) for stage in stages]
    change = stages_with_results[-1][1] if stages_with_results else values
    write_inputs = _input_writer(w, f.n, problem.drive.stages[0])
    noise_of, prepared_dt, dot = _noise(problem, blend[:, :n_x], F, terms), 0.0, np.dot
    add = np.add

    def propagate(s: int, rows: np.ndarray) -> np.ndarray | None:
        nonlocal prepared_dt
        dt = sizes[s]
        if dt != prepared_dt:
            np.multiply(per_step, dt, out=table)
            add(table, constant, out=table)
            prepared_dt = dt
        write_inputs(s)
        dot(w, table, product)
        dot(of_values, w, values)
        last = values
        for stage, result in stages_with_results:
            dot(stage, last, result)
            last = result
        add(states, change, states)
        dot(blend, F_on_one, rows)
        return None if noise_of is None else noise_of(dt)

    return propagate


def _stages(
    A: np.ndarray, zero: np.ndarray, identity: np.ndarray, steps: int
) -> list[tuple[list[list[np.ndarray]], list[list[np.ndarray]]]]:
    """Return the blocks of the matrices that lead from f to the Runge-Kutta change of the states,
    (I + A/2 (I + A/3 (I + A/4))) f for order 4; none for order 1. Each block is a pair, as in
    `_propagation`.
    """
    if steps == 1:
        return []
    inner = [
        ([[A / k, zero], [zero, zero]], [[zero, identity], [zero, identity]])
        for k in range(steps - 1, 2, -1)
    ]
    return [
        ([[A / steps], [zero]], [[identity], [identity]]),
        *inner,
        ([[0.5 * A, zero]], [[zero, identity]]),
    ]


def _input_writer(w: np.ndarray, n: int, rows: Sequence[np.ndarray]) -> Callable[[int], None]:
    """Return the function that writes the inputs of a step into ``w``, after 1 + ``n`` entries."""
    inputs = w[1 + n :]
    if not len(inputs):
        return lambda s: None
    if len(inputs) == 1:
        values, last = np.asarray(rows[0]).tolist(), len(w) - 1

        def write_one(s: int) -> None:
            w[last] = values[s]

        return write_one
    u = np.stack(list(rows), axis=1)

    def write_all(s: int) -> None:
        inputs[:] = u[s]

    return write_all


def _noise(
    problem: FilterProblem, half: np.ndarray, slopes: np.ndarray, terms: int
) -> Noise | None:
    """Return the function that computes Q_k of the last step; None without process noise.

    Q_k is the sum over i, j of M_i Q M_j^T dt / (i + j + 1), with M_i the terms of Phi. ``half
    (n_x, n_x)`` is I + A/2 and ``slopes (n_x, n)`` is F, with A and F times the step.
    """
    driven, order = np.flatnonzero(problem.density), np.arange(terms)
    if not driven.size:
        return None
    n, n_x, d = len(problem.density), len(half), driven.size
    weights = np.kron(1.0 / (order[:, None] + order + 1.0), np.diag(problem.density[driven]))
    columns = np.zeros((n, terms * d))
    columns[:, :d] = np.eye(n)[:, driven]

    def noise_of(dt: float) -> np.ndarray:
        F = slopes[:, driven]
        columns[:n_x, d : 2 * d] = F
        if terms > 2:
            columns[:n_x, 2 * d :] = (half - np.eye(n_x)) @ F
        return np.asarray(columns @ (weights * dt) @ columns.T)

    return noise_of


def _outputs(
    h: Bilinear, w: np.ndarray, problem: FilterProblem
) -> tuple[Callable[[int, np.ndarray], None], np.ndarray, bool]:
    """Return ``observe``, ``G`` and ``varying`` of `FilterEquations`."""
    width, n, m = len(w), h.n, len(problem.variance)
    coefficients = h.table.reshape(width, m, n + width)
    constant_columns = np.zeros((width, m, m + 1))
    constant_columns[0, :, :m] = -np.eye(m)
    blocks = [
        np.concatenate([coefficients[:, :, :n], constant_columns], axis=2),
        coefficients[:, :, n:],
    ]
    table = np.concatenate([block.reshape(width, -1) for block in blocks], axis=1)
    product, size = table[0].copy(), m * (n + m + 1)
    G, of_values = product[:size].reshape(m, -1), product[size:].reshape(m, width)
    varying, dot = bool(np.any(table[1:])), np.dot
    write_inputs = (
        _input_writer(w, n, [row[problem.grid.sample] for row in problem.drive.begin])
        if h.feeds_through
        else None
    )

    def observe(k: int, expected: np.ndarray) -> None:
        if write_inputs is not None:
            write_inputs(k)
        if varying:
            dot(w, table, product)
        dot(of_values, w, expected)

    return observe, G, varying
