"""The schema of scenario files (pydantic), and the way from a checked file to a Scenario; imported only when one is read."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from scenarios.files.declarations import checked
from scenarios.files.vehicles_schema import STRICT
from scenarios.studies.declaration import Estimation, Flight, ManeuverPlan, PublishedChoice, Repeated, Scenario, Start, Variation
from scenarios.studies.quantities import UNITS, Quantity, density, positive, si, standard_deviations, unit_of
from sim.errors import DeclarationError

Name = Annotated[str, Field(min_length=1)]


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
    model: Literal["rigid", "flexible", "ballistic", "lateral", "longitudinal"]
    modes: int = Field(default=0, ge=0)
    outputs: list[str] = Field(min_length=1)
    method: Literal["ekf", "ukf", "output-error", "filter-error", "equation-error"] = "ekf"
    start: dict[str, _Spread]
    initial: dict[str, _Spread]
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
    mains = [_estimation(content.estimate, "main", where)]
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
        mains.append(_estimation(method, method.name, where))
    flight = _flight(content.flight, content.estimate.model, where)
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
        _repeated(content, [each.name for each in mains], where) if content.repeated else None,
    )


def _repeated(content: _Scenario, names: Sequence[str], where: str) -> Repeated:
    """The flights to be repeated: each the scenario's own with those tables replaced that it gives itself."""
    assert content.repeated is not None
    flights = []
    for number, given in enumerate(content.repeated.flights, start=1):
        unknown = [name for name in given.methods if name not in names]
        if unknown:
            place = f"{where}, key repeated.flights[{number}].methods"
            raise DeclarationError(f"there is no method {unknown[0]!r}", where=place, remedy=f"use {', '.join(names)}")
        changed = {key: value for key, value in given.model_dump(exclude={"label", "methods"}).items() if value is not None}
        flight = _flight(content.flight.model_copy(update=changed), content.estimate.model, where)
        flights.append(Variation(given.label, flight, tuple(given.methods or names)))
    return Repeated(content.repeated.runs, tuple(flights))


def _flight(flight: _Flight, model: str, where: str) -> Flight:
    place = f"{where}, key flight"
    rate = positive(si(flight.rate, "1/s", f"{place}.rate", {"hz": "1/s"}), f"{place}.rate")
    return Flight(
        flight.vehicle,
        positive(si(flight.duration, "s", f"{place}.duration"), f"{place}.duration"),
        rate,
        maneuver_plans(flight.maneuvers, place),
        standard_deviations(flight.noise_std, flight.noise_variance, place, model),
        flight.modes,
        positive(si(flight.step, "s", f"{place}.step"), f"{place}.step"),
        flight.integration,
        {name: density(name, value, f"{place}.process_noise.{name}", model) for name, value in flight.process_noise.items()},
        dict(flight.derivatives),
        {name: dict(gains) for name, gains in flight.feedback.items()},
    )


def maneuver_plans(maneuvers: Sequence[Maneuver], place: str) -> tuple[ManeuverPlan, ...]:
    """Maneuvers with their numbers in SI; ``place`` is the key of the flight they belong to."""
    plans = []
    for number, maneuver in enumerate(maneuvers, start=1):
        key = f"{place}.maneuvers[{number}]"
        given = maneuver.model_dump(exclude_none=True, exclude={"input", "kind"})
        units = {"amplitude": UNITS.get(maneuver.input, "1"), "first_frequency": "rad/s", "last_frequency": "rad/s"}
        numbers = {k: v if k == "harmonics" else si(v, units.get(k, "s"), f"{key}.{k}") for k, v in given.items()}
        plans.append(ManeuverPlan(maneuver.input, maneuver.kind, numbers))
    return tuple(plans)


def _estimation(estimate: _Estimate, name: str, where: str) -> Estimation:
    place = f"{where}, key {'estimate' if name == 'main' else f'methods {name}'}"
    model = estimate.model
    published = PublishedChoice(estimate.published.file, estimate.published.table, estimate.published.column) if estimate.published else None
    return Estimation(
        name=name,
        label=estimate.label or name,
        model=model,
        outputs=tuple(estimate.outputs),
        start={key: _start(key, value, f"{place}.start.{key}", model) for key, value in estimate.start.items()},
        initial={key: _start(key, value, f"{place}.initial.{key}", model) for key, value in estimate.initial.items()},
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
    )


def _start(name: str, spread: _Spread, where: str, model: str) -> Start:
    std = si(spread.std, unit_of(name, model), f"{where}.std")
    if not std > 0:
        raise DeclarationError(f"{spread.std!r} is not above 0", where=f"{where}.std", remedy="give a standard deviation above zero")
    return Start(si(spread.value, unit_of(name, model), f"{where}.value"), std)
