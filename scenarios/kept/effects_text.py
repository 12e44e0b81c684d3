"""Effects as plain text and back: their class and what it was made with, so that a claimed one is the same one on another day."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import Any, get_type_hints

from sim.declaration.effect import Effect
from sim.declaration.proposal import Traceable
from sim.errors import DeclarationError, FlightidError

ROOM = "sim.effects."  # effects of the library, and nothing else, are made again by the name of their class


def effect_content(effect: Traceable) -> dict[str, Any]:
    """Name, class and fields of an effect; of a user's own the name alone, since its class is in a file of the user's."""
    if not type(effect).__module__.startswith(ROOM):
        return {"name": effect.name, "own": True}
    return {"name": effect.name, **_object(effect)}


def effect_of(content: Mapping[str, Any], own: Sequence[Traceable], where: str) -> Traceable:
    """The effect that ``effect_content`` described; one of ``own`` where it was a user's.

    Raises
    ------
    DeclarationError : a user's effect that is not among ``own``, or a class that this version does not have.
    """
    name = str(content.get("name", ""))
    if content.get("own"):
        found = next((effect for effect in own if effect.name == name), None)
        if found is None:
            remedy = "name the file it came from with --effects"
            raise DeclarationError(f"{name} is an effect of a file that the study was made with", where=where, remedy=remedy)
        return found
    try:
        effect: Traceable = _made(content)
        if not isinstance(effect, Effect) or effect.name != name:
            raise TypeError("its class is another's")
    except (AttributeError, ImportError, KeyError, TypeError, ValueError, FlightidError) as error:
        what = f"the effect {name or '?'} cannot be made again ({' '.join(str(error).split())})"
        raise DeclarationError(what, where=where, remedy="run the study again with this version") from None
    return effect


def _object(value: Any) -> dict[str, Any]:
    given = {item.name: getattr(value, item.name) for item in fields(value) if item.init and getattr(value, item.name) != _default(item)}
    return {"class": f"{type(value).__module__}:{type(value).__qualname__}", "fields": {name: _plain(each) for name, each in given.items()}}


def _default(item: Field[Any]) -> Any:
    return item.default_factory() if item.default_factory is not MISSING else item.default


def _plain(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        return _object(value)
    if isinstance(value, Mapping):
        return {"mapping": {str(key): _plain(each) for key, each in value.items()}}
    if isinstance(value, tuple | list):
        return [_plain(each) for each in value]
    if not isinstance(value, str | bool | int | float):
        raise TypeError(f"a {type(value).__name__} is no plain value")
    return value


def _made(content: Mapping[str, Any]) -> Any:
    module, _, name = content["class"].partition(":")
    if not module.startswith(ROOM):
        raise ValueError(f"{module} is not of the library")
    kind = getattr(importlib.import_module(module), name)
    if not (isinstance(kind, type) and is_dataclass(kind)):
        raise TypeError(f"{name} is no effect")
    given = {key: _value(each) for key, each in content["fields"].items()}
    hints = get_type_hints(kind)
    for key, value in given.items():
        refuse_other_kind(value, hints[key])
    return kind(**given)


def _value(content: Any) -> Any:
    if isinstance(content, Mapping):
        return {key: _value(each) for key, each in content["mapping"].items()} if "mapping" in content else _made(content)
    return tuple(_value(each) for each in content) if isinstance(content, list) else content


def refuse_other_kind(value: Any, kind: Any) -> None:
    """Raise TypeError where a value that was read is not of the type that is declared for it, or holds a number that is not finite."""
    from pydantic import ConfigDict, TypeAdapter, ValidationError

    plain = is_dataclass(kind) and isinstance(kind, type)
    try:
        if plain and not isinstance(value, kind):
            raise TypeError(f"a {type(value).__name__} where a {kind.__name__} is due")
        if not plain:
            settings = ConfigDict(arbitrary_types_allowed=True, allow_inf_nan=False)
            TypeAdapter(kind, config=settings).validate_python(value, strict=True)
    except ValidationError as error:
        raise TypeError(f"{value!r:.40} is no {kind}: {error.errors()[0]['msg']}") from None


def refuse_other_fields(content: Mapping[str, Any], kind: type) -> None:
    """Raise TypeError where the values under the names of a dataclass's fields are not of their types; KeyError for a name it does not have."""
    hints = get_type_hints(kind)
    for key, value in content.items():
        refuse_other_kind(value, hints[key])
