"""Vehicle files: constants and starting values of one vehicle for one model, in SI units."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from scenarios.files.aircraft_files import (
    model_of_file,
    read_model_file,
    vehicle_source,
)
from scenarios.files.declarations import checked, closest, toml_of
from scenarios.files.measured.columns import RecordFile, path_of
from scenarios.files.sources import InputFile, Source
from scenarios.files.user_models import (
    NONE,
    Constraints,
    OwnModel,
    is_model_file,
    own_numbers,
    refuse_nothing_left,
    take_constraints,
    with_place,
)
from sim.declaration.model import Model
from sim.errors import DeclarationError
from sim.vehicles.aircraft import MOMENTS
from sim.vehicles.factory import ABOVE_ZERO, FAMILIES

MODELS = (
    "ballistic",
    "rigid",
    "flexible",
    "loes",
    "lateral",
    "longitudinal",
    "multirotor",
    "aircraft",
)
BESIDE = "vehicle.toml"
AIRCRAFT = "aircraft"
UNCERTAINTY = "uncertainty"
FLOWN = ("aircraft_class", "flight_phase")
# Model -> keys at the top of its file that are there, or are not, in files of no other model; a
# file without these is a rigid aircraft's.
_TOLD_BY = {
    "flexible": (("modes", True),),
    "lateral": (("span", True),),
    "longitudinal": (("reference_airspeed", True),),
    "loes": (("gravity", True), ("mass", False)),
    "multirotor": (("mass", False), ("airspeed", False), ("reference_airspeed", False)),
}
# Model -> keys that only its files have, and which other models read these files.
_WRITTEN_FOR = {
    "lateral": ("roll_inertia", "yaw_inertia"),
    "longitudinal": ("reference_airspeed",),
    "ballistic": ("density_scale_height",),
    "rigid": ("pitch_inertia", "airspeed"),
}
_READERS = {"rigid": ("rigid", "flexible")}
_SHARE = re.compile(r"\s*(\d+\.?\d*|\.\d+)\s*%\s*", re.ASCII)
_MODAL_START = re.compile(r"(?:C[Lm]_eta(?:dot)?(\d+)|Ceta(\d+)_\w+)")
RELATIVE_PRIOR = 0.5
OF_TYPICAL = 0.01  # typical size of a zero start, share of the largest one


@dataclass(frozen=True)
class VehicleFile:
    """Content of a vehicle file.

    Attributes
    ----------
    name : of the vehicle; default: of the file.
    model : the model it was read for.
    constants : fixed values in SI. rigid and flexible: ``mass``, ``wing_area``, ``chord``,
        ``pitch_inertia``, ``airspeed``, ``air_density``; loes: ``airspeed``, ``gravity`` and, if
        given, ``vane_arm`` (m, ahead of the c.g.); ballistic: ``air_density_reference``,
        ``density_scale_height``, ``gravity``; lateral and longitudinal: ``LATERAL_CONSTANTS`` and
        ``LONGITUDINAL_CONSTANTS`` of the equations.
    derivatives : starting values in SI, per radian (loes: per unit of the stick); of lateral and
        longitudinal those that are given.
    modes : for flexible, (number from 1, values) with ``frequency`` rad/s, ``damping``,
        ``generalized_mass`` kg m2 and the starts ``CL_eta1 CL_etadot1 Cm_eta1 Cm_etadot1
        Ceta1_alpha Ceta1_q Ceta1_de Ceta1_eta1 Ceta1_etadot1`` of that mode, and the couplings
        ``Ceta1_eta2 ...`` that the file gives.
    identity : name and hash of the file, or None.
    aircraft_class, flight_phase : class I to IV, category A to C of MIL-F-8785C, or None.
    own, own_file : a user's model with these numbers, and its file; None for ``MODELS``.
    constraints : parameters that are fixed, bounded or tied; their starts are in ``derivatives``.
    text : content of the file, or empty.
    uncertainty : standard deviations of constants (table ``[uncertainty]``); others are exact.
    """

    name: str
    model: str
    constants: Mapping[str, float]
    derivatives: Mapping[str, float]
    modes: tuple[tuple[int, dict[str, float]], ...] = field(default=())
    identity: InputFile | None = field(default=None, compare=False)
    own: Model | None = field(default=None, compare=False)
    own_file: InputFile | None = field(default=None, compare=False)
    aircraft_class: str | None = None
    flight_phase: str | None = None
    constraints: Constraints = NONE
    text: str = field(default="", compare=False)
    uncertainty: Mapping[str, float] = field(default_factory=dict)


def vehicle_with_file(name: str, file: InputFile | None) -> str:
    """Return a vehicle's name and its file, if it has one, for outputs.

    Examples
    --------
    >>> vehicle_with_file("bomber_rigid", InputFile("flight_vehicle.toml", "0" * 64))
    'bomber_rigid (flight_vehicle.toml)'
    >>> vehicle_with_file("x29", None)
    'x29'
    """
    return name if file is None else f"{name} ({file.name})"


def vehicle_next_to(record: Path | RecordFile) -> Path | None:
    """``vehicle.toml`` in a record's folder, None if there is none."""
    path = path_of(record)
    beside = path.parent / BESIDE if path is not None else None
    return beside if beside is not None and beside.is_file() else None


ALSO_READ = "also read, because found beside the records"


def files_read_unnamed(records: Sequence[RecordFile], vehicle: Path | None) -> tuple[str, ...]:
    """Return a sentence that names the files that were read without being named: a vehicle file and
    the JSON files of records; empty without one.

    ``vehicle``: the file that ``vehicle_next_to`` found, None if the vehicle file was named.
    """
    names = [str(vehicle)] if vehicle is not None else []
    names += [
        str(record.path.with_name(record.sidecar.file))
        for record in records
        if record.sidecar.file and not record.in_memory
    ]
    return (f"{ALSO_READ}: {', '.join(dict.fromkeys(names))}",) if names else ()


def refuse_unknown_model(model: str | OwnModel, where: str) -> None:
    """Raise DeclarationError for an unknown model name."""
    if model not in MODELS and not is_model_file(model):
        raise DeclarationError(
            f"there is no model {model!r}",
            where=where,
            remedy=near
            if (near := closest(str(model), MODELS)).startswith("did you mean")
            else f"{near}, or a Python file of your own",
        )


def read_vehicle(path: str | Path | Source | None, model: str | OwnModel) -> VehicleFile:
    """Read a vehicle file for one of ``MODELS``, or for a user's model, for which it may be None.

    Raises DeclarationError, also if there is no such file.
    """
    refuse_unknown_model(model, str(path.path if isinstance(path, Source) else path))
    if isinstance(model, OwnModel) or is_model_file(model):
        own = model if isinstance(model, OwnModel) else read_model_file(model, MODELS)
        return own_vehicle(own, None if path is None else vehicle_source(path))
    if path is None:
        what = f"the {model} model needs constants and starting values"
        raise DeclarationError(
            what,
            where="--vehicle",
            remedy=f"name a vehicle file or one of the library, or put {BESIDE} beside the record",
        )
    return vehicle_of(vehicle_source(path, model), model)


def own_vehicle(own: OwnModel, source: Source | None) -> VehicleFile:
    """Return a user's own model with the numbers of a vehicle file, or with its own if there is
    none.
    """
    if source is not None and "aerodynamics" in toml_of(source):
        return aircraft_vehicle(source)
    name, model, laid_down = (
        own_numbers(own, source) if source is not None else (own.model.name, own.model, NONE)
    )
    constants, starts = (
        {item.name: item.value for item in model.parameters if item.free is free}
        for free in (False, True)
    )
    identity = own.identity if source is None else source.identity
    text = source.content.decode("utf-8-sig") if source is not None else ""
    vehicle = VehicleFile(
        name,
        model.name,
        constants,
        starts,
        (),
        identity,
        model,
        own.identity,
        constraints=laid_down,
        text=text,
    )
    return vehicle if source is None else _with_uncertainty(vehicle, source)


def with_plain_terms(source: Source) -> Source:
    """A vehicle file without terms, with a constant for each coefficient."""
    content = toml_of(source)
    table = content.get("aerodynamics", {})
    if not isinstance(table, dict):
        return source
    wind = {"CD", "CL"} & set(table)
    axes = ("CD", "CY", "CL", *MOMENTS) if wind else ("CX", "CY", "CZ", *MOMENTS)
    further = "".join(f'\n[aerodynamics.{a}]\n"1" = 0.0\n' for a in axes if a not in table)
    return replace(source, content=source.content + further.encode()) if further else source


def aircraft_vehicle(source: Source) -> VehicleFile:
    """Return a file of the model ``aircraft``. Raises DeclarationError as ``vehicle_of``."""
    name, model, laid_down = model_of_file(source)
    constants, starts = (
        {item.name: item.value for item in model.parameters if item.free is free}
        for free in (False, True)
    )
    vehicle = VehicleFile(
        name,
        model.name,
        constants,
        starts,
        (),
        source.identity,
        model,
        source.identity,
        constraints=laid_down,
        text=source.content.decode("utf-8-sig"),
    )
    return _with_uncertainty(vehicle, source)


def _with_uncertainty(vehicle: VehicleFile, source: Source) -> VehicleFile:
    """Return the vehicle with the standard deviations of its constants that its file states.

    Raises DeclarationError, in one line: an unknown constant, another unit, a number that is not
    positive, or a standard deviation beyond half of a constant that must be positive.
    """
    from scenarios.files.schemas import number_in

    table = toml_of(source).get(UNCERTAINTY, {})
    where = f"{source.path}, key {UNCERTAINTY}"
    if not isinstance(table, dict):
        remedy = 'write [uncertainty] and lines such as mass = "1 %"'
        raise DeclarationError("this is no table", where=where, remedy=remedy)
    known = (
        {item.name: item.unit for item in vehicle.own.parameters if not item.free}
        if vehicle.own is not None
        else FAMILIES["rigid" if vehicle.model == "flexible" else vehicle.model][1]
    )
    units = {name: known[name] for name in vehicle.constants if name in known}
    sigmas = {}
    for name, given in table.items():
        place = f"{where}.{name}"
        if name not in units:
            remedy = closest(name, units)
            raise DeclarationError(f"there is no constant {name}", where=place, remedy=remedy)
        value = abs(vehicle.constants[name])
        share = _SHARE.fullmatch(given) if isinstance(given, str) else None
        sigma = 0.01 * float(share[1]) * value if share else number_in(given, units[name], place)
        if not sigma > 0.0 or not math.isfinite(sigma):
            remedy = "give a positive number, or leave the line out where the constant is known"
            what = f"{given!r} is no standard deviation"
            raise DeclarationError(what, where=place, remedy=remedy)
        if name in ABOVE_ZERO and sigma > 0.5 * value:
            raise DeclarationError(
                f"{sigma:g} {units[name]} is more than half of {name}, {value:g}",
                where=place,
                remedy="give one standard deviation, in the constant's own unit or in %",
            )
        sigmas[name] = sigma
    return replace(vehicle, uncertainty=sigmas)


def read_any_vehicle(path: str | Path | Source) -> VehicleFile:
    """Read a vehicle file of any model of an aircraft.

    The model is empty if the file only serves a kinematic check. Raises DeclarationError.
    """
    from scenarios.files.schemas import CHECK_ONLY

    source = vehicle_source(path)
    content = toml_of(source)
    if "aerodynamics" in content or content.get("model") == AIRCRAFT:
        return aircraft_vehicle(with_plain_terms(source))
    if "density_scale_height" in content or "air_density_reference" in content:
        raise DeclarationError(
            "this is a falling body's file, without an airspeed",
            where=str(source.path),
            remedy="give the file of an aircraft",
        )
    if "airspeed" in content and content.keys() <= CHECK_ONLY.model_fields.keys():
        known = checked(CHECK_ONLY, content, source.path).model_dump(exclude_none=True)
        name = known.pop("name", source.path.stem)
        return VehicleFile(name, "", known, {}, identity=source.identity)
    return vehicle_of(
        source,
        next(
            (
                model
                for model, keys in _TOLD_BY.items()
                if all((key in content) is there for key, there in keys)
            ),
            "rigid",
        ),
    )


def vehicle_of(source: Source, model: str) -> VehicleFile:
    """Return the vehicle of a file that was read, for one of ``MODELS``.

    A value is a number in SI units or a text with a unit, ``"24200 lb"``. Starts of an elastic mode
    are in its ``[[modes]]`` table or under ``[derivatives]``.

    Raises
    ------
    DeclarationError : one line with file, key and remedy: not TOML, an unknown or missing key, a
        value of the wrong kind, unit or sign.
    """
    if model == AIRCRAFT:
        return aircraft_vehicle(source)
    from scenarios.files.schemas import SCHEMAS, mode_schema, refuse_unusable, units_of_starts

    path, content = source.path, toml_of(source)
    _refuse_other_model(content, model, path)
    content.pop(UNCERTAINTY, None)  # read last, when constants are known
    units = units_of_starts(model, content.get("modes"))
    laid_down = take_constraints(content, units, path)
    tables: list[dict[str, Any]] = []
    if model == "flexible":
        tables = _mode_tables(content, path)
        content = {**content, "modes": tables}
    try:
        vehicle = checked(SCHEMAS[model], content, path).model_dump(exclude_none=True)
    except DeclarationError as error:
        raise with_place(error, laid_down, path) from None
    modes = []
    for number, table in enumerate(tables, start=1):
        values = checked(
            mode_schema(number, len(tables)), table, path, f"modes[{number}]"
        ).model_dump(exclude_none=True)
        modes.append((number, values))
    constants = {
        key: value
        for key, value in vehicle.items()
        if key not in ("name", "derivatives", "modes", *FLOWN)
    }
    refuse_unusable(model, constants, vehicle["derivatives"], path)
    starts = {
        **vehicle["derivatives"],
        **{key: value for _, mode in modes for key, value in mode.items()},
    }
    refuse_nothing_left(laid_down, [name for name in starts if name in units], path)
    read = VehicleFile(
        vehicle.get("name", path.stem),
        model,
        constants,
        vehicle["derivatives"],
        tuple(modes),
        source.identity,
        aircraft_class=vehicle.get("aircraft_class"),
        flight_phase=vehicle.get("flight_phase"),
        constraints=laid_down,
        text=source.content.decode("utf-8-sig"),
    )
    return _with_uncertainty(read, source)


def _refuse_other_model(content: Mapping[str, Any], model: str, path: Path) -> None:
    """Raise DeclarationError for a file that names another model, or whose keys belong to one."""
    named = content.get("model")
    if isinstance(named, str) and named in MODELS and named != model:
        raise DeclarationError(
            f"this vehicle file is for the {named} model (key model), not for {model}",
            where=str(path),
            remedy=f"name a file for {model}, or the model {named}",
        )
    for other, keys in _WRITTEN_FOR.items():
        if all(key in content for key in keys) and model not in _READERS.get(other, (other,)):
            raise DeclarationError(
                f"this vehicle file is for the {other} model ({', '.join(keys)}), not for {model}",
                where=str(path),
                remedy=f"name a file for {model}, or the model {other}",
            )


def _mode_tables(content: dict[str, Any], path: str | Path) -> list[dict[str, Any]]:
    """Return the ``[[modes]]`` tables, completed by modal starts under ``[derivatives]``."""
    modes = content.get("modes")
    if (
        not isinstance(modes, list)
        or not modes
        or not all(isinstance(mode, dict) for mode in modes)
    ):
        raise DeclarationError(
            "no elastic mode",
            where=f"{path}, key modes",
            remedy="add a [[modes]] table for each mode, or use the rigid model",
        )
    tables = [dict(mode) for mode in modes]
    derivatives = content.get("derivatives")
    if isinstance(derivatives, dict):
        rest = {}
        for key, value in derivatives.items():
            match = _MODAL_START.fullmatch(key)
            number = int(match[1] or match[2]) if match else 0
            if not 1 <= number <= len(tables):
                rest[key] = value
                continue
            if key in tables[number - 1]:
                raise DeclarationError(
                    f"given twice, also under modes[{number}]",
                    where=f"{path}, key derivatives.{key}",
                    remedy="keep one of the two",
                )
            tables[number - 1][key] = value
        content["derivatives"] = rest
    return tables


def with_priors(model: Model, free: Sequence[str]) -> Model:
    """Return the model with exactly the named parameters free, each with a prior standard deviation
    of half its starting value: files may be 30 % wrong.
    """
    parameters = model.parameters.only_free(free)
    typical = max((abs(parameters[name].value) for name in free), default=1.0)
    prior = {
        name: RELATIVE_PRIOR * (abs(parameters[name].value) or OF_TYPICAL * typical or 1.0)
        for name in free
    }
    return model.with_parameters(parameters.with_prior(prior))
