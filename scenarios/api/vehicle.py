"""A vehicle in Python: from a file, from the library, or from numbers."""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.api import tables as html
from scenarios.files.aircraft_files import (
    content_of_library,
    is_library_name,
    source_of_content,
    toml_text,
)
from scenarios.files.declarations import closest, read_toml_source, toml_of
from scenarios.files.schemas import is_quantity
from scenarios.files.sources import Source
from sim.errors import DeclarationError


@dataclass(eq=False, repr=False)
class Vehicle:
    """Constants and starting values of one vehicle, as a vehicle file has them.

    The methods of ``vehicle.parameters["Cm_q"]`` fix, bound, tie or free a parameter of this
    vehicle.

    Attributes
    ----------
    content : keys of a vehicle file and their values; ``vehicle["mass"]`` is one of them.
    source : the file as it was read; None for a vehicle that was made in Python.
    """

    content: Mapping[str, Any]
    source: Source | None = None

    @property
    def name(self) -> str:
        """Name of the vehicle, else of its file."""
        default = self.source.path.stem if self.source is not None else "vehicle"
        return str(self.content.get("name", default))

    @property
    def derivatives(self) -> dict[str, Any]:
        """Starting values of the derivatives."""
        return dict(self.content.get("derivatives", {}))

    @property
    def parameters(self) -> VehicleParameters:
        """Parameters that may be estimated, by name: ``vehicle.parameters["Cm_q"].fix(-28.0)``."""
        return VehicleParameters(self)

    def __getitem__(self, key: str) -> Any:
        for table in (self.content, self.derivatives):
            if key in table:
                return table[key]
        raise KeyError(f"there is no {key!r}: {', '.join((*self.content, *self.derivatives))}")

    def to_toml(self) -> str:
        """Return the text of the vehicle file."""
        if self.source is not None:
            return self.source.content.decode("utf-8-sig")
        return toml_text(self.content)

    def save(self, path: str | PathLike[str]) -> Path:
        """Write the vehicle file; returns the path."""
        from scenarios.api.shown import file_given

        target = file_given(path)
        target.write_text(self.to_toml(), encoding="utf-8", newline="\n")
        return target

    def source_for(self, model: str) -> Source:
        """Return the source that a command would read for a model.

        Elastic modes are left out for a model without them.
        """
        if self.source is not None:
            return self.source
        return source_of_content(self.name, self.content, model)

    def __repr__(self) -> str:
        derivatives = ", ".join(list(self.derivatives)[:6]) or "nothing"
        more = ", ..." if len(self.derivatives) > 6 else ""
        return f"<Vehicle {self.name}: {len(self.content)} entries, starts of {derivatives}{more}>"

    def _repr_html_(self) -> str:
        numbers: list[tuple[str, Any]] = []
        tables: list[tuple[str, Any]] = []
        for key, value in self.content.items():
            if isinstance(value, Mapping):
                tables += [(f"{key}.{name}", entry) for name, entry in value.items()]
            elif not isinstance(value, list):
                numbers.append((key, value))
        rows = [(key, _shown(value)) for key, value in (*numbers, *tables)]
        return html.page(self.name, html.table(("key", "value"), rows))


def vehicle(
    source: str | PathLike[str] | Mapping[str, Any] | Vehicle | None = None, /, **numbers: Any
) -> Vehicle:
    """Return a vehicle from a file, from the library, or from numbers.

    Parameters
    ----------
    source : path of a vehicle file, a name of the library (``vehicles()`` lists them), or content.
    numbers : keys of a vehicle file, ``mass=24200.0`` or ``mass="53352 lb"``,
        ``derivatives={"CL_alpha": 4.0, ...}``. They replace the values of the source, derivatives
        one by one. The keys that a model needs are checked when the vehicle is used with it.

    Raises
    ------
    InputError : there is no such file or vehicle, or it is no TOML; a keyword is no key of a
        vehicle file, or its value is no number.

    Examples
    --------
    >>> import flightid as fid
    >>> heavy = fid.vehicle("bomber_rigid", mass="300000 lb")
    >>> heavy["mass"], heavy["CL_alpha"]
    ('300000 lb', 2.922)
    """
    if isinstance(source, Vehicle) and not numbers:
        return source
    if source is None:
        return Vehicle(_over({}, numbers))
    if isinstance(source, Vehicle | Mapping):
        content = source.content if isinstance(source, Vehicle) else source
        return Vehicle(_over(content, numbers))
    path = _path_of(source)
    if is_library_name(source):
        return Vehicle(_over(content_of_library(str(source)), numbers))
    read = read_toml_source(path)
    content = toml_of(read)
    return Vehicle(_over(content, numbers)) if numbers else Vehicle(content, read)


CLOSE = 0.85  # similarity of a misspelt key; mass_1 of a user model is less similar to mass
TEXTS = ("name", "model", "aircraft_class", "flight_phase", "attitude", "wind")  # keys of texts


@cache
def _known_keys() -> frozenset[str]:
    """Keys of the vehicle files of all built-in models."""
    from scenarios.files.aircraft_files import aircraft_schema
    from scenarios.files.schemas import SCHEMAS

    schemas = (aircraft_schema(), *SCHEMAS.values())
    keys = {key for schema in schemas for key in schema.model_fields}
    return frozenset({*keys, "aerodynamics", "model", "uncertainty", *CONSTRAINTS})


def _refuse_wrong(content: Mapping[str, Any], numbers: Mapping[str, Any]) -> None:
    """Raise DeclarationError for a keyword that is no key of a vehicle file, or is no number.

    A user model may have constants of any name. If the vehicle is not evidently for a built-in
    model, only names similar to known ones are refused.
    """
    known, title = _known_keys(), str(numbers.get("name", content.get("name", "vehicle")))
    built_in = bool(content) and content.keys() <= known
    for key, value in numbers.items():
        where = f"{title}, key {key}"
        allowed = {*known, *content}
        near = difflib.get_close_matches(key, allowed, n=1, cutoff=CLOSE)
        if key not in allowed and (built_in or near):
            raise DeclarationError(
                "there is no such key", where=where, remedy=closest(key, sorted(allowed))
            )
        if key not in TEXTS and isinstance(value, str | bool):
            _refuse_no_number(value, where)
        if key == STARTS:
            if not isinstance(value, Mapping):
                remedy = 'give the starts by name: {"Cm_q": -28.0}'
                raise DeclarationError("this is no table", where=where, remedy=remedy)
            for name, start in value.items():
                if isinstance(start, str | bool):
                    _refuse_no_number(start, f"{title}, key {key}.{name}")


def _refuse_no_number(value: str | bool, where: str) -> None:
    if isinstance(value, bool) or not is_quantity(value):
        raise DeclarationError(
            f"{value!r:.60} is not a number with a unit",
            where=where,
            remedy='give a number in SI and radians, or a text such as "1.5 m"',
        )


def _path_of(given: Any) -> Path:
    if not isinstance(given, str | PathLike):
        remedy = "give a file's path, a name of the library, or its numbers"
        raise DeclarationError(
            f"a {type(given).__name__} is no vehicle", where="vehicle", remedy=remedy
        )
    return Path(given)


def source_of(given: Any, model: str) -> Source | None:
    """Return the source of the vehicle that a caller gave; None if the caller gave none."""
    if given is None:
        return None
    return vehicle(given).source_for(model)


def _over(content: Mapping[str, Any], numbers: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content with ``numbers`` replaced; tables key by key. Raises DeclarationError."""
    _refuse_wrong(content, numbers)
    merged = {
        key: {**content[key], **value}
        if isinstance(value, Mapping) and isinstance(content.get(key), Mapping)
        else value
        for key, value in numbers.items()
    }
    return {**content, **merged}


def _shown(value: Any) -> str:
    return f"{value:.7g}" if isinstance(value, float) else str(value)


# ---- Parameters: fixed, bounded, tied or free, as the tables of a vehicle file

FIXED, BOUNDS, TIED, STARTS = "fixed", "bounds", "tied", "derivatives"
CONSTRAINTS = (FIXED, BOUNDS, TIED)
OF_MODES = ("frequency", "damping", "generalized_mass")  # constants of an elastic mode


@dataclass(frozen=True)
class VehicleParameter:
    """One parameter of a vehicle. Its methods change the vehicle and return it.

    Attributes
    ----------
    name : as in the vehicle file.
    vehicle : the vehicle that the parameter belongs to.

    Examples
    --------
    >>> import flightid as fid
    >>> bomber = fid.vehicle("bomber_rigid")
    >>> bomber.parameters["Cm_q"].fix(-28.0)
    <Vehicle bomber_rigid: 10 entries, starts of CL_alpha, CL_q, CL_de, Cm_alpha, Cm_de>
    >>> bomber.parameters["Cm_q"]
    <Cm_q = -28, fixed>
    """

    name: str
    vehicle: Vehicle

    @property
    def start(self) -> Any:
        """Starting value, fixed value, or value of a tie; None if it is not known."""
        fixed = _fixed(self.vehicle.content)
        if fixed.get(self.name) is not None:
            return fixed[self.name]
        for table in _start_tables(self.vehicle.content):
            if self.name in table:
                return table[self.name]
        return self._tied_value()

    def _tied_value(self) -> float | None:
        """Return the value of a tied parameter at the starting values; None if not a number."""
        terms = self.vehicle.content.get(TIED, {}).get(self.name)
        total = 0.0
        for term in [terms] if isinstance(terms, Mapping) else terms or [{}]:
            value = term.get("constant")
            if "parameter" in term:
                start = self.vehicle.parameters[term["parameter"]].start
                value = None if isinstance(start, str) else start
                value = None if value is None else value * float(term.get("factor", 1.0))
            if not isinstance(value, int | float):
                return None
            total += value
        return total

    @property
    def state(self) -> str:
        """``"free"``, ``"fixed"``, ``"bounded"`` or ``"tied"``."""
        content = self.vehicle.content
        if self.name in _fixed(content):
            return "fixed"
        words = ((BOUNDS, "bounded"), (TIED, "tied"))
        return next((word for key, word in words if self.name in content.get(key, {})), "free")

    def fix(self, value: float | str | None = None) -> Vehicle:
        """Hold the parameter at a value, or at its start; it is not estimated.

        Parameters
        ----------
        value : SI and radians, or a text with a unit; None: its start.

        Raises
        ------
        InputError
            The value is no number, or there is no start to take.
        """
        held = self.start if value is None else _number(value, self.name)
        if held is None:
            raise DeclarationError(
                f"{self.name} has no start", where="fix", remedy="give the value to hold it at"
            )
        return self._change(FIXED, held)

    def bound(self, low: float | str, high: float | str) -> Vehicle:
        """Keep the estimate between two values; the start has to lie within.

        Parameters
        ----------
        low, high : SI and radians, or texts with a unit; infinite: open.

        Raises
        ------
        InputError
            A bound is no number, or the lower one is not below the upper one.
        """
        first, last = (_number(end, self.name, open_end=True) for end in (low, high))
        if isinstance(first, float) and isinstance(last, float) and not first < last:
            raise DeclarationError(
                f"the bounds {low} and {high} of {self.name} are in the wrong order",
                where="bound",
                remedy="give the lower bound first",
            )
        return self._change(BOUNDS, [first, last])

    def tie(self, other: str, factor: float = 1.0, constant: float = 0.0) -> Vehicle:
        """Tie the parameter to another: ``constant + factor * other``; it is then not estimated.

        Parameters
        ----------
        other : name of the parameter that it follows.
        factor, constant : SI and radians.

        Raises
        ------
        InputError
            There is no such parameter, or it is this one or a tied one.
        """
        names = [name for name in self.vehicle.parameters if name != self.name]
        if other not in names or self.vehicle.parameters[other].state == "tied":
            raise DeclarationError(
                f"{self.name} cannot be tied to {other!r}",
                where="tie",
                remedy=f"name another parameter that is not tied: {', '.join(names)}",
            )
        term = {"parameter": other, "factor": _plain(factor, self.name)}
        shift = _plain(constant, self.name)
        return self._change(TIED, [term, {"constant": shift}] if shift else term)

    def free(self) -> Vehicle:
        """Estimate the parameter, without bounds; a fixed value becomes its start."""
        return self._change(None, None)

    def _change(self, table: str | None, entry: Any) -> Vehicle:
        """Move the parameter into a table of constraints, or into none; return the vehicle."""
        content, start = dict(self.vehicle.content), self.start
        tables = {
            FIXED: _fixed(content),
            **{key: dict(content.get(key, {})) for key in (BOUNDS, TIED)},
        }
        for constraints in tables.values():
            constraints.pop(self.name, None)
        if table is not None:
            tables[table][self.name] = entry
        content = _without(content, CONSTRAINTS)
        content |= {key: constraints for key, constraints in tables.items() if constraints}
        # A fixed or tied parameter may be in one table only.
        without_start = {self.name, *tables[FIXED], *tables[TIED]}
        if "modes" in content:
            content["modes"] = [_without(mode, without_start) for mode in _mode_tables(content)]
        starts = dict(content.get(STARTS, {}))
        if table in (BOUNDS, None) and start is not None:
            starts[self.name] = start
            without_start -= {self.name}
        content[STARTS] = _without(starts, without_start)
        self.vehicle.content, self.vehicle.source = content, None
        return self.vehicle

    def __repr__(self) -> str:
        start, content = self.start, self.vehicle.content
        value = f" = {start:g}" if isinstance(start, int | float) else f" = {start}"
        ends = content.get(BOUNDS, {}).get(self.name)
        more = f" in {list(ends)}" if ends and self.state == "bounded" else ""
        return f"<{self.name}{value if start is not None else ''}, {self.state}{more}>"


class VehicleParameters(Mapping[str, VehicleParameter]):
    """Parameters of a vehicle by name: the free ones, then those that are fixed or tied."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle

    def __getitem__(self, name: str) -> VehicleParameter:
        if name not in list(self):
            raise KeyError(f"there is no parameter {name!r}: {', '.join(self)}")
        return VehicleParameter(name, self._vehicle)

    def __iter__(self) -> Iterator[str]:
        content = self._vehicle.content
        tables = [*_start_tables(content), _fixed(content), content.get(TIED, {})]
        names = (name for table in tables for name in table)
        return iter(dict.fromkeys(name for name in names if name not in OF_MODES))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __repr__(self) -> str:
        states = [f"{name} {item.state}" for name, item in self.items() if item.state != "free"]
        return f"<{len(self)} parameters: {', '.join(states[:6]) or 'all free'}>"


def _mode_tables(content: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    return [mode for mode in content.get("modes", ()) if isinstance(mode, Mapping)]


def _without(table: Mapping[str, Any], names: Collection[str]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key not in names}


def _start_tables(content: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    return [content.get(STARTS, {}), *_mode_tables(content)]


def _fixed(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table ``fixed``; a list of names holds each parameter at its start."""
    given = content.get(FIXED, {})
    if isinstance(given, Mapping):
        return dict(given)
    starts = {name: value for table in _start_tables(content) for name, value in table.items()}
    return {name: starts.get(name) for name in given}


def _number(value: Any, name: str, *, open_end: bool = False) -> float | str:
    """Return a number, or a text with a unit, which the reader of vehicle files converts.

    Raises DeclarationError for other values.
    """
    if isinstance(value, str):
        if is_quantity(value):
            return value
        raise DeclarationError(
            f"{value!r:.60} is no value of {name}",
            where="vehicle",
            remedy='give a number, or a text with a unit such as "2.5 1/rad"',
        )
    try:
        number = math.nan if isinstance(value, bool | np.bool_) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if math.isnan(number) or (math.isinf(number) and not open_end):
        raise DeclarationError(
            f"{value!r:.60} is no value of {name}", where="vehicle", remedy="give a finite number"
        )
    return number


def _plain(value: Any, name: str) -> float:
    """Return a number of a tie, which has no unit. Raises DeclarationError."""
    if isinstance(value, str):
        raise DeclarationError(
            f"{value!r:.60} is no number for the tie of {name}",
            where="tie",
            remedy="give a number, in SI and radians",
        )
    return float(_number(value, name))
