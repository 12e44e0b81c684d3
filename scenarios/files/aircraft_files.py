"""Vehicle files of the model ``aircraft``: airframe, surfaces, sensors, and the terms of each
coefficient; read and written.

Library vehicles as vehicle files, so that a name can replace a file.
"""

from __future__ import annotations

import difflib
import hashlib
import json
import math
import os
from collections.abc import Collection, Mapping
from functools import cache
from importlib.resources import as_file, files
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.files.declarations import checked, closest, of_terms, read_toml_source, toml_of
from scenarios.files.sources import InputFile, Source
from scenarios.files.user_models import (
    AIRCRAFT_SUFFIX,
    Constraints,
    OwnModel,
    constrained,
    read_user_model,
    refuse_nothing_left,
    take_constraints,
)
from scenarios.files.user_models import TABLES as CONSTRAINTS
from sim.aerodynamics import parse_term
from sim.errors import DeclarationError
from sim.vehicles.aircraft import (
    BIASED,
    BODY_AXES,
    CONSTANTS,
    DEFAULTS,
    FURTHER,
    MOMENTS,
    NAME,
    OUTPUTS,
    SENSORS,
    STATES,
    VARYING,
    WIND_AXES,
    Aircraft,
    Point,
    Thrust,
    aircraft_model,
    refuse_recorded,
    refuse_wind,
)
from sim.vehicles.attitude import ATTITUDES, EULER
from sim.vehicles.factory import FAMILIES, MODE_CONSTANTS, mode_units
from sim.vehicles.library import VehicleData, read_parameter_set, vehicle_names

if TYPE_CHECKING:
    from pydantic import BaseModel

    from sim.declaration.model import Model

AXES = tuple(dict.fromkeys((*BODY_AXES, *WIND_AXES, *MOMENTS)))
SURFACE_UNITS = ("rad", "1")
START = {"airspeed": "m/s", "trim_alpha": "rad", "trim_theta": "rad"}


@cache
def aircraft_schema() -> type[BaseModel]:
    """Return the keys of a file with their units, without its tables of terms."""
    from scenarios.files.schemas import number_of, table_of

    texts: Any = list[str]
    place: Any = table_of("Place", **{axis: (number_of("m"), 0.0) for axis in "xyz"})
    mounted: Any = table_of(
        "Mounted", **{axis: (number_of("m"), 0.0) for axis in "xyz"}, estimated=(texts, [])
    )
    sensors: Any = table_of("Sensors", **{name: (mounted | None, None) for name in SENSORS})
    thrust: Any = table_of(
        "Thrust",
        input=(str, "thrust"),
        arm=(number_of("m"), 0.0),
        angle=(number_of("rad"), 0.0),
        maximum=(number_of("N", gt=0.0) | None, None),
        throttle=(list[float] | None, None),
        force=(list[float] | None, None),
    )
    inside = {name: CONSTANTS[name] for name in CONSTANTS if not name.startswith(("cg_", "thrust"))}
    positive = {*inside} - {"cross_inertia"}
    numbers: dict[str, Any] = {
        name: (number_of(unit, gt=0.0 if name in positive else None), DEFAULTS.get(name, ...))
        for name, unit in inside.items()
    }
    return table_of(
        "AircraftVehicle",
        name=(str | None, None),
        **numbers,
        airspeed=(number_of("m/s", gt=0.0), ...),
        trim_alpha=(number_of("rad"), 0.0),
        trim_theta=(number_of("rad"), 0.0),
        surfaces=(dict[str, str], ...),
        mixes=(dict[str, dict[str, float]], {}),
        center_of_gravity=(place | None, None),
        sensors=(sensors | None, None),
        thrust=(thrust | None, None),
        wind=(bool | str, False),
        trim=(dict[str, float], {}),
        columns=(texts, []),
        states=(texts, []),
        recorded=(texts, []),
        attitude=(str, EULER),
        biases=(texts, list(BIASED)),
    )


def read_aircraft(source: Source) -> tuple[Aircraft, Constraints]:
    """Read an aircraft's file: declaration and constraints.

    Parameters
    ----------
    source : the file. Numbers are SI, or texts with a unit, ``"24200 lb"``. Coefficients of terms
        stand under ``[aerodynamics.Cm]`` and so on as ``"alpha*elevator" = -0.3``, per radian.

    Raises
    ------
    DeclarationError : one line with file, key and remedy.
    """
    path, content = source.path, of_terms(toml_of(source), source.path)
    content.pop("model", None)
    content.pop("uncertainty", None)  # read with all other vehicle files
    coefficients = _aerodynamics(content.pop("aerodynamics", {}), path)
    laid_down = {key: content.pop(key) for key in CONSTRAINTS if key in content}
    vehicle = checked(aircraft_schema(), content, path).model_dump(exclude_none=True)
    _refuse_names(vehicle, path)
    signals_of = _declared(vehicle, {}, path.stem)
    terms = {
        axis: {
            parse_term(text, signals_of.signals, f"{path}, key aerodynamics.{axis}"): value
            for text, value in table.items()
        }
        for axis, table in coefficients.items()
    }
    aircraft = _declared(vehicle, terms, path.stem)
    parameters = {**aircraft.parameters, **aircraft.positions}
    units = {name: unit for name, (_, unit) in parameters.items()}
    starts = {name: value for name, (value, _) in parameters.items()}
    # The value of a constraint replaces that of the term.
    given = {
        name
        for table in ("fixed", "tied")
        if isinstance(laid_down.get(table), dict)
        for name, value in laid_down[table].items()
        if value is not True
    }
    free_starts = {name: value for name, value in starts.items() if name not in given}
    with_starts = {**laid_down, "derivatives": free_starts}
    constraints = take_constraints(with_starts, units, path)
    refuse_nothing_left(constraints, list(units), path)
    return aircraft.with_values(with_starts["derivatives"]), constraints


def model_of_file(source: Source) -> tuple[str, Model, Constraints]:
    """Name, model and constraints of an aircraft's file; raises as ``read_aircraft``."""
    aircraft, constraints = read_aircraft(source)
    return aircraft.name, aircraft_model(aircraft), constraints


def read_model_file(path: str | Path, built_in: tuple[str, ...] = ()) -> OwnModel:
    """The model that a file declares: a user's Python file, or a vehicle file of an aircraft.

    Raises DeclarationError as ``read_user_model`` and ``read_aircraft``.
    """
    if not str(path).endswith(AIRCRAFT_SUFFIX):
        return read_user_model(path, built_in)
    source = read_toml_source(path)
    _, model, laid_down = model_of_file(source)
    return OwnModel(constrained(model, laid_down), source.identity)


def example() -> Model:
    """Return the model of the generic airliner that the catalogue has, for lists of models."""
    place = files("scenarios").joinpath("catalog", "aircraft", "airliner.toml")
    with as_file(place) as path:
        return read_model_file(path).model


def _aerodynamics(table: object, path: Path) -> dict[str, dict[str, float]]:
    """Texts of terms and their values, by coefficient."""
    from scenarios.files.schemas import number_in

    where = f"{path}, key aerodynamics"
    if not isinstance(table, dict) or not table:
        remedy = 'write [aerodynamics.Cm] with "1" = 0.05, "alpha" = -0.9 and so on'
        raise DeclarationError("there are no terms", where=where, remedy=remedy)
    result = {}
    for axis, terms in table.items():
        if axis not in AXES:
            raise DeclarationError(
                f"there is no coefficient {axis}", where=where, remedy=closest(axis, AXES)
            )
        if not isinstance(terms, dict):
            remedy = f'write [aerodynamics.{axis}] and lines such as "alpha" = 0.1'
            raise DeclarationError("this is no table", where=f"{where}.{axis}", remedy=remedy)
        result[axis] = {
            text: number_in(value, "1", f"{where}.{axis}.{text}") for text, value in terms.items()
        }
    return result


def _refuse_names(vehicle: Mapping[str, Any], path: Path) -> None:
    """Raise DeclarationError for an undefined name."""
    surfaces = vehicle["surfaces"]
    for name, unit in surfaces.items():
        if unit not in SURFACE_UNITS:
            where = f"{path}, key surfaces.{name}"
            remedy = 'write "rad" for a deflection, "1" for a share'
            raise DeclarationError(f"{unit!r} is no unit of a surface", where=where, remedy=remedy)
    for name, parts in vehicle["mixes"].items():
        for part in parts:
            if part not in surfaces:
                where = f"{path}, key mixes.{name}"
                what = f"{part} is no surface"
                raise DeclarationError(what, where=where, remedy=closest(part, surfaces))
    for key, known in (
        ("columns", VARYING),
        ("states", tuple(FURTHER)),
        ("recorded", tuple(STATES)),
        ("biases", (*OUTPUTS, *FURTHER)),
    ):
        for name in vehicle[key]:
            if name not in known:
                where = f"{path}, key {key}"
                raise DeclarationError(
                    f"{name} cannot stand there", where=where, remedy=closest(name, known)
                )
    _refuse_places(vehicle, path)
    thrust = _thrust(vehicle["thrust"], str(path)).signal if "thrust" in vehicle else ""
    moved = [*surfaces, *([thrust] if thrust else [])]
    for name in vehicle["trim"]:
        if name not in moved:
            where = f"{path}, key trim"
            remedy = closest(name, moved)
            raise DeclarationError(f"{name} is no input", where=where, remedy=remedy)
    refuse_wind(_wind(vehicle["wind"]), vehicle["states"], f"{path}, key wind")
    key = "recorded" if vehicle["attitude"] in ATTITUDES else "attitude"
    wind, attitude = _wind(vehicle["wind"]), vehicle["attitude"]
    refuse_recorded(vehicle["recorded"], wind, f"{path}, key {key}", attitude)


def _refuse_places(vehicle: Mapping[str, Any], path: Path) -> None:
    """Raise DeclarationError for an estimated coordinate that is none, or that no output shows."""
    for name, place in vehicle.get("sensors", {}).items():
        where = f"{path}, key sensors.{name}.estimated"
        for axis in place["estimated"]:
            if axis not in ("x", "y", "z"):
                remedy = 'write some of "x", "y", "z"'
                raise DeclarationError(f"{axis!r} is no axis", where=where, remedy=remedy)
        if place["estimated"] and name in vehicle["recorded"]:
            raise DeclarationError(
                f"{name} is recorded, and the place of its sensor cannot be estimated",
                where=where,
                remedy=f"give the place as a number, or leave {name} out of recorded",
            )


def _wind(value: bool | str) -> str:
    """Axes of the wind that a file states; ``true`` are those of the Earth."""
    return value if isinstance(value, str) else ("earth" if value else "")


def _declared(vehicle: Mapping[str, Any], terms: Mapping[str, Any], stem: str) -> Aircraft:
    """Return the aircraft of a checked file."""
    thrust = vehicle.get("thrust", {"input": "none", "arm": 0.0, "angle": 0.0})
    cg = vehicle.get("center_of_gravity", {})
    constants = {name: vehicle[name] for name in CONSTANTS if name in vehicle}
    constants |= {f"cg_{axis}": cg.get(axis, 0.0) for axis in "xyz"}
    constants |= {"thrust_arm": thrust["arm"], "thrust_angle": thrust["angle"]}
    sensors: dict[str, Point] = {
        name: (place["x"], place["y"], place["z"])
        for name, place in vehicle.get("sensors", {}).items()
    }
    begin = {
        **vehicle["trim"],
        "airspeed": vehicle["airspeed"],
        "alpha": vehicle["trim_alpha"],
        "theta": vehicle["trim_theta"],
    }
    return Aircraft(
        vehicle.get("name") or stem,
        constants,
        vehicle["surfaces"],
        terms,
        vehicle["mixes"],
        sensors,
        _thrust(thrust, stem),
        _wind(vehicle["wind"]),
        tuple(vehicle["columns"]),
        begin,
        tuple(vehicle["biases"]),
        tuple(vehicle["states"]),
        tuple(vehicle["recorded"]),
        vehicle["attitude"],
        tuple(
            f"{name}_{axis}"
            for name, place in vehicle.get("sensors", {}).items()
            for axis in "xyz"
            if axis in place["estimated"]
        ),
    )


def _thrust(table: Mapping[str, Any], stem: str) -> Thrust:
    """Propulsion of the table ``[thrust]``, if there is one."""
    where = f"{stem}, key thrust"
    kind = table["input"]
    if kind == "none":
        return Thrust("")
    if kind == "thrust":
        return Thrust()
    if kind != "throttle":
        remedy = 'write input = "thrust", "throttle" or "none"'
        raise DeclarationError(f"{kind!r} is no input", where=where, remedy=remedy)
    shares, forces = table.get("throttle"), table.get("force")
    if shares is None and forces is None and "maximum" in table:
        shares, forces = [0.0, 1.0], [0.0, table["maximum"]]
    if not shares or not forces or len(shares) != len(forces) or len(shares) < 2:
        raise DeclarationError(
            "a throttle needs the thrust that it gives",
            where=where,
            remedy="give maximum in N, or throttle = [0, ...] and force = [0, ...] of one length",
        )
    if any(later <= earlier for earlier, later in pairwise(shares)):
        remedy = "let throttle increase"
        raise DeclarationError("the table of thrust is in disorder", where=where, remedy=remedy)
    return Thrust("throttle", (tuple(shares), tuple(forces)))


def written(aircraft: Aircraft, sigmas: Mapping[str, float] | None = None) -> str:
    """Return an aircraft as a vehicle file, with the standard deviations of values as comments.

    Parameters
    ----------
    aircraft : what to write.
    sigmas : by parameter, where they are known.

    Returns
    -------
    Text in TOML, which ``read_aircraft`` reads back to the same numbers.
    """
    import tomlkit
    from tomlkit.items import KeyType, SingleKey

    c, start = aircraft.constants, aircraft.start
    plain = {
        "model": NAME,
        "name": aircraft.name,
        **{name: c[name] for name in CONSTANTS if not name.startswith(("cg_", "thrust"))},
        "airspeed": start.get("airspeed", 1.0),
        "trim_alpha": start.get("alpha", 0.0),
        "trim_theta": start.get("theta", 0.0),
        "columns": list(aircraft.varying),
        "states": list(aircraft.further),
        **({"recorded": list(aircraft.recorded)} if aircraft.recorded else {}),
        **({"attitude": aircraft.attitude} if aircraft.attitude != EULER else {}),
        "biases": list(aircraft.biases),
        "wind": aircraft.wind or False,
    }
    moved = (*aircraft.surfaces, aircraft.thrust.signal)
    thrust: dict[str, Any] = {"input": aircraft.thrust.signal or "none"}
    thrust |= {"arm": c["thrust_arm"], "angle": c["thrust_angle"]}
    if aircraft.thrust.signal == "throttle":
        shares, forces = aircraft.thrust.table
        thrust |= {"throttle": list(shares), "force": list(forces)}
    tables: dict[str, Any] = {
        "trim": {name: float(start[name]) for name in moved if name in start},
        "surfaces": aircraft.surfaces,
        "mixes": {name: _numbers(parts) for name, parts in aircraft.mixes.items()},
        "thrust": thrust,
        "center_of_gravity": {axis: c[f"cg_{axis}"] for axis in "xyz"},
        "sensors": {
            name: _written_place(name, place, aircraft.estimated)
            for name, place in aircraft.with_values({}).sensors.items()
        },
    }
    document = tomlkit.document()
    for key, value in {**plain, **{key: table for key, table in tables.items() if table}}.items():
        document.add(key, tomlkit.item(value))
    coefficients = tomlkit.table(is_super_table=True)
    for axis, terms in aircraft.coefficients.items():
        table = tomlkit.table()
        for term, value in terms.items():
            number = tomlkit.item(float(value))
            if (sigma := (sigmas or {}).get(f"{axis}_{term.label}")) is not None:
                number.comment(f"+- {sigma:.2g}")
            table.append(SingleKey(term.text, KeyType.Basic), number)
        coefficients.append(axis, table)
    document.append("aerodynamics", coefficients)
    return tomlkit.dumps(document)


def _numbers(table: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in table.items()}


def _written_place(name: str, place: Point, estimated: Collection[str]) -> dict[str, Any]:
    free = [axis for axis in "xyz" if f"{name}_{axis}" in estimated]
    numbers: dict[str, Any] = _numbers(dict(zip("xyz", place, strict=True)))
    return {**numbers, "estimated": free} if free else numbers


LONGEST = 60  # letters of a name of the library
FILE_KEYS = {"omega": "frequency", "zeta": "damping", "generalized_mass": "generalized_mass"}

# ---- A name or a file


def is_library_name(given: str | Path | Any) -> bool:
    """Return whether a text can only be a library name: a plain word, and no existing file."""
    text = str(given)
    return text.isidentifier() and len(text) <= LONGEST and not os.path.lexists(text)


def vehicle_source(given: str | Path | Source, model: str = "") -> Source:
    """Return a vehicle file as it is, or the file of a library vehicle.

    Parameters
    ----------
    given : path of a vehicle file, a name of ``flightid vehicles``, or a file that was read.
    model : for which it is read; the rigid model takes no elastic modes of a vehicle.

    Raises
    ------
    DeclarationError
        There is no such file or vehicle.
    """
    if isinstance(given, Source):
        return given
    if not is_library_name(given):
        return read_toml_source(given)
    name = str(given)
    return source_of_content(name, content_of_library(name), model)


def source_of_content(name: str, content: Mapping[str, Any], model: str) -> Source:
    """Return a vehicle file from its content, without elastic modes if the model is rigid."""
    used = {key: value for key, value in content.items() if key != "modes" or model != "rigid"}
    raw = toml_text(used).encode()
    return Source(Path(name), raw, InputFile(name, hashlib.sha256(raw).hexdigest()))


def content_of_library(name: str) -> dict[str, Any]:
    """Return the content of the vehicle file of a library vehicle. Raises DeclarationError."""
    names = vehicle_names()
    if name not in names:
        near = difflib.get_close_matches(name, names, 3) or list(names)
        raise DeclarationError(
            f"there is no vehicle {name!r}",
            where="vehicle",
            remedy=f"name a file that ends in .toml, or one of the library: {', '.join(near)}",
        )
    return content_of(read_parameter_set(name))


def content_of(data: VehicleData) -> dict[str, Any]:
    """Return a library vehicle with the keys of a vehicle file."""
    _, constants, derivatives = FAMILIES[data.equations]
    values = {number.name: number.value for number in data.numbers}
    out: dict[str, Any] = {
        "name": data.name,
        **({"aircraft_class": data.aircraft_class} if data.aircraft_class else {}),
        **{key: values[key] for key in constants if key in values},
    }
    if (
        "reference_airspeed" in constants
        and "reference_airspeed" not in out
        and "airspeed" in values
    ):
        out["reference_airspeed"] = values["airspeed"]
    out["derivatives"] = {key: values[key] for key in derivatives if key in values}
    if data.modes:
        out["modes"] = [_mode(values, number, data.modes) for number in range(1, data.modes + 1)]
    return out


def _mode(values: Mapping[str, float], number: int, modes: int) -> dict[str, float]:
    """Return the ``[[modes]]`` table of one elastic mode."""
    constants = {
        f"{local}{number}": key for local, key in FILE_KEYS.items() if local in MODE_CONSTANTS
    }
    own = [
        name
        for name, _, _ in mode_units(modes)
        if name.startswith((f"CL_eta{number}", f"CL_etadot{number}", f"Cm_eta{number}"))
    ]
    own += [
        name
        for name, _, _ in mode_units(modes)
        if name.startswith((f"Cm_etadot{number}", f"Ceta{number}_"))
    ]
    return {
        **{key: values[name] for name, key in constants.items()},
        **{name: values[name] for name in own if name in values},
    }


# ---- TOML


def toml_text(content: Mapping[str, Any]) -> str:
    """Return the text of a vehicle file: plain keys first, then tables, then lists of tables.

    Raises DeclarationError for a value that TOML does not have.
    """
    lines = [
        f"{_key(key)} = {toml_value(value, key)}"
        for key, value in content.items()
        if not _is_table(value)
    ]
    out = ["\n".join(lines)]
    for key, value in content.items():
        if isinstance(value, Mapping):
            out.append(
                "\n".join(
                    [
                        f"[{_key(key)}]",
                        *(
                            f"{_key(name)} = {toml_value(each, f'{key}.{name}')}"
                            for name, each in value.items()
                        ),
                    ]
                )
            )
        elif _is_table(value):
            out += [
                "\n".join(
                    [
                        f"[[{_key(key)}]]",
                        *(
                            f"{_key(name)} = {toml_value(each, name)}"
                            for name, each in item.items()
                        ),
                    ]
                )
                for item in value
            ]
    return "\n\n".join(part for part in out if part) + "\n"


def _is_table(value: Any) -> bool:
    return isinstance(value, Mapping) or (
        isinstance(value, list | tuple)
        and bool(value)
        and all(isinstance(item, Mapping) for item in value)
    )


def _key(key: Any) -> str:
    text = str(key)
    return (
        text
        if text.isascii() and text.replace("_", "").replace("-", "").isalnum()
        else _quoted(text)
    )


def toml_value(value: Any, key: Any) -> str:
    """Return a value as TOML writes it; ``key`` names it in errors."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, Mapping):
        return (
            "{"
            + ", ".join(f"{_key(name)} = {toml_value(each, name)}" for name, each in value.items())
            + "}"
        )
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(each, key) for each in value) + "]"
    if isinstance(value, int):
        return str(value)
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise DeclarationError(
            f"a {type(value).__name__} is no value",
            where=f"key {key}",
            remedy="give a number or a text",
        ) from None
    return (
        repr(number)
        if math.isfinite(number)
        else {math.inf: "inf", -math.inf: "-inf"}.get(number, "nan")
    )


def _quoted(text: str) -> str:
    """Return a basic string: as JSON writes it, but for one letter that JSON does not escape."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
