"""What a search may propose: the library's effects for a vehicle, and a user's own effects from a
file.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from scenarios.files.declarations import WANTED, run_python
from scenarios.files.sources import Source, read_source
from scenarios.files.user_models import inputs_at_rest, is_own
from sim.declaration.compile import compile_model
from sim.declaration.effect import Effect, GroupEffect, ParameterEffect, Signal
from sim.declaration.model import Containing, Model
from sim.declaration.proposal import Traceable, Traits
from sim.errors import DeclarationError, ModelError

Act = TypeVar("Act", bound=Effect)

_ATTRIBUTES = (
    "name",
    "station",
    "parameters",
    "absent",
    "regularity",
    "aliases",
    "explanation",
    "probes",
)
# stood with the effect itself before ``traits`` did
_FORMERLY = ("onset", "per_record", "plausible")


def candidates_for(model: Model, own: Sequence[Traceable] = ()) -> tuple[Traceable, ...]:
    """The library's effects that can act on a model, are not in it and tell a search where to look,
    then the user's ``own``.
    """
    from sim.effects.library import effects_for

    equations = model.equations
    taken = {effect.name for effect in model.effects} | {
        *(equations.contains if isinstance(equations, Containing) else ())
    }
    recorded = {signal.name for signal in equations.inputs}
    offered = can_act(effects_for(equations), model)
    found = (
        effect for effect in offered if effect.name not in taken and isinstance(effect, Traceable)
    )
    known = (effect for effect in found if effect.traits.recorded_as not in recorded)
    return (*(effect for effect in known if _may_change(effect, model)), *own)


def _may_change(effect: Effect, model: Model) -> bool:
    """Whether what an effect makes vary is estimated."""
    changed = (
        (effect.parameter,)
        if isinstance(effect, ParameterEffect)
        else effect.group
        if isinstance(effect, GroupEffect)
        else ()
    )
    return all(model.parameters[name].free for name in changed)


def can_act(effects: Sequence[Act], model: Model) -> tuple[Act, ...]:
    """Those effects that find the signals they take: an own model may have a channel's name without
    what the library's models form beside it.
    """
    return tuple(effect for effect in effects if not is_own(model) or _acts(effect, model))


def _acts(effect: Effect, model: Model) -> bool:
    try:
        system = compile_model(model.with_effects(effect))
        x, u = system.initial.values().tolist(), inputs_at_rest(model)
        p = system.parameters.values().tolist()
        with np.errstate(all="ignore"):
            system.f(0.0, x, u, p)
            system.h(0.0, x, u, p)
            system.noise(p)
    except (AttributeError, KeyError, ModelError):
        return False
    except ArithmeticError:
        return True  # no value at rest is no lack of a signal
    return True


def read_effects(source: str | Path | Source, model: Model) -> tuple[Traceable, ...]:
    """The effects of a user's Python file, or of one that was read, that can act on a model: its
    ``EFFECTS``, else its ``VARIANTS``.

    The file is run, once, as any Python program is: only a file that the user names comes here.

    Raises
    ------
    DeclarationError : no such file, an error in it (with its line), no effects in it, an effect
    that lacks an attribute or has
        the name of one in the library, or none that can act on this model.
    """
    source = source if isinstance(source, Source) else read_source(source, DeclarationError, WANTED)
    where = str(source.path)
    module = run_python(source, "effects")
    effects = getattr(module, "EFFECTS", getattr(module, "VARIANTS", None))
    if not isinstance(effects, tuple | list) or not effects:
        raise DeclarationError(
            "it offers no effect",
            where=where,
            remedy="define EFFECTS, a tuple of effects, at its top level",
        )
    return checked_effects(effects, model, where)


def checked_effects(effects: Sequence[Any], model: Model, where: str) -> tuple[Traceable, ...]:
    """A user's effects that can act on a model; ``where`` says where they stand. Raises
    DeclarationError as ``read_effects``.
    """
    from sim.effects.library import applies, library

    known = {effect.name for effect in library()}
    for effect in effects:
        _check(effect, where)
        if effect.name in known:
            raise DeclarationError(
                f"effect {effect.name}: the library has one of this name",
                where=where,
                remedy="give yours another name",
            )
    able = tuple(effect for effect in effects if applies(effect, model.equations))
    if not able:
        named = ", ".join(dict.fromkeys(effect.name for effect in effects))
        e = model.equations
        remedy = (
            f"its inputs are {_listed(e.inputs)}, its outputs {_listed(e.outputs)}, its ports "
            f"{_listed(e.ports)}"
        )
        raise DeclarationError(
            f"no effect of it ({named}) can act on the {model.equations.name} model",
            where=where,
            remedy=remedy,
        )
    able_names = [effect.name for effect in able]
    for name in able_names:
        if able_names.count(name) > 1:
            raise DeclarationError(
                f"effect {name} is there twice", where=where, remedy="give each a name of its own"
            )
    return able


def _check(effect: Any, where: str) -> None:
    """Refuse what is no effect; an effect of the former form is given its traits."""
    if isinstance(effect, type):
        raise DeclarationError(
            f"{effect.__name__} is a class",
            where=where,
            remedy=f"put an instance into EFFECTS: {effect.__name__}(...)",
        )
    wanted = _ATTRIBUTES if hasattr(effect, "traits") else (*_ATTRIBUTES, *_FORMERLY)
    missing = [attribute for attribute in wanted if not hasattr(effect, attribute)]
    if missing == [*_FORMERLY]:
        missing = ["traits"]
    if missing:
        shown = (
            effect.name
            if hasattr(effect, "name") and isinstance(effect.name, str) and effect.name
            else type(effect).__name__
        )
        raise DeclarationError(
            f"effect {shown} lacks {', '.join(missing)}",
            where=where,
            remedy="add it as docs/how-to/own-effect.md shows",
        )
    if hasattr(effect, "traits") and not isinstance(effect.traits, Traits):
        remedy = "make them with sim.declaration.proposal.Traits"
        raise DeclarationError(
            f"effect {effect.name}: its traits are of type {type(effect.traits).__name__}",
            where=where,
            remedy=remedy,
        )
    if not hasattr(effect, "traits"):
        # On the class, so that copies of the effect have it, too.
        type(effect).traits = property(_former_traits)


def _former_traits(effect: Any) -> Traits:
    sentences = (str(effect.sentence),) if hasattr(effect, "sentence") else ()
    return Traits(
        sentences,
        plausible=effect.plausible,
        onset=effect.onset,
        per_record=bool(effect.per_record),
    )


def _listed(signals: Sequence[Signal]) -> str:
    return ", ".join(signal.name for signal in signals) or "none"
