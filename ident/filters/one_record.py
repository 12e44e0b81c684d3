"""One pass of the extended Kalman filter over one record, for equations that give their matrices in place.

The same filter as filterpy's in `ident.filters.ekf`, Joseph's update in two products: with G = [H, -I, y] and W of P and R side by side,
H P and S come from G W, and P becomes B W B^T with B = [I - K H, K]. Every product lands in the history, and what broke
down is looked for once, at the end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ident.filters.history import Kept
from ident.filters.problem import FilterProblem


@dataclass(frozen=True, eq=False)
class Equations:
    """The equations of one filter, evaluated at a point that they keep (n states and free parameters, n_x states, m outputs).

    Attributes
    ----------
    point : ``(n,)`` where they are linearised.
    move : over sub-step ``s``: moves the states of the point, writes the state rows ``(n_x, n)`` of the fundamental matrix into its second
        argument and returns Q_k ``(n, n)``, None without process noise.
    look : at sample ``k``: writes the outputs ``(m,)`` at the point into its second argument and, where ``varying``, their slopes into ``G``.
    G : ``(m, n + m + 1)``, the slopes, minus the unit matrix, and room for a column.
    varying : whether the slopes of the outputs change.
    """

    point: np.ndarray
    move: Callable[[int, np.ndarray], np.ndarray | None]
    look: Callable[[int, np.ndarray], None]
    G: np.ndarray
    varying: bool


def filter_one(problem: FilterProblem, equations: Equations, start: np.ndarray, about: np.ndarray | None, kept: Kept) -> bool:
    """Filter a record from ``start (n,)``, linearised about the trajectory ``about (n, N)`` where given; fills ``kept``.

    False where an innovation's covariance is not positive definite. Other numbers may be infinite or NaN: the caller looks.
    """
    from scipy.linalg.lapack import dposv

    point, look, G, varying, dot, subtract = equations.point, equations.look, equations.G, equations.varying, np.dot, np.subtract
    m, n = len(G), len(point)
    predict = _prediction(problem, equations, about, kept.transition)
    point[:] = start
    x = point if about is None else start.copy()
    W = np.zeros((n + m + 1, n + m + 1))
    noise = np.arange(n, n + m)
    W[noise, noise] = problem.variance
    W_P, G_turned, H, y, GW = W[:n, :n], G.T, G[:, :n], G[:, -1], np.empty_like(G)
    # Whole matrices spare BLAS copies of parts: of the product that K G is part of, the rows below the first n are not used.
    GW_turned, product, BW, unit = GW.T, np.empty_like(W), np.empty((n, n + m + 1)), np.eye(n, n + m + 1)
    B = product[:n]
    B_turned, B_last = B.T, B[:, -1]
    missing = {k: np.flatnonzero(~problem.valid[:, k]) for k in np.flatnonzero(~problem.valid.all(axis=0)).tolist()}
    z = np.where(problem.valid, problem.z, 0.0).T.copy()
    P = problem.covariance
    before, after = zip(kept.predicted_mean, kept.predicted_covariance, strict=True), zip(kept.mean, kept.covariance, strict=True)
    samples = zip(before, after, kept.S, kept.outputs, z, strict=True)
    for k, ((x_before, P_before), (mean, P_after), S, expected, measured) in enumerate(samples):
        if k:
            predict(k, x, P, P_before)
        else:
            P_before[:] = P
        x_before[:] = x
        if about is not None:
            point[:] = about[:, k]
        look(k, expected)
        if about is not None:
            expected += H @ (x - point)
        subtract(measured, expected, y)
        gone = missing.get(k)
        whole = None if gone is None else _left_out(gone, G, W)
        if varying:
            kept.sensitivity[k] = H
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
    kept.innovation[:] = np.where(problem.valid.T, z - kept.outputs, 0.0)
    if not varying:
        kept.sensitivity[:] = H * problem.valid.T[:, :, None]
    return True


def _left_out(gone: np.ndarray, G: np.ndarray, W: np.ndarray) -> np.ndarray:
    """Make the channels ``gone`` ones that say nothing: no slopes, no innovation, one in S. Returns ``G`` as it was."""
    n, whole = len(W) - len(G) - 1, G.copy()
    G[gone, :n] = G[gone, -1] = 0.0
    W[n + gone, n + gone] = 1.0
    return whole


def _prediction(
    problem: FilterProblem, equations: Equations, about: np.ndarray | None, transition: np.ndarray
) -> Callable[[int, np.ndarray, np.ndarray, np.ndarray], None]:
    """Moves the mean in place and the covariance into its place over the sub-steps to sample k, and fills their fundamental matrix."""
    move, point, n, n_x, dot = equations.move, equations.point, len(problem.names), len(problem.system.states), np.dot
    ends, half, further = problem.grid.sample.tolist(), np.empty((n, n)), np.eye(n)
    moving, whole, turned, rest = list(transition[:, :n_x]), list(transition), list(transition.transpose(0, 2, 1)), further[:n_x]

    def predict(k: int, x: np.ndarray, P: np.ndarray, P_before: np.ndarray) -> None:
        if about is not None:
            point[:] = about[:, k - 1]
        first = ends[k - 1]
        for s in range(first, ends[k]):
            rows, step, step_turned = (moving[k], whole[k], turned[k]) if s == first else (rest, further, further.T)
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
