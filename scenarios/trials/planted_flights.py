"""Records, vehicle file and truth of a tracing scenario.

Also the schema of tracing scenarios (pydantic), and conversion of a checked file to a
TraceScenario.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, Field

from ident.flying_qualities.modes import slowest_oscillation
from scenarios.files.aircraft_files import toml_key, vehicle_file_text
from scenarios.files.declarations import checked
from scenarios.files.schemas import VEHICLES_SCHEMA_STRICT
from scenarios.files.vehicles import MODELS
from scenarios.files.writing import write_text
from scenarios.studies.declaration import ManeuverPlan, maneuvers_by_input, with_common_hold
from scenarios.studies.estimating import resting
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
    positive_si,
    si,
    standard_deviations,
)
from scenarios.trials.planted_declaration import (
    CLOSED_LOOP,
    Expectation,
    HiddenTerm,
    RecordPlan,
    TraceFlight,
    TraceScenario,
    hidden_units,
    true_vehicle,
    with_breakout,
    with_hidden,
)
from sim.closed_loop.airframe import X29
from sim.closed_loop.linear import EquivalentSystem
from sim.declaration.compile import compile_model
from sim.declaration.effect import Parameter
from sim.declaration.model import Model, System
from sim.errors import DeclarationError
from sim.maneuvers import Sum
from sim.maths import complex_step_jacobian
from sim.record import Channel, Record
from sim.truth.flight import fly, sample_times
from sim.vehicles.aircraft import declaration_of
from sim.vehicles.factory import FAMILIES, LOES_CONSTANTS, MODE_CONSTANTS, RIGID_CONSTANTS
from sim.vehicles.library import read_parameter_set, vehicle_names

# The constant terms of a low-order equivalent stay at zero.
CONSTANTS = {
    **{name: tuple(constants) for name, (_, constants, _) in FAMILIES.items()},
    "loes": tuple(LOES_CONSTANTS),
    "flexible": tuple(RIGID_CONSTANTS),
}
FILE_NAMES = {"omega": "frequency", "zeta": "damping", "generalized_mass": "generalized_mass"}


@dataclass(frozen=True, eq=False)
class SimulatedTrace:
    """The records of a tracing scenario with their truth.

    Attributes
    ----------
    derivatives : true values (SI) of the declared model's parameters; for a closed loop, of the
        low-order equivalent of its linear frequency response.
    hidden : true parameters of each hidden term in the training record.
    vehicle_file : text of the vehicle file for the tracing loop.
    test : third record, not used by the loop.
    noise_free : training record without sensor noise.
    """

    train: Record
    validate: Record
    derivatives: Mapping[str, float]
    hidden: Mapping[str, Mapping[str, float]]
    noise_std: Mapping[str, float]
    step: float
    vehicle_file: str
    test: Record
    noise_free: Record


def fly_trace(scenario: TraceScenario, seed: int) -> SimulatedTrace:
    """Simulate the records of a scenario; the same seed gives the same bytes.

    Their noise is independent.

    Raises
    ------
    DeclarationError : a maneuver or a hidden term lacks a number, or moves an unknown input.
    """
    first, second, third = np.random.default_rng(seed).spawn(3)
    if scenario.flight.vehicle.startswith(CLOSED_LOOP):
        return _closed_loop(scenario, (first, second, third))
    flight, vehicle = scenario.flight, true_vehicle(scenario.flight)
    train, noise_free = _fly(flight, flight.train, first, "train", validation=False)
    validate, _ = _fly(flight, flight.validate, second, "validate", validation=True)
    test, _ = _fly(flight, flight.test_plan, third, "test", validation=True)
    return SimulatedTrace(
        train,
        validate,
        _derivatives(scenario, vehicle),
        {term.name: dict(term.values) for term in flight.hidden},
        dict(flight.noise_std),
        flight.step,
        started_file(scenario, vehicle),
        test,
        noise_free,
    )


def started_file(scenario: TraceScenario, vehicle: Model) -> str:
    """Return the vehicle file for the tracing loop: true constants, wrong starting values."""
    if scenario.flight.own is not None:
        return _own_text(scenario, vehicle)
    values = {item.name: item.value for item in vehicle.parameters}
    return _vehicle_text(scenario, values, _derivatives(scenario, vehicle))


def _derivatives(scenario: TraceScenario, vehicle: Model) -> dict[str, float]:
    """Return the true values of the parameters that the declared model estimates.

    A rigid model has only those without an elastic mode.
    """
    all_modes = scenario.model == "flexible" or scenario.flight.own is not None
    return {
        item.name: item.value
        for item in vehicle.parameters
        if item.free and (all_modes or not _mode_of(item.name))
    }


def _fly(
    flight: TraceFlight, plan: RecordPlan, rng: np.random.Generator, name: str, *, validation: bool
) -> tuple[Record, Record]:
    model = with_hidden(true_vehicle(flight), flight.hidden, validation=validation)
    return simulated_with_truth(flight, plan, model, rng, name)


def simulated_record(
    flight: TraceFlight, plan: RecordPlan, model: Model, rng: np.random.Generator, name: str
) -> Record:
    """Simulate one record of a flight's plan, with the noise of the model."""
    return simulated_with_truth(flight, plan, model, rng, name)[0]


def simulated_with_truth(
    flight: TraceFlight, plan: RecordPlan, model: Model, rng: np.random.Generator, name: str
) -> tuple[Record, Record]:
    """Simulate one record of a flight's plan; return it with and without sensor noise."""
    inputs = {signal.name for signal in model.equations.inputs}
    by_input = maneuvers_by_input(plan.maneuvers, inputs, f"key flight.{name}", resting(model))
    outputs = [signal.name for signal in model.equations.outputs if signal.name in flight.noise_std]
    time = sample_times(flight.rate, plan.duration)
    if flight.own is not None:
        by_input = with_common_hold(by_input, plan.maneuvers, time)
    record, truth = fly(
        model,
        by_input,
        time,
        rng,
        step=min(flight.step, 1.0 / flight.rate),
        outputs=outputs,
        name=name,
    )
    return record, with_outputs(record, [truth.outputs[channel.name] for channel in record.outputs])


def with_outputs(record: Record, rows: Sequence[np.ndarray]) -> Record:
    """Return a record with other values ``(N,)`` of each output, none of them missing."""
    outputs = zip(record.outputs, rows, strict=True)
    return replace(
        record,
        outputs=tuple(Channel.of(channel.name, channel.unit, row) for channel, row in outputs),
    )


def fly_loop(
    scenario: TraceScenario,
    plan: RecordPlan,
    where: str,
    rng: np.random.Generator,
    curvature: float | None = None,
) -> tuple[Record, Record]:
    """Simulate one record of a closed loop; return it with and without sensor noise.

    ``curvature`` replaces that of the gearing.

    Raises
    ------
    DeclarationError : the aircraft departs.
    """
    from sim.closed_loop.nonlinear import FlightOutcome, fly_closed_loop

    aircraft = with_breakout(loop_of(scenario), scenario.flight.hidden)
    if curvature is not None:
        aircraft = replace(aircraft, stick=replace(aircraft.stick, curvature=curvature))
    record, truth = fly_closed_loop(aircraft, _stick(plan.maneuvers, where), plan.duration, rng)
    if truth.outcome is not FlightOutcome.COMPLETED:
        raise DeclarationError("the aircraft departs", where=where, remedy="fly smaller maneuvers")
    return record, with_outputs(record, list(truth.recorded))


def loop_of(scenario: TraceScenario) -> X29:
    """Return the closed loop that a scenario flies, without the hidden break-out."""
    from sim.closed_loop.airframe import load_x29

    return load_x29(scenario.flight.vehicle.removeprefix(CLOSED_LOOP))


def equivalent_of(scenario: TraceScenario) -> EquivalentSystem:
    """Return the equivalent system of the linear loop, with L_q of the airframe.

    The control law does not change the lift equation.
    """
    from sim.closed_loop.linear import equivalent_system

    loop = loop_of(scenario)
    return equivalent_system(loop, L_q=loop.airframe.L_q)


def _closed_loop(
    scenario: TraceScenario, generators: Sequence[np.random.Generator]
) -> SimulatedTrace:
    from scenarios.x29.declaration import equivalent_values, loop_constants, telemetry_noise

    flight, loop = scenario.flight, loop_of(scenario)
    plans = {"train": flight.train, "validate": flight.validate, "test": flight.test_plan}
    simulated = [
        fly_loop(scenario, plan, f"key flight.{name}", rng)
        for (name, plan), rng in zip(plans.items(), generators, strict=True)
    ]
    values = equivalent_values(equivalent_of(scenario))
    hidden = {term.name: dict(term.values) for term in flight.hidden}
    (train, noise_free), (validate, _), (test, _) = simulated
    text = _vehicle_text(scenario, loop_constants(loop), values)
    noise = telemetry_noise(loop)
    return SimulatedTrace(
        train, validate, values, hidden, noise, loop.frame, text, test, noise_free
    )


def _stick(plans: tuple[ManeuverPlan, ...], where: str) -> Sum:
    moved = maneuvers_by_input(plans, {"stick"}, where)
    return Sum((moved["stick"],)) if moved else Sum()


def _class_of(vehicle: str) -> str:
    """Return the aircraft class of a vehicle in MIL-F-8785C: IV, fighter, in a closed loop."""
    if vehicle.startswith(CLOSED_LOOP):
        return "IV"
    return read_parameter_set(vehicle).aircraft_class if vehicle in vehicle_names() else ""


def _vehicle_text(
    scenario: TraceScenario, values: Mapping[str, float], derivatives: Mapping[str, float]
) -> str:
    """Return a vehicle file with derivatives wrong by ``wrong``, with alternating sign.

    The scenario's ``start`` replaces values by name.
    """
    _refuse_unknown_starts(scenario, derivatives)
    started = {
        name: value * (1.0 + scenario.wrong * (-1.0) ** i)
        for i, (name, value) in enumerate(derivatives.items())
    }
    started |= dict(scenario.start)
    of_class = _class_of(scenario.flight.vehicle)
    lines = [
        f'name = "{scenario.flight.vehicle}"',
        *([f'aircraft_class = "{of_class}"'] if of_class else []),
        *(f"{name} = {values[name]!r}" for name in CONSTANTS[scenario.model]),
    ]
    modal = {name: number for name in started if (number := _mode_of(name))}
    lines += [
        "[derivatives]",
        *(f"{name} = {value!r}" for name, value in started.items() if name not in modal),
    ]
    for number in sorted(set(modal.values())):
        lines += [
            "[[modes]]",
            *(
                f"{key} = {values[f'{name}{number}']!r}"
                for name, key in FILE_NAMES.items()
                if name in MODE_CONSTANTS
            ),
        ]
        lines += [
            f"{name} = {value!r}" for name, value in started.items() if modal.get(name) == number
        ]
    return "\n".join(lines) + "\n"


def _own_text(scenario: TraceScenario, model: Model) -> str:
    """Return the vehicle file of a user model: its constants, and wrong parameters."""
    free = {item.name: item for item in model.parameters if item.free}
    _refuse_unknown_starts(scenario, free)
    started = {
        name: off(item, scenario.wrong * (-1.0) ** i) for i, (name, item) in enumerate(free.items())
    } | dict(scenario.start)
    aircraft = declaration_of(model)
    if aircraft is not None:
        return vehicle_file_text(aircraft.with_values(started))
    lines = [
        f"name = {json.dumps(model.name)}",
        *(f"{toml_key(item.name)} = {item.value!r}" for item in model.parameters if not item.free),
    ]
    lines += [
        "[derivatives]",
        *(f"{toml_key(name)} = {value!r}" for name, value in started.items()),
    ]
    return "\n".join(lines) + "\n"


def off(item: Parameter, share: float) -> float:
    """Return a starting value that is wrong by a share of the true one.

    If that is out of bounds, it is wrong to the other side, or half-way to a bound.
    """
    low, high = item.bounds
    for value in (item.value * (1.0 + share), item.value * (1.0 - share)):
        if low <= value <= high:
            return value
    return 0.5 * (item.value + (low if item.value * share < 0.0 else high))


def _refuse_unknown_starts(scenario: TraceScenario, allowed: Collection[str]) -> None:
    unknown = set(scenario.start) - set(allowed)
    if unknown:
        what = f"there is no {', '.join(sorted(unknown))}"
        raise DeclarationError(what, where="key estimate.start", remedy=f"use {', '.join(allowed)}")


def _mode_of(name: str) -> int:
    """Return the number of the elastic mode that a derivative belongs to, 0 for a rigid one:
    ``CL_eta1``, ``Ceta1_q``.
    """
    if name.startswith("Ceta"):
        return int(name[4 : name.index("_")])
    digits = "".join(c for c in name if c.isdigit())
    return int(digits) if "_eta" in name and digits else 0


def write_simulated(simulated_flight: SimulatedTrace, folder: Path) -> tuple[Path, Path, Path]:
    """Write training record, validation record and vehicle file; return their paths.

    The tracing loop knows nothing else of the flight.
    """
    from scenarios.files.writing import write_record

    train, _ = write_record(folder, simulated_flight.train, "train", simulated=True)
    validate, _ = write_record(folder, simulated_flight.validate, "validate", simulated=True)
    vehicle = folder / "vehicle.toml"
    write_text(vehicle, simulated_flight.vehicle_file)
    return train, validate, vehicle


# ---- Schema of tracing scenarios

Name = Annotated[str, Field(min_length=1)]


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
    """Return a TraceScenario from the content of its file; ``where`` names the file in messages.

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
            positive_si(flight.rate, "1/s", f"{place}.rate", {"hz": "1/s"}),
            positive_si(flight.step, "s", f"{place}.step"),
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
    duration = positive_si(record.duration, "s", f"{where}.duration")
    return RecordPlan(duration, maneuver_plans(record.maneuvers, where, model))


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


# ---- Modes of the true aircraft


def elastic_modes(
    system: System, p: np.ndarray, fixed_states: Collection[str] = ()
) -> dict[str, float]:
    """Return undamped frequency (rad/s) and damping ratio of the elastic modes at rest.

    They are the oscillations without the slowest one, the short period.
    """
    n, u = len(system.states), [0.0] * len(system.inputs)
    F = complex_step_jacobian(lambda x: system.f(0.0, x, u, p.tolist()), [0.0] * n)
    moving = [i for i, state in enumerate(system.states) if state.name not in fixed_states]
    roots = [root for root in np.linalg.eigvals(F[np.ix_(moving, moving)]) if root.imag > 1e-9]
    out = {}
    for number, root in enumerate(sorted(roots, key=abs)[1:], start=1):
        out[f"elastic_mode_{number}_frequency"] = float(abs(root))
        out[f"elastic_mode_{number}_damping"] = float(-root.real / abs(root))
    return out


def true_modes(vehicle: Model) -> dict[str, float]:
    """Return the modes of a true vehicle from its own equations, without a fit."""
    system = compile_model(vehicle)
    p = system.parameters.values()
    short_period = slowest_oscillation(system, p) or ()
    named = dict(zip(("natural_frequency", "damping_ratio"), short_period, strict=False))
    return named | elastic_modes(system, p)


def modes_of_truth(scenario: TraceScenario) -> dict[str, float]:
    """Return frequencies and damping ratios of the true aircraft by its own equations.

    Empty for models whose states are not zero in trim.
    """
    flight = scenario.flight
    if flight.vehicle.startswith(CLOSED_LOOP):
        equivalent = equivalent_of(scenario)
        return {
            "natural_frequency": equivalent.natural_frequency,
            "damping_ratio": equivalent.damping_ratio,
        }
    return true_modes(true_vehicle(flight)) if scenario.model in ("rigid", "flexible") else {}
