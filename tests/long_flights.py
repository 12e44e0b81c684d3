"""Simulated flights of twenty minutes with known maneuvers, and the score of what a search finds in
them.

The aircraft is linear, its longitudinal and lateral motion decoupled and each in perturbations
about level flight. A pilot holds attitude and height, corrects now and then, retrims, changes the
speed; a yaw damper moves the rudder in every second flight. All flights of a call are marched
together, one axis a flight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import chirp, lfilter

from ident.maneuver_detection import DetectedManeuver, FlightSignals

STEP = 0.02  # s, of the march
LENGTH = 1200.0  # s
GRAVITY = 9.80665
CONTROLS = {"pitch": "elevator", "roll": "aileron", "yaw": "rudder", "throttle": "thrust"}
THRUST, WEIGHT = 20e3, 80e3  # N, level flight
DEGREE = np.pi / 180.0
# Kinds flown on each axis, and how often relative to each other.
FLOWN = {
    "pitch": (
        "step",
        "pulse",
        "doublet",
        "doublet",
        "3-2-1-1",
        "3-2-1-1",
        "sweep",
        "multisine",
        "pull-up",
    ),
    "roll": ("step", "pulse", "doublet", "3-2-1-1", "sweep", "multisine", "turn", "turn"),
    "yaw": ("pulse", "doublet", "doublet", "3-2-1-1", "sweep", "multisine"),
    "throttle": ("step", "doublet"),
}
PLANES = ("symmetric", "lateral")
PATTERNS = {
    "step": (1.0,),
    "pulse": (1.0,),
    "doublet": (1.0, -1.0),
    "3-2-1-1": (3.0, -2.0, 1.0, -1.0),
}


@dataclass(frozen=True)
class Known:
    """A maneuver that was flown: its input, or for a turn its bank, begins at ``start`` and ends at
    ``end``, s.
    """

    start: float
    end: float
    axis: str
    kind: str


@dataclass(frozen=True, eq=False)
class LongFlight:
    """The record of a flight as its recorder wrote it, and what was flown. ``quiet``: hands off
    before a maneuver, s.
    """

    signals: FlightSignals
    known: tuple[Known, ...]
    quiet: tuple[tuple[float, float], ...]
    turbulence: float


@dataclass(eq=False)
class _Script:
    """What one flight is going to do, on the march's grid."""

    command: dict[str, np.ndarray]  # deg and share of the thrust, added to the pilot's
    bank: np.ndarray  # rad, that the pilot holds
    hands: dict[str, np.ndarray]  # by plane: 1 where the pilot flies, less during a maneuver
    speed: np.ndarray  # m/s, change that the pilot wants
    known: list[Known] = field(default_factory=list)
    quiet: list[tuple[float, float]] = field(default_factory=list)


def fly(seeds: Sequence[int], length: float = LENGTH) -> list[LongFlight]:
    """One flight a seed; the same seed gives the same flight, whatever flies with it."""
    generators = [np.random.default_rng([20260, seed]) for seed in seeds]
    time = np.arange(round(length / STEP)) * STEP
    aircraft = [_aircraft(rng) for rng in generators]
    scripts = [_script(rng, time, one) for rng, one in zip(generators, aircraft, strict=True)]
    motion = _march(
        time,
        aircraft,
        scripts,
        [_disturbances(rng, time, one) for rng, one in zip(generators, aircraft, strict=True)],
    )
    return [
        _recorded(
            rng, time, {name: values[k] for name, values in motion.items()}, aircraft[k], scripts[k]
        )
        for k, rng in enumerate(generators)
    ]


def _aircraft(rng: np.random.Generator) -> dict[str, float]:
    speed, period = rng.uniform(60.0, 180.0), rng.uniform(1.8, 4.5)
    roll = 1.0 / rng.uniform(0.3, 1.2)
    return {
        "V": speed,
        "Za": -rng.uniform(0.6, 1.8),
        "Ma": -(period**2),
        "Mq": -rng.uniform(0.8, 2.5),
        "Me": -rng.uniform(0.6, 1.2) * period**2,
        "Lp": -roll,
        "La": rng.uniform(3.0, 8.0) * roll,
        "Lb": -rng.uniform(2.0, 8.0),
        "Nb": rng.uniform(1.0, 3.0) ** 2,
        "Nr": -rng.uniform(0.2, 0.8),
        "Nd": -rng.uniform(0.5, 1.2) * 2.0,
        "Yb": -rng.uniform(0.08, 0.25),
        "sigma": rng.choice([0.0, 0.6, 1.2, 2.0]),
        "damper": rng.choice([0.0, 0.5]),
        "pitch_damper": rng.choice([0.0, 0.0, 0.3]),
        "gain": rng.uniform(0.2, 0.5),
        "amplitude": rng.uniform(1.2, 3.0),
        "remnant": rng.uniform(0.04, 0.1),
        "rate": rng.choice([20.0, 25.0, 50.0]),
        "noise": rng.uniform(0.5, 2.0),
    }


def _script(rng: np.random.Generator, time: np.ndarray, aircraft: dict[str, float]) -> _Script:
    script = _Script(
        {control: np.zeros(time.size) for control in CONTROLS.values()},
        np.zeros(time.size),
        {plane: np.ones(time.size) for plane in PLANES},
        np.zeros(time.size),
    )
    clock = rng.uniform(40.0, 90.0)
    while True:
        axis = str(rng.choice(["pitch", "roll", "yaw", "throttle"], p=[0.4, 0.28, 0.22, 0.1]))
        kind = str(rng.choice(FLOWN[axis]))
        calm = rng.uniform(3.0, 18.0)
        if clock + calm + 90.0 > time[-1]:
            break
        end = _put(rng, script, time, clock + calm, axis, kind, aircraft)
        for plane in PLANES:
            script.hands[plane][(time >= clock) & (time < clock + calm)] *= (
                0.4 if plane == _plane(axis) else 0.7
            )
        script.quiet.append((clock, clock + calm))
        pause = rng.uniform(12.0, 70.0)
        if rng.uniform() < 0.2:
            at, over = end + 5.0, rng.uniform(30.0, 60.0)
            script.speed += (
                rng.uniform(-0.1, 0.1) * aircraft["V"] * np.clip((time - at) / over, 0.0, 1.0)
            )
            pause += over
        clock = end + pause
    _corrections(rng, script, time, aircraft)
    return script


def _put(
    rng: np.random.Generator,
    script: _Script,
    time: np.ndarray,
    start: float,
    axis: str,
    kind: str,
    aircraft: dict[str, float],
) -> float:
    """Write a maneuver into the script; its end, s."""
    size = float(rng.uniform(0.7, 1.5) * rng.choice([-1.0, 1.0])) * (
        0.15 if axis == "throttle" else aircraft["amplitude"]
    )
    control = CONTROLS[axis]
    if kind == "turn":
        bank, ramp, hold = (
            rng.choice([-1, 1]) * rng.uniform(20.0, 45.0) * DEGREE,
            rng.uniform(3.0, 6.0),
            rng.uniform(15.0, 60.0),
        )
        end = start + hold + 2.0 * ramp
        script.bank += bank * np.clip(np.minimum(time - start, end - time) / ramp, 0.0, 1.0)
    elif kind == "pull-up":
        ramp, hold = rng.uniform(0.7, 1.5), rng.uniform(2.0, 4.0)
        end = start + hold + 2.0 * ramp
        # g of lift for a unit of control
        steady = (
            -aircraft["Me"] * -aircraft["Za"] / (-aircraft["Ma"] + aircraft["Mq"] * aircraft["Za"])
        )
        pull = rng.uniform(0.4, 0.9) / (steady * aircraft["V"] / GRAVITY)
        script.command[control] -= np.clip(
            np.minimum(time - start, end - time) / ramp, 0.0, 1.0
        ) * min(pull / DEGREE, 4.0 * aircraft["amplitude"])
    elif kind in ("sweep", "multisine"):
        end = (
            start + rng.uniform(15.0, 60.0)
            if kind == "sweep"
            else start + rng.choice([10.0, 15.0, 20.0, 30.0])
        )
        inside = (time >= start) & (time < end)
        since = time[inside] - start
        if kind == "sweep":
            low, high = rng.uniform(0.08, 0.25), rng.uniform(1.2, 2.5)
            low, high = (low, high) if rng.uniform() < 0.8 else (high, low)
            wave = chirp(
                since,
                low,
                end - start,
                high,
                method=str(rng.choice(["linear", "logarithmic"])),
                phi=-90,
            )
            wave = wave * np.clip(np.minimum(since, end - start - since) / 0.5, 0.0, 1.0)
        else:
            first = max(1, round(0.1 * (end - start)))
            harmonics = np.arange(first, round(1.8 * (end - start)), rng.integers(2, 4))
            phases = -np.pi * np.arange(harmonics.size) ** 2 / harmonics.size
            wave = sum(
                np.cos(2 * np.pi * h * since / (end - start) + phase)
                for h, phase in zip(harmonics, phases, strict=True)
            )
            wave = wave / np.max(np.abs(wave)) * 1.3
        script.command[control][inside] += size * wave
    else:
        unit = rng.uniform(0.4, 1.2) if kind != "step" else rng.uniform(5.0, 12.0)
        unit = (
            rng.uniform(4.0, 9.0)
            if axis == "throttle"
            else unit
            * (2.0 if kind == "doublet" and axis == "pitch" and rng.uniform() < 0.3 else 1.0)
        )
        durations = np.abs(PATTERNS[kind]) * unit * rng.uniform(0.88, 1.12, len(PATTERNS[kind]))
        edges = start + np.concatenate([[0.0], np.cumsum(durations)])
        rise = rng.uniform(0.05, 0.3)  # s, in which a level is reached
        if kind in ("doublet", "3-2-1-1") and axis != "throttle" and rng.uniform() < 0.25:
            rise = rng.uniform(0.5, 0.9) * min(durations)  # flown by hand on a large aircraft
        for sign, first, last in zip(np.sign(PATTERNS[kind]), edges[:-1], edges[1:], strict=True):
            level = sign * size * rng.uniform(0.85, 1.15) * (0.6 if kind == "step" else 1.0)
            script.command[control] += level * (
                np.clip((time - first) / rise, 0.0, 1.0) - np.clip((time - last) / rise, 0.0, 1.0)
            )
        end = float(edges[-1])
    if kind != "turn":
        script.hands[_plane(axis)][(time >= start) & (time < end + rng.uniform(0.5, 3.0))] *= (
            rng.uniform(0.1, 0.4)
        )
    script.known.append(Known(start, float(end), axis, kind))
    return float(end)


def _plane(axis: str) -> str:
    return PLANES[axis in ("roll", "yaw")]


def _corrections(
    rng: np.random.Generator, script: _Script, time: np.ndarray, aircraft: dict[str, float]
) -> None:
    """Short inputs of the pilot between the maneuvers, and slow retrimming."""
    busy = np.zeros(time.size, dtype=bool)
    for one in script.known:
        busy |= (time > one.start - 1.0) & (time < one.end + 1.0)
    for control in ("elevator", "aileron", "rudder"):
        for at in np.cumsum(rng.exponential(45.0, 60)):
            over = rng.uniform(0.6, 3.0)
            inside = (time >= at) & (time < at + over)
            if inside.any() and not busy[inside].any():
                size = rng.uniform(0.1, 0.4) * 0.7 * aircraft["amplitude"] * rng.choice([-1, 1])
                script.command[control][inside] += (
                    size * np.sin(np.pi * (time[inside] - at) / over) ** 2
                )
        walk = np.cumsum(rng.standard_normal(time.size)) * np.sqrt(STEP) * 0.015
        script.command[control] += lfilter([STEP / 10.0], [1.0, STEP / 10.0 - 1.0], walk)


def _disturbances(
    rng: np.random.Generator, time: np.ndarray, aircraft: dict[str, float]
) -> dict[str, np.ndarray]:
    def coloured(sigma: float, rate: float) -> np.ndarray:
        shape = np.exp(-rate * STEP)
        return np.asarray(
            lfilter(
                [sigma * np.sqrt(1.0 - shape**2)], [1.0, -shape], rng.standard_normal(time.size)
            )
        )

    gust = aircraft["V"] / 200.0
    level = 1.0 + 0.5 * np.sin(
        2.0 * np.pi * time / rng.uniform(300.0, 900.0) + rng.uniform(0.0, 6.0)
    )
    return {
        "alpha": coloured(aircraft["sigma"] / aircraft["V"], gust) * level,
        "beta": coloured(aircraft["sigma"] / aircraft["V"], gust) * level,
        "speed": coloured(aircraft["sigma"], gust) * level,
        **{
            control: coloured(aircraft["remnant"] * aircraft["amplitude"] * DEGREE, 3.0)
            for control in ("elevator", "aileron", "rudder")
        },
    }


def _march(
    time: np.ndarray,
    aircraft: Sequence[dict[str, float]],
    scripts: Sequence[_Script],
    gusts: Sequence[dict[str, np.ndarray]],
) -> dict[str, np.ndarray]:
    """Semi-implicit Euler steps of all flights together; signals ``(F, N)``."""
    a = {key: np.array([one[key] for one in aircraft]) for key in aircraft[0]}
    count = len(aircraft)
    command = {
        control: np.array([script.command[control] for script in scripts]) * DEGREE
        for control in ("elevator", "aileron", "rudder")
    }
    throttle = np.array([script.command["thrust"] for script in scripts])
    bank = np.array([script.bank for script in scripts])
    hands = {plane: np.array([script.hands[plane] for script in scripts]) for plane in PLANES}
    wanted = np.array([script.speed for script in scripts])
    gust = {key: np.array([one[key] for one in gusts]) for key in gusts[0]}
    out = {
        name: np.zeros((count, time.size))
        for name in (
            "V",
            "alpha",
            "q",
            "theta",
            "h",
            "beta",
            "p",
            "r",
            "phi",
            "psi",
            *CONTROLS.values(),
        )
    }
    V, alpha, q, theta, h, beta, p, r, phi, psi, elevator_p, aileron_p, thrust_p, held, level = (
        np.zeros((15, count))
    )
    for n in range(time.size):
        fly, roll = hands["symmetric"][:, n], hands["lateral"][:, n]
        climb = theta - alpha
        pull = a["gain"] * (theta - np.clip(-0.002 * h, -0.05, 0.05)) + 0.3 * a["gain"] * q
        elevator_p += STEP / 0.3 * (fly * (pull + gust["elevator"][:, n]) - elevator_p)
        held += STEP * 0.02 * elevator_p  # trim follows what is held
        ailerons = -a["Lp"] / a["La"] * (-0.7 * (phi - bank[:, n]) - 0.2 * p)
        aileron_p += STEP / 0.25 * (roll * (ailerons + gust["aileron"][:, n]) - aileron_p)
        level += STEP * 0.03 * aileron_p
        thrust_p += (
            STEP
            / 4.0
            * (
                np.clip(0.03 * (wanted[:, n] - V), -0.3, 0.3) * np.minimum(1.0, fly + 0.2)
                - thrust_p
            )
        )
        elevator = command["elevator"][:, n] + elevator_p + held + a["pitch_damper"] * q
        aileron = command["aileron"][:, n] + aileron_p + level
        rudder = command["rudder"][:, n] + a["damper"] * r + roll * gust["rudder"][:, n]
        thrust = throttle[:, n] + thrust_p
        ag, bg = alpha + gust["alpha"][:, n], beta + gust["beta"][:, n]
        V += STEP * (GRAVITY * (thrust * THRUST / WEIGHT - climb) - 0.02 * V)
        q += STEP * (a["Ma"] * ag + a["Mq"] * q + a["Me"] * elevator)
        alpha += STEP * (q + a["Za"] * ag)
        theta += STEP * q
        h += STEP * a["V"] * climb
        p += STEP * (a["Lp"] * p + a["Lb"] * bg + a["La"] * aileron)
        r += STEP * (
            a["Nb"] * bg + a["Nr"] * (r - GRAVITY / a["V"] * np.sin(phi)) + a["Nd"] * rudder
        )
        beta += STEP * (a["Yb"] * bg - r + GRAVITY / a["V"] * np.sin(phi))
        phi += STEP * p
        psi += STEP * r
        for name, value in zip(
            out,
            (V, alpha, q, theta, h, beta, p, r, phi, psi, elevator, aileron, rudder, thrust),
            strict=True,
        ):
            out[name][:, n] = value
    out["alpha"] = out["alpha"] + gust["alpha"]
    out["beta"] = out["beta"] + gust["beta"]
    out["V"] = out["V"] + gust["speed"]
    return out


def _recorded(
    rng: np.random.Generator,
    time: np.ndarray,
    motion: dict[str, np.ndarray],
    aircraft: dict[str, float],
    script: _Script,
) -> LongFlight:
    every = round(1.0 / (aircraft["rate"] * STEP))
    kept = slice(None, None, every)
    V = aircraft["V"]
    clean = {
        "elevator": motion["elevator"] - 0.02,
        "aileron": motion["aileron"] + 0.004,
        "rudder": motion["rudder"] - 0.006,
        "thrust": THRUST * (1.0 + motion["thrust"]),
        "alpha": motion["alpha"] + 0.05,
        "q": motion["q"],
        "nz": 1.0 / np.cos(motion["phi"]) - V * aircraft["Za"] * motion["alpha"] / GRAVITY,
        "theta": motion["theta"] + 0.05,
        "airspeed": V + motion["V"],
        "height": 2000.0 + motion["h"],
        "beta": motion["beta"],
        "p": motion["p"],
        "r": motion["r"],
        "phi": motion["phi"],
        "psi": motion["psi"],
    }
    noise = {
        **dict.fromkeys(("elevator", "aileron", "rudder"), 0.02 * DEGREE),
        **{
            "thrust": 50.0,
            "alpha": 0.08 * DEGREE,
            "q": 0.08 * DEGREE,
            "nz": 0.012,
            "theta": 0.03 * DEGREE,
            "airspeed": 0.3,
            "height": 0.5,
        },
        **{
            "beta": 0.08 * DEGREE,
            "p": 0.1 * DEGREE,
            "r": 0.05 * DEGREE,
            "phi": 0.05 * DEGREE,
            "psi": 0.05 * DEGREE,
        },
    }
    channels = {
        name: values[kept]
        + aircraft["noise"] * noise[name] * rng.standard_normal(values[kept].size)
        for name, values in clean.items()
    }
    inputs = {name: channels.pop(name) for name in CONTROLS.values()}
    return LongFlight(
        FlightSignals(time[kept], inputs, channels),
        tuple(script.known),
        tuple(script.quiet),
        aircraft["sigma"],
    )


@dataclass(frozen=True)
class Score:
    """What a search found of known maneuvers, summed over flights."""

    known: int
    found: int
    kinds: int
    false: int
    flights: int
    missed: tuple[str, ...] = ()
    invented: tuple[str, ...] = ()
    confused: tuple[str, ...] = ()

    def __add__(self, other: Score) -> Score:
        return Score(
            *(getattr(self, name) + getattr(other, name) for name in self.__dataclass_fields__)
        )


def score(known: Sequence[Known], found: Sequence[DetectedManeuver], label: str = "") -> Score:
    """How many known maneuvers were found: right axis, and both ends within 1 s or 70 % of the
    joint time in common.

    A maneuver found that matches no known one, be it a part of one only, is a false one; trim
    points count neither way.
    """
    moves = [one for one in found if one.kind != "trim"]
    missed, confused, hits, kinds = [], [], 0, 0
    for each in known:
        same = [one for one in moves if one.axis == each.axis and _matches(each, one)]
        hits += bool(same)
        right = any(one.kind == each.kind for one in same)
        kinds += right
        if not same:
            missed.append(f"{label}{each.axis} {each.kind} {each.start:.1f}-{each.end:.1f}")
        elif not right:
            confused.append(
                f"{label}{each.axis} {each.kind} {each.start:.1f}-{each.end:.1f} as {same[0].kind}"
            )
    invented = [
        f"{label}{one.axis} {one.kind} {one.start:.1f}-{one.end:.1f}"
        for one in moves
        if not any(one.axis == each.axis and _matches(each, one) for each in known)
    ]
    return Score(
        len(known), hits, kinds, len(invented), 1, tuple(missed), tuple(invented), tuple(confused)
    )


def _matches(known: Known, found: DetectedManeuver) -> bool:
    joint = max(known.end, found.end) - min(known.start, found.start)
    near = abs(known.start - found.start) <= 1.0 and abs(known.end - found.end) <= 1.0
    return near or _common(known, found) >= 0.7 * joint


def _common(known: Known, found: DetectedManeuver) -> float:
    return max(0.0, min(known.end, found.end) - max(known.start, found.start))
