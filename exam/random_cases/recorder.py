"""Faults of a recorder: right is a refusal, a word that names the channel, or `unexplained`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial

import numpy as np

from exam.random_cases.case import AIRCRAFT, ALL, Draw, Kind, Setting
from exam.random_cases.sizes import pulse, several, uniform
from exam.random_cases.vehicles import NOISE
from exam.recorder_faults import clock, columns, readings
from exam.scoring import same_fault
from sim.maths import G0

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
    """The faults that any column may have."""
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
        f"held:{channel}": kind(_held, columns.held, (f"sensor-hold:{channel}", *late)),
        f"dead:{channel}": kind(_dead, columns.dead, spikes, apart=True),
        f"burst:{channel}": kind(_burst(channel), columns.burst, spikes, apart=True),
        f"coarse:{channel}": kind(_coarse(channel), readings.coarse),
        f"clipped:{channel}": kind(
            uniform(0.1, 0.25, "share"), readings.clipped, (f"sensor-curve:{channel}",)
        ),
    }


def _factor(channel: str, factor: float, models: tuple[str, ...] = AIRCRAFT) -> Kind:
    needed = () if channel in CONTROLS else (channel,)
    spoils = partial(readings.scaled, channel)
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
        spoils=clock.fast_clock,
        channels=("nz",),  # without it a faster clock is another set of derivatives
        accepted=tuple(sorted(same_fault("time-base"))),
        words=CLOCK,
    ),
    "rows missing": Kind(
        _spell(0.3, 1.5), models=ALL, spoils=clock.rows_missing, words=ROWS, apart=True
    ),
    "rows lost": Kind(
        _spell(0.3, 1.0),
        models=ALL,
        spoils=clock.rows_lost,
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
            spoils=partial(columns.skewed, name),
            accepted=_late(name),
            words=(name,),
        )
        for name in ("alpha", "q", "nz")
    },
    "exchanged samples": Kind(
        lambda rng, s: {"count": float(rng.integers(4, 9))},
        spoils=partial(columns.exchanged, "alpha", "q"),
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
