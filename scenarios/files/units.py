"""Convert the units of a user's file to ours.

Products of SI units and degrees need no library; pint is imported only for others.
"""

from __future__ import annotations

import math
import re
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from sim.errors import FlightidError, RecordError
from sim.maths import G0

if TYPE_CHECKING:
    import pint

Number = TypeVar("Number", float, np.ndarray)

LOAD_FACTOR = "g"

QUANTITIES = {  # Quantity that each of our units measures, and units a user may write for it.
    "1": ("a pure number", "no unit"),
    "s": ("a time", "s, ms or min"),
    "rad": ("an angle", "rad, deg or mrad"),
    "rad/s": ("an angular rate", "rad/s, deg/s or rpm"),
    "1/rad": ("a derivative per angle", "1/rad or 1/deg"),
    "1/s": ("a rate", "1/s"),
    "1/s2": ("a rate per time", "1/s2"),
    LOAD_FACTOR: ("a load factor", "g, m/s2 or ft/s2"),
    "m": ("a length", "m, ft or km"),
    "m2": ("an area", "m2 or ft2"),
    "m/s": ("a speed", "m/s, ft/s or kt"),
    "m/s2": ("an acceleration", "m/s2, ft/s2 or g"),
    "N": ("a force", "N, kN or lbf"),
    "Pa": ("a pressure", "Pa, kPa or lbf/ft2"),
    "kg": ("a mass", "kg, lb or slug"),
    "kg/m2": ("a mass per area", "kg/m2 or lb/ft2"),
    "kg/m3": ("a density", "kg/m3 or slug/ft3"),
    "kg m2": ("a moment of inertia", "kg m2 or slug ft2"),
}
_SI = {
    "1": (0, 0, 0, 0),
    "rad": (0, 0, 0, 1),
    "m": (1, 0, 0, 0),
    "s": (0, 1, 0, 0),
    "kg": (0, 0, 1, 0),
    "N": (1, -2, 1, 0),
    "deg": (0, 0, 0, 1),
    "Pa": (-1, -2, 1, 0),
}
_CAPITALS = {name.upper(): name for name in _SI}
_DEGREE = math.pi / 180.0
_FACTOR = re.compile(r"([*/]?)(rad|deg|kg|Pa|N|m|s|1)(?:\*\*(-?\d+))?(?=[*/]|$)", re.ASCII)
_LONGEST_UNIT = 40  # longest text of a unit, in characters
# Huge powers are refused, since the library would compute them.
_EXPLOSIVE = re.compile(
    r"\*\*[-+]?\(|\*\*[-+]?\d{3}|\*\*[-+]?[\d.]+\*\*|\)\*\*.*\)\*\*|\d{7}|\d[eE][-+]?\d{2}",
    re.ASCII,
)
_GRAVITIES = ("g", "G", "gs", "g0", "g_0", "gee")
_ALIASES = {"°": "deg", "lbm": "lb", "psf": "lbf/ft**2", "NM": "nautical_mile"}
_ANGLES = (
    "radian",
    "degree",
    "arcminute",
    "arcsecond",
    "turn",
    "grade",
    "revolutions_per_minute",
    "revolutions_per_second",
)


class _Size(NamedTuple):
    """Exponents of metre, second, kilogram and radian, and how many of the last are degrees."""

    m: int
    s: int
    kg: int
    rad: int
    deg: int


def to_si(
    value: Number, unit: str, target: str, where: str, error: type[FlightidError] = RecordError
) -> Number:
    """Convert a value, or an array of any shape with NaN kept, to one of our units.

    Parameters
    ----------
    value : the number as the file has it.
    unit : its unit as the file has it; ``""`` means that it is in ``target`` already.
    target : one of ``QUANTITIES``: SI, radians, and ``"g"`` (9.80665 m/s2) for a load factor; or
        the unit that an own model declares.
    where : file and column or key, for the message.
    error : what to raise.

    Conventions: ``g`` is the standard gravity where an acceleration is due, a gram elsewhere. A
    pound is a mass, but a force in a pressure or where a force is due; a weight per area (lbf/ft2)
    given for a mass per area is divided by g0, which leaves the number of pounds. A radian may be
    left out, a degree may not. Hz is a number of turns a second, so it is 2 pi rad/s, and no plain
    1/s.

    Raises
    ------
    FlightidError (``error``) : the unit is unknown, or measures another quantity.
    """
    text = normal_form(unit)
    if text in ("", normal_form(target)):
        return value
    if not _is_tame(text):
        examples = QUANTITIES.get(target, ("", f"it in {target}, or leave the unit out"))[1]
        raise error(
            f"unknown unit {unit[:_LONGEST_UNIT]!r}", where=where, remedy=f"write {examples}"
        )
    if target == LOAD_FACTOR:
        if text in (*_GRAVITIES, "1"):
            return value
        return _converted(value, unit, text, "m/s2", target, where, error) / G0
    if target == "m/s2" and text in _GRAVITIES:
        return value * G0
    return _converted(value, unit, text, target, target, where, error)


def is_unit(unit: str) -> bool:
    """Return whether a unit is known, so that others are converted into it; any other is a label
    that all must share.
    """
    text = normal_form(unit)
    if not _is_tame(text):
        return False
    return (
        text == LOAD_FACTOR or _si_size(text) is not None or _parsed(_registry(), text) is not None
    )


def _is_tame(text: str) -> bool:
    """Return whether a unit is a short product of small powers in plain letters; only such a text
    is parsed.
    """
    foreign = any(letter.isdecimal() and not letter.isascii() for letter in text)
    return len(text) <= _LONGEST_UNIT and not foreign and _EXPLOSIVE.search(text) is None


def normal_form(unit: str) -> str:
    """A unit as products and powers of names: ``"kg m^2"`` and ``"kg-m2"`` are ``"kg*m**2"``."""
    text = unit.strip().translate(str.maketrans("·²³−⁻¹", "*23--1")).replace("^", "**")
    text = re.sub(r"\s*([*/()])\s*", r"\1", text)
    text = re.sub(r"\s+", "*", text)
    text = re.sub(r"(?<=[A-Za-z\d])-(?=[A-Za-z])", "*", text)
    text = re.sub(r"(?<=[A-Za-z])(-?\d+)", r"**\1", text)
    return re.sub(r"[^\W\d]+|°", lambda word: _ALIASES.get(word[0], word[0]), text)


def _converted(
    value: Number,
    unit: str,
    text: str,
    target: str,
    shown: str,
    where: str,
    error: type[FlightidError],
) -> Number:
    kind, examples = QUANTITIES.get(
        shown, (f"what is declared in {shown!r}", f"it in {shown}, or leave the unit out")
    )
    wrong = error(f"unit {unit!r} does not measure {kind}", where=where, remedy=f"write {examples}")
    size, due = _si_size(text), _si_size(normal_form(target))
    if size is not None and due is not None:
        if size[:3] == due[:3] and (
            size.rad == due.rad or (0 in (size.rad, due.rad) and not size.deg and not due.deg)
        ):
            return value * _DEGREE ** (size.deg - due.deg) if size.deg != due.deg else value
        raise wrong
    if re.search(r"hz|hertz", text, re.IGNORECASE):
        if target == "rad/s" and text.lower() in ("hz", "hertz"):
            return value * (2.0 * math.pi)
        raise wrong
    if text.isupper():  # in headers in capitals, not siemens and petaampere
        usual = re.sub(r"[A-Z]+", lambda word: _CAPITALS.get(word[0], word[0]), text)
        if (
            usual != text
            and (size := _si_size(usual)) is not None
            and due is not None
            and size[:4] == due[:4]
        ):
            return _converted(value, unit, usual, target, shown, where, error)
    units = _registry()
    goal, parsed = _parsed(units, normal_form(target)), _parsed(units, _pounds(text, target))
    if goal is None:
        remedy = (
            f"leave the unit out: the numbers are taken in {target}, which has no conversion here"
        )
        raise error(f"unit {unit!r} is not the declared {target!r}", where=where, remedy=remedy)
    if parsed is None:
        raise error(f"unknown unit {unit!r}", where=where, remedy=f"write {examples}")
    if parsed.dimensionality != goal.dimensionality or _angle_power(parsed) != _angle_power(goal):
        raise wrong
    try:
        return units.Quantity(value, parsed).to(goal).magnitude
    except Exception:  # logarithmic and offset units fail in ways of their own
        raise wrong from None


def _si_size(text: str) -> _Size | None:
    """Exponents of a product of SI units and degrees, None for any other unit."""
    total, degrees, at = np.zeros(4, dtype=int), 0, 0
    while at < len(text):
        match = _FACTOR.match(text, at)
        if match is None or (at == 0) != (match[1] == ""):
            return None
        power = int(match[3] or 1) * (-1 if match[1] == "/" else 1)
        total += np.array(_SI[match[2]]) * power
        degrees += power if match[2] == "deg" else 0
        at = match.end()
    return _Size(*(int(power) for power in (*total, degrees))) if text else None


def _pounds(text: str, target: str) -> str:
    if target in ("Pa", "N"):
        return re.sub(r"\b(lb|pound|pounds)\b", "lbf", text)
    if target == "kg/m2":
        return re.sub(r"\b(lbf|pound_force)\b", "lb", text.replace("psi", "lb/in**2"))
    return text


@lru_cache(maxsize=1)
def _registry() -> pint.UnitRegistry[Any]:
    import pint

    return pint.UnitRegistry()


def _parsed(units: pint.UnitRegistry[Any], text: str) -> Any:
    """Return the unit, also from capitals (``"DEG/S"``); None if there is no such unit."""
    if not re.fullmatch(r"[\w*/().%-]+", text):
        return None
    for spelling in (text, text.lower()):
        try:
            return units.parse_units(spelling)
        # the parser raises many kinds of errors
        except Exception:
            continue
    return None


def _angle_power(unit: Any) -> float:
    """Return the power of an angle in a unit; pint counts angles as pure numbers."""
    return sum(power for name, power in unit._units.items() if name.endswith(_ANGLES))
