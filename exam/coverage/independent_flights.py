"""Flights for the coverage of the estimators, by equations, integration, noise and gusts of their
own: nothing of `sim` is used.

Rigid short period: alpha and q about trim, as a pair of linear equations. Lateral: the moment
equation solved with the inertia matrix (Etkin and Reid, Dynamics of Flight, 3rd ed., section
4.9). Longitudinal: body axes u, w, q, theta (Nelson, Flight Stability and Automatic Control, 2nd
ed., section 3.2). Runge-Kutta of fourth order on ten steps a sample; inputs are held between
samples.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

G = 9.80665
RATE = 50.0  # samples a second
FINE = 10  # integration steps a sample
MEMORY = 0.9  # correlation of neighbouring samples of AR(1) noise
GUST_SIGMA, GUST_LENGTH = 1.0, 150.0  # m/s and m
START_ERROR = 0.3  # share by which starting derivatives are wrong, at most
MODELS = ("rigid", "lateral", "longitudinal")
NOISES = ("white", "ar1", "markov-gusts", "dryden-gusts")
_NUMBERS = {
    "rigid": 1,
    "lateral": 2,
    "longitudinal": 3,
    "white": 1,
    "ar1": 2,
    "markov-gusts": 3,
    "dryden-gusts": 4,
}

DURATION = {"rigid": 12.0, "lateral": 15.0, "longitudinal": 20.0}
CONSTANTS: Mapping[str, Mapping[str, float]] = {
    "rigid": {
        **{"mass": 2100.0, "wing_area": 18.2, "chord": 1.65, "pitch_inertia": 3900.0},
        **{"airspeed": 62.0, "air_density": 1.1},
    },
    "lateral": {
        **{
            "mass": 2100.0,
            "wing_area": 18.2,
            "span": 11.4,
            "roll_inertia": 4300.0,
            "yaw_inertia": 6900.0,
            "cross_inertia": 210.0,
        },
        **{"airspeed": 62.0, "air_density": 1.1, "trim_alpha": 0.05, "trim_theta": 0.03},
    },
    "longitudinal": {
        **{
            "mass": 2100.0,
            "wing_area": 18.2,
            "chord": 1.65,
            "pitch_inertia": 3900.0,
            "air_density": 1.1,
        },
        **{"reference_airspeed": 62.0, "thrust_arm": -0.1},
    },
}
TRUE: Mapping[str, Mapping[str, float]] = {
    "rigid": {
        "CL_alpha": 4.9,
        "CL_q": 7.0,
        "CL_de": 0.4,
        "Cm_alpha": -0.9,
        "Cm_q": -14.0,
        "Cm_de": -1.2,
    },
    "lateral": {
        **{
            "CY_beta": -0.65,
            "CY_dr": 0.19,
            "Cl_beta": -0.09,
            "Cl_p": -0.47,
            "Cl_r": 0.14,
            "Cl_da": 0.16,
        },
        **{"Cn_beta": 0.09, "Cn_p": -0.04, "Cn_r": -0.15, "Cn_dr": -0.085},
    },
    "longitudinal": {
        **{"CD_0": 0.03, "CD_alpha": 0.24, "CL_0": 0.3, "CL_alpha": 4.9, "CL_de": 0.4},
        **{"Cm_0": 0.05, "Cm_alpha": -0.9, "Cm_q": -14.0, "Cm_de": -1.2},
    },
}
SENSORS: Mapping[str, Mapping[str, float]] = {
    "rigid": {"alpha": 0.002, "q": 0.002, "nz": 0.01},
    "lateral": {"beta": 0.002, "p": 0.003, "r": 0.002, "phi": 0.003, "ny": 0.008},
    "longitudinal": {
        "airspeed": 0.25,
        "alpha": 0.002,
        "theta": 0.002,
        "q": 0.002,
        "nz": 0.012,
        "nx": 0.004,
    },
}
UNITS = {
    **dict.fromkeys(("alpha", "beta", "theta", "phi", "elevator", "aileron", "rudder"), "rad"),
    **dict.fromkeys("pqr", "rad/s"),
    **{"airspeed": "m/s", "thrust": "N", "nx": "g", "ny": "g", "nz": "g", "time": "s"},
}


@dataclass(frozen=True, eq=False)
class Flight:
    """A measured flight: ``columns`` by header (``"alpha [rad]"``), what a vehicle file says.

    ``start`` are the wrong derivatives of the vehicle file, ``true`` the right ones.
    """

    columns: Mapping[str, np.ndarray]
    vehicle: Mapping[str, str | float]
    start: Mapping[str, float]
    true: Mapping[str, float]


def flown(model: str, noise: str, run: int) -> Flight:
    """Flight number ``run`` of a model in one kind of noise; the same arguments give the same
    bytes.
    """
    rng = np.random.default_rng([35, _NUMBERS[model], _NUMBERS[noise], run])
    time, inputs = maneuver(model)
    share = rng.uniform(1.0 - START_ERROR, 1.0 + START_ERROR, len(TRUE[model]))
    start = {
        name: float(value * by)
        for (name, value), by in zip(TRUE[model].items(), share, strict=True)
    }
    gust = None
    if noise.endswith("gusts"):
        spectrum = markov if noise.startswith("markov") else dryden
        gust = spectrum(rng, (len(time) - 1) * FINE + 1, 1.0 / (RATE * FINE), _airspeed(model))
    outputs = _calm(model) if gust is None else motion(model, time, inputs, gust)
    sensor = ar1 if noise == "ar1" else white
    columns = {"time [s]": time, **{f"{name} [{UNITS[name]}]": row for name, row in inputs.items()}}
    for name, std in SENSORS[model].items():
        columns[f"{name} [{UNITS[name]}]"] = outputs[name] + std * sensor(rng, len(time))
    return Flight(columns, {"name": "light twin", **CONSTANTS[model]}, start, TRUE[model])


def white(rng: np.random.Generator, count: int) -> np.ndarray:
    """Independent standard normal numbers ``(count,)``."""
    return rng.standard_normal(count)


def ar1(rng: np.random.Generator, count: int, memory: float = MEMORY) -> np.ndarray:
    """A stationary first-order autoregression of variance one, ``(count,)``."""
    out = rng.standard_normal(count)
    fresh = math.sqrt(1.0 - memory * memory)
    for k in range(1, count):
        out[k] = memory * out[k - 1] + fresh * out[k]
    return out


def markov(rng: np.random.Generator, count: int, step: float, airspeed: float) -> np.ndarray:
    """First-order (Ornstein and Uhlenbeck) gusts ``(count,)`` in m/s, correlated over
    ``GUST_LENGTH``.
    """
    return GUST_SIGMA * ar1(rng, count, math.exp(-step * airspeed / GUST_LENGTH))


def dryden(rng: np.random.Generator, count: int, step: float, airspeed: float) -> np.ndarray:
    """Dryden's vertical gusts ``(count,)`` in m/s: white noise through sigma sqrt(T) (1 + sqrt(3) T
    s)/(1 + T s)^2, T = length/V.

    The gust and a state of half its memory are integrated as x'' = -2 x'/T - x/T^2 + noise/T^2 in
    small steps, from their stationary covariance: of x with unit noise density 1/(4 T), of x'
    1/(4 T^3).
    """
    T, h = GUST_LENGTH / airspeed, step
    # Exact transition over a step of the critically damped oscillator; the noise's covariance from
    # that of the stationary motion.
    decay = math.exp(-h / T)
    F = decay * np.array([[1.0 + h / T, h], [-h / T**2, 1.0 - h / T]])
    stationary = np.diag([1.0 / (4.0 * T), 1.0 / (4.0 * T**3)])
    values, vectors = np.linalg.eigh(stationary - F @ stationary @ F.T)
    fresh = rng.standard_normal((count, 2)) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
    x = np.sqrt(np.diag(stationary)) * rng.standard_normal(2)
    out = np.empty(count)
    gain = GUST_SIGMA * math.sqrt(T)
    for k in range(count):
        out[k] = gain * (x[0] + math.sqrt(3.0) * T * x[1])
        x = F @ x + fresh[k]
    return out


def maneuver(model: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Sample times and held inputs: a 3-2-1-1 and doublets."""
    time = np.arange(round(DURATION[model] * RATE) + 1) / RATE

    def steps(*edges: tuple[float, float]) -> np.ndarray:
        return sum((size * (time >= at - 1e-9) for at, size in edges), np.zeros(len(time)))

    if model == "rigid":
        return time, {
            "elevator": 0.035
            * steps(
                (1.0, 1), (2.5, -2), (3.5, 2), (4.0, -2), (4.5, 1), (7.5, -1), (8.2, 2), (8.9, -1)
            )
        }
    if model == "lateral":
        aileron = 0.07 * steps((1.0, 1), (1.8, -2), (2.6, 1), (10.0, -1), (10.6, 2), (11.2, -1))
        rudder = 0.06 * steps((4.0, 1), (6.2, -2), (7.6, 2), (8.3, -2), (9.0, 1))
        return time, {"aileron": aileron, "rudder": rudder}
    _, elevator, thrust = level()
    moved = 0.035 * steps(
        (1.0, 1), (2.5, -2), (3.5, 2), (4.0, -2), (4.5, 1), (15.0, -1), (15.6, 2), (16.2, -1)
    )
    return time, {
        "elevator": elevator + moved,
        "thrust": thrust + 1200.0 * steps((6.0, 1), (10.0, -1)),
    }


@functools.cache
def level() -> tuple[float, float, float]:
    """Angle of attack, elevator (rad) and thrust (N) of level flight at the reference airspeed, by
    Newton's method.
    """
    c, d = CONSTANTS["longitudinal"], TRUE["longitudinal"]
    force = 0.5 * c["air_density"] * c["reference_airspeed"] ** 2 * c["wing_area"]

    def off(x: np.ndarray) -> np.ndarray:
        alpha, elevator, thrust = x[0], x[1], x[2] * force
        lift = force * (d["CL_0"] + d["CL_alpha"] * alpha + d["CL_de"] * elevator)
        drag = force * (d["CD_0"] + d["CD_alpha"] * alpha)
        moment = (
            d["Cm_0"]
            + d["Cm_alpha"] * alpha
            + d["Cm_de"] * elevator
            + thrust * c["thrust_arm"] / (force * c["chord"])
        )
        return np.array(
            [
                (lift + thrust * np.sin(alpha) - c["mass"] * G) / force,
                (thrust * np.cos(alpha) - drag) / force,
                moment,
            ]
        )

    x = np.array([0.05, 0.0, 0.05])
    for _ in range(20):
        slope = np.array([(off(x + 1e-6 * e) - off(x - 1e-6 * e)) / 2e-6 for e in np.eye(3)]).T
        x = x - np.linalg.solve(slope, off(x))
    return float(x[0]), float(x[1]), float(x[2] * force)


def motion(
    model: str, time: np.ndarray, inputs: Mapping[str, np.ndarray], gust: np.ndarray | None = None
) -> dict[str, np.ndarray]:
    """Outputs at the samples without sensor noise; ``gust`` (m/s) at every integration step,
    upwards or from the right.
    """
    rates, outputs, x = _EQUATIONS[model]()
    u, h = np.array(list(inputs.values())), float(time[1] - time[0]) / FINE
    wind = np.zeros((len(time) - 1) * FINE + 1) if gust is None else gust
    seen = [outputs(x, u[:, 0], wind[0])]
    for k in range(len(time) - 1):
        held = u[:, k]
        for j in range(k * FINE, (k + 1) * FINE):
            middle = 0.5 * (wind[j] + wind[j + 1])
            a = rates(x, held, wind[j])
            b = rates(x + 0.5 * h * a, held, middle)
            c = rates(x + 0.5 * h * b, held, middle)
            x = x + h / 6.0 * (a + 2.0 * (b + c) + rates(x + h * c, held, wind[j + 1]))
        seen.append(outputs(x, u[:, k + 1], wind[FINE * (k + 1)]))
    return dict(zip(SENSORS[model], np.array(seen).T, strict=True))


@functools.cache
def _calm(model: str) -> dict[str, np.ndarray]:
    return motion(model, *maneuver(model))


def _airspeed(model: str) -> float:
    return CONSTANTS[model]["reference_airspeed" if model == "longitudinal" else "airspeed"]


Equations = tuple[Callable[..., np.ndarray], Callable[..., np.ndarray], np.ndarray]


def _rigid() -> Equations:
    c, d = CONSTANTS["rigid"], TRUE["rigid"]
    V, half = c["airspeed"], c["chord"] / (2.0 * c["airspeed"])
    force = 0.5 * c["air_density"] * V * V * c["wing_area"]
    lift = (
        force
        / c["mass"]
        * np.array([d["CL_alpha"], d["CL_q"] * half, d["CL_de"], d["CL_alpha"] / V])
    )
    pitch = (
        force
        * c["chord"]
        / c["pitch_inertia"]
        * np.array([d["Cm_alpha"], d["Cm_q"] * half, d["Cm_de"], d["Cm_alpha"] / V])
    )
    matrix = np.array([np.array([0.0, 1.0, 0.0, 0.0]) - lift / V, pitch])

    def rates(x: np.ndarray, u: np.ndarray, w: float) -> np.ndarray:
        return np.asarray(matrix @ (x[0], x[1], u[0], w))

    def outputs(x: np.ndarray, u: np.ndarray, w: float) -> np.ndarray:
        return np.array([x[0] + w / V, x[1], lift @ (x[0], x[1], u[0], w) / G])

    return rates, outputs, np.zeros(2)


def _lateral() -> Equations:
    c, d = CONSTANTS["lateral"], TRUE["lateral"]
    V, half = c["airspeed"], c["span"] / (2.0 * c["airspeed"])
    force = 0.5 * c["air_density"] * V * V * c["wing_area"]
    of = np.array(
        [
            [d.get(f"{axis}_{by}", 0.0) for by in ("beta", "p", "r", "da", "dr")]
            for axis in ("CY", "Cl", "Cn")
        ]
    )
    of = of * np.array([1.0, half, half, 1.0, 1.0])
    inertia = np.array(
        [[c["roll_inertia"], -c["cross_inertia"]], [-c["cross_inertia"], c["yaw_inertia"]]]
    )
    turning = np.linalg.solve(inertia, force * c["span"] * of[1:])
    side = force / c["mass"] * of[0]
    # States beta, p, r, phi; inputs aileron, rudder; wind over airspeed.
    matrix = np.zeros((4, 7))
    loads = np.zeros((3, 7))
    for row, values in zip(loads, (side, *turning), strict=True):
        row[[0, 1, 2, 4, 5]] = values
        row[6] = values[0]
    matrix[0] = loads[0] / V
    matrix[0, 1] += math.sin(c["trim_alpha"])
    matrix[0, 2] -= math.cos(c["trim_alpha"])
    matrix[0, 3] += G * math.cos(c["trim_theta"]) / V
    matrix[1:3] = loads[1:]
    matrix[3, 1], matrix[3, 2] = 1.0, math.tan(c["trim_theta"])

    def rates(x: np.ndarray, u: np.ndarray, w: float) -> np.ndarray:
        return np.asarray(matrix @ (*x, *u, w / V))

    def outputs(x: np.ndarray, u: np.ndarray, w: float) -> np.ndarray:
        return np.array([x[0] + w / V, x[1], x[2], x[3], loads[0] @ (*x, *u, w / V) / G])

    return rates, outputs, np.zeros(4)


def _longitudinal() -> Equations:
    c, d = CONSTANTS["longitudinal"], TRUE["longitudinal"]
    V0, mass = c["reference_airspeed"], c["mass"]

    def loads(x: np.ndarray, u: np.ndarray, w: float) -> tuple[float, float, float]:
        along, down, q, _ = x
        speed, path = math.hypot(along, down), math.atan2(down, along)
        alpha, rate = path + w / V0, q * c["chord"] / (2.0 * V0)
        force = 0.5 * c["air_density"] * speed * speed * c["wing_area"]
        drag = force * (d["CD_0"] + d["CD_alpha"] * alpha)
        lift = force * (d["CL_0"] + d["CL_alpha"] * alpha + d["CL_de"] * u[0])
        moment = (
            force
            * c["chord"]
            * (d["Cm_0"] + d["Cm_alpha"] * alpha + d["Cm_q"] * rate + d["Cm_de"] * u[0])
        )
        X = u[1] + lift * math.sin(path) - drag * math.cos(path)
        Z = -lift * math.cos(path) - drag * math.sin(path)
        return X / mass, Z / mass, (moment + u[1] * c["thrust_arm"]) / c["pitch_inertia"]

    def rates(x: np.ndarray, u: np.ndarray, w: float) -> np.ndarray:
        X, Z, q_dot = loads(x, u, w)
        along, down, q, theta = x
        return np.array(
            [X - q * down - G * math.sin(theta), Z + q * along + G * math.cos(theta), q_dot, q]
        )

    def outputs(x: np.ndarray, u: np.ndarray, w: float) -> np.ndarray:
        X, Z, _ = loads(x, u, w)
        return np.array(
            [math.hypot(x[0], x[1]), math.atan2(x[1], x[0]) + w / V0, x[3], x[2], -Z / G, X / G]
        )

    alpha, _, _ = level()
    return rates, outputs, np.array([V0 * math.cos(alpha), V0 * math.sin(alpha), 0.0, alpha])


_EQUATIONS: Mapping[str, Callable[[], Equations]] = {
    "rigid": _rigid,
    "lateral": _lateral,
    "longitudinal": _longitudinal,
}
