"""One pass of the extended Kalman filter over one record, with transition matrices and process
noise.

Eq. 8 of the simulated-flight-data paper (Taylor series of exp(F T)) and its eq. 13, Q_k = integral
over the step of Phi(tau) Q Phi(tau)^T, solved in closed form for each choice.

The filter equals filterpy's in `ident.filters.ekf`, with Joseph's update in two products: with G =
[H, -I, y] and W of P and R side by side, H P and S come from G W, and P becomes B W B^T with B = [I
- K H, K]. Results are written into the history, which is checked once at the end.

For such small matrices a call costs more than its arithmetic. So one table, times w = (1, states,
parameters, inputs), gives all terms that are linear in w: the
Jacobian, the matrices whose products with w are the values, the factors of the Runge-Kutta step and
of the fundamental matrix.
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
    """Maps ``F (..., n, n)``, the diagonal of the spectral density ``(n,)`` and the step (s) to
    ``Phi``, ``Q_k``.

    ``of_rows`` is for batches in which F ``(..., r, n)`` are the first r rows of a matrix, all
    others zero. It returns a function of F and the step that gives the first r rows of ``Phi - I``
    and of ``Q_k``, of the latter only the first r columns where those beyond are zero, None without
    noise. Below them Phi is the identity and Q_k is diag(density) dt.
    """

    def __call__(
        self, F: np.ndarray, density: np.ndarray, dt: float
    ) -> tuple[np.ndarray, np.ndarray]: ...
    def of_rows(self, r: int, density: np.ndarray) -> RowTransition: ...


@dataclass(frozen=True)
class Taylor:
    """Series with ``terms`` terms: 2 gives I + F T, 3 adds F^2 T^2 / 2, and so on."""

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
        terms, noise_of = self.terms, noise_of_series(r, density, self.terms)

        def rows(F: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray | None]:
            if terms < 2:
                return np.zeros_like(F), noise_of([], F, dt)
            A, powers = F[..., :r], [F * dt]
            for k in range(2, terms):
                powers.append(A @ powers[-1] * (dt / k))
            return sum(powers[1:], powers[0]), noise_of(powers, F, dt)

        return rows


def noise_of_series(
    r: int, density: np.ndarray, terms: int
) -> Callable[[list[np.ndarray], np.ndarray, float], np.ndarray | None]:
    """Prepare the first r rows of Q_k for ``Phi = I + M_1 + ...`` with ``terms`` terms, M_k = F^k
    dt^k / k!, F zero below its first r rows.

    The returned function takes the same rows of the M_k ``(..., r, n)``, an array of their shape
    and the step (s); it gives None without process noise.
    """
    driven = np.flatnonzero(density)
    walking, width, walks = driven >= r, driven.size, bool(np.any(driven >= r))
    # One driven entry, the usual case, is a slice, which is cheaper than an index array.
    chosen = slice(driven[0], driven[0] + 1) if width == 1 else driven
    identity = np.eye(r, len(density))[:, driven]
    # With M_0 = I, Q_k = sum over i, j of M_i Q M_j^T dt / (i + j + 1).
    order = np.arange(terms)
    share = np.kron(1.0 / (order[:, None] + order + 1.0), np.diag(density[driven]))

    def noise_of(powers: list[np.ndarray], like: np.ndarray, dt: float) -> np.ndarray | None:
        if width == 0:
            return None
        columns = np.empty((*like.shape[:-1], terms * width))
        columns[..., :width] = identity
        for k, M in enumerate(powers, start=1):
            columns[..., k * width : (k + 1) * width] = M[..., chosen]
        weighed = columns @ (share * dt)
        own = weighed @ np.swapaxes(columns, -1, -2)
        if not walks:
            return np.asarray(own)
        noise = np.zeros((*like.shape[:-1], len(density)))
        noise[..., :r], noise[..., driven[walking]] = own, weighed[..., :width][..., walking]
        return noise

    return noise_of


@dataclass(frozen=True)
class Exponential:
    """Matrix exponential; the noise integral by Van Loan's block exponential (IEEE TAC 23(3),
    1978).
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
    """Log density of an innovation ``y (m,)`` with covariance ``S (m, m)``, and its normalised
    square.

    Raises
    ------
    numpy.linalg.LinAlgError : ``S`` is not positive definite.
    """
    from scipy.linalg.lapack import dposv

    root, weighed, trouble = dposv(S, y)
    if trouble:
        raise np.linalg.LinAlgError("the covariance of an innovation is not positive definite")
    squared = float(y @ weighed.ravel())
    return -0.5 * (squared + len(y) * math.log(2.0 * math.pi)) - sum(
        map(math.log, root.diagonal().tolist())
    ), squared


# ---- One pass of the extended Kalman filter over one record


@dataclass(frozen=True, eq=False)
class FilterEquations:
    """Equations of one filter at its point of linearisation (n states and free parameters, n_x
    states, m outputs).

    Attributes
    ----------
    point : ``(n,)`` where they are linearised.
    move : over sub-step ``s``: moves the states of the point, writes the state rows ``(n_x, n)`` of
        the fundamental matrix into its second argument and returns Q_k ``(n, n)``, None without
        process noise.
    observe : at sample ``k``: writes the outputs ``(m,)`` at the point into its second argument
        and, where ``varying``, their slopes into ``G``.
    G : ``(m, n + m + 1)``, the slopes, minus the unit matrix, and room for a column.
    varying : whether the slopes of the outputs change.
    """

    point: np.ndarray
    move: Callable[[int, np.ndarray], np.ndarray | None]
    observe: Callable[[int, np.ndarray], None]
    G: np.ndarray
    varying: bool


def filter_one(
    problem: FilterProblem,
    equations: FilterEquations,
    start: np.ndarray,
    about: np.ndarray | None,
    buffers: FilterBuffers,
) -> bool:
    """Filter a record from ``start (n,)`` and fill ``buffers``; ``about (n, N)``: trajectory to
    linearise about.

    Returns False if the covariance of an innovation is not positive definite. Other results may be
    infinite or NaN; the caller checks them.
    """
    from scipy.linalg.lapack import dposv

    point, observe, G = equations.point, equations.observe, equations.G
    varying, dot, subtract = equations.varying, np.dot, np.subtract
    m, n = len(G), len(point)
    predict = _prediction(problem, equations, about, buffers.transition)
    point[:] = start
    x = point if about is None else start.copy()
    W = np.zeros((n + m + 1, n + m + 1))
    noise = np.arange(n, n + m)
    W[noise, noise] = problem.variance
    W_P, G_turned, H, y, GW = W[:n, :n], G.T, G[:, :n], G[:, -1], np.empty_like(G)
    # Whole matrices spare BLAS copies of parts: of the product that K G is part of, the rows below
    # the first n are not used.
    GW_turned, product, BW = GW.T, np.empty_like(W), np.empty((n, n + m + 1))
    unit = np.eye(n, n + m + 1)
    B = product[:n]
    B_turned, B_last = B.T, B[:, -1]
    missing = {
        k: np.flatnonzero(~problem.valid[:, k])
        for k in np.flatnonzero(~problem.valid.all(axis=0)).tolist()
    }
    z = np.where(problem.valid, problem.z, 0.0).T.copy()
    P = problem.covariance
    before = zip(buffers.predicted_mean, buffers.predicted_covariance, strict=True)
    after = zip(buffers.mean, buffers.covariance, strict=True)
    samples = zip(before, after, buffers.S, buffers.outputs, z, strict=True)
    for k, ((x_before, P_before), (mean, P_after), S, expected, measured) in enumerate(samples):
        if k:
            predict(k, x, P, P_before)
        else:
            P_before[:] = P
        x_before[:] = x
        if about is not None:
            point[:] = about[:, k]
        observe(k, expected)
        if about is not None:
            expected += H @ (x - point)
        subtract(measured, expected, y)
        absent = missing.get(k)
        whole = None if absent is None else _leave_out_channels(absent, G, W)
        if varying:
            buffers.sensitivity[k] = H
        W_P[:] = P_before
        dot(G, W, GW)
        dot(GW, G_turned, S)
        _, S_G, trouble = dposv(S, G)
        if trouble:
            return False
        dot(GW_turned, S_G, product)
        subtract(unit, B, B)
        dot(B, W, BW)
        dot(BW, B_turned, P_after)
        subtract(x, B_last, mean)
        x[:], P = mean, P_after
        if whole is not None:
            G[:], W[noise, noise] = whole, problem.variance
    buffers.innovation[:] = np.where(problem.valid.T, z - buffers.outputs, 0.0)
    if not varying:
        buffers.sensitivity[:] = H * problem.valid.T[:, :, None]
    return True


def _leave_out_channels(absent: np.ndarray, G: np.ndarray, W: np.ndarray) -> np.ndarray:
    """Remove the channels ``absent`` from an update: zero slopes and innovation, one in S. Returns
    the old ``G``.
    """
    n, whole = len(W) - len(G) - 1, G.copy()
    G[absent, :n] = G[absent, -1] = 0.0
    W[n + absent, n + absent] = 1.0
    return whole


def _prediction(
    problem: FilterProblem,
    equations: FilterEquations,
    about: np.ndarray | None,
    transition: np.ndarray,
) -> Callable[[int, np.ndarray, np.ndarray, np.ndarray], None]:
    """Function that moves mean and covariance over the sub-steps to sample k, and fills the
    fundamental matrix.
    """
    move, point, n = equations.move, equations.point, len(problem.names)
    n_x, dot = len(problem.system.states), np.dot
    ends, half, further = problem.grid.sample.tolist(), np.empty((n, n)), np.eye(n)
    moving, whole = list(transition[:, :n_x]), list(transition)
    turned, rest = list(transition.transpose(0, 2, 1)), further[:n_x]

    def predict(k: int, x: np.ndarray, P: np.ndarray, P_before: np.ndarray) -> None:
        if about is not None:
            point[:] = about[:, k - 1]
        first = ends[k - 1]
        for s in range(first, ends[k]):
            rows, step, step_turned = (
                (moving[k], whole[k], turned[k]) if s == first else (rest, further, further.T)
            )
            away = None if about is None else x - point
            noise = move(s, rows)
            if away is not None:
                x[:] = point + step @ away
            dot(step, P, half)
            dot(half, step_turned, P_before)
            if noise is not None:
                np.add(P_before, noise, P_before)
            if s != first:
                whole[k][:] = further @ whole[k]
            P = P_before

    return predict


# ---- The equations of a filter of one record by their table

Noise = Callable[[float], np.ndarray]
_ORDERS = {rk4_step: 4, euler_step: 1}
_TERMS = {Taylor(2): 2, Taylor(3): 3}


def table_equations(
    problem: FilterProblem, step: Step, transition: Transition
) -> FilterEquations | None:
    """Equations from the table; None if they are not bilinear, an input changes within a step, or
    there is no closed form for integrator or transition.
    """
    if step not in _ORDERS or transition not in _TERMS or not constant_within_steps(problem.drive):
        return None
    result = system_tables(problem.system, problem.p)
    if result is None:
        return None
    f, h = result
    w = np.zeros(len(f.table))
    w[0] = 1.0
    move = _motion(f, w, problem, _ORDERS[step], _TERMS[transition])
    observe, G, varying = _outputs(h, w, problem)
    return FilterEquations(w[1 : 1 + f.n], move, observe, G, varying)


def _motion(
    f: Bilinear, w: np.ndarray, problem: FilterProblem, steps: int, terms: int
) -> Callable[[int, np.ndarray], np.ndarray | None]:
    """``FilterEquations.move``: moves the states in ``w`` and fills the state rows of the
    fundamental matrix.
    """
    width, n, n_x = len(w), f.n, len(problem.system.states)
    coefficients = f.table.reshape(width, n_x, n + width)
    slopes, halves, A = coefficients[:, :, :n], coefficients[:, :, n:], coefficients[:, :, :n_x]
    none, one = np.zeros((width, n_x, n_x)), np.zeros((width, n_x, n_x))
    one[0] = np.eye(n_x)
    # Each block with its terms with and without the factor of the step. The last but one, times F
    # above I, gives Phi.
    half = (0.5 * A, one) if terms > 2 else (none, one)
    blocks = [
        ([[halves]], [[0.0 * halves]]),
        *_stages(A, none, one, steps),
        ([[half[0], none]], [[half[1], one]]),
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
    noise_of, prepared, dot = _noise(problem, blend[:, :n_x], F, terms), 0.0, np.dot
    add = np.add

    def move(s: int, rows: np.ndarray) -> np.ndarray | None:
        nonlocal prepared
        dt = sizes[s]
        if dt != prepared:
            np.multiply(per_step, dt, out=table)
            add(table, constant, out=table)
            prepared = dt
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

    return move


def _stages(
    A: np.ndarray, none: np.ndarray, one: np.ndarray, steps: int
) -> list[tuple[list[list[np.ndarray]], list[list[np.ndarray]]]]:
    """Return the matrices that lead in steps from f to (I + A/2 (I + A/3 (I + A/4))) f; none for a
    single step.
    """
    if steps == 1:
        return []
    inner = [
        ([[A / k, none], [none, none]], [[none, one], [none, one]]) for k in range(steps - 1, 2, -1)
    ]
    return [([[A / steps], [none]], [[one], [one]]), *inner, ([[0.5 * A, none]], [[none, one]])]


def _input_writer(w: np.ndarray, n: int, rows: Sequence[np.ndarray]) -> Callable[[int], None]:
    """Function that writes the inputs of a step into the end of ``w``, after one and ``n``
    entries.
    """
    inputs = w[1 + n :]
    if not len(inputs):
        return lambda s: None
    if len(inputs) == 1:
        values, last = np.asarray(rows[0]).tolist(), len(w) - 1

        def one(s: int) -> None:
            w[last] = values[s]

        return one
    u = np.stack(list(rows), axis=1)

    def several(s: int) -> None:
        inputs[:] = u[s]

    return several


def _noise(
    problem: FilterProblem, half: np.ndarray, slopes: np.ndarray, terms: int
) -> Noise | None:
    """Q_k of the last step, None without process noise: sum over i, j of M_i Q M_j^T dt / (i + j +
    1), M_i the terms of Phi.

    ``half (n_x, n_x)``: I + A/2; ``slopes (n_x, n)``: F; both times the step.
    """
    driven, order = np.flatnonzero(problem.density), np.arange(terms)
    if not driven.size:
        return None
    n, n_x, d = len(problem.density), len(half), driven.size
    share = np.kron(1.0 / (order[:, None] + order + 1.0), np.diag(problem.density[driven]))
    columns = np.zeros((n, terms * d))
    columns[:, :d] = np.eye(n)[:, driven]

    def noise_of(dt: float) -> np.ndarray:
        F = slopes[:, driven]
        columns[:n_x, d : 2 * d] = F
        if terms > 2:
            columns[:n_x, 2 * d :] = (half - np.eye(n_x)) @ F
        return np.asarray(columns @ (share * dt) @ columns.T)

    return noise_of


def _outputs(
    h: Bilinear, w: np.ndarray, problem: FilterProblem
) -> tuple[Callable[[int, np.ndarray], None], np.ndarray, bool]:
    """``observe``, ``G`` and ``varying`` of ``FilterEquations``."""
    width, n, m = len(w), h.n, len(problem.variance)
    coefficients = h.table.reshape(width, m, n + width)
    beside = np.zeros((width, m, m + 1))
    beside[0, :, :m] = -np.eye(m)
    blocks = [np.concatenate([coefficients[:, :, :n], beside], axis=2), coefficients[:, :, n:]]
    table = np.concatenate([block.reshape(width, -1) for block in blocks], axis=1)
    product, cut = table[0].copy(), m * (n + m + 1)
    G, of_values = product[:cut].reshape(m, -1), product[cut:].reshape(m, width)
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
