"""Longitudinal flight over a flat earth by equations of its own: velocities along body axes, forces
in newtons, gravity as a vector.

Written from Newton's law, without angle of attack or path as states, so that it shares no equation
with the kinematics under test.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

G = 9.80665
FINE = 0.002  # s
UNITS = {"alpha": "rad", "q": "rad/s", "nz": "g", "theta": "rad", "airspeed": "m/s", "ax": "m/s2"}


@dataclass(frozen=True)
class Sensors:
    """What is wrong with the channels, each mapping by channel; ``arm`` m, the vane ahead of the
    centre of gravity.
    """

    delay: Mapping[str, float] = field(default_factory=dict)
    lag: Mapping[str, float] = field(default_factory=dict)
    scale: Mapping[str, float] = field(default_factory=dict)
    bias: Mapping[str, float] = field(default_factory=dict)
    drift: Mapping[str, float] = field(default_factory=dict)
    arm: float = 0.0


def pulses(t: float) -> float:
    """A 3-2-1-1 of the elevator and a doublet with soft edges, rad."""
    edges = [
        (1.0, 1.0),
        (2.5, -2.0),
        (3.5, 2.0),
        (4.0, -2.0),
        (4.5, 1.0),
        (9.0, -0.6),
        (10.0, 1.2),
        (11.0, -0.6),
    ]
    return 0.05 * sum(
        size / (1.0 + math.exp(-(t - at) / 0.03))
        if abs(t - at) < 1.0
        else (size if t > at else 0.0)
        for at, size in edges
    )


def fly(
    duration: float = 20.0, speed: float = 130.0, elevator: Callable[[float], float] = pulses
) -> dict[str, np.ndarray]:
    """The true motion every ``FINE`` s of an aircraft in trim at the start."""
    mass, inertia, area, chord, density = 6000.0, 22000.0, 24.0, 2.2, 0.95
    start = 0.5 * density * speed**2 * area
    trim = mass * G / (start * 5.0)
    thrust = start * (0.03 + 0.06 * (5.0 * trim) ** 2)

    def forces(t: float, u: float, w: float, q: float) -> tuple[float, float, float]:
        v2, a = u * u + w * w, math.atan2(w, u)
        pressure, hat = 0.5 * density * v2 * area, q * chord / (2.0 * math.sqrt(v2))
        lift = pressure * (5.0 * a + 0.45 * elevator(t) + 6.0 * hat)
        drag = pressure * (0.03 + 0.06 * (5.0 * a) ** 2)
        x = thrust - drag * math.cos(a) + lift * math.sin(a)
        z = -lift * math.cos(a) - drag * math.sin(a)
        return x, z, pressure * chord * (-0.7 * (a - trim) - 1.1 * elevator(t) - 12.0 * hat)

    def slope(t: float, s: tuple[float, ...]) -> tuple[float, ...]:
        u, w, q, theta = s
        x, z, moment = forces(t, u, w, q)
        return (
            -q * w + x / mass - G * math.sin(theta),
            q * u + z / mass + G * math.cos(theta),
            moment / inertia,
            q,
        )

    s: tuple[float, ...] = (speed * math.cos(trim), speed * math.sin(trim), 0.0, trim)
    rows = []
    for i in range(round(duration / FINE) + 1):
        t = i * FINE
        x, z, _ = forces(t, *s[:3])
        rows.append(
            (t, math.atan2(s[1], s[0]), s[2], -z / mass / G, s[3], math.hypot(s[0], s[1]), x / mass)
        )
        k1 = slope(t, s)
        k2 = slope(t + 0.5 * FINE, tuple(a + 0.5 * FINE * b for a, b in zip(s, k1, strict=True)))
        k3 = slope(t + 0.5 * FINE, tuple(a + 0.5 * FINE * b for a, b in zip(s, k2, strict=True)))
        k4 = slope(t + FINE, tuple(a + FINE * b for a, b in zip(s, k3, strict=True)))
        s = tuple(
            a + FINE / 6.0 * (b + 2.0 * c + 2.0 * d + e)
            for a, b, c, d, e in zip(s, k1, k2, k3, k4, strict=True)
        )
    return dict(
        zip(("time", "alpha", "q", "nz", "theta", "airspeed", "ax"), np.array(rows).T, strict=True)
    )


def shown(
    flown: Mapping[str, np.ndarray],
    rate: float,
    sensors: Sensors,
    sigma: Mapping[str, float],
    rng: np.random.Generator,
) -> dict[str, np.ndarray]:
    """What the sensors record at ``rate`` samples a second, with white noise."""
    t = flown["time"]
    time = np.arange(round(t[-1] * rate) + 1) / rate
    out = {"time": time}
    for name, std in sigma.items():
        y = flown[name]
        if name == "alpha" and sensors.arm:
            y = y - sensors.arm / flown["airspeed"] * flown["q"]
        if name in sensors.lag:
            share, slow = 1.0 - math.exp(-FINE / sensors.lag[name]), np.empty_like(y)
            value = y[0]
            for i, now in enumerate(y.tolist()):
                value += share * (now - value)
                slow[i] = value
            y = slow
        y = np.interp(time - sensors.delay.get(name, 0.0), t, y)
        y = (
            sensors.scale.get(name, 1.0) * y
            + sensors.bias.get(name, 0.0)
            + sensors.drift.get(name, 0.0) * time
        )
        out[name] = y + std * rng.standard_normal(len(time))
    return out
