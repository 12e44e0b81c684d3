"""Numbers of scenario files in SI: plain ones, texts with a unit, variances, spectral densities."""

from __future__ import annotations

import math
from collections.abc import Mapping

from scenarios.files.own_models import unit_in
from scenarios.files.units import to_si
from sim.declaration.model import Model
from sim.errors import DeclarationError

Quantity = float | int | str

# SI units of the quantities a scenario may give with a unit of its own.
UNITS = {
    "alpha": "rad",
    "q": "rad/s",
    "nz": "g",
    "altitude": "m",
    "velocity": "m/s",
    "elevator": "rad",
    "beta": "kg/m2",
    "p": "rad/s",
    "r": "rad/s",
    "phi": "rad",
    "ny": "g",
    "aileron": "rad",
    "rudder": "rad",
    "airspeed": "m/s",
    "theta": "rad",
    "nx": "g",
    "thrust": "N",
}
# A falling body's beta is its ballistic coefficient, an aircraft's its sideslip.
OWN_UNITS = {"lateral": {"beta": "rad"}}


def unit_of(name: str, model: str | Model = "") -> str:
    """The SI unit of what a scenario gives under a name, for a model where it has a meaning of its own; 1 for a coefficient.

    A user's own model (``Model``) declares the units of all its names.
    """
    if isinstance(model, Model):
        return unit_in(model, name)
    return OWN_UNITS.get(model, {}).get(name) or UNITS.get(name, "1")


def standard_deviations(std: Mapping[str, Quantity], variance: Mapping[str, str], where: str, model: str | Model = "") -> dict[str, float]:
    """Noise by output of a model, SI, from standard deviations and variances."""
    out = {}
    for name, value in std.items():
        out[name] = positive(si(value, unit_of(name, model), f"{where}.noise_std.{name}"), f"{where}.noise_std.{name}")
    for name, text in variance.items():
        key = f"{where}.noise_variance.{name}"
        number, unit = _parts(text, key)
        out[name] = math.sqrt(positive(number, key)) * float(to_si(1.0, _root(unit, key), unit_of(name, model), key, DeclarationError))
    return out


def density(name: str, value: Quantity, where: str, model: str | Model = "") -> float:
    """A spectral density: a plain number in SI, or e.g. ``"57 (lb/ft2)^2/s"``."""
    if not isinstance(value, str):
        return _not_negative(float(value), where)
    number, unit = _parts(value, where)
    if not unit.endswith("/s"):
        raise DeclarationError(f"unit {unit!r} is no spectral density", where=where, remedy='write for example "57 (lb/ft2)^2/s"')
    factor = float(to_si(1.0, _root(unit.removesuffix("/s"), where), unit_of(name, model), where, DeclarationError))
    return _not_negative(number, where) * factor**2


def _root(unit: str, where: str) -> str:
    """The unit whose square is given: ``"deg^2"``, ``"(deg/s)^2"``."""
    text = unit.strip()
    if not text.endswith("^2"):
        raise DeclarationError(f"unit {unit!r} is no square", where=where, remedy='write for example "0.016 deg^2" or "0.016 (deg/s)^2"')
    return text.removesuffix("^2").strip().removeprefix("(").removesuffix(")")


def _parts(text: str, where: str) -> tuple[float, str]:
    number, _, unit = text.strip().partition(" ")
    try:
        return float(number), unit
    except ValueError:
        raise DeclarationError(f"{text!r} is not a number with a unit", where=where, remedy='write for example "0.016 deg^2"') from None


def si(value: Quantity, target: str, where: str, same: Mapping[str, str] | None = None) -> float:
    """A number, or a text with a unit, in the unit ``target``; ``same`` are other spellings of units."""
    if not isinstance(value, str):
        return float(value)
    number, unit = _parts(value, where)
    unit = (same or {}).get(unit.lower(), unit)
    return float(to_si(number, unit, target, where, DeclarationError))


def positive(value: float, where: str) -> float:
    """The value, refused where it is not above zero and finite."""
    if not (value > 0 and math.isfinite(value)):
        raise DeclarationError(f"{value:g} is not above 0", where=where, remedy="give a positive number")
    return value


def _not_negative(value: float, where: str) -> float:
    if not (value >= 0 and math.isfinite(value)):
        raise DeclarationError(f"{value:g} is negative", where=where, remedy="give zero or a positive number")
    return value
