"""The pydantic schemas of vehicle files; imported only when one is read."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, create_model
from pydantic_core import PydanticCustomError

from scenarios.files.formats.cells import LARGEST
from scenarios.files.units import to_si
from sim.errors import DeclarationError
from sim.vehicles.factory import ABOVE_ZERO, FAMILIES, MODE_DERIVATIVES, WHOLE_AXES, mode_parameter
from sim.vehicles.multirotor import DELAY, LAG

STRICT = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
_QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*)?", re.ASCII)


def quantity_in(target: str) -> Callable[[object], float]:
    """A validator that turns a number or ``"24200 lb"`` into the unit ``target``."""

    def convert(value: object) -> float:
        number = plain(value)
        if math.isfinite(number) and number != 0.0 and not 1.0 / LARGEST <= abs(number) <= LARGEST:
            what = f"{value!r:.60} lies beyond the numbers that are computed with, {1.0 / LARGEST:g} to {LARGEST:g}"
            raise PydanticCustomError("quantity", "extreme", {"what": what, "remedy": "check its exponent and its unit"})
        return number

    def plain(value: object) -> float:
        if isinstance(value, float) or (isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**1023):
            return float(value)
        found = _QUANTITY.fullmatch(value) if isinstance(value, str) else None
        if found is None:
            shown = f"{value!r:.60}"
            raise PydanticCustomError("quantity", "no quantity", {"what": f"{shown} is not a number with a unit", "remedy": _example(target)})
        if not found[2]:
            raise PydanticCustomError("quantity", "no unit", {"what": f"{value!r} has no unit", "remedy": _example(target)})
        try:
            return float(to_si(float(found[1]), found[2].strip(), target, "", DeclarationError))
        except DeclarationError as fault:
            raise PydanticCustomError("quantity", "unit", {"what": fault.what, "remedy": fault.remedy}) from None

    return convert


def number_in(value: object, unit: str, where: str) -> float:
    """A number or ``"24200 lb"`` in ``unit``. Raises DeclarationError that names ``where``."""
    try:
        number = quantity_in(unit)(value)
    except PydanticCustomError as error:
        context: Mapping[str, Any] = error.context or {}
        raise DeclarationError(str(context["what"]), where=where, remedy=str(context["remedy"])) from None
    if not math.isfinite(number):
        raise DeclarationError(f"value {number} is not a finite number", where=where, remedy="give a finite number")
    return number


def _example(target: str) -> str:
    return "write a plain number" if target == "1" else f'write a plain number in {target}, or a text such as "1.5 {target}"'


def _number(target: str, gt: float | None = None, ge: float | None = None) -> Any:
    return Annotated[float, BeforeValidator(quantity_in(target)), Field(gt=gt, ge=ge)]


def _required(kinds: Mapping[str, Any]) -> dict[str, Any]:
    return {name: (kind, ...) for name, kind in kinds.items()}


def _table(title: str, **fields: Any) -> type[BaseModel]:
    return create_model(title, __config__=STRICT, **fields)


_NAME = (Annotated[str, Field(min_length=1)] | None, None)
_PURE, _PER_ANGLE = _number("1"), _number("1/rad")
_AIRFRAME = _required(
    {
        "mass": _number("kg", gt=0.0),
        "wing_area": _number("m2", gt=0.0),
        "chord": _number("m", gt=0.0),
        "pitch_inertia": _number("kg m2", gt=0.0),
        "airspeed": _number("m/s", gt=0.0),
        "air_density": _number("kg/m3", gt=0.0),
    }
)
_RIGID_STARTS = _table("RigidDerivatives", **_required({f"C{axis}_{by}": _PER_ANGLE for axis in "Lm" for by in ("alpha", "q", "de")}))
_LOES_STARTS = _table(
    "LoesDerivatives",
    **_required({"L_alpha": _number("1/s"), "M_alpha": _number("1/s2"), "L_delta": _number("1/s"), "M_delta": _number("1/s2"), "L_q": _PURE}),
    **_required({"M_q": _number("1/s"), "inv_tau": _number("1/s", gt=0.0), "delay": _number("s", ge=0.0)}),
)
_BALLISTIC_STARTS = _table("BallisticDerivatives", **_required({"beta": _number("kg/m2", gt=0.0)}))


AircraftClass = Literal["I", "II", "II-C", "II-L", "III", "IV"]
FlightPhase = Literal["A", "B", "C"]
_FLOWN: dict[str, Any] = {"aircraft_class": (AircraftClass | None, None), "flight_phase": (FlightPhase | None, None)}


def _whole_axes(model: str) -> type[BaseModel]:
    """The file of equations whose constants must be given, and whose derivatives may be left out."""
    _, constants, derivatives = WHOLE_AXES[model]
    title = model.capitalize()
    lowest = dict.fromkeys((LAG, DELAY), 0.0)
    starts = _table(f"{title}Derivatives", **{name: (_number(unit, ge=lowest.get(name)) | None, None) for name, unit in derivatives.items()})
    kinds = {name: _number(unit, gt=0.0 if name in ABOVE_ZERO else None) for name, unit in constants.items()}
    return _table(f"{title}Vehicle", name=_NAME, **_required(kinds), **_FLOWN, derivatives=(starts, ...))


SCHEMAS: Mapping[str, type[BaseModel]] = {
    "rigid": _table("RigidVehicle", name=_NAME, **_AIRFRAME, **_FLOWN, derivatives=(_RIGID_STARTS, ...)),
    "flexible": _table("FlexibleVehicle", name=_NAME, **_AIRFRAME, **_FLOWN, derivatives=(_RIGID_STARTS, ...), modes=(list[dict[str, Any]], ...)),
    "loes": _table(
        "LoesVehicle",
        name=_NAME,
        **_required({"airspeed": _number("m/s", gt=0.0), "gravity": _number("m/s2", gt=0.0)}),
        vane_arm=(_number("m") | None, None),
        **_FLOWN,
        derivatives=(_LOES_STARTS, ...),
    ),
    "ballistic": _table(
        "BallisticVehicle",
        name=_NAME,
        **_required(
            {"air_density_reference": _number("kg/m3", gt=0.0), "density_scale_height": _number("m", gt=0.0), "gravity": _number("m/s2", gt=0.0)}
        ),
        derivatives=(_BALLISTIC_STARTS, ...),
    ),
    **{model: _whole_axes(model) for model in WHOLE_AXES},
}


def mode_schema(number: int, count: int) -> type[BaseModel]:
    """The table of elastic mode ``number`` of ``count``: its own starts are required, couplings to other modes are not."""
    own = {"frequency": _number("rad/s", gt=0.0), "damping": _number("1", ge=0.0), "generalized_mass": _number("kg m2", gt=0.0)}
    starts = [f"CL_eta{number}", f"CL_etadot{number}", f"Cm_eta{number}", f"Cm_etadot{number}"]
    starts += [f"Ceta{number}_{by}" for by in ("alpha", "q", "de", f"eta{number}", f"etadot{number}")]
    couplings = [f"Ceta{number}_{by}{other}" for other in range(1, count + 1) if other != number for by in ("eta", "etadot")]
    optional: dict[str, Any] = {key: (_PURE | None, None) for key in couplings}
    return _table(f"Mode{number}", **_required({**own, **{key: _PURE for key in starts}}), **optional)


def units_of_starts(model: str, modes: object = None) -> dict[str, str]:
    """What is estimated of a model, with its unit; ``modes`` is a file's list of elastic modes."""
    kind = "rigid" if model == "flexible" else model
    count = len(modes) if model == "flexible" and isinstance(modes, list) else 0
    own = {mode_parameter(local, i): unit for i in range(1, count + 1) for local, unit in MODE_DERIVATIVES.items()}
    modal = {f"Ceta{i}_{by}{i}": "1" for i in range(1, count + 1) for by in ("eta", "etadot")}
    return {**FAMILIES[kind][2], **own, **modal}


def refuse_unusable(model: str, constants: Mapping[str, float], derivatives: Mapping[str, float], path: str | Path) -> None:
    """What no single key shows. Raises DeclarationError where no derivative is given, and for moments of inertia that no body has."""
    if not derivatives:
        _, _, known = WHOLE_AXES[model]
        remedy = f"give where the search starts, one of {', '.join(known)} at least: what is left out is held at zero"
        raise DeclarationError("no derivative is given", where=f"{path}, key derivatives", remedy=remedy)
    cross = constants.get("cross_inertia", 0.0)
    if cross and cross**2 >= constants["roll_inertia"] * constants["yaw_inertia"]:
        remedy = "its square is below roll_inertia times yaw_inertia"
        raise DeclarationError(f"value {cross:g} kg m2 is too large", where=f"{path}, key cross_inertia", remedy=remedy)
