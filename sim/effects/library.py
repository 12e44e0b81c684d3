"""The library of effects: every module in the folder of a station is found automatically.

Such a module defines ``VARIANTS: tuple[Effect, ...]``, the instances that the library offers: one
for each channel or input on which the effect may act, with parameters at typical values. Effects of
one family may share a file.
"""

from __future__ import annotations

import difflib
import importlib
import pkgutil
from collections.abc import Sequence
from types import ModuleType

from sim.declaration.effect import (
    Effect,
    OnChannel,
    OnSignal,
    StateJumpEffect,
    Station,
    constants_needed,
    outputs_read_by,
    ports_needed,
    rates_read_by,
    states_read_by,
)
from sim.declaration.model import Equations
from sim.declaration.proposal import Traceable, Traits
from sim.effects.instances import controls, in_its_unit
from sim.errors import ModelError


def effect_modules() -> tuple[ModuleType, ...]:
    """Return the modules in the station folders, in the order of the signal chain, then by name."""
    result: list[ModuleType] = []
    for station in Station:
        folder = f"sim.effects.{station.name.lower()}"
        try:
            package = importlib.import_module(folder)
        except ModuleNotFoundError as error:
            if error.name != folder:
                raise
            continue
        modules = [
            module.name
            for module in pkgutil.walk_packages(package.__path__, f"{folder}.")
            if not module.ispkg
        ]
        result += [
            importlib.import_module(name)
            for name in sorted(modules, key=lambda name: name.rpartition(".")[2])
        ]
    return tuple(result)


def library() -> tuple[Effect, ...]:
    """Return every instance of the library; raise ModelError for a module without ``VARIANTS``."""
    effects: list[tuple[str, Effect]] = []
    for module in effect_modules():
        variants = getattr(module, "VARIANTS", ())
        if not variants:
            raise ModelError(
                "the module offers no effect",
                where=module.__name__,
                remedy="define VARIANTS, a tuple of effects, in it",
            )
        effects += _with_sort_names(module, variants)
    return _in_order(effects)


def effects_for(equations: Equations) -> tuple[Effect, ...]:
    """Return the effects that can act on a vehicle.

    These are the instances in ``VARIANTS`` whose input, channel and ports the vehicle has. For its
    other inputs, outputs and ports, the function ``made_for(equations)`` of a module, if it exists,
    makes further instances.
    """
    candidates: list[tuple[str, Effect]] = []
    for module in effect_modules():
        known = [effect for effect in getattr(module, "VARIANTS", ()) if applies(effect, equations)]
        names = {effect.name for effect in known}
        made = module.made_for(equations) if hasattr(module, "made_for") else ()
        further = [e for e in made if e.name not in names and applies(e, equations)]
        candidates += _with_sort_names(module, (*known, *further))
    return _in_order(candidates)


def _with_sort_names(module: ModuleType, effects: Sequence[Effect]) -> list[tuple[str, Effect]]:
    """Return the effects of a module, each with the name by which it is sorted.

    That is the name of the module, or the family name of the effect if the module has several
    families.
    """
    families = {effect.name.partition(":")[0] for effect in getattr(module, "VARIANTS", ())}
    file = module.__name__.rpartition(".")[2]
    return [
        (file if len(families) < 2 else effect.name.partition(":")[0].replace("-", "_"), effect)
        for effect in effects
    ]


def _in_order(effects: Sequence[tuple[str, Effect]]) -> tuple[Effect, ...]:
    """Return effects in the order of the signal chain, then by their sort names."""
    stations = [*Station]
    ordered = sorted(effects, key=lambda each: (stations.index(each[1].station), each[0]))
    return tuple(effect for _, effect in ordered)


def other_names(equations: Equations) -> dict[str, str]:
    """Return the further names of effects of a vehicle, each with the effect's own name, from
    ``other_names(equations)`` of the modules.
    """
    names: dict[str, str] = {}
    for module in effect_modules():
        names |= module.other_names(equations) if hasattr(module, "other_names") else {}
    return names


def catch_all_terms_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return the catch-all terms of a vehicle, which compete with its effects and name no cause.

    If one of them is the most probable, a cause outside the library acts. They are not in the
    library, but are found by file in the same way: ``GUARDS`` of a file, and the terms that its
    ``made_for(equations)`` makes for the signals and ports of a user model.
    """
    package = importlib.import_module("sim.effects.guards")
    candidates: list[Traceable] = []
    for name in sorted(module.name for module in pkgutil.iter_modules(package.__path__)):
        module = importlib.import_module(f"{package.__name__}.{name}")
        made = module.made_for(equations) if hasattr(module, "made_for") else ()
        candidates += [guard for guard in (*module.GUARDS, *made) if applies(guard, equations)]
    return tuple(candidates)


def applies(effect: Effect, equations: Equations) -> bool:
    """Return whether a vehicle has the input, the output, the ports, the constants and the states
    that an effect acts on.
    """
    inputs = {signal.name for signal in equations.inputs}
    outputs = {signal.name for signal in equations.outputs}
    ports = {port.name for port in equations.ports}
    states = {signal.name for signal in equations.states}
    if isinstance(effect, StateJumpEffect) and states != {*effect.states_read}:
        return False
    # With several inputs each has its own instance, named by its label.
    has_right_label = (
        not isinstance(effect, OnSignal)
        or len(controls(equations)) == 1
        or getattr(effect, "label", effect.signal) != ""
    )
    input_exists = not isinstance(effect, OnSignal) or (effect.signal in inputs and has_right_label)
    outputs_exist = (
        not isinstance(effect, OnChannel) or effect.channel in outputs
    ) and outputs.issuperset(outputs_read_by(effect))
    ports_and_states_exist = ports.issuperset(ports_needed(effect)) and states.issuperset(
        (*rates_read_by(effect), *states_read_by(effect))
    )
    return (
        input_exists
        and outputs_exist
        and ports_and_states_exist
        and in_its_unit(effect, equations)
        and {*equations.parameter_names}.issuperset(constants_needed(effect))
    )


def effect_names() -> tuple[str, ...]:
    """Return the names of all effects, each once, in the order of the signal chain."""
    return tuple(dict.fromkeys(effect.name for effect in library()))


def traits_of(name: str) -> Traits:
    """Return the traits of the effect of the library with a name; empty for an unknown name.

    A numbered instance (``elastic-mode#2``) has the traits of the first one (``elastic-mode``).
    Instances made from a declaration are not in the library; they have traits of their own.
    """
    effects = {
        effect.name: effect for effect in reversed(library()) if isinstance(effect, Traceable)
    }
    found = effects.get(name) or effects.get(name.partition("#")[0])
    return found.traits if found is not None else Traits()


def find_effect(name: str, equations: Equations | None = None) -> Effect:
    """Return the effect with a name, for the equations of a vehicle or of any vehicle.

    The part after the colon may be left out if there is only one instance (``"elastic-mode"`` for
    ``"elastic-mode:1"``). For a vehicle the name may be one of ``other_names``.

    Raises
    ------
    ModelError : there is no such effect (the nearest name is suggested), or there are several.
    """
    effects = library() if equations is None else effects_for(equations)
    name = name if equations is None else other_names(equations).get(name, name)
    exact = [effect for effect in effects if effect.name == name]
    if exact:
        return exact[0]
    family = [effect for effect in effects if effect.name.partition(":")[0] == name]
    if len(family) == 1:
        return family[0]
    where = "effects" if equations is None else f"effects on {equations.name}"
    if family:
        raise ModelError(
            f"there are several effects {name!r}",
            where=where,
            remedy=f"use one of {', '.join(effect.name for effect in family)}",
        )
    names = list(dict.fromkeys(effect.name for effect in effects))
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.4)
    raise ModelError(
        f"there is no effect {name!r}",
        where=where,
        remedy=f"did you mean {near[0]!r}?" if near else f"use one of {', '.join(names)}",
    )
