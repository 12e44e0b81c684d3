"""What a maneuver must not exceed: load factors, angles, rates, deflections and their speed; from a file, else sensible ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.declarations import closest, read_toml
from scenarios.files.schemas import number_in
from scenarios.files.user_models import is_own, unit_in
from scenarios.preparation.measured_inputs import of_totals
from sim.declaration.model import Model
from sim.errors import DeclarationError
from sim.maths import G0

DEGREE = np.pi / 180.0
# Chosen: gentle flying that perturbations about trim still describe; load factors are totals, 1 in level flight.
USUAL: Mapping[str, tuple[float, float]] = {
    "nz": (0.0, 2.0),
    "ny": (-0.5, 0.5),
    **{name: (-size * DEGREE, size * DEGREE) for name, size in {"q": 25.0, "beta": 10.0, "p": 60.0, "r": 20.0, "phi": 60.0}.items()},
}
ANGLE_OF_ATTACK, PITCH, SPEED = 8.0 * DEGREE, 20.0 * DEGREE, 0.1  # either side of the trim; of the airspeed a share
DEFLECTION = 5.0 * DEGREE
THRUST = 0.05  # of the weight


@dataclass(frozen=True)
class Limits:
    """``outputs`` : lowest and highest reading, SI and total load factors; ``amplitude`` : largest deflection from rest by input; ``rate`` : its
    fastest change, unit/s, by input where it is limited."""

    outputs: Mapping[str, tuple[float, float]]
    amplitude: Mapping[str, float]
    rate: Mapping[str, float]


def offset_of(model: Model, output: str) -> float:
    """What is added to an output of the model to have the total: of a load factor of perturbations the weight."""
    return 1.0 if output == "nz" and not of_totals(model) else 0.0


def usual_limits(model: Model, rest: Mapping[str, float]) -> Limits:
    """Limits where nobody names any. ``rest`` : outputs in trim. A user's own model has those of channels that it calls the same."""
    outputs: dict[str, tuple[float, float]] = {}
    for signal in model.equations.outputs:
        name, at = signal.name, rest[signal.name]
        if name == "alpha" and signal.unit == "rad":
            outputs[name] = (at - ANGLE_OF_ATTACK, at + ANGLE_OF_ATTACK)
        elif name == "theta" and signal.unit == "rad":
            outputs[name] = (at - PITCH, at + PITCH)
        elif name == "airspeed" and at > 0.0:
            outputs[name] = ((1.0 - SPEED) * at, (1.0 + SPEED) * at)
        elif name in USUAL and (not is_own(model) or signal.unit in ("rad", "rad/s")):
            outputs[name] = USUAL[name]
    return Limits(outputs, {signal.name: _usual_amplitude(model, signal.name, signal.unit) for signal in model.equations.inputs}, {})


def limits_of(given: Path | Mapping[str, Any] | None, model: Model, usual: Limits) -> Limits:
    """The usual limits with those of a file, or of its content, in their place.

    Keys: ``OUTPUT_max`` (alone it holds to both sides of zero, but of a load factor), ``OUTPUT_min``, ``INPUT_amplitude``, ``INPUT_rate``.

    Raises
    ------
    DeclarationError : a key that there is not, a value of a wrong kind, unit or sign, a lowest above a highest.
    """
    if given is None:
        return usual
    where = str(given) if isinstance(given, Path) else "limits"
    content = read_toml(given) if isinstance(given, Path) else dict(given)
    known = _keys(model)
    outputs, amplitude, rate = dict(usual.outputs), dict(usual.amplitude), dict(usual.rate)
    found: dict[str, dict[str, float]] = {}
    for key, value in content.items():
        if key not in known:
            raise DeclarationError("there is no such key", where=f"{where}, key {key}", remedy=closest(key, known))
        name, kind, unit = known[key]
        number = number_in(value, unit, f"{where}, key {key}")
        if kind in ("amplitude", "rate"):
            if number <= 0.0:
                raise DeclarationError(f"value {number:g} is not above 0", where=f"{where}, key {key}", remedy="give a positive number")
            (amplitude if kind == "amplitude" else rate)[name] = number
        else:
            found.setdefault(name, {})[kind] = number
    for name, ends in found.items():
        low, high = outputs.get(name, (-np.inf, np.inf))
        high = ends.get("max", high)
        # A pull-up's limit says nothing of a push-over's; an angle's or a rate's holds to both sides.
        low = ends.get("min", low if name in ("nz", "airspeed") or "max" not in ends else -abs(high))
        if not low < high:
            raise DeclarationError(f"{low:g} is not below {high:g}", where=f"{where}, key {name}_max", remedy="give a highest above the lowest")
        outputs[name] = (low, high)
    return Limits(outputs, amplitude, rate)


def _keys(model: Model) -> dict[str, tuple[str, str, str]]:
    """Key -> channel, what it limits, and its unit."""
    out: dict[str, tuple[str, str, str]] = {}
    for signal in model.equations.outputs:
        out |= {f"{signal.name}_{end}": (signal.name, end, signal.unit) for end in ("min", "max")}
    for signal in model.equations.inputs:
        unit = unit_in(model, signal.name)
        out[f"{signal.name}_amplitude"] = (signal.name, "amplitude", unit)
        out[f"{signal.name}_rate"] = (signal.name, "rate", "1/s" if unit == "1" else f"{unit}/s")
    return out


def _usual_amplitude(model: Model, name: str, unit: str) -> float:
    """An angle of some degrees; thrust of a share of the weight; one of any other unit."""
    if unit == "rad":
        return DEFLECTION
    if name == "thrust" and "mass" in model.parameters:
        return THRUST * model.parameters["mass"].value * G0
    return 1.0
