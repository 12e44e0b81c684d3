"""What a search may propose: the library's effects for a vehicle, and a user's own effects from a file."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from scenarios.files.sources import Source, read_source
from scenarios.preparation.plan import SPEED
from sim.declaration.effect import Effect
from sim.declaration.model import Model
from sim.errors import DeclarationError, FlightidError

# Of the low-order equivalent system they are part of the model itself.
_OWN_OF_LOES = ("input-delay", "actuator-lag")
_ATTRIBUTES = ("name", "station", "parameters", "absent", "regularity", "aliases", "explanation")
_TRACED = ("onset", "per_record", "plausible", "probes")


def candidates_for(model: Model, own: Sequence[Effect] = ()) -> tuple[Effect, ...]:
    """The library's effects that can act on a model, are not in it and tell a search where to look, then the user's ``own``."""
    from sim.declaration.proposal import Traceable
    from sim.effects.library import effects_for

    taken = {effect.name for effect in model.effects} | ({*_OWN_OF_LOES} if model.equations.name == "loes" else set())
    if any(signal.name == SPEED for signal in model.equations.inputs):
        taken.add("speed-variation")
    found = effects_for(model.equations)
    return (*(effect for effect in found if effect.name not in taken and isinstance(effect, Traceable)), *own)


def read_effects(path: str | Path, model: Model) -> tuple[Effect, ...]:
    """The effects of a user's Python file that can act on a model, as ``effects_of``. Raises DeclarationError, also where there is no such file."""
    return effects_of(read_source(path, DeclarationError, "a Python file"), model)


def effects_of(source: Source, model: Model) -> tuple[Effect, ...]:
    """The effects of a Python file that was read: its ``EFFECTS``, else its ``VARIANTS``, those that can act on a model.

    The file is run, once, as any Python program is: only a file that the user names comes here.

    Raises
    ------
    DeclarationError : no Python file, an error in it (with its line), no effects in it, an effect that lacks an attribute or has
        the name of one in the library, or none that can act on this model.
    """
    from sim.effects.library import applies, library

    where = str(source.path)
    module = _run(source)
    effects = getattr(module, "EFFECTS", getattr(module, "VARIANTS", None))
    if not isinstance(effects, tuple | list) or not effects:
        raise DeclarationError("it offers no effect", where=where, remedy="define EFFECTS, a tuple of effects, at its top level")
    known = {effect.name for effect in library()}
    names: list[str] = []
    for effect in effects:
        shown = _checked(effect, where)
        if shown in known:
            raise DeclarationError(f"effect {shown}: the library has one of this name", where=where, remedy="give yours another name")
        names.append(shown)
    able = tuple(effect for effect in effects if applies(effect, model.equations))
    if not able:
        named = ", ".join(dict.fromkeys(names))
        e = model.equations
        remedy = f"its inputs are {_listed(e.inputs)}, its outputs {_listed(e.outputs)}, its ports {_listed(e.ports)}"
        raise DeclarationError(f"no effect of it ({named}) can act on the {model.equations.name} model", where=where, remedy=remedy)
    able_names = [effect.name for effect in able]
    for name in able_names:
        if able_names.count(name) > 1:
            raise DeclarationError(f"effect {name} is there twice", where=where, remedy="give each a name of its own")
    return able


def _checked(effect: object, where: str) -> str:
    name = getattr(effect, "name", None)
    shown = name if isinstance(name, str) and name else type(effect).__name__
    missing = [attribute for attribute in (*_ATTRIBUTES, *_TRACED) if not hasattr(effect, attribute)]
    if isinstance(effect, type):
        raise DeclarationError(f"{effect.__name__} is a class", where=where, remedy=f"put an instance into EFFECTS: {effect.__name__}(...)")
    if missing:
        raise DeclarationError(f"effect {shown} lacks {', '.join(missing)}", where=where, remedy="add it as docs/how-to/own-effect.md shows")
    return shown


def _run(source: Source) -> ModuleType:
    path, where = source.path, str(source.path)
    if path.suffix != ".py":
        raise DeclarationError("this is no Python file", where=where, remedy="name a file that ends in .py")
    name = f"flightid_effects_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their own module up
    try:
        exec(compile(source.content, where, "exec", dont_inherit=True), module.__dict__)  # these bytes were hashed
    except FlightidError as error:
        raise DeclarationError(str(error), where=f"{where}{_line(error, path)}", remedy="mend that place") from None
    except Exception as error:  # the file is a user's, and anything may be wrong with it
        line = f", line {error.lineno}" if isinstance(error, SyntaxError) and error.lineno else _line(error, path)
        text = error.msg if isinstance(error, SyntaxError) else str(error)
        what = " ".join(f"{type(error).__name__}: {text}".split())
        raise DeclarationError(what, where=f"{where}{line}", remedy="mend that line") from None
    finally:
        sys.modules.pop(name, None)
    return module


def _line(error: BaseException, path: Path) -> str:
    """The line of the user's file that the error came through last."""
    found, trace = "", error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(path):
            found = f", line {trace.tb_lineno}"
        trace = trace.tb_next
    return found


def _listed(signals: Sequence[object]) -> str:
    return ", ".join(getattr(signal, "name", "?") for signal in signals) or "none"
