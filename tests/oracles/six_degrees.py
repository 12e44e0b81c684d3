"""Flight in six degrees of freedom over a flat earth by equations of its own: direction cosines,
velocity along earth axes, forces in newtons.

The attitude is a matrix and the velocity stands in earth axes (north, east, down), so that no angle
is integrated and no equation is shared with the kinematics under test; angles and rates are read
from the motion as instruments would.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp

from sim.record import Channel, Record

G = 9.80665
MASS, INERTIA = (
    6000.0,
    np.array([[14000.0, 0.0, -1100.0], [0.0, 22000.0, 0.0], [-1100.0, 0.0, 33000.0]]),
)
AREA, CHORD, SPAN, DENSITY, SPEED = 24.0, 2.2, 12.0, 0.95, 130.0
DEGREE = math.pi / 180.0
FINE = 0.01  # s
UNITS = {
    "alpha": "rad",
    "beta": "rad",
    "airspeed": "m/s",
    "p": "rad/s",
    "q": "rad/s",
    "r": "rad/s",
    "phi": "rad",
    "theta": "rad",
    "psi": "rad",
} | {**{"ax": "m/s2", "ay": "m/s2", "az": "m/s2", "nz": "g", "ny": "g", "nx": "g", "height": "m"}}
NOISE = (
    {name: 0.15 * DEGREE for name in ("alpha", "beta", "p", "q", "r")}
    | {name: 0.2 * DEGREE for name in ("phi", "theta", "psi")}
    | {
        **{
            "airspeed": 0.3,
            "ax": 0.05,
            "ay": 0.05,
            "az": 0.1,
            "nz": 0.01,
            "ny": 0.005,
            "nx": 0.005,
            "height": 1.0,
        }
    }
)
WHOLE = (
    "p",
    "q",
    "r",
    "ax",
    "ay",
    "az",
    "phi",
    "theta",
    "psi",
    "airspeed",
    "alpha",
    "beta",
    "height",
)
LATERAL = ("beta", "p", "r", "phi", "ny")


@dataclass(frozen=True)
class Faults:
    """What is wrong with the channels. ``vanes``: position (m, ahead, right, below) of alpha's and
    beta's; ``accelerometers``: of each.
    """

    delay: Mapping[str, float] = field(default_factory=dict)
    lag: Mapping[str, float] = field(default_factory=dict)
    scale: Mapping[str, float] = field(default_factory=dict)
    bias: Mapping[str, float] = field(default_factory=dict)
    drift: Mapping[str, float] = field(default_factory=dict)
    vanes: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    accelerometers: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)


def _soft(t: float, edges: tuple[tuple[float, float], ...]) -> float:
    return sum(
        size / (1.0 + math.exp(-min(max((t - at) / 0.03, -40.0), 40.0))) for at, size in edges
    )


_ELEVATOR = (
    (1.0, 1.0),
    (2.5, -2.0),
    (3.5, 2.0),
    (4.0, -2.0),
    (4.5, 1.0),
    (13.0, -0.6),
    (14.0, 1.2),
    (15.0, -0.6),
)
_AILERON = (
    (5.5, 1.0),
    (6.5, -2.0),
    (7.5, 1.0),
    (10.0, -0.7),
    (11.0, 0.7),
    (16.0, 1.0),
    (16.8, -1.0),
    (18.2, -1.0),
    (19.0, 1.0),
)
_RUDDER = ((8.0, 1.0), (8.7, -2.0), (9.4, 2.0), (9.8, -2.0), (10.2, 1.0), (17.0, -1.0), (17.8, 1.0))


def controls(t: float) -> tuple[float, float, float]:
    """Elevator, aileron and rudder, rad."""
    return 0.04 * _soft(t, _ELEVATOR), 0.06 * _soft(t, _AILERON), 0.06 * _soft(t, _RUDDER)


def _loads(
    air: np.ndarray,
    rates: np.ndarray,
    moved: tuple[float, float, float],
    trim: float,
    thrust: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Force and moment along body axes."""
    u, v, w = air
    speed = math.sqrt(u * u + v * v + w * w)
    a, b = math.atan2(w, u), math.asin(v / speed)
    elevator, aileron, rudder = moved
    p, q, r = rates * np.array([SPAN, CHORD, SPAN]) / (2.0 * speed)
    pressure = 0.5 * DENSITY * speed**2 * AREA
    lift = pressure * (5.0 * a + 0.45 * elevator + 6.0 * q)
    drag = pressure * (0.03 + 0.06 * (5.0 * a) ** 2 + 0.3 * b * b)
    side = pressure * (-0.8 * b + 0.2 * rudder + 0.3 * r)
    force = np.array(
        [
            thrust - drag * math.cos(a) + lift * math.sin(a),
            side,
            -lift * math.cos(a) - drag * math.sin(a),
        ]
    )
    roll = SPAN * (-0.09 * b - 0.45 * p + 0.12 * r + 0.12 * aileron + 0.01 * rudder)
    pitch = CHORD * (-0.7 * (a - trim) - 1.1 * elevator - 12.0 * q)
    yaw = SPAN * (0.12 * b - 0.03 * p - 0.2 * r - 0.005 * aileron - 0.07 * rudder)
    return force, pressure * np.array([roll, pitch, yaw])


@functools.cache
def fly(
    duration: float = 20.0,
    wind: tuple[float, float, float] = (6.0, -4.0, 0.0),
    gusts: float = 0.0,
    seed: int = 0,
    level: bool = False,
) -> Mapping[str, np.ndarray]:
    """The true motion every ``FINE`` s from level trim, in a steady wind (north, east, down, m/s).

    ``gusts``: m/s, root mean square of each component of air that moves beside it, by a ``seed``.
    ``level``: by the elevator alone.
    """
    start = 0.5 * DENSITY * SPEED**2 * AREA
    trim = MASS * G / (start * 5.0)
    thrust = start * (0.03 + 0.06 * (5.0 * trim) ** 2)
    gravity, inverse, rng = (
        np.array([0.0, 0.0, G]),
        np.linalg.inv(INERTIA),
        np.random.default_rng(seed),
    )
    rates_of, phases = np.geomspace(0.3, 8.0, 24), rng.uniform(0.0, 2.0 * math.pi, (3, 24))
    sizes = gusts * rng.standard_normal((3, 24)) / math.sqrt(12.0)
    controls_at = (lambda t: (controls(t)[0], 0.0, 0.0)) if level else controls

    def blowing(t: float) -> np.ndarray:
        return (
            np.asarray(wind + np.sum(sizes * np.sin(rates_of * t + phases), axis=1))
            if gusts
            else np.array(wind)
        )

    def slope(t: float, s: np.ndarray) -> np.ndarray:
        velocity, rates, to_earth = s[:3], s[3:6], s[6:15].reshape(3, 3)
        force, moment = _loads(
            to_earth.T @ (velocity - blowing(t)), rates, controls_at(t), trim, thrust
        )
        p, q, r = rates
        spin = np.array([[0.0, -r, q], [r, 0.0, -p], [-q, p, 0.0]])
        turned = inverse @ (moment - np.cross(rates, INERTIA @ rates))
        return np.concatenate(
            [to_earth @ force / MASS + gravity, turned, (to_earth @ spin).ravel(), velocity]
        )

    attitude = np.array(
        [
            [math.cos(trim), 0.0, math.sin(trim)],
            [0.0, 1.0, 0.0],
            [-math.sin(trim), 0.0, math.cos(trim)],
        ]
    )
    first = np.concatenate(
        [
            np.array([SPEED, 0.0, 0.0]) + blowing(0.0),
            np.zeros(3),
            attitude.ravel(),
            [0.0, 0.0, -1500.0],
        ]
    )
    time = np.arange(round(duration / FINE) + 1) * FINE
    states = solve_ivp(
        slope,
        (0.0, duration),
        first,
        t_eval=time,
        rtol=1e-8,
        atol=1e-8,
        max_step=0.05,
        method="DOP853",
    ).y
    out = {
        name: np.empty(len(time))
        for name in (*UNITS, "elevator", "aileron", "rudder", "p_dot", "q_dot", "r_dot")
    }
    for k, t in enumerate(time):
        s = states[:, k]
        to_earth = s[6:15].reshape(3, 3)
        air = to_earth.T @ (s[:3] - blowing(t))
        force, _ = _loads(air, s[3:6], controls_at(t), trim, thrust)
        speed = float(np.linalg.norm(air))
        row = {
            "airspeed": speed,
            "alpha": math.atan2(air[2], air[0]),
            "beta": math.asin(air[1] / speed),
            "height": -s[17],
        }
        row |= dict(zip("pqr", s[3:6].tolist(), strict=True)) | dict(
            zip(("p_dot", "q_dot", "r_dot"), slope(t, s)[3:6].tolist(), strict=True)
        )
        row |= dict(zip(("ax", "ay", "az"), (force / MASS).tolist(), strict=True)) | dict(
            zip(("elevator", "aileron", "rudder"), controls_at(t), strict=True)
        )
        row |= {"nx": row["ax"] / G, "ny": row["ay"] / G, "nz": -row["az"] / G}
        row |= {
            "theta": -math.asin(to_earth[2, 0]),
            "phi": math.atan2(to_earth[2, 1], to_earth[2, 2]),
        }
        row["psi"] = math.atan2(to_earth[1, 0], to_earth[0, 0])
        for name, value in row.items():
            out[name][k] = value
    return out


def _felt(flown: Mapping[str, np.ndarray], name: str, at: tuple[float, float, float]) -> np.ndarray:
    """What an accelerometer feels at a position: omega_dot x r + omega x (omega x r) more than at
    the centre of gravity.
    """
    omega, turned = (np.array([flown[f"{rate}{dot}"] for rate in "pqr"]).T for dot in ("", "_dot"))
    more = np.cross(turned, at) + np.cross(omega, np.cross(omega, at))
    axis = "xyz".index(name[1])
    return np.asarray(
        flown[name] + more[:, axis] * (1.0 if name[0] == "a" else (-1.0 if axis == 2 else 1.0) / G)
    )


def _at_vane(
    flown: Mapping[str, np.ndarray], name: str, at: tuple[float, float, float]
) -> np.ndarray:
    """The flow's angle where the vane is: the air's velocity there is that at the centre of gravity
    and omega x r, over the airspeed.
    """
    there = np.cross(np.array([flown[rate] for rate in "pqr"]).T, at) / flown["airspeed"][:, None]
    return np.asarray(flown[name] + there[:, 2 if name == "alpha" else 1])


def shown(
    flown: Mapping[str, np.ndarray],
    channels: tuple[str, ...],
    faults: Faults,
    seed: int,
    rate: float = 25.0,
    noise: float = 1.0,
) -> Record:
    """What the sensors record at ``rate`` samples a second, with white noise; a heading between 0
    and 2 pi.
    """
    rng, fine = np.random.default_rng(seed), np.arange(len(flown["alpha"])) * FINE
    time = np.arange(round(fine[-1] * rate) + 1) / rate
    out = []
    for name in channels:
        y = flown[name]
        if name in faults.vanes:
            y = _at_vane(flown, name, faults.vanes[name])
        if name in faults.accelerometers:
            y = _felt(flown, name, faults.accelerometers[name])
        y = np.unwrap(y) if name in ("psi", "phi") else y
        if name in faults.lag:
            # The solution of a first-order lag of straight pieces.
            ratio, slow = FINE / faults.lag[name], np.empty_like(y)
            value, keep = y[0], math.exp(-ratio)
            for i in range(len(y)):
                before = y[max(i - 1, 0)]
                value = (
                    keep * value
                    + (1.0 - keep) * before
                    + (y[i] - before) * (1.0 - (1.0 - keep) / ratio)
                )
                slow[i] = value
            y = slow
        y = np.interp(time - faults.delay.get(name, 0.0), fine, y)
        y = (
            faults.scale.get(name, 1.0) * y
            + faults.bias.get(name, 0.0)
            + faults.drift.get(name, 0.0) * time
        )
        y = y + noise * NOISE[name] * rng.standard_normal(len(time))
        out.append(Channel.of(name, UNITS[name], np.mod(y, 2.0 * math.pi) if name == "psi" else y))
    return Record(time, (), tuple(out), name=f"flight {seed}")
