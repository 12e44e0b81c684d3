"""What is hidden: kinds of effects, each with its instances on the models that have it."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from exam.every_effect.carriers import MODELS, equations_of
from exam.scores.rates import NOTHING, kind_of
from sim.declaration.proposal import Traceable
from sim.effects.library import effects_for
from sim.errors import DeclarationError

# in a fall no more than another start; no search proposes them
UNSEEN = ("sensor-delay:altitude", "sensor-lag:altitude")


@dataclass(frozen=True)
class Instance:
    """An effect by its full name on the vehicles of one model; without a name, nothing."""

    model: str
    name: str


def effect_of(instance: Instance) -> Traceable:
    """The effect of an instance as the library has it, in its first form where it has several."""
    return _offered(instance.model)[instance.name]


@cache
def _offered(model: str) -> Mapping[str, Traceable]:
    """Effects that may be hidden on a model's vehicles, by name. General forms are no causes, and
    modes that a vehicle declares no effects.
    """
    offered = [
        effect
        for effect in effects_for(equations_of(model))
        if isinstance(effect, Traceable) and not effect.traits.general
    ]
    return {effect.name: effect for effect in reversed(offered) if effect.name not in UNSEEN}


@cache
def library_kinds() -> Mapping[str, tuple[Instance, ...]]:
    """Kind -> instances, models and channels mixed, so that few flights see several; ``NOTHING``
    first.
    """
    kinds: dict[str, dict[Instance, None]] = {
        NOTHING: dict.fromkeys(Instance(model, "") for model in MODELS)
    }
    for model in MODELS:
        for name in reversed(list(_offered(model))):
            kinds.setdefault(kind_of(name), {})[Instance(model, name)] = None
    return {name: _mixed(tuple(found)) for name, found in kinds.items()}


def _mixed(instances: tuple[Instance, ...]) -> tuple[Instance, ...]:
    """An order of its own for each number of them, always the same."""
    return tuple(
        instances[at] for at in np.random.default_rng(len(instances)).permutation(len(instances))
    )


def chosen(asked: Sequence[str] | None) -> Mapping[str, tuple[Instance, ...]]:
    """Those of the library that are asked for: ``nothing``, a kind, or an effect by its full name;
    all, None.

    Raises
    ------
    DeclarationError : a name that the library lacks, or one twice.
    """
    kinds = library_kinds()
    if asked is None:
        return kinds
    found: dict[str, tuple[Instance, ...]] = {}
    for name in asked:
        of_name = kinds.get(name) or tuple(
            instance for instance in kinds.get(kind_of(name), ()) if instance.name == name
        )
        if not of_name:
            near = difflib.get_close_matches(name, kinds, n=1, cutoff=0.4)
            remedy = f"did you mean {near[0]!r}?" if near else f"use {', '.join(kinds)}"
            raise DeclarationError(f"there is no effect {name!r}", where="--effects", remedy=remedy)
        if name in found:
            raise DeclarationError(
                f"{name} is named twice", where="--effects", remedy="name each once"
            )
        found[name] = of_name
    if not found:
        raise DeclarationError(
            "no effect is named", where="--effects", remedy="name some, or leave it out for all"
        )
    return found
