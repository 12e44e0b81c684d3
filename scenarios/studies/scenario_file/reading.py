"""From the content of a scenario file, checked, to a Scenario; imported only when one is read."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from ident.flying_qualities.levels import flown_as
from scenarios.files.declarations import checked
from scenarios.files.own_models import OwnModel, is_of_aircraft
from scenarios.files.writing import unportable
from scenarios.studies.declaration import Estimation, Flight, Mark, PublishedChoice, Scenario, Start, SweepPlan
from scenarios.studies.scenario_file.choices import choices_of
from scenarios.studies.scenario_file.flight import flight_of, other_flight_of, repeated_of
from scenarios.studies.scenario_file.own import completed, model_files
from scenarios.studies.scenario_file.quantities import density, positive, si, standard_deviations, unit_of
from scenarios.studies.scenario_file.schema import EstimateTable, MethodTable, PublishedTable, ScenarioTable, SpreadTable
from sim.declaration.model import Model
from sim.errors import DeclarationError


def scenario_of(document: Mapping[str, Any], name: str, where: str) -> Scenario:
    """A Scenario from the content of its file; ``where`` names the file in messages.

    A method under ``[[methods]]`` takes over from ``[estimate]`` whatever it does not say itself; its tables
    ``start``, ``initial`` and ``held`` replace whole entries, not tables. Its ``flight`` replaces keys of ``[flight]``.

    Raises
    ------
    DeclarationError : an unknown or missing key, a value or unit that is wrong: one line with file and key.
    """
    content = checked(ScenarioTable, document, where)
    base = {key: value for key, value in document["estimate"].items()}
    files = model_files([content.flight.vehicle, content.estimate.model, *(str(change.get("model", "")) for change in content.methods)])
    flight = flight_of(content.flight, content.estimate.model, where, files)
    _refuse_words_for_aircraft(content, flight.own, where)
    mains = [estimation_of(content.estimate, "main", where, flight, files)]
    for number, change in enumerate(content.methods, start=1):
        merged = {**base, **change}
        for table in ("start", "initial", "held"):
            if isinstance(change.get(table), dict) and isinstance(base.get(table), dict):
                merged[table] = {**base[table], **change[table]}
        method, place = checked(MethodTable, merged, where, f"methods[{number}]"), f"{where}, key methods[{number}]"
        if why := unportable(method.name):
            remedy = "its files have it in their names: give it another one"
            raise DeclarationError(f"the name {method.name!r} {why}", where=f"{place}.name", remedy=remedy)
        if method.name.lower() in [done.name.lower() for done in mains]:
            raise DeclarationError(f"the name {method.name!r} is taken", where=f"{place}.name", remedy="give each method a name of its own")
        own_flight = other_flight_of(content.flight, method.flight, method.model, where, f"methods[{number}].flight", files)
        if method.distance and own_flight is None:
            raise DeclarationError("this method sees the scenario's flight", where=f"{place}.distance", remedy="leave it out, or give it a flight")
        declared = estimation_of(method, method.name, where, own_flight or flight, files)
        choices = choices_of(method.own, merged, f"{place}.own")
        mains.append(replace(declared, flight=own_flight, distance=method.distance or "", choices=choices))
    _refuse_other_flights(content, mains, where)
    if content.estimate.engine is not None and not any(each.method == "ekf" for each in mains):
        what = "an engine is named, and no method is an extended Kalman filter"
        raise DeclarationError(what, where=f"{where}, key estimate.engine", remedy='leave it out, or write method = "ekf"')
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
        repeated_of(content, [each.name for each in mains if each.flight is None], where, files) if content.repeated else None,
        _swept(content, mains, where),
        content.determination,
        choices_of(content.own, document, f"{where}, key own"),
    )


def _swept(content: ScenarioTable, mains: Sequence[Estimation], where: str) -> SweepPlan | None:
    """The structures of a sweep, from stiff to soft."""
    if content.sweep is None:
        return None
    place = f"{where}, key sweep"
    if not content.condensed or content.flight.modes < 1:
        raise DeclarationError("there is no structure to soften", where=place, remedy="fly elastic modes, with condensed = true")
    if mains[0].modes or mains[0].model != "rigid":
        raise DeclarationError("the main method is no rigid model", where=place, remedy='write model = "rigid" under [estimate]')
    if content.flight.feedback or content.flight.process_noise:
        raise DeclarationError("feedback or random forcing in a sweep", where=place, remedy="leave it out of the flight")
    factors = tuple(sorted(set(content.sweep.frequency_factors), reverse=True))
    for number, mark in enumerate(content.sweep.marks, start=1):
        if mark.frequency_factor not in factors:
            known = ", ".join(f"{factor:g}" for factor in factors)
            raise DeclarationError("no such factor", where=f"{place}.marks[{number}].frequency_factor", remedy=f"use one of {known}")
    return SweepPlan(factors, tuple(Mark(mark.label, mark.frequency_factor, _choice(mark.published)) for mark in content.sweep.marks))


def _choice(published: PublishedTable | None) -> PublishedChoice | None:
    return PublishedChoice(published.file, published.table, published.column) if published else None


def estimation_of(estimate: EstimateTable, name: str, where: str, flight: Flight, files: Mapping[str, OwnModel]) -> Estimation:
    place = f"{where}, key {'estimate' if name == 'main' else f'methods {name}'}"
    own = files[estimate.model].model if estimate.model in files else None
    model = own or estimate.model
    _refuse_missing(estimate, own, place)
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
        published=_choice(estimate.published),
        flown_noise_std=standard_deviations({}, estimate.flown_noise_variance, place, model),
        engine=estimate.engine or "filterpy",
        own=own,
    )
    return declared if own is None else completed(declared, flight.noise_std)


def _refuse_words_for_aircraft(content: ScenarioTable, own: Model | None, where: str) -> None:
    """Raise DeclarationError for keys that say something of an aircraft alone, where none flies."""
    aircraft = content.estimate.model != "ballistic" and (own is None or is_of_aircraft(own))
    asked = {"condensed": content.condensed and own is not None}
    asked |= {key: getattr(content, key) is not None and not aircraft for key in ("aircraft_class", "flight_phase")}
    for key, vain in asked.items():
        if vain:
            raise DeclarationError("this is for aircraft, and none flies", where=f"{where}, key {key}", remedy="leave it out")


def _refuse_other_flights(content: ScenarioTable, mains: Sequence[Estimation], where: str) -> None:
    """Raise DeclarationError for a flight of a method's own where sweeps are flown once for all methods."""
    own = [number for number, method in enumerate(mains) if method.flight is not None]
    if own and content.sweep:
        raise DeclarationError("a sweep is flown once for all methods", where=f"{where}, key methods[{own[0]}].flight", remedy="leave it out")


def _refuse_missing(estimate: EstimateTable, own: Model | None, place: str) -> None:
    """Raise DeclarationError where a built-in model is not told what only a file of one's own says itself."""
    missing = [key for key in ("outputs", "start", "initial") if getattr(estimate, key) is None]
    if own is None and missing:
        word = "key" if len(missing) == 1 else "keys"
        raise DeclarationError(f"{word} missing: {', '.join(missing)}", where=place, remedy="add " + ("it" if len(missing) == 1 else "them"))


def _start(name: str, spread: SpreadTable, where: str, model: str | Model) -> Start:
    std = si(spread.std, unit_of(name, model), f"{where}.std")
    if not std > 0:
        raise DeclarationError(f"{spread.std!r} is not above 0", where=f"{where}.std", remedy="give a standard deviation above zero")
    return Start(si(spread.value, unit_of(name, model), f"{where}.value"), std)
