"""The table ``own`` of a scenario file: which of its values no source gives, and why each was chosen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from scenarios.studies.declaration import Choice
from sim.errors import DeclarationError

MOST_ENTRIES = 6  # of a list of numbers that is told one by one


def choices_of(own: Mapping[str, Any], document: Mapping[str, Any], where: str) -> tuple[Choice, ...]:
    """The choices that ``own`` declares of ``document``, whose keys it repeats with a reason in the place of each value.

    The value is read from the document, so that a study tells what it really used; ``where`` is the key of ``own`` in messages.

    Raises
    ------
    DeclarationError : a key that the document does not have, or a reason that is no text.
    """
    return tuple(_choices(own, document, where, ""))


def _choices(own: Mapping[str, Any], found: Any, where: str, above: str) -> Iterator[Choice]:
    for name, reason in own.items():
        key, value = f"{above}{name}", _inside(found, name)
        if value is None:
            raise DeclarationError("the file has no such value", where=f"{where}.{key}", remedy="name a key that stands in it, or leave it out")
        if isinstance(reason, Mapping):
            yield from _choices(reason, value, where, f"{key}.")
        elif isinstance(reason, str) and reason.strip():
            yield Choice(key, value_text(value), " ".join(reason.split()))
        else:
            raise DeclarationError(f"{reason!r} is no reason", where=f"{where}.{key}", remedy="say in words why this value was chosen")


def without_gone(own: Mapping[str, Any], before: Any, after: Any) -> dict[str, Any]:
    """What ``own`` says of values that a change of the document took away is left out."""
    out: dict[str, Any] = {}
    for name, reason in own.items():
        old, new = _inside(before, name), _inside(after, name)
        if new is None and old is not None:
            continue
        kept = without_gone(reason, old, new) if isinstance(reason, Mapping) else reason
        if kept != {} or reason == {}:
            out[name] = kept
    return out


def methods_without_gone(before: Mapping[str, Any], after: dict[str, Any]) -> dict[str, Any]:
    """A changed document likewise in the table ``own`` of each method; what a method does not declare is the main one's."""
    were, now = before.get("methods"), after.get("methods")
    if not (isinstance(were, list) and isinstance(now, list) and len(were) == len(now)):
        return after
    return {**after, "methods": [_method(old, new, before, after) for old, new in zip(were, now, strict=True)]}


def _method(old: Any, new: Any, before: Mapping[str, Any], after: Mapping[str, Any]) -> Any:
    if not (isinstance(old, Mapping) and isinstance(new, Mapping) and isinstance(new.get("own"), Mapping)):
        return new
    main = [document["estimate"] if isinstance(document.get("estimate"), Mapping) else {} for document in (before, after)]
    return {**new, "own": without_gone(new["own"], {**main[0], **old}, {**main[1], **new})}


def _inside(table: Any, name: str) -> Any:
    """An entry of a table, or of a list by its number from one; None where it is not there."""
    if isinstance(table, list):
        return table[int(name) - 1] if name.isascii() and name.isdigit() and 1 <= int(name) <= len(table) else None
    return table.get(name) if isinstance(table, Mapping) else None


def value_text(value: Any) -> str:
    """A value of a scenario file in one line: ``"100 Hz"``, ``"550 lb/ft2 +- 110 lb/ft2"``, ``"CL_q -11 +- 6, CL_de 0.35 +- 0.2"``."""
    if isinstance(value, Mapping):
        if value.keys() == {"value", "std"}:
            return f"{value_text(value['value'])} +- {value_text(value['std'])}"
        return ", ".join(f"{name} {value_text(entry)}" for name, entry in value.items())
    if isinstance(value, list):
        told = len(value) <= MOST_ENTRIES and not any(isinstance(entry, Mapping) for entry in value)
        return ", ".join(value_text(entry) for entry in value) if told else f"({len(value)} entries)"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else str(value)
