"""The equations of a lateral and of a whole longitudinal motion written a second time, their roots
by differences and a companion matrix.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

G = 9.80665


def lateral_roots(c: Mapping[str, float], d: Mapping[str, float]) -> np.ndarray:
    """Roots (1/s) of beta, p, r, phi from dimensional derivatives; a derivative that is not in
    ``d`` is zero.
    """
    V, S, b = c["airspeed"], c["wing_area"], c["span"]
    pressure = 0.5 * c["air_density"] * V**2
    inertia = np.array(
        [[c["roll_inertia"], -c["cross_inertia"]], [-c["cross_inertia"], c["yaw_inertia"]]]
    )

    def row(axis: str) -> np.ndarray:
        return np.array(
            [
                d.get(f"{axis}_beta", 0.0),
                d.get(f"{axis}_p", 0.0) * b / (2 * V),
                d.get(f"{axis}_r", 0.0) * b / (2 * V),
                0.0,
            ]
        )

    turning = np.linalg.solve(inertia, pressure * S * b * np.array([row("Cl"), row("Cn")]))
    A = np.zeros((4, 4))
    A[0] = pressure * S / (c["mass"] * V) * row("CY") + [
        0.0,
        np.sin(c["trim_alpha"]),
        -np.cos(c["trim_alpha"]),
        G / V * np.cos(c["trim_theta"]),
    ]
    A[1:3] = turning
    A[3, 1:3] = 1.0, np.tan(c["trim_theta"])
    return np.roots(np.poly(A))


def longitudinal_roots(
    c: Mapping[str, float], d: Mapping[str, float], level: tuple[float, float, float]
) -> np.ndarray:
    """Roots (1/s) of V, alpha, theta, q about level flight at ``level`` (alpha, elevator, thrust),
    by central differences.
    """
    V0 = c["reference_airspeed"]

    def rates(x: np.ndarray) -> np.ndarray:
        V, alpha, theta, q = x
        force = 0.5 * c["air_density"] * V**2 * c["wing_area"]

        def coefficient(axis: str) -> float:
            by = {
                "0": 1.0,
                "V": V / V0,
                "alpha": alpha,
                "q": q * c["chord"] / (2 * V0),
                "de": level[1],
            }
            return sum(d.get(f"{axis}_{name}", 0.0) * value for name, value in by.items())

        lift, drag, moment = (
            force * coefficient("CL"),
            force * coefficient("CD"),
            force * c["chord"] * coefficient("Cm"),
        )
        climb = theta - alpha
        along = level[2] * np.cos(alpha) - drag - c["mass"] * G * np.sin(climb)
        across = lift + level[2] * np.sin(alpha) - c["mass"] * G * np.cos(climb)
        return np.array(
            [
                along / c["mass"],
                q - across / (c["mass"] * V),
                q,
                (moment + level[2] * c["thrust_arm"]) / c["pitch_inertia"],
            ]
        )

    centre, steps = np.array([V0, level[0], level[0], 0.0]), np.array([1e-3, 1e-6, 1e-6, 1e-6])
    columns = [
        (rates(centre + h * unit) - rates(centre - h * unit)) / (2 * h)
        for h, unit in zip(steps, np.eye(4), strict=True)
    ]
    assert np.max(np.abs(rates(centre))) < 1e-9
    return np.linalg.eigvals(np.array(columns).T)
