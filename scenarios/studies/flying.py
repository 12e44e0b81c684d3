"""From a scenario's flight to a record and its truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from scenarios.files.own_models import inputs_at_rest
from scenarios.studies.declaration import Flight, ManeuverPlan, Scenario
from sim.declaration.model import Model, Noise
from sim.errors import DeclarationError
from sim.maneuvers import Maneuver, MultiStep, Sum, Sweep, doublet, pulse, schroeder_multisine, step, three_two_one_one
from sim.propagation import euler_step, rk4_step
from sim.record import Record
from sim.truth.feedback import fly_with_feedback
from sim.truth.flight import Distance, Truth, fly, remeasure, sample_times
from sim.vehicles.factory import WHOLE_AXES, ballistic_model, flexible_model, rigid_model, whole_axis_model
from sim.vehicles.flexibility import with_frequency_factor
from sim.vehicles.library import VehicleData, read_parameter_set

EVER = -1e6  # s, since when an input has been at rest: before all that a record or an effect looks back to
SMOOTH = ("sweep", "multisine")
STEPS = {"rk4": rk4_step, "euler": euler_step}

DISTANCES = {
    "same equations and step": Distance.SAME_EQUATIONS,
    "same equations, finer step": Distance.OTHER_STEP,
    "same equations, other values": Distance.OTHER_VALUES,
    "effect missing": Distance.EFFECT_MISSING,
}


def true_model(flight: Flight) -> Model:
    """The vehicle that really flies, with its noise."""
    noise = Noise(flight.noise_std, flight.process_noise)
    if flight.own is not None:
        return flight.own.with_noise(noise)
    model = vehicle_model(flight.vehicle, flight.modes, noise, flight.frequency_factor)
    free = model.parameters.free_names
    for name in flight.derivatives:
        if name not in free:
            raise DeclarationError(f"there is no derivative {name!r}", where="key flight.derivatives", remedy=f"use {', '.join(free)}")
    return model.with_values(flight.derivatives)


def vehicle_model(vehicle: str, modes: int, noise: Noise, frequency_factor: float = 1.0) -> Model:
    """A built-in vehicle with so many of its elastic modes, their frequencies by a factor."""
    data = with_frequency_factor(read_parameter_set(vehicle), frequency_factor)
    if modes and not data.modes:
        raise DeclarationError(f"{modes} elastic modes asked for", where=f"vehicle {data.name}", remedy="it has none")
    if data.equations == "ballistic":
        return ballistic_model(data, noise)
    if data.equations in WHOLE_AXES:
        return whole_axis_model(data, noise)
    return flexible_model(data, modes, noise) if modes else rigid_model(data, noise)


def flown_vehicle(flight: Flight) -> VehicleData:
    """The numbers of the built-in vehicle that flies."""
    return with_frequency_factor(read_parameter_set(flight.vehicle), flight.frequency_factor)


def fly_scenario(scenario: Scenario, seed: int, where: str = "") -> tuple[Record, Truth]:
    """Fly the truth of a scenario; the same seed gives the same bytes.

    Raises
    ------
    DeclarationError : a maneuver lacks a number or moves an input that is not there, or noise is declared for no output.
    """
    flight = scenario.flight
    model = true_model(flight)
    place = where or "key flight"
    inputs = {signal.name for signal in model.equations.inputs}
    outputs = {signal.name for signal in model.equations.outputs}
    for name in flight.noise_std:
        if name not in outputs:
            raise DeclarationError(f"there is no output {name!r}", where=f"{place}.noise", remedy=f"its outputs are {', '.join(sorted(outputs))}")
    by_input = maneuvers_by_input(flight.maneuvers, inputs, place, resting(model))
    time = sample_times(flight.rate, flight.duration)
    if flight.own is not None:
        by_input = held_alike(by_input, flight.maneuvers, time)
    measured = [name for name in (signal.name for signal in model.equations.outputs) if name in flight.noise_std]
    common: dict[str, Any] = {
        "step": min(flight.step, 1.0 / flight.rate),
        "method": STEPS.get(flight.integration),  # none: to a tolerance
        "outputs": measured,
        "distance": DISTANCES[scenario.distance],
        "name": scenario.name,
    }
    rng = np.random.default_rng(seed)
    if flight.feedback:
        return fly_with_feedback(model, by_input, flight.feedback, time, rng, **common)
    return fly(model, by_input, time, rng, **common)


def resting(model: Model) -> dict[str, float]:
    """Where the inputs of an own model rest, by name, where that is not zero."""
    names = [signal.name for signal in model.equations.inputs]
    return {name: value for name, value in zip(names, inputs_at_rest(model), strict=True) if value}


def maneuvers_by_input(
    plans: Sequence[ManeuverPlan], inputs: Collection[str], place: str, rest: Mapping[str, float] = MappingProxyType({})
) -> dict[str, Maneuver]:
    """What moves each input, about where it rests; several maneuvers on one add up. ``place`` is the key of the flight they belong to.

    Raises
    ------
    DeclarationError : a maneuver lacks a number or moves an input that is not there.
    """
    by_input = {name: Sum((step(value, EVER),)) for name, value in rest.items()}
    for number, plan in enumerate(plans, start=1):
        if plan.input not in inputs:
            known = ", ".join(sorted(inputs)) or "none"
            raise DeclarationError(f"there is no input {plan.input!r}", where=f"{place}.maneuvers[{number}]", remedy=f"its inputs are {known}")
        before = by_input.get(plan.input, Sum())
        by_input[plan.input] = Sum((*before.parts, maneuver_of(plan, f"{place}.maneuvers[{number}]")))
    return {**by_input}


def held_alike(by_input: Mapping[str, Maneuver], plans: Sequence[ManeuverPlan], time: np.ndarray) -> dict[str, Maneuver]:
    """Maneuvers that a record can hold: beside steps on any input a smooth one is fed sample by sample.

    Between the samples ``time`` (s) a record's inputs are all held or all linear, and read the other way a step is half a sample late.
    """
    smooth = {plan.input for plan in plans if plan.kind in SMOOTH}
    if all(plan.kind in SMOOTH for plan in plans):
        return {**by_input}
    times = (EVER, *time[1:].tolist(), math.inf)
    return {**by_input, **{name: MultiStep(tuple(np.asarray(by_input[name](time)).tolist()), times) for name in smooth}}


def measured_again(record: Record, truth: Truth, noise_std: Mapping[str, float], seed: int) -> Record:
    """The same flight with sensors of other noise."""
    std = {**truth.noise_std, **noise_std}
    return remeasure(record, replace(truth, noise_std=std), np.random.default_rng(seed))


def maneuver_of(plan: ManeuverPlan, where: str) -> Maneuver:
    """The maneuver that a plan describes.

    Raises
    ------
    DeclarationError : a number that the kind needs is missing, or one is given that it does not take.
    """
    needed, build = KINDS[plan.kind]
    for name in needed:
        if name not in plan.numbers:
            raise DeclarationError(f"{name} is missing", where=where, remedy=f"a {plan.kind} needs {', '.join(needed)}")
    for name in plan.numbers:
        if name not in (*needed, "start"):
            raise DeclarationError(f"a {plan.kind} takes no {name}", where=where, remedy=f"it takes {', '.join((*needed, 'start'))}")
    return build(plan.numbers)


KINDS: Mapping[str, tuple[tuple[str, ...], Callable[[Mapping], Maneuver]]] = {
    "3-2-1-1": (("amplitude", "unit"), lambda n: three_two_one_one(n["amplitude"], n["unit"], n["start"])),
    "doublet": (("amplitude", "unit"), lambda n: doublet(n["amplitude"], n["unit"], n["start"])),
    "pulse": (("amplitude", "unit"), lambda n: pulse(n["amplitude"], n["unit"], n["start"])),
    "step": (("amplitude",), lambda n: step(n["amplitude"], n["start"])),
    "sweep": (
        ("amplitude", "first_frequency", "last_frequency", "duration"),
        lambda n: Sweep(n["amplitude"], n["first_frequency"], n["last_frequency"], n["duration"], n["start"], taper=0.1 * n["duration"]),
    ),
    "multisine": (
        ("amplitude", "duration", "harmonics"),
        lambda n: schroeder_multisine(n["amplitude"], n["duration"], tuple(n["harmonics"]), n["start"]),
    ),
}
