"""A subclass of filterpy's ExtendedKalmanFilter with the Jacobian written out by hand, as its
handbook shows; no likelihoods.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from benchmarks.peers.short_period import Problem, Scales, rk4, scales_of


class ShortPeriodFilter(ExtendedKalmanFilter):
    """States alpha, q and the six derivatives; Runge-Kutta for the mean, three terms of the
    exponential for the covariance.
    """

    P: np.ndarray

    def __init__(self, scales: Scales, dt: float) -> None:
        super().__init__(dim_x=8, dim_z=2)
        self.scales, self.dt = scales, dt

    def predict(self, u: float = 0.0) -> None:
        lift, moment, hat = self.scales
        alpha, q, *p = self.x[:, 0].tolist()
        F = np.zeros((8, 8))
        F[0, :5] = -lift * p[0], 1.0 - lift * hat * p[1], -lift * alpha, -lift * hat * q, -lift * u
        F[1, 0], F[1, 1] = moment * p[3], moment * hat * p[4]
        F[1, 5:] = moment * alpha, moment * hat * q, moment * u
        step = F * self.dt
        self.F = self._I + step + 0.5 * (step @ step)
        self.x[0, 0], self.x[1, 0] = rk4(self.scales, alpha, q, u, p, self.dt)
        self.P = self.F @ self.P @ self.F.T


H = np.eye(2, 8)


def slopes(x: np.ndarray) -> np.ndarray:
    return H


def outputs(x: np.ndarray) -> np.ndarray:
    return x[:2]


def filtered(problem: Problem, z: np.ndarray, likelihood: bool) -> dict[str, np.ndarray]:
    """One record ``z (2, N)``: means and standard deviations after each sample, ``(N, 8)``, the
    last of each, and the log-likelihood.
    """
    time, elevator = problem["time"], problem["elevator"].tolist()
    ekf = ShortPeriodFilter(scales_of(problem), float(time[1] - time[0]))
    ekf.x, ekf.P = problem["start"].reshape(8, 1).copy(), np.diag(problem["start_std"] ** 2)
    ekf.R = np.diag(problem["noise_std"] ** 2)
    N, measured = len(time), z.T[:, :, None]
    means, stds, total = np.empty((N, 8)), np.empty((N, 8)), 0.0
    for k in range(N):
        if k:
            ekf.predict(elevator[k - 1])
        ekf.update(measured[k], slopes, outputs)
        if likelihood:
            total += ekf.log_likelihood
        means[k], stds[k] = ekf.x[:, 0], np.sqrt(np.diagonal(ekf.P))
    out = {"mean": means, "std": stds, "estimate": means[-1, 2:], "estimate_std": stds[-1, 2:]}
    return {**out, "log_likelihood": np.array(total)} if likelihood else out


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    return lambda: filtered(problem, problem["z"], likelihood=False)
