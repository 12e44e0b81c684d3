"""Flights whose parameters are curves of a signal, by equations written again and SciPy's own
integrator between switches of the inputs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.integrate import solve_ivp

from sim.record import Channel, Record
from tests.bases import RIGID_VALUES
from tests.whole_axes import CONSTANTS, NOISE, TRUE

G0 = 9.80665
Law = Callable[[float], float]


def doublets(time: np.ndarray, parts: Sequence[tuple[float, float, float]]) -> np.ndarray:
    """Doublets of (start, width to each side, size)."""
    out = np.zeros(len(time))
    for start, width, size in parts:
        out += size * (((time >= start - 1e-9) & (time < start + width - 1e-9)) * 1.0)
        out -= size * (((time >= start + width - 1e-9) & (time < start + 2.0 * width - 1e-9)) * 1.0)
    return out


def moved(
    rates: Callable[[np.ndarray, np.ndarray], Sequence[float]],
    time: np.ndarray,
    u: np.ndarray,
    n: int,
) -> np.ndarray:
    """States ``(n, N)`` from rest under inputs held between samples."""
    x, out = np.zeros(n), [np.zeros(n)]
    for k in range(len(time) - 1):
        held = u[:, k]
        x = solve_ivp(
            lambda t, y, held=held: rates(y, held), (time[k], time[k + 1]), x, rtol=1e-8, atol=1e-10
        ).y[:, -1]
        out.append(x)
    return np.array(out).T


def recorded(
    time: np.ndarray,
    inputs: dict[str, tuple[str, np.ndarray]],
    outputs: dict[str, tuple[str, np.ndarray, float]],
    seed: int,
    name: str,
) -> Record:
    """A record with white noise on each output, of the size given."""
    rng = np.random.default_rng(seed)
    read = tuple(
        Channel.of(key, unit, values + std * rng.standard_normal(len(time)))
        for key, (unit, values, std) in outputs.items()
    )
    return Record(
        time,
        tuple(Channel.of(key, unit, values) for key, (unit, values) in inputs.items()),
        read,
        name=name,
    )


def lateral(share: dict[str, Law], seed: int, size: float = 1.0, duration: float = 20.0) -> Record:
    """The light twin of ``tests/whole_axes.py``; ``share`` : derivative -> its value over the
    declared one, by sideslip (rad).
    """
    c, d = CONSTANTS["lateral"], TRUE["lateral"]
    time = np.arange(round(duration * 25.0) + 1) / 25.0
    aileron = size * doublets(
        time, [(1.0, 0.8, 0.07), (7.0, 0.6, -0.09), (12.0, 0.8, 0.05), (15.0, 0.4, 0.1)]
    )
    rudder = size * doublets(
        time, [(3.0, 0.72, 0.1), (6.6, 1.0, 0.08), (10.0, 0.72, -0.12), (14.6, 0.8, 0.1)]
    )
    qS, half = (
        0.5 * c["air_density"] * c["airspeed"] ** 2 * c["wing_area"],
        c["span"] / (2.0 * c["airspeed"]),
    )
    inertia = np.array(
        [[c["roll_inertia"], -c["cross_inertia"]], [-c["cross_inertia"], c["yaw_inertia"]]]
    )

    def coefficients(x: np.ndarray, u: np.ndarray) -> list[float]:
        signals = {"beta": x[0], "p": x[1] * half, "r": x[2] * half, "da": u[0], "dr": u[1]}
        value = {name: d[name] * (share[name](x[0]) if name in share else 1.0) for name in d}
        return [
            sum(value.get(f"{axis}_{by}", 0.0) * signal for by, signal in signals.items())
            for axis in ("CY", "Cl", "Cn")
        ]

    def rates(x: np.ndarray, u: np.ndarray) -> list[float]:
        force, *moments = coefficients(x, u)
        p_dot, r_dot = np.linalg.solve(inertia, qS * c["span"] * np.array(moments))
        tilt = G0 / c["airspeed"] * np.cos(c["trim_theta"]) * x[3]
        turning = x[1] * np.sin(c["trim_alpha"]) - x[2] * np.cos(c["trim_alpha"]) + tilt
        return [
            qS * force / (c["mass"] * c["airspeed"]) + turning,
            p_dot,
            r_dot,
            x[1] + np.tan(c["trim_theta"]) * x[2],
        ]

    x = moved(rates, time, np.array([aileron, rudder]), 4)
    ny = np.array(
        [
            qS * coefficients(x[:, k], np.array([aileron[k], rudder[k]]))[0] / (c["mass"] * G0)
            for k in range(len(time))
        ]
    )
    units = {"beta": "rad", "p": "rad/s", "r": "rad/s", "phi": "rad", "ny": "g"}
    outputs = {
        name: (unit, values, NOISE["lateral"][name])
        for (name, unit), values in zip(units.items(), [*x, ny], strict=True)
    }
    return recorded(
        time,
        {"aileron": ("rad", aileron), "rudder": ("rad", rudder)},
        outputs,
        seed,
        f"lateral {seed}",
    )


def rigid(damping: Law, seed: int, size: float = 1.0) -> Record:
    """The aircraft of ``tests/bases.py``; ``damping`` : Cm_q over the declared one, by the angle of
    attack (rad).
    """
    v, time = RIGID_VALUES, np.arange(801) / 50.0
    elevator = size * doublets(
        time,
        [
            (1.0, 0.6, 0.06),
            (4.0, 1.0, -0.08),
            (7.0, 0.4, 0.1),
            (10.0, 1.2, -0.05),
            (13.0, 0.5, 0.07),
        ],
    )
    qS, half = (
        0.5 * v["air_density"] * v["airspeed"] ** 2 * v["wing_area"],
        v["chord"] / (2.0 * v["airspeed"]),
    )

    def lift(x: np.ndarray, e: float) -> float:
        return float(v["CL_alpha"] * x[0] + v["CL_q"] * x[1] * half + v["CL_de"] * e)

    def rates(x: np.ndarray, u: np.ndarray) -> list[float]:
        moment = v["Cm_alpha"] * x[0] + v["Cm_q"] * damping(x[0]) * x[1] * half + v["Cm_de"] * u[0]
        return [
            x[1] - qS * lift(x, u[0]) / (v["mass"] * v["airspeed"]),
            qS * v["chord"] * moment / v["pitch_inertia"],
        ]

    x = moved(rates, time, elevator[None], 2)
    nz = np.array([qS * lift(x[:, k], elevator[k]) / (v["mass"] * G0) for k in range(len(time))])
    outputs = {"alpha": ("rad", x[0], 0.002), "q": ("rad/s", x[1], 0.002), "nz": ("g", nz, 0.01)}
    return recorded(time, {"elevator": ("rad", elevator)}, outputs, seed, f"rigid {seed}")


Push = Callable[[float, np.ndarray, float], float]


def spring(
    stiffness: Law,
    seed: int,
    size: float = 1.0,
    damping: Law = lambda x: 1.0,
    extra: Push = lambda t, x, f: 0.0,
) -> Record:
    """2 kg on a spring of ``stiffness`` (N/m) with ``damping`` (N s/m), both by displacement (m),
    under pulses of force.

    ``extra`` : a force (N) that nobody declared, of time (s), of displacement, speed and a
    displacement that follows late by .6 s, and of the recorded force.
    """
    time = np.arange(401) / 20.0
    pulses = [(1.0, 4.0, 20.0), (9.0, 10.5, -15.0), (13.0, 14.0, 30.0)]
    force = size * np.sum(
        [
            np.where((time >= begin - 1e-9) & (time < end - 1e-9), value, 0.0)
            for begin, end, value in pulses
        ],
        axis=0,
    )

    def push(t: float, x: np.ndarray, f: float) -> float:
        return float((f + extra(t, x, f) - damping(x[0]) * x[1] - stiffness(x[0]) * x[0]) / 2.0)

    def rates(x: np.ndarray, u: np.ndarray) -> list[float]:
        return [x[1], push(x[3], x, u[0]), (x[0] - x[2]) / 0.6, 1.0]

    x = moved(rates, time, np.atleast_2d(force), 4)
    pushed = np.array([push(time[k], x[:, k], force[k]) for k in range(len(time))])
    return recorded(
        time,
        {"force": ("N", force)},
        {"x": ("m", x[0], 0.003), "acceleration": ("m/s2", pushed, 0.05)},
        seed,
        f"spring {seed}",
    )
