"""The X-29-like aircraft: airframe, surfaces, sensors, control law, telemetry; and its data file.

Convention throughout ``sim.closed_loop``: SI and radians for time, speed, alpha and q. Three
quantities keep the unit of the aircraft's description, because derivatives are per that unit:
surface deflections and the command u_p in degrees, the stick in inches (aft +), and normal
acceleration in g. alpha, q, the surfaces and u_p are perturbations about trim. A positive u_p is
nose up. The order of the surfaces is canard, symmetric flaperon, strake flap.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sim.errors import DeclarationError

# ---- Numbers of the X-29-like aircraft

SURFACE_NAMES = ("canard", "flaperon", "strake")


@dataclass(frozen=True)
class ShortPeriodAirframe:
    """Short-period derivatives at one flight condition.

    alpha_dot = L_alpha alpha + L_q q + L_surface . surfaces, q_dot = M_alpha alpha + M_q q +
    M_surface . surfaces, incremental nz = -(V/g) [L_alpha alpha + (L_q - 1) q + L_surface .
    surfaces], at the centre of gravity, positive up.

    Attributes
    ----------
    title : description of this airframe.
    airspeed, gravity, air_density : m/s, m/s2, kg/m3.
    L_alpha, L_q, M_alpha, M_q : 1/s, 1, 1/s2, 1/s.
    L_surface, M_surface : per degree of each surface, 1/s/deg and 1/s2/deg.
    """

    title: str
    airspeed: float
    gravity: float
    air_density: float
    L_alpha: float
    L_q: float
    M_alpha: float
    M_q: float
    L_surface: tuple[float, float, float]
    M_surface: tuple[float, float, float]


@dataclass(frozen=True)
class Actuator:
    """Actuator of one surface.

    The command ``mixing * u_p`` (deg, about trim) is limited to the travel. A second-order servo
    and a first-order ram with a rate limit and end stops follow it.

    Attributes
    ----------
    mixing : deg of surface per deg of u_p.
    trim, lower, upper : deg, absolute; the travel about trim is ``lower - trim`` to ``upper -
        trim``.
    rate : rate limit of the ram, deg/s.
    ram : bandwidth of the ram, rad/s.
    servo_frequency, servo_damping : rad/s and 1; both None for a surface without servo.
    """

    name: str
    mixing: float
    trim: float
    lower: float
    upper: float
    rate: float
    ram: float
    servo_frequency: float | None = None
    servo_damping: float | None = None


@dataclass(frozen=True)
class Sensor:
    """A feedback sensor of second order with unit gain: ``frequency`` in rad/s, ``damping`` in
    1.
    """

    frequency: float
    damping: float


@dataclass(frozen=True)
class ControlLaw:
    """The sampled law u_p = z^-n { -LL [Kn nz + Kq q] + Ki I [r - nz - Kqi q] }.

    q in deg/s and nz incremental in g, both from the sensors; LL = (1 + s/lead)/(1 + s/lag) and I =
    1/s by Tustin's rule.

    Attributes
    ----------
    Kn, Kq, Ki, Kqi : deg/g, s, deg/g/s, g s/deg.
    lead, lag : rad/s.
    frame_rate : frames a second.
    delay_frames : n, whole frames between reading the sensors and changing the command; at least 1.
    """

    Kn: float
    Kq: float
    Ki: float
    Kqi: float
    lead: float
    lag: float
    frame_rate: float
    delay_frames: int


@dataclass(frozen=True)
class StickShaping:
    """Reference from the stick: r = z^-N wp/(s + wp) { K e (1 + curvature |e|) }, with e the stick
    beyond its break-out.

    Attributes
    ----------
    dead_band : half width w of the break-out, in; e = sign(stick) max(|stick| - w, 0).
    gain, curvature : K in g/in, and 1/in.
    delay_frames : N, frames.
    lag : wp, rad/s, by Tustin's rule.
    recorded_skew : s by which the recorded stick leads the recorded outputs, see
        ``fly_closed_loop``.
    """

    dead_band: float
    gain: float
    curvature: float
    delay_frames: int
    lag: float
    recorded_skew: float


@dataclass(frozen=True)
class Telemetry:
    """Recording: ``rate`` in 1/s, ``vane_arm`` in m ahead of the centre of gravity, noise as 1
    sigma in rad, rad/s, g.
    """

    rate: float
    vane_arm: float
    alpha_noise: float
    q_noise: float
    nz_noise: float


@dataclass(frozen=True)
class X29:
    """A complete aircraft: airframe with surfaces, sensors, control law, stick and telemetry."""

    name: str
    airframe: ShortPeriodAirframe
    surfaces: tuple[Actuator, Actuator, Actuator]
    gyro: Sensor
    accelerometer: Sensor
    law: ControlLaw
    stick: StickShaping
    telemetry: Telemetry

    @property
    def frame(self) -> float:
        """Length of one frame of the control computer, s."""
        return 1.0 / self.law.frame_rate


# ---- Reading the X-29-like aircraft from its data file, numbers with units and origins

DATA_FILE = Path(__file__).resolve().parent.parent / "data" / "x29.toml"

_ORIGINS = {
    "pub": "read in the named publication or its reprint",
    "pub2": "published, read in a secondary source",
    "pap": "printed in NASA TM-101722",
    "own": "chosen by this project, not flight data",
}
_FOOT = 0.3048  # m
_SLUG = 14.593902937206364  # kg

# Unit in the file, and factor to the unit of this package; degrees, inches and g are kept.
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
_LAW = {
    "Kn": ("deg/g", 1.0),
    "Kq": ("s", 1.0),
    "Ki": ("deg/g/s", 1.0),
    "Kqi": ("g s/deg", 1.0),
    "lead": ("rad/s", 1.0),
    "lag": ("rad/s", 1.0),
}
_STICK = {
    "gain": ("g/in", 1.0),
    "lag": ("rad/s", 1.0),
    "delay_frames": ("1", 1.0),
    "recorded_skew": ("s", 1.0),
}
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
_TELEMETRY = {
    "rate": ("1/s", 1.0),
    "vane_arm": ("ft", _FOOT),
    "alpha_noise": ("rad", 1.0),
    "q_noise": ("rad/s", 1.0),
    "nz_noise": ("g", 1.0),
}


def load_x29(name: str, path: Path = DATA_FILE) -> X29:
    """Return the aircraft ``"P"`` (published), ``"S"`` (simulation-like), ``"F"``, ``"D"`` or
    ``"R"`` (flight-like).

    Numbers are in the units of ``sim.closed_loop.airframe``.

    Raises DeclarationError for an airframe that the file lacks, a key that is missing or unknown,
    and a wrong unit, origin or number.
    """
    document = _document(path)
    airframes = _table(document, "airframes", path.name)
    if name not in airframes:
        raise DeclarationError(
            f"there is no airframe {name!r}",
            where=path.name,
            remedy=f"use one of {', '.join(airframes)}",
        )
    where = f"{path.name}, airframes.{name}"
    own = _table(airframes, name, where)
    title = own.get("title")
    if not isinstance(title, str):
        raise DeclarationError(
            "title is missing", where=where, remedy="describe this airframe in a text"
        )
    numbers = _numbers(
        {k: v for k, v in own.items() if k not in ("title", "law", "stick")},
        _AIRFRAME,
        where,
        vectors=("L_surface", "M_surface"),
    )
    law = _numbers(_table(own, "law", where), _LAW, f"{where}.law")
    stick = _numbers(_table(own, "stick", where), _STICK, f"{where}.stick")
    computer = _numbers(
        _table(document, "computer", path.name), _COMPUTER, f"{path.name}, computer"
    )
    shaping = _numbers(_table(document, "stick", path.name), _SHAPING, f"{path.name}, stick")
    surfaces = _table(document, "surfaces", path.name)
    sensors = _table(document, "sensors", path.name)
    canard, flaperon, strake = (
        _actuator(surface, _table(surfaces, surface, path.name), path.name)
        for surface in SURFACE_NAMES
    )
    gyro, accelerometer = (
        Sensor(
            **_numbers(
                _table(sensors, sensor, path.name), _SENSOR, f"{path.name}, sensors.{sensor}"
            )
        )
        for sensor in ("gyro", "accelerometer")
    )
    return X29(
        name=name,
        airframe=ShortPeriodAirframe(title=title, **numbers),
        surfaces=(canard, flaperon, strake),
        gyro=gyro,
        accelerometer=accelerometer,
        law=ControlLaw(
            **{
                **law,
                "frame_rate": computer["frame_rate"],
                "delay_frames": _whole(computer["delay_frames"], 1, f"{path.name}, computer"),
            }
        ),
        stick=StickShaping(
            **{
                **shaping,
                **stick,
                "delay_frames": _whole(stick["delay_frames"], 0, f"{where}.stick"),
            }
        ),
        telemetry=Telemetry(
            **_numbers(
                _table(document, "telemetry", path.name), _TELEMETRY, f"{path.name}, telemetry"
            )
        ),
    )


def _document(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DeclarationError(
            "cannot be read", where=str(path), remedy="give the path of an existing file"
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DeclarationError(
            f"is not TOML ({error})", where=str(path), remedy="mend that place"
        ) from error


def _table(parent: Mapping[str, Any], key: str, where: str) -> dict[str, Any]:
    table = parent.get(key)
    if not isinstance(table, dict):
        raise DeclarationError(f"the table {key} is missing", where=where, remedy=f"add [{key}]")
    return table


def _actuator(name: str, table: Mapping[str, Any], file: str) -> Actuator:
    has_servo = any(key in table for key in _SERVO)
    where = f"{file}, surfaces.{name}"
    actuator = Actuator(
        name=name, **_numbers(table, {**_ACTUATOR, **(_SERVO if has_servo else {})}, where)
    )
    if not actuator.lower < actuator.trim < actuator.upper:
        raise DeclarationError(
            f"trim {actuator.trim:g} deg is not within its travel",
            where=where,
            remedy="give lower < trim < upper",
        )
    if not (actuator.rate > 0 and actuator.ram > 0):
        raise DeclarationError(
            "rate or ram is not positive", where=where, remedy="give positive ones"
        )
    return actuator


def _numbers(
    table: Mapping[str, Any],
    units: Mapping[str, tuple[str, float]],
    where: str,
    vectors: tuple[str, ...] = (),
) -> dict[str, Any]:
    for key in table:
        if key not in units:
            raise DeclarationError(
                f"unknown key {key}", where=where, remedy=f"use {', '.join(units)}"
            )
    return {
        key: _number(table, key, unit, factor, where, key in vectors)
        for key, (unit, factor) in units.items()
    }


def _number(
    table: Mapping[str, Any], key: str, unit: str, factor: float, where: str, vector: bool
) -> Any:
    entry = table.get(key)
    where = f"{where}.{key}"
    if not isinstance(entry, dict) or "value" not in entry:
        raise DeclarationError(
            "is missing",
            where=where,
            remedy=f'write {{value = ..., unit = "{unit}", origin = "own"}}',
        )
    if entry.get("unit") != unit:
        raise DeclarationError(
            f"unit {entry.get('unit')!r}", where=where, remedy=f"give the value in {unit}"
        )
    _origin(entry, where)
    value = entry["value"]
    values = (
        value
        if vector and isinstance(value, list) and len(value) == len(SURFACE_NAMES)
        else [value]
    )
    if (vector and len(values) != len(SURFACE_NAMES)) or not all(_finite(item) for item in values):
        raise DeclarationError(
            f"value {value!r}",
            where=where,
            remedy="give three numbers" if vector else "give one finite number",
        )
    return tuple(factor * float(item) for item in values) if vector else factor * float(value)


def _finite(item: object) -> bool:
    return isinstance(item, int | float) and not isinstance(item, bool) and math.isfinite(item)


def _origin(entry: Mapping[str, Any], where: str) -> str:
    mark = entry.get("origin")
    if mark not in _ORIGINS:
        raise DeclarationError(
            f"origin {mark!r}", where=where, remedy=f"use one of {', '.join(_ORIGINS)}"
        )
    return _ORIGINS[mark]


def _whole(value: float, least: int, where: str) -> int:
    if value != int(value) or value < least:
        raise DeclarationError(
            f"delay_frames {value:g}",
            where=where,
            remedy=f"give a whole number of frames, {least} or more",
        )
    return int(value)
