"""Rows of the page: a printed number beside ours, their difference, and why."""

from __future__ import annotations

import math
from dataclasses import dataclass

from exam.reproduction.declaration import (
    Paper,
    Part,
    Printed,
    Values,
    digits,
    printed_of,
    printed_values,
)
from exam.reproduction.lookups import Found, Numbers
from scenarios.files.units import to_si
from scenarios.report.quantities import number_text
from sim.errors import DeclarationError

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
CLOSE = 2.0  # sigmas beyond which a row says why


@dataclass(frozen=True)
class Row:
    """One printed number beside ours.

    ``true`` is empty and ``reference`` none where there is none, ``off`` too: how far both are from
    the reference in their own sigmas. ``sigmas`` is None where the two are not compared in sigmas.
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
    """The row of what is zero in print and in ours. Raises DeclarationError where ours is not."""
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
    """What both numbers are held against, None where the group or the quantity has nothing."""
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
    """Ours in the paper's unit and sign."""
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
    """Ours minus the printed value over the root of both variances, of the one that is known where
    one is; infinite where neither is.
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
    """How far the printed value and ours are from the reference, each in its own sigmas."""
    theirs = (
        f"{(float(printed.value) - reference) / printed.std:+.1f}" if printed.std else "no sigma"
    )
    return (
        f"{theirs}; {(ours.value - reference) / ours.std:+.1f}"
        if ours.std
        else f"{theirs}; no sigma"
    )


def _true(part: Part, group: Values, name: str, numbers: Numbers, where: str) -> str:
    """The printed true value, and the one that is flown where it is another."""
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
    """Whether ours is within two of its sigmas of the reference."""
    return bool(ours.std) and abs(ours.value - reference) <= CLOSE * (ours.std or 0.0)


def _why(group: Values, name: str, sigmas: float | None, found: bool, where: str) -> str:
    """The reason of a row; that the reference is ``found`` is one only where the numbers of the row
    say so.
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
