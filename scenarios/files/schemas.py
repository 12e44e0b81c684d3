"""Pydantic schemas of channel maps, vehicle files, maneuver files and surveys.

The module is imported only when such a file is read.
"""

from __future__ import annotations

import datetime
import math
import re
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StringConstraints,
    create_model,
    model_validator,
)
from pydantic_core import PydanticCustomError

from scenarios.files.sources import LARGEST_NUMBER
from scenarios.files.units import to_si
from sim.errors import DeclarationError
from sim.vehicles.factory import ABOVE_ZERO, FAMILIES, MODE_DERIVATIVES, WHOLE_AXES, mode_parameter
from sim.vehicles.other_vehicles import DELAY, LAG

# ---- Channel maps

STRICT = ConfigDict(extra="forbid", frozen=True, strict=True)
ABSENT = "\0"  # column of a channel that a map declares absent; no header is equal to it
LONGEST_COLUMN = 500  # letters of the name of a column or of an expression
MOST_SUMMANDS = 20  # most columns in a sum
LONGEST_NUMBER = 1023  # bits of a whole number that is converted to a float


_Number = Annotated[float, Field(allow_inf_nan=False)]
_Text = Annotated[str, Field(min_length=1, max_length=LONGEST_COLUMN)]


class ColumnEntry(BaseModel):
    """An entry of a channel map: a column, such as ``{column = "AoA1", unit = "deg"}``, or an
    expression of columns.
    """

    model_config = STRICT
    column: _Text | Annotated[int, Field(ge=1)] | None = None
    sum: Annotated[list[_Text], Field(min_length=1, max_length=MOST_SUMMANDS)] | None = None
    unit: str | None = None
    scale: _Number = 1.0
    offset: _Number = 0.0
    bias: _Number | None = None
    sign: Literal[1, -1] = 1
    delay: _Number = 0.0
    table: Annotated[list[list[_Number]], Field(min_length=2, max_length=2)] | None = None
    hold: Literal["previous", "linear"] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> ColumnEntry:
        """Refuse an entry with neither or both of column and sum, or with a table that is no
        calibration.
        """
        if (self.column is None) == (self.sum is None):
            context = {
                "what": "neither column nor sum, or both",
                "remedy": 'write column = "HEADER", or sum = ["HEADER", "HEADER"]',
            }
            raise PydanticCustomError("channel", "not a column", context)
        if self.table is not None and (
            len(self.table[0]) != len(self.table[1])
            or len(self.table[0]) < 2
            or not _increasing(self.table[0])
        ):
            context = {
                "what": "table is no calibration",
                "remedy": "write [[x1, x2, ...], [y1, y2, ...]] of one length, x increasing",
            }
            raise PydanticCustomError("channel", "not a table", context)
        return self


def _increasing(values: Sequence[float]) -> bool:
    return all(later > earlier for earlier, later in pairwise(values))


def _as_table(value: object) -> object:
    """Return a short entry of a channel map, such as ``alpha = "AoA1"``, as a table."""
    if value is False:
        return {"column": ABSENT}
    if isinstance(value, str | int) and not isinstance(value, bool):
        return {"column": value}
    if not isinstance(value, dict):
        context = {
            "what": f"{value!r} names no column",
            "remedy": 'write {column = "HEADER", unit = "UNIT"}',
        }
        raise PydanticCustomError("channel", "not a column", context)
    return value


_Entry = Annotated[ColumnEntry | None, BeforeValidator(_as_table)]


def channel_map(allowed: Sequence[str]) -> type[BaseModel]:
    """Return the schema of a channel map for these channels.

    The names are aliases of its fields: a user's model may have names that pydantic reserves.
    """
    fields: dict[str, Any] = {
        f"channel_{i}": (_Entry, Field(None, alias=name)) for i, name in enumerate(allowed)
    }
    return create_model("ChannelMap", __config__=STRICT, **fields)


# ---- Vehicle files

VEHICLES_SCHEMA_STRICT = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
_QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*)?", re.ASCII)


def quantity_in(target: str) -> Callable[[object], float]:
    """Return a validator that converts a number, or a text such as ``"24200 lb"``, to the unit
    ``target``.
    """

    def in_range(value: object) -> float:
        number = converted(value)
        if (
            math.isfinite(number)
            and number != 0.0
            and not 1.0 / LARGEST_NUMBER <= abs(number) <= LARGEST_NUMBER
        ):
            what = (
                f"{value!r:.60} lies beyond the numbers that are computed with, "
                f"{1.0 / LARGEST_NUMBER:g} to {LARGEST_NUMBER:g}"
            )
            raise PydanticCustomError(
                "quantity", "extreme", {"what": what, "remedy": "check its exponent and its unit"}
            )
        return number

    def converted(value: object) -> float:
        if isinstance(value, float) or (
            isinstance(value, int)
            and not isinstance(value, bool)
            and abs(value) < 2**LONGEST_NUMBER
        ):
            return float(value)
        match = _QUANTITY.fullmatch(value) if isinstance(value, str) else None
        if match is None:
            shown = f"{value!r:.60}"
            raise PydanticCustomError(
                "quantity",
                "no quantity",
                {"what": f"{shown} is not a number with a unit", "remedy": _example(target)},
            )
        if not match[2]:
            raise PydanticCustomError(
                "quantity",
                "no unit",
                {"what": f"{value!r} has no unit", "remedy": _example(target)},
            )
        try:
            return float(to_si(float(match[1]), match[2].strip(), target, "", DeclarationError))
        except DeclarationError as fault:
            raise PydanticCustomError(
                "quantity", "unit", {"what": fault.what, "remedy": fault.remedy}
            ) from None

    return in_range


def is_quantity(text: str) -> bool:
    """Return whether a text is a number with a unit of any dimension, such as ``"24200 lb"``."""
    match = _QUANTITY.fullmatch(text)
    return match is not None and bool(match[2])


def number_in(value: object, unit: str, where: str) -> float:
    """Return the number of a value, which is a number or a text such as ``"24200 lb"``, in
    ``unit``.

    Raises
    ------
    DeclarationError : if the value is no such quantity. ``where`` is the place of the value.
    """
    try:
        number = quantity_in(unit)(value)
    except PydanticCustomError as error:
        context: Mapping[str, Any] = error.context or {}
        raise DeclarationError(
            str(context["what"]), where=where, remedy=str(context["remedy"])
        ) from None
    if not math.isfinite(number):
        raise DeclarationError(
            f"value {number} is not a finite number", where=where, remedy="give a finite number"
        )
    return number


def _example(target: str) -> str:
    """Return the remedy for a quantity that cannot be read."""
    if target == "1":
        return "write a plain number"
    return f'write a plain number in {target}, or a text such as "1.5 {target}"'


def number_of(target: str, gt: float | None = None, ge: float | None = None) -> Any:
    """Return the type of a number, or of a text with a unit, in the unit ``target``."""
    return Annotated[float, BeforeValidator(quantity_in(target)), Field(gt=gt, ge=ge)]


def _required_fields(types: Mapping[str, Any]) -> dict[str, Any]:
    return {name: (field_type, ...) for name, field_type in types.items()}


def table_of(title: str, **fields: Any) -> type[BaseModel]:
    """Return a strict schema of a table of a vehicle file."""
    return create_model(title, __config__=VEHICLES_SCHEMA_STRICT, **fields)


_NAME = (Annotated[str, Field(min_length=1)] | None, None)
_PURE_NUMBER, _PER_ANGLE = number_of("1"), number_of("1/rad")
_AIRFRAME = _required_fields(
    {
        "mass": number_of("kg", gt=0.0),
        "wing_area": number_of("m2", gt=0.0),
        "chord": number_of("m", gt=0.0),
        "pitch_inertia": number_of("kg m2", gt=0.0),
        "airspeed": number_of("m/s", gt=0.0),
        "air_density": number_of("kg/m3", gt=0.0),
    }
)
_RIGID_STARTS = table_of(
    "RigidDerivatives",
    **_required_fields(
        {f"C{axis}_{by}": _PER_ANGLE for axis in "Lm" for by in ("alpha", "q", "de")}
    ),
)
_LOES_STARTS = table_of(
    "LoesDerivatives",
    **_required_fields(
        {
            "L_alpha": number_of("1/s"),
            "M_alpha": number_of("1/s2"),
            "L_delta": number_of("1/s"),
            "M_delta": number_of("1/s2"),
            "L_q": _PURE_NUMBER,
            "M_q": number_of("1/s"),
            "inv_tau": number_of("1/s", gt=0.0),
            "delay": number_of("s", ge=0.0),
        }
    ),
)
_BALLISTIC_STARTS = table_of(
    "BallisticDerivatives", **_required_fields({"beta": number_of("kg/m2", gt=0.0)})
)


AircraftClass = Literal["I", "II", "II-C", "II-L", "III", "IV"]
FlightPhase = Literal["A", "B", "C"]
_FLYING_QUALITIES: dict[str, Any] = {
    "aircraft_class": (AircraftClass | None, None),
    "flight_phase": (FlightPhase | None, None),
}
FLYING_QUALITIES = table_of("FlyingQualities", **_FLYING_QUALITIES)


def _whole_axes(model: str) -> type[BaseModel]:
    """Return the schema of a model in ``WHOLE_AXES``, with required constants and optional
    derivatives.
    """
    _, constants, derivatives = WHOLE_AXES[model]
    title = model.capitalize()
    lowest = dict.fromkeys((LAG, DELAY), 0.0)
    starts = table_of(
        f"{title}Derivatives",
        **{
            name: (number_of(unit, ge=lowest.get(name)) | None, None)
            for name, unit in derivatives.items()
        },
    )
    kinds = {
        name: number_of(unit, gt=0.0 if name in ABOVE_ZERO else None)
        for name, unit in constants.items()
    }
    return table_of(
        f"{title}Vehicle",
        name=_NAME,
        **_required_fields(kinds),
        **_FLYING_QUALITIES,
        derivatives=(starts, ...),
    )


_RIGID: dict[str, Any] = {
    "name": _NAME,
    **_AIRFRAME,
    **_FLYING_QUALITIES,
    "derivatives": (_RIGID_STARTS, ...),
}
SCHEMAS: Mapping[str, type[BaseModel]] = {
    "rigid": table_of("RigidVehicle", **_RIGID),
    "flexible": table_of("FlexibleVehicle", **_RIGID, modes=(list[dict[str, Any]], ...)),
    "loes": table_of(
        "LoesVehicle",
        name=_NAME,
        **_required_fields(
            {"airspeed": number_of("m/s", gt=0.0), "gravity": number_of("m/s2", gt=0.0)}
        ),
        vane_arm=(number_of("m") | None, None),
        **_FLYING_QUALITIES,
        derivatives=(_LOES_STARTS, ...),
    ),
    "ballistic": table_of(
        "BallisticVehicle",
        name=_NAME,
        **_required_fields(
            {
                "air_density_reference": number_of("kg/m3", gt=0.0),
                "density_scale_height": number_of("m", gt=0.0),
                "gravity": number_of("m/s2", gt=0.0),
            }
        ),
        derivatives=(_BALLISTIC_STARTS, ...),
    ),
    **{model: _whole_axes(model) for model in WHOLE_AXES},
}


# vehicle file that has only the keys for a check of the kinematics
CHECK_ONLY = table_of(
    "CheckedVehicle",
    name=_NAME,
    airspeed=(number_of("m/s", gt=0.0), ...),
    gravity=(number_of("m/s2", gt=0.0) | None, None),
    vane_arm=(number_of("m") | None, None),
    chord=(number_of("m", gt=0.0) | None, None),
    air_density=(number_of("kg/m3", gt=0.0) | None, None),
)


def mode_schema(number: int, count: int) -> type[BaseModel]:
    """Return the schema of the table of elastic mode ``number`` of ``count`` modes.

    The starts of couplings to other modes are optional, and all others are required.
    """
    constants = {
        "frequency": number_of("rad/s", gt=0.0),
        "damping": number_of("1", ge=0.0),
        "generalized_mass": number_of("kg m2", gt=0.0),
    }
    starts = [f"CL_eta{number}", f"CL_etadot{number}", f"Cm_eta{number}", f"Cm_etadot{number}"]
    starts += [
        f"Ceta{number}_{by}" for by in ("alpha", "q", "de", f"eta{number}", f"etadot{number}")
    ]
    couplings = [
        f"Ceta{number}_{by}{other}"
        for other in range(1, count + 1)
        if other != number
        for by in ("eta", "etadot")
    ]
    optional: dict[str, Any] = {key: (_PURE_NUMBER | None, None) for key in couplings}
    return table_of(
        f"Mode{number}",
        **_required_fields({**constants, **{key: _PURE_NUMBER for key in starts}}),
        **optional,
    )


def units_of_starts(model: str, modes: object = None) -> dict[str, str]:
    """Return parameter -> SI unit for all parameters of a model that can be estimated.

    ``modes`` is the list of elastic modes in the file.
    """
    kind = "rigid" if model == "flexible" else model
    count = len(modes) if model == "flexible" and isinstance(modes, list) else 0
    of_modes = {
        mode_parameter(local, i): unit
        for i in range(1, count + 1)
        for local, unit in MODE_DERIVATIVES.items()
    }
    generalized = {f"Ceta{i}_{by}{i}": "1" for i in range(1, count + 1) for by in ("eta", "etadot")}
    return {**FAMILIES[kind][2], **of_modes, **generalized}


def refuse_unusable(
    model: str, constants: Mapping[str, float], derivatives: Mapping[str, float], path: str | Path
) -> None:
    """Raise DeclarationError for a file without derivatives or with impossible inertias."""
    if not derivatives:
        _, _, known = WHOLE_AXES[model]
        remedy = (
            f"give where the search starts, one of {', '.join(known)} at least: what is left out "
            "is held at zero"
        )
        raise DeclarationError(
            "no derivative is given", where=f"{path}, key derivatives", remedy=remedy
        )
    cross = constants.get("cross_inertia", 0.0)
    if cross and cross**2 >= constants["roll_inertia"] * constants["yaw_inertia"]:
        remedy = "its square is below roll_inertia times yaw_inertia"
        raise DeclarationError(
            f"value {cross:g} kg m2 is too large", where=f"{path}, key cross_inertia", remedy=remedy
        )


# ---- Maneuver files

Name = Annotated[str, StringConstraints(min_length=1)]
Number = Annotated[float, Field(allow_inf_nan=False)]


class PartEntry(BaseModel):
    """A maneuver: a part of a record."""

    model_config = VEHICLES_SCHEMA_STRICT
    number: Annotated[int, Field(ge=1)] | None = None
    name: Name | None = None
    from_: Number = Field(alias="from")
    to: Number
    axis: str | None = None
    kind: str | None = None


class FileEntry(BaseModel):
    """A file ``maneuvers.toml``."""

    model_config = VEHICLES_SCHEMA_STRICT
    record: Name | None = None
    sha256: Name | None = None
    maneuvers: list[PartEntry] = []


# ---- Survey files

FOLDER_NAME = r"^[A-Za-z0-9][A-Za-z0-9._+-]*$"  # name of a flight and of the folder of its results


def _date_text(value: object) -> object:
    return value.isoformat() if isinstance(value, datetime.date | datetime.datetime) else value


class Reading(BaseModel):
    """Options for reading records; an option of a flight replaces that of the survey."""

    model_config = VEHICLES_SCHEMA_STRICT
    channels: Name | None = None
    columns: Name | Annotated[list[Name], Field(min_length=1)] | None = None
    from_: Number | None = Field(None, alias="from")
    to: Number | None = None
    maneuver: int | Name | Annotated[list[int | Name], Field(min_length=1)] | None = None
    maneuvers: Name | None = None
    hold: Literal["previous", "linear"] | None = None
    rate: Annotated[float, Field(gt=0)] | None = None
    lowpass: Annotated[float, Field(gt=0)] | None = None


class FlightEntry(Reading):
    """A flight of a survey."""

    name: Annotated[str, StringConstraints(pattern=FOLDER_NAME)] | None = None
    record: Name | None = None
    records: Annotated[list[Name], Field(min_length=1)] | None = None
    vehicle: dict[str, Any] = {}
    condition: dict[str, float | str] = {}
    date: Annotated[str | None, BeforeValidator(_date_text)] = None
    tail: Name | None = None


class SurveyEntry(Reading):
    """A file of a survey."""

    title: Name | None = None
    model: Name
    vehicle: Name | None = None
    effort: Literal["normal", "thorough"] = "normal"
    effects: Name | None = None
    records: Name | Annotated[list[Name], Field(min_length=1)] | None = None
    flights: list[FlightEntry] = []
