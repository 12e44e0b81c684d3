"""The schema of tracing scenarios (pydantic), and the way from a checked file to a TraceScenario;
imported only when one is read.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, Field

from scenarios.files.declarations import checked
from scenarios.files.schemas import VEHICLES_SCHEMA_STRICT
from scenarios.files.vehicles import MODELS
from scenarios.studies.declaration import ManeuverPlan
from scenarios.studies.reading import (
    maneuver_plans,
    model_files,
    own_vehicle_of,
    refuse_other_equations,
)
from scenarios.studies.schema import (
    ManeuverTable,
    Quantity,
    model_name,
    positive,
    si,
    standard_deviations,
)
from scenarios.trials.planted.declaration import (
    Expectation,
    HiddenTerm,
    RecordPlan,
    TraceFlight,
    TraceScenario,
    hidden_units,
)
from sim.declaration.model import Model
from sim.errors import DeclarationError

Name = Annotated[str, Field(min_length=1)]
DISTANCES = (
    "nothing missing",
    "effect missing",
    "effect of another form missing",
    "nothing in the library fits",
)


class _Strict(BaseModel):
    model_config = VEHICLES_SCHEMA_STRICT


class _PlannedRecord(_Strict):
    duration: Quantity
    maneuvers: list[ManeuverTable] = []


class _Flight(_Strict):
    vehicle: Name
    values: dict[str, Quantity] = {}
    rate: Quantity = 50.0
    step: Quantity = 0.001
    modes: int = Field(default=0, ge=0)
    noise_std: dict[str, Quantity] = {}
    noise_variance: dict[str, str] = {}
    train: _PlannedRecord
    validate_: _PlannedRecord = Field(alias="validate")
    test: _PlannedRecord | None = None


class _Hidden(_Strict):
    name: Name
    values: dict[str, Quantity] = {}
    elsewhere: dict[str, Quantity] = {}


class _Estimate(_Strict):
    model: Annotated[str, AfterValidator(model_name(*MODELS))]
    wrong: float = Field(default=0.3, ge=0, lt=1)
    start: dict[str, float] = {}
    effort: Literal["normal", "thorough"] = "normal"


class _Expect(_Strict):
    verdicts: list[Literal["consistent", "traced", "partial", "ambiguous", "unexplained"]] = Field(
        min_length=1
    )
    effects: list[list[str]] = []


class _Trace(_Strict):
    schema_: Literal["flightid/scenario/1"] = Field(alias="schema")
    kind: Literal["trace"]
    title: Name
    about: str = ""
    distance: Literal[
        "nothing missing",
        "effect missing",
        "effect of another form missing",
        "nothing in the library fits",
    ]
    seed: int = Field(default=1, ge=0)
    flight: _Flight
    hidden: list[_Hidden] = []
    estimate: _Estimate
    expect: _Expect


def trace_scenario_of(document: Mapping[str, Any], name: str, where: str) -> TraceScenario:
    """A TraceScenario from the content of its file; ``where`` names the file in messages.

    Raises
    ------
    DeclarationError : an unknown or missing key, a value or unit that is wrong, a hidden term that
        is not there: one line with file and key.
    """
    content = checked(_Trace, document, where)
    flight, place = content.flight, f"{where}, key flight"
    files = model_files([flight.vehicle, content.estimate.model])
    own = own_vehicle_of(flight.vehicle, flight.values, flight.modes, place, files)
    refuse_other_equations(own, content.estimate.model, where)
    if own is None and files:
        what = f"the built-in vehicle {flight.vehicle} flies"
        remedy = "name a built-in model, or fly that of your file"
        raise DeclarationError(what, where=f"{where}, key estimate.model", remedy=remedy)
    model = own or content.estimate.model
    hidden = tuple(
        _hidden(item, own or flight.vehicle, f"{where}, key hidden[{number}]")
        for number, item in enumerate(content.hidden, start=1)
    )
    if bool(hidden) == (content.distance == "nothing missing") and not flight.vehicle.startswith(
        "x29-"
    ):
        what = "something is hidden" if hidden else "nothing is hidden"
        if hidden or not flight.modes:
            raise DeclarationError(
                f"{what}, and the distance is {content.distance!r}",
                where=f"{where}, key distance",
                remedy="make the two agree",
            )
    return TraceScenario(
        name,
        content.title,
        " ".join(content.about.split()),
        content.distance,
        TraceFlight(
            flight.vehicle,
            _record(flight.train, f"{place}.train", model),
            _record(flight.validate_, f"{place}.validate", model),
            hidden,
            standard_deviations(flight.noise_std, flight.noise_variance, place, model),
            positive(si(flight.rate, "1/s", f"{place}.rate", {"hz": "1/s"}), f"{place}.rate"),
            positive(si(flight.step, "s", f"{place}.step"), f"{place}.step"),
            flight.modes,
            own,
            None if flight.test is None else _record(flight.test, f"{place}.test", model),
        ),
        content.estimate.model,
        Expectation(
            tuple(content.expect.verdicts),
            tuple(tuple(sorted(names)) for names in content.expect.effects),
        ),
        content.estimate.wrong,
        dict(content.estimate.start),
        content.seed,
        content.estimate.effort,
    )


def _record(record: _PlannedRecord, where: str, model: str | Model) -> RecordPlan:
    plans: tuple[ManeuverPlan, ...] = maneuver_plans(record.maneuvers, where, model)
    return RecordPlan(
        positive(si(record.duration, "s", f"{where}.duration"), f"{where}.duration"), plans
    )


def _hidden(item: _Hidden, vehicle: str | Model, where: str) -> HiddenTerm:
    units = hidden_units(item.name, vehicle, where)

    def values(table: Mapping[str, Quantity], key: str) -> dict[str, float]:
        for name in table:
            if name not in units:
                raise DeclarationError(
                    f"{item.name} has no {name}",
                    where=f"{where}.{key}",
                    remedy=f"it has {', '.join(units)}",
                )
        return {
            name: si(value, units[name], f"{where}.{key}.{name}") for name, value in table.items()
        }

    return HiddenTerm(item.name, values(item.values, "values"), values(item.elsewhere, "elsewhere"))
