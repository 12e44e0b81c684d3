"""Kalman filter and Rauch-Tung-Striebel smoother of a linear system in covariance form, written for
the tests alone.

x_dot = A x + B u + w, z = C x + D u + v. Everything is a plain matrix; integrals are done by
quadrature.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Linear:
    """Matrices, spectral density ``Q (n, n)``, measurement covariance ``R (m, m)``, start ``x0``,
    ``P0``.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    Q: np.ndarray
    R: np.ndarray
    x0: np.ndarray
    P0: np.ndarray


@dataclass(frozen=True, eq=False)
class Filtered:
    """Rows are samples."""

    x: np.ndarray
    P: np.ndarray
    x_before: np.ndarray
    P_before: np.ndarray
    Phi: np.ndarray
    log_likelihood: np.ndarray
    nis: np.ndarray
    innovation: np.ndarray
    innovation_std: np.ndarray


def exponential(M: np.ndarray) -> np.ndarray:
    """exp(M) by a long series of M / 2^10 squared ten times."""
    small = M / 1024.0
    total, term = np.eye(len(M)), np.eye(len(M))
    for k in range(1, 25):
        term = term @ small / k
        total = total + term
    for _ in range(10):
        total = total @ total
    return total


def series(M: np.ndarray, terms: int) -> np.ndarray:
    """The first terms of exp(M)."""
    return sum(
        (np.linalg.matrix_power(M, k) / math.factorial(k) for k in range(terms)), np.zeros_like(M)
    )


def fundamental(A: np.ndarray, dt: float, terms: int | None) -> np.ndarray:
    """Series with that many terms, the exponential when None."""
    return exponential(A * dt) if terms is None else series(A * dt, terms)


def process_noise(A: np.ndarray, Q: np.ndarray, dt: float, terms: int | None) -> np.ndarray:
    """Integral of Phi(s) Q Phi(s)^T over a step, by Gauss-Legendre quadrature of 10 points."""
    nodes, weights = np.polynomial.legendre.leggauss(10)
    total = np.zeros_like(Q)
    if not np.any(Q):
        return total
    for node, weight in zip(nodes, weights, strict=True):
        Phi = fundamental(A, 0.5 * dt * (1.0 + node), terms)
        total = total + 0.5 * dt * weight * Phi @ Q @ Phi.T
    return total


def mean_step(
    A: np.ndarray,
    B: np.ndarray,
    x: np.ndarray,
    u: tuple[np.ndarray, np.ndarray, np.ndarray],
    dt: float,
    euler: bool,
) -> np.ndarray:
    """Euler, or Runge-Kutta with inputs at the beginning, middle and end."""
    k1 = A @ x + B @ u[0]
    if euler:
        return x + dt * k1
    k2 = A @ (x + 0.5 * dt * k1) + B @ u[1]
    k3 = A @ (x + 0.5 * dt * k2) + B @ u[1]
    k4 = A @ (x + dt * k3) + B @ u[2]
    return x + dt * (k1 + 2 * k2 + 2 * k3 + k4) / 6.0


def kalman(
    model: Linear,
    time: np.ndarray,
    u: np.ndarray,
    z: np.ndarray,
    valid: np.ndarray,
    pieces: np.ndarray,
    *,
    terms: int | None,
    euler: bool,
    ramp: bool,
) -> Filtered:
    """Filter ``z (m, N)`` with inputs ``u (nu, N)`` held between samples or ramped; ``pieces (N -
    1,)`` sub-steps an interval.
    """
    n, m, N = len(model.x0), len(model.R), len(time)
    out = Filtered(
        np.zeros((N, n)),
        np.zeros((N, n, n)),
        np.zeros((N, n)),
        np.zeros((N, n, n)),
        np.tile(np.eye(n), (N, 1, 1)),
        np.zeros(N),
        np.zeros(N),
        np.zeros((N, m)),
        np.ones((N, m)),
    )
    x, P = model.x0, model.P0
    for k in range(N):
        if k:
            count = int(pieces[k - 1])
            dt = (time[k] - time[k - 1]) / count
            Phi, noise = fundamental(model.A, dt, terms), process_noise(model.A, model.Q, dt, terms)
            for piece in range(count):
                slope = (u[:, k] - u[:, k - 1]) if ramp else np.zeros(len(u))
                at = [u[:, k - 1] + slope * (piece + part) / count for part in (0.0, 0.5, 1.0)]
                x = mean_step(model.A, model.B, x, (at[0], at[1], at[2]), dt, euler)
                P = Phi @ P @ Phi.T + noise
                out.Phi[k] = Phi @ out.Phi[k]
        out.x_before[k], out.P_before[k] = x, P
        rows = [i for i in range(m) if valid[i, k]]
        if rows:
            C, R = model.C[rows], model.R[np.ix_(rows, rows)]
            y = z[rows, k] - C @ x - model.D[rows] @ u[:, k]
            S = C @ P @ C.T + R
            K = np.linalg.solve(S, C @ P).T
            x, P = x + K @ y, P - K @ S @ K.T
            out.nis[k] = y @ np.linalg.solve(S, y)
            out.log_likelihood[k] = -0.5 * (out.nis[k] + np.log(np.linalg.det(2.0 * np.pi * S)))
            out.innovation[k, rows], out.innovation_std[k, rows] = y, np.sqrt(np.diag(S))
        out.x[k], out.P[k] = x, P
    return out


def rts(filtered: Filtered) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed means ``(N, n)`` and covariances ``(N, n, n)``; every predicted covariance must be
    regular.
    """
    x, P = filtered.x.copy(), filtered.P.copy()
    for k in range(len(x) - 2, -1, -1):
        gain = filtered.P[k] @ filtered.Phi[k + 1].T @ np.linalg.inv(filtered.P_before[k + 1])
        x[k] = x[k] + gain @ (x[k + 1] - filtered.x_before[k + 1])
        P[k] = P[k] + gain @ (P[k + 1] - filtered.P_before[k + 1]) @ gain.T
    return x, P
