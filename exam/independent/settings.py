"""The settings of a flight of the second simulator, without its causes: airplane, trim, maneuvers
and their sizes, loops, recorder.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from exam.independent.airplanes import AIRPLANES, PHANTOM, TRANSPORT, Airplane
from exam.independent.causes import G0, Scales
from exam.independent.folders import SIGMA, Recorder, Signals
from exam.independent.six_degrees import (
    STEP,
    Loops,
    Trim,
    accelerations,
    at_speed,
    derivatives,
    fly,
    start_of,
    trimmed,
)
from tests.independent.maneuvers import (
    Maneuver,
    doublet,
    in_turn,
    three_two_one_one,
    tick_for,
    training,
    validation,
)

# Largest gain of log likelihood by nonlinear polynomials in the records to fit, which should not be
# detectable.
MOST_GAIN = 4.0
SMALLEST = 0.3  # smallest sufficient size of a maneuver, relative to the full size
RATES = ("p", "q", "r")
Commands = dict[str, np.ndarray]


@dataclass(frozen=True)
class Setting:
    """A flight without its causes: airplane, trim, model of the vehicle file, commands of three
    records, loops, recorder.
    """

    plane: Airplane
    trim: Trim
    model: str
    commands: tuple[Commands, ...]
    loops: Loops
    how: Recorder
    scales: Scales


def drawn_setting(number: int, model: str, rng: np.random.Generator) -> tuple[Setting, float]:
    """Draw airplane, trim, maneuvers and recorder of a flight; return them with the residual by
    nonlinear polynomials in noise sigmas.
    """
    fleet = (TRANSPORT, PHANTOM) if model == "longitudinal" else AIRPLANES
    plane = at_speed(
        fleet[((number - 1) // 2 + (number - 1) % 2 + (number - 1) // 6) % len(fleet)],
        float(rng.uniform(0.94, 1.08)),
    )
    trim = trimmed(plane)
    fast = plane.mass < 100.0
    rate = float(rng.choice([50.0, 100.0] if fast else [25.0, 50.0, 50.0]))
    how = Recorder(
        rate,
        float(rng.choice([15.0, 20.0] if fast else [6.0, 10.0, 20.0])),
        float(rng.choice([0.7, 1.0])),
    )
    true = derivatives(plane, trim, model)
    closed = bool(rng.random() < 0.4)
    frequency = fast_mode(plane, trim, model)
    scales = Scales(plane.span / 6.0 if model == "lateral" else plane.chord, 1.0 / frequency)
    loops = loops_of(plane, true, model, closed, rng)
    setting = Setting(plane, trim, model, maneuvers(model, tick_for(frequency)), loops, how, scales)
    return sized(setting)


def fast_mode(plane: Airplane, trim: Trim, model: str) -> float:
    """Return the frequency (rad/s) of short period or Dutch roll from the static stability."""
    pressed = 0.5 * plane.density * plane.airspeed**2 * plane.area
    ixx, iyy, izz, _ = plane.inertia
    if model == "lateral":
        d = derivatives(plane, trim, "lateral")
        stiffness = d["Cn_beta"] * np.cos(trim.alpha) - izz / ixx * d["Cl_beta"] * np.sin(
            trim.alpha
        )
        return float(np.sqrt(pressed * plane.span * stiffness / izz))
    d = derivatives(plane, trim, "rigid")
    return float(np.sqrt(-pressed * plane.chord * d["Cm_alpha"] / iyy))


def loops_of(
    plane: Airplane, true: Mapping[str, float], model: str, closed: bool, rng: np.random.Generator
) -> Loops:
    """Return a pilot who keeps the wings level and, in closed-loop flights, a damper, perhaps with
    attitude hold.
    """
    if model == "lateral":
        damper = (
            float(rng.uniform(0.5, 1.5))
            * true["Cn_r"]
            / true["Cn_dr"]
            * plane.span
            / (2.0 * plane.airspeed)
        )
        return Loops(bank=0.1, yaw_rate=damper if closed else 0.0)
    damper = (
        float(rng.uniform(0.4, 1.2))
        * true["Cm_q"]
        / true["Cm_de"]
        * plane.chord
        / (2.0 * plane.airspeed)
    )
    attitude = 0.3 if closed and rng.random() < 0.5 else 0.0
    return Loops(pitch_rate=damper if closed else 0.0, attitude=attitude, bank=0.4, roll_rate=0.1)


def maneuvers(model: str, tick: float) -> tuple[Commands, ...]:
    """Return the commands of two records to fit and one to predict, of size one."""
    if model != "lateral":
        elevators = (*training(tick), validation(tick))
        thrusts = (
            doublet(6.0, 3.0),
            in_turn(4.0, 1.0, (-1.0, 1.0), (4, 3)),
            in_turn(6.0, 1.0, (0.8,), (6,)),
        )
        out = []
        for one, pulses in zip(elevators, thrusts, strict=True):
            time = STEP * np.arange(round(one.duration / STEP) + 1)
            out.append(
                {"elevator": one.at(time)}
                | (
                    {"thrust": Maneuver(pulses, one.duration, 0.5).at(time)}
                    if model == "longitudinal"
                    else {}
                )
            )
        return tuple(out)
    ailerons = (
        doublet(1.0, 0.8) + in_turn(11.0, 0.5, (0.7, -0.7, 0.7), (1, 2, 1)),
        doublet(8.0 + 3.0 * tick, 1.0, -0.8),
        in_turn(1.5, 0.7, (0.8, -0.8, 0.8), (1, 2, 1)) + doublet(14.0, 0.5, -0.6),
    )
    rudders = (
        doublet(4.0, 1.5 * tick) + doublet(15.0, tick, -0.7),
        three_two_one_one(1.5, tick),
        doublet(6.0, 1.2 * tick, -0.9),
    )
    time = STEP * np.arange(round(22.0 / STEP) + 1)
    return tuple(
        {"aileron": Maneuver(one, 22.0).at(time), "rudder": Maneuver(two, 22.0).at(time)}
        for one, two in zip(ailerons, rudders, strict=True)
    )


def sized(setting: Setting) -> tuple[Setting, float]:
    """Return the setting with commands that are as large as the flight allows, and smaller if the
    polynomials are too nonlinear within it.
    """
    first = setting.commands[0]
    scale: dict[str, float] = {}
    for name in first:
        only = {
            other: (values if other == name else 0.0 * values) for other, values in first.items()
        }
        unit = 0.02 * setting.plane.mass * G0 if name == "thrust" else 0.005
        flown = fly(
            setting.plane,
            setting.trim,
            {other: unit * values for other, values in only.items()},
            setting.loops,
        )
        most = {
            channel: float(np.max(np.abs(flown[channel] - flown[channel][0])))
            for channel in ("alpha", "nz", "beta", "p", "phi", "airspeed")
        }
        limits = {
            "elevator": {"alpha": np.radians(4.0), "nz": 0.5},
            "thrust": {"airspeed": 0.03 * setting.plane.airspeed},
            "aileron": {"p": np.radians(25.0), "phi": np.radians(18.0)},
            "rudder": {"beta": np.radians(4.0), "phi": np.radians(12.0)},
        }[name]
        scale[name] = unit * min(limit / most[channel] for channel, limit in limits.items())
    whole = replace(setting, commands=_scaled(setting.commands, scale, 1.0))
    samples = setting.how.rate * sum(
        STEP * len(next(iter(one.values()))) for one in setting.commands[:2]
    )
    allowed, bend, share = float(np.sqrt(2.0 * MOST_GAIN / samples)), bend_of(whole), 1.0
    if bend > allowed:
        # The nonlinearity is proportional to the square of the size.
        share = max(SMALLEST, float(np.sqrt(allowed / bend)))
        whole = replace(setting, commands=_scaled(setting.commands, scale, share))
        bend = bend_of(whole)
    return whole, bend


def _scaled(
    commands: Sequence[Commands], scale: Mapping[str, float], share: float
) -> tuple[Commands, ...]:
    return tuple(
        {name: share * scale[name] * values for name, values in one.items()} for one in commands
    )


def _straight(setting: Setting, s: Signals) -> dict[str, tuple[np.ndarray, list[np.ndarray]]]:
    """Return the loads and kinematics that should be linear, by channel: values, and the columns of
    the linear functions.

    Rates of change are multiplied by the time of the fast mode, so that all are in units of their
    channel.
    """
    one, pressure = np.ones(len(s["q"])), (s["airspeed"] / setting.plane.airspeed) ** 2
    pace = np.sqrt(pressure)
    rate = {
        name: np.gradient(s[name], STEP) * setting.scales.time
        for name in ("q", "p", "r", "beta", "phi")
    }
    if setting.model == "lateral":
        columns = [s["beta"], s["p"], s["r"], s["aileron"], s["rudder"], one]
        found = {"ny": (s["ny"], columns), "p": (rate["p"], columns), "r": (rate["r"], columns)}
        return {
            **found,
            "beta": (rate["beta"], [*columns, s["phi"]]),
            "phi": (rate["phi"], [s["p"], s["r"], one]),
        }
    columns = [s["alpha"] * pressure, s["q"] * pace, s["elevator"] * pressure, pressure, pace, one]
    found = {"nz": (s["nz"], columns), "q": (rate["q"], [*columns, s["thrust"]])}
    if setting.model == "longitudinal":
        # Thrust and the lift that tilts with alpha belong to the model.
        found["nx"] = (
            s["nx"] - s["thrust"] / (setting.plane.mass * G0),
            [*columns, s["alpha"] * s["nz"]],
        )
    return found


def _left(values: np.ndarray, columns: Sequence[np.ndarray]) -> float:
    """Return the standard deviation of the residual of a linear fit."""
    matrix = np.stack(columns, axis=1)
    return float(np.std(values - matrix @ np.linalg.lstsq(matrix, values, rcond=None)[0]))


def bend_of(setting: Setting) -> float:
    """Return the residual of linear fits on the records to fit, in noise sigmas of the worst
    channel.
    """
    worst = 0.0
    for commands in setting.commands[:2]:
        lines = _straight(setting, fly(setting.plane, setting.trim, commands, setting.loops))
        for name, (values, columns) in lines.items():
            worst = max(worst, _left(values, columns) / (SIGMA[name] * setting.how.noise))
    return worst


def _bent_in_alpha(s: Signals) -> list[np.ndarray]:
    return [s["alpha"] ** 2, s["alpha"] ** 3]


def _bent_in_beta(s: Signals) -> list[np.ndarray]:
    return [s["beta"] ** 2, s["beta"] ** 3, s["beta"] * np.abs(s["beta"])]


def _product(s: Signals) -> list[np.ndarray]:
    return [s["alpha"] * s["q"]]


CURVES: Mapping[str, tuple[str, Callable[[Signals], list[np.ndarray]], tuple[str, ...]]] = {
    "lift-nonlinearity": ("nz", _bent_in_alpha, ("rigid", "longitudinal")),
    "moment-nonlinearity": ("q", _bent_in_alpha, ("rigid", "longitudinal")),
    "drag-nonlinearity": ("nx", _bent_in_alpha, ("longitudinal",)),
    "varies:CL_q(alpha)": ("nz", _product, ("rigid", "longitudinal")),
    "varies:CL_alpha(q)": ("nz", _product, ("rigid", "longitudinal")),
    "varies:Cm_q(alpha)": ("q", _product, ("rigid", "longitudinal")),
    "varies:Cm_alpha(q)": ("q", _product, ("rigid", "longitudinal")),
    "side-force-nonlinearity": ("ny", _bent_in_beta, ("lateral",)),
    "roll-nonlinearity": ("p", _bent_in_beta, ("lateral",)),
    "yaw-nonlinearity": ("r", _bent_in_beta, ("lateral",)),
}
"""Effects that curved polynomials may make true: name -> channel of the load, its columns,
models."""


def amplification(setting: Setting) -> float:
    """Return the response of the fast mode at its own frequency over the static one, 1/(2 zeta), at
    least 1.

    A nonlinear moment is fed back at the frequency of the mode, and a lightly damped mode amplifies
    it.
    """
    plane, trim = setting.plane, setting.trim
    states = [1, 3, 5, 6] if setting.model == "lateral" else [2, 4]
    rest, small = start_of(plane, trim), 1e-4
    columns = []
    for state in states:
        both = []
        for sign in (1.0, -1.0):
            moved = [x + sign * small * (k == state) for k, x in enumerate(rest)]
            rates = accelerations(plane, moved, trim.surfaces, trim.power)[0]
            both.append(np.array([rates[k] for k in states]))
        columns.append((both[0] - both[1]) / (2.0 * small))
    roots = np.linalg.eigvals(np.array(columns).T)
    swinging = [root for root in roots if abs(root.imag) > 1e-6]
    return max([1.0, *(abs(root) / max(-2.0 * root.real, 1e-3) for root in swinging)])


def true_curves(setting: Setting) -> list[str]:
    """Return the nonlinearities of the airplane that a record may show: each gains more than
    `MOST_GAIN` in log likelihood.
    """
    offered = [name for name, (_, _, models) in CURVES.items() if setting.model in models]
    gains = dict.fromkeys(offered, 0.0)
    larger = amplification(setting)
    for commands in setting.commands[:2]:
        s = fly(setting.plane, setting.trim, commands, setting.loops)
        about = {**s, "alpha": s["alpha"] - s["alpha"][0], "beta": s["beta"] - s["beta"][0]}
        lines = _straight(setting, s)
        samples = setting.how.rate * STEP * len(s["q"])
        for name in offered:
            channel, more, _ = CURVES[name]
            values, columns = lines[channel]
            seen = (larger if channel in RATES else 1.0) / (SIGMA[channel] * setting.how.noise)
            curved = _left(values, columns) ** 2 - _left(values, [*columns, *more(about)]) ** 2
            gains[name] += 0.5 * samples * curved * seen**2
    return [name for name, gain in gains.items() if gain > MOST_GAIN]
