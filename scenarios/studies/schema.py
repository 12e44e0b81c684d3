"""The schema of scenario files (pydantic), and the way from a checked file to a Scenario; imported only when one is read."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, Field
from pydantic_core import PydanticCustomError

from ident.flying_qualities.mode_levels import flown_as
from scenarios.files.declarations import checked
from scenarios.files.own_models import OwnModel, is_model_file
from scenarios.files.vehicles_schema import STRICT
from scenarios.studies.declaration import Estimation, Flight, ManeuverPlan, PublishedChoice, Repeated, Scenario, Start, Variation
from scenarios.studies.own import completed, model_files, truth_of
from scenarios.studies.quantities import Quantity, density, positive, si, standard_deviations, unit_of
from sim.declaration.model import Model
from sim.errors import DeclarationError

Name = Annotated[str, Field(min_length=1)]


def model_name(*known: str) -> Callable[[str], str]:
    """A check of what is fitted: one of the ``known`` models, or a user's model file."""

    def checked_name(name: str) -> str:
        if name not in known and not is_model_file(name):
            context = {"what": f"there is no model {name!r}", "remedy": f"use one of {', '.join(known)}, or a Python file of your own"}
            raise PydanticCustomError("model", "no model", context)
        return name

    return checked_name


class _Strict(BaseModel):
    model_config = STRICT


class _Spread(_Strict):
    value: Quantity
    std: Quantity


class Maneuver(_Strict):
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


class _Flight(_Strict):
    vehicle: Name
    values: dict[str, Quantity] = {}
    duration: Quantity
    rate: Quantity
    modes: int = Field(default=0, ge=0)
    step: Quantity = 0.001
    integration: Literal["rk4", "euler"] = "rk4"
    maneuvers: list[Maneuver] = []
    noise_std: dict[str, Quantity] = {}
    noise_variance: dict[str, str] = {}
    process_noise: dict[str, Quantity] = {}
    derivatives: dict[str, float] = {}
    feedback: dict[str, dict[str, float]] = {}


class _Variation(_Strict):
    label: Name
    methods: list[Name] = []
    process_noise: dict[str, Quantity] | None = None
    derivatives: dict[str, float] | None = None
    feedback: dict[str, dict[str, float]] | None = None


class _Repeated(_Strict):
    runs: int = Field(ge=2)
    flights: list[_Variation] = Field(min_length=1)


class _Published(_Strict):
    file: Name
    table: Name
    column: Name


class _Estimate(_Strict):
    name: Name = "main"
    label: str = ""
    model: Annotated[str, AfterValidator(model_name("rigid", "flexible", "ballistic", "lateral", "longitudinal"))]
    modes: int = Field(default=0, ge=0)
    outputs: list[str] | None = Field(default=None, min_length=1)
    method: Literal["ekf", "ukf", "output-error", "filter-error", "equation-error"] = "ekf"
    start: dict[str, _Spread] | None = None
    initial: dict[str, _Spread] | None = None
    held: dict[str, Quantity] = {}
    noise_std: dict[str, Quantity] = {}
    noise_variance: dict[str, str] = {}
    process_noise: dict[str, Quantity] = {}
    integration: Literal["rk4", "euler"] = "rk4"
    terms: int = Field(default=3, ge=0, le=12)
    max_step: Quantity | None = None
    passes: int = Field(default=1, ge=1)
    spread: float | None = Field(default=None, ge=5)
    use_priors: bool = False
    explanation: str = ""
    published: _Published | None = None
    flown_noise_variance: dict[str, str] = {}


class _Scenario(_Strict):
    schema_: Literal["flightid/scenario/1"] = Field(alias="schema")
    title: Name
    about: str = ""
    distance: Literal["same equations and step", "same equations, finer step", "same equations, other values", "effect missing"]
    seed: int = Field(default=1, ge=0)
    flight: _Flight
    estimate: _Estimate
    methods: list[dict[str, Any]] = []
    condensed: bool = False
    display: dict[str, str] = {}
    aircraft_class: Literal["I", "II", "II-C", "II-L", "III", "IV"] | None = None
    flight_phase: Literal["A", "B", "C"] | None = None
    repeated: _Repeated | None = None


def scenario_of(document: Mapping[str, Any], name: str, where: str) -> Scenario:
    """A Scenario from the content of its file; ``where`` names the file in messages.

    A method under ``[[methods]]`` takes over from ``[estimate]`` whatever it does not say itself; its tables
    ``start``, ``initial`` and ``held`` replace whole entries, not tables.

    Raises
    ------
    DeclarationError : an unknown or missing key, a value or unit that is wrong: one line with file and key.
    """
    content = checked(_Scenario, document, where)
    base = {key: value for key, value in document["estimate"].items()}
    files = model_files([content.flight.vehicle, content.estimate.model, *(str(change.get("model", "")) for change in content.methods)])
    flight = _flight(content.flight, content.estimate.model, where, files)
    mains = [_estimation(content.estimate, "main", where, flight, files)]
    for number, change in enumerate(content.methods, start=1):
        merged = {**base, **change}
        for table in ("start", "initial", "held"):
            if isinstance(change.get(table), dict) and isinstance(base.get(table), dict):
                merged[table] = {**base[table], **change[table]}
        method = checked(_Estimate, merged, where, f"methods[{number}]")
        if method.name in [done.name for done in mains]:
            raise DeclarationError(
                f"the name {method.name!r} is taken", where=f"{where}, key methods[{number}].name", remedy="give each method a name of its own"
            )
        mains.append(_estimation(method, method.name, where, flight, files))
    return Scenario(
        name,
        content.title,
        " ".join(content.about.split()),
        content.distance,
        flight,
        tuple(mains),
        content.condensed,
        dict(content.display),
        content.seed,
        flown_as(content.aircraft_class, content.flight_phase) if content.aircraft_class or content.flight_phase else None,
        tuple(file.identity for file in files.values()),
        _repeated(content, [each.name for each in mains], where, files) if content.repeated else None,
    )


def _repeated(content: _Scenario, names: Sequence[str], where: str, files: Mapping[str, OwnModel]) -> Repeated:
    """The flights to be repeated: each the scenario's own with those tables replaced that it gives itself."""
    assert content.repeated is not None
    flights = []
    for number, given in enumerate(content.repeated.flights, start=1):
        unknown = [name for name in given.methods if name not in names]
        if unknown:
            place = f"{where}, key repeated.flights[{number}].methods"
            raise DeclarationError(f"there is no method {unknown[0]!r}", where=place, remedy=f"use {', '.join(names)}")
        changed = {key: value for key, value in given.model_dump(exclude={"label", "methods"}).items() if value is not None}
        flight = _flight(content.flight.model_copy(update=changed), content.estimate.model, where, files)
        flights.append(Variation(given.label, flight, tuple(given.methods or names)))
    return Repeated(content.repeated.runs, tuple(flights))


def _flight(flight: _Flight, fitted: str, where: str, files: Mapping[str, OwnModel]) -> Flight:
    place = f"{where}, key flight"
    own = own_vehicle_of(flight.vehicle, flight.values, flight.modes, place, files)
    refuse_other_equations(own, fitted, where)
    model = own or fitted
    rate = positive(si(flight.rate, "1/s", f"{place}.rate", {"hz": "1/s"}), f"{place}.rate")
    return Flight(
        flight.vehicle,
        positive(si(flight.duration, "s", f"{place}.duration"), f"{place}.duration"),
        rate,
        maneuver_plans(flight.maneuvers, place, model),
        standard_deviations(flight.noise_std, flight.noise_variance, place, model),
        flight.modes,
        positive(si(flight.step, "s", f"{place}.step"), f"{place}.step"),
        flight.integration,
        {name: density(name, value, f"{place}.process_noise.{name}", model) for name, value in flight.process_noise.items()},
        dict(flight.derivatives),
        {name: dict(gains) for name, gains in flight.feedback.items()},
        own,
    )


def own_vehicle_of(vehicle: str, values: Mapping[str, Quantity], modes: int, place: str, files: Mapping[str, OwnModel]) -> Model | None:
    """The own model that flies, with its true values; None where a built-in vehicle does, which has neither."""
    if vehicle in files:
        if modes:
            raise DeclarationError(f"{modes} elastic modes asked for", where=f"{place}.modes", remedy="a model of your own has none")
        return truth_of(files[vehicle].model, values, f"{place}.values")
    if values:
        raise DeclarationError("a built-in vehicle has its own values", where=f"{place}.values", remedy="leave them out, or name a model of your own")
    return None


def refuse_other_equations(own: Model | None, fitted: str, where: str) -> None:
    """Raise DeclarationError where an own model flies and a built-in one is fitted, whose constants it need not have."""
    if own is not None and not is_model_file(fitted):
        what = f"a model of your own flies, and {fitted} is fitted"
        raise DeclarationError(what, where=f"{where}, key estimate.model", remedy="name the same file, or another of yours")


def maneuver_plans(maneuvers: Sequence[Maneuver], place: str, model: str | Model = "") -> tuple[ManeuverPlan, ...]:
    """Maneuvers with their numbers in SI, or in the units of an own ``model``; ``place`` is the key of the flight they belong to."""
    plans = []
    for number, maneuver in enumerate(maneuvers, start=1):
        key = f"{place}.maneuvers[{number}]"
        given = maneuver.model_dump(exclude_none=True, exclude={"input", "kind"})
        units = {"amplitude": unit_of(maneuver.input, model), "first_frequency": "rad/s", "last_frequency": "rad/s"}
        numbers = {k: v if k == "harmonics" else si(v, units.get(k, "s"), f"{key}.{k}") for k, v in given.items()}
        plans.append(ManeuverPlan(maneuver.input, maneuver.kind, numbers))
    return tuple(plans)


def _estimation(estimate: _Estimate, name: str, where: str, flight: Flight, files: Mapping[str, OwnModel]) -> Estimation:
    place = f"{where}, key {'estimate' if name == 'main' else f'methods {name}'}"
    own = files[estimate.model].model if estimate.model in files else None
    model = own or estimate.model
    _refuse_missing(estimate, own, place)
    published = PublishedChoice(estimate.published.file, estimate.published.table, estimate.published.column) if estimate.published else None
    declared = Estimation(
        name=name,
        label=estimate.label or name,
        model=estimate.model,
        outputs=tuple(estimate.outputs or ()),
        start={key: _start(key, value, f"{place}.start.{key}", model) for key, value in (estimate.start or {}).items()},
        initial={key: _start(key, value, f"{place}.initial.{key}", model) for key, value in (estimate.initial or {}).items()},
        method=estimate.method,
        modes=estimate.modes,
        held={key: si(value, unit_of(key, model), f"{place}.held.{key}") for key, value in estimate.held.items()},
        noise_std=standard_deviations(estimate.noise_std, estimate.noise_variance, place, model),
        process_noise={key: density(key, value, f"{place}.process_noise.{key}", model) for key, value in estimate.process_noise.items()},
        integration=estimate.integration,
        terms=estimate.terms,
        max_step=math.inf if estimate.max_step is None else positive(si(estimate.max_step, "s", f"{place}.max_step"), f"{place}.max_step"),
        passes=estimate.passes,
        use_priors=estimate.use_priors,
        spread=math.inf if estimate.spread is None else estimate.spread,
        explanation=" ".join(estimate.explanation.split()),
        published=published,
        flown_noise_std=standard_deviations({}, estimate.flown_noise_variance, place, model),
        own=own,
    )
    return declared if own is None else completed(declared, flight.noise_std)


def _refuse_missing(estimate: _Estimate, own: Model | None, place: str) -> None:
    """Raise DeclarationError where a built-in model is not told what only a file of one's own says itself."""
    missing = [key for key in ("outputs", "start", "initial") if getattr(estimate, key) is None]
    if own is None and missing:
        word = "key" if len(missing) == 1 else "keys"
        raise DeclarationError(f"{word} missing: {', '.join(missing)}", where=place, remedy="add " + ("it" if len(missing) == 1 else "them"))


def _start(name: str, spread: _Spread, where: str, model: str | Model) -> Start:
    std = si(spread.std, unit_of(name, model), f"{where}.std")
    if not std > 0:
        raise DeclarationError(f"{spread.std!r} is not above 0", where=f"{where}.std", remedy="give a standard deviation above zero")
    return Start(si(spread.value, unit_of(name, model), f"{where}.value"), std)
