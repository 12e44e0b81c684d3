"""Who does what in a declared model: its effects by their stage of the signal chain, its states, where its parameters stand."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from operator import itemgetter
from typing import Any
from weakref import WeakKeyDictionary

from sim.declaration.effect import (
    Anticipating,
    ClockEffect,
    Commuting,
    DynamicsEffect,
    Effect,
    GroupEffect,
    InputEffect,
    OnlineForm,
    ParameterEffect,
    ReadingEffect,
    SensorEffect,
    Signal,
    full_name,
    in_order,
)
from sim.declaration.model import Model
from sim.declaration.parameters import ParameterSet
from sim.declaration.system import Rows
from sim.errors import ModelError

_FOLLOWED: WeakKeyDictionary[type, dict[Any, bool]] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class Parts:
    """The effects of a model by stage, each stage in the order in which the signal meets them.

    ``inputs`` and ``sensors`` act on whole paths; ``moved_in`` and ``moved_out`` are those that an on-line System carries as states,
    ``slices`` where these stand among ``states``. ``own`` picks an effect's parameters off a row of all of them, by effect name,
    ``vehicle_of`` those of the equations, which ``varying`` and
    ``varying_together`` change. ``bias_index`` by output. ``clocks`` set the pace of
    ``dynamics``, which are theirs alone.
    """

    model: Model
    outputs: tuple[Signal, ...]
    inputs: tuple[InputEffect, ...]
    moved_in: tuple[Any, ...]
    varying: tuple[ParameterEffect, ...]
    varying_together: tuple[GroupEffect, ...]
    dynamics: tuple[DynamicsEffect, ...]
    readings: tuple[ReadingEffect, ...]
    sensors: tuple[SensorEffect, ...]
    moved_out: tuple[Any, ...]
    clocks: tuple[ClockEffect, ...]
    states: tuple[Signal, ...]
    slices: Mapping[str, slice]
    own: Mapping[str, Callable[[Rows], Any]]
    vehicle_of: Callable[[Rows], Any]
    bias_index: Mapping[str, int]

    @property
    def state_names(self) -> tuple[str, ...]:
        return tuple(signal.name for signal in self.states)

    @property
    def input_names(self) -> tuple[str, ...]:
        return tuple(signal.name for signal in self.model.equations.inputs)


def parts_of(model: Model, outputs: Sequence[str] | None, online: bool) -> Parts:
    """The parts of a model; an unknown output, or an effect that cannot run on line, is a ModelError."""
    equations = model.equations
    chosen = _chosen_outputs(model, outputs)
    wanted = {signal.name for signal in chosen}
    inputs: list[InputEffect] = in_order(_following(model, InputEffect))
    found: list[SensorEffect] = in_order(_following(model, SensorEffect))
    sensors = [effect for effect in found if effect.channel in wanted]
    dynamics = _following(model, DynamicsEffect)
    moved_in, moved_out = (_state_forms(model, inputs), _state_forms(model, sensors)) if online else ([], [])
    states = list(equations.states)
    for effect in dynamics:
        states += effect.states
    slices: dict[str, slice] = {}
    for online_effect in [*moved_in, *moved_out]:
        first = len(states)
        states += online_effect.online_states
        slices[online_effect.name] = slice(first, len(states))
    return Parts(
        model,
        chosen,
        tuple(effect for effect in inputs if effect not in moved_in),
        tuple(moved_in),
        tuple(_following(model, ParameterEffect)),
        tuple(_following(model, GroupEffect)),
        tuple(dynamics),
        tuple(in_order(_following(model, ReadingEffect))),
        tuple(effect for effect in sensors if effect not in moved_out),
        tuple(moved_out),
        tuple(_following(model, ClockEffect)),
        tuple(states),
        slices,
        {effect.name: _gather(model, effect) for effect in model.effects},
        _gather_named(model.parameters, equations.parameter_names, "vehicle_parameters"),
        {name: model.parameters.index(f"bias_{name}") for name in model.biases},
    )


def _following(model: Model, protocol: Any) -> list[Any]:
    """The effects of a model that follow a protocol: asked once for each class and names of its attributes, since the answer looks at all of them."""
    found = []
    for effect in model.effects:
        known, asked = _FOLLOWED.setdefault(type(effect), {}), (protocol, *getattr(effect, "__dict__", ()))
        if asked not in known:
            known[asked] = isinstance(effect, protocol)
        if known[asked]:
            found.append(effect)
    return found


def _chosen_outputs(model: Model, outputs: Sequence[str] | None) -> tuple[Signal, ...]:
    known = {signal.name: signal for signal in model.equations.outputs}
    if outputs is None:
        return model.equations.outputs
    for name in outputs:
        if name not in known:
            raise ModelError(f"there is no output {name!r}", where=f"model {model.name}", remedy=f"its outputs are {', '.join(known)}")
    return tuple(known[name] for name in outputs)


def _state_forms(model: Model, effects: Sequence[Any]) -> list[Any]:
    moved: list[Any] = []
    for effect in effects:
        if isinstance(effect, OnlineForm):
            moved.append(effect)
            continue
        ahead = isinstance(effect, Anticipating) and effect.anticipates
        if ahead:
            raise ModelError(
                f"effect {effect.name} needs the input's future and cannot run on line",
                where=f"model {model.name}",
                remedy="use a whole-record fit (output-error)",
            )
        free = [item.name for item in effect.parameters if model.parameters[full_name(effect, item.name)].free]
        behind = any(other.signal == effect.signal for other in moved) and not (isinstance(effect, Commuting) and effect.commutes)
        if not isinstance(effect, InputEffect) or free or behind:
            raise ModelError(
                f"effect {effect.name} has no state form and cannot run on line",
                where=f"model {model.name}",
                remedy="hold its parameters if it acts on an input, or use a whole-record fit (output-error)",
            )
    return moved


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
