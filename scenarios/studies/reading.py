"""From the checked content of a scenario file to a Scenario; imported when one is read."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from ident.flying_qualities.levels import flight_phase_of
from scenarios.files.aircraft_files import read_model_file
from scenarios.files.declarations import checked, refuse_unknown
from scenarios.files.user_models import OwnModel, is_model_file, is_of_aircraft
from scenarios.files.vehicles import MODELS, with_priors
from scenarios.files.writing import unportable
from scenarios.studies.declaration import (
    FILTERS,
    Estimation,
    FlightPlan,
    ManeuverPlan,
    Mark,
    PublishedChoice,
    Repeated,
    Scenario,
    Start,
    SweepPlan,
    Variation,
    choices_of,
)
from scenarios.studies.schema import (
    EstimateTable,
    FlightTable,
    ManeuverTable,
    MethodTable,
    OtherFlightTable,
    PublishedTable,
    Quantity,
    ScenarioTable,
    SpreadTable,
    density,
    positive_si,
    si,
    standard_deviations,
    unit_of,
)
from sim.declaration.effect import ParameterSet
from sim.declaration.model import Biased, Model, Noise
from sim.errors import DeclarationError, ModelError

# ---- A user's own model in a scenario

ZERO_START_RANGE = 1.0  # least sigma of an initial state, in its unit


def model_files(names: Iterable[str]) -> dict[str, OwnModel]:
    """Return the user models among ``names``. Errors as ``read_model_file``."""
    return {
        name: read_model_file(name, MODELS) for name in dict.fromkeys(names) if is_model_file(name)
    }


def truth_of(model: Model, values: Mapping[str, Quantity], where: str) -> Model:
    """Return the model with the scenario's true values of parameters and constants.

    Raises
    ------
    DeclarationError : an unknown name, a wrong unit, a value beyond its bounds; ``where`` is the
        key of the table.
    """
    for name in values:
        refuse_unknown("parameter", name, model.parameters.names, f"{where}.{name}")
    numbers = {
        name: si(value, model.parameters[name].unit, f"{where}.{name}")
        for name, value in values.items()
    }
    try:
        return model.with_values(numbers)
    except ModelError as fault:
        raise DeclarationError(
            f"{fault.where}: {fault.what}", where=where, remedy=fault.remedy
        ) from None


def completed(estimation: Estimation, measured: Iterable[str]) -> Estimation:
    """Return an estimation of a user model, completed from the model file.

    Completed are outputs that are ``measured``, starting values and initial states. Standard
    deviations are half of each value; for states at least ``ZERO_START_RANGE``.
    """
    model = estimation.own
    assert model is not None
    noisy = set(measured)
    free = [name for name in model.parameters.free_names if name not in estimation.held]
    prior = with_priors(model, free).parameters
    starts = {name: Start(prior[name].value, prior[name].prior_std) for name in free}
    initial = {
        item.name: Start(item.value, max(abs(item.value), ZERO_START_RANGE))
        for item in model.initial
    }
    return replace(
        estimation,
        outputs=estimation.outputs
        or tuple(signal.name for signal in model.equations.outputs if signal.name in noisy),
        start={**starts, **estimation.start},
        initial={**initial, **estimation.initial},
    )


def own_declared(estimation: Estimation, noise_std: Mapping[str, float]) -> Model:
    """Return the user model from which an estimator starts.

    The parameters under ``start`` are free with their priors, those under ``held`` are fixed, and
    constants have the values of the file.

    Raises
    ------
    DeclarationError : a parameter or state is unknown, both started and held, or out of bounds.
    """
    model, place = estimation.own, f"estimation {estimation.name}"
    assert model is not None
    tables = (
        ("start", "parameter", estimation.start, model.parameters.names),
        ("held", "parameter", estimation.held, model.parameters.names),
        ("initial", "state", estimation.initial, model.initial.names),
        (
            "outputs",
            "output",
            estimation.outputs,
            [signal.name for signal in model.equations.outputs],
        ),
        (
            "process_noise",
            "state or free parameter",
            estimation.process_noise,
            (*estimation.start, *estimation.initial),
        ),
    )
    for key, kind, names, known in tables:
        for name in names:
            refuse_unknown(kind, name, known, f"{place}, key {key}")
    refuse_held_start(estimation)
    try:
        started = model.with_values(
            {**{name: start.value for name, start in estimation.start.items()}, **estimation.held}
        )
    except ModelError as fault:
        raise DeclarationError(
            f"{fault.where}: {fault.what}", where=f"{place}, key start", remedy=fault.remedy
        ) from None
    free = started.parameters.only_free(estimation.start).with_prior(
        {name: start.std for name, start in estimation.start.items()}
    )
    initial = (
        replace(
            item,
            value=estimation.initial[item.name].value,
            prior_std=estimation.initial[item.name].std,
        )
        for item in model.initial
    )
    noise = Noise(dict(noise_std), dict(estimation.process_noise))
    return replace(started, parameters=free, initial=ParameterSet(tuple(initial)), noise=noise)


def refuse_held_start(estimation: Estimation) -> None:
    """Raise DeclarationError for a parameter that is both under ``start`` and under ``held``."""
    for name in estimation.held:
        if name in estimation.start:
            raise DeclarationError(
                f"{name} is under start and under held",
                where=f"estimation {estimation.name}, key held",
                remedy="keep one of the two",
            )


def own_biases(model: Model, outputs: Iterable[str]) -> list[str]:
    """Return the outputs whose sensors have a free constant bias in the file."""
    declared = model.equations.biased_outputs if isinstance(model.equations, Biased) else ()
    return [name for name in outputs if name in declared]


# ---- From the flight tables of a scenario file to a FlightPlan


def flight_of(
    flight: FlightTable, fitted: str, where: str, files: Mapping[str, OwnModel], key: str = "flight"
) -> FlightPlan:
    """Return the flight of a checked table, SI; ``key`` is the table's in messages."""
    place = f"{where}, key {key}"
    own = own_vehicle_of(flight.vehicle, flight.values, flight.modes, place, files)
    refuse_other_equations(own, fitted, where)
    if own is not None and flight.derivatives:
        remedy = "put its true values under flight.values"
        raise DeclarationError(
            "a model of your own has no derivatives of a vehicle",
            where=f"{place}.derivatives",
            remedy=remedy,
        )
    model = own or fitted
    return FlightPlan(
        flight.vehicle,
        positive_si(flight.duration, "s", f"{place}.duration"),
        positive_si(flight.rate, "1/s", f"{place}.rate", {"hz": "1/s"}),
        maneuver_plans(flight.maneuvers, place, model),
        standard_deviations(flight.noise_std, flight.noise_variance, place, model),
        flight.modes,
        positive_si(flight.step, "s", f"{place}.step"),
        flight.integration,
        {
            name: density(name, value, f"{place}.process_noise.{name}", model)
            for name, value in flight.process_noise.items()
        },
        dict(flight.derivatives),
        {name: dict(gains) for name, gains in flight.feedback.items()},
        own,
        flight.frequency_factor,
    )


def other_flight_of(
    flight: FlightTable,
    other: OtherFlightTable | None,
    fitted: str,
    where: str,
    key: str,
    files: Mapping[str, OwnModel],
) -> FlightPlan | None:
    """Return the scenario's flight with the entries of ``other`` replaced; None without ``other``.

    Either ``noise_std`` or ``noise_variance`` replaces both.
    """
    if other is None:
        return None
    changed = {name: value for name, value in other if value is not None}
    if {"noise_std", "noise_variance"} & changed.keys():
        changed = {"noise_std": {}, "noise_variance": {}, **changed}
    return flight_of(flight.model_copy(update=changed), fitted, where, files, key)


def own_vehicle_of(
    vehicle: str,
    values: Mapping[str, Quantity],
    modes: int,
    place: str,
    files: Mapping[str, OwnModel],
) -> Model | None:
    """Return the user model of a flight with its true values; None for a built-in vehicle."""
    if vehicle in files:
        if modes:
            raise DeclarationError(
                f"{modes} elastic modes asked for",
                where=f"{place}.modes",
                remedy="a model of your own has none",
            )
        return truth_of(files[vehicle].model, values, f"{place}.values")
    if values:
        raise DeclarationError(
            "a built-in vehicle has its own values",
            where=f"{place}.values",
            remedy="leave them out, or name a model of your own",
        )
    return None


def refuse_other_equations(own: Model | None, fitted: str, where: str) -> None:
    """Raise DeclarationError if a built-in model, with its constants, is fitted to a user model."""
    if own is not None and not is_model_file(fitted):
        what = f"a model of your own flies, and {fitted} is fitted"
        raise DeclarationError(
            what,
            where=f"{where}, key estimate.model",
            remedy="name the same file, or another of yours",
        )


def maneuver_plans(
    maneuvers: Sequence[ManeuverTable], place: str, model: str | Model = ""
) -> tuple[ManeuverPlan, ...]:
    """Return the maneuvers with numbers in SI, or in the units of a user's ``model``.

    ``place`` is the key of the flight in messages.
    """
    plans = []
    for number, maneuver in enumerate(maneuvers, start=1):
        key = f"{place}.maneuvers[{number}]"
        given = maneuver.model_dump(exclude_none=True, exclude={"input", "kind"})
        units = {
            "amplitude": unit_of(maneuver.input, model),
            "first_frequency": "rad/s",
            "last_frequency": "rad/s",
        }
        numbers = {
            k: v if k == "harmonics" else si(v, units.get(k, "s"), f"{key}.{k}")
            for k, v in given.items()
        }
        plans.append(ManeuverPlan(maneuver.input, maneuver.kind, numbers))
    return tuple(plans)


def repeated_of(
    content: ScenarioTable, names: Sequence[str], where: str, files: Mapping[str, OwnModel]
) -> Repeated:
    """Return the flights to be repeated: the scenario's flight with some tables replaced."""
    assert content.repeated is not None
    flights = []
    for number, given in enumerate(content.repeated.flights, start=1):
        unknown = [name for name in given.methods if name not in names]
        if unknown:
            place = f"{where}, key repeated.flights[{number}].methods"
            raise DeclarationError(
                f"there is no method {unknown[0]!r}", where=place, remedy=f"use {', '.join(names)}"
            )
        changed = {
            key: value
            for key, value in given.model_dump(exclude={"label", "methods"}).items()
            if value is not None
        }
        flight = flight_of(
            content.flight.model_copy(update=changed), content.estimate.model, where, files
        )
        flights.append(Variation(given.label, flight, tuple(given.methods or names)))
    return Repeated(content.repeated.runs, tuple(flights))


# ---- From the content of a scenario file


def scenario_of(document: Mapping[str, Any], name: str, where: str) -> Scenario:
    """Return a Scenario from the content of its file; ``where`` names the file in messages.

    A method under ``[[methods]]`` inherits all keys of ``[estimate]`` that it does not give. Its
    tables ``start``, ``initial`` and ``held`` replace single entries, its ``flight`` keys of
    ``[flight]``.

    Raises
    ------
    DeclarationError : an unknown or missing key, a wrong value or unit: one line, file and key.
    """
    content = checked(ScenarioTable, document, where)
    base = dict(document["estimate"])
    files = model_files(
        [
            content.flight.vehicle,
            content.estimate.model,
            *(str(change.get("model", "")) for change in content.methods),
        ]
    )
    flight = flight_of(content.flight, content.estimate.model, where, files)
    _refuse_aircraft_keys(content, flight.own, where)
    estimations = [estimation_of(content.estimate, "main", where, flight, files)]
    for number, change in enumerate(content.methods, start=1):
        merged = {**base, **change}
        for table in ("start", "initial", "held"):
            if isinstance(change.get(table), dict) and isinstance(base.get(table), dict):
                merged[table] = {**base[table], **change[table]}
        method = checked(MethodTable, merged, where, f"methods[{number}]")
        place = f"{where}, key methods[{number}]"
        if why := unportable(method.name):
            remedy = "its files have it in their names: give it another one"
            raise DeclarationError(
                f"the name {method.name!r} {why}", where=f"{place}.name", remedy=remedy
            )
        if method.name.lower() in [estimation.name.lower() for estimation in estimations]:
            raise DeclarationError(
                f"the name {method.name!r} is taken",
                where=f"{place}.name",
                remedy="give each method a name of its own",
            )
        own_flight = other_flight_of(
            content.flight, method.flight, method.model, where, f"methods[{number}].flight", files
        )
        if method.distance and own_flight is None:
            raise DeclarationError(
                "this method sees the scenario's flight",
                where=f"{place}.distance",
                remedy="leave it out, or give it a flight",
            )
        declared = estimation_of(method, method.name, where, own_flight or flight, files)
        choices = choices_of(method.own, merged, f"{place}.own")
        estimations.append(
            replace(declared, flight=own_flight, distance=method.distance or "", choices=choices)
        )
    _refuse_other_flights(content, estimations, where)
    filters = [estimation for estimation in estimations if estimation.method == "ekf"]
    if content.estimate.engine is not None and not filters:
        what = "an engine is named, and no method is an extended Kalman filter"
        raise DeclarationError(
            what,
            where=f"{where}, key estimate.engine",
            remedy='leave it out, or write method = "ekf"',
        )
    return Scenario(
        name,
        content.title,
        " ".join(content.about.split()),
        content.distance,
        flight,
        tuple(estimations),
        content.condensed,
        dict(content.display),
        content.seed,
        flight_phase_of(content.aircraft_class, content.flight_phase)
        if content.aircraft_class or content.flight_phase
        else None,
        tuple(file.identity for file in files.values()),
        repeated_of(content, [e.name for e in estimations if e.flight is None], where, files)
        if content.repeated
        else None,
        _sweep_plan(content, estimations, where),
        content.determination,
        choices_of(content.own, document, f"{where}, key own"),
    )


def _sweep_plan(
    content: ScenarioTable, estimations: Sequence[Estimation], where: str
) -> SweepPlan | None:
    """Return the structures of a sweep, from stiff to soft."""
    if content.sweep is None:
        return None
    place = f"{where}, key sweep"
    if not content.condensed or content.flight.modes < 1:
        raise DeclarationError(
            "there is no structure to soften",
            where=place,
            remedy="fly elastic modes, with condensed = true",
        )
    if estimations[0].modes or estimations[0].model != "rigid":
        raise DeclarationError(
            "the main method is no rigid model",
            where=place,
            remedy='write model = "rigid" under [estimate]',
        )
    if content.flight.feedback or content.flight.process_noise:
        raise DeclarationError(
            "feedback or random forcing in a sweep",
            where=place,
            remedy="leave it out of the flight",
        )
    factors = tuple(sorted(set(content.sweep.frequency_factors), reverse=True))
    for number, mark in enumerate(content.sweep.marks, start=1):
        if mark.frequency_factor not in factors:
            known = ", ".join(f"{factor:g}" for factor in factors)
            raise DeclarationError(
                "no such factor",
                where=f"{place}.marks[{number}].frequency_factor",
                remedy=f"use one of {known}",
            )
    return SweepPlan(
        factors,
        tuple(
            Mark(mark.label, mark.frequency_factor, _choice(mark.published))
            for mark in content.sweep.marks
        ),
    )


def _choice(published: PublishedTable | None) -> PublishedChoice | None:
    return PublishedChoice(published.file, published.table, published.column) if published else None


def _label(estimate: EstimateTable, name: str) -> str:
    """Return the method's label, with the number of passes if more than one."""
    label = estimate.label or name
    repeated = estimate.method in FILTERS and estimate.passes > 1
    return f"{label}, {estimate.passes} passes" if repeated else label


def estimation_of(
    estimate: EstimateTable,
    name: str,
    where: str,
    flight: FlightPlan,
    files: Mapping[str, OwnModel],
) -> Estimation:
    """Return the estimation of a checked table; ``name``: ``"main"`` or the name of a method."""
    place = f"{where}, key {'estimate' if name == 'main' else f'methods {name}'}"
    own = files[estimate.model].model if estimate.model in files else None
    model = own or estimate.model
    _refuse_missing(estimate, own, place)
    declared = Estimation(
        name=name,
        label=_label(estimate, name),
        model=estimate.model,
        outputs=tuple(estimate.outputs or ()),
        start={
            key: _start(key, value, f"{place}.start.{key}", model)
            for key, value in (estimate.start or {}).items()
        },
        initial={
            key: _start(key, value, f"{place}.initial.{key}", model)
            for key, value in (estimate.initial or {}).items()
        },
        method=estimate.method,
        modes=estimate.modes,
        held={
            key: si(value, unit_of(key, model), f"{place}.held.{key}")
            for key, value in estimate.held.items()
        },
        noise_std=standard_deviations(estimate.noise_std, estimate.noise_variance, place, model),
        process_noise={
            key: density(key, value, f"{place}.process_noise.{key}", model)
            for key, value in estimate.process_noise.items()
        },
        integration=estimate.integration,
        terms=estimate.terms,
        max_step=math.inf
        if estimate.max_step is None
        else positive_si(estimate.max_step, "s", f"{place}.max_step"),
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


def _refuse_aircraft_keys(content: ScenarioTable, own: Model | None, where: str) -> None:
    """Raise DeclarationError for keys that only make sense for an aircraft."""
    aircraft = content.estimate.model != "ballistic" and (own is None or is_of_aircraft(own))
    without_meaning = {"condensed": content.condensed and own is not None}
    without_meaning |= {
        key: getattr(content, key) is not None and not aircraft
        for key in ("aircraft_class", "flight_phase")
    }
    for key, refused in without_meaning.items():
        if refused:
            raise DeclarationError(
                "this is for aircraft, and none flies",
                where=f"{where}, key {key}",
                remedy="leave it out",
            )


def _refuse_other_flights(
    content: ScenarioTable, estimations: Sequence[Estimation], where: str
) -> None:
    """Raise DeclarationError for a method's own flight in a sweep, whose methods share flights."""
    own = [number for number, method in enumerate(estimations) if method.flight is not None]
    if own and content.sweep:
        raise DeclarationError(
            "a sweep is flown once for all methods",
            where=f"{where}, key methods[{own[0]}].flight",
            remedy="leave it out",
        )


def _refuse_missing(estimate: EstimateTable, own: Model | None, place: str) -> None:
    """Raise DeclarationError for missing keys that only a user's model file can supply."""
    missing = [key for key in ("outputs", "start", "initial") if getattr(estimate, key) is None]
    if own is None and missing:
        word = "key" if len(missing) == 1 else "keys"
        raise DeclarationError(
            f"{word} missing: {', '.join(missing)}",
            where=place,
            remedy="add " + ("it" if len(missing) == 1 else "them"),
        )


def _start(name: str, spread: SpreadTable, where: str, model: str | Model) -> Start:
    std = si(spread.std, unit_of(name, model), f"{where}.std")
    if not std > 0:
        raise DeclarationError(
            f"{spread.std!r} is not above 0",
            where=f"{where}.std",
            remedy="give a standard deviation above zero",
        )
    return Start(si(spread.value, unit_of(name, model), f"{where}.value"), std)
