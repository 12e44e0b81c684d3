"""The rigid short period as a user who has only NumPy would write it: rates, their Jacobian, and
the linear model; nothing of flightid.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

Problem = Mapping[str, np.ndarray]
G0 = 9.80665


class Scales(NamedTuple):
    """``lift`` = rho V S / (2 m) in 1/s, ``moment`` = rho V^2 S c / (2 Iy) in 1/s2, ``hat`` = c /
    (2 V) in s.
    """

    lift: float
    moment: float
    hat: float


def scales_of(problem: Problem) -> Scales:
    """The constants of the aircraft from ``constants``: mass, wing area, chord, pitch inertia,
    airspeed, air density.
    """
    m, S, c, inertia, V, rho = problem["constants"].tolist()
    return Scales(0.5 * rho * V * S / m, 0.5 * rho * V * V * S * c / inertia, 0.5 * c / V)


def rates(
    scales: Scales, alpha: float, q: float, elevator: float, p: list[float]
) -> tuple[float, float]:
    """Rates of alpha and q; ``p`` are CL_alpha, CL_q, CL_de, Cm_alpha, Cm_q, Cm_de."""
    hat = scales.hat * q
    alpha_rate = q - scales.lift * (p[0] * alpha + p[1] * hat + p[2] * elevator)
    return alpha_rate, scales.moment * (p[3] * alpha + p[4] * hat + p[5] * elevator)


def rk4(
    scales: Scales, alpha: float, q: float, elevator: float, p: list[float], dt: float
) -> tuple[float, float]:
    """One Runge-Kutta step with the input held."""
    a1, q1 = rates(scales, alpha, q, elevator, p)
    a2, q2 = rates(scales, alpha + 0.5 * dt * a1, q + 0.5 * dt * q1, elevator, p)
    a3, q3 = rates(scales, alpha + 0.5 * dt * a2, q + 0.5 * dt * q2, elevator, p)
    a4, q4 = rates(scales, alpha + dt * a3, q + dt * q3, elevator, p)
    return alpha + dt / 6.0 * (a1 + 2.0 * (a2 + a3) + a4), q + dt / 6.0 * (
        q1 + 2.0 * (q2 + q3) + q4
    )


def linear_model(scales: Scales, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``A (2, 2)`` and ``B (2, 1)`` of the same equations."""
    lift, moment, hat = scales
    A = np.array([[-lift * p[0], 1.0 - lift * hat * p[1]], [moment * p[3], moment * hat * p[4]]])
    return A, np.array([[-lift * p[2]], [moment * p[5]]])
