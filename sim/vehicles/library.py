"""Vehicle data with units and origins, the built-in library, differences between two sets, and
checks of plausibility.

Mass, inertias and geometry are refused if no aircraft has them. The area is about span times chord,
and radii of gyration lie in a narrow range [1]_; other numbers are probably in feet, slugs or
pounds.

References
----------
.. [1] D. P. Raymer, Aircraft Design: A Conceptual Approach, AIAA, table 16.1.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any

from sim.declaration.effect import Parameter, ParameterSet
from sim.errors import DeclarationError

# ---- Numbers of a vehicle with units and sources; differences of two sets


class Origin(Enum):
    """Kind of source of a number; values are the marks in data files."""

    PUBLISHED = "pub"
    PAPER = "pap"
    CONVERTED = "conv"
    OWN = "own"
    REMEMBERED = "rem"
    USER = "user"

    @property
    def words(self) -> str:
        """Meaning of the mark in words."""
        return _WORDS[self]


_WORDS = {
    Origin.PUBLISHED: "read in the named publication or its reprint",
    Origin.PAPER: "printed in the paper on simulated flight data",
    Origin.CONVERTED: "published for the same aircraft at another flight condition and converted",
    Origin.OWN: "chosen or computed by this project, not flight data",
    Origin.REMEMBERED: "commonly quoted for this vehicle, source not at hand, not verified",
    Origin.USER: "given by the user",
}


@dataclass(frozen=True)
class SourcedNumber:
    """A number of a vehicle with its unit and source.

    Attributes
    ----------
    name, value, unit : as of a Parameter, in SI units.
    printed : text of the number in its source, with the source's unit; empty for a user's number.
    origin : kind of source.
    note : remark on the source.
    printed_by_paper : number in the paper that is known to be a misprint; not used in computations.
    """

    name: str
    value: float
    unit: str
    printed: str = ""
    origin: Origin = Origin.USER
    note: str = ""
    printed_by_paper: str = ""

    @property
    def source(self) -> str:
        """Origin and note in one line."""
        return f"{self.origin.words}: {self.note}" if self.note else self.origin.words


@dataclass(frozen=True)
class VehicleData:
    """Numbers of a vehicle from one source.

    Attributes
    ----------
    name, title, source : name of the set, description, and origin.
    equations : name of the equations, such as ``"rigid"`` or ``"lateral"``.
    numbers : values of the parameters; those of elastic modes have full names (``omega1``,
        ``CL_eta1``, ``Ceta1_eta2``).
    initial : initial values of states; zero for a state that is missing.
    modes : number of elastic modes.
    based_on : name of the set that this set extends; empty without one.
    aircraft_class : class of MIL-F-8785C, I to IV; empty if unknown.
    """

    name: str
    title: str
    source: str
    equations: str
    numbers: tuple[SourcedNumber, ...]
    initial: tuple[SourcedNumber, ...] = ()
    modes: int = 0
    based_on: str = ""
    aircraft_class: str = ""

    def __contains__(self, name: object) -> bool:
        return any(number.name == name for number in self.numbers)

    def __getitem__(self, name: str) -> SourcedNumber:
        for number in self.numbers:
            if number.name == name:
                return number
        raise DeclarationError(
            f"the number {name} is missing", where=f"vehicle {self.name}", remedy="give it"
        )

    @property
    def values(self) -> Mapping[str, float]:
        """Values by name, SI."""
        return {number.name: number.value for number in self.numbers}

    @property
    def parameters(self) -> ParameterSet:
        """All numbers as fixed parameters with their source."""
        return ParameterSet(
            tuple(
                Parameter(n.name, n.value, n.unit, free=False, source=n.source)
                for n in self.numbers
            )
        )


@dataclass(frozen=True)
class NumberDifference:
    """A number that differs between two sets; ``first`` or ``second`` is None if a set lacks it."""

    name: str
    first: SourcedNumber | None
    second: SourcedNumber | None


def difference(a: VehicleData, b: VehicleData) -> tuple[NumberDifference, ...]:
    """Return the numbers whose value or unit differs between two sets, or that only one has, in the
    order of ``a``, then ``b``.
    """
    first, second = {n.name: n for n in a.numbers}, {n.name: n for n in b.numbers}
    pairs = (
        NumberDifference(name, first.get(name), second.get(name)) for name in {**first, **second}
    )
    return tuple(
        d
        for d in pairs
        if d.first is None
        or d.second is None
        or (d.first.value, d.first.unit) != (d.second.value, d.second.unit)
    )


# ---- The built-in vehicles: one data file each

_KEYS = {
    "title",
    "source",
    "equations",
    "aircraft_class",
    "based_on",
    "modes",
    "parameters",
    "initial",
}
_CLASSES = ("I", "II", "III", "IV")
_COLUMNS = {"value", "unit", "printed", "origin", "note", "printed_by_paper"}
_REQUIRED = ("value", "unit", "printed", "origin")


def vehicle_names() -> tuple[str, ...]:
    """Return the names of the built-in vehicles, sorted: the data files that name equations."""
    return tuple(
        sorted(
            _stem(entry)
            for entry in _folder().iterdir()
            if entry.name.endswith(".toml") and "equations" in _document(entry)
        )
    )


def read_parameter_set(name: str) -> VehicleData:
    """Read a built-in vehicle's numbers, with those of the set it is based on.

    Raises DeclarationError for an unknown name and for a wrong file, naming the key.
    """
    entry = next((entry for entry in _folder().iterdir() if entry.name == f"{name}.toml"), None)
    if entry is None or "equations" not in _document(entry):
        raise DeclarationError(
            f"there is no vehicle {name!r}",
            where="vehicle library",
            remedy=f"use one of {', '.join(vehicle_names())}",
        )
    return _read(entry, ())


def read_parameter_file(path: Traversable) -> VehicleData:
    """Return the numbers of a data file in the format of the library; ``based_on`` is a built-in
    set.
    """
    return _read(path, ())


def _read(entry: Traversable, above: tuple[str, ...]) -> VehicleData:
    """Return the numbers of a data file; ``above`` are the sets that are based on it."""
    name, document = _stem(entry), _document(entry)
    where = entry.name
    _only(document, _KEYS, where)
    for key in ("title", "source", "equations"):
        if not isinstance(document.get(key), str):
            raise DeclarationError(f"{key} is missing", where=where, remedy="give it as a text")
    base_name = document.get("based_on", "")
    modes = document.get("modes")
    if modes is not None and (not isinstance(modes, int) or isinstance(modes, bool) or modes < 0):
        raise DeclarationError(
            f"modes is {modes!r}", where=where, remedy="give a whole number, zero or more"
        )
    aircraft_class = document.get("aircraft_class")
    if aircraft_class is not None and aircraft_class not in _CLASSES:
        raise DeclarationError(
            f"aircraft_class is {aircraft_class!r}",
            where=where,
            remedy=f"use one of {', '.join(_CLASSES)}",
        )
    numbers, initial = _numbers(document, "parameters", where), _numbers(document, "initial", where)
    based_on: VehicleData | None = None
    if base_name:
        if base_name in (*above, name):
            raise DeclarationError(
                f"based_on {base_name} leads back to itself",
                where=where,
                remedy="base a set on another one",
            )
        base_entry = _folder() / f"{base_name}.toml"
        if not base_entry.is_file():
            raise DeclarationError(
                f"based_on {base_name}: there is no such vehicle",
                where=where,
                remedy=f"use one of {', '.join(vehicle_names())}",
            )
        based_on = _read(base_entry, (*above, name))
        numbers = _merged(based_on.numbers, numbers)
        initial = _merged(based_on.initial, initial)
    inherited = based_on.modes if based_on is not None else 0
    if aircraft_class is None:
        aircraft_class = based_on.aircraft_class if based_on is not None else ""
    texts = {key: document[key] for key in ("title", "source", "equations")}
    return VehicleData(
        name=name,
        **texts,
        numbers=numbers,
        initial=initial,
        modes=inherited if modes is None else modes,
        based_on=base_name,
        aircraft_class=aircraft_class,
    )


def _merged(
    base: tuple[SourcedNumber, ...], own: tuple[SourcedNumber, ...]
) -> tuple[SourcedNumber, ...]:
    """Return the numbers of a base set, with numbers of the same name replaced, then the others."""
    remaining = {number.name: number for number in own}
    merged = tuple(remaining.pop(number.name, number) for number in base)
    return merged + tuple(remaining.values())


def _numbers(document: Mapping[str, Any], table: str, where: str) -> tuple[SourcedNumber, ...]:
    entries = document.get(table, {})
    if not isinstance(entries, dict):
        raise DeclarationError(f"{table} is no table", where=where, remedy=f"write [{table}]")
    return tuple(
        _number(name, entry, f"{where}, {table}.{name}") for name, entry in entries.items()
    )


def _number(name: str, entry: Any, where: str) -> SourcedNumber:
    if not isinstance(entry, dict):
        raise DeclarationError(
            "is no table",
            where=where,
            remedy='write {value = ..., unit = "...", printed = "...", origin = "..."}',
        )
    _only(entry, _COLUMNS, where)
    for key in _REQUIRED:
        if key not in entry:
            raise DeclarationError(
                f"{key} is missing", where=where, remedy=f"a number has {', '.join(_REQUIRED)}"
            )
    value = entry["value"]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise DeclarationError(f"value {value!r}", where=where, remedy="give one finite number")
    for key in _COLUMNS - {"value"}:
        if not isinstance(entry.get(key, ""), str):
            raise DeclarationError(f"{key} is no text", where=where, remedy="put it in quotes")
    try:
        origin = Origin(entry["origin"])
    except ValueError:
        marks = ", ".join(mark.value for mark in Origin if mark is not Origin.USER)
        raise DeclarationError(
            f"origin {entry['origin']!r}", where=where, remedy=f"use one of {marks}"
        ) from None
    number = SourcedNumber(name, float(value), entry["unit"], entry["printed"], origin)
    return replace(
        number, note=entry.get("note", ""), printed_by_paper=entry.get("printed_by_paper", "")
    )


def _only(table: Mapping[str, Any], allowed: set[str], where: str) -> None:
    for key in table:
        if key not in allowed:
            raise DeclarationError(
                f"unknown key {key}", where=where, remedy=f"use {', '.join(sorted(allowed))}"
            )


def _document(entry: Traversable) -> dict[str, Any]:
    try:
        return tomllib.loads(entry.read_text(encoding="utf-8"))
    except OSError as error:
        raise DeclarationError(
            "cannot be read", where=entry.name, remedy="give the path of an existing file"
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DeclarationError(
            f"is not TOML ({error})", where=entry.name, remedy="mend that place"
        ) from error


def _folder() -> Traversable:
    return files("sim") / "data"


def _stem(entry: Traversable) -> str:
    return entry.name.removesuffix(".toml")


INERTIAS = ("roll_inertia", "pitch_inertia", "yaw_inertia")
POSITIVE = (
    "mass",
    "wing_area",
    "chord",
    "span",
    *INERTIAS,
    "air_density",
    "speed_of_sound",
)
# Span times chord over area is 1 for a rectangle and 4/3 for a triangle. Radii of
# gyration in roll are 0.2 to 0.4 of half the span (Raymer, Aircraft Design, table 16.1).
CHORD_TIMES_SPAN = (0.5, 2.5)  # plausible ratio to the area, wider than for any wing
GYRATION_RADIUS = (0.1, 0.8)  # plausible radius of gyration in roll, relative to half the span
# kg/m3, least plausible density, that at 43 km; the density at sea level in slug/ft3 is 0.0024.
LEAST_DENSITY = 0.003
SPEED_OF_SOUND = (200.0, 500.0)  # m/s, plausible speed of sound; 340 m/s are 661 kn and 1116 ft/s


def refuse_numbers(constants: Mapping[str, float], names: Iterable[str], where: str) -> None:
    """Raise DeclarationError for constants that are missing or that no aircraft has.

    Parameters
    ----------
    constants : name -> value in SI units.
    names : names of the required constants.
    where : the vehicle, for messages.
    """
    c = constants
    for name in names:
        if name not in c:
            raise DeclarationError(f"the number {name} is missing", where=where, remedy="give it")
    for name in POSITIVE:
        if not 0.0 < c[name] < math.inf:
            raise DeclarationError(
                f"{name} = {c[name]:g} is not positive",
                where=where,
                remedy="give a positive number",
            )
    inertias = [c[name] for name in INERTIAS]
    if 2.0 * max(inertias) > sum(inertias):
        raise DeclarationError(
            "the largest inertia is larger than the sum of the other two, which no body has",
            where=where,
            remedy=f"check {', '.join(INERTIAS[:2])} and {INERTIAS[2]} and their units",
        )
    if c["cross_inertia"] ** 2 >= c["roll_inertia"] * c["yaw_inertia"]:
        raise DeclarationError(
            f"cross_inertia = {c['cross_inertia']:g} kg m2 is too large",
            where=where,
            remedy="its square is below roll_inertia yaw_inertia",
        )
    _refuse_other_units(c, where)


def _refuse_other_units(c: Mapping[str, float], where: str) -> None:
    """Raise DeclarationError for numbers that are consistent in other units only."""
    product = c["chord"] * c["span"]
    if not CHORD_TIMES_SPAN[0] < product / c["wing_area"] < CHORD_TIMES_SPAN[1]:
        raise DeclarationError(
            f"wing_area = {c['wing_area']:g} m2 is not that of chord {c['chord']:g} m and span "
            f"{c['span']:g} m, whose product is {product:.4g} m2",
            where=where,
            remedy='give all three in m, or with their units as in span = "70.5 ft"',
        )
    radius = 2.0 * math.sqrt(c["roll_inertia"] / c["mass"]) / c["span"]
    if not GYRATION_RADIUS[0] < radius < GYRATION_RADIUS[1]:
        raise DeclarationError(
            f"the radius of gyration in roll is {radius:.2g} of half the span, of aircraft 0.2 to "
            "0.4",
            where=where,
            remedy='check mass, span and roll_inertia; units are written as in mass = "1205 slug"',
        )
    if c["air_density"] < LEAST_DENSITY:
        raise DeclarationError(
            f"air_density = {c['air_density']:g} kg/m3 is that of 43 km",
            where=where,
            remedy='write slugs as air_density = "0.0014 slug/ft3"',
        )
    if not SPEED_OF_SOUND[0] < c["speed_of_sound"] < SPEED_OF_SOUND[1]:
        raise DeclarationError(
            f"speed_of_sound = {c['speed_of_sound']:g} m/s is that of no air",
            where=where,
            remedy='write other units as speed_of_sound = "1116 ft/s"',
        )
