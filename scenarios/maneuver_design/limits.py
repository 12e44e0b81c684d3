"""Limits of a maneuver: of the motion, of a pilot and of an actuator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
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

# ---- Who moves the controls

DEGREE = np.pi / 180.0
ACTUATOR_RATE = 60.0 * DEGREE  # rad/s of a surface; chosen: transports have less, fighters more
ENGINE_RISE = 1.0  # s, from the trim to the largest thrust; chosen


@dataclass(frozen=True)
class Flyer:
    """Limits of the pilot or computer that moves the controls.

    Attributes
    ----------
    name : for sentences, ``"a pilot"``.
    kinds : possible maneuvers.
    shortest_step : duration of the shortest step, s.
    fastest : highest frequency of a sweep, Hz.
    longest_sweep : longest duration of a sweep, s.
    rest : pause between maneuvers, s.
    rise : time from trim to the full amplitude, s.
    """

    name: str
    kinds: tuple[str, ...]
    shortest_step: float = 0.0
    fastest: float = np.inf
    longest_sweep: float = np.inf
    rest: float = 0.0
    rise: float = 0.0

    @property
    def text(self) -> str:
        """Who flies, and the limits, in one line."""
        if not self.shortest_step:
            return f"flown by {self.name}"
        return (
            f"flown by {self.name} (--computer for a flight computer): steps of "
            f"{self.shortest_step:g} s or more, {self.rise:g} s to the full deflection, sweeps up "
            f"to {self.fastest:g} Hz and {self.longest_sweep:g} s, {self.rest:g} s of rest between "
            "maneuvers"
        )


# Frequency and length of a sweep by hand: Tischler and Remple, "Aircraft and Rotorcraft System
# Identification", 2nd edition, AIAA 2012, chapter 5; Williams, Ham and Tischler, "Flight Test
# Manual, Rotorcraft Frequency Domain Flight Testing", US Army AQTD Project 93-14, 1995. Chosen:
# the other numbers.
PILOT = Flyer(
    "a pilot", ("3-2-1-1", "doublet", "sweep"), 0.3, 2.0, longest_sweep=120.0, rest=1.0, rise=0.15
)
COMPUTER = Flyer("a flight computer", ("3-2-1-1", "doublet", "sweep", "multisine"))


# ---- What a maneuver must not exceed

# Chosen: gentle maneuvers, for which perturbation equations hold. Load factors are totals.
USUAL: Mapping[str, tuple[float, float]] = {
    "nz": (0.0, 2.0),
    "ny": (-0.5, 0.5),
    **{
        name: (-size * DEGREE, size * DEGREE)
        for name, size in {"q": 25.0, "beta": 10.0, "p": 60.0, "r": 20.0, "phi": 60.0}.items()
    },
}
ANGLE_OF_ATTACK = 8.0 * DEGREE  # rad, on either side of the trim
PITCH_LIMIT = 20.0 * DEGREE  # rad, on either side of the trim
AIRSPEED_LIMIT_SHARE = 0.1  # share of the airspeed, on either side
DEFLECTION_LIMIT = 5.0 * DEGREE
THRUST_LIMIT_SHARE = 0.05  # share of the weight


@dataclass(frozen=True)
class Limits:
    """``outputs`` : lowest and highest reading, SI and total load factors; ``amplitude`` : largest
    deflection from rest by input; ``rate`` : its fastest change, unit/s, by input where it is
    limited."""

    outputs: Mapping[str, tuple[float, float]]
    amplitude: Mapping[str, float]
    rate: Mapping[str, float]


def offset_of(model: Model, output: str) -> float:
    """Return total minus model output: 1 g for the normal load factor of perturbation models."""
    return 1.0 if output == "nz" and not of_totals(model) else 0.0


def usual_limits(model: Model, rest: Mapping[str, float]) -> Limits:
    """Return default limits.

    ``rest`` : outputs in trim. A user model gets limits for outputs with known names.
    """
    outputs: dict[str, tuple[float, float]] = {}
    for signal in model.equations.outputs:
        name, at = signal.name, rest[signal.name]
        if name == "alpha" and signal.unit == "rad":
            outputs[name] = (at - ANGLE_OF_ATTACK, at + ANGLE_OF_ATTACK)
        elif name == "theta" and signal.unit == "rad":
            outputs[name] = (at - PITCH_LIMIT, at + PITCH_LIMIT)
        elif name == "airspeed" and at > 0.0:
            outputs[name] = ((1.0 - AIRSPEED_LIMIT_SHARE) * at, (1.0 + AIRSPEED_LIMIT_SHARE) * at)
        elif name in USUAL and (not is_own(model) or signal.unit in ("rad", "rad/s")):
            outputs[name] = USUAL[name]
    return Limits(
        outputs,
        {
            signal.name: _usual_amplitude(model, signal.name, signal.unit)
            for signal in model.equations.inputs
        },
        {},
    )


def limits_of(given: Path | Mapping[str, Any] | None, model: Model, usual: Limits) -> Limits:
    """Return the usual limits with those of a file, or of its content, in their place.

    Keys: ``OUTPUT_max``, ``OUTPUT_min``, ``INPUT_amplitude``, ``INPUT_rate``. The maximum of an
    angle or rate limits both signs if there is no minimum.

    Raises
    ------
    DeclarationError : an unknown key, a value of a wrong kind, unit or sign, a minimum above a
        maximum.
    """
    if given is None:
        return usual
    where = str(given) if isinstance(given, Path) else "limits"
    content = read_toml(given) if isinstance(given, Path) else dict(given)
    keys = _keys(model)
    outputs, amplitude, rate = dict(usual.outputs), dict(usual.amplitude), dict(usual.rate)
    result: dict[str, dict[str, float]] = {}
    for key, value in content.items():
        if key not in keys:
            raise DeclarationError(
                "there is no such key", where=f"{where}, key {key}", remedy=closest(key, keys)
            )
        name, kind, unit = keys[key]
        number = number_in(value, unit, f"{where}, key {key}")
        if kind in ("amplitude", "rate"):
            if number <= 0.0:
                raise DeclarationError(
                    f"value {number:g} is not above 0",
                    where=f"{where}, key {key}",
                    remedy="give a positive number",
                )
            (amplitude if kind == "amplitude" else rate)[name] = number
        else:
            result.setdefault(name, {})[kind] = number
    for name, ends in result.items():
        low, high = outputs.get(name, (-np.inf, np.inf))
        high = ends.get("max", high)
        # A maximum of nz or airspeed does not limit the minimum; that of an angle or rate does.
        low = ends.get(
            "min", low if name in ("nz", "airspeed") or "max" not in ends else -abs(high)
        )
        if not low < high:
            raise DeclarationError(
                f"{low:g} is not below {high:g}",
                where=f"{where}, key {name}_max",
                remedy="give a highest above the lowest",
            )
        outputs[name] = (low, high)
    return Limits(outputs, amplitude, rate)


def _keys(model: Model) -> dict[str, tuple[str, str, str]]:
    """Return a mapping: key of a limit -> channel, limited quantity, unit."""
    out: dict[str, tuple[str, str, str]] = {}
    for signal in model.equations.outputs:
        out |= {f"{signal.name}_{end}": (signal.name, end, signal.unit) for end in ("min", "max")}
    for signal in model.equations.inputs:
        unit = unit_in(model, signal.name)
        out[f"{signal.name}_amplitude"] = (signal.name, "amplitude", unit)
        out[f"{signal.name}_rate"] = (signal.name, "rate", "1/s" if unit == "1" else f"{unit}/s")
    return out


def _usual_amplitude(model: Model, name: str, unit: str) -> float:
    """Return 5 deg for an angle, a share of the weight for thrust, else 1."""
    if unit == "rad":
        return DEFLECTION_LIMIT
    if name == "thrust" and "mass" in model.parameters:
        return THRUST_LIMIT_SHARE * model.parameters["mass"].value * G0
    return 1.0


def with_usual_rates(limits: Limits, model: Model, flyer: Flyer) -> Limits:
    """Return the limits with default rates: the lower one of actuator and pilot, if any."""
    rates = dict(limits.rate)
    for name, size in limits.amplitude.items():
        actuator = (
            size / ENGINE_RISE
            if name == "thrust"
            else ACTUATOR_RATE
            if unit_in(model, name) == "rad"
            else np.inf
        )
        lower = min(actuator, size / flyer.rise if flyer.rise else np.inf)
        if name not in rates and np.isfinite(lower):
            rates[name] = lower
    return replace(limits, rate=rates)


def no_faster(rows: np.ndarray, rate: np.ndarray, interval: float) -> np.ndarray:
    """Return ``rows (inputs, N)`` with their rates limited to ``rate (inputs,)`` per second."""
    out = rows.copy()
    if not np.any(np.isfinite(rate)):
        return out
    most = rate * interval
    for k in range(1, rows.shape[1]):
        out[:, k] = out[:, k - 1] + np.clip(rows[:, k] - out[:, k - 1], -most, most)
    return out
