"""Reads the X-29-like aircraft from its data file, numbers with units and origins."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sim.closed_loop.airframe import SURFACE_NAMES, X29, Actuator, Airframe, ControlLaw, Sensor, StickShaping, Telemetry
from sim.errors import DeclarationError

DATA_FILE = Path(__file__).resolve().parent.parent / "data" / "x29.toml"

_ORIGINS = {
    "pub": "read in the named publication or its reprint",
    "pub2": "published, read in a secondary source",
    "pap": "printed in NASA TM-101722",
    "own": "chosen by this project, not flight data",
}
_FOOT, _SLUG = 0.3048, 14.593902937206364

# Unit in the file and the factor to the unit inside; degrees, inches and g stay (see sim.closed_loop.airframe).
_AIRFRAME = {
    "airspeed": ("ft/s", _FOOT),
    "gravity": ("ft/s2", _FOOT),
    "air_density": ("slug/ft3", _SLUG / _FOOT**3),
    "L_alpha": ("1/s", 1.0),
    "L_q": ("1", 1.0),
    "M_alpha": ("1/s2", 1.0),
    "M_q": ("1/s", 1.0),
    "L_surface": ("1/s/deg", 1.0),
    "M_surface": ("1/s2/deg", 1.0),
}
_LAW = {"Kn": ("deg/g", 1.0), "Kq": ("s", 1.0), "Ki": ("deg/g/s", 1.0), "Kqi": ("g s/deg", 1.0), "lead": ("rad/s", 1.0), "lag": ("rad/s", 1.0)}
_STICK = {"gain": ("g/in", 1.0), "lag": ("rad/s", 1.0), "delay_frames": ("1", 1.0), "recorded_skew": ("s", 1.0)}
_ACTUATOR = {
    "mixing": ("1", 1.0),
    "trim": ("deg", 1.0),
    "lower": ("deg", 1.0),
    "upper": ("deg", 1.0),
    "rate": ("deg/s", 1.0),
    "ram": ("rad/s", 1.0),
}
_SERVO = {"servo_frequency": ("rad/s", 1.0), "servo_damping": ("1", 1.0)}
_SENSOR = {"frequency": ("rad/s", 1.0), "damping": ("1", 1.0)}
_COMPUTER = {"frame_rate": ("1/s", 1.0), "delay_frames": ("1", 1.0)}
_SHAPING = {"dead_band": ("in", 1.0), "curvature": ("1/in", 1.0)}
_TELEMETRY = {"rate": ("1/s", 1.0), "vane_arm": ("ft", _FOOT), "alpha_noise": ("rad", 1.0), "q_noise": ("rad/s", 1.0), "nz_noise": ("g", 1.0)}


def load_x29(name: str, path: Path = DATA_FILE) -> X29:
    """The aircraft ``"P"`` (published), ``"S"`` (simulation-like), ``"F"``, ``"D"`` or ``"R"`` (flight-like).

    Numbers are in the units of ``sim.closed_loop.airframe``.

    Raises DeclarationError for an airframe that the file lacks, a key that is missing or unknown, and a wrong unit, origin or number.
    """
    document = _document(path)
    airframes = _table(document, "airframes", path.name)
    if name not in airframes:
        raise DeclarationError(f"there is no airframe {name!r}", where=path.name, remedy=f"use one of {', '.join(airframes)}")
    where = f"{path.name}, airframes.{name}"
    own = _table(airframes, name, where)
    title = own.get("title")
    if not isinstance(title, str):
        raise DeclarationError("title is missing", where=where, remedy="say in a text what this airframe is")
    numbers = _numbers({k: v for k, v in own.items() if k not in ("title", "law", "stick")}, _AIRFRAME, where, vectors=("L_surface", "M_surface"))
    law = _numbers(_table(own, "law", where), _LAW, f"{where}.law")
    stick = _numbers(_table(own, "stick", where), _STICK, f"{where}.stick")
    computer = _numbers(_table(document, "computer", path.name), _COMPUTER, f"{path.name}, computer")
    shaping = _numbers(_table(document, "stick", path.name), _SHAPING, f"{path.name}, stick")
    surfaces, sensors = _table(document, "surfaces", path.name), _table(document, "sensors", path.name)
    canard, flaperon, strake = (_actuator(surface, _table(surfaces, surface, path.name), path.name) for surface in SURFACE_NAMES)
    gyro, accelerometer = (
        Sensor(**_numbers(_table(sensors, sensor, path.name), _SENSOR, f"{path.name}, sensors.{sensor}")) for sensor in ("gyro", "accelerometer")
    )
    return X29(
        name=name,
        airframe=Airframe(title=title, **numbers),
        surfaces=(canard, flaperon, strake),
        gyro=gyro,
        accelerometer=accelerometer,
        law=ControlLaw(
            **{**law, "frame_rate": computer["frame_rate"], "delay_frames": _whole(computer["delay_frames"], 1, f"{path.name}, computer")}
        ),
        stick=StickShaping(**{**shaping, **stick, "delay_frames": _whole(stick["delay_frames"], 0, f"{where}.stick")}),
        telemetry=Telemetry(**_numbers(_table(document, "telemetry", path.name), _TELEMETRY, f"{path.name}, telemetry")),
    )


def _document(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DeclarationError("cannot be read", where=str(path), remedy="give the path of an existing file") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DeclarationError(f"is not TOML ({error})", where=str(path), remedy="mend that place") from error


def _table(parent: Mapping[str, Any], key: str, where: str) -> dict[str, Any]:
    table = parent.get(key)
    if not isinstance(table, dict):
        raise DeclarationError(f"the table {key} is missing", where=where, remedy=f"add [{key}]")
    return table


def _actuator(name: str, table: Mapping[str, Any], file: str) -> Actuator:
    has_servo = any(key in table for key in _SERVO)
    where = f"{file}, surfaces.{name}"
    actuator = Actuator(name=name, **_numbers(table, {**_ACTUATOR, **(_SERVO if has_servo else {})}, where))
    if not actuator.lower < actuator.trim < actuator.upper:
        raise DeclarationError(f"trim {actuator.trim:g} deg is not within its travel", where=where, remedy="give lower < trim < upper")
    if not (actuator.rate > 0 and actuator.ram > 0):
        raise DeclarationError("rate or ram is not positive", where=where, remedy="give positive ones")
    return actuator


def _numbers(table: Mapping[str, Any], units: Mapping[str, tuple[str, float]], where: str, vectors: tuple[str, ...] = ()) -> dict[str, Any]:
    for key in table:
        if key not in units:
            raise DeclarationError(f"unknown key {key}", where=where, remedy=f"use {', '.join(units)}")
    return {key: _number(table, key, unit, factor, where, key in vectors) for key, (unit, factor) in units.items()}


def _number(table: Mapping[str, Any], key: str, unit: str, factor: float, where: str, vector: bool) -> Any:
    entry = table.get(key)
    where = f"{where}.{key}"
    if not isinstance(entry, dict) or "value" not in entry:
        raise DeclarationError("is missing", where=where, remedy=f'write {{value = ..., unit = "{unit}", origin = "own"}}')
    if entry.get("unit") != unit:
        raise DeclarationError(f"unit {entry.get('unit')!r}", where=where, remedy=f"give the value in {unit}")
    _origin(entry, where)
    value = entry["value"]
    values = value if vector and isinstance(value, list) and len(value) == len(SURFACE_NAMES) else [value]
    if (vector and len(values) != len(SURFACE_NAMES)) or not all(_finite(item) for item in values):
        raise DeclarationError(f"value {value!r}", where=where, remedy="give three numbers" if vector else "give one finite number")
    return tuple(factor * float(item) for item in values) if vector else factor * float(value)


def _finite(item: object) -> bool:
    return isinstance(item, int | float) and not isinstance(item, bool) and math.isfinite(item)


def _origin(entry: Mapping[str, Any], where: str) -> str:
    mark = entry.get("origin")
    if mark not in _ORIGINS:
        raise DeclarationError(f"origin {mark!r}", where=where, remedy=f"use one of {', '.join(_ORIGINS)}")
    return _ORIGINS[mark]


def _whole(value: float, least: int, where: str) -> int:
    if value != int(value) or value < least:
        raise DeclarationError(f"delay_frames {value:g}", where=where, remedy=f"give a whole number of frames, {least} or more")
    return int(value)
