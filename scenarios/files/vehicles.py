"""Read vehicle files: constants and starting values of a vehicle for a model, in SI units."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from scenarios.files.aircraft_files import model_of_file, read_model_file, vehicle_source
from scenarios.files.declarations import checked, closest, toml_of
from scenarios.files.measured.columns import RecordFile, path_of
from scenarios.files.sources import InputFile, Source
from scenarios.files.user_models import (
    AIRCRAFT_SUFFIX,
    FLYING_QUALITIES_KEYS,
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
VEHICLE_FILE_NAME = (
    "vehicle.toml"  # name of a vehicle file that is read from the folder of a record
)
AIRCRAFT = "aircraft"
UNCERTAINTY = "uncertainty"
# Model -> (key at the top of the file, whether a file of this model has it). A file that agrees
# with no line is of the rigid model.
_DISTINGUISHING_KEYS = {
    "flexible": (("modes", True),),
    "lateral": (("span", True),),
    "longitudinal": (("reference_airspeed", True),),
    "loes": (("gravity", True), ("mass", False)),
    "multirotor": (("mass", False), ("airspeed", False), ("reference_airspeed", False)),
}
# Model -> keys that only its files have.
_OWN_KEYS = {
    "lateral": ("roll_inertia", "yaw_inertia"),
    "longitudinal": ("reference_airspeed",),
    "ballistic": ("density_scale_height",),
    "rigid": ("pitch_inertia", "airspeed"),
}
# Model -> models that read its files, if others do too.
_READERS = {"rigid": ("rigid", "flexible")}
_PERCENT = re.compile(r"\s*(\d+\.?\d*|\.\d+)\s*%\s*", re.ASCII)
_MODAL_START = re.compile(r"(?:C[Lm]_eta(?:dot)?(\d+)|Ceta(\d+)_\w+)")
RELATIVE_PRIOR = 0.5  # prior standard deviation over starting value: values may be 30 % wrong
TYPICAL_SHARE = 0.01  # size that replaces a start of zero, as a share of the largest start
LARGEST_UNCERTAINTY = 0.5  # standard deviation over value of a constant that must be positive


@dataclass(frozen=True)
class VehicleFile:
    """Content of a vehicle file.

    Attributes
    ----------
    name : name of the vehicle, or of the file if it states none.
    model : name of the model for which the file was read.
    constants : fixed values in SI units; ``docs/nomenclature.md`` has their names and meanings. A
        file of the loes model may omit ``vane_arm``.
    derivatives : starting values in SI units, per radian (loes: per unit of the stick).
    modes : number, from 1, and values of each elastic mode of the flexible model: ``frequency``
        (rad/s), ``damping`` (1), ``generalized_mass`` (kg m2), the starts of its derivatives, and
        the couplings ``Ceta1_eta2 ...`` in the file.
    identity : name and hash of the file, or None.
    own : a user's model with these numbers; None for a built-in model.
    own_file : name and hash of the file of the user's model; None for a built-in model.
    aircraft_class : class I to IV of MIL-F-8785C, or None.
    flight_phase : category A to C of MIL-F-8785C, or None.
    constraints : parameters that are fixed, bounded or tied; their starts are in ``derivatives``.
    text : content of the file, or empty.
    uncertainty : constant -> standard deviation in SI units, from the table ``[uncertainty]``; a
        constant without an entry is exact.
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
    """Return the path of ``vehicle.toml`` in the folder of a record, None if there is none."""
    path = path_of(record)
    if path is None:
        return None
    vehicle_path = path.parent / VEHICLE_FILE_NAME
    return vehicle_path if vehicle_path.is_file() else None


ALSO_READ = "also read, because found beside the records"


def files_read_unnamed(records: Sequence[RecordFile], vehicle: Path | None) -> tuple[str, ...]:
    """Return a sentence on the files that were read although the user did not name them; no
    sentence without such files.

    These are the sidecars of the records, and the ``vehicle`` file that ``vehicle_next_to`` found;
    it is None if the user named one.
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
    if model in MODELS or is_model_file(model):
        return
    remedy = closest(str(model), MODELS)
    if not remedy.startswith("did you mean"):
        remedy = f"{remedy}, or a Python file of your own"
    raise DeclarationError(f"there is no model {model!r}", where=where, remedy=remedy)


def read_vehicle(path: str | Path | Source | None, model: str | OwnModel) -> VehicleFile:
    """Return the vehicle of a file for a built-in model or a user's model.

    ``path`` may be None for a user's model, which has its own values. Raises DeclarationError.
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
            remedy="name a vehicle file or one of the library, or put "
            f"{VEHICLE_FILE_NAME} beside the record",
        )
    return vehicle_of(vehicle_source(path, model), model)


def own_vehicle(own: OwnModel, source: Source | None) -> VehicleFile:
    """Return a user's model with the values of a vehicle file, or its own values without a file.

    Raises
    ------
    DeclarationError : if the file has the aerodynamics of an aircraft and the model is a Python
        file.
    """
    content = {} if source is None else toml_of(source)
    if source is not None and "aerodynamics" in content:
        if not own.identity.name.endswith(AIRCRAFT_SUFFIX):
            what = (
                f"it has [aerodynamics], which {own.model.name}, a model in Python, does not read"
            )
            remedy = "give a file with the parameters of this model, or --model aircraft"
            raise DeclarationError(what, where=str(source.path), remedy=remedy)
        return aircraft_vehicle(source)
    name, model, constraints = own.model.name, own.model, NONE
    if source is not None:
        name, model, constraints = own_numbers(own, source)
    of_levels = {key: content[key] for key in FLYING_QUALITIES_KEYS if key in content}
    levels: dict[str, Any] = {}
    if source is not None and of_levels:
        from scenarios.files.schemas import FLYING_QUALITIES

        levels = checked(FLYING_QUALITIES, of_levels, source.path).model_dump()
    return _vehicle_of_model(name, model, constraints, source, own.identity, levels)


def _vehicle_of_model(
    name: str,
    model: Model,
    constraints: Constraints,
    source: Source | None,
    own_file: InputFile,
    levels: Mapping[str, Any],
) -> VehicleFile:
    """Return the vehicle of a user's model or an aircraft, whose values are those of ``model``.

    ``source`` is the vehicle file, ``own_file`` the file of the model, ``levels`` the keys of
    flying qualities.
    """
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
        own_file if source is None else source.identity,
        model,
        own_file,
        **levels,
        constraints=constraints,
        text=source.content.decode("utf-8-sig") if source is not None else "",
    )
    return vehicle if source is None else _with_uncertainty(vehicle, source)


def with_plain_terms(source: Source) -> Source:
    """Return the file of an aircraft with a constant term of zero for each coefficient without
    terms.
    """
    content = toml_of(source)
    table = content.get("aerodynamics", {})
    if not isinstance(table, dict):
        return source
    wind_axes = {"CD", "CL"} & set(table)
    axes = ("CD", "CY", "CL", *MOMENTS) if wind_axes else ("CX", "CY", "CZ", *MOMENTS)
    added = "".join(f'\n[aerodynamics.{axis}]\n"1" = 0.0\n' for axis in axes if axis not in table)
    return replace(source, content=source.content + added.encode()) if added else source


def aircraft_vehicle(source: Source) -> VehicleFile:
    """Read a file of the model ``aircraft``. Raises DeclarationError as ``vehicle_of``."""
    name, model, constraints = model_of_file(source)
    return _vehicle_of_model(name, model, constraints, source, source.identity, {})


def _with_uncertainty(vehicle: VehicleFile, source: Source) -> VehicleFile:
    """Return the vehicle with the standard deviations of its constants, from its file.

    Raises
    ------
    DeclarationError : for an unknown constant, a wrong unit, a number that is not positive, or a
        standard deviation of more than half of a constant that must be positive.
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
    for name, entry in table.items():
        place = f"{where}.{name}"
        if name not in units:
            remedy = closest(name, units)
            raise DeclarationError(f"there is no constant {name}", where=place, remedy=remedy)
        value = abs(vehicle.constants[name])
        percent = _PERCENT.fullmatch(entry) if isinstance(entry, str) else None
        if percent:
            sigma = 0.01 * float(percent[1]) * value
        else:
            sigma = number_in(entry, units[name], place)
        if not sigma > 0.0 or not math.isfinite(sigma):
            remedy = "give a positive number, or leave the line out where the constant is known"
            what = f"{entry!r} is no standard deviation"
            raise DeclarationError(what, where=place, remedy=remedy)
        if name in ABOVE_ZERO and sigma > LARGEST_UNCERTAINTY * value:
            raise DeclarationError(
                f"{sigma:g} {units[name]} is more than half of {name}, {value:g}",
                where=place,
                remedy="give one standard deviation, in the constant's own unit or in %",
            )
        sigmas[name] = sigma
    return replace(vehicle, uncertainty=sigmas)


def read_any_vehicle(path: str | Path | Source) -> VehicleFile:
    """Return the vehicle of a file of any model of an aircraft, which follows from its keys.

    The model is an empty text if the file has only the values for a check of the kinematics. Raises
    DeclarationError.
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
    for model, keys in _DISTINGUISHING_KEYS.items():
        if all((key in content) is has_key for key, has_key in keys):
            return vehicle_of(source, model)
    return vehicle_of(source, "rigid")


def vehicle_of(source: Source, model: str) -> VehicleFile:
    """Return the vehicle of an open file for one of ``MODELS``.

    A value is a number in SI units, or a text with a unit such as ``"24200 lb"``. Starts of an
    elastic mode are in its ``[[modes]]`` table or in ``[derivatives]``.

    Raises
    ------
    DeclarationError : if the file is not TOML, if a key is unknown or missing, or if a value has
        the wrong kind, unit or sign. The message has file, key and remedy in one line.
    """
    if model == AIRCRAFT:
        return aircraft_vehicle(source)
    from scenarios.files.schemas import SCHEMAS, mode_schema, refuse_unusable, units_of_starts

    path, content = source.path, toml_of(source)
    _refuse_other_model(content, model, path)
    content.pop(UNCERTAINTY, None)  # read last, once the constants are known
    units = units_of_starts(model, content.get("modes"))
    constraints = take_constraints(content, units, path)
    tables: list[dict[str, Any]] = []
    if model == "flexible":
        tables = _mode_tables(content, path)
        content = {**content, "modes": tables}
    try:
        vehicle = checked(SCHEMAS[model], content, path).model_dump(exclude_none=True)
    except DeclarationError as error:
        raise with_place(error, constraints, path) from None
    modes = []
    for number, table in enumerate(tables, start=1):
        values = checked(
            mode_schema(number, len(tables)), table, path, f"modes[{number}]"
        ).model_dump(exclude_none=True)
        modes.append((number, values))
    constants = {
        key: value
        for key, value in vehicle.items()
        if key not in ("name", "derivatives", "modes", *FLYING_QUALITIES_KEYS)
    }
    refuse_unusable(model, constants, vehicle["derivatives"], path)
    starts = {
        **vehicle["derivatives"],
        **{key: value for _, mode in modes for key, value in mode.items()},
    }
    refuse_nothing_left(constraints, [name for name in starts if name in units], path)
    vehicle_file = VehicleFile(
        vehicle.get("name", path.stem),
        model,
        constants,
        vehicle["derivatives"],
        tuple(modes),
        source.identity,
        aircraft_class=vehicle.get("aircraft_class"),
        flight_phase=vehicle.get("flight_phase"),
        constraints=constraints,
        text=source.content.decode("utf-8-sig"),
    )
    return _with_uncertainty(vehicle_file, source)


def _refuse_other_model(content: Mapping[str, Any], model: str, path: Path) -> None:
    """Raise DeclarationError for a file of another model, as its keys show."""
    named = content.get("model")
    if isinstance(named, str) and named in MODELS and named != model:
        raise DeclarationError(
            f"this vehicle file is for the {named} model (key model), not for {model}",
            where=str(path),
            remedy=f"name a file for {model}, or the model {named}",
        )
    for other, keys in _OWN_KEYS.items():
        if all(key in content for key in keys) and model not in _READERS.get(other, (other,)):
            raise DeclarationError(
                f"this vehicle file is for the {other} model ({', '.join(keys)}), not for {model}",
                where=str(path),
                remedy=f"name a file for {model}, or the model {other}",
            )


def _mode_tables(content: dict[str, Any], path: str | Path) -> list[dict[str, Any]]:
    """Return the ``[[modes]]`` tables with the starts of modes that are in ``[derivatives]``, which
    are removed from there.
    """
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
        without_modal = {}
        for key, value in derivatives.items():
            match = _MODAL_START.fullmatch(key)
            number = int(match[1] or match[2]) if match else 0
            if not 1 <= number <= len(tables):
                without_modal[key] = value
                continue
            if key in tables[number - 1]:
                raise DeclarationError(
                    f"given twice, also under modes[{number}]",
                    where=f"{path}, key derivatives.{key}",
                    remedy="keep one of the two",
                )
            tables[number - 1][key] = value
        content["derivatives"] = without_modal
    return tables


def with_priors(model: Model, free: Sequence[str]) -> Model:
    """Return the model with only the parameters ``free`` free, each with a prior about its start.

    The prior standard deviation is ``RELATIVE_PRIOR`` times the starting value.
    """
    parameters = model.parameters.only_free(free)
    largest = max((abs(parameters[name].value) for name in free), default=1.0)
    prior = {
        name: RELATIVE_PRIOR * (abs(parameters[name].value) or TYPICAL_SHARE * largest or 1.0)
        for name in free
    }
    return model.with_parameters(parameters.with_prior(prior))
