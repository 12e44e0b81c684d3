"""Records of aircraft and bodies with something hidden in them, by simulators that share no
equation with the project.

Runge-Kutta in plain Python at 1 ms or less; what is hidden is a handful of functions. Every effect
is written here a second time, from its definition in words: an input path as a map of a finely
sampled signal, a sensor path likewise.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.signal import cont2discrete, lfilter

G0 = 9.80665
SIGMA = {"alpha": 0.0012, "q": 0.0015, "nz": 0.012}
# (fine step, signal held over each fine step) -> the same
Path1 = Callable[[float, np.ndarray], np.ndarray]
# (step, values at begin and end of each step) -> what is shown at the begin
Sensor = Callable[[float, np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Aircraft:
    """A rigid aircraft in numbers, SI."""

    name: str
    mass: float
    wing_area: float
    chord: float
    pitch_inertia: float
    airspeed: float
    air_density: float
    derivatives: Mapping[str, float]


TRAINER = Aircraft(
    "glider tug",
    1080.0,
    15.3,
    1.41,
    1640.0,
    58.0,
    1.05,
    dict(CL_alpha=5.3, CL_q=7.1, CL_de=0.40, Cm_alpha=-0.88, Cm_q=-15.0, Cm_de=-1.22),
)
FIGHTER = Aircraft(
    "jet trainer",
    5200.0,
    22.0,
    2.1,
    18500.0,
    145.0,
    0.88,
    dict(CL_alpha=4.6, CL_q=5.2, CL_de=0.48, Cm_alpha=-0.61, Cm_q=-11.5, Cm_de=-1.05),
)
LINER = Aircraft(
    "twin jet",
    54000.0,
    110.0,
    3.9,
    2.7e6,
    175.0,
    0.78,
    dict(CL_alpha=5.9, CL_q=9.5, CL_de=0.36, Cm_alpha=-1.35, Cm_q=-26.0, Cm_de=-1.55),
)


def nothing(t: float, alpha: float, q: float, elevator: float) -> float:
    return 0.0


@dataclass(frozen=True)
class Hidden:
    """What the declared model does not know.

    ``lift`` and ``moment`` add to CL and Cm as functions of (t, alpha felt, q, elevator); ``gust``
    in m/s up, ``speed`` in m/s over t; ``mode`` an elastic mode: frequency, damping, and the gains
    lift, moment, gyro of its coordinate, driven by the elevator and ``by_alpha``. ``changed`` are
    derivatives from a time on. Arms in m ahead; ``gyro_by_load`` in rad/s per g.
    """

    command: tuple[Path1, ...] = ()
    lift: Callable[[float, float, float, float], float] = nothing
    moment: Callable[[float, float, float, float], float] = nothing
    gust: Callable[[float], float] = lambda t: 0.0
    speed: Callable[[float], float] | None = None
    mode: Mapping[str, float] | None = None
    vane_arm: float = 0.0
    accelerometer_arm: float = 0.0
    gyro_by_load: float = 0.0
    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    drift: Mapping[str, float] = field(default_factory=dict)
    spikes: Mapping[str, Sequence[tuple[int, float]]] = field(default_factory=dict)
    changed: tuple[float, Mapping[str, float]] | None = None


def delayed(delay: float) -> Path1:
    """The signal a pure time later; over a step that a late switch falls into its mean."""

    def act(h: float, u: np.ndarray) -> np.ndarray:
        n, share = int(delay / h), delay / h % 1.0
        shifted = [np.concatenate([np.full(k, u[0]), u[: len(u) - k]]) for k in (n, n + 1)]
        return (1.0 - share) * shifted[0] + share * shifted[1]

    return act


def lagged(time_constant: float) -> Path1:
    """A first-order lag: exact means over the steps of a held signal."""

    def act(h: float, u: np.ndarray) -> np.ndarray:
        g = 1.0 - math.exp(-h / time_constant)
        y = np.asarray(lfilter([0.0, g], [1.0, g - 1.0], u - u[0])) + u[0]
        return u + (y - u) * g * time_constant / h

    return act


def dead(half_width: float) -> Path1:
    return lambda h, u: np.sign(u) * np.maximum(np.abs(u) - half_width, 0.0)


def limited(limit: float) -> Path1:
    return lambda h, u: np.clip(u, -limit, limit)


def rated(rate: float) -> Path1:
    """No faster than ``rate``."""

    def act(h: float, u: np.ndarray) -> np.ndarray:
        y, out = float(u[0]), np.empty(len(u))
        for i, wanted in enumerate(u.tolist()):
            move = max(-rate * h, min(rate * h, wanted - y))
            out[i] = y + 0.5 * move
            y += move
        return out

    return act


def slack(half_width: float) -> Path1:
    """Free play: the output rests until the input has crossed the gap."""

    def act(h: float, u: np.ndarray) -> np.ndarray:
        y, out = 0.0, np.empty(len(u))
        for i, wanted in enumerate(u.tolist()):
            y = max(wanted - half_width, min(wanted + half_width, y))
            out[i] = y
        return out

    return act


def scaled(factor: float) -> Sensor:
    return lambda h, begin, end: factor * begin


def shown_late(delay: float) -> Sensor:
    """A sensor whose readings are a pure time old; ``delay`` is rounded to the step."""
    return lambda h, begin, end: delayed(round(delay / h) * h)(h, begin)


def curved(curvature: float) -> Sensor:
    return lambda h, begin, end: begin + curvature * begin**2


def stepped(size: float, at: float) -> Sensor:
    return lambda h, begin, end: begin + size * (h * np.arange(len(begin)) > at)


def held(period: float, first: float = 0.0) -> Sensor:
    """Updated at ``first`` and every ``period`` s from there on, both whole numbers of steps."""

    def act(h: float, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        i, every, start = np.arange(len(begin)), round(period / h), round(first / h)
        return np.asarray(begin[np.where(i < start, 0, i - (i - start) % every)])

    return act


def shown_lagged(time_constant: float) -> Sensor:
    """A first-order sensor, exact where its input runs straight within a step and jumps between
    steps.
    """

    def act(h: float, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        e = math.exp(-h / time_constant)
        last = 1.0 - time_constant / h * (1.0 - e)
        y, out = float(begin[0]), [float(begin[0])]
        for a, b in zip(begin[:-1].tolist(), end.tolist(), strict=True):
            y = e * y + (1.0 - e - last) * a + last * b
            out.append(y)
        return np.array(out)

    return act


def dryden(
    rng: np.random.Generator,
    sigma: float,
    length: float,
    airspeed: float,
    duration: float,
    step: float = 0.01,
) -> Callable[[float], float]:
    """One draw of vertical Dryden turbulence, m/s, held over ``step`` s."""
    T = length / airspeed
    b, a = [sigma * math.sqrt(T) * math.sqrt(3.0) * T, sigma * math.sqrt(T)], [T * T, 2.0 * T, 1.0]
    num, den, _ = cont2discrete((b, a), step, "zoh")
    n = int(duration / step) + 200 + int(8 * T / step)
    w = lfilter(num.ravel(), den, rng.standard_normal(n) / math.sqrt(step))[int(8 * T / step) :]
    return lambda t: float(w[int(t / step)])


def steps(pattern: Sequence[tuple[float, float]], rate: float, duration: float) -> np.ndarray:
    """A command held between samples from ``(time, level)`` pairs, ``(N,)``."""
    time = np.arange(round(duration * rate) + 1) / rate
    u = np.zeros(len(time))
    for start, level in pattern:
        u[time > start - 1e-9] = level
    return u


def three_two_one_one(amplitude: float, unit: float, start: float) -> list[tuple[float, float]]:
    s, a = start, amplitude
    return [(s, a), (s + 3 * unit, -a), (s + 5 * unit, a), (s + 6 * unit, -a), (s + 7 * unit, 0.0)]


def doublet(amplitude: float, unit: float, start: float) -> list[tuple[float, float]]:
    return [(start, amplitude), (start + unit, -amplitude), (start + 2 * unit, 0.0)]


def fly_aircraft(
    aircraft: Aircraft, command: np.ndarray, rate: float, hidden: Hidden = Hidden()
) -> dict[str, np.ndarray]:
    """Time, elevator as recorded, alpha, q, nz without noise, ``(N,)`` each; ``command`` is the
    recorded, held elevator.
    """
    per = max(1, math.ceil(1.0 / (rate * 0.002)))
    fine = 4 * per
    h, hf = 1.0 / (rate * per), 1.0 / (rate * fine)
    u = np.repeat(command, fine)[: (len(command) - 1) * fine + 1]
    for act in hidden.command:
        u = act(hf, u)
    held = u[:-1].reshape(-1, 4).mean(axis=1).tolist()  # over each step
    # in the first and the last quarter of each step
    starts, ends = u[::4].tolist(), u[3::4].tolist()
    d, m, S, c, Iy, rho = (
        dict(aircraft.derivatives),
        aircraft.mass,
        aircraft.wing_area,
        aircraft.chord,
        aircraft.pitch_inertia,
        aircraft.air_density,
    )
    mode = hidden.mode
    speed, gust, lift, moment = hidden.speed, hidden.gust, hidden.lift, hidden.moment

    def loads(t: float, x: Sequence[float], e: float) -> tuple[float, float, float, float]:
        V = aircraft.airspeed if speed is None else speed(t)
        a, rate_hat = x[0] + gust(t) / aircraft.airspeed, x[1] * c / (2.0 * V)
        CL = d["CL_alpha"] * a + d["CL_q"] * rate_hat + d["CL_de"] * e + lift(t, a, x[1], e)
        Cm = d["Cm_alpha"] * a + d["Cm_q"] * rate_hat + d["Cm_de"] * e + moment(t, a, x[1], e)
        if mode is not None:
            CL, Cm = CL + mode["lift"] * x[2], Cm + mode["moment"] * x[2]
        return CL, Cm, V, a

    def slope(t: float, x: Sequence[float], e: float) -> tuple[float, ...]:
        CL, Cm, V, a = loads(t, x, e)
        Q = 0.5 * rho * V * V * S
        first = (x[1] - Q * CL / (m * V), Q * c * Cm / Iy)
        if mode is None:
            return first
        w = mode["frequency"]
        return (
            *first,
            x[3],
            w * w * (e + mode.get("by_alpha", 0.0) * a - x[2]) - 2.0 * mode["damping"] * w * x[3],
        )

    x: tuple[float, ...] = (0.0, 0.0) if mode is None else (0.0, 0.0, 0.0, 0.0)

    def shown(t: float, e: float) -> tuple[float, float, float]:
        CL, Cm, V, a = loads(t, x, e)
        Q = 0.5 * rho * V * V * S
        nz = Q * CL / (m * G0)
        gyro = hidden.gyro_by_load * nz + (mode["gyro"] * x[3] if mode is not None else 0.0)
        return (
            a - hidden.vane_arm / V * x[1],
            x[1] + gyro,
            nz + hidden.accelerometer_arm * Q * c * Cm / (Iy * G0),
        )

    rows, lasts = [], []
    for i in range(len(held) + 1):
        t, e = i * h, starts[i]
        if hidden.changed is not None and t >= hidden.changed[0] - 1e-9:
            d.update(hidden.changed[1])
        rows.append(shown(t + 1e-9, e))
        if i == len(held):
            break
        e = held[i]
        k1 = slope(t, x, e)
        k2 = slope(t + 0.5 * h, [p + 0.5 * h * k for p, k in zip(x, k1, strict=True)], e)
        k3 = slope(t + 0.5 * h, [p + 0.5 * h * k for p, k in zip(x, k2, strict=True)], e)
        k4 = slope(t + h, [p + h * k for p, k in zip(x, k3, strict=True)], e)
        x = tuple(
            p + h / 6.0 * (a1 + 2 * a2 + 2 * a3 + a4)
            for p, a1, a2, a3, a4 in zip(x, k1, k2, k3, k4, strict=True)
        )
        lasts.append(shown(t + h - 1e-9, ends[i]))
    y, y_end = np.array(rows).T, np.array(lasts).T
    out = {"time": np.arange(len(command)) / rate, "elevator": command}
    for row, last, name in zip(y, y_end, ("alpha", "q", "nz"), strict=True):
        values = hidden.sensors[name](h, row, last) if name in hidden.sensors else row
        out[name] = values[::per] + hidden.drift.get(name, 0.0) * out["time"]
    return out


def measured(
    flown: Mapping[str, np.ndarray],
    rng: np.random.Generator,
    sigma: Mapping[str, float],
    hidden: Hidden = Hidden(),
    tails: float = 0.0,
) -> dict[str, np.ndarray]:
    """With white noise of ``sigma``, Student's t of ``tails`` degrees of freedom where that is
    given (same variance), and spikes.
    """
    out = {
        name: np.array(flown[name])
        for name in flown
        if name in ("time", "elevator") or name in sigma
    }
    for name, std in sigma.items():
        n = len(out["time"])
        unit = (
            rng.standard_normal(n)
            if not tails
            else rng.standard_t(tails, n) * math.sqrt((tails - 2.0) / tails)
        )
        out[name] = out[name] + std * unit
        for at, size in hidden.spikes.get(name, ()):
            out[name][at] += size
    return out


def fly_body(
    beta: float,
    duration: float,
    rate: float,
    hidden: Mapping[str, float] | None = None,
    **world: float,
) -> dict[str, np.ndarray]:
    """Altitude of a body that falls: hidden ``scale_height`` (m), ``jump_time`` and
    ``jump_factor``, ``mach_rise`` (drag with speed) as given.
    """
    rho0, H, g = world.get("rho0", 1.225), world.get("H", 7160.0), world.get("g", 9.79)
    extra = dict(hidden or {})
    H = extra.get("scale_height", H)

    def drag(t: float, v: float) -> float:
        factor = extra.get("jump_factor", 1.0) if t >= extra.get("jump_time", math.inf) else 1.0
        return factor * (
            1.0 + extra.get("mach_rise", 0.0) * math.exp(-(((abs(v) / 320.0) - 1.1) ** 2) / 0.5)
        )

    per = max(1, math.ceil(1.0 / (rate * 0.005)))
    h = 1.0 / (rate * per)
    x, v = world.get("altitude", 55000.0), world.get("velocity", -1700.0)

    def push(t: float, z: float, s: float) -> float:
        return 0.5 * rho0 * math.exp(-z / H) * s * s * drag(t, s) / beta - g

    rows = []
    for i in range(round(duration * rate) * per + 1):
        t = i * h
        rows.append(x)
        a1 = push(t, x, v)
        a2 = push(t + h / 2, x + h / 2 * v, v + h / 2 * a1)
        a3 = push(t + h / 2, x + h / 2 * (v + h / 2 * a1), v + h / 2 * a2)
        a4 = push(t + h, x + h * (v + h / 2 * a2), v + h * a3)
        x, v = x + h * v + h * h / 6 * (a1 + a2 + a3), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    y = np.array(rows)[::per]
    return {"time": np.arange(len(y)) / rate, "altitude": y}


def wrong_start(aircraft: Aircraft, rng: np.random.Generator, by: float = 0.3) -> Aircraft:
    """The aircraft as a handbook has it: every derivative up to ``by`` wrong."""
    return replace(
        aircraft,
        derivatives={
            name: value * (1.0 + by * rng.uniform(-1.0, 1.0))
            for name, value in aircraft.derivatives.items()
        },
    )


def write_record(path: Path, columns: Mapping[str, np.ndarray]) -> Path:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(
            [f"{value:.9g}" if math.isfinite(value) else "" for value in row]
            for row in zip(*columns.values(), strict=True)
        )
    return path


def write_vehicle(path: Path, aircraft: Aircraft) -> Path:
    names = ("mass", "wing_area", "chord", "pitch_inertia", "airspeed", "air_density")
    lines = [
        f'name = "{aircraft.name}"',
        *(f"{name} = {getattr(aircraft, name)!r}" for name in names),
        "[derivatives]",
    ]
    lines += [f"{name} = {value!r}" for name, value in aircraft.derivatives.items()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
