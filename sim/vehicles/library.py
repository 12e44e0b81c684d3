"""The built-in vehicles: one data file each, found by being there."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any

from sim.errors import DeclarationError
from sim.vehicles.data import Number, Origin, VehicleData

_KEYS = {"title", "source", "equations", "based_on", "modes", "parameters", "initial"}
_COLUMNS = {"value", "unit", "printed", "origin", "note", "printed_by_paper"}
_REQUIRED = ("value", "unit", "printed", "origin")


def vehicle_names() -> tuple[str, ...]:
    """Names of the built-in vehicles, sorted: every data file that names its equations."""
    return tuple(sorted(_stem(entry) for entry in _folder().iterdir() if entry.name.endswith(".toml") and "equations" in _document(entry)))


def read_parameter_set(name: str) -> VehicleData:
    """A built-in vehicle's numbers, those of the set it is based on included.

    Raises DeclarationError for a name that is not there and for a file that breaks the rules, naming the key.
    """
    entry = next((entry for entry in _folder().iterdir() if entry.name == f"{name}.toml"), None)
    if entry is None or "equations" not in _document(entry):
        raise DeclarationError(f"there is no vehicle {name!r}", where="vehicle library", remedy=f"use one of {', '.join(vehicle_names())}")
    return _read(entry, ())


def read_parameter_file(path: Traversable) -> VehicleData:
    """Numbers from a data file in the library's format, e.g. a new vehicle before it is put there; ``based_on`` means a built-in set."""
    return _read(path, ())


def _read(entry: Traversable, above: tuple[str, ...]) -> VehicleData:
    name, document = _stem(entry), _document(entry)
    where = entry.name
    _only(document, _KEYS, where)
    for key in ("title", "source", "equations"):
        if not isinstance(document.get(key), str):
            raise DeclarationError(f"{key} is missing", where=where, remedy="give it as a text")
    base_name = document.get("based_on", "")
    modes = document.get("modes")
    if modes is not None and (not isinstance(modes, int) or isinstance(modes, bool) or modes < 0):
        raise DeclarationError(f"modes is {modes!r}", where=where, remedy="give a whole number, zero or more")
    numbers, initial = _numbers(document, "parameters", where), _numbers(document, "initial", where)
    based_on: VehicleData | None = None
    if base_name:
        if base_name in (*above, name):
            raise DeclarationError(f"based_on {base_name} leads back to itself", where=where, remedy="base a set on another one")
        base_entry = _folder() / f"{base_name}.toml"
        if not base_entry.is_file():
            raise DeclarationError(f"based_on {base_name}: there is no such vehicle", where=where, remedy=f"use one of {', '.join(vehicle_names())}")
        based_on = _read(base_entry, (*above, name))
        numbers, initial = _over(based_on.numbers, numbers), _over(based_on.initial, initial)
    inherited = based_on.modes if based_on is not None else 0
    texts = {key: document[key] for key in ("title", "source", "equations")}
    return VehicleData(name=name, **texts, numbers=numbers, initial=initial, modes=inherited if modes is None else modes, based_on=base_name)


def _over(base: tuple[Number, ...], own: tuple[Number, ...]) -> tuple[Number, ...]:
    """Numbers of the base set in their order, replaced by our own where we have them, then the rest of ours."""
    mine = {number.name: number for number in own}
    kept = tuple(mine.pop(number.name, number) for number in base)
    return kept + tuple(mine.values())


def _numbers(document: Mapping[str, Any], table: str, where: str) -> tuple[Number, ...]:
    entries = document.get(table, {})
    if not isinstance(entries, dict):
        raise DeclarationError(f"{table} is no table", where=where, remedy=f"write [{table}]")
    return tuple(_number(name, entry, f"{where}, {table}.{name}") for name, entry in entries.items())


def _number(name: str, entry: Any, where: str) -> Number:
    if not isinstance(entry, dict):
        raise DeclarationError("is no table", where=where, remedy='write {value = ..., unit = "...", printed = "...", origin = "..."}')
    _only(entry, _COLUMNS, where)
    for key in _REQUIRED:
        if key not in entry:
            raise DeclarationError(f"{key} is missing", where=where, remedy=f"a number has {', '.join(_REQUIRED)}")
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
        raise DeclarationError(f"origin {entry['origin']!r}", where=where, remedy=f"use one of {marks}") from None
    number = Number(name, float(value), entry["unit"], entry["printed"], origin)
    return replace(number, note=entry.get("note", ""), printed_by_paper=entry.get("printed_by_paper", ""))


def _only(table: Mapping[str, Any], known: set[str], where: str) -> None:
    for key in table:
        if key not in known:
            raise DeclarationError(f"unknown key {key}", where=where, remedy=f"use {', '.join(sorted(known))}")


def _document(entry: Traversable) -> dict[str, Any]:
    try:
        return tomllib.loads(entry.read_text(encoding="utf-8"))
    except OSError as error:
        raise DeclarationError("cannot be read", where=entry.name, remedy="give the path of an existing file") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DeclarationError(f"is not TOML ({error})", where=entry.name, remedy="mend that place") from error


def _folder() -> Traversable:
    return files("sim") / "data"


def _stem(entry: Traversable) -> str:
    return entry.name.removesuffix(".toml")
