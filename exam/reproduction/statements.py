"""Figures and conclusions of the page: what the paper shows, what ours shows with its numbers, and
whether it follows from them.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Mapping
from dataclasses import dataclass

from exam.reproduction.declaration import Matrix, Statement
from exam.reproduction.lookups import Found, Numbers
from sim.errors import DeclarationError

_TERM = r"\|?[-+]?[\w.]+\|?"
_CONDITION = re.compile(rf"({_TERM}) ([<>]) ({_TERM})")
_COMPARED = {"<": operator.lt, ">": operator.gt}


@dataclass(frozen=True)
class Told:
    """A statement with its numbers put in; ``figure`` is empty where it has none."""

    place: str
    says: str
    ours: str
    figure: str
    agrees: str
    why: str


def told(statement: Statement, numbers: Numbers) -> Told:
    """A statement with its numbers. Raises DeclarationError where a figure or number is missing, or
    what is said no longer follows.
    """
    found = {name: combined(lookup, numbers) for name, lookup in statement.numbers.items()}
    if statement.figure:
        study, _, file = statement.figure.partition("/")
        numbers(f"{study}: files.{file}")
    values = {name: each.value for name, each in found.items()}
    for condition in statement.holds:
        if not holds(condition, values):
            remedy = (
                "look at what has changed, and say anew whether it agrees: "
                f"{', '.join(f'{n} {v:.6g}' for n, v in values.items())}"
            )
            raise DeclarationError(
                f"{condition} does not hold",
                where=f"reproduction, {statement.place}",
                remedy=remedy,
            )
    try:
        ours = statement.ours.format(**{name: _Shown(each) for name, each in found.items()})
    except (KeyError, ValueError, IndexError) as error:
        raise DeclarationError(
            f"{error} in braces",
            where=f"reproduction, {statement.place}",
            remedy="name it under numbers",
        ) from None
    return Told(
        statement.place, statement.says, ours, statement.figure, statement.agrees, statement.why
    )


def combined(lookup: str, numbers: Numbers) -> Found:
    """A number, or two as ``A minus B`` or ``A over B``, which has no sigma."""
    for word, work in ((" minus ", operator.sub), (" over ", operator.truediv)):
        first, found, second = lookup.partition(word)
        if found:
            return Found(work(numbers(first).value, numbers(second).value))
    return numbers(lookup)


class _Shown:
    """A number as a template writes it: ``{x}`` three digits, ``{x:.0%}`` any format of a number,
    ``{x:size}`` without its sign.
    """

    def __init__(self, found: Found) -> None:
        self.found = found

    def __format__(self, form: str) -> str:
        value = self.found.value
        return format(abs(value), ".3g") if form == "size" else format(value, form or ".3g")


def holds(condition: str, values: Mapping[str, float]) -> bool:
    """Whether ``"name < 0.1"`` or ``"|name| > other"`` holds. Raises DeclarationError for another
    form or an unknown name.
    """
    found = _CONDITION.fullmatch(condition)
    if found is None:
        raise DeclarationError(
            f"{condition!r} is no condition",
            where="reproduction",
            remedy="write name < number, |name| > number or name > name",
        )
    return bool(_COMPARED[found[2]](_term(found[1], values), _term(found[3], values)))


def _term(text: str, values: Mapping[str, float]) -> float:
    name = text.strip("|")
    try:
        value = values[name] if name in values else float(name)
    except ValueError:
        raise DeclarationError(
            f"there is no number {name!r}", where="reproduction", remedy="name it under numbers"
        ) from None
    return abs(value) if text.startswith("|") else value


@dataclass(frozen=True)
class Cells:
    """A printed correlation matrix beside ours: ``printed`` and ``ours`` by pair of names, the
    earlier name first.
    """

    names: tuple[str, ...]
    printed: Mapping[tuple[str, str], float]
    ours: Mapping[tuple[str, str], float]

    @property
    def worst(self) -> tuple[str, str]:
        """The pair that differs most."""
        return max(self.printed, key=lambda pair: abs(self.ours[pair] - self.printed[pair]))

    @property
    def rms(self) -> float:
        """Root mean square of the differences."""
        return float(
            (
                sum((self.ours[pair] - r) ** 2 for pair, r in self.printed.items())
                / len(self.printed)
            )
            ** 0.5
        )


def cells_of(matrix: Matrix, turned: list[str], numbers: Numbers) -> Cells:
    """Both matrices; ours with the signs of the paper. Raises DeclarationError where a row has too
    many or too few entries.
    """
    printed: dict[tuple[str, str], float] = {}
    for at, (name, line) in enumerate(zip(matrix.names, [*matrix.upper, ""], strict=True)):
        others, entries = matrix.names[at + 1 :], line.split()
        if len(others) != len(entries):
            what = f"{len(entries)} entries, {len(others)} are due"
            raise DeclarationError(
                what, where=f"reproduction, {matrix.label}, {name}", remedy="see the paper"
            )
        printed |= {
            (name, other): float(entry) for other, entry in zip(others, entries, strict=True)
        }
    ours = {}
    for a, b in printed:
        sign = -1.0 if (a in turned) != (b in turned) else 1.0
        ours[a, b] = sign * numbers(f"{matrix.study}: correlation.{a}.{b}").value
    return Cells(tuple(matrix.names), printed, ours)
