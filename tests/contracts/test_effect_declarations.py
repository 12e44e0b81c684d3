"""What every effect declares: names, form, starting values and where it vanishes. A new effect is
covered as soon as its file is there.
"""

from __future__ import annotations

import re
from dataclasses import replace

from sim.aerodynamics import FLOW, parse_term
from sim.declaration.effect import (
    ClockEffect,
    DynamicsEffect,
    Effect,
    InputEffect,
    NoiseEffect,
    ParameterEffect,
    ReadingEffect,
    Regularity,
    SensorEffect,
    StateJumpEffect,
    Station,
    full_name,
)
from sim.declaration.model import Multiplying
from sim.effects.library import applies
from tests.effect_cases import every_effect
from tests.offered import AIRCRAFT, ALL_VEHICLES, VARYING

# Names that other programs read; where a colon follows, an output channel (spikes: also an input),
# an input, a port or a number.
FIXED_NAMES = {
    Station.INPUT_PATH: "input-delay actuator-lag actuator-second-order actuator-rate-limit actuator-saturation input-deadband input-backlash "  # noqa: E501
    "input-recorded-late",
    Station.DYNAMICS: "moment-nonlinearity lift-nonlinearity control-nonlinearity derivative-jump elastic-mode flow-separation "  # noqa: E501
    "density-scale-height drag-mach drag-jump yaw-nonlinearity roll-nonlinearity "
    "side-force-nonlinearity drag-nonlinearity varies missing-term",
    Station.DISTURBANCE: (
        "gust-turbulence gust-discrete gust-horizontal speed-variation unmeasured-input phugoid"
    ),
    Station.SENSOR_PATH: "vane-offset sensor-scale sensor-lag sensor-delay sensor-drift sensor-spikes lost-rows time-base accelerometer-offset "  # noqa: E501
    "sensor-coupling sensor-curve sensor-step sensor-hold sensor-deadband sensor-backlash",
    Station.NOISE: "",
}


@every_effect
def test_declares_what_the_protocol_wants(effect: Effect) -> None:
    assert isinstance(effect, Effect)
    form = {
        Station.INPUT_PATH: (InputEffect,),
        Station.DYNAMICS: (DynamicsEffect, ParameterEffect),
        Station.DISTURBANCE: (DynamicsEffect,),
        # recorded inputs have sensors, too
        Station.SENSOR_PATH: (
            SensorEffect,
            ReadingEffect,
            InputEffect,
            ClockEffect,
            StateJumpEffect,
        ),
        Station.NOISE: (NoiseEffect,),
    }[effect.station]
    assert isinstance(effect, form)
    assert isinstance(effect.regularity, Regularity)
    assert hash(effect) == hash(replace(effect))  # type: ignore[type-var]
    assert (
        len(effect.explanation) > 150
        and "=" in effect.explanation
        and "\n" not in effect.explanation
    )
    local = [item.name for item in effect.parameters]
    assert local and len(set(local)) == len(local) and all(name.isidentifier() for name in local)
    assert all(item.unit for item in effect.parameters)
    assert any(item.free for item in effect.parameters)
    full = [full_name(effect, name) for name in local]
    assert len(set(full)) == len(full)
    assert effect.absent and set(effect.absent) <= set(local)
    values = {item.name: item for item in effect.parameters}
    for name, value in effect.absent.items():
        low, high = values[name].bounds
        assert low <= value <= high
        assert values[name].value != value, "a starting value is where the effect acts"
    assert effect.name not in effect.aliases
    assert any(applies(effect, vehicle) for vehicle in (*ALL_VEHICLES, AIRCRAFT)), (
        "no vehicle here can carry it: extend tests/offered.py and tests/bases.py"
    )


def names(*fields: str) -> set[str]:
    """Names of the signals in these fields of all equations."""
    return {
        signal.name
        for vehicle in ALL_VEHICLES
        for field in fields
        for signal in getattr(vehicle, field)
    }


FACTORS = {
    name for vehicle in ALL_VEHICLES if isinstance(vehicle, Multiplying) for name in vehicle.factors
}
LABELS = {
    Station.INPUT_PATH: names("inputs"),
    Station.DYNAMICS: names("inputs", "ports"),
    Station.DISTURBANCE: names("ports"),
    Station.SENSOR_PATH: names("outputs", "inputs"),
}


@every_effect
def test_name_follows_the_design(effect: Effect) -> None:
    stem, colon, suffix = effect.name.partition(":")
    assert re.fullmatch(r"[a-z]+(-[a-z]+)*", stem)
    for station, fixed in FIXED_NAMES.items():
        if stem in fixed.split():
            assert station is effect.station
    if stem == VARYING:
        of, over = re.fullmatch(r"(\w+)\((\w+)\)", suffix).groups()  # type: ignore[union-attr]
        assert of in FACTORS and over in names("states", "inputs")
    elif stem == "missing-term":
        axis, term = re.fullmatch(r"(C\w)\((.+)\)", suffix).groups()  # type: ignore[union-attr]
        assert axis in {port.name for port in AIRCRAFT.ports}
        assert parse_term(term, (*FLOW, *(each.name for each in AIRCRAFT.inputs))).text == term
    elif colon:
        assert suffix in LABELS[effect.station] or (
            effect.station is Station.DYNAMICS and suffix.isdigit()
        )
    assert not stem.startswith("sensor-") or (effect.station is Station.SENSOR_PATH and colon)
    for item in effect.parameters:
        full = full_name(effect, item.name)
        assert full.startswith(f"{effect.name}.") or (
            hasattr(effect, "rename") and full.isidentifier()
        )
    for alias in effect.aliases:
        assert any(alias.partition(":")[0] in fixed.split() for fixed in FIXED_NAMES.values())
