"""Cramer-Rao bounds with priors, from equations written a second time and central differences of a
SciPy integration.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.integrate import solve_ivp

Outputs = Callable[[Mapping[str, float]], np.ndarray]


def bound(
    outputs: Outputs,
    values: Mapping[str, float],
    prior_std: Mapping[str, float],
    noise_std: Sequence[float],
) -> dict[str, float]:
    """Smallest standard deviations of the quantities named in ``prior_std``.

    ``outputs(values)`` gives the noise-free outputs ``(m, N)``; ``noise_std (m,)``. The information
    of the prior is added, so that the bound holds for an estimator that is told it.
    """
    names = list(prior_std)
    columns = []
    for name in names:
        size = 1e-3 * prior_std[name]
        pair = [outputs({**values, name: values[name] + sign * size}) for sign in (1.0, -1.0)]
        columns.append(((pair[0] - pair[1]) / (2.0 * size) / np.array(noise_std)[:, None]).ravel())
    J = np.array(columns).T
    information = J.T @ J + np.diag([prior_std[name] ** -2.0 for name in names])
    return dict(zip(names, np.sqrt(np.diag(np.linalg.inv(information))).tolist(), strict=True))


def short_period_outputs(time: np.ndarray, switches: Sequence[tuple[float, float]]) -> Outputs:
    """alpha and q at ``time`` (rad, rad/s); ``switches`` are (time, elevator from then on). Initial
    states ``alpha``, ``q`` are among the values.
    """

    def outputs(v: Mapping[str, float]) -> np.ndarray:
        V, S, c = v["airspeed"], v["wing_area"], v["chord"]
        lift = 0.5 * v["air_density"] * V * S / v["mass"]
        pitch = 0.5 * v["air_density"] * V * V * S * c / v["pitch_inertia"]
        k = c / (2.0 * V)

        def rates(t: float, x: np.ndarray, de: float) -> list[float]:
            alpha, q = x
            CL = v["CL_alpha"] * alpha + v["CL_q"] * q * k + v["CL_de"] * de
            Cm = v["Cm_alpha"] * alpha + v["Cm_q"] * q * k + v["Cm_de"] * de
            return [q - lift * CL, pitch * Cm]

        y, x = np.empty((2, len(time))), np.array([v["alpha"], v["q"]])
        y[:, 0] = x
        for (begin, de), (end, _) in zip(
            switches, [*switches[1:], (float(time[-1]), 0.0)], strict=True
        ):
            at = np.flatnonzero((time > begin + 1e-9) & (time <= end + 1e-9))
            stops = np.clip(time[at], begin, end)
            solved = solve_ivp(
                rates,
                (begin, end),
                x,
                args=(de,),
                t_eval=stops,
                rtol=1e-10,
                atol=1e-12,
                dense_output=True,
            )
            y[:, at], x = solved.y, solved.sol(end)
        return y

    return outputs


def fall_outputs(time: np.ndarray) -> Outputs:
    """Altitude at ``time``, m, of a vertical fall; initial ``altitude`` and ``velocity`` (positive
    up) are among the values.
    """

    def outputs(v: Mapping[str, float]) -> np.ndarray:
        def rates(t: float, x: np.ndarray) -> list[float]:
            rho = v["air_density_reference"] * np.exp(-x[0] / v["density_scale_height"])
            return [x[1], 0.5 * rho * x[1] ** 2 / v["beta"] - v["gravity"]]

        start = (v["altitude"], v["velocity"])
        return solve_ivp(
            rates, (time[0], time[-1]), start, method="DOP853", t_eval=time, rtol=1e-12, atol=1e-9
        ).y[:1]

    return outputs
