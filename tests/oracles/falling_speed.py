"""A flight whose airspeed falls, written apart from `sim`: scalar equations, classical Runge-Kutta,
an elevator of sines or held steps.

With weight: total forces and the path's angle, V gamma_dot = L/m - g cos(gamma), alpha = theta -
gamma, lift m g at the start. Without: perturbations about a trim that any speed is in, alpha_dot =
q - rho V S CL/(2 m).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

G = 9.80665
TRUE = {
    "CL_alpha": 5.1,
    "CL_q": 6.0,
    "CL_de": 0.42,
    "Cm_alpha": -0.92,
    "Cm_q": -17.0,
    "Cm_de": -1.35,
}
CONSTANTS = {
    "mass": 7500.0,
    "wing_area": 30.1,
    "chord": 2.43,
    "pitch_inertia": 32000.0,
    "airspeed": 130.0,
    "air_density": 0.96,
}


@dataclass(frozen=True)
class FallingSpeed:
    """Columns of a flight, ``(N,)`` each, SI: elevator and alpha in rad above trim, nz in g above
    one.
    """

    time: np.ndarray
    elevator: np.ndarray
    alpha: np.ndarray
    q: np.ndarray
    nz: np.ndarray
    airspeed: np.ndarray
    dynamic_pressure: np.ndarray


def fly_falling(
    *,
    weight: bool,
    fall: float = 0.1,
    climb: float = 0.0,
    duration: float = 20.0,
    rate: float = 50.0,
    held: bool = False,
) -> FallingSpeed:
    """``fall`` is the share of the airspeed that is lost over the record, evenly, ``climb`` that of
    the air density; ``held`` holds the samples.
    """
    c, d = CONSTANTS, TRUE
    steps = 4
    h = 1.0 / rate / steps
    count = int(duration * rate) + 1

    def air(t: float) -> tuple[float, float]:
        return c["airspeed"] * (1.0 - fall * t / duration), c["air_density"] * (
            1.0 - climb * t / duration
        )

    lift0 = (
        c["mass"] * G / (0.5 * c["air_density"] * c["airspeed"] ** 2 * c["wing_area"])
        if weight
        else 0.0
    )

    def loads(t: float, de: float, a: float, q: float) -> tuple[float, float]:
        V, rho = air(t)
        force = 0.5 * rho * V * V * c["wing_area"]
        rate_hat = q * c["chord"] / (2.0 * V)
        CL = lift0 + d["CL_alpha"] * a + d["CL_q"] * rate_hat + d["CL_de"] * de
        Cm = d["Cm_alpha"] * a + d["Cm_q"] * rate_hat + d["Cm_de"] * de
        return force * CL, force * c["chord"] * Cm

    def rates(t: float, sample: float, x: np.ndarray) -> np.ndarray:
        theta, gamma, q = (float(value) for value in x)
        L, M = loads(t, sines(sample if held else t), theta - gamma, q)
        V, _ = air(t)
        turn = (L / c["mass"] - (G * math.cos(gamma) if weight else 0.0)) / V
        return np.array([q, turn, M / c["pitch_inertia"]])

    x, rows = np.zeros(3), []
    for k in range(count):
        t = k / rate
        L, _ = loads(t, sines(t), x[0] - x[1], x[2])
        V, rho = air(t)
        rows.append(
            (
                t,
                sines(t),
                x[0] - x[1],
                x[2],
                L / (c["mass"] * G) - (1.0 if weight else 0.0),
                V,
                0.5 * rho * V * V,
            )
        )
        for i in range(steps):
            at = t + i * h
            k1 = rates(at, t, x)
            k2 = rates(at + 0.5 * h, t, x + 0.5 * h * k1)
            k3 = rates(at + 0.5 * h, t, x + 0.5 * h * k2)
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rates(at + h, t, x + h * k3))
    return FallingSpeed(*np.array(rows).T)


def sines(t: float) -> float:
    """A smooth elevator that excites the short period and rests at the start, rad."""
    return (
        0.02
        * (math.sin(1.9 * t) + math.sin(3.7 * t + 1.0) + math.sin(6.1 * t + 2.0))
        * min(1.0, max(0.0, t - 1.0))
    )
