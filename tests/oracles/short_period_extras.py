"""The two aircraft of the tests written a second time, with room for added loads, integrated
between all switches by SciPy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from tests.bases import LOES_CONSTANTS, LOES_VALUES, RIGID_VALUES

# (time, alpha felt by the air, q, control, further states) -> (lift, moment, rates of the further
# states)
Extra = Callable[[float, float, float, float, np.ndarray], tuple[float, float, Sequence[float]]]
NOTHING: Extra = lambda t, a, q, u, z: (0.0, 0.0, ())  # noqa: E731


def _integrated(
    rates: Callable[[float, np.ndarray, float], Any],
    x0: np.ndarray,
    time: np.ndarray,
    u: np.ndarray,
    cuts: Sequence[float],
) -> np.ndarray:
    """States ``(N, nx)`` at the samples under held inputs, no step across a sample or one of the
    cuts.
    """
    out, x = [x0], x0
    for a, b, held in zip(time[:-1], time[1:], u[:-1], strict=True):
        ends = [a, *sorted(c for c in cuts if a < c < b), b]
        for first, last in pairwise(ends):
            middle = 0.5 * (first + last)
            x = solve_ivp(
                _inside(rates, held, first, last, middle),
                (first, last),
                x,
                method="DOP853",
                rtol=1e-11,
                atol=1e-13,
            ).y[:, -1]
        out.append(x)
    return np.array(out)


def _inside(
    rates: Callable[[float, np.ndarray, float], Any],
    held: float,
    first: float,
    last: float,
    middle: float,
) -> Callable[[float, Any], Any]:
    # At the ends of a piece the time is drawn inwards, so that a switch there belongs to one side.
    return lambda t, x: rates(middle + (t - middle) * (1.0 - 1e-12), x, held)


def fly_rigid(
    time: np.ndarray,
    u: np.ndarray,
    extra: Extra = NOTHING,
    *,
    further: int = 0,
    gust: Callable[[float], float] = lambda t: 0.0,
    speed: Callable[[float], float] = lambda t: RIGID_VALUES["airspeed"],
    cuts: Sequence[float] = (),
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs alpha, q, nz ``(3, N)`` and the further states ``(N, n)`` of the rigid aircraft with
    added load coefficients.
    """
    v = RIGID_VALUES
    m, S, c, Iy, rho = (
        v[name] for name in ("mass", "wing_area", "chord", "pitch_inertia", "air_density")
    )

    def loads(
        t: float, x: np.ndarray, e: float
    ) -> tuple[float, float, Sequence[float], float, float]:
        V = speed(t)
        a, rate = x[0] + gust(t) / v["airspeed"], x[1] * c / (2.0 * V)
        lift, moment, own = extra(t, a, x[1], e, x[2:])
        CL = v["CL_alpha"] * a + v["CL_q"] * rate + v["CL_de"] * e + lift
        Cm = v["Cm_alpha"] * a + v["Cm_q"] * rate + v["Cm_de"] * e + moment
        return CL, Cm, own, V, a

    def rates(t: float, x: np.ndarray, e: float) -> Any:
        CL, Cm, own, V, _ = loads(t, x, e)
        return [x[1] - rho * V * S * CL / (2.0 * m), rho * V * V * S * c * Cm / (2.0 * Iy), *own]

    x = _integrated(rates, np.zeros(2 + further), time, u, cuts)
    read = [loads(t, row, e) for t, row, e in zip(time, x, u, strict=True)]
    nz = [rho * V * V * S * CL / (2.0 * m * 9.80665) for CL, _, _, V, _ in read]
    return np.array([[a for *_, a in read], x[:, 1], nz]), x[:, 2:]


def fly_loes(
    time: np.ndarray,
    u: np.ndarray,
    extra: Extra = NOTHING,
    *,
    further: int = 0,
    cuts: Sequence[float] = (),
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs alpha, q, nz ``(3, N)`` and the further states of the low-order equivalent system
    with added rates, driven by the pseudo-control.
    """
    v, V, g, arm = (
        LOES_VALUES,
        LOES_CONSTANTS["airspeed"],
        LOES_CONSTANTS["gravity"],
        LOES_CONSTANTS["vane_arm"],
    )
    steps = round(v["delay"] / (time[1] - time[0]))
    assert abs(steps * (time[1] - time[0]) - v["delay"]) < 1e-12
    late = np.concatenate([np.full(steps, u[0]), u[:-steps]])

    def rates(t: float, x: np.ndarray, e: float) -> Any:
        alpha, q, delta = x[:3]
        lift, moment, own = extra(t, alpha, q, delta, x[3:])
        a_dot = v["L_alpha"] * alpha + v["L_q"] * q + v["L_delta"] * delta + lift
        return [
            a_dot,
            v["M_alpha"] * alpha + v["M_q"] * q + v["M_delta"] * delta + moment,
            v["inv_tau"] * (e - delta),
            *own,
        ]

    x = _integrated(rates, np.zeros(3 + further), time, late, cuts)
    a_dot = np.array([rates(t, row, e)[0] for t, row, e in zip(time, x, late, strict=True)])
    return np.array([x[:, 0] - arm / V * x[:, 1], x[:, 1], V / g * (x[:, 1] - a_dot)]), x[:, 3:]
