"""Keywords of Python: messages in their words instead of options, and what they may hold."""

from __future__ import annotations

import contextlib
import functools
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import ParamSpec, TypeVar

from sim.errors import DeclarationError, FlightidError

P = ParamSpec("P")
R = TypeVar("R")
_OPTION = re.compile(r"(?<![\w-])--([a-z][a-z-]*)")
# An option with its value, a word, and a command with the files and options behind it.
_WITH_VALUE = re.compile(r"(?<![\w-])--(method|hold|margins) ([a-z-]+)")
_COMMAND = re.compile(
    r"\bflightid ([a-z]+)((?: (?:--(?!method|hold)[a-z-]+ [^\s;,]+|[A-Z]{3,}|[^\s;,]+\.[a-z]\w*))*)"
)
# Options whose keyword is another word: those that Python keeps for itself, and plurals.
WORDS = {
    "from": "start",
    "to": "stop",
    "class": "aircraft_class",
    "out": "save(folder)",
    "value": "values",
}


def as_keywords(text: str) -> str:
    """A message with keywords in the place of options.

    Examples
    --------
    >>> as_keywords("use --from and --trust-record")
    'use start= and trust_record='
    """

    def keyword(found: re.Match[str]) -> str:
        name = WORDS.get(found[1], found[1].replace("-", "_"))
        return name if name.endswith(")") else f"{name}="

    return _OPTION.sub(keyword, _WITH_VALUE.sub(r'\1="\2"', text))


def in_python_words(sentences: Iterable[str]) -> tuple[str, ...]:
    """Sentences of a result, with functions and keywords in the place of commands and options.

    Examples
    --------
    >>> in_python_words(["next: flightid diagnose f.csv --model rigid --vehicle v.toml"])
    ('next: flightid.diagnose on the same records',)
    """

    def call(found: re.Match[str]) -> str:
        given = " on the same records" if found[2] else ""
        return f"flightid.{found[1].replace('response', 'frequency_response')}{given}"

    found = (as_keywords(_COMMAND.sub(call, each)) for each in sentences)
    return tuple(each.replace(" records method=", " records with method=") for each in found)


@contextlib.contextmanager
def in_python() -> Iterator[None]:
    """Raise what is raised inside in the words of Python; the kind of the error stays."""
    try:
        yield
    except FlightidError as error:
        parts = [as_keywords(each) for each in (error.what, error.where, error.remedy)]
        if parts == [error.what, error.where, error.remedy]:
            raise
        raise type(error)(parts[0], where=parts[1], remedy=parts[2]) from None


def told_in_python(function: Callable[P, R]) -> Callable[P, R]:
    """A function of the commands whose messages name keywords, not options."""

    @functools.wraps(function)
    def told(*args: P.args, **kwargs: P.kwargs) -> R:
        with in_python():
            return function(*args, **kwargs)

    return told


def names_of(
    given: str | Sequence[str], kind: str = "signal", where: str = "input, output"
) -> tuple[str, ...]:
    """One name or several of a ``kind``. Raises DeclarationError for what is none."""
    names = (given,) if isinstance(given, str) else given
    if not isinstance(names, Sequence) or not all(isinstance(each, str) for each in names):
        remedy = "give a name or a list of names"
        raise DeclarationError(f"{given!r} names no {kind}", where=where, remedy=remedy)
    return tuple(names)


def band_of(given: tuple[float, float] | None) -> tuple[float, float] | None:
    """Lowest and highest frequency, Hz. Raises DeclarationError for what is no pair of numbers."""
    if given is None:
        return None
    try:
        low, high = map(float, given)
    except (TypeError, ValueError):
        remedy = "give the lowest and the highest frequency, Hz: (0.1, 8)"
        raise DeclarationError(f"{given!r} is no band", where="band", remedy=remedy) from None
    return low, high
