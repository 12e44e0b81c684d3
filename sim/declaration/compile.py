"""From a declared Model to its System: the five array functions that every algorithm sees."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Sequence
from functools import cache
from operator import itemgetter
from types import SimpleNamespace
from typing import Any

import numpy as np

from sim.declaration.effect import (
    Commuting,
    DynamicsEffect,
    Effect,
    InputEffect,
    NoiseEffect,
    OnlineForm,
    ReadingEffect,
    SensorEffect,
    Signal,
    Station,
    full_name,
    in_order,
)
from sim.declaration.model import Model
from sim.declaration.parameters import Parameter, ParameterSet
from sim.declaration.system import Rows, System
from sim.errors import ModelError


def compile_model(model: Model, outputs: Sequence[str] | None = None, *, online: bool = False) -> System:
    """Compile a model into a System.

    Parameters
    ----------
    model : the declaration.
    outputs : the outputs wanted, in order; all when None.
    online : put input and sensor effects that have a state form into ``f`` and ``h``, for filters that see
        one sample at a time. An input effect without one may stay when all its parameters are held: it
        then acts on the recorded input beforehand, which it can only ahead of all others or if it commutes with them.

    Raises
    ------
    ModelError : an unknown output, or an effect that cannot run on line (it is named).
    """
    equations = model.equations
    output_signals = _chosen_outputs(model, outputs)
    inputs: list[InputEffect] = in_order([effect for effect in model.effects if isinstance(effect, InputEffect)])
    sensors: list[SensorEffect] = in_order([effect for effect in model.effects if isinstance(effect, SensorEffect)])
    dynamics = [effect for effect in model.effects if isinstance(effect, DynamicsEffect)]
    readings: list[ReadingEffect] = in_order([effect for effect in model.effects if isinstance(effect, ReadingEffect)])
    wanted = {signal.name for signal in output_signals}
    sensors = [effect for effect in sensors if effect.channel in wanted]
    moved_in, moved_out = (_state_forms(model, inputs), _state_forms(model, sensors)) if online else ([], [])
    inputs = [effect for effect in inputs if effect not in moved_in]
    sensors = [effect for effect in sensors if effect not in moved_out]
    own = {effect.name: _gather(model, effect) for effect in model.effects}
    vehicle_of = _gather_named(model.parameters, equations.parameter_names, f"{equations.name}_parameters")

    state_signals = list(equations.states)
    for effect in dynamics:
        state_signals += effect.states
    online_slices: dict[str, slice] = {}
    for online_effect in [*moved_in, *moved_out]:
        first = len(state_signals)
        state_signals += online_effect.online_states
        online_slices[online_effect.name] = slice(first, len(state_signals))
    state_names = tuple(signal.name for signal in state_signals)
    input_names = tuple(signal.name for signal in equations.inputs)
    zero_ports = {port.name: 0.0 for port in equations.ports}
    disturbances = [(effect, own[effect.name]) for effect in dynamics if effect.station is Station.DISTURBANCE]
    others = [(effect, own[effect.name]) for effect in dynamics if effect.station is not Station.DISTURBANCE]
    with_states = [(effect, own[effect.name]) for effect in dynamics if effect.states]
    n_base = len(equations.states)
    base_outputs = tuple(signal.name for signal in equations.outputs)
    bias_index = {name: model.parameters.index(f"bias_{name}") for name in model.biases}

    def signals(t: Any, x: Rows, u: Rows, p: Rows) -> tuple[SimpleNamespace, Any]:
        s = SimpleNamespace(time=t, **zero_ports)
        bus = s.__dict__
        bus.update(zip(state_names, x, strict=False))
        bus.update(zip(input_names, u, strict=False))
        vehicle = vehicle_of(p)
        for effect in moved_in:
            bus[effect.signal] = effect.pass_on(bus[effect.signal], x[online_slices[effect.name]], own[effect.name](p))
        for effect, gather in disturbances:
            for port, value in effect.increments(s, vehicle, gather(p)).items():
                bus[port] = bus[port] + value
        bus.update(equations.flow(s, vehicle))
        for effect, gather in others:
            for port, value in effect.increments(s, vehicle, gather(p)).items():
                bus[port] = bus[port] + value
        return s, vehicle

    def measured(s: SimpleNamespace, vehicle: Any, p: Rows) -> dict[str, Any]:
        y = dict(zip(base_outputs, equations.measurements(s, vehicle), strict=True))
        for effect in readings:
            y.update(effect.read(s, y, vehicle, own[effect.name](p)))
        return y

    def f(t: Any, x: Rows, u: Rows, p: Rows) -> list[Any]:
        s, vehicle = signals(t, x, u, p)
        rates = list(equations.derivatives(s, vehicle))
        for effect, gather in with_states:
            rates += effect.derivatives(s, vehicle, gather(p))
        if moved_in:
            bus = dict(zip(input_names, u, strict=True))
            for effect in moved_in:
                inside, parameters = x[online_slices[effect.name]], own[effect.name](p)
                rates += effect.rates(bus[effect.signal], inside, parameters)
                bus[effect.signal] = effect.pass_on(bus[effect.signal], inside, parameters)
        if moved_out:
            y = measured(s, vehicle, p)
            for effect in moved_out:
                inside, parameters = x[online_slices[effect.name]], own[effect.name](p)
                rates += effect.rates(y[effect.channel], inside, parameters)
                y[effect.channel] = effect.pass_on(y[effect.channel], inside, parameters)
        return rates

    def h(t: Any, x: Rows, u: Rows, p: Rows) -> list[Any]:
        s, vehicle = signals(t, x, u, p)
        y = measured(s, vehicle, p)
        for effect in moved_out:
            y[effect.channel] = effect.pass_on(y[effect.channel], x[online_slices[effect.name]], own[effect.name](p))
        for name, index in bias_index.items():
            y[name] = y[name] + p[index]
        return [y[signal.name] for signal in output_signals]

    def input_path(p: Rows, u: list[Any], edges: np.ndarray) -> list[Any]:
        out = list(u)
        for effect in inputs:
            row = input_names.index(effect.signal)
            out[row] = effect.act(edges, out[row], own[effect.name](p))
        return out

    def sensor_path(p: Rows, begin: list[Any], end: list[Any], steps: np.ndarray) -> tuple[list[Any], list[Any]]:
        begin, end = list(begin), list(end)
        for effect in sensors:
            row = [signal.name for signal in output_signals].index(effect.channel)
            # A sensor sees the signal before the bias of the recorded channel is added.
            bias = p[bias_index[effect.channel]] if effect.channel in bias_index else 0.0
            new_begin, new_end = effect.act(steps, begin[row] - bias, end[row] - bias, own[effect.name](p))
            begin[row], end[row] = new_begin + bias, new_end + bias
        return begin, end

    def noise(p: Rows) -> tuple[list[Any], list[Any]]:
        declared = model.noise.process_density
        density: list[Any] = [declared.get(name, 0.0) for name in state_names]
        vehicle, at = vehicle_of(p), n_base
        for effect in dynamics:
            if isinstance(effect, NoiseEffect):
                density[at : at + len(effect.states)] = list(effect.density(vehicle, own[effect.name](p)))
            at += len(effect.states)
        return density, [_measurement_variance(model, signal.name) for signal in output_signals]

    added = [Parameter(signal.name, 0.0, signal.unit, free=False) for signal in state_signals[n_base:]]
    given = {item.name for item in model.initial}
    initial = model.initial.joined(item for item in added if item.name not in given)
    return System(
        tuple(state_signals),
        equations.inputs,
        output_signals,
        model.parameters,
        ParameterSet(tuple(initial[name] for name in state_names)),
        model.noise,
        tuple(effect.name for effect in inputs),
        tuple(effect.name for effect in sensors),
        _names_of(inputs),
        _names_of([effect for effect in model.effects if effect.station is Station.SENSOR_PATH and effect not in (*moved_in, *moved_out, *inputs)])
        | {f"bias_{name}" for name in model.biases},
        input_path,
        f,
        h,
        sensor_path,
        noise,
        frozenset(signal.name for effect in dynamics if isinstance(effect, NoiseEffect) for signal in effect.states),
    )


def _chosen_outputs(model: Model, outputs: Sequence[str] | None) -> tuple[Signal, ...]:
    known = {signal.name: signal for signal in model.equations.outputs}
    if outputs is None:
        return model.equations.outputs
    for name in outputs:
        if name not in known:
            raise ModelError(f"there is no output {name!r}", where=f"model {model.name}", remedy=f"its outputs are {', '.join(known)}")
    return tuple(known[name] for name in outputs)


def _names_of(effects: Sequence[Effect]) -> frozenset[str]:
    return frozenset(full_name(effect, item.name) for effect in effects for item in effect.parameters)


def _state_forms(model: Model, effects: Sequence[Any]) -> list[Any]:
    moved: list[Any] = []
    for effect in effects:
        if isinstance(effect, OnlineForm):
            moved.append(effect)
            continue
        free = [item.name for item in effect.parameters if model.parameters[full_name(effect, item.name)].free]
        behind = any(other.signal == effect.signal for other in moved) and not (isinstance(effect, Commuting) and effect.commutes)
        if not isinstance(effect, InputEffect) or free or behind:
            raise ModelError(
                f"effect {effect.name} has no state form and cannot run on line",
                where=f"model {model.name}",
                remedy="hold its parameters if it acts on an input, or use a whole-record fit (output-error)",
            )
    return moved


def _measurement_variance(model: Model, output: str) -> float:
    std = model.noise.measurement_std.get(output)
    return float("nan") if std is None else std**2


def _gather(model: Model, effect: Effect) -> Callable[[Rows], Any]:
    names = [item.name for item in effect.parameters]
    full = [full_name(effect, name) for name in names]
    return _gather_named(model.parameters, full, "effect_parameters", names)


@cache  # making such a class takes as long as all the rest of an effect's compilation
def _view(label: str, fields: tuple[str, ...]) -> Any:
    return namedtuple(label, fields)


def _gather_named(parameters: ParameterSet, names: Sequence[str], label: str, fields: Sequence[str] | None = None) -> Callable[[Rows], Any]:
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
