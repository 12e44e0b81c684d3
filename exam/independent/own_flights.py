"""Sixty flights by the second simulator: longitudinal and lateral maneuvers of three airplanes, a third with nothing planted.

An even number belongs to whoever tunes the loop, an odd one is kept from them. Each cause is flown
twice, once for either half, by different airplanes and with other sizes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from exam.independent import causes as c
from exam.independent.airplanes import AIRPLANES, PHANTOM, TRANSPORT, Airplane
from exam.independent.causes import Cause, Scales
from exam.independent.folders import SIGMA, Planted, Recorder, Signals, recorded, truth_of, write_folder, wrong_starts
from exam.independent.six_degrees import G0, STEP, Hidden, Loops, Trim, at_speed, derivatives, dryden, fly, trimmed
from tests.independent.maneuvers import Maneuver, doublet, in_turn, three_two_one_one, tick_for, training, validation

SEED = 37
MOST_GAIN = 4.0  # log likelihood that curved polynomials may be worth in the records to fit: nobody should see them
SMALLEST = 0.3  # share of the full size below which a maneuver excites too little
OUTPUTS = {
    "rigid": ("alpha", "q", "nz"),
    "longitudinal": ("airspeed", "alpha", "theta", "q", "nz", "nx"),
    "lateral": ("beta", "p", "r", "phi", "ny"),
}
INPUTS = {"rigid": ("elevator",), "longitudinal": ("elevator", "thrust"), "lateral": ("aileron", "rudder")}
Commands = dict[str, np.ndarray]


@dataclass(frozen=True)
class Setting:
    """A flight before its causes: airplane, trim, model of the vehicle file, commands of three records, loops, recorder."""

    plane: Airplane
    trim: Trim
    model: str
    commands: tuple[Commands, ...]
    loops: Loops
    how: Recorder
    scales: Scales


@dataclass(frozen=True)
class Act:
    """A planted cause of the airplane, its surroundings or its sensors.

    ``hidden`` gives what acts in the equations on a record; ``flown`` what becomes of its commands,
    where the record shows them as they were asked.
    """

    cause: Cause
    hidden: Callable[[Hidden, int], Hidden] = lambda hidden, part: hidden
    flown: Callable[[Commands], Commands] = lambda commands: commands


Draw = Callable[[Setting, np.random.Generator], Act]


def _same(signals: Signals, step: float) -> Signals:
    return signals


def _sensor(make: Callable[[str, Scales, np.random.Generator], Cause], channel: str) -> Draw:
    return lambda setting, rng: Act(make(channel, setting.scales, rng))


def _inputs(name: str, surface: str) -> tuple[str, ...]:
    return (name, f"{name}:{surface}")


def turbulence(setting: Setting, rng: np.random.Generator) -> Act:
    """Dryden turbulence along all axes in every record."""
    sigma, length, seed = float(rng.uniform(0.5, 1.0)), float(rng.uniform(100.0, 300.0)), int(rng.integers(2**31))
    counts = [len(next(iter(commands.values()))) for commands in setting.commands]
    gusts = [dryden(setting.plane.airspeed, sigma, length, count, np.random.default_rng([seed, part])) for part, count in enumerate(counts)]
    planted = Planted("turbulence", ("gust-turbulence",), (), ("turbulence",), {"gust-turbulence": {"sigma": sigma}})
    return Act(Cause(planted, _same), lambda hidden, part: replace(hidden, gust=gusts[part]))


def side_gust(setting: Setting, rng: np.random.Generator) -> Act:
    """One gust from the side, 1 - cosine, in each record at another time."""
    counts = [len(next(iter(commands.values()))) for commands in setting.commands]
    length = float(rng.uniform(1.0, 2.5)) * max(setting.scales.time, 0.3)
    peak, starts = 0.05 * setting.plane.airspeed * float(rng.uniform(0.7, 1.2)), rng.uniform(0.15, 0.7, 3)
    gusts = []
    for count, start in zip(counts, starts, strict=True):
        since = STEP * np.arange(count) - start * STEP * count
        shape = np.where((since >= 0.0) & (since <= length), 0.5 * (1.0 - np.cos(2.0 * np.pi * since / length)), 0.0)
        gusts.append(np.stack([0.0 * shape, -peak * shape, 0.0 * shape]))
    return Act(Cause(Planted("side gust", ("gust-discrete",), (), ("beta",), {}), _same), lambda hidden, part: replace(hidden, gust=gusts[part]))


def control_jump(setting: Setting, rng: np.random.Generator) -> Act:
    """The elevator loses a quarter to two fifths of its effect at a time."""
    factor, share = float(rng.uniform(0.6, 0.75)), float(rng.uniform(0.3, 0.6))
    counts = [len(next(iter(commands.values()))) for commands in setting.commands]
    planted = Planted("jump of the elevator's effect", ("derivative-jump",), (), ("elevator",), {})
    return Act(Cause(planted, _same), lambda hidden, part: replace(hidden, jump=(share * STEP * counts[part], "elevator", factor)))


def _travel(setting: Setting, surface: str) -> float:
    return max(float(np.max(np.abs(commands[surface]))) for commands in setting.commands)


def dead_band(surface: str) -> Draw:
    """Play that a spring centres: near neutral the surface does not follow."""

    def draw(setting: Setting, rng: np.random.Generator) -> Act:
        width = float(rng.uniform(0.15, 0.3)) * _travel(setting, surface)
        values = {name: {"half_width": width} for name in _inputs("input-deadband", surface)}
        planted = Planted(f"dead band of the {surface}", _inputs("input-deadband", surface), _inputs("input-backlash", surface), (surface,), values)
        act = lambda x: float(np.sign(x)) * max(abs(x) - width, 0.0)  # noqa: E731
        return Act(Cause(planted, _same), lambda hidden, part: replace(hidden, linkage={surface: act}))

    return draw


def saturation(surface: str) -> Draw:
    """A stop that the recorded actuator passes and the surface does not."""

    def draw(setting: Setting, rng: np.random.Generator) -> Act:
        limit = float(rng.uniform(0.45, 0.65)) * _travel(setting, surface)
        values = {name: {"limit": limit} for name in _inputs("actuator-saturation", surface)}
        near = _inputs("control-nonlinearity", surface)
        planted = Planted(f"stop of the {surface}", _inputs("actuator-saturation", surface), near, (surface,), values)
        return Act(Cause(planted, _same), lambda hidden, part: replace(hidden, linkage={surface: lambda x: min(max(x, -limit), limit)}))

    return draw


def thrust_pulse(setting: Setting, rng: np.random.Generator) -> Act:
    """One engine surges for a while: an unrecorded yawing moment, a fifth to a third of what the rudder can give."""
    plane = setting.plane
    pressed = 0.5 * plane.density * plane.airspeed**2 * plane.area
    arm = 0.15 * plane.span
    yaw = abs(derivatives(plane, setting.trim, "lateral")["Cn_dr"]) * _travel(setting, "rudder") * float(rng.uniform(0.4, 0.8))
    force = yaw * pressed * plane.span / arm * float(rng.choice([-1.0, 1.0]))
    length, starts = float(rng.uniform(1.0, 2.5)), rng.uniform(2.0, 12.0, 3)
    near = ("unmeasured-input:roll", "unmeasured-input:side_force")
    planted = Planted("asymmetric thrust pulse", ("unmeasured-input:yaw",), near, ("yaw", "r"), {})
    return Act(Cause(planted, _same), lambda hidden, part: replace(hidden, pulse=(float(starts[part]), length, force, arm)))


def lagged_loads(setting: Setting, rng: np.random.Generator) -> Act:
    """A part of lift and pitching moment follows the angle of attack late: no effect of the library says it."""
    share, lag = float(rng.uniform(0.3, 0.6)), float(rng.uniform(0.5, 1.2)) * setting.scales.time
    planted = Planted("lagged loads", (), ("flow-separation",), ("load factor", "pitch rate", "angle of attack"), {})
    return Act(Cause(planted, _same), lambda hidden, part: replace(hidden, lag=(share, lag)))


def stall_hysteresis(setting: Setting, rng: np.random.Generator) -> Act:
    """Flow that separates above an angle of attack and attaches again below a lower one: no effect of the library says it."""
    upper = float(np.radians(rng.uniform(0.9, 1.4)))
    stall = (upper, upper - float(np.radians(rng.uniform(0.8, 1.3))), float(rng.uniform(0.05, 0.1)))
    near = ("flow-separation", "lift-nonlinearity", "moment-nonlinearity")
    return Act(Cause(Planted("stall hysteresis", (), near, ("angle of attack",), {}), _same), lambda hidden, part: replace(hidden, stall=stall))


def thrust_lag(setting: Setting, rng: np.random.Generator) -> Act:
    """The record holds the thrust that was asked, the engine follows with a lag."""
    lag = float(rng.uniform(0.7, 1.5))
    near = ("input-delay:thrust", "actuator-second-order:thrust", "actuator-rate-limit:thrust")
    planted = Planted("engine lag", ("actuator-lag:thrust",), near, ("thrust",), {"actuator-lag:thrust": {"time_constant": lag}})
    return Act(Cause(planted, _same), flown=lambda commands: {**commands, "thrust": c.lagged(commands["thrust"], STEP, lag)})


PLANTED: tuple[tuple[str, tuple[Draw, ...]], ...] = (
    ("rigid", (_sensor(c.boom, "alpha"),)),
    ("lateral", (_sensor(c.late_sensor, "beta"),)),
    ("longitudinal", (_sensor(c.late_sensor, "alpha"), _sensor(c.drifting, "theta"))),
    ("rigid", (_sensor(c.late_sensor, "q"),)),
    ("lateral", (_sensor(c.lagging_sensor, "p"),)),
    ("rigid", (control_jump,)),
    ("longitudinal", (thrust_lag,)),
    ("lateral", (_sensor(c.cross_axis, "r"),)),
    ("rigid", (_sensor(c.recorded_late, "elevator"),)),
    ("longitudinal", (_sensor(c.accelerometer_ahead, "nz"),)),
    ("lateral", (side_gust,)),
    ("rigid", (turbulence,)),
    ("lateral", (saturation("rudder"),)),
    ("rigid", (_sensor(c.boom, "alpha"), _sensor(c.wrong_scale, "q"))),
    ("longitudinal", (_sensor(c.wrong_scale, "airspeed"),)),
    ("lateral", (thrust_pulse,)),
    ("rigid", (stall_hysteresis,)),
    ("longitudinal", (lagged_loads,)),
    ("lateral", (_sensor(c.accelerometer_ahead, "ny"), _sensor(c.wrong_scale, "r"))),
    ("rigid", (dead_band("elevator"),)),
)
CLEAN = tuple((model, ()) for model in ("rigid", "lateral", "longitudinal", "rigid", "lateral", "longitudinal", "rigid", "lateral", "longitudinal", "rigid"))
SPECS: tuple[tuple[str, tuple[Draw, ...]], ...] = tuple(spec for k in range(10) for spec in (CLEAN[k], PLANTED[2 * k], PLANTED[2 * k + 1]))
COUNT = 2 * len(SPECS)


def fly_flight(number: int, folder: Path) -> None:
    """Fly number 1 to `COUNT` and write its folder; the same number gives the same bytes."""
    model, draws = SPECS[(number - 1) // 2]
    rng = np.random.default_rng([SEED, 2, number])
    setting, bend = drawn_setting(number, model, rng)
    acts = [draw(setting, rng) for draw in draws]
    names = OUTPUTS[model] if model != "rigid" or rng.random() < 0.7 else (*OUTPUTS[model], "theta", "airspeed")
    records, slowest = [], 0.0
    for part, commands in enumerate(setting.commands):
        hidden, flown = Hidden(lateral=model == "lateral"), commands
        for act in acts:
            hidden, flown = act.hidden(hidden, part), act.flown(flown)
        signals = fly(setting.plane, setting.trim, flown, setting.loops, hidden)
        if flown is not commands:
            signals["thrust"] = signals["thrust"] - flown["thrust"] + commands["thrust"]
        slowest = max(slowest, float(np.max(np.abs(signals["airspeed"] / setting.plane.airspeed - 1.0))))
        for act in acts:
            signals = act.cause.plant(signals, STEP)
        seen = {name: signals[name] for name in (*INPUTS[model], *names)}
        records.append(recorded(seen, STEP, INPUTS[model], setting.how, rng))
    harmless = [*true_curves(setting), *(["phugoid"] if model == "rigid" else [])]
    if slowest > 0.03 and model != "longitudinal":
        harmless.append("speed-variation")
    true = derivatives(setting.plane, setting.trim, model)
    notes: dict[str, Any] = {"simulator": "own", "bend": bend, "rate": setting.how.rate, "cutoff": setting.how.cutoff}
    notes["closed_loop"] = setting.loops.pitch_rate != 0.0 or setting.loops.yaw_rate != 0.0
    truth = truth_of(model, setting.plane.name, [act.cause.planted for act in acts], harmless, true, notes)
    vehicle = {"name": f"aircraft {number + 60}", **vehicle_file(setting.plane, setting.trim, model)}
    write_folder(folder, records, vehicle, wrong_starts(true, rng), truth)


def drawn_setting(number: int, model: str, rng: np.random.Generator) -> tuple[Setting, float]:
    """Airplane, trim, maneuvers and recorder of a flight, and what curved polynomials leave in noise sigmas."""
    fleet = (TRANSPORT, PHANTOM) if model == "longitudinal" else AIRPLANES
    plane = at_speed(fleet[((number - 1) // 2 + (number - 1) % 2 + (number - 1) // 6) % len(fleet)], float(rng.uniform(0.94, 1.08)))
    trim = trimmed(plane)
    fast = plane.mass < 100.0
    rate = float(rng.choice([50.0, 100.0] if fast else [25.0, 50.0, 50.0]))
    how = Recorder(rate, float(rng.choice([15.0, 20.0] if fast else [6.0, 10.0, 20.0])), float(rng.choice([0.7, 1.0])))
    true = derivatives(plane, trim, model)
    closed = bool(rng.random() < 0.4)
    frequency = fast_mode(plane, trim, model)
    scales = Scales(plane.span / 6.0 if model == "lateral" else plane.chord, 1.0 / frequency)
    loops = loops_of(plane, true, model, closed, rng)
    setting = Setting(plane, trim, model, maneuvers(model, tick_for(frequency)), loops, how, scales)
    return sized(setting)


def fast_mode(plane: Airplane, trim: Trim, model: str) -> float:
    """Frequency (rad/s) of short period or Dutch roll from the static stability."""
    pressed = 0.5 * plane.density * plane.airspeed**2 * plane.area
    ixx, iyy, izz, _ = plane.inertia
    if model == "lateral":
        d = derivatives(plane, trim, "lateral")
        stiffness = d["Cn_beta"] * np.cos(trim.alpha) - izz / ixx * d["Cl_beta"] * np.sin(trim.alpha)
        return float(np.sqrt(pressed * plane.span * stiffness / izz))
    d = derivatives(plane, trim, "rigid")
    return float(np.sqrt(-pressed * plane.chord * d["Cm_alpha"] / iyy))


def loops_of(plane: Airplane, true: Mapping[str, float], model: str, closed: bool, rng: np.random.Generator) -> Loops:
    """A hand that keeps the wings level, and in closed-loop flights a damper, perhaps with attitude hold."""
    if model == "lateral":
        damper = float(rng.uniform(0.5, 1.5)) * true["Cn_r"] / true["Cn_dr"] * plane.span / (2.0 * plane.airspeed)
        return Loops(bank=0.1, yaw_rate=damper if closed else 0.0)
    damper = float(rng.uniform(0.4, 1.2)) * true["Cm_q"] / true["Cm_de"] * plane.chord / (2.0 * plane.airspeed)
    attitude = 0.3 if closed and rng.random() < 0.5 else 0.0
    return Loops(pitch_rate=damper if closed else 0.0, attitude=attitude, bank=0.4, roll_rate=0.1)


def maneuvers(model: str, tick: float) -> tuple[Commands, ...]:
    """Commands of two records to fit and one to predict, of size one."""
    if model != "lateral":
        elevators = (*training(tick), validation(tick))
        thrusts = (doublet(6.0, 3.0), in_turn(4.0, 1.0, (-1.0, 1.0), (4, 3)), in_turn(6.0, 1.0, (0.8,), (6,)))
        out = []
        for one, pulses in zip(elevators, thrusts, strict=True):
            time = STEP * np.arange(round(one.duration / STEP) + 1)
            out.append({"elevator": one.at(time)} | ({"thrust": Maneuver(pulses, one.duration, 0.5).at(time)} if model == "longitudinal" else {}))
        return tuple(out)
    ailerons = (
        doublet(1.0, 0.8) + in_turn(11.0, 0.5, (0.7, -0.7, 0.7), (1, 2, 1)),
        doublet(8.0 + 3.0 * tick, 1.0, -0.8),
        in_turn(1.5, 0.7, (0.8, -0.8, 0.8), (1, 2, 1)) + doublet(14.0, 0.5, -0.6),
    )
    rudders = (doublet(4.0, 1.5 * tick) + doublet(15.0, tick, -0.7), three_two_one_one(1.5, tick), doublet(6.0, 1.2 * tick, -0.9))
    time = STEP * np.arange(round(22.0 / STEP) + 1)
    return tuple({"aileron": Maneuver(one, 22.0).at(time), "rudder": Maneuver(two, 22.0).at(time)} for one, two in zip(ailerons, rudders, strict=True))


def sized(setting: Setting) -> tuple[Setting, float]:
    """The setting with commands as large as the flight stands, and smaller where the polynomials bend within it."""
    first = setting.commands[0]
    scale: dict[str, float] = {}
    for name in first:
        only = {other: (values if other == name else 0.0 * values) for other, values in first.items()}
        unit = 0.02 * setting.plane.mass * G0 if name == "thrust" else 0.005
        flown = fly(setting.plane, setting.trim, {other: unit * values for other, values in only.items()}, setting.loops)
        most = {channel: float(np.max(np.abs(flown[channel] - flown[channel][0]))) for channel in ("alpha", "nz", "beta", "p", "phi", "airspeed")}
        limits = {
            "elevator": {"alpha": np.radians(4.0), "nz": 0.5},
            "thrust": {"airspeed": 0.03 * setting.plane.airspeed},
            "aileron": {"p": np.radians(25.0), "phi": np.radians(18.0)},
            "rudder": {"beta": np.radians(4.0), "phi": np.radians(12.0)},
        }[name]
        scale[name] = unit * min(limit / most[channel] for channel, limit in limits.items())
    whole = replace(setting, commands=_scaled(setting.commands, scale, 1.0))
    samples = setting.how.rate * sum(STEP * len(next(iter(one.values()))) for one in setting.commands[:2])
    allowed, bend, share = float(np.sqrt(2.0 * MOST_GAIN / samples)), bend_of(whole), 1.0
    if bend > allowed:
        # A bend grows with the square of the size.
        share = max(SMALLEST, float(np.sqrt(allowed / bend)))
        whole = replace(setting, commands=_scaled(setting.commands, scale, share))
        bend = bend_of(whole)
    return whole, bend


def _scaled(commands: Sequence[Commands], scale: Mapping[str, float], share: float) -> tuple[Commands, ...]:
    return tuple({name: share * scale[name] * values for name, values in one.items()} for one in commands)


def _straight(setting: Setting, s: Signals) -> dict[str, tuple[np.ndarray, list[np.ndarray]]]:
    """Loads and kinematics that straight lines should explain, by channel: values, and the columns of the lines.

    Rates of change count with the time of the fast mode, so that all are in units of their channel.
    """
    one, pressure = np.ones(len(s["q"])), (s["airspeed"] / setting.plane.airspeed) ** 2
    pace = np.sqrt(pressure)
    rate = {name: np.gradient(s[name], STEP) * setting.scales.time for name in ("q", "p", "r", "beta", "phi")}
    if setting.model == "lateral":
        columns = [s["beta"], s["p"], s["r"], s["aileron"], s["rudder"], one]
        found = {"ny": (s["ny"], columns), "p": (rate["p"], columns), "r": (rate["r"], columns)}
        return {**found, "beta": (rate["beta"], [*columns, s["phi"]]), "phi": (rate["phi"], [s["p"], s["r"], one])}
    columns = [s["alpha"] * pressure, s["q"] * pace, s["elevator"] * pressure, pressure, pace, one]
    found = {"nz": (s["nz"], columns), "q": (rate["q"], [*columns, s["thrust"]])}
    if setting.model == "longitudinal":
        # Thrust and the lift that tilts with alpha belong to the model.
        found["nx"] = (s["nx"] - s["thrust"] / (setting.plane.mass * G0), [*columns, s["alpha"] * s["nz"]])
    return found


def _left(values: np.ndarray, columns: Sequence[np.ndarray]) -> float:
    """Standard deviation of what lines over the columns leave."""
    matrix = np.stack(columns, axis=1)
    return float(np.std(values - matrix @ np.linalg.lstsq(matrix, values, rcond=None)[0]))


def bend_of(setting: Setting) -> float:
    """What straight lines leave on the records to fit, in noise sigmas of the worst channel."""
    worst = 0.0
    for commands in setting.commands[:2]:
        lines = _straight(setting, fly(setting.plane, setting.trim, commands, setting.loops))
        for name, (values, columns) in lines.items():
            worst = max(worst, _left(values, columns) / (SIGMA[name] * setting.how.noise))
    return worst


CURVES: Mapping[str, tuple[str, Callable[[Signals], list[np.ndarray]], tuple[str, ...]]] = {
    "lift-nonlinearity": ("nz", lambda s: [s["alpha"] ** 2, s["alpha"] ** 3], ("rigid", "longitudinal")),
    "moment-nonlinearity": ("q", lambda s: [s["alpha"] ** 2, s["alpha"] ** 3], ("rigid", "longitudinal")),
    "drag-nonlinearity": ("nx", lambda s: [s["alpha"] ** 2, s["alpha"] ** 3], ("longitudinal",)),
    "varies:CL_q(alpha)": ("nz", lambda s: [s["alpha"] * s["q"]], ("rigid", "longitudinal")),
    "varies:CL_alpha(q)": ("nz", lambda s: [s["alpha"] * s["q"]], ("rigid", "longitudinal")),
    "varies:Cm_q(alpha)": ("q", lambda s: [s["alpha"] * s["q"]], ("rigid", "longitudinal")),
    "varies:Cm_alpha(q)": ("q", lambda s: [s["alpha"] * s["q"]], ("rigid", "longitudinal")),
    "side-force-nonlinearity": ("ny", lambda s: [s["beta"] ** 2, s["beta"] ** 3], ("lateral",)),
    "roll-nonlinearity": ("p", lambda s: [s["beta"] ** 2, s["beta"] ** 3], ("lateral",)),
    "yaw-nonlinearity": ("r", lambda s: [s["beta"] ** 2, s["beta"] ** 3], ("lateral",)),
}
"""Effects that curved polynomials may make true: name -> channel of the load, its columns, models."""


def true_curves(setting: Setting) -> list[str]:
    """Curves that the airplane itself has and that a record may show: each worth more than `MOST_GAIN` in log likelihood."""
    gains = dict.fromkeys((name for name, (_, _, models) in CURVES.items() if setting.model in models), 0.0)
    for commands in setting.commands[:2]:
        s = fly(setting.plane, setting.trim, commands, setting.loops)
        about = {**s, "alpha": s["alpha"] - s["alpha"][0], "beta": s["beta"] - s["beta"][0]}
        lines = _straight(setting, s)
        samples = setting.how.rate * STEP * len(s["q"])
        for name in gains:
            channel, more, _ = CURVES[name]
            values, columns = lines[channel]
            noise = SIGMA[channel] * setting.how.noise
            gains[name] += 0.5 * samples * (_left(values, columns) ** 2 - _left(values, [*columns, *more(about)]) ** 2) / noise**2
    return [name for name, gain in gains.items() if gain > MOST_GAIN]


def vehicle_file(plane: Airplane, trim: Trim, model: str) -> dict[str, float]:
    """The constants of the vehicle file."""
    ixx, iyy, izz, ixz = plane.inertia
    both = {"mass": plane.mass, "wing_area": plane.area}
    if model == "lateral":
        inertia = {"roll_inertia": ixx, "yaw_inertia": izz, "cross_inertia": ixz}
        about = {"airspeed": plane.airspeed, "air_density": plane.density, "trim_alpha": trim.alpha, "trim_theta": trim.theta}
        return {**both, "span": plane.span, **inertia, **about}
    pitch = {"chord": plane.chord, "pitch_inertia": iyy, "air_density": plane.density}
    if model == "rigid":
        return {**both, **pitch, "airspeed": plane.airspeed}
    return {**both, **pitch, "reference_airspeed": plane.airspeed, "thrust_arm": plane.thrust_arm}
