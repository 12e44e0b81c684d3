"""From the tables of a flight, as a scenario file has them, to what is flown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from scenarios.files.own_models import OwnModel, is_model_file
from scenarios.studies.declaration import Flight, ManeuverPlan, Repeated, Variation
from scenarios.studies.scenario_file.own import truth_of
from scenarios.studies.scenario_file.quantities import Quantity, density, positive, si, standard_deviations, unit_of
from scenarios.studies.scenario_file.schema import FlightTable, Maneuver, OtherFlightTable, ScenarioTable
from sim.declaration.model import Model
from sim.errors import DeclarationError


def flight_of(flight: FlightTable, fitted: str, where: str, files: Mapping[str, OwnModel], key: str = "flight") -> Flight:
    """The flight of a checked table, SI; ``key`` is the table's in messages."""
    place = f"{where}, key {key}"
    own = own_vehicle_of(flight.vehicle, flight.values, flight.modes, place, files)
    refuse_other_equations(own, fitted, where)
    if own is not None and flight.derivatives:
        remedy = "put its true values under flight.values"
        raise DeclarationError("a model of your own has no derivatives of a vehicle", where=f"{place}.derivatives", remedy=remedy)
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
        flight.frequency_factor,
    )


def other_flight_of(
    flight: FlightTable, other: OtherFlightTable | None, fitted: str, where: str, key: str, files: Mapping[str, OwnModel]
) -> Flight | None:
    """The scenario's flight with what ``other`` gives in the place of its own; None without. Noise of one kind replaces both kinds."""
    if other is None:
        return None
    changed = {name: value for name, value in other if value is not None}
    if {"noise_std", "noise_variance"} & changed.keys():
        changed = {"noise_std": {}, "noise_variance": {}, **changed}
    return flight_of(flight.model_copy(update=changed), fitted, where, files, key)


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


def repeated_of(content: ScenarioTable, names: Sequence[str], where: str, files: Mapping[str, OwnModel]) -> Repeated:
    """The flights to be repeated: each the scenario's own with those tables replaced that it gives itself."""
    assert content.repeated is not None
    flights = []
    for number, given in enumerate(content.repeated.flights, start=1):
        unknown = [name for name in given.methods if name not in names]
        if unknown:
            place = f"{where}, key repeated.flights[{number}].methods"
            raise DeclarationError(f"there is no method {unknown[0]!r}", where=place, remedy=f"use {', '.join(names)}")
        changed = {key: value for key, value in given.model_dump(exclude={"label", "methods"}).items() if value is not None}
        flight = flight_of(content.flight.model_copy(update=changed), content.estimate.model, where, files)
        flights.append(Variation(given.label, flight, tuple(given.methods or names)))
    return Repeated(content.repeated.runs, tuple(flights))
