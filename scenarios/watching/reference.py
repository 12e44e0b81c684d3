"""The study that a stream is held against, read from its comparison.json, and the vehicle that a watch starts from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scenarios.files.sources import read_json, resolved
from scenarios.files.vehicles import VehicleFile, read_vehicle
from scenarios.identification.low_order import DERIVED, PAPER_START
from sim.closed_loop.airframe import load_x29
from sim.errors import DeclarationError
from sim.vehicles.factory import LOES_CONSTANTS

SCHEMA = "flightid/comparison/1"


@dataclass(frozen=True)
class Reference:
    """``values``: name -> (estimate, standard deviation) of parameters and derived quantities; ``fixed``: name -> value held there;
    ``plain``: what one pass of the bank found, where the study says so: the paper's own result."""

    name: str
    values: Mapping[str, tuple[float, float]]
    fixed: Mapping[str, float] = field(default_factory=dict)
    plain: Mapping[str, float] = field(default_factory=dict)


def read_reference(path: Path, needed: Sequence[str] = tuple(PAPER_START)) -> Reference:
    """A study that has the ``needed`` parameters: its folder, or the comparison.json in it. Those of
    the low-order equivalent system are what a watch of it starts from.

    Raises
    ------
    DeclarationError : no such study, no comparison, or one of another model.
    """
    file = path / "comparison.json" if path.is_dir() else path
    content = read_json(file, wanted="the folder of a study, or its comparison.json")
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise DeclarationError(f"it is no {SCHEMA}", where=str(file), remedy="name the folder of a study that run, identify or watch wrote")
    values = {**_pairs(content, "parameters", file), **{name: pair for name, pair in _pairs(content, "derived", file).items() if name in DERIVED}}
    fixed = _numbers(content.get("fixed"), "value")
    plain = _numbers(content["plain"].get("parameters"), "estimate") if isinstance(content.get("plain"), dict) else {}
    missing = [name for name in needed if name not in values and name not in fixed]
    if missing:
        if missing[0] in content.get("start_dependent", ()):
            raise DeclarationError(f"{missing[0]} hangs on the start in it", where=str(file), remedy="name a study that was refined")
        remedy = "name a study of the same model"
        raise DeclarationError(f"there is no {missing[0]} in it", where=str(file), remedy=remedy)
    return Reference(str(path), values, fixed, plain)


def vehicle_to_watch(vehicle: Path | None, reference: Reference | None) -> VehicleFile:
    """Constants and starting values: the vehicle file's, else the reference's, else those of the paper and its aircraft.

    A reference gives what its plain bank found, as the paper started its flight filter, where it says that; else its estimate.
    """
    if vehicle is not None:
        found = read_vehicle(vehicle, "loes")
        if found.constraints:
            what, remedy = "a filter that runs along estimates every derivative", "leave [fixed], [bounds] and [tied] out, or use identify"
            raise DeclarationError(what, where=str(vehicle), remedy=remedy)
        return found
    x29 = load_x29("F")
    constants = {"airspeed": x29.airframe.airspeed, "gravity": x29.airframe.gravity, "vane_arm": x29.telemetry.vane_arm}
    if reference is None:
        return VehicleFile("x29", "loes", constants, dict(PAPER_START))
    known = {**reference.fixed, **{name: value for name, (value, _) in reference.values.items()}, **reference.plain}
    held = {name: reference.fixed.get(name, constants[name]) for name in LOES_CONSTANTS}
    return VehicleFile(resolved(Path(reference.name)).name, "loes", held, {name: known[name] for name in PAPER_START})


def _pairs(content: Mapping[str, Any], key: str, file: Path) -> dict[str, tuple[float, float]]:
    table = content.get(key, {})
    if not isinstance(table, dict):
        raise DeclarationError("no table", where=f"{file}, key {key}", remedy="name the folder of a study")
    out = {}
    for name, entry in table.items():
        if not isinstance(entry, dict) or not _is_number(entry.get("estimate")):
            raise DeclarationError("no estimate", where=f"{file}, key {key}.{name}", remedy="name the folder of a study")
        if _is_number(entry.get("std")):
            out[name] = (float(entry["estimate"]), float(entry["std"]))
    return out


def _numbers(table: Any, key: str) -> dict[str, float]:
    """Name -> number under ``key`` of each entry that has one; none of what is no table."""
    entries = table.items() if isinstance(table, dict) else ()
    found: dict[str, Any] = {name: entry.get(key) for name, entry in entries if isinstance(entry, dict)}
    return {name: float(value) for name, value in found.items() if _is_number(value)}


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
