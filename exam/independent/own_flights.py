"""Sixty flights by the second simulator: longitudinal and lateral maneuvers of three airplanes, a
third without a hidden cause.

Even numbers are for tuning the loop, odd ones are kept from it. Each cause is flown twice, once in
either half, by different airplanes and with other sizes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from exam.independent import causes as c
from exam.independent.airplanes import Airplane
from exam.independent.causes import Cause, Scales
from exam.independent.folders import (
    Planted,
    Signals,
    recorded,
    truth_of,
    write_folder,
    wrong_starts,
)
from exam.independent.settings import Commands, Setting, drawn_setting, true_curves
from exam.independent.six_degrees import STEP, Hidden, Trim, derivatives, dryden, fly

SEED = 37
OUTPUTS = {
    "rigid": ("alpha", "q", "nz"),
    "longitudinal": ("airspeed", "alpha", "theta", "q", "nz", "nx"),
    "lateral": ("beta", "p", "r", "phi", "ny"),
}
INPUTS = {
    "rigid": ("elevator",),
    "longitudinal": ("elevator", "thrust"),
    "lateral": ("aileron", "rudder"),
}


@dataclass(frozen=True)
class Act:
    """A hidden cause of the airplane, its surroundings or its sensors.

    ``hidden`` returns the part that acts in the equations on a record. ``flown`` returns the
    commands that act, if the record shows other ones.
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
    sigma, length, seed = (
        float(rng.uniform(0.5, 1.0)),
        float(rng.uniform(100.0, 300.0)),
        int(rng.integers(2**31)),
    )
    counts = [len(next(iter(commands.values()))) for commands in setting.commands]
    gusts = [
        dryden(setting.plane.airspeed, sigma, length, count, np.random.default_rng([seed, part]))
        for part, count in enumerate(counts)
    ]
    planted = Planted(
        "turbulence",
        ("gust-turbulence",),
        (),
        ("turbulence",),
        {"gust-turbulence": {"sigma": sigma}},
    )
    return Act(Cause(planted, _same), lambda hidden, part: replace(hidden, gust=gusts[part]))


def side_gust(setting: Setting, rng: np.random.Generator) -> Act:
    """One 1 - cosine gust from the side, in each record at another time."""
    counts = [len(next(iter(commands.values()))) for commands in setting.commands]
    length = float(rng.uniform(1.0, 2.5)) * max(setting.scales.time, 0.3)
    peak, starts = (
        0.05 * setting.plane.airspeed * float(rng.uniform(0.7, 1.2)),
        rng.uniform(0.15, 0.7, 3),
    )
    gusts = []
    for count, start in zip(counts, starts, strict=True):
        since = STEP * np.arange(count) - start * STEP * count
        shape = np.where(
            (since >= 0.0) & (since <= length),
            0.5 * (1.0 - np.cos(2.0 * np.pi * since / length)),
            0.0,
        )
        gusts.append(np.stack([0.0 * shape, -peak * shape, 0.0 * shape]))
    return Act(
        Cause(Planted("side gust", ("gust-discrete",), (), ("beta",), {}), _same),
        lambda hidden, part: replace(hidden, gust=gusts[part]),
    )


def control_jump(setting: Setting, rng: np.random.Generator) -> Act:
    """At one time the elevator loses a quarter to two fifths of its effect."""
    factor, share = float(rng.uniform(0.6, 0.75)), float(rng.uniform(0.3, 0.6))
    counts = [len(next(iter(commands.values()))) for commands in setting.commands]
    planted = Planted("jump of the elevator's effect", ("derivative-jump",), (), ("elevator",), {})
    return Act(
        Cause(planted, _same),
        lambda hidden, part: replace(
            hidden, jump=(share * STEP * counts[part], "elevator", factor)
        ),
    )


def _travel(setting: Setting, surface: str) -> float:
    return max(float(np.max(np.abs(commands[surface]))) for commands in setting.commands)


def dead_band(surface: str) -> Draw:
    """Play that is centred by springs: near neutral the surface does not follow."""

    def draw(setting: Setting, rng: np.random.Generator) -> Act:
        width = float(rng.uniform(0.15, 0.3)) * _travel(setting, surface)
        values = {name: {"half_width": width} for name in _inputs("input-deadband", surface)}
        planted = Planted(
            f"dead band of the {surface}",
            _inputs("input-deadband", surface),
            _inputs("input-backlash", surface),
            (surface,),
            values,
        )
        act = lambda x: float(np.sign(x)) * max(abs(x) - width, 0.0)  # noqa: E731
        return Act(
            Cause(planted, _same), lambda hidden, part: replace(hidden, linkage={surface: act})
        )

    return draw


def saturation(surface: str) -> Draw:
    """A stop of the surface, which the recorded actuator does not have."""

    def draw(setting: Setting, rng: np.random.Generator) -> Act:
        limit = float(rng.uniform(0.45, 0.65)) * _travel(setting, surface)
        values = {name: {"limit": limit} for name in _inputs("actuator-saturation", surface)}
        near = _inputs("control-nonlinearity", surface)
        planted = Planted(
            f"stop of the {surface}",
            _inputs("actuator-saturation", surface),
            near,
            (surface,),
            values,
        )
        return Act(
            Cause(planted, _same),
            lambda hidden, part: replace(
                hidden, linkage={surface: lambda x: min(max(x, -limit), limit)}
            ),
        )

    return draw


def thrust_pulse(setting: Setting, rng: np.random.Generator) -> Act:
    """One engine has more thrust for some time: an unrecorded yawing moment, a fifth to a third of
    the largest one of the rudder.
    """
    plane = setting.plane
    pressed = 0.5 * plane.density * plane.airspeed**2 * plane.area
    arm = 0.15 * plane.span
    yaw = (
        abs(derivatives(plane, setting.trim, "lateral")["Cn_dr"])
        * _travel(setting, "rudder")
        * float(rng.uniform(0.4, 0.8))
    )
    force = yaw * pressed * plane.span / arm * float(rng.choice([-1.0, 1.0]))
    length, starts = float(rng.uniform(1.0, 2.5)), rng.uniform(2.0, 12.0, 3)
    near = ("unmeasured-input:roll", "unmeasured-input:side_force")
    planted = Planted("asymmetric thrust pulse", ("unmeasured-input:yaw",), near, ("yaw", "r"), {})
    return Act(
        Cause(planted, _same),
        lambda hidden, part: replace(hidden, pulse=(float(starts[part]), length, force, arm)),
    )


def lagged_loads(setting: Setting, rng: np.random.Generator) -> Act:
    """A part of lift and pitching moment follows the angle of attack late; not an effect of the
    library.
    """
    share, lag = float(rng.uniform(0.3, 0.6)), float(rng.uniform(0.5, 1.2)) * setting.scales.time
    planted = Planted(
        "lagged loads",
        (),
        ("flow-separation",),
        ("load factor", "pitch rate", "angle of attack"),
        {},
    )
    return Act(Cause(planted, _same), lambda hidden, part: replace(hidden, lag=(share, lag)))


def stall_hysteresis(setting: Setting, rng: np.random.Generator) -> Act:
    """Flow that separates above an angle of attack and reattaches below a lower one; not an effect
    of the library.
    """
    upper = float(np.radians(rng.uniform(0.9, 1.4)))
    stall = (upper, upper - float(np.radians(rng.uniform(0.8, 1.3))), float(rng.uniform(0.05, 0.1)))
    near = ("flow-separation", "lift-nonlinearity", "moment-nonlinearity")
    return Act(
        Cause(Planted("stall hysteresis", (), near, ("angle of attack",), {}), _same),
        lambda hidden, part: replace(hidden, stall=stall),
    )


def thrust_lag(setting: Setting, rng: np.random.Generator) -> Act:
    """The commanded thrust is recorded, and the engine follows with a lag."""
    lag = float(rng.uniform(0.7, 1.5))
    near = ("input-delay:thrust", "actuator-second-order:thrust", "actuator-rate-limit:thrust")
    planted = Planted(
        "engine lag",
        ("actuator-lag:thrust",),
        near,
        ("thrust",),
        {"actuator-lag:thrust": {"time_constant": lag}},
    )
    return Act(
        Cause(planted, _same),
        flown=lambda commands: {**commands, "thrust": c.lagged(commands["thrust"], STEP, lag)},
    )


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
Spec = tuple[str, tuple[Draw, ...]]
CLEAN: tuple[Spec, ...] = (
    *3 * (("rigid", ()), ("lateral", ()), ("longitudinal", ())),
    ("rigid", ()),
)
SPECS: tuple[Spec, ...] = tuple(
    spec for k in range(10) for spec in (CLEAN[k], PLANTED[2 * k], PLANTED[2 * k + 1])
)
COUNT = 2 * len(SPECS)


def fly_flight(number: int, folder: Path, draw: int = 0) -> None:
    """Fly number 1 to `COUNT` and write its folder; the same number and draw give the same bytes.

    Another draw has the same causes in the same order, with other airplanes and sizes.
    """
    model, causes = SPECS[(number - 1) // 2]
    rng = np.random.default_rng([SEED, 2, number, *([draw] if draw else [])])
    setting, bend = drawn_setting(number + 2 * draw, model, rng)
    acts = [make(setting, rng) for make in causes]
    names = (
        OUTPUTS[model]
        if model != "rigid" or rng.random() < 0.7
        else (*OUTPUTS[model], "theta", "airspeed")
    )
    records, slowest = [], 0.0
    for part, commands in enumerate(setting.commands):
        hidden, flown = Hidden(lateral=model == "lateral"), commands
        for act in acts:
            hidden, flown = act.hidden(hidden, part), act.flown(flown)
        signals = fly(setting.plane, setting.trim, flown, setting.loops, hidden)
        if flown is not commands:
            signals["thrust"] = signals["thrust"] - flown["thrust"] + commands["thrust"]
        slowest = max(
            slowest, float(np.max(np.abs(signals["airspeed"] / setting.plane.airspeed - 1.0)))
        )
        for act in acts:
            signals = act.cause.plant(signals, STEP)
        seen = {name: signals[name] for name in (*INPUTS[model], *names)}
        records.append(recorded(seen, STEP, INPUTS[model], setting.how, rng))
    harmless = [*true_curves(setting), *(["phugoid"] if model == "rigid" else [])]
    if slowest > 0.03 and model != "longitudinal":
        harmless.append("speed-variation")
    true = derivatives(setting.plane, setting.trim, model)
    notes: dict[str, Any] = {
        "simulator": "own",
        "bend": bend,
        "rate": setting.how.rate,
        "cutoff": setting.how.cutoff,
    }
    notes["closed_loop"] = setting.loops.pitch_rate != 0.0 or setting.loops.yaw_rate != 0.0
    truth = truth_of(
        model, setting.plane.name, [act.cause.planted for act in acts], harmless, true, notes
    )
    vehicle = {
        "name": f"aircraft {number + 60}",
        **vehicle_file(setting.plane, setting.trim, model),
    }
    write_folder(folder, records, vehicle, wrong_starts(true, rng), truth)


def vehicle_file(plane: Airplane, trim: Trim, model: str) -> dict[str, float]:
    """Return the constants of the vehicle file."""
    ixx, iyy, izz, ixz = plane.inertia
    both = {"mass": plane.mass, "wing_area": plane.area}
    if model == "lateral":
        inertia = {"roll_inertia": ixx, "yaw_inertia": izz, "cross_inertia": ixz}
        about = {
            "airspeed": plane.airspeed,
            "air_density": plane.density,
            "trim_alpha": trim.alpha,
            "trim_theta": trim.theta,
        }
        return {**both, "span": plane.span, **inertia, **about}
    pitch = {"chord": plane.chord, "pitch_inertia": iyy, "air_density": plane.density}
    if model == "rigid":
        return {**both, **pitch, "airspeed": plane.airspeed}
    return {**both, **pitch, "reference_airspeed": plane.airspeed, "thrust_arm": plane.thrust_arm}
