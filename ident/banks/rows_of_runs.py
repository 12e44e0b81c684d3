"""One step of many filters of bilinear equations, each number of the filter a row of runs.

Every operation is one of NumPy's on whole rows, element by element, so that no run's numbers depend on which others there are, or on how
many; entries of the table that are zero cost nothing. The same filters as `ident.banks.bilinear_equations`, several times
faster for hundreds of runs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ident.banks.bilinear_equations import Tables
from ident.bilinear_table import Bilinear


class Seen(NamedTuple):
    """What an update writes, a row of runs each: innovations ``y``, diagonal of their covariance ``S``, and, of channels freed of what those before
    them tell, variances ``alone`` and squares over them ``squared``; ``(m, B)``, of a missing channel zeros, and ones in ``S`` and ``alone``."""

    y: np.ndarray
    S: np.ndarray
    alone: np.ndarray
    squared: np.ndarray


class Term(NamedTuple):
    """A coefficient times one entry of (1, states, parameters, inputs), or times two, to be added to a row; ``second`` 0 for one."""

    row: int
    coefficient: float
    first: int
    second: int


def slope_terms(table: Bilinear) -> list[Term]:
    """The Jacobian by states and parameters, entry (i, j) in row ``i n + j``: one term of each entry first, then the others."""
    n, width = table.n, len(table.table)
    slopes = table.table.reshape(width, -1, n + width)[:, :, :n].reshape(width, -1)
    found = [[Term(row, float(slopes[a, row]), a, 0) for a in np.flatnonzero(slopes[:, row]).tolist()] for row in range(slopes.shape[1])]
    return _in_layers(found)


def value_terms(table: Bilinear) -> list[Term]:
    """The values, in as many rows: one term of each first, then the others."""
    n, width = table.n, len(table.table)
    halves = table.table.reshape(width, -1, n + width)[:, :, n:]
    found = []
    for row in range(halves.shape[1]):
        # Of two entries the table holds half a coefficient twice; what is linear it holds once, at (0, b).
        whole = np.triu(halves[:, row] + halves[:, row].T - np.diag(np.diag(halves[:, row])))
        pairs = zip(*(index.tolist() for index in np.nonzero(whole)), strict=True)
        found.append([Term(row, float(whole[a, b]), b, a) for a, b in pairs])
    return _in_layers(found)


def _in_layers(found: list[list[Term]]) -> list[Term]:
    return [terms[0] for terms in found if terms] + [term for terms in found for term in terms[1:]]


def summed(terms: Sequence[Term], w: np.ndarray, out: np.ndarray) -> Callable[[float], None]:
    """A function that fills rows ``out (rows, B)`` with the sums of their terms at ``w``, times a factor; rows without a term are zeroed once."""
    out[:] = 0.0
    begun: set[int] = set()
    other, multiply, add = np.empty_like(w[0]), np.multiply, np.add
    plan = []
    for term in terms:
        further = term.row in begun
        begun.add(term.row)
        second, row = w[term.second] if term.second else None, out[term.row]
        plan.append((term.coefficient, w[term.first], second, row, other if further else row, further))

    def fill(factor: float) -> None:
        for coefficient, first, second, row, room, further in plan:
            multiply(first, coefficient * factor, room)
            if second is not None:
                multiply(room, second, room)
            if further:
                add(row, room, row)

    return fill


def predictor(tables: Tables, w: np.ndarray, P: np.ndarray) -> Callable[[float], None]:
    """A function that moves states in ``w (len w, B)`` and covariances ``P (n, n, B)``, symmetric, over a step of so many seconds."""
    n, n_x, B = tables.n, tables.n_x, w.shape[1]
    F, D, DP, moved = (np.empty((n_x, n, B)) for _ in range(4))
    rest, f, change, t = (np.empty((n_x, B)) for _ in range(4))
    own, pair = np.empty((n_x, n_x, B)), np.empty((n_x, n_x, B))
    # Rates are linear in the states: A times these, of which the Jacobian has A, and what is without states.
    at_rest = [term for term in value_terms(tables.f) if not (0 < term.first <= n_x or 0 < term.second <= n_x)]
    slopes, values = summed(slope_terms(tables.f), w, F.reshape(-1, B)), summed(at_rest, w, rest)
    noise = _noise(tables, F, D) if tables.driven else None
    states, multiply, add = w[1 : 1 + n_x], np.multiply, np.add
    columns, moving = [(F[:, k], change[k]) for k in range(n_x)], [(F[:, k], states[k]) for k in range(n_x)]
    halves = [(F[:, k, None], F[k]) for k in range(n_x)]
    # An entry that the rates do not know leaves its column of Phi that of the identity.
    known = sorted({term.row % n for term in slope_terms(tables.f)}) or [0]
    parts, blocks = [(D[:, k, None], P[k]) for k in known], [(moved[:, None, k], D[None, :, k]) for k in known]
    P_states, P_mirror, mirror = P[:n_x], P[n_x:, :n_x], moved[:, n_x:].swapaxes(0, 1)

    def predict(dt: float) -> None:
        slopes(dt)
        values(dt)
        _product(moving, t, D[:, 0])
        add(rest, t, f)
        # Runge-Kutta of equations that are affine in the states: f + A/2 (f + A/3 (f + A/4 f)).
        change[:] = f
        for divisor in (4.0, 3.0, 2.0):
            _product(columns, t, D[:, 0])
            multiply(t, 1.0 / divisor, t)
            add(f, t, change)
        # Phi - I = F + A F / 2.
        _product(halves, D, DP)
        multiply(D, 0.5, D)
        Q = None if noise is None else noise(dt)
        add(D, F, D)
        _product(parts, moved, DP)
        add(moved, P_states, moved)
        _product(blocks, own, pair)
        add(own, moved[:, :n_x], own)
        if Q is not None:
            add(own, Q, own)
        add(states, change, states)
        P_states[:] = moved
        add(own, own.swapaxes(0, 1), pair)
        multiply(pair, 0.5, P_states[:, :n_x])
        P_mirror[:] = mirror

    return predict


def _product(parts: Sequence[tuple[np.ndarray, np.ndarray]], out: np.ndarray, room: np.ndarray) -> None:
    """The sum of products, always in the same order."""
    np.multiply(*parts[0], out)
    for one, other in parts[1:]:
        np.multiply(one, other, room)
        np.add(out, room, out)


def _noise(tables: Tables, F: np.ndarray, second: np.ndarray) -> Callable[[float], np.ndarray]:
    """Q_k ``(n_x, n_x, B)`` from the terms of Phi, I, F and ``second`` = A F / 2 with the step in them, while they stand there."""
    n_x, B, driven = len(F), F.shape[2], tables.driven
    terms = len(tables.share) // len(driven)
    C = np.zeros((len(tables.share), n_x, B))
    for j, i in enumerate(driven):
        C[j, i] = 1.0
    total, room = np.empty((n_x, n_x, B)), np.empty((n_x, n_x, B))

    def noise(dt: float) -> np.ndarray:
        for j, i in enumerate(driven):
            for term, matrix in zip(range(1, terms), (F, second), strict=False):
                C[term * len(driven) + j] = matrix[:, i]
        total[:] = 0.0
        for a, row in enumerate(tables.share):
            for b in np.flatnonzero(row).tolist():
                np.multiply(C[a][:, None], C[b][None], room)
                np.multiply(room, float(row[b]) * dt, room)
                np.add(total, room, total)
        return total

    return noise


def updater(tables: Tables, w: np.ndarray, P: np.ndarray) -> Callable[[np.ndarray, np.ndarray | None, Seen], None]:
    """A function that takes measurements ``(m, B)`` or ``(m, 1)`` with the positions that are missing, moves ``w`` and ``P``, and fills ``Seen``."""
    n, m, B = tables.n, len(tables.R), w.shape[1]
    H, expected, rows, room = np.empty((m, n, B)), np.empty((m, B)), np.empty((m, n + 1 + m, B)), np.empty((n + 1 + m, B))
    slopes, values = summed(slope_terms(tables.h), w, H.reshape(-1, B)), summed(value_terms(tables.h), w, expected)
    varying = bool(np.any(tables.h.table[1:]))
    slopes(1.0)
    present = [np.flatnonzero(np.any(tables.h.table.reshape(len(w), m, -1)[:, i, :n], axis=0)).tolist() or [0] for i in range(m)]
    HP, y, S, scaled = rows[:, :n], rows[:, n], rows[:, n + 1 :], np.empty((n + 1, B))
    by_state = [[(H[i, k], P[k]) for k in present[i]] for i in range(m)]
    squares = [[[(HP[i, k], H[j, k]) for k in present[j]] for j in range(m)] for i in range(m)]
    R = tables.R.diagonal().tolist()
    subtract, multiply, divide = np.subtract, np.multiply, np.divide
    diagonal = rows.reshape(-1, B)[n + 1 :: n + 2 + m]
    s, outer, point = scaled[:n], np.empty_like(P), w[1 : 1 + n]
    above, beside = s[:, None], s[None]

    def update(z: np.ndarray, missing: np.ndarray | None, seen: Seen) -> None:
        if varying:
            slopes(1.0)
        values(1.0)
        subtract(z, expected, y)
        for i in range(m):
            _product(by_state[i], HP[i], room[:n])
            for j in range(m):
                _product(squares[i][j], S[i, j], room[0])
            np.add(S[i, i], R[i], S[i, i])
        if missing is not None:
            rows[missing] = 0.0
            S[:, missing] = 0.0
            S[missing, missing] = 1.0
        seen.y[:], seen.S[:] = y, diagonal
        for i in range(m - 1):
            for j in range(i + 1, m):
                divide(S[j, i], S[i, i], room[0])
                ratio = room[0].copy()
                multiply(rows[i], ratio, room)
                subtract(rows[j], room, rows[j])
        seen.alone[:] = diagonal
        multiply(y, y, seen.squared)
        divide(seen.squared, diagonal, seen.squared)
        for i in range(m):
            np.sqrt(S[i, i], room[0])
            divide(rows[i, : n + 1], room[0], scaled)
            # P loses s s^T, of which both sides of the diagonal are the same numbers.
            multiply(above, beside, outer)
            subtract(P, outer, P)
            multiply(s, scaled[n], room[:n])
            np.add(point, room[:n], point)

    return update
