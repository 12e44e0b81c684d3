"""Compilation of a declared Model to its System of five array functions."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import count
from operator import itemgetter
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from sim.declaration.effect import (
    Anticipating,
    ClockEffect,
    Commuting,
    DynamicsEffect,
    Effect,
    GroupEffect,
    InputEffect,
    NoiseEffect,
    OnlineForm,
    Parameter,
    ParameterEffect,
    ParameterSet,
    ReadingEffect,
    RememberingEffect,
    SensorEffect,
    SensorMemory,
    Signal,
    StateJumpEffect,
    Station,
    full_name,
    in_order,
    rates_read_by,
)
from sim.declaration.model import Model, Rows, System, Tie, with_tied_values
from sim.declaration.user_arguments import (
    Signals,
    lock_arrays,
    locks_arrays,
    with_locked_arrays,
)
from sim.declaration.user_equations import (
    UserEquations,
)
from sim.errors import ModelError

# ---- Parts of a declared model

_FOLLOWS: WeakKeyDictionary[type, dict[Any, bool]] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class EffectStages:
    """The effects of a model by stage, in the order in which they act on a signal.

    Attributes
    ----------
    inputs, sensors : effects that act on whole paths.
    online_inputs, online_sensors : input and sensor effects whose states are among those of an
        on-line System.
    varying, varying_groups : effects that change parameters of the equations.
    jumps : effects that make states of the equations jump.
    clocks : effects that scale the time of ``dynamics``.
    slices : by effect name, the places of its states among ``states``.
    select : by effect name, a function that selects its parameters from those of the model.
    vehicle_of : a function that selects the parameters of the equations.
    bias_index : by output, the place of its bias among the parameters.
    """

    model: Model
    outputs: tuple[Signal, ...]
    inputs: tuple[InputEffect, ...]
    online_inputs: tuple[Any, ...]
    varying: tuple[ParameterEffect, ...]
    varying_groups: tuple[GroupEffect, ...]
    dynamics: tuple[DynamicsEffect, ...]
    readings: tuple[ReadingEffect, ...]
    sensors: tuple[SensorEffect, ...]
    online_sensors: tuple[Any, ...]
    jumps: tuple[StateJumpEffect, ...]
    clocks: tuple[ClockEffect, ...]
    states: tuple[Signal, ...]
    slices: Mapping[str, slice]
    select: Mapping[str, Callable[[Rows], Any]]
    vehicle_of: Callable[[Rows], Any]
    bias_index: Mapping[str, int]

    @property
    def state_names(self) -> tuple[str, ...]:
        return tuple(signal.name for signal in self.states)

    @property
    def input_names(self) -> tuple[str, ...]:
        return tuple(signal.name for signal in self.model.equations.inputs)


def parts_of(model: Model, outputs: Sequence[str] | None, online: bool) -> EffectStages:
    """Return the effects of a model by stage.

    Raises ModelError for an unknown output and, with ``online``, an effect that cannot run on line.
    """
    equations = model.equations
    chosen = _chosen_outputs(model, outputs)
    wanted = {signal.name for signal in chosen}
    inputs: list[InputEffect] = in_order(_effects_following(model, InputEffect))
    sensor_effects: list[SensorEffect] = in_order(_effects_following(model, SensorEffect))
    sensors = [effect for effect in sensor_effects if effect.channel in wanted]
    dynamics = _effects_following(model, DynamicsEffect)
    online_inputs, online_sensors = (
        (_with_state_form(model, inputs), _with_state_form(model, sensors)) if online else ([], [])
    )
    states = list(equations.states)
    for effect in dynamics:
        states += effect.states
    slices: dict[str, slice] = {}
    for online_effect in [*online_inputs, *online_sensors]:
        first = len(states)
        states += online_effect.online_states
        slices[online_effect.name] = slice(first, len(states))
    return EffectStages(
        model,
        chosen,
        tuple(effect for effect in inputs if effect not in online_inputs),
        tuple(online_inputs),
        tuple(_effects_following(model, ParameterEffect)),
        tuple(_effects_following(model, GroupEffect)),
        tuple(dynamics),
        tuple(in_order(_effects_following(model, ReadingEffect))),
        tuple(effect for effect in sensors if effect not in online_sensors),
        tuple(online_sensors),
        tuple(_effects_following(model, StateJumpEffect)),
        tuple(_effects_following(model, ClockEffect)),
        tuple(states),
        slices,
        {effect.name: _gather(model, effect) for effect in model.effects},
        _gather_named(model.parameters, equations.parameter_names, "vehicle_parameters"),
        {name: model.parameters.index(f"bias_{name}") for name in model.biases},
    )


def _effects_following(model: Model, protocol: Any) -> list[Any]:
    """Return the effects of a model that follow a protocol.

    Answers are cached by class and attribute names, since the check inspects all attributes.
    """
    result = []
    for effect in model.effects:
        known = _FOLLOWS.setdefault(type(effect), {})
        key = (protocol, *getattr(effect, "__dict__", ()))
        if key not in known:
            known[key] = isinstance(effect, protocol)
        if known[key]:
            result.append(effect)
    return result


def _chosen_outputs(model: Model, outputs: Sequence[str] | None) -> tuple[Signal, ...]:
    known = {signal.name: signal for signal in model.equations.outputs}
    if outputs is None:
        return model.equations.outputs
    for name in outputs:
        if name not in known:
            raise ModelError(
                f"there is no output {name!r}",
                where=f"model {model.name}",
                remedy=f"its outputs are {', '.join(known)}",
            )
    return tuple(known[name] for name in outputs)


def _with_state_form(model: Model, effects: Sequence[Any]) -> list[Any]:
    """Return the effects that have a state form; raise ModelError if another one cannot run on
    line.
    """
    with_form: list[Any] = []
    for effect in effects:
        if isinstance(effect, OnlineForm):
            with_form.append(effect)
            continue
        ahead = isinstance(effect, Anticipating) and effect.anticipates
        if ahead:
            raise ModelError(
                f"effect {effect.name} needs the input's future and cannot run on line",
                where=f"model {model.name}",
                remedy="use a whole-record fit (output-error)",
            )
        free = [
            item.name
            for item in effect.parameters
            if model.parameters[full_name(effect, item.name)].free
        ]
        behind = any(other.signal == effect.signal for other in with_form) and not (
            isinstance(effect, Commuting) and effect.commutes
        )
        if not isinstance(effect, InputEffect) or free or behind:
            raise ModelError(
                f"effect {effect.name} has no state form and cannot run on line",
                where=f"model {model.name}",
                remedy=(
                    "hold its parameters if it acts on an input, or use a whole-record fit "
                    "(output-error)"
                ),
            )
    return with_form


def _gather(model: Model, effect: Effect) -> Callable[[Rows], Any]:
    names = [item.name for item in effect.parameters]
    full = [full_name(effect, name) for name in names]
    return _gather_named(model.parameters, full, "effect_parameters", names)


@cache  # creating the class takes as long as the rest of an effect's compilation
def _view(label: str, fields: tuple[str, ...]) -> Any:
    return namedtuple(label, fields)


def _gather_named(
    parameters: ParameterSet, names: Sequence[str], label: str, fields: Sequence[str] | None = None
) -> Callable[[Rows], Any]:
    view = _view(label, tuple(fields or names))
    index = [parameters.index(name) for name in names]
    if len(index) == 0:
        empty = view()
        return lambda p: empty
    if len(index) == 1:
        only = index[0]
        return lambda p: view(p[only])
    pick = itemgetter(*index)
    return lambda p: view._make(pick(p))


# ---- The five functions of a System

Bus = Callable[[Any, Rows, Rows, Rows], tuple[Signals, Any]]
Measured = Callable[[Signals, Any, Rows], dict[str, Any]]


def signals_of(parts: EffectStages) -> Bus:
    """Return a function of all signals by name at one time, with the contributions of effects, and
    of the vehicle's parameters at that time.
    """
    equations, select, slices = parts.model.equations, parts.select, parts.slices
    online_inputs = parts.online_inputs
    vehicle_of, state_names, input_names = parts.vehicle_of, parts.state_names, parts.input_names
    zero_ports = {port.name: 0.0 for port in equations.ports}
    varying = [(effect.parameter, effect.change, select[effect.name]) for effect in parts.varying]
    together = [(effect.changes, select[effect.name]) for effect in parts.varying_groups]
    dynamics = [(effect, select[effect.name]) for effect in parts.dynamics]
    disturbances = [each for each in dynamics if each[0].station is Station.DISTURBANCE]
    others = [each for each in dynamics if each[0].station is not Station.DISTURBANCE]
    # The flow of a user model may depend on ports, to which effects of the dynamics add after the
    # first evaluation of the flow.
    forms_ports = (
        bool(others)
        and isinstance(equations, UserEquations)
        and equations.flow_function is not None
        and not equations.rate_ports
    )
    users, calls = isinstance(equations, UserEquations), count()

    def signals(t: Any, x: Rows, u: Rows, p: Rows) -> tuple[Signals, Any]:
        s = Signals(time=t, **zero_ports)
        bus = s.__dict__
        bus.update(zip(state_names, x, strict=False))
        bus.update(zip(input_names, u, strict=False))
        vehicle = vehicle_of(p)
        for effect in online_inputs:
            bus[effect.signal] = effect.pass_on(
                bus[effect.signal], x[slices[effect.name]], select[effect.name](p)
            )
        for effect, gather in disturbances:
            for port, value in effect.increments(s, vehicle, gather(p)).items():
                bus[port] = bus[port] + value
        for name, change, gather in varying:
            vehicle = vehicle._replace(**{name: getattr(vehicle, name) + change(s, gather(p))})
        for changes, gather in together:
            vehicle = vehicle._replace(
                **{
                    name: getattr(vehicle, name) + value
                    for name, value in changes(s, gather(p)).items()
                }
            )
        locks = users and locks_arrays(next(calls))
        if locks:
            vehicle = with_locked_arrays(vehicle)
            lock_arrays(bus)
        bus.update(equations.flow(s, vehicle))
        for effect, gather in others:
            for port, value in effect.increments(s, vehicle, gather(p)).items():
                bus[port] = bus[port] + value
        if forms_ports:
            bus.update(equations.flow(s, vehicle))
        if locks:
            lock_arrays(bus)
        return s, vehicle

    return signals


def measured_of(parts: EffectStages) -> Measured:
    """Return a function of all outputs by name as sensors without memory measure them."""
    equations, select, readings = parts.model.equations, parts.select, parts.readings
    base_outputs = tuple(signal.name for signal in equations.outputs)
    rates = (
        tuple(f"{signal.name}_dot" for signal in equations.states)
        if any(rates_read_by(effect) for effect in readings)
        else ()
    )

    def measured(s: Signals, vehicle: Any, p: Rows) -> dict[str, Any]:
        if rates:
            for name, rate in zip(rates, equations.derivatives(s, vehicle), strict=True):
                s.__dict__.setdefault(name, rate)  # a user model may have a state of that name
        y = dict(zip(base_outputs, equations.measurements(s, vehicle), strict=True))
        for effect in readings:
            y.update(effect.read(s, y, vehicle, select[effect.name](p)))
        return y

    return measured


def dynamics_of(
    parts: EffectStages, signals: Bus, measured: Measured
) -> Callable[[Any, Rows, Rows, Rows], list[Any]]:
    """Return ``f``: the rates of all states, those of effects after those of the equations."""
    equations, select, slices = parts.model.equations, parts.select, parts.slices
    input_names = parts.input_names
    online_inputs, online_sensors = parts.online_inputs, parts.online_sensors
    with_states = [(effect, select[effect.name]) for effect in parts.dynamics if effect.states]
    rate_names = (
        tuple(f"{signal.name}_dot" for signal in equations.states)
        if any(rates_read_by(effect) for effect, _ in with_states)
        else ()
    )
    clocks = [(effect, select[effect.name]) for effect in parts.clocks]
    jumps = [(effect, select[effect.name]) for effect in parts.jumps]
    place = {signal.name: row for row, signal in enumerate(equations.states)}

    def f(t: Any, x: Rows, u: Rows, p: Rows) -> list[Any]:
        s, vehicle = signals(t, x, u, p)
        rates = list(equations.derivatives(s, vehicle))
        for name, rate in zip(rate_names, rates, strict=False):
            s.__dict__.setdefault(name, rate)  # a user model may have a state of that name
        for effect, gather in with_states:
            rates += effect.derivatives(s, vehicle, gather(p))
        for clock, gather in clocks:
            pace = clock.pace(gather(p))
            rates = [rate / pace for rate in rates]
        for jump, gather in jumps:
            for name, rate in jump.added_rates(s, rates, gather(p)).items():
                rates[place[name]] = rates[place[name]] + rate
        if online_inputs:
            bus = dict(zip(input_names, u, strict=True))
            for effect in online_inputs:
                inside, parameters = x[slices[effect.name]], select[effect.name](p)
                rates += effect.rates(bus[effect.signal], inside, parameters)
                bus[effect.signal] = effect.pass_on(bus[effect.signal], inside, parameters)
        if online_sensors:
            y = measured(s, vehicle, p)
            for effect in online_sensors:
                inside, parameters = x[slices[effect.name]], select[effect.name](p)
                rates += effect.rates(y[effect.channel], inside, parameters)
                y[effect.channel] = effect.pass_on(y[effect.channel], inside, parameters)
        return rates

    return f


def outputs_of(
    parts: EffectStages, signals: Bus, measured: Measured
) -> Callable[[Any, Rows, Rows, Rows], list[Any]]:
    """Return ``h``: the chosen outputs before sensors with memory, biases added."""
    select, slices, online_sensors = parts.select, parts.slices, parts.online_sensors
    bias_index, outputs = parts.bias_index, parts.outputs

    def h(t: Any, x: Rows, u: Rows, p: Rows) -> list[Any]:
        s, vehicle = signals(t, x, u, p)
        y = measured(s, vehicle, p)
        for effect in online_sensors:
            y[effect.channel] = effect.pass_on(
                y[effect.channel], x[slices[effect.name]], select[effect.name](p)
            )
        for name, index in bias_index.items():
            y[name] = y[name] + p[index]
        return [y[signal.name] for signal in outputs]

    return h


def input_path_of(parts: EffectStages) -> Callable[[Rows, list[Any], np.ndarray], list[Any]]:
    """Return ``input_path``: cell means of the recorded inputs at the vehicle."""
    select, inputs, input_names = parts.select, parts.inputs, parts.input_names

    def input_path(p: Rows, u: list[Any], edges: np.ndarray) -> list[Any]:
        out = list(u)
        for effect in inputs:
            row = input_names.index(effect.signal)
            out[row] = effect.act(edges, out[row], select[effect.name](p))
        return out

    return input_path


def sensor_path_of(
    parts: EffectStages,
) -> Callable[[Rows, list[Any], list[Any], np.ndarray], tuple[list[Any], list[Any]]]:
    """Return ``sensor_path``: outputs after sensors with memory."""
    select, sensors, bias_index = parts.select, parts.sensors, parts.bias_index
    names = [signal.name for signal in parts.outputs]

    def sensor_path(
        p: Rows, begin: list[Any], end: list[Any], steps: np.ndarray
    ) -> tuple[list[Any], list[Any]]:
        begin, end = list(begin), list(end)
        for effect in sensors:
            row = names.index(effect.channel)
            # The bias of the recorded channel is added after the sensor.
            bias = p[bias_index[effect.channel]] if effect.channel in bias_index else 0.0
            new_begin, new_end = effect.act(
                steps, begin[row] - bias, end[row] - bias, select[effect.name](p)
            )
            begin[row], end[row] = new_begin + bias, new_end + bias
        return begin, end

    return sensor_path


def sensor_memory_of(parts: EffectStages) -> Callable[[Rows], list[SensorMemory]]:
    """Return ``sensor_memory``: the response of sensors with memory to small fast motion."""
    names = [signal.name for signal in parts.outputs]
    sensor_effects = [each for each in parts.sensors if isinstance(each, RememberingEffect)]
    rows = [(names.index(each.channel), each, parts.select[each.name]) for each in sensor_effects]
    return lambda p: [SensorMemory(row, *each.memory(pick(p))) for row, each, pick in rows]


def noise_of(parts: EffectStages) -> Callable[[Rows], tuple[list[Any], list[Any]]]:
    """Return ``noise``: densities of the states' forcing, measurement variances of the outputs."""
    model, select, dynamics = parts.model, parts.select, parts.dynamics
    vehicle_of, outputs = parts.vehicle_of, parts.outputs
    state_names, at = parts.state_names, len(model.equations.states)
    random: list[tuple[slice, NoiseEffect]] = []
    for effect in dynamics:
        places = slice(at, at + len(effect.states))
        if isinstance(effect, NoiseEffect):
            random.append((places, effect))
        at = places.stop

    def noise(p: Rows) -> tuple[list[Any], list[Any]]:
        declared = model.noise.process_density
        density: list[Any] = [declared.get(name, 0.0) for name in state_names]
        vehicle = vehicle_of(p)
        for places, effect in random:
            density[places] = list(effect.density(vehicle, select[effect.name](p)))
        for clock in parts.clocks:
            pace = clock.pace(select[clock.name](p))
            density = [value / pace for value in density]
        std = model.noise.measurement_std
        return density, [std.get(signal.name, float("nan")) ** 2 for signal in outputs]

    return noise


# ---- From a declared Model to its System: the five array functions that algorithms use


def compile_model(
    model: Model, outputs: Sequence[str] | None = None, *, online: bool = False
) -> System:
    """Compile a model into a System.

    Parameters
    ----------
    model : the declaration.
    outputs : names of the outputs, in order; None for all.
    online : move input and sensor effects that have a state form into ``f`` and ``h``, for filters
        that process one sample at a time. An input effect without a state form is allowed if all
        its parameters are held. It then acts on the recorded input beforehand, and must therefore
        be the first on its signal or commute with those before it.

    Raises
    ------
    ModelError : an unknown output, or an effect that cannot run on line.
    """
    parts = parts_of(model, outputs, online)
    signals, measured = signals_of(parts), measured_of(parts)
    moved = (
        *parts.online_inputs,
        *parts.online_sensors,
        *parts.inputs,
        *parts.jumps,
        *parts.clocks,
    )
    after = [
        effect
        for effect in model.effects
        if effect.station is Station.SENSOR_PATH and effect not in moved
    ]
    system = System(
        parts.states,
        model.equations.inputs,
        parts.outputs,
        model.parameters,
        _initial(parts),
        model.noise,
        tuple(effect.name for effect in parts.inputs),
        tuple(effect.name for effect in parts.sensors),
        _names_of(parts.inputs),
        _names_of(after) | {f"bias_{name}" for name in model.biases},
        input_path_of(parts),
        dynamics_of(parts, signals, measured),
        outputs_of(parts, signals, measured),
        sensor_path_of(parts),
        noise_of(parts),
        frozenset(
            signal.name
            for effect in parts.dynamics
            if isinstance(effect, NoiseEffect)
            for signal in effect.states
        ),
        sensor_memory_of(parts),
    )
    return tied_system(system, model.ties)


def _initial(parts: EffectStages) -> ParameterSet:
    """Return initial values in the order of the states; undeclared ones of effects are zero."""
    model = parts.model
    given = {item.name for item in model.initial}
    added = [
        Parameter(signal.name, 0.0, signal.unit, free=False)
        for signal in parts.states[len(model.equations.states) :]
    ]
    initial = model.initial.joined(item for item in added if item.name not in given)
    return ParameterSet(tuple(initial[name] for name in parts.state_names))


def _names_of(effects: Sequence[Effect]) -> frozenset[str]:
    return frozenset(
        full_name(effect, item.name) for effect in effects for item in effect.parameters
    )


def tied_system(system: System, ties: Sequence[Tie]) -> System:
    """Return the System with every tied parameter computed from its tie; the same object without
    ties.

    A source of ties acts wherever one of the parameters tied to it acts.
    """
    if not ties:
        return system
    at = system.parameters.index
    places = [
        (at(tie.name), [(at(source), factor) for source, factor in tie.terms], tie.constant)
        for tie in ties
    ]
    full = partial(_with_ties_computed, places)
    acting = {
        source for tie in ties if tie.name in system.input_parameters for source in tie.sources
    }
    moving = {
        source for tie in ties if tie.name not in system.output_parameters for source in tie.sources
    }
    return replace(
        system,
        parameters=with_tied_values(system.parameters, ties),
        input_parameters=system.input_parameters | acting,
        output_parameters=system.output_parameters - moving,
        input_path=lambda p, u, edges: system.input_path(full(p), u, edges),
        f=lambda t, x, u, p: system.f(t, x, u, full(p)),
        h=lambda t, x, u, p: system.h(t, x, u, full(p)),
        sensor_path=lambda p, begin, end, steps: system.sensor_path(full(p), begin, end, steps),
        noise=lambda p: system.noise(full(p)),
        sensor_memory=lambda p: system.sensor_memory(full(p)),
    )


def _with_ties_computed(
    places: Sequence[tuple[int, list[tuple[int, float]], float]], p: Sequence[Any]
) -> list[Any]:
    """Return parameters with tied ones computed from the others; entries are numbers or arrays."""
    out = list(p)
    for place, terms, constant in places:
        value: Any = constant
        for source, factor in terms:
            value = value + factor * p[source]
        out[place] = value
    return out
