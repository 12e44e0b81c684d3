"""Lateral and longitudinal motion written a second time from the text books, with room for added
coefficients, wind and lagging surfaces.

Etkin and Reid, Dynamics of Flight, 3rd ed., section 4.9 (lateral, body axes): the moment equation
is solved as a matrix equation here. Longitudinal motion in body axes (u, w, q, theta), Nelson,
Flight Stability and Automatic Control, 2nd ed., section 3.2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from tests.bases import LATERAL_VALUES, LONGITUDINAL_VALUES

G = 9.80665
# (time, signals) -> what is added to the coefficients
Added = Callable[[float, Mapping[str, float]], Mapping[str, float]]


def _integrated(
    rates: Callable[..., Any],
    x0: Sequence[float],
    time: np.ndarray,
    u: np.ndarray,
    cuts: Sequence[float],
) -> np.ndarray:
    """States ``(N, nx)`` at the samples under held inputs ``(n, N)``, no step across a sample or
    one of the cuts.
    """
    x = np.array(x0, dtype=float)
    out = [x]
    for k, (a, b) in enumerate(pairwise(time)):
        for first, last in pairwise([a, *sorted(c for c in cuts if a < c < b), b]):
            middle = 0.5 * (first + last)

            def inside(t: float, x: np.ndarray, middle: float = middle, k: int = k) -> Any:
                # Drawn inwards at the ends of a piece, so that a switch there belongs to one side.
                return rates(middle + (t - middle) * (1.0 - 1e-12), x, u[:, k])

            x = solve_ivp(inside, (first, last), x, method="DOP853", rtol=1e-10, atol=1e-12).y[
                :, -1
            ]
        out.append(x)
    return np.array(out)


def fly_lateral(
    time: np.ndarray,
    u: np.ndarray,
    added: Added = lambda t, s: {},
    *,
    wind: Callable[[float], float] = lambda t: 0.0,
    lags: tuple[float, float] | None = None,
    bending: tuple[float, float, float, float] | None = None,
    faster: float = 0.0,
    cuts: Sequence[float] = (),
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs beta, p, r, phi, ny ``(5, N)`` and the yaw acceleration ``(N,)``.

    ``added`` gives increments of CY, Cl and Cn (a missing one is zero), ``wind`` the air from the
    right in m/s, ``lags`` the time constants of the actuators of aileron and rudder, settled at the
    first input. ``bending`` is frequency, damping, gain of sideslip and gyro of an oscillator that
    the rudder drives; ``added`` knows it as ``eta``. The airspeed grows by ``faster`` m/s2.
    """
    v, b = LATERAL_VALUES, LATERAL_VALUES["span"]
    inertia = np.array(
        [[v["roll_inertia"], -v["cross_inertia"]], [-v["cross_inertia"], v["yaw_inertia"]]]
    )

    def motion(t: float, x: np.ndarray, held: np.ndarray) -> tuple[np.ndarray, float]:
        beta, p, r, phi = x[:4]
        V = v["airspeed"] + faster * t
        force = 0.5 * v["air_density"] * V * V * v["wing_area"]
        da, dr = x[4:6] if lags else held
        s = {
            "beta": beta + wind(t) / v["airspeed"],
            "p": p * b / (2 * V),
            "r": r * b / (2 * V),
            "da": da,
            "dr": dr,
        }
        more = added(t, {**s, "eta": x[-2]} if bending else s)
        CY, Cl, Cn = (
            sum(v[f"{axis}_{by}"] * value for by, value in s.items()) + more.get(axis, 0.0)
            for axis in ("CY", "Cl", "Cn")
        )
        side = force * CY / v["mass"]
        turning = np.linalg.solve(inertia, [force * b * Cl, force * b * Cn])
        # Air past the body: v_dot = side force + w p - u r + gravity, v = V beta.
        u0, w0 = V * math.cos(v["trim_alpha"]), V * math.sin(v["trim_alpha"])
        beta_dot = (side + w0 * p - u0 * r + G * math.cos(v["trim_theta"]) * phi) / V
        own = [(held[i] - x[4 + i]) / lags[i] for i in (0, 1)] if lags else []
        if bending:
            w, damping, gain, _ = bending
            own += [x[-1], w * w * (dr + gain * s["beta"] - x[-2]) - 2 * damping * w * x[-1]]
        return np.array([beta_dot, *turning, p + math.tan(v["trim_theta"]) * r, *own]), side / G

    x0 = [0.0, 0.0, 0.0, 0.0, *(u[:, 0] if lags else ()), *((0.0, 0.0) if bending else ())]
    states = _integrated(lambda t, x, held: motion(t, x, held)[0], x0, time, u, cuts)
    at_samples = [motion(t, x, u[:, k]) for k, (t, x) in enumerate(zip(time, states, strict=True))]
    outputs = np.vstack([states[:, :4].T, [ny for _, ny in at_samples]])
    outputs[0] += [wind(t) / v["airspeed"] for t in time]
    outputs[2] += bending[3] * states[:, -1] if bending else 0.0
    return outputs, np.array([rates[2] for rates, _ in at_samples])


def fly_longitudinal(
    time: np.ndarray,
    u: np.ndarray,
    start: Sequence[float],
    added: Added = lambda t, s: {},
    *,
    headwind: Callable[[float], float] = lambda t: 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs airspeed, alpha, theta, q, nz, nx ``(6, N)`` and the pitch acceleration ``(N,)``;
    ``start`` is airspeed, alpha, theta, q.

    ``added`` gives increments of CD, CL and Cm, ``headwind`` what the air adds to the airspeed in
    m/s.
    """
    v = LONGITUDINAL_VALUES

    def motion(t: float, x: np.ndarray, held: np.ndarray) -> tuple[np.ndarray, float, float]:
        along, down, q, theta = x
        e, thrust = held
        V, alpha = math.hypot(along, down) + headwind(t), math.atan2(down, along)
        ratio, rate = V / v["reference_airspeed"], q * v["chord"] / (2 * v["reference_airspeed"])
        s = {"alpha": alpha, "de": e, "q": q, "V": V}
        more = added(t, s)
        CD = v["CD_0"] + v["CD_V"] * ratio + v["CD_alpha"] * alpha + more.get("CD", 0.0)
        CL = (
            v["CL_0"]
            + v["CL_V"] * ratio
            + v["CL_alpha"] * alpha
            + v["CL_q"] * rate
            + v["CL_de"] * e
            + more.get("CL", 0.0)
        )
        Cm = (
            v["Cm_0"]
            + v["Cm_V"] * ratio
            + v["Cm_alpha"] * alpha
            + v["Cm_q"] * rate
            + v["Cm_de"] * e
            + more.get("Cm", 0.0)
        )
        force = 0.5 * v["air_density"] * V * V * v["wing_area"]
        X = thrust + force * (CL * math.sin(alpha) - CD * math.cos(alpha))
        Z = -force * (CL * math.cos(alpha) + CD * math.sin(alpha))
        along_dot = X / v["mass"] - q * down - G * math.sin(theta)
        down_dot = Z / v["mass"] + q * along + G * math.cos(theta)
        q_dot = (force * v["chord"] * Cm + thrust * v["thrust_arm"]) / v["pitch_inertia"]
        return np.array([along_dot, down_dot, q_dot, q]), -Z / (v["mass"] * G), X / (v["mass"] * G)

    V0, alpha0, theta0, q0 = start
    x0 = [V0 * math.cos(alpha0), V0 * math.sin(alpha0), q0, theta0]
    states = _integrated(lambda t, x, held: motion(t, x, held)[0], x0, time, u, ())
    at_samples = [motion(t, x, u[:, k]) for k, (t, x) in enumerate(zip(time, states, strict=True))]
    along, down, q, theta = states.T
    speed = np.hypot(along, down) + [headwind(t) for t in time]
    outputs = np.array(
        [
            speed,
            np.arctan2(down, along),
            theta,
            q,
            [nz for _, nz, _ in at_samples],
            [nx for *_, nx in at_samples],
        ]
    )
    return outputs, np.array([rates[2] for rates, *_ in at_samples])
