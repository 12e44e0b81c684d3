"""Rows of the page on the two papers: printed numbers beside the project's, figures, findings."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Mapping
from dataclasses import dataclass

from exam.reproduction.declaration import (
    Matrix,
    Paper,
    Part,
    Printed,
    Statement,
    Values,
    digits,
    printed_of,
    printed_values,
)
from exam.reproduction.lookups import Found, Numbers
from scenarios.files.units import to_si
from scenarios.report.quantities import number_text
from sim.errors import DeclarationError

# ---- Rows of the page

# What the low-order fit to a loop's own frequency response has; L_q is held in it at the value that
# is flown.
LOOP = (
    "L_alpha",
    "M_alpha",
    "L_delta",
    "M_delta",
    "L_q",
    "M_q",
    "inv_tau",
    "natural_frequency",
    "damping_ratio",
    "delay",
)
SAME = 1e-4  # relative: what units and the digits that are kept leave
CLOSE = 2.0  # sigmas beyond which a row has a reason


@dataclass(frozen=True)
class Row:
    """One printed number beside ours.

    ``true`` is the true value (empty without one). ``reference`` is a further value of comparison,
    and ``off`` has the distances of both numbers from it in their own sigmas; both are None without
    one. ``sigmas`` is None if the two are not compared in sigmas.
    """

    name: str
    true: str
    reference: str
    printed: str
    ours: str
    difference: str
    off: str
    why: str
    sigmas: float | None = None


def rows_of(paper: Paper, part: Part, group: Values, numbers: Numbers) -> list[Row]:
    """The rows of a group.

    Raises
    ------
    DeclarationError : a number is missing, a row that must say why does not, or a printed true
    value is not flown and no misprint.
    """
    rows = [
        _row(paper, part, group, name, printed, numbers)
        for name, printed in printed_values(paper, group).items()
    ]
    return [*rows, _zero(group, numbers)] if group.zero else rows


def _zero(group: Values, numbers: Numbers) -> Row:
    """Return the row of quantities that are zero in print and in ours. Raises DeclarationError if
    ours is not.
    """
    others = [
        name
        for name in group.zero
        if numbers(f"{group.study}: {group.path.format(name=name)}").value
    ]
    if others:
        raise DeclarationError(
            f"{', '.join(others)} of ours is not zero",
            where=group.label,
            remedy="give it a row under printed",
        )
    return Row("`, `".join(group.zero), "", "none", "0", "0", "same", "none", "zero in both")


def _row(
    paper: Paper, part: Part, group: Values, name: str, printed: Printed, numbers: Numbers
) -> Row:
    path = group.path.format(name=name)
    sign = (
        -1.0 if group.turned and sum(each in paper.turned for each in name.split(".")) % 2 else 1.0
    )
    ours = _shown(numbers(f"{group.study}: {path}"), group, sign)
    reference = _reference(group, name, sign, numbers)
    where = f"{paper.published}, {group.label}, {name}"
    sigmas = _sigmas(printed, ours) if group.compare == "sigmas" else None
    return Row(
        name,
        _true(part, group, name, numbers, where),
        "none" if reference is None else _plain(f"{reference.value:.4g}"),
        printed.text(),
        _text(ours),
        _difference(group, printed, ours, sigmas),
        "none" if reference is None else _off(printed, ours, reference.value),
        _why(group, name, sigmas, reference is not None and _near(ours, reference.value), where),
        sigmas,
    )


def _reference(group: Values, name: str, sign: float, numbers: Numbers) -> Found | None:
    """Return the value with which both numbers are compared; None without one."""
    if group.reference == "loop_equivalent":
        study = group.study.partition("/")[0]
        return (
            _shown(numbers(f"{study}: frequency_response.loop_with_flown_L_q.{name}"), group, sign)
            if name in LOOP
            else None
        )
    return (
        _shown(numbers(f"{group.study}: {name}.{group.reference}"), group, sign)
        if group.reference
        else None
    )


def _shown(found: Found, group: Values, sign: float) -> Found:
    """Return our number in the paper's unit and sign."""
    factor = (
        float(to_si(1.0, found.unit or group.own_unit, group.unit, group.label, DeclarationError))
        if group.unit
        else 1.0
    )
    return Found(
        sign * factor * found.value + 0.0,
        None if found.std is None else factor * found.std,
        group.unit or found.unit,
    )


def _text(found: Found) -> str:
    if found.std:
        return (
            f"{_plain(number_text(found.value, found.std))} +- "
            f"{_plain(number_text(found.std, found.std))}"
        )
    return _plain(f"{found.value:.4g}")


def _plain(text: str) -> str:
    short = text.replace("e-0", "e-").replace("e+0", "e")
    return short if short.strip("-0.") else short.removeprefix("-")


def _sigmas(printed: Printed, ours: Found) -> float:
    """Return ours minus the printed value over the root of both variances, or of the known one;
    infinite if neither is known.
    """
    value = float(printed.value)
    if printed.upper is not None:
        value = min(max(ours.value, value), float(printed.upper))
    spread = math.hypot(printed.std or 0.0, ours.std or 0.0)
    return (
        (ours.value - value) / spread
        if spread > 0
        else math.copysign(math.inf, ours.value - value)
        if ours.value != value
        else 0.0
    )


def _difference(group: Values, printed: Printed, ours: Found, sigmas: float | None) -> str:
    if sigmas is not None:
        if math.isfinite(sigmas):
            return f"{sigmas:+.1f}" if printed.upper is None or sigmas else "inside"
        return f"{100.0 * (ours.value / float(printed.value) - 1.0):+.1f} %"
    if group.compare == "ratio":
        return (
            "same"
            if math.isclose(float(printed.value), ours.value, rel_tol=SAME)
            else "not zero"
            if not printed.value
            else f"x {ours.value / float(printed.value):.3g}"
        )
    return (
        f"{ours.value - float(printed.value):+.2f}"
        if group.compare == "difference"
        else "not compared"
    )


def _off(printed: Printed, ours: Found, reference: float) -> str:
    """Return the distances of the printed value and ours from the reference, each in its own
    sigmas.
    """
    theirs = (
        f"{(float(printed.value) - reference) / printed.std:+.1f}" if printed.std else "no sigma"
    )
    return (
        f"{theirs}; {(ours.value - reference) / ours.std:+.1f}"
        if ours.std
        else f"{theirs}; no sigma"
    )


def _true(part: Part, group: Values, name: str, numbers: Numbers, where: str) -> str:
    """Return the printed true value, and the one that is flown if it differs."""
    if not part.true:
        return ""
    if name not in part.true:
        raise DeclarationError(
            "no true value is declared", where=where, remedy="add it to true of its part"
        )
    printed = printed_of(part.true[name], where).value
    flown = _shown(numbers(f"{group.study}: {name}.true"), group, 1.0).value
    same = math.isclose(float(printed), flown, rel_tol=1e-5)
    if same == (name in part.misprints):
        what = f"true value {printed}, flown {flown:g}"
        raise DeclarationError(
            what, where=where, remedy="say under misprints why it is not flown, or strike it there"
        )
    return digits(printed) if same else f"{digits(printed)}, flown {flown:.4g}"


def _near(ours: Found, reference: float) -> bool:
    """Return whether ours is within two of its sigmas of the reference."""
    return bool(ours.std) and abs(ours.value - reference) <= CLOSE * (ours.std or 0.0)


def _why(group: Values, name: str, sigmas: float | None, found: bool, where: str) -> str:
    """Return the reason of a row; ``found`` is a reason only if the numbers of the row support
    it.
    """
    reason = group.reasons.get(name, "")
    close = sigmas is not None and abs(sigmas) <= CLOSE
    why = (
        group.within
        if close and not reason
        else group.found
        if found and group.found
        else reason or group.why
    )
    if not why:
        raise DeclarationError(
            f"{sigmas:+.1f} sigmas and no reason" if sigmas is not None else "no reason",
            where=where,
            remedy="say why",
        )
    return why


# ---- Figures and conclusions of the page

_TERM = r"\|?[-+]?[\w.]+\|?"
_CONDITION = re.compile(rf"({_TERM}) ([<>]) ({_TERM})")
_COMPARED = {"<": operator.lt, ">": operator.gt}


@dataclass(frozen=True)
class Told:
    """A statement with its numbers inserted; ``figure`` is empty without one."""

    place: str
    says: str
    ours: str
    figure: str
    agrees: str
    why: str


def told(statement: Statement, numbers: Numbers) -> Told:
    """Return a statement with its numbers. Raises DeclarationError if a figure or number is
    missing, or the statement does not follow.
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
    """Return a number, or two as ``A minus B`` or ``A over B``, which has no sigma."""
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
        """The pair with the largest difference."""
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
    """Return both matrices, ours with the signs of the paper. Raises DeclarationError if a row has
    too many or too few entries.
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
