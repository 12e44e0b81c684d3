"""The equations of a filter of one record by their table: one product gives all that a step needs.

At this size a call costs more than its arithmetic. All that is linear in w = (1, states, parameters, inputs) stands side by side in one
table: the Jacobian, the halves of the values, the factors of the Runge-Kutta step and of the fundamental matrix.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from ident.bilinear_table import Bilinear, held_within_steps, system_tables
from ident.filters.one_record import Equations
from ident.filters.problem import FilterProblem
from ident.filters.transition import Taylor, Transition
from sim.propagation import Step, euler_step, rk4_step

Noise = Callable[[float], np.ndarray]
_ORDERS = {rk4_step: 4, euler_step: 1}
_TERMS = {Taylor(2): 2, Taylor(3): 3}


def table_equations(problem: FilterProblem, step: Step, transition: Transition) -> Equations | None:
    """None where the equations are not bilinear, an input changes within a step, or integrator or transition are none of those written here."""
    if step not in _ORDERS or transition not in _TERMS or not held_within_steps(problem.drive):
        return None
    found = system_tables(problem.system, problem.p)
    if found is None:
        return None
    f, h = found
    w = np.zeros(len(f.table))
    w[0] = 1.0
    move = _motion(f, w, problem, _ORDERS[step], _TERMS[transition])
    look, G, varying = _outputs(h, w, problem)
    return Equations(w[1 : 1 + f.n], move, look, G, varying)


def _motion(f: Bilinear, w: np.ndarray, problem: FilterProblem, steps: int, terms: int) -> Callable[[int, np.ndarray], np.ndarray | None]:
    """``Equations.move``: moves the states in ``w`` and fills the state rows of the fundamental matrix."""
    width, n, n_x = len(w), f.n, len(problem.system.states)
    coefficients = f.table.reshape(width, n_x, n + width)
    slopes, halves, A = coefficients[:, :, :n], coefficients[:, :, n:], coefficients[:, :, :n_x]
    none, one = np.zeros((width, n_x, n_x)), np.zeros((width, n_x, n_x))
    one[0] = np.eye(n_x)
    # Each block with what is to be multiplied by the step, and what is not. The last but one, times F above I, gives Phi.
    half = (0.5 * A, one) if terms > 2 else (none, one)
    blocks = [([[halves]], [[0.0 * halves]]), *_stages(A, none, one, steps), ([[half[0], none]], [[half[1], one]]), ([[slopes]], [[0.0 * slopes]])]
    per_step, constant = (np.concatenate([np.block(pair[i]).reshape(width, -1) for pair in blocks], axis=1) for i in (0, 1))
    shapes = [np.block(pair[0]).shape[1:] for pair in blocks]
    ends = np.cumsum([0, *(rows * columns for rows, columns in shapes)]).tolist()
    room = np.concatenate([np.zeros(ends[-1]), np.eye(n_x, n).ravel()])
    of_values, *stages, blend, F = (room[a:b].reshape(shape) for (a, b), shape in zip(pairwise(ends), shapes, strict=True))
    product, F_on_one = room[: ends[-1]], room[ends[-2] :].reshape(2 * n_x, n)
    states, table, sizes = w[1 : 1 + n_x], np.empty_like(constant), problem.grid.steps.tolist()
    values = np.zeros(n_x)
    way = [(stage, np.zeros(len(stage))) for stage in stages]
    change = way[-1][1] if way else values
    feed, noise_of, prepared, dot, add = _feeding(w, f.n, problem.drive.stages[0]), _noise(problem, blend[:, :n_x], F, terms), 0.0, np.dot, np.add

    def move(s: int, rows: np.ndarray) -> np.ndarray | None:
        nonlocal prepared
        dt = sizes[s]
        if dt != prepared:
            np.multiply(per_step, dt, out=table)
            add(table, constant, out=table)
            prepared = dt
        feed(s)
        dot(w, table, product)
        dot(of_values, w, values)
        last = values
        for stage, found in way:
            dot(stage, last, found)
            last = found
        add(states, change, states)
        dot(blend, F_on_one, rows)
        return None if noise_of is None else noise_of(dt)

    return move


def _stages(A: np.ndarray, none: np.ndarray, one: np.ndarray, steps: int) -> list[tuple[list[list[np.ndarray]], list[list[np.ndarray]]]]:
    """Matrices that lead from f to (I + A/2 (I + A/3 (I + A/4))) f one after the other, f carried along in between; none for a single step."""
    if steps == 1:
        return []
    inner = [([[A / k, none], [none, none]], [[none, one], [none, one]]) for k in range(steps - 1, 2, -1)]
    return [([[A / steps], [none]], [[one], [one]]), *inner, ([[0.5 * A, none]], [[none, one]])]


def _feeding(w: np.ndarray, n: int, rows: Sequence[np.ndarray]) -> Callable[[int], None]:
    """Writes the inputs of a step into the end of ``w``, after one and ``n`` more; a single one, the usual case, as a number."""
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


def _noise(problem: FilterProblem, half: np.ndarray, slopes: np.ndarray, terms: int) -> Noise | None:
    """Q_k of the step that was made last, None where nothing drives: sum over i, j of M_i Q M_j^T dt / (i + j + 1), M_i the terms of Phi.

    ``half (n_x, n_x)`` is I + A/2, ``slopes (n_x, n)`` F, both with the step in them.
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


def _outputs(h: Bilinear, w: np.ndarray, problem: FilterProblem) -> tuple[Callable[[int, np.ndarray], None], np.ndarray, bool]:
    """``look``, ``G`` and ``varying`` of ``Equations``."""
    width, n, m = len(w), h.n, len(problem.variance)
    coefficients = h.table.reshape(width, m, n + width)
    beside = np.zeros((width, m, m + 1))
    beside[0, :, :m] = -np.eye(m)
    blocks = [np.concatenate([coefficients[:, :, :n], beside], axis=2), coefficients[:, :, n:]]
    table = np.concatenate([block.reshape(width, -1) for block in blocks], axis=1)
    product, cut = table[0].copy(), m * (n + m + 1)
    G, of_values = product[:cut].reshape(m, -1), product[cut:].reshape(m, width)
    varying, dot = bool(np.any(table[1:])), np.dot
    feed = _feeding(w, n, [row[problem.grid.sample] for row in problem.drive.begin]) if h.feeds_through else None

    def look(k: int, expected: np.ndarray) -> None:
        if feed is not None:
            feed(k)
        if varying:
            dot(w, table, product)
        dot(of_values, w, expected)

    return look, G, varying
