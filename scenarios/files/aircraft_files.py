"""Reading and writing of vehicle files of the model ``aircraft``: airframe, surfaces, sensors, and
the terms of each coefficient.

A library vehicle is also converted to a vehicle file here, so that a user may give its name instead
of a path.
"""

from __future__ import annotations

import difflib
import hashlib
import json
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
    """Return the schema of a vehicle file: its keys and units, without its tables of terms."""
    from scenarios.files.schemas import number_of, table_of

    texts: Any = list[str]
    coordinates = {axis: (number_of("m"), 0.0) for axis in "xyz"}
    place: Any = table_of("Place", **coordinates)
    sensor: Any = table_of("Mounted", **coordinates, estimated=(texts, []))
    sensors: Any = table_of("Sensors", **{name: (sensor | None, None) for name in SENSORS})
    thrust: Any = table_of(
        "Thrust",
        input=(str, "thrust"),
        arm=(number_of("m"), 0.0),
        angle=(number_of("rad"), 0.0),
        maximum=(number_of("N", gt=0.0) | None, None),
        throttle=(list[float] | None, None),
        force=(list[float] | None, None),
    )
    file_constants = {
        name: CONSTANTS[name] for name in CONSTANTS if not name.startswith(("cg_", "thrust"))
    }
    positive = {*file_constants} - {"cross_inertia"}
    numbers: dict[str, Any] = {
        name: (number_of(unit, gt=0.0 if name in positive else None), DEFAULTS.get(name, ...))
        for name, unit in file_constants.items()
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
    """Read the vehicle file of an aircraft.

    Parameters
    ----------
    source : the file. Numbers are in SI units, or texts with a unit such as ``"24200 lb"``. The
        tables ``[aerodynamics.Cm]`` and so on have the terms of the coefficients, per radian:
        ``"alpha*elevator" = -0.3``.

    Returns
    -------
    The aircraft at its starting values, and the constraints on its parameters.

    Raises
    ------
    DeclarationError : if the file has an error. The message has file, key and remedy in one line.
    """
    path, content = source.path, of_terms(toml_of(source), source.path)
    content.pop("model", None)
    content.pop("uncertainty", None)  # `vehicles.py` reads it, for every kind of vehicle file
    coefficients = _aerodynamics(content.pop("aerodynamics", {}), path)
    constraint_tables = {key: content.pop(key) for key in CONSTRAINTS if key in content}
    vehicle = checked(aircraft_schema(), content, path).model_dump(exclude_none=True)
    _refuse_names(vehicle, path)
    without_terms = _aircraft_of(vehicle, {}, path.stem)
    terms = {
        axis: {
            parse_term(text, without_terms.signals, f"{path}, key aerodynamics.{axis}"): value
            for text, value in table.items()
        }
        for axis, table in coefficients.items()
    }
    aircraft = _aircraft_of(vehicle, terms, path.stem)
    parameters = {**aircraft.parameters, **aircraft.positions}
    units = {name: unit for name, (_, unit) in parameters.items()}
    starts = {name: value for name, (value, _) in parameters.items()}
    # A value under [fixed] or [tied] replaces that of the term.
    replaced = {
        name
        for table in ("fixed", "tied")
        if isinstance(constraint_tables.get(table), dict)
        for name, value in constraint_tables[table].items()
        if value is not True
    }
    term_starts = {name: value for name, value in starts.items() if name not in replaced}
    constrained_content = {**constraint_tables, "derivatives": term_starts}
    constraints = take_constraints(constrained_content, units, path)
    refuse_nothing_left(constraints, list(units), path)
    return aircraft.with_values(constrained_content["derivatives"]), constraints


def model_of_file(source: Source) -> tuple[str, Model, Constraints]:
    """Return name, model and constraints of an aircraft from its file, as ``read_aircraft``."""
    aircraft, constraints = read_aircraft(source)
    return aircraft.name, aircraft_model(aircraft), constraints


def read_model_file(path: str | Path, built_in: tuple[str, ...] = ()) -> OwnModel:
    """Return the model of a Python file, or of the vehicle file of an aircraft, constraints
    included. It raises as ``read_user_model`` and ``read_aircraft``.
    """
    if not str(path).endswith(AIRCRAFT_SUFFIX):
        return read_user_model(path, built_in)
    source = read_toml_source(path)
    _, model, constraints = model_of_file(source)
    return OwnModel(constrained(model, constraints), source.identity)


def example() -> Model:
    """Return the generic airliner of the catalogue, which is the example of its model in lists."""
    resource = files("scenarios").joinpath("catalog", "aircraft", "airliner.toml")
    with as_file(resource) as path:
        return read_model_file(path).model


def _aerodynamics(table: object, path: Path) -> dict[str, dict[str, float]]:
    """Return coefficient -> text of a term -> value, per radian."""
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
    """Raise DeclarationError for a name that the file or the model does not define."""
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
    thrust_input = _thrust(vehicle["thrust"], str(path)).signal if "thrust" in vehicle else ""
    inputs = [*surfaces, *([thrust_input] if thrust_input else [])]
    for name in vehicle["trim"]:
        if name not in inputs:
            where = f"{path}, key trim"
            remedy = closest(name, inputs)
            raise DeclarationError(f"{name} is no input", where=where, remedy=remedy)
    refuse_wind(_wind(vehicle["wind"]), vehicle["states"], f"{path}, key wind")
    key = "recorded" if vehicle["attitude"] in ATTITUDES else "attitude"
    wind, attitude = _wind(vehicle["wind"]), vehicle["attitude"]
    refuse_recorded(vehicle["recorded"], wind, f"{path}, key {key}", attitude)


def _refuse_places(vehicle: Mapping[str, Any], path: Path) -> None:
    """Raise DeclarationError for a place of a sensor that cannot be estimated: its coordinate is
    none of x, y and z, or its channel is an input, so that no output depends on the place.
    """
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
    """Return the axes of the wind, those of the Earth for ``true``; empty without wind."""
    if isinstance(value, str):
        return value
    return "earth" if value else ""


def _aircraft_of(vehicle: Mapping[str, Any], terms: Mapping[str, Any], stem: str) -> Aircraft:
    """Return the aircraft of a checked file.

    Parameters
    ----------
    vehicle : content of the file, with the keys of ``aircraft_schema``.
    terms : coefficient -> term -> value.
    stem : name of the file without suffix; the name of an aircraft whose file states none.
    """
    thrust = vehicle.get("thrust", {"input": "none", "arm": 0.0, "angle": 0.0})
    cg = vehicle.get("center_of_gravity", {})
    constants = {name: vehicle[name] for name in CONSTANTS if name in vehicle}
    constants |= {f"cg_{axis}": cg.get(axis, 0.0) for axis in "xyz"}
    constants |= {"thrust_arm": thrust["arm"], "thrust_angle": thrust["angle"]}
    sensors: dict[str, Point] = {
        name: (place["x"], place["y"], place["z"])
        for name, place in vehicle.get("sensors", {}).items()
    }
    start = {
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
        start,
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
    where = f"{stem}, key thrust"
    thrust_input = table["input"]
    if thrust_input == "none":
        return Thrust("")
    if thrust_input == "thrust":
        return Thrust()
    if thrust_input != "throttle":
        remedy = 'write input = "thrust", "throttle" or "none"'
        raise DeclarationError(f"{thrust_input!r} is no input", where=where, remedy=remedy)
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


def vehicle_file_text(aircraft: Aircraft, sigmas: Mapping[str, float] | None = None) -> str:
    """Return the text of a vehicle file of an aircraft, with standard deviations as comments.

    ``read_aircraft`` reads the same numbers from it. ``sigmas`` has parameter -> standard
    deviation, in the unit of the parameter, for parameters with a known one.
    """
    import tomlkit
    from tomlkit.items import KeyType, SingleKey

    c, start = aircraft.constants, aircraft.start
    keys = {
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
    inputs = (*aircraft.surfaces, aircraft.thrust.signal)
    thrust: dict[str, Any] = {"input": aircraft.thrust.signal or "none"}
    thrust |= {"arm": c["thrust_arm"], "angle": c["thrust_angle"]}
    if aircraft.thrust.signal == "throttle":
        shares, forces = aircraft.thrust.table
        thrust |= {"throttle": list(shares), "force": list(forces)}
    tables: dict[str, Any] = {
        "trim": {name: float(start[name]) for name in inputs if name in start},
        "surfaces": aircraft.surfaces,
        "mixes": {name: _floats(parts) for name, parts in aircraft.mixes.items()},
        "thrust": thrust,
        "center_of_gravity": {axis: c[f"cg_{axis}"] for axis in "xyz"},
        "sensors": {
            name: _place_table(name, place, aircraft.estimated)
            for name, place in aircraft.with_values({}).sensors.items()
        },
    }
    document = tomlkit.document()
    for key, value in {**keys, **{key: table for key, table in tables.items() if table}}.items():
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


def _floats(table: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in table.items()}


def _place_table(name: str, place: Point, estimated: Collection[str]) -> dict[str, Any]:
    """Return the table of the place of a sensor. ``estimated`` are the estimated coordinates of all
    sensors, such as ``nz_x``.
    """
    table: dict[str, Any] = _floats(dict(zip("xyz", place, strict=True)))
    estimated_axes = [axis for axis in "xyz" if f"{name}_{axis}" in estimated]
    if estimated_axes:
        table["estimated"] = estimated_axes
    return table


_LONGEST_NAME = 60  # letters of a library name; a longer text is a path
# constants of an elastic mode: name in the library -> key in a vehicle file
_MODE_KEYS = {"omega": "frequency", "zeta": "damping", "generalized_mass": "generalized_mass"}

# ---- A name or a file


def is_library_name(given: str | Path | Any) -> bool:
    """Return whether a text can only be a library name: a plain word, and no existing file."""
    text = str(given)
    return text.isidentifier() and len(text) <= _LONGEST_NAME and not os.path.lexists(text)


def vehicle_source(given: str | Path | Source, model: str = "") -> Source:
    """Return the source of a vehicle file, or of a library vehicle in the form of a vehicle file.

    Parameters
    ----------
    given : path of a vehicle file, a name that ``flightid vehicles`` lists, or an open file.
    model : name of the model; for ``rigid`` the elastic modes of a library vehicle are left out.

    Raises
    ------
    DeclarationError : if there is no such file or vehicle.
    """
    if isinstance(given, Source):
        return given
    if not is_library_name(given):
        return read_toml_source(given)
    name = str(given)
    return source_of_content(name, content_of_library(name), model)


def source_of_content(name: str, content: Mapping[str, Any], model: str) -> Source:
    """Return the vehicle file with this content, without elastic modes if the model is rigid."""
    used = {key: value for key, value in content.items() if key != "modes" or model != "rigid"}
    raw = toml_text(used).encode()
    return Source(Path(name), raw, InputFile(name, hashlib.sha256(raw).hexdigest()))


def content_of_library(name: str) -> dict[str, Any]:
    """Return the content of a vehicle file for a library vehicle. Raises DeclarationError."""
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
    """Return the values of a library vehicle in SI units, with the keys of a vehicle file."""
    _, constants, derivatives = FAMILIES[data.equations]
    values = {number.name: number.value for number in data.numbers}
    content: dict[str, Any] = {
        "name": data.name,
        **({"aircraft_class": data.aircraft_class} if data.aircraft_class else {}),
        **{key: values[key] for key in constants if key in values},
    }
    if (
        "reference_airspeed" in constants
        and "reference_airspeed" not in content
        and "airspeed" in values
    ):
        content["reference_airspeed"] = values["airspeed"]
    content["derivatives"] = {key: values[key] for key in derivatives if key in values}
    if data.modes:
        content["modes"] = [
            _mode(values, number, data.modes) for number in range(1, data.modes + 1)
        ]
    return content


def _mode(values: Mapping[str, float], number: int, modes: int) -> dict[str, float]:
    """Return the ``[[modes]]`` table of one elastic mode."""
    constants = {
        f"{local}{number}": key for local, key in _MODE_KEYS.items() if local in MODE_CONSTANTS
    }
    names = [name for name, _, _ in mode_units(modes)]
    # The derivatives of forces and of Cm by the mode precede the others.
    first = (f"CL_eta{number}", f"CL_etadot{number}", f"Cm_eta{number}")
    last = (f"Cm_etadot{number}", f"Ceta{number}_")
    derivatives = [
        name for prefixes in (first, last) for name in names if name.startswith(prefixes)
    ]
    return {
        **{key: values[name] for name, key in constants.items()},
        **{name: values[name] for name in derivatives if name in values},
    }


# ---- TOML


def toml_text(content: Mapping[str, Any]) -> str:
    """Return the text of a vehicle file: plain keys first, then tables and lists of tables.

    Raises
    ------
    DeclarationError : for a value that TOML does not have.
    """
    plain_lines = [
        f"{toml_key(key)} = {toml_value(value, key)}"
        for key, value in content.items()
        if not _is_table(value)
    ]
    blocks = ["\n".join(plain_lines)]
    for key, value in content.items():
        if isinstance(value, Mapping):
            entries = [
                f"{toml_key(name)} = {toml_value(entry, f'{key}.{name}')}"
                for name, entry in value.items()
            ]
            blocks.append("\n".join([f"[{toml_key(key)}]", *entries]))
        elif _is_table(value):
            for table in value:
                entries = [
                    f"{toml_key(name)} = {toml_value(entry, name)}" for name, entry in table.items()
                ]
                blocks.append("\n".join([f"[[{toml_key(key)}]]", *entries]))
    return "\n\n".join(block for block in blocks if block) + "\n"


def _is_table(value: Any) -> bool:
    """Return whether TOML writes a value as a table or as a list of tables."""
    return isinstance(value, Mapping) or (
        isinstance(value, list | tuple)
        and bool(value)
        and all(isinstance(item, Mapping) for item in value)
    )


def toml_key(key: Any) -> str:
    """Return a key in TOML, in quotes if it needs them."""
    text = str(key)
    is_bare = text.isascii() and text.replace("_", "").replace("-", "").isalnum()
    return text if is_bare else toml_string(text)


def toml_value(value: Any, key: Any) -> str:
    """Return a value in TOML; ``key`` is its key, for messages."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return toml_string(value)
    if isinstance(value, Mapping):
        entries = [f"{toml_key(name)} = {toml_value(entry, name)}" for name, entry in value.items()]
        return "{" + ", ".join(entries) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(element, key) for element in value) + "]"
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
    return repr(number)  # Python and TOML have the same form of numbers, also of inf and nan


def toml_string(text: str) -> str:
    """Return a text as a basic string of TOML, which is a string of JSON with DEL escaped too."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
