"""The schema of scenario files (pydantic); imported only when one is read."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, Field
from pydantic_core import PydanticCustomError

from scenarios.files.own_models import is_model_file
from scenarios.files.vehicles_schema import STRICT, AircraftClass, FlightPhase
from scenarios.studies.scenario_file.quantities import Quantity

Name = Annotated[str, Field(min_length=1)]
Distance = Literal["same equations and step", "same equations, finer step", "same equations, other values", "effect missing"]


def model_name(*known: str) -> Callable[[str], str]:
    """A check of what is fitted: one of the ``known`` models, or a user's model file."""

    def checked_name(name: str) -> str:
        if name not in known and not is_model_file(name):
            context = {"what": f"there is no model {name!r}", "remedy": f"use one of {', '.join(known)}, or a Python file of your own"}
            raise PydanticCustomError("model", "no model", context)
        return name

    return checked_name


class Strict(BaseModel):
    model_config = STRICT


class SpreadTable(Strict):
    value: Quantity
    std: Quantity


class Maneuver(Strict):
    """One maneuver; which numbers it needs depends on its kind."""

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
    maneuvers: list[Maneuver] = []
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
    model: Annotated[str, AfterValidator(model_name("rigid", "flexible", "ballistic", "lateral", "longitudinal"))]
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
    """What a method's own flight has in the place of the scenario's; the vehicle and its true values are the same."""

    duration: Quantity | None = None
    rate: Quantity | None = None
    step: Quantity | None = None
    integration: Literal["tolerance", "rk4", "euler"] | None = None
    maneuvers: list[Maneuver] | None = None
    noise_std: dict[str, Quantity] | None = None
    noise_variance: dict[str, str] | None = None
    process_noise: dict[str, Quantity] | None = None


class MethodTable(EstimateTable):
    """A method beside the main one, which may have a flight and choices of its own."""

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
