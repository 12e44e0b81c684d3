"""All kinds of causes that a random case may hide: effects of the library in an aircraft and in a
falling body, causes outside the library, and faults of the recorder.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from exam import recorder_faults as faults
from exam.random_cases.case import (
    AIRCRAFT,
    ALL,
    Draw,
    Kind,
    Setting,
    either,
    pulse,
    several,
    share,
    signed,
    uniform,
)
from exam.random_cases.vehicles import NOISE
from exam.scoring import same_fault
from sim.maths import G0

# ---- What the library has a name for, hidden in an aircraft

RIGID, NZ = ("rigid",), ("nz",)


def _curved_moment(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    return {"loss": s.moment * either(rng) * float(rng.uniform(0.2, 0.9)), "width": 0.04}


def _curved_lift(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    return {"loss": s.lift * float(rng.uniform(1.0, 4.0))}


def _weak_control(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    return {"cubic": float(rng.uniform(0.1, 0.35)) / s.peak**2}


def _jump(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    names = (
        ("Cm_alpha", "Cm_q", "Cm_de", "CL_alpha")
        if "Cm_alpha" in s.model.parameters
        else ("M_alpha", "M_q", "M_delta", "L_alpha")
    )
    chosen, part = int(rng.choice(3)), float(rng.uniform(0.6, 1.4))
    # Shares of usual derivatives: stability and control are lost, damping is gained.
    size = (-0.37, 0.41, -0.31)[chosen] * s.value(names[chosen])
    return {
        "time": float(rng.uniform(0.25, 0.6) * s.duration),
        **dict.fromkeys(names, 0.0),
        names[chosen]: part * size,
    }


def _mode(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    values = several(
        rng,
        frequency=(9.0, 22.0),
        damping=(0.015, 0.06),
        lift=(0.05, 0.3),
        moment=(-0.5, -0.1),
        gyro=(0.01, 0.04),
    )
    # The low-order equivalent counts nose up as positive, a trailing edge down turns the nose down.
    turned = 1.0 if s.control == 1.0 else -1.0
    loads = {
        "lift": values["lift"] * turned * s.lift / s.control,
        "moment": values["moment"] * turned * s.moment / s.control,
    }
    return {**values, **loads, "gyro": values["gyro"] * turned / s.control, "angle_gain": 0.0}


def _gust(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    start, length = pulse(rng, s, 0.5, 2.0)
    return {"peak": either(rng) * float(rng.uniform(2.0, 5.0)), "start": start, "duration": length}


def _push(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    start, length = pulse(rng, s, 0.5, 3.0)
    moment = s.moment * either(rng) * float(rng.uniform(0.004, 0.012))
    return {
        "start": start,
        "duration": length,
        "moment": moment,
        "lift": s.lift * float(rng.normal(0.0, 0.01)),
    }


def _exchange(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    return {
        "gravity": 1.0,
        **several(rng, path=(-0.09, 0.09), weight_share=(0.05, 0.12), induced=(0.2, 0.6)),
    }


def _zero_step(channel: str) -> Kind:
    sigma = {"alpha": 0.0012, "q": 0.0015, "nz": 0.012}[channel]

    def draw(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
        return {
            "at": float(rng.uniform(0.2, 0.7) * s.duration),
            "size": sigma * either(rng) * float(rng.uniform(4.0, 12.0)),
        }

    name = f"sensor-step:{channel}"
    return Kind(draw, name, name, apart=True)


def _same_name(name: str, draw: object, **more: object) -> Kind:
    return Kind(draw, name, name, **more)  # type: ignore[arg-type]


EFFECTS: Mapping[str, Kind] = {
    "input-delay": _same_name("input-delay", uniform(0.02, 0.15, "delay"), models=RIGID),
    "actuator-lag": _same_name("actuator-lag", uniform(0.04, 0.2, "time_constant"), models=RIGID),
    "actuator-rate-limit": _same_name("actuator-rate-limit", share(2.0, 5.0, "rate")),
    "actuator-saturation": _same_name("actuator-saturation", share(0.5, 0.85, "limit")),
    "input-deadband": _same_name("input-deadband", share(0.05, 0.25, "half_width")),
    "input-backlash": _same_name("input-backlash", share(0.04, 0.2, "half_width")),
    "curved moment": Kind(_curved_moment, "own:tanh-moment", "moment-nonlinearity"),
    "curved lift": Kind(_curved_lift, "own:stalling-lift", "lift-nonlinearity"),
    "weak control": Kind(_weak_control, "own:weakening-control", "control-nonlinearity"),
    "derivative-jump": _same_name("derivative-jump", _jump, apart=True),
    "elastic-mode": _same_name("elastic-mode", _mode),
    "gust-turbulence": _same_name("gust-turbulence", uniform(0.5, 2.5, "sigma")),
    "gust-discrete": _same_name("gust-discrete", _gust, apart=True),
    "half-sine gust": Kind(_gust, "own:half-sine-gust", "gust-discrete", apart=True),
    "speed-variation": _same_name("speed-variation", signed(0.3, 1.2, "rate")),
    "energy exchange": Kind(
        _exchange,
        "own:energy-exchange",
        "phugoid",
        models=RIGID,
        apart=True,
        same=("weight_share", "induced"),
    ),
    "unmeasured-input": _same_name("unmeasured-input", _push, apart=True),
    "vane-offset": _same_name("vane-offset", uniform(2.0, 12.0, "arm"), channels=NZ),
    "accelerometer-offset:nz": _same_name(
        "accelerometer-offset:nz", uniform(3.0, 12.0, "arm"), channels=NZ
    ),
    "quadratic vane": Kind(
        signed(2.0, 6.0, "curvature"), "sensor-curve:alpha", "sensor-curve:alpha", channels=NZ
    ),
    "sensor-scale:alpha": _same_name(
        "sensor-scale:alpha", uniform(1.08, 1.3, "scale"), channels=NZ
    ),
    "sensor-scale:q": _same_name("sensor-scale:q", uniform(1.08, 1.3, "scale"), channels=NZ),
    "sensor-lag:alpha": _same_name("sensor-lag:alpha", uniform(0.03, 0.15, "time_constant")),
    "sensor-delay:q": _same_name("sensor-delay:q", uniform(0.03, 0.12, "delay"), channels=NZ),
    "sensor-delay:nz": _same_name("sensor-delay:nz", uniform(0.03, 0.12, "delay"), channels=NZ),
    "sensor-drift:q": _same_name("sensor-drift:q", signed(0.0003, 0.002, "slope"), apart=True),
    "sensor-drift:alpha": _same_name(
        "sensor-drift:alpha", signed(0.0003, 0.002, "slope"), apart=True
    ),
    "sensor-step:alpha": _zero_step("alpha"),
    "sensor-step:q": _zero_step("q"),
    "sensor-spikes:q": _same_name("sensor-spikes:q", uniform(0.03, 0.1, "size")),
}


# ---- What the library has a name for, hidden in the fall of a body

BALLISTIC = ("ballistic",)


def _mach_drag(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    # Only near the speed of sound does drag change within less than a Mach number, and no fall
    # drawn here comes that low.
    return {
        "size": either(rng) * float(rng.uniform(0.2, 0.5)),
        **several(rng, middle=(3.0, 4.5), width=(1.0, 2.0)),
    }


def _drag_jump(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    return {
        "time": float(rng.uniform(0.5, 0.8) * s.duration),
        "factor": float(np.exp(either(rng) * rng.uniform(0.2, 0.6))),
    }


def _altitude_step(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    return {
        "at": float(rng.uniform(0.2, 0.8) * s.duration),
        "size": either(rng) * float(rng.uniform(40.0, 120.0)),
    }


FALLING: Mapping[str, Kind] = {
    "density-scale-height": Kind(
        signed(0.04, 0.12, "change"), "density-scale-height", "density-scale-height", BALLISTIC
    ),
    "mach drag": Kind(_mach_drag, "own:mach-drag", "drag-mach", BALLISTIC),
    "drag-jump": Kind(_drag_jump, "drag-jump", "drag-jump", BALLISTIC, apart=True),
    "sensor-scale:altitude": Kind(
        uniform(1.04, 1.15, "scale"), "sensor-scale:altitude", "sensor-scale:altitude", BALLISTIC
    ),
    "sensor-drift:altitude": Kind(
        signed(10.0, 30.0, "slope"),
        "sensor-drift:altitude",
        "sensor-drift:altitude",
        BALLISTIC,
        apart=True,
    ),
    "sensor-step:altitude": Kind(
        _altitude_step, "sensor-step:altitude", "sensor-step:altitude", BALLISTIC, apart=True
    ),
    "sensor-spikes:altitude": Kind(
        uniform(80.0, 400.0, "size"), "sensor-spikes:altitude", "sensor-spikes:altitude", BALLISTIC
    ),
}


# ---- Causes that no effect of the library names


def _in_moment(draw: Draw, local: str) -> Draw:
    """Convert sizes in coefficients to the moment of the equations."""

    def scaled(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
        values = draw(rng, s)
        return {**values, local: values[local] * s.moment}

    return scaled


def _product(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    return {
        "moment": either(rng) * float(rng.uniform(4.0, 9.0)) * s.moment / s.control,
        "lift": -2.0 * s.lift / s.control,
    }


def _lagged(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    values = several(rng, moment=(-0.5, -0.2), lift=(0.5, 2.0), fast=(0.15, 0.5), slow=(0.8, 2.5))
    return {**values, "moment": values["moment"] * s.moment, "lift": values["lift"] * s.lift}


def _upwash(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    return {"gain": either(rng) * float(rng.uniform(0.06, 0.2)) / s.control}


# A moment that is a function of the pitch rate is a damping that depends on it, word for word; so
# is one by a product of two signals a derivative that grows with the other: the general form names
# them.
OF_THE_RATE = ("varies:Cm_q(q)", "varies:M_q(q)")
OF_BOTH = ("varies:Cm_q(alpha)", "varies:M_q(alpha)", "varies:Cm_alpha(q)", "varies:M_alpha(q)")

FOREIGN: Mapping[str, Kind] = {
    "product": Kind(_product, "own:alpha-control-product"),
    "periodic": Kind(
        _in_moment(lambda rng, s: several(rng, size=(0.002, 0.006), frequency=(3.0, 8.0)), "size"),
        "own:periodic-moment",
    ),
    "rate damping": Kind(
        _in_moment(lambda rng, s: several(rng, size=(-0.9, -0.3)), "size"),
        "own:rate-damping",
        accepted=OF_THE_RATE,
    ),
    "lagged loads": Kind(_lagged, "own:lagged-loads"),
    "hysteresis": Kind(
        _in_moment(lambda rng, s: several(rng, size=(-0.015, -0.005), width=(0.02, 0.04)), "size"),
        "own:hysteresis",
    ),
    "friction": Kind(
        _in_moment(lambda rng, s: several(rng, size=(0.003, 0.008), width=(0.005, 0.02)), "size"),
        "own:friction",
        accepted=OF_THE_RATE,
    ),
    "alpha-rate product": Kind(
        _in_moment(signed(0.8, 2.0, "moment"), "moment"), "own:alpha-rate-product", accepted=OF_BOTH
    ),
    "travelling mass": Kind(
        _in_moment(signed(0.012, 0.025, "rate"), "rate"), "own:travelling-mass"
    ),
    "control upwash": Kind(_upwash, "own:control-upwash"),
    # A curved calibration is a right name: the library has no other form of this fault.
    "cubic vane": Kind(
        uniform(30.0, 80.0, "cubic"),
        "own:cubic-vane",
        channels=("nz",),
        accepted=("sensor-curve:alpha",),
    ),
    "drag rhythm": Kind(
        lambda rng, s: several(rng, size=(0.15, 0.4), frequency=(0.8, 2.5)),
        "own:drag-rhythm",
        models=BALLISTIC,
    ),
    "drag decay": Kind(signed(0.01, 0.03, "rate"), "own:drag-decay", models=BALLISTIC),
    "density layer": Kind(
        lambda rng, s: several(rng, size=(0.2, 0.5), middle=(13e3, 24e3), depth=(1500.0, 3000.0)),
        "own:density-layer",
        models=BALLISTIC,
    ),
}


# ---- Faults of a recorder

CHANNELS = ("alpha", "q", "nz", "altitude")
CONTROLS = {"elevator": ("rigid",), "stick": ("loes",)}
CLOCK, ROWS = ("time base", "clock"), ("row", "rows", "gap", "missing")


def _late(channel: str) -> tuple[str, ...]:
    return (f"sensor-delay:{channel}", f"sensor-lag:{channel}")


def _spell(shortest: float, longest: float) -> Draw:
    def draw(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
        begin, length = pulse(rng, s, shortest, longest, last=0.5)
        return {"begin": begin, "length": length}

    return draw


def _dead(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    return {**_spell(0.5, 2.5)(rng, s), "zero": float(rng.random() < 0.5)}


def _burst(channel: str) -> Draw:
    # Four times as loud in all: the noise on top has the root of 15 sigmas.
    return lambda rng, s: {**_spell(2.0, 6.0)(rng, s), "sigma": math.sqrt(15.0) * NOISE[channel]}


def _coarse(channel: str) -> Draw:
    return lambda rng, s: {"bit": float(rng.uniform(4.0, 12.0)) * NOISE[channel]}


def _rows_late(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    return {"rows": float(math.ceil(0.02 / s.interval))}


def _held(rng: np.random.Generator, s: Setting) -> Mapping[str, float]:
    return {"rows": float(rng.integers(3, 7))}


def _each(channel: str) -> Mapping[str, Kind]:
    """Return the faults that any column may have."""
    needed, said = (channel,), (channel,)
    spikes = (f"sensor-spikes:{channel}",)
    late = _late(channel)

    def kind(draw: Draw, act: object, accepted: tuple[str, ...] = (), apart: bool = False) -> Kind:
        return Kind(
            draw,
            models=ALL,
            channels=needed,
            spoils=partial(act, channel),  # type: ignore
            accepted=accepted,
            words=said,
            apart=apart,
        )

    return {
        f"held:{channel}": kind(_held, faults.held, (f"sensor-hold:{channel}", *late)),
        f"dead:{channel}": kind(_dead, faults.dead, spikes, apart=True),
        f"burst:{channel}": kind(_burst(channel), faults.burst, spikes, apart=True),
        f"coarse:{channel}": kind(_coarse(channel), faults.coarse),
        f"clipped:{channel}": kind(
            uniform(0.1, 0.25, "share"), faults.clipped, (f"sensor-curve:{channel}",)
        ),
    }


def _factor(channel: str, factor: float, models: tuple[str, ...] = AIRCRAFT) -> Kind:
    needed = () if channel in CONTROLS else (channel,)
    spoils = partial(faults.scaled, channel)
    accepted = () if channel in CONTROLS else (f"sensor-scale:{channel}",)
    return Kind(
        lambda rng, s: {"factor": factor},
        models=models,
        channels=needed,
        spoils=spoils,
        accepted=accepted,
        words=(channel,),
    )


DEGREES = 180.0 / math.pi
RECORDER: Mapping[str, Kind] = {
    "clock fast": Kind(
        lambda rng, s: several(rng, factor=(1.03, 1.15)),
        spoils=faults.fast_clock,
        channels=("nz",),  # without it a faster clock is another set of derivatives
        accepted=tuple(sorted(same_fault("time-base"))),
        words=CLOCK,
    ),
    "rows missing": Kind(
        _spell(0.3, 1.5), models=ALL, spoils=faults.rows_missing, words=ROWS, apart=True
    ),
    "rows lost": Kind(
        _spell(0.3, 1.0),
        models=ALL,
        spoils=faults.rows_lost,
        accepted=("lost-rows",),
        words=(*ROWS, *CLOCK),
        apart=True,
    ),
    **{
        name: kind
        for channel in CHANNELS
        if channel != "altitude"
        for name, kind in _each(channel).items()
    },
    **{name: kind for name, kind in _each("altitude").items() if not name.startswith("clipped")},
    **{
        f"skewed:{name}": Kind(
            _rows_late,
            channels=("nz",),
            spoils=partial(faults.skewed, name),
            accepted=_late(name),
            words=(name,),
        )
        for name in ("alpha", "q", "nz")
    },
    "exchanged samples": Kind(
        lambda rng, s: {"count": float(rng.integers(4, 9))},
        spoils=partial(faults.exchanged, "alpha", "q"),
        accepted=("sensor-spikes:alpha", "sensor-spikes:q"),
        words=("alpha", "q"),
        apart=True,
    ),
    **{f"turned:{name}": _factor(name, -1.0, models) for name, models in CONTROLS.items()},
    "turned:q": _factor("q", -1.0),
    "unit:elevator": _factor("elevator", DEGREES, ("rigid",)),
    "unit:alpha": _factor("alpha", DEGREES),
    "unit:nz": _factor("nz", G0),
    "unit:altitude": _factor("altitude", 1.0 / 0.3048, ("ballistic",)),
}


# ---- All that an random case may hide, by name

KINDS: Mapping[str, Kind] = {**EFFECTS, **FALLING, **FOREIGN, **RECORDER}


def drawable(group: str, model: str, channels: Sequence[str]) -> list[str]:
    """Return the names of the kinds of a group that can be hidden, and are observable, in a model's
    record with these channels.
    """
    return [
        name
        for name, kind in KINDS.items()
        if kind.group == group and model in kind.models and set(kind.channels) <= set(channels)
    ]


def families(names: Sequence[str]) -> dict[str, list[str]]:
    """Return the parts of names before the colon: one fault on several channels is one family."""
    found: dict[str, list[str]] = {}
    for name in names:
        found.setdefault(name.partition(":")[0], []).append(name)
    return found
