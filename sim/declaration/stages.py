"""The five functions of a System, each made from the parts of a model. What they close over is bound once, for they are called often."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import Any

import numpy as np

from sim.declaration.arguments import Signals, is_sampled, lock_arrays, with_locked_arrays
from sim.declaration.effect import NoiseEffect, Station, rates_read_by
from sim.declaration.model import Model
from sim.declaration.own_equations import OwnEquations
from sim.declaration.parts import Parts
from sim.declaration.system import Rows

Bus = Callable[[Any, Rows, Rows, Rows], tuple[Signals, Any]]
Measured = Callable[[Signals, Any, Rows], dict[str, Any]]


def signals_of(parts: Parts) -> Bus:
    """All signals by name at one time, with what the effects add, and the vehicle's own parameters as they are then."""
    equations, own, slices, moved_in = parts.model.equations, parts.own, parts.slices, parts.moved_in
    vehicle_of, state_names, input_names = parts.vehicle_of, parts.state_names, parts.input_names
    zero_ports = {port.name: 0.0 for port in equations.ports}
    varying = [(effect.parameter, effect.change, own[effect.name]) for effect in parts.varying]
    together = [(effect.changes, own[effect.name]) for effect in parts.varying_together]
    disturbances = [(effect, own[effect.name]) for effect in parts.dynamics if effect.station is Station.DISTURBANCE]
    others = [(effect, own[effect.name]) for effect in parts.dynamics if effect.station is not Station.DISTURBANCE]
    # The flow of a user's own model may hold the ports, to which dynamics add only after it was formed for them.
    forms_ports = bool(others) and isinstance(equations, OwnEquations) and equations.formed is not None and not equations.rate_ports
    users, calls = isinstance(equations, OwnEquations), count()

    def signals(t: Any, x: Rows, u: Rows, p: Rows) -> tuple[Signals, Any]:
        s = Signals(time=t, **zero_ports)
        bus = s.__dict__
        bus.update(zip(state_names, x, strict=False))
        bus.update(zip(input_names, u, strict=False))
        vehicle = vehicle_of(p)
        for effect in moved_in:
            bus[effect.signal] = effect.pass_on(bus[effect.signal], x[slices[effect.name]], own[effect.name](p))
        for effect, gather in disturbances:
            for port, value in effect.increments(s, vehicle, gather(p)).items():
                bus[port] = bus[port] + value
        for name, change, gather in varying:
            vehicle = vehicle._replace(**{name: getattr(vehicle, name) + change(s, gather(p))})
        for changes, gather in together:
            vehicle = vehicle._replace(**{name: getattr(vehicle, name) + value for name, value in changes(s, gather(p)).items()})
        locks = users and is_sampled(next(calls))
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


def measured_of(parts: Parts) -> Measured:
    """All outputs by name as sensors without memory read them."""
    equations, own, readings = parts.model.equations, parts.own, parts.readings
    base_outputs = tuple(signal.name for signal in equations.outputs)
    rates = tuple(f"{signal.name}_dot" for signal in equations.states) if any(rates_read_by(effect) for effect in readings) else ()

    def measured(s: Signals, vehicle: Any, p: Rows) -> dict[str, Any]:
        if rates:
            for name, rate in zip(rates, equations.derivatives(s, vehicle), strict=True):
                s.__dict__.setdefault(name, rate)  # an own model may have a state of that name
        y = dict(zip(base_outputs, equations.measurements(s, vehicle), strict=True))
        for effect in readings:
            y.update(effect.read(s, y, vehicle, own[effect.name](p)))
        return y

    return measured


def dynamics_of(parts: Parts, signals: Bus, measured: Measured) -> Callable[[Any, Rows, Rows, Rows], list[Any]]:
    """``f``: the rates of all states, those of effects behind those of the equations."""
    equations, own, slices, input_names = parts.model.equations, parts.own, parts.slices, parts.input_names
    moved_in, moved_out = parts.moved_in, parts.moved_out
    with_states = [(effect, own[effect.name]) for effect in parts.dynamics if effect.states]
    rate_names = tuple(f"{signal.name}_dot" for signal in equations.states) if any(rates_read_by(effect) for effect, _ in with_states) else ()
    clocks = [(effect, own[effect.name]) for effect in parts.clocks]

    def f(t: Any, x: Rows, u: Rows, p: Rows) -> list[Any]:
        s, vehicle = signals(t, x, u, p)
        rates = list(equations.derivatives(s, vehicle))
        for name, rate in zip(rate_names, rates, strict=False):
            s.__dict__.setdefault(name, rate)  # an own model may have a state of that name
        for effect, gather in with_states:
            rates += effect.derivatives(s, vehicle, gather(p))
        for clock, gather in clocks:
            pace = clock.pace(gather(p))
            rates = [rate / pace for rate in rates]
        if moved_in:
            bus = dict(zip(input_names, u, strict=True))
            for effect in moved_in:
                inside, parameters = x[slices[effect.name]], own[effect.name](p)
                rates += effect.rates(bus[effect.signal], inside, parameters)
                bus[effect.signal] = effect.pass_on(bus[effect.signal], inside, parameters)
        if moved_out:
            y = measured(s, vehicle, p)
            for effect in moved_out:
                inside, parameters = x[slices[effect.name]], own[effect.name](p)
                rates += effect.rates(y[effect.channel], inside, parameters)
                y[effect.channel] = effect.pass_on(y[effect.channel], inside, parameters)
        return rates

    return f


def outputs_of(parts: Parts, signals: Bus, measured: Measured) -> Callable[[Any, Rows, Rows, Rows], list[Any]]:
    """``h``: the chosen outputs before sensors with memory, biases added."""
    own, slices, moved_out, bias_index, outputs = parts.own, parts.slices, parts.moved_out, parts.bias_index, parts.outputs

    def h(t: Any, x: Rows, u: Rows, p: Rows) -> list[Any]:
        s, vehicle = signals(t, x, u, p)
        y = measured(s, vehicle, p)
        for effect in moved_out:
            y[effect.channel] = effect.pass_on(y[effect.channel], x[slices[effect.name]], own[effect.name](p))
        for name, index in bias_index.items():
            y[name] = y[name] + p[index]
        return [y[signal.name] for signal in outputs]

    return h


def input_path_of(parts: Parts) -> Callable[[Rows, list[Any], np.ndarray], list[Any]]:
    """``input_path``: cell means of the recorded inputs at the vehicle."""
    own, inputs, input_names = parts.own, parts.inputs, parts.input_names

    def input_path(p: Rows, u: list[Any], edges: np.ndarray) -> list[Any]:
        out = list(u)
        for effect in inputs:
            row = input_names.index(effect.signal)
            out[row] = effect.act(edges, out[row], own[effect.name](p))
        return out

    return input_path


def sensor_path_of(parts: Parts) -> Callable[[Rows, list[Any], list[Any], np.ndarray], tuple[list[Any], list[Any]]]:
    """``sensor_path``: outputs after sensors with memory."""
    own, sensors, bias_index = parts.own, parts.sensors, parts.bias_index
    names = [signal.name for signal in parts.outputs]

    def sensor_path(p: Rows, begin: list[Any], end: list[Any], steps: np.ndarray) -> tuple[list[Any], list[Any]]:
        begin, end = list(begin), list(end)
        for effect in sensors:
            row = names.index(effect.channel)
            # A sensor sees the signal before the bias of the recorded channel is added.
            bias = p[bias_index[effect.channel]] if effect.channel in bias_index else 0.0
            new_begin, new_end = effect.act(steps, begin[row] - bias, end[row] - bias, own[effect.name](p))
            begin[row], end[row] = new_begin + bias, new_end + bias
        return begin, end

    return sensor_path


def noise_of(parts: Parts) -> Callable[[Rows], tuple[list[Any], list[Any]]]:
    """``noise``: spectral density of each state's forcing, measurement variance of each output."""
    model, own, dynamics, vehicle_of, outputs = parts.model, parts.own, parts.dynamics, parts.vehicle_of, parts.outputs
    state_names, n_base = parts.state_names, len(model.equations.states)

    def noise(p: Rows) -> tuple[list[Any], list[Any]]:
        declared = model.noise.process_density
        density: list[Any] = [declared.get(name, 0.0) for name in state_names]
        vehicle, at = vehicle_of(p), n_base
        for effect in dynamics:
            if isinstance(effect, NoiseEffect):
                density[at : at + len(effect.states)] = list(effect.density(vehicle, own[effect.name](p)))
            at += len(effect.states)
        for clock in parts.clocks:
            pace = clock.pace(own[clock.name](p))
            density = [value / pace for value in density]
        return density, [_measurement_variance(model, signal.name) for signal in outputs]

    return noise


def _measurement_variance(model: Model, output: str) -> float:
    std = model.noise.measurement_std.get(output)
    return float("nan") if std is None else std**2
