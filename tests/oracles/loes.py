"""The low-order equivalent system as the paper writes it, with its own sign of the pseudo-control,
solved exactly for a held stick.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.linalg import expm


def rates_and_readings(
    v: Mapping[str, float], alpha: float, q: float, delta: float, stick: float
) -> tuple[list[float], list[float]]:
    """Eqs. 5-10 with delta_dot = -(delta + stick)/tau + delta_0: the pseudo-control and its
    derivatives have the opposite sign here.
    """
    d, L_d, M_d, d_0 = -delta, -v["L_delta"], -v["M_delta"], -v["delta_0"]
    alpha_dot = v["L_alpha"] * alpha + v["L_q"] * q + L_d * d + v["L_0"]
    q_dot = v["M_alpha"] * alpha + v["M_q"] * q + M_d * d + v["M_0"]
    d_dot = -v["inv_tau"] * d - v["inv_tau"] * stick + d_0
    inner = v["L_alpha"] * alpha + (v["L_q"] - 1.0) * q + L_d * d + v["L_0"]
    nz = -v["airspeed"] / v["gravity"] * inner + v["nz_0"]
    return [alpha_dot, q_dot, -d_dot], [alpha - v["vane_arm"] / v["airspeed"] * q, q, nz]


def exact_response(v: Mapping[str, float], stick: np.ndarray, step: float, late: int) -> np.ndarray:
    """Outputs ``(3, N)`` from rest for a stick held over ``step`` s and delayed by ``late`` whole
    steps, by the matrix exponential.
    """
    block = np.zeros((5, 5))
    for column in range(4):
        alpha, q, delta, stick_now = (1.0 if i == column else 0.0 for i in range(4))
        free = {**v, "L_0": 0.0, "M_0": 0.0, "delta_0": 0.0}
        block[:3, column] = rates_and_readings(free, alpha, q, delta, stick_now)[0]
    block[:3, 4] = [v["L_0"], v["M_0"], v["delta_0"]]
    jump = expm(block * step)
    delayed = np.concatenate([np.full(late, stick[0]), stick])[: len(stick)]
    state, rows = np.zeros(3), []
    for u in delayed:
        rows.append(rates_and_readings(v, state[0], state[1], state[2], u)[1])
        state = jump[:3, :3] @ state + jump[:3, 3] * u + jump[:3, 4]
    return np.array(rows).T
