"""From a declared Model to its System: the five array functions that every algorithm sees."""

from __future__ import annotations

from collections.abc import Sequence

from sim.declaration.effect import Effect, NoiseEffect, Station, full_name
from sim.declaration.model import Model
from sim.declaration.parameters import Parameter, ParameterSet
from sim.declaration.parts import Parts, parts_of
from sim.declaration.stages import dynamics_of, input_path_of, measured_of, noise_of, outputs_of, sensor_path_of, signals_of
from sim.declaration.system import System
from sim.declaration.ties import tied_system


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
