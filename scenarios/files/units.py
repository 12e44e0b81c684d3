"""Conversion of the units in files to SI units.

Products of SI units and degrees are converted here. The library pint is imported for other units
only.
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

# unit of the program -> quantity that it measures, and units that a file may have for it
QUANTITIES = {
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
# exponents of metre, second, kilogram and radian
_SI_EXPONENTS = {
    "1": (0, 0, 0, 0),
    "rad": (0, 0, 0, 1),
    "m": (1, 0, 0, 0),
    "s": (0, 1, 0, 0),
    "kg": (0, 0, 1, 0),
    "N": (1, -2, 1, 0),
    "deg": (0, 0, 0, 1),
    "Pa": (-1, -2, 1, 0),
}
_CAPITALS = {name.upper(): name for name in _SI_EXPONENTS}
_DEGREE = math.pi / 180.0  # rad
_FACTOR = re.compile(r"([*/]?)(rad|deg|kg|Pa|N|m|s|1)(?:\*\*(-?\d+))?(?=[*/]|$)", re.ASCII)
_LONGEST_UNIT = 40  # longest text of a unit, in characters
# powers that may be huge, which the library would compute
_HUGE_POWER = re.compile(
    r"\*\*[-+]?\(|\*\*[-+]?\d{3}|\*\*[-+]?[\d.]+\*\*|\)\*\*.*\)\*\*|\d{7}|\d[eE][-+]?\d{2}",
    re.ASCII,
)
_GRAVITIES = ("g", "G", "gs", "g0", "g_0", "gee")
_ALIASES = {"°": "deg", "lbm": "lb", "psf": "lbf/ft**2", "NM": "nautical_mile"}
_ANGLES = (  # in pint
    "radian",
    "degree",
    "arcminute",
    "arcsecond",
    "turn",
    "grade",
    "revolutions_per_minute",
    "revolutions_per_second",
)


class _Exponents(NamedTuple):
    """Exponents of metre, second, kilogram and angle in a unit. ``deg`` is the part of the exponent
    of angles that belongs to degrees.
    """

    m: int
    s: int
    kg: int
    rad: int
    deg: int


def to_si(
    value: Number, unit: str, target: str, where: str, error: type[FlightidError] = RecordError
) -> Number:
    """Return a value, or an array of any shape, in the unit ``target``. NaN remains NaN.

    Parameters
    ----------
    value : number in the file.
    unit : unit in the file; ``""`` means ``target``.
    target : one of ``QUANTITIES``: an SI unit, with radians, or ``"g"`` (9.80665 m/s2) for a load
        factor; or a unit that a model in Python declares.
    where : file and column or key, for the message.
    error : type of the error.

    Raises
    ------
    FlightidError (``error``) : if the unit is unknown, or measures another quantity.

    Notes
    -----
    ``g`` is the standard gravity if ``target`` is an acceleration, and a gram otherwise. A pound is
    a force if ``target`` is a force or a pressure, and a mass otherwise. A weight per area, as
    lbf/ft2, is divided by g0 if ``target`` is a mass per area, so that the number of pounds remains
    the same. A radian may be left out, a degree may not. Hz is turns per second: it is converted to
    2 pi rad/s, and not to 1/s.
    """
    text = normal_form(unit)
    if text in ("", normal_form(target)):
        return value
    if not _can_be_parsed(text):
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
    """Return whether a unit is known, so that other units can be converted to it."""
    text = normal_form(unit)
    if not _can_be_parsed(text):
        return False
    if text == LOAD_FACTOR or _si_exponents(text) is not None:
        return True
    return _parsed(_registry(), text) is not None


def _can_be_parsed(text: str) -> bool:
    """Return whether a unit is a short text with small powers and ASCII digits. No other text is
    given to the parser.
    """
    foreign_digits = any(letter.isdecimal() and not letter.isascii() for letter in text)
    return len(text) <= _LONGEST_UNIT and not foreign_digits and _HUGE_POWER.search(text) is None


def normal_form(unit: str) -> str:
    """Return a unit as products and powers of names: ``"kg*m**2"`` for ``"kg m^2"`` and
    ``"kg-m2"``.
    """
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
    """Return a value in the unit ``target``. ``text`` is the normal form of its ``unit``, and
    ``shown`` the target in messages.
    """
    kind, examples = QUANTITIES.get(
        shown, (f"what is declared in {shown!r}", f"it in {shown}, or leave the unit out")
    )
    wrong = error(f"unit {unit!r} does not measure {kind}", where=where, remedy=f"write {examples}")
    source, wanted = _si_exponents(text), _si_exponents(normal_form(target))
    if source is not None and wanted is not None:
        radian_left_out = 0 in (source.rad, wanted.rad) and not source.deg and not wanted.deg
        if source[:3] != wanted[:3] or not (source.rad == wanted.rad or radian_left_out):
            raise wrong
        if source.deg == wanted.deg:
            return value
        return value * _DEGREE ** (source.deg - wanted.deg)
    if re.search(r"hz|hertz", text, re.IGNORECASE):
        if target == "rad/s" and text.lower() in ("hz", "hertz"):
            return value * (2.0 * math.pi)
        raise wrong
    if text.isupper():  # a header in capitals: M/S is no mega per siemens
        usual = re.sub(r"[A-Z]+", lambda word: _CAPITALS.get(word[0], word[0]), text)
        source = _si_exponents(usual) if usual != text else None
        if source is not None and wanted is not None and source[:4] == wanted[:4]:
            return _converted(value, unit, usual, target, shown, where, error)
    units = _registry()
    target_unit = _parsed(units, normal_form(target))
    parsed = _parsed(units, _pounds(text, target))
    if target_unit is None:
        remedy = (
            f"leave the unit out: the numbers are taken in {target}, which has no conversion here"
        )
        raise error(f"unit {unit!r} is not the declared {target!r}", where=where, remedy=remedy)
    if parsed is None:
        raise error(f"unknown unit {unit!r}", where=where, remedy=f"write {examples}")
    if parsed.dimensionality != target_unit.dimensionality:
        raise wrong
    if _angle_power(parsed) != _angle_power(target_unit):
        raise wrong
    try:
        return units.Quantity(value, parsed).to(target_unit).magnitude
    except Exception:  # logarithmic units and units with an offset raise various errors
        raise wrong from None


def _si_exponents(text: str) -> _Exponents | None:
    """Return the exponents of a product of SI units and degrees; None for other units."""
    total, degrees, position = np.zeros(4, dtype=int), 0, 0
    while position < len(text):
        match = _FACTOR.match(text, position)
        if match is None or (position == 0) != (match[1] == ""):
            return None
        power = int(match[3] or 1) * (-1 if match[1] == "/" else 1)
        total += np.array(_SI_EXPONENTS[match[2]]) * power
        degrees += power if match[2] == "deg" else 0
        position = match.end()
    return _Exponents(*(int(power) for power in (*total, degrees))) if text else None


def _pounds(text: str, target: str) -> str:
    """Return a unit with pounds as forces where ``target`` needs a force, and as masses where it
    needs a mass per area.
    """
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
    """Return the unit of a text, also in capitals (``"DEG/S"``); None if there is no such unit."""
    if not re.fullmatch(r"[\w*/().%-]+", text):
        return None
    for spelling in (text, text.lower()):
        try:
            return units.parse_units(spelling)
        except Exception:  # the parser raises various errors
            continue
    return None


def _angle_power(unit: Any) -> float:
    """Return the power of angles in a unit. In pint an angle is a pure number."""
    return sum(power for name, power in unit._units.items() if name.endswith(_ANGLES))
