"""A second writing of the flexible aircraft: eqs. 26-30 as matrices in slugs and feet, integrated
by SciPy.

The numbers are those of the large swept-wing bomber at Mach 0.6 and 5000 ft; rows and columns are
modes 1 to 4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

FOOT = 0.3048  # m
SLUG = 14.593902937  # kg
GRAVITY = 9.80665 / FOOT  # ft/s2

MASS, PITCH_INERTIA, AREA, CHORD, SPEED, DENSITY = 8951.9, 6.4e6, 1946.0, 15.3, 658.3, 0.0020481
LIFT = {"alpha": 2.922, "q": -14.7, "de": 0.435}
MOMENT = {"alpha": -1.66, "q": -34.75, "de": -2.578}
FREQUENCY = np.array([12.57, 14.07, 21.17, 22.05])
DAMPING = 0.02
GENERALIZED_MASS = np.array([183.6, 9586.5, 1334.4, 43596.9])
LIFT_ETA = np.array([0.0288, -0.30, -0.0150, 0.014])
LIFT_ETADOT = np.array([0.0848, -0.34, -0.0617, 0.020])
MOMENT_ETA = np.array([-0.032, 0.138, 0.0379, -0.018])
MOMENT_ETADOT = np.array([-0.159, 0.156, 0.1609, -0.030])
FORCE_ALPHA = np.array([-0.014898, 0.17, 0.0320, -0.010])
FORCE_Q = np.array([-0.0949, 0.156, 0.2593, -0.030])
FORCE_DE = np.array([-0.012835, -0.004, 0.0257, 0.003])
FORCE_ETA = np.array(
    [
        [5.85e-5, -1e-4, -9.13e-5, 0.0],
        [2e-3, -0.06, 1e-3, 0.0],
        [2.94e-4, 1e-3, -3.33e-4, 0.0],
        [0.0, 0.0, 0.0, -0.010],
    ]
)
FORCE_ETADOT = np.array(
    [
        [-4.2e-4, 4e-4, 6.51e-4, 0.0],
        [-4e-3, -0.12, 0.0, 0.0],
        [-6.24e-4, 0.0, -2.20e-3, 0.0],
        [0.0, 0.0, 0.0, -0.050],
    ]
)


@dataclass(frozen=True, eq=False)
class Linear:
    """x_dot = A x + B [elevator, gust], y = C x + D [elevator, gust]; x = [alpha, q, eta..,
    etadot..], y = [alpha at the vane, q, nz].
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray


def flexible_aircraft(modes: int, frequency_factor: float = 1.0) -> Linear:
    """The aircraft with its first modes; AC2 of the paper has half the frequencies of AC1 (factor
    0.5).
    """
    n, slow = modes, CHORD / (2.0 * SPEED)
    # Rows: CL, Cm and the generalized forces; columns: states, then elevator and gust angle.
    loads = np.zeros((2 + n, 2 + 2 * n + 2))
    for row, coefficients in enumerate((LIFT, MOMENT)):
        loads[row, 0], loads[row, 1], loads[row, -2] = (
            coefficients["alpha"],
            coefficients["q"] * slow,
            coefficients["de"],
        )
    loads[0, 2 : 2 + n], loads[0, 2 + n : 2 + 2 * n] = LIFT_ETA[:n], LIFT_ETADOT[:n] * slow
    loads[1, 2 : 2 + n], loads[1, 2 + n : 2 + 2 * n] = MOMENT_ETA[:n], MOMENT_ETADOT[:n] * slow
    loads[2:, 0], loads[2:, 1], loads[2:, -2] = FORCE_ALPHA[:n], FORCE_Q[:n] * slow, FORCE_DE[:n]
    loads[2:, 2 : 2 + n], loads[2:, 2 + n : 2 + 2 * n] = (
        FORCE_ETA[:n, :n],
        FORCE_ETADOT[:n, :n] * slow,
    )
    loads[:, -1] = loads[:, 0]

    impact = 0.5 * DENSITY * SPEED**2 * AREA
    kinematics = np.zeros((2 + 2 * n, 2 + 2 * n + 2))
    kinematics[0, 1] = 1.0
    kinematics[2 : 2 + n, 2 + n : 2 + 2 * n] = np.eye(n)
    omega = frequency_factor * FREQUENCY[:n]
    kinematics[2 + n :, 2 : 2 + n] = -np.diag(omega**2)
    kinematics[2 + n :, 2 + n : 2 + 2 * n] = -np.diag(2.0 * DAMPING * omega)
    gains = np.zeros((2 + 2 * n, 2 + n))
    gains[0, 0] = -impact / (MASS * SPEED)
    gains[1, 1] = impact * CHORD / PITCH_INERTIA
    gains[2 + n :, 2:] = np.diag(impact * CHORD / GENERALIZED_MASS[:n])
    rates = kinematics + gains @ loads

    readings = np.zeros((3, 2 + 2 * n + 2))
    readings[0, 0] = readings[0, -1] = readings[1, 1] = 1.0
    readings[2] = impact / (MASS * GRAVITY) * loads[0]
    return Linear(rates[:, :-2], rates[:, -2:], readings[:, :-2], readings[:, -2:])


def respond(
    aircraft: Linear,
    time: np.ndarray,
    elevator: np.ndarray,
    gust: Callable[[float], float] | None = None,
) -> np.ndarray:
    """Outputs ``(3, N)`` to an elevator held between samples and a gust angle (rad) that is any
    function of time.
    """
    from scipy.integrate import solve_ivp

    blow = gust if gust is not None else (lambda t: 0.0)
    x = np.zeros(len(aircraft.A))
    outputs = np.empty((3, len(time)))
    for k, t in enumerate(time):
        outputs[:, k] = aircraft.C @ x + aircraft.D @ [elevator[k], blow(t)]
        if k + 1 < len(time):
            u = elevator[k]
            solution = solve_ivp(
                lambda s, z, u=u: aircraft.A @ z + aircraft.B @ [u, blow(s)],
                (t, time[k + 1]),
                x,
                method="DOP853",
                rtol=1e-10,
                atol=1e-13,
            )
            x = solution.y[:, -1]
    return outputs


def parameters_in_si(modes: int, frequency_factor: float = 1.0) -> dict[str, float]:
    """The same numbers by name, in SI."""
    values = {
        "mass": MASS * SLUG,
        "wing_area": AREA * FOOT**2,
        "chord": CHORD * FOOT,
        "pitch_inertia": PITCH_INERTIA * SLUG * FOOT**2,
        "airspeed": SPEED * FOOT,
        "air_density": DENSITY * SLUG / FOOT**3,
    }
    values |= {f"CL_{name}": value for name, value in LIFT.items()} | {
        f"Cm_{name}": value for name, value in MOMENT.items()
    }
    for i in range(modes):
        n = i + 1
        values |= {
            f"omega{n}": frequency_factor * FREQUENCY[i],
            f"zeta{n}": DAMPING,
            f"generalized_mass{n}": GENERALIZED_MASS[i] * SLUG * FOOT**2,
            f"CL_eta{n}": LIFT_ETA[i],
            f"CL_etadot{n}": LIFT_ETADOT[i],
            f"Cm_eta{n}": MOMENT_ETA[i],
            f"Cm_etadot{n}": MOMENT_ETADOT[i],
            f"Ceta{n}_alpha": FORCE_ALPHA[i],
            f"Ceta{n}_q": FORCE_Q[i],
            f"Ceta{n}_de": FORCE_DE[i],
        }
        for j in range(modes):
            values |= {
                f"Ceta{n}_eta{j + 1}": FORCE_ETA[i, j],
                f"Ceta{n}_etadot{j + 1}": FORCE_ETADOT[i, j],
            }
    return {name: float(value) for name, value in values.items()}
