"""Schema of scenario files (pydantic), and their quantities in SI; imported when one is read."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, Field
from pydantic_core import PydanticCustomError

from scenarios.files.declarations import CHANNEL_UNITS
from scenarios.files.schemas import VEHICLES_SCHEMA_STRICT, AircraftClass, FlightPhase
from scenarios.files.units import to_si
from scenarios.files.user_models import is_model_file, unit_in
from sim.declaration.model import Model
from sim.errors import DeclarationError

# ---- Numbers of scenario files in SI

Quantity = float | int | str

# SI units of quantities that a scenario may give in another unit.
UNITS = {
    name: CHANNEL_UNITS[name]
    for name in (
        *("alpha", "q", "nz", "altitude", "elevator", "p", "r", "phi", "ny", "aileron", "rudder"),
        *("airspeed", "theta", "nx", "thrust"),
    )
} | {"velocity": "m/s", "beta": "kg/m2"}
# A falling body's beta is its ballistic coefficient, an aircraft's its sideslip.
UNITS_BY_MODEL = {"lateral": {"beta": "rad"}}


def unit_of(name: str, model: str | Model = "") -> str:
    """Return the SI unit of a named quantity; 1 for a coefficient.

    ``model``: name of a built-in model, in which a quantity may have another unit, or a user's
    model (``Model``), which declares its units.
    """
    if isinstance(model, Model):
        return unit_in(model, name)
    return UNITS_BY_MODEL.get(model, {}).get(name) or UNITS.get(name, "1")


def standard_deviations(
    std: Mapping[str, Quantity], variance: Mapping[str, str], where: str, model: str | Model = ""
) -> dict[str, float]:
    """Return noise standard deviations by output, SI, from standard deviations and variances."""
    out = {}
    for name, value in std.items():
        key = f"{where}.noise_std.{name}"
        out[name] = positive_si(value, unit_of(name, model), key)
    for name, text in variance.items():
        key = f"{where}.noise_variance.{name}"
        number, unit = _parts(text, key)
        out[name] = math.sqrt(positive(number, key)) * float(
            to_si(1.0, _root(unit, key), unit_of(name, model), key, DeclarationError)
        )
    return out


def density(name: str, value: Quantity, where: str, model: str | Model = "") -> float:
    """Return a spectral density: a plain number in SI, or e.g. ``"57 (lb/ft2)^2/s"``."""
    if not isinstance(value, str):
        return _not_negative(float(value), where)
    number, unit = _parts(value, where)
    if not unit.endswith("/s"):
        raise DeclarationError(
            f"unit {unit!r} is no spectral density",
            where=where,
            remedy='write for example "57 (lb/ft2)^2/s"',
        )
    root = _root(unit.removesuffix("/s"), where)
    factor = float(to_si(1.0, root, unit_of(name, model), where, DeclarationError))
    return _not_negative(number, where) * factor**2


def _root(unit: str, where: str) -> str:
    """Return the square root of a unit such as ``"deg^2"`` or ``"(deg/s)^2"``."""
    text = unit.strip()
    if not text.endswith("^2"):
        raise DeclarationError(
            f"unit {unit!r} is no square",
            where=where,
            remedy='write for example "0.016 deg^2" or "0.016 (deg/s)^2"',
        )
    return text.removesuffix("^2").strip().removeprefix("(").removesuffix(")")


def _parts(text: str, where: str) -> tuple[float, str]:
    """Return number and unit of a text such as ``"0.016 deg^2"``."""
    number, _, unit = text.strip().partition(" ")
    try:
        return float(number), unit
    except ValueError:
        raise DeclarationError(
            f"{text!r} is not a number with a unit",
            where=where,
            remedy='write for example "0.016 deg^2"',
        ) from None


def si(value: Quantity, target: str, where: str, same: Mapping[str, str] | None = None) -> float:
    """Return a number, or a text with a unit, in the unit ``target``.

    ``same``: units to read as other units, such as ``{"hz": "1/s"}``.
    """
    if not isinstance(value, str):
        return float(value)
    number, unit = _parts(value, where)
    unit = (same or {}).get(unit.lower(), unit)
    return float(to_si(number, unit, target, where, DeclarationError))


def positive_si(
    value: Quantity, target: str, where: str, same: Mapping[str, str] | None = None
) -> float:
    """Return ``si`` of a value. Raises DeclarationError if it is not positive and finite."""
    return positive(si(value, target, where, same), where)


def positive(value: float, where: str) -> float:
    """Return the value. Raises DeclarationError if it is not positive and finite."""
    if not (value > 0 and math.isfinite(value)):
        raise DeclarationError(
            f"{value:g} is not above 0", where=where, remedy="give a positive number"
        )
    return value


def _not_negative(value: float, where: str) -> float:
    if not (value >= 0 and math.isfinite(value)):
        raise DeclarationError(
            f"{value:g} is negative", where=where, remedy="give zero or a positive number"
        )
    return value


# ---- The schema of scenario files

Name = Annotated[str, Field(min_length=1)]
Distance = Literal[
    "same equations and step",
    "same equations, finer step",
    "same equations, other values",
    "effect missing",
]


def model_name(*known: str) -> Callable[[str], str]:
    """Return a validator of model names: one of the ``known`` models, or a user's model file."""

    def checked_name(name: str) -> str:
        if name not in known and not is_model_file(name):
            context = {
                "what": f"there is no model {name!r}",
                "remedy": f"use one of {', '.join(known)}, or a Python file of your own",
            }
            raise PydanticCustomError("model", "no model", context)
        return name

    return checked_name


class Strict(BaseModel):
    model_config = VEHICLES_SCHEMA_STRICT


class SpreadTable(Strict):
    value: Quantity
    std: Quantity


class ManeuverTable(Strict):
    """One maneuver; its kind determines which numbers it needs."""

    input: Name
    kind: Literal["3-2-1-1", "doublet", "step", "pulse", "sweep", "multisine"]
    amplitude: Quantity | None = None
    unit: Quantity | None = None
    start: Quantity = 0.0
    duration: Quantity | None = None
    first_frequency: Quantity | None = None
    last_frequency: Quantity | None = None
    harmonics: list[int] | None = None


class FlightTable(Strict):
    vehicle: Name
    values: dict[str, Quantity] = {}
    duration: Quantity
    rate: Quantity
    modes: int = Field(default=0, ge=0)
    step: Quantity = 0.001
    integration: Literal["tolerance", "rk4", "euler"] = "tolerance"
    maneuvers: list[ManeuverTable] = []
    noise_std: dict[str, Quantity] = {}
    noise_variance: dict[str, str] = {}
    process_noise: dict[str, Quantity] = {}
    derivatives: dict[str, float] = {}
    feedback: dict[str, dict[str, float]] = {}
    frequency_factor: float = Field(default=1.0, gt=0.0)


class VariationTable(Strict):
    label: Name
    methods: list[Name] = []
    process_noise: dict[str, Quantity] | None = None
    derivatives: dict[str, float] | None = None
    feedback: dict[str, dict[str, float]] | None = None


class RepeatedTable(Strict):
    runs: int = Field(ge=2)
    flights: list[VariationTable] = Field(min_length=1)


class PublishedTable(Strict):
    file: Name
    table: Name
    column: Name


class MarkTable(Strict):
    label: Name
    frequency_factor: float
    published: PublishedTable | None = None


class SweepTable(Strict):
    frequency_factors: list[Annotated[float, Field(gt=0.0)]] = Field(min_length=3)
    marks: list[MarkTable] = []


class EstimateTable(Strict):
    name: Name = "main"
    label: str = ""
    model: Annotated[
        str, AfterValidator(model_name("rigid", "flexible", "ballistic", "lateral", "longitudinal"))
    ]
    modes: int = Field(default=0, ge=0)
    outputs: list[str] | None = Field(default=None, min_length=1)
    method: Literal["ekf", "ukf", "output-error", "filter-error", "equation-error"] = "ekf"
    start: dict[str, SpreadTable] | None = None
    initial: dict[str, SpreadTable] | None = None
    held: dict[str, Quantity] = {}
    noise_std: dict[str, Quantity] = {}
    noise_variance: dict[str, str] = {}
    process_noise: dict[str, Quantity] = {}
    integration: Literal["rk4", "euler"] = "rk4"
    terms: int = Field(default=3, ge=0, le=12)
    max_step: Quantity | None = None
    passes: int = Field(default=1, ge=1)
    engine: Literal["filterpy", "batched"] | None = None
    spread: float | None = Field(default=None, ge=5)
    use_priors: bool = False
    explanation: str = ""
    published: PublishedTable | None = None
    flown_noise_variance: dict[str, str] = {}


class OtherFlightTable(Strict):
    """Entries of a method's own flight that replace the scenario's; the vehicle is the same."""

    duration: Quantity | None = None
    rate: Quantity | None = None
    step: Quantity | None = None
    integration: Literal["tolerance", "rk4", "euler"] | None = None
    maneuvers: list[ManeuverTable] | None = None
    noise_std: dict[str, Quantity] | None = None
    noise_variance: dict[str, str] | None = None
    process_noise: dict[str, Quantity] | None = None


class MethodTable(EstimateTable):
    """A further method, which may have its own flight and choices."""

    flight: OtherFlightTable | None = None
    distance: Distance | None = None
    own: dict[str, Any] = {}


class ScenarioTable(Strict):
    schema_: Literal["flightid/scenario/1"] = Field(alias="schema")
    title: Name
    about: str = ""
    distance: Distance
    seed: int = Field(default=1, ge=0)
    flight: FlightTable
    estimate: EstimateTable
    methods: list[dict[str, Any]] = []
    condensed: bool = False
    display: dict[str, str] = {}
    aircraft_class: AircraftClass | None = None
    flight_phase: FlightPhase | None = None
    repeated: RepeatedTable | None = None
    sweep: SweepTable | None = None
    determination: bool = False
    own: dict[str, Any] = {}
