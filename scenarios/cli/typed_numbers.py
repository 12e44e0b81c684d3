"""Numbers as they are typed, by the rule by which files are read: digits from 0 to 9, nothing
between them.
"""

from __future__ import annotations

import typing
from collections.abc import Sequence

from sim.errors import DeclarationError


def refuse_foreign_digits(given: Sequence[str]) -> None:
    """Raise DeclarationError where an option's number is typed as Python alone would read it: in
    digits of another script, or with underscores.
    """
    for at, word in enumerate(given):
        name, equals, text = word.partition("=")
        values = [text] if equals else given[at + 1 : at + 3]
        for value in values if name.startswith("--") else ():
            if value.startswith("-") and not value[1:2].isdecimal():
                break
            if _is_foreign(value) and name in _numeric_options(given[0]):
                raise DeclarationError(
                    f"{value!r} is no plain number",
                    where=name,
                    remedy="write it in digits from 0 to 9",
                )


def _is_foreign(text: str) -> bool:
    try:
        return not (text.isascii() and "_" not in text) and float(text) is not None
    except ValueError:
        return False


def _numeric_options(command: str) -> frozenset[str]:
    """The options of a command that take a number, by the annotations of its function."""
    from scenarios.cli.application import COMMANDS

    functions = {function.__name__.rstrip("_"): function for group in COMMANDS.values() for function in group}
    if command not in functions:
        return frozenset()
    hints = typing.get_type_hints(functions[command], include_extras=True).values()
    options = [(hint, declared) for hint in hints for declared in getattr(hint, "__metadata__", ())]
    numeric = [declared for hint, declared in options if _holds_number(hint.__origin__)]
    # Within an annotation the library keeps the first name where a default would be.
    return frozenset(name for each in numeric for name in (each.default, *(each.param_decls or ())) if isinstance(name, str))


def _holds_number(kind: object) -> bool:
    return kind in (int, float) or any(map(_holds_number, typing.get_args(kind)))
