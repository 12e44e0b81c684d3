"""From a declared Model to its System: the five array functions that every algorithm sees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from sim.declaration.effect import Effect, NoiseEffect, Station, full_name
from sim.declaration.model import Model
from sim.declaration.parameters import Parameter, ParameterSet
from sim.declaration.parts import Parts, parts_of
from sim.declaration.stages import dynamics_of, input_path_of, measured_of, noise_of, outputs_of, sensor_path_of, signals_of
from sim.declaration.system import System
from sim.declaration.ties import Tie, with_tied_values


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
    parts = parts_of(model, outputs, online)
    signals, measured = signals_of(parts), measured_of(parts)
    moved = (*parts.moved_in, *parts.moved_out, *parts.inputs, *parts.clocks)
    after = [effect for effect in model.effects if effect.station is Station.SENSOR_PATH and effect not in moved]
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
        frozenset(signal.name for effect in parts.dynamics if isinstance(effect, NoiseEffect) for signal in effect.states),
    )
    return tied_system(system, model.ties)


def _initial(parts: Parts) -> ParameterSet:
    """Initial values in the order of the states; states of effects start at zero where the model does not say."""
    model = parts.model
    given = {item.name for item in model.initial}
    added = [Parameter(signal.name, 0.0, signal.unit, free=False) for signal in parts.states[len(model.equations.states) :]]
    initial = model.initial.joined(item for item in added if item.name not in given)
    return ParameterSet(tuple(initial[name] for name in parts.state_names))


def _names_of(effects: Sequence[Effect]) -> frozenset[str]:
    return frozenset(full_name(effect, item.name) for effect in effects for item in effect.parameters)


def tied_system(system: System, ties: Sequence[Tie]) -> System:
    """The System with every function seeing each tied parameter at what its tie gives; the same object where there are no ties.

    A parameter that others follow counts as acting wherever one of these does.
    """
    if not ties:
        return system
    at = system.parameters.index
    places = [(at(tie.name), [(at(source), factor) for source, factor in tie.terms], tie.constant) for tie in ties]
    full = partial(_followed, places)
    acting = {source for tie in ties if tie.name in system.input_parameters for source in tie.sources}
    moving = {source for tie in ties if tie.name not in system.output_parameters for source in tie.sources}
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
    )


def _followed(places: Sequence[tuple[int, list[tuple[int, float]], float]], p: Sequence[Any]) -> list[Any]:
    """The parameters with those that are tied worked out from the others; entries are numbers or arrays."""
    out = list(p)
    for place, terms, constant in places:
        value: Any = constant
        for source, factor in terms:
            value = value + factor * p[source]
        out[place] = value
    return out
