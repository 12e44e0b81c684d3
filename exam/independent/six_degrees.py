"""The second simulator: six degrees of freedom over a flat Earth, nonlinear, Runge-Kutta of
fourth order.

Body axes x forward, y right, z down; Euler angles; air-relative velocity for the aerodynamics,
so that
gusts act through them (Etkin and Reid, Dynamics of Flight, 3rd ed., chapter 4). It shares no
code with
`sim` or `ident`. Inner loops run on plain floats, which is faster than arrays of a few numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from exam.independent.airplanes import Airplane, Six
from exam.independent.folders import Signals

G0 = 9.80665  # m/s2
STEP = 1.0 / 400.0  # s
SCALE_HEIGHT = 9500.0  # m over which the density falls by e
SURFACES = ("elevator", "aileron", "rudder")
MOTION = ("airspeed", "alpha", "beta", "p", "q", "r", "phi", "theta")
SIGNALS = (*SURFACES, "thrust", *MOTION, "nx", "ny", "nz", "power", "height")
Linkage = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Trim:
    """Level unaccelerated flight without bank: attitude, surfaces (rad), thrust (N, or a
    propeller's pressure rise).
    """

    alpha: float
    beta: float
    elevator: float
    aileron: float
    rudder: float
    power: float
    theta: float

    @property
    def surfaces(self) -> tuple[float, float, float]:
        """Elevator, aileron, rudder."""
        return self.elevator, self.aileron, self.rudder


@dataclass(frozen=True)
class Loops:
    """Feedback to the surfaces' commands: pitch rate (s), attitude (rad/rad), yaw rate (s), and the
    pilot's bank angle control (rad/rad, s).
    """

    pitch_rate: float = 0.0
    attitude: float = 0.0
    yaw_rate: float = 0.0
    bank: float = 0.0
    roll_rate: float = 0.0


@dataclass(frozen=True, eq=False)
class Hidden:
    """Unrecorded causes in the equations of motion.

    Parameters
    ----------
    linkage : for each surface, what lies between its recorded angle and the angle in the air,
        about trim.
    jump : time (s), surface and factor of its effect about trim from then on.
    gust : wind components along body axes (m/s, three arrays on the fine grid), or none.
    pulse : start and length (s) of a thrust change (N), and the engine's distance right of the
        centre line (m).
    lag : share of the lift (or of the yawing moment by sideslip) that follows late, and its
        time constant (s).
    stall : upper and lower angle of attack (rad, about trim) between which separated flow
        persists, lost lift coefficient.
    """

    linkage: Mapping[str, Callable[[float], float]] = field(default_factory=dict)
    jump: tuple[float, str, float] | None = None
    gust: np.ndarray | None = None
    pulse: tuple[float, float, float, float] | None = None
    lag: tuple[float, float] | None = None
    stall: tuple[float, float, float] | None = None
    lateral: bool = False


def loads(
    plane: Airplane,
    air: tuple[float, float, float],
    rates: Sequence[float],
    surfaces: Sequence[float],
    rise: float,
) -> tuple[Six, float, float, float]:
    """Coefficients, dynamic pressure over density, alpha and beta for a velocity against the
    air (m/s) and body rates (rad/s)."""
    u, v, w = air
    speed = math.sqrt(u * u + v * v + w * w)
    alpha, beta = math.atan2(w, u), math.asin(v / speed)
    half_span, half_chord = plane.span / (2.0 * speed), plane.chord / (2.0 * speed)
    p, q, r = rates
    found = plane.coefficients(
        alpha, beta, p * half_span, q * half_chord, r * half_span, *surfaces, rise
    )
    return found, 0.5 * speed * speed, alpha, beta


def accelerations(
    plane: Airplane,
    state: Sequence[float],
    surfaces: Sequence[float],
    power: float,
    wind: Sequence[float] = (0.0, 0.0, 0.0),
    added: Sequence[float] = (0.0,) * 6,
) -> tuple[list[float], tuple[float, float, float]]:
    """Rates of u, v, w, p, q, r, phi, theta, psi and height, and the specific force without
    weight (m/s2) along body axes.

    ``power`` is thrust in N, or the propeller's pressure rise; ``added`` are coefficients on
    top of the airplane's.
    """
    u, v, w, p, q, r, phi, theta, _, height = state
    thrust, rise = (0.0, power) if plane.propeller else (power, 0.0)
    six, pressure, _, _ = loads(
        plane, (u - wind[0], v - wind[1], w - wind[2]), (p, q, r), surfaces, rise
    )
    force = plane.density * math.exp(-height / SCALE_HEIGHT) * pressure * plane.area
    cx, cy, cz, cl, cm, cn = (one + more for one, more in zip(six, added, strict=True))
    ax, ay, az = (
        (force * cx + thrust) / plane.mass,
        force * cy / plane.mass,
        force * cz / plane.mass,
    )
    roll, yaw = force * plane.span * cl, force * plane.span * cn
    pitch = force * plane.chord * cm + thrust * plane.thrust_arm
    ixx, iyy, izz, ixz = plane.inertia
    sin_phi, cos_phi, sin_theta, cos_theta = (
        math.sin(phi),
        math.cos(phi),
        math.sin(theta),
        math.cos(theta),
    )
    roll += ixz * p * q - (izz - iyy) * q * r
    yaw += -ixz * q * r - (iyy - ixx) * p * q
    pitch += (izz - ixx) * p * r - ixz * (p * p - r * r)
    common = ixx * izz - ixz * ixz
    turning = q * sin_phi + r * cos_phi
    return [
        r * v - q * w - G0 * sin_theta + ax,
        p * w - r * u + G0 * cos_theta * sin_phi + ay,
        q * u - p * v + G0 * cos_theta * cos_phi + az,
        (izz * roll + ixz * yaw) / common,
        pitch / iyy,
        (ixz * roll + ixx * yaw) / common,
        p + turning * math.tan(theta),
        q * cos_phi - r * sin_phi,
        turning / cos_theta,
        u * sin_theta - v * sin_phi * cos_theta - w * cos_phi * cos_theta,
    ], (ax, ay, az)


def start_of(plane: Airplane, trim: Trim) -> list[float]:
    """Return the state in trim."""
    speed, cos_beta = plane.airspeed, math.cos(trim.beta)
    along, down = speed * math.cos(trim.alpha) * cos_beta, speed * math.sin(trim.alpha) * cos_beta
    return [along, speed * math.sin(trim.beta), down, 0.0, 0.0, 0.0, 0.0, trim.theta, 0.0, 0.0]


def trimmed(plane: Airplane) -> Trim:
    """Return level flight at the airplane's airspeed by Newton's method; raise RuntimeError if it
    finds none.
    """

    def trim_of(x: np.ndarray) -> Trim:
        alpha, beta, de, da, dr, power = map(float, x)
        return Trim(
            alpha, beta, de, da, dr, power * (1.0 if plane.propeller else plane.mass * G0), alpha
        )

    def unbalanced(x: np.ndarray) -> np.ndarray:
        trim = trim_of(x)
        return np.array(
            accelerations(plane, start_of(plane, trim), trim.surfaces, trim.power)[0][:6]
        )

    x = np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.1])
    for _ in range(50):
        slope = np.array(
            [(unbalanced(x + 1e-6 * e) - unbalanced(x - 1e-6 * e)) / 2e-6 for e in np.eye(6)]
        ).T
        step = np.linalg.solve(slope, unbalanced(x))
        x = x - step * min(1.0, 0.2 / float(np.max(np.abs(step))))
        if np.max(np.abs(step)) < 1e-11:
            return trim_of(x)
    raise RuntimeError(f"{plane.name}: no level flight at {plane.airspeed} m/s")


def derivatives(plane: Airplane, trim: Trim, model: str) -> dict[str, float]:
    """Linear derivatives about trim of a model of the vehicle file, by central differences of
    the coefficients.

    Lift is the force across the flight path; for the rigid model, whose load factor is its
    lift, across the body.
    """
    rise = trim.power if plane.propeller else 0.0
    names = ("alpha", "beta", "p", "q", "r", "de", "da", "dr")
    about = np.array([trim.alpha, trim.beta, 0.0, 0.0, 0.0, *trim.surfaces])
    small = 1e-5

    def all_six(x: np.ndarray) -> np.ndarray:
        along, side, down, roll, pitch, yaw = plane.coefficients(*map(float, x), rise)
        a = float(x[0])
        lift = -down if model == "rigid" else along * math.sin(a) - down * math.cos(a)
        drag = -along * math.cos(a) - down * math.sin(a)
        return np.array([drag, side, lift, roll, pitch, yaw])

    slopes = {
        name: (all_six(about + small * e) - all_six(about - small * e)) / (2.0 * small)
        for name, e in zip(names, np.eye(8), strict=True)
    }
    row = {"CD": 0, "CY": 1, "CL": 2, "Cl": 3, "Cm": 4, "Cn": 5}
    if model == "lateral":
        return {
            f"{axis}_{by}": float(slopes[by][row[axis]])
            for axis in ("CY", "Cl", "Cn")
            for by in ("beta", "p", "r", "da", "dr")
        }
    found = {
        f"{axis}_{by}": float(slopes[by][row[axis]])
        for axis in ("CL", "Cm")
        for by in ("alpha", "q", "de")
    }
    if model == "rigid":
        return found
    at_trim = all_six(about)
    found["CD_alpha"] = float(slopes["alpha"][row["CD"]])
    for axis in ("CD", "CL", "Cm"):
        elevator = found.get(f"{axis}_de", 0.0) * trim.elevator
        found[f"{axis}_0"] = (
            float(at_trim[row[axis]]) - found[f"{axis}_alpha"] * trim.alpha - elevator
        )
    return found


def dryden(
    airspeed: float, sigma: float, length: float, count: int, rng: np.random.Generator
) -> np.ndarray:
    """Dryden gusts ``(3, count)`` in m/s: along first order, across and vertical second order
    (MIL-F-8785C), exact at the grid's steps."""
    time = length / airspeed
    keep = math.exp(-STEP / time)
    fresh = rng.standard_normal((3, count))
    out = np.empty((3, count))
    along = fresh[0, 0]
    for k in range(count):
        out[0, k] = along
        along = keep * along + math.sqrt(1.0 - keep * keep) * rng.standard_normal()
    # x'' = -2 x'/T - x/T^2 + noise/T^2; the gust, of variance one, is sqrt(T) (x + sqrt(3) T x').
    transition = keep * np.array([[1.0 + STEP / time, STEP], [-STEP / time**2, 1.0 - STEP / time]])
    settled = np.diag([1.0 / (4.0 * time), 1.0 / (4.0 * time**3)])
    root = np.linalg.cholesky(settled - transition @ settled @ transition.T + 1e-18 * np.eye(2))
    for row in (1, 2):
        x = np.sqrt(np.diag(settled)) * rng.standard_normal(2)
        more = root @ rng.standard_normal((2, count))
        for k in range(count):
            out[row, k] = math.sqrt(time) * (x[0] + math.sqrt(3.0) * time * x[1])
            x = transition @ x + more[:, k]
    return sigma * out


def servo_matrices(plane: Airplane) -> tuple[float, float, float, float, float, float]:
    """Return the exact transition of a second-order servo over a step with its command held."""
    omega, zeta = plane.servo
    beat = omega * math.sqrt(1.0 - zeta * zeta)
    keep, c, s = math.exp(-zeta * omega * STEP), math.cos(beat * STEP), math.sin(beat * STEP)
    a11, a12 = keep * (c + zeta * omega / beat * s), keep * s / beat
    a21, a22 = -keep * omega * omega / beat * s, keep * (c - zeta * omega / beat * s)
    return a11, a12, a21, a22, 1.0 - a11, -a21


def fly(
    plane: Airplane,
    trim: Trim,
    commands: Mapping[str, np.ndarray],
    loops: Loops = Loops(),
    hidden: Hidden = Hidden(),
) -> Signals:
    """Fly from trim; true signals at the c.g. on the grid of `STEP`.

    ``commands`` are changes about trim: surfaces in rad, ``thrust`` in N. The surfaces are
    recorded behind
    their servos. ``nx``, ``ny``, ``nz`` are specific forces over g, nz positive up.
    """
    count = len(next(iter(commands.values())))
    still = np.zeros(count)
    asked = np.stack([commands.get(name, still) for name in SURFACES])
    thrust = commands.get("thrust", still)
    servo = servo_matrices(plane)
    state, places, speeds = start_of(plane, trim), [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
    late, separated = 0.0, 0.0
    gust = np.zeros((3, count)) if hidden.gust is None else hidden.gust
    rows = np.empty((count, len(SIGNALS)))
    for k in range(count):
        wind = gust[:, k].tolist()
        power, added = _power(plane, trim, float(thrust[k]), hidden, k * STEP)
        angle = _angle(state, wind, hidden.lateral) - (trim.beta if hidden.lateral else trim.alpha)
        added = _unsteady(added, hidden, angle, late, separated)
        surfaces = _in_air(trim, places, hidden, k * STEP)
        first, specific = accelerations(plane, state, surfaces, power, wind, added)
        rows[k] = (*places, thrust[k], *_seen(state, wind), *_in_g(specific), power, state[9])
        if k + 1 == count:
            break
        p, q, r, phi, theta = state[3:8]
        feedback = (
            loops.pitch_rate * q + loops.attitude * (theta - trim.theta),
            loops.bank * phi + loops.roll_rate * p,
            loops.yaw_rate * r,
        )
        for i in range(3):
            command = float(asked[i, k]) + feedback[i]
            place, pace = places[i], speeds[i]
            places[i] = servo[0] * place + servo[1] * pace + servo[4] * command
            speeds[i] = servo[2] * place + servo[3] * pace + servo[5] * command
        after = _in_air(trim, places, hidden, (k + 1) * STEP)

        def rates(x: list[float], along: Sequence[float], air: Sequence[float]) -> list[float]:
            return accelerations(plane, x, along, power, air, added)[0]  # noqa: B023

        state = _stepped(state, first, rates, (surfaces, after), (wind, gust[:, k + 1].tolist()))
        late, separated = _followed(hidden, angle, late, separated)
    if not np.all(np.isfinite(rows)) or np.max(np.abs(rows[:, 10])) > 1.0:
        raise RuntimeError(f"{plane.name}: the flight went astray")
    out = {name: rows[:, k].copy() for k, name in enumerate(SIGNALS)}
    for name, neutral in zip(SURFACES, trim.surfaces, strict=True):
        out[name] += neutral
    out["thrust"] += 0.0 if plane.propeller else trim.power
    return out


def _moved(state: Sequence[float], rates: Sequence[float], by: float) -> list[float]:
    return [x + by * rate for x, rate in zip(state, rates, strict=True)]


def _angle(state: Sequence[float], wind: Sequence[float], lateral: bool) -> float:
    """Angle of attack or sideslip against the air."""
    u, v, w = state[0] - wind[0], state[1] - wind[1], state[2] - wind[2]
    return math.asin(v / math.sqrt(u * u + v * v + w * w)) if lateral else math.atan2(w, u)


def _seen(state: Sequence[float], wind: Sequence[float]) -> tuple[float, ...]:
    """Return speed and angles relative to the air, rates, bank and attitude."""
    u, v, w = state[0] - wind[0], state[1] - wind[1], state[2] - wind[2]
    speed = math.sqrt(u**2 + v**2 + w**2)
    return speed, math.atan2(w, u), math.asin(v / speed), *state[3:8]


def _in_g(specific: tuple[float, float, float]) -> tuple[float, float, float]:
    return specific[0] / G0, specific[1] / G0, -specific[2] / G0


def _stepped(
    state: list[float],
    first: list[float],
    rates: Callable[[list[float], Sequence[float], Sequence[float]], list[float]],
    surfaces: tuple[list[float], list[float]],
    wind: tuple[list[float], list[float]],
) -> list[float]:
    """Return the state after a Runge-Kutta step; surfaces and wind are linear in time within it."""
    middle = [0.5 * (one + other) for one, other in zip(*surfaces, strict=True)]
    air = [0.5 * (one + other) for one, other in zip(*wind, strict=True)]
    second = rates(_moved(state, first, 0.5 * STEP), middle, air)
    third = rates(_moved(state, second, 0.5 * STEP), middle, air)
    fourth = rates(_moved(state, third, STEP), surfaces[1], wind[1])
    slopes = zip(state, first, second, third, fourth, strict=True)
    return [x + STEP / 6.0 * (a + 2.0 * (b + c) + d) for x, a, b, c, d in slopes]


def _in_air(trim: Trim, places: Sequence[float], hidden: Hidden, time: float) -> list[float]:
    """Return the surfaces behind their linkage."""
    seen = [
        hidden.linkage[name](place) if name in hidden.linkage else place
        for name, place in zip(SURFACES, places, strict=True)
    ]
    if hidden.jump is not None and time >= hidden.jump[0]:
        seen[SURFACES.index(hidden.jump[1])] *= hidden.jump[2]
    return [neutral + change for neutral, change in zip(trim.surfaces, seen, strict=True)]


def _power(
    plane: Airplane, trim: Trim, change: float, hidden: Hidden, time: float
) -> tuple[float, tuple[float, ...]]:
    """Return the thrust, and the coefficients of an unrecorded pulse."""
    power = trim.power + (0.0 if plane.propeller else change)
    if hidden.pulse is None:
        return power, (0.0,) * 6
    start, length, force, arm = hidden.pulse
    if not start <= time < start + length:
        return power, (0.0,) * 6
    pressed = 0.5 * plane.density * plane.airspeed**2 * plane.area
    moment = force * plane.thrust_arm / (pressed * plane.chord)
    return power, (force / pressed, 0.0, 0.0, 0.0, moment, -force * arm / (pressed * plane.span))


def _unsteady(
    added: Sequence[float], hidden: Hidden, angle: float, late: float, separated: float
) -> tuple[float, ...]:
    """Return the coefficients of loads that follow late, and of separated flow."""
    x, y, z, roll, pitch, yaw = added
    if hidden.lag is not None:
        share = hidden.lag[0]
        if hidden.lateral:
            yaw += share * (late - angle)
        else:
            pitch += share * (late - angle)
            z -= 1.5 * share * (late - angle)
    if hidden.stall is not None:
        z += hidden.stall[2] * separated
        pitch += 0.2 * hidden.stall[2] * separated
    return x, y, z, roll, pitch, yaw


def _followed(hidden: Hidden, angle: float, late: float, separated: float) -> tuple[float, float]:
    """Return the states of the unsteady loads after a step."""
    if hidden.lag is not None:
        late = angle + (late - angle) * math.exp(-STEP / hidden.lag[1])
    if hidden.stall is not None:
        upper, lower, _ = hidden.stall
        target = (
            1.0 if angle > upper else 0.0 if angle < lower else (1.0 if separated > 0.5 else 0.0)
        )
        separated = target + (separated - target) * math.exp(-STEP / 0.08)
    return late, separated


def at_speed(plane: Airplane, factor: float) -> Airplane:
    """Return the airplane at another airspeed."""
    return replace(plane, airspeed=plane.airspeed * factor)
