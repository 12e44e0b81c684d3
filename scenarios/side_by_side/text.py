"""Studies side by side in the terminal: estimates, errors and published values, a column a study."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from rich.console import Console

from scenarios.side_by_side.comparison import SideBySide
from scenarios.side_by_side.value import Column as Study
from scenarios.side_by_side.value import Value
from scenarios.terminal.display_units import shown_in, unit_cell
from scenarios.terminal.numbers import console, number
from scenarios.terminal.paragraphs import print_paragraph
from scenarios.terminal.quantities import determined
from scenarios.terminal.tables import GAP, Column, print_table

CELL, FIXED = 17, 40  # columns of a terminal: an estimate with its sigma; parameter, unit and true value


def print_compared(compared: SideBySide, out: Console | None = None) -> None:
    """What each study is, then tables of what they share: estimates, errors and published values where there are any."""
    out = out or console()
    numbered = sum(len(GAP) + max(len(column.label), CELL) for column in compared.columns) > out.width - FIXED
    for place, column in enumerate(compared.columns, start=1):
        told = [column.title or column.estimator, *([column.estimator] if column.title and column.estimator else [])]
        told += [f"seed {column.seed}"] if column.seed is not None else []
        print_paragraph(out, f"{f'{place} ' if numbered else ''}{column.label}: {', '.join(told)}; {column.outcome}", indent=0)
    if numbered:
        shown = tuple(replace(column, label=str(n)) for n, column in enumerate(compared.columns, start=1))
        singles = {str(n): compared.single[c.label] for n, c in enumerate(compared.columns, start=1) if c.label in compared.single}
        compared = replace(compared, columns=shown, single=singles)
    names = (*compared.names, *compared.derived)
    true = _common_truth(compared, names)
    known = [Column("true", ["-" if value is None else f"{value:.5g}" for value in true])] if any(value is not None for value in true) else []
    _print(out, compared, "estimate +- sigma", names, _estimate, known)
    if any(_differs(compared, name) for name in names):
        _print(out, compared, "what the study's model should find: true, or condensed where it lacks modes", names, _reference)
    if any(value.reference is not None for _, value in _values(compared)):
        _print(out, compared, "error in % (in standard deviations)", names, _error)
    if any(value.published is not None for _, value in _values(compared)):
        _print(out, compared, "published +- sigma", names, _published)
        _print(out, compared, "error of the published value in % (in its own standard deviations)", names, _published_error)
    for label, single in compared.single.items():
        print_paragraph(out, f"only {label} has {', '.join(single)}", indent=0)
    if compared.apart:
        print_paragraph(out, f"in different units, therefore not compared: {', '.join(compared.apart)}", indent=0)


def _print(
    out: Console, compared: SideBySide, title: str, names: Sequence[str], cell: Callable[[Value], str], further: Sequence[Column] = ()
) -> None:
    """One table, in as many blocks as the terminal's width asks for. Rows that say nothing are left out."""
    names = [name for name in names if any(_cell(_shown(compared, name, study), cell) != "-" for study in compared.columns)]
    if not names:
        return
    fixed = [
        Column("parameter", [compared.words(name) for name in names], left=True),
        Column("unit", [unit_cell(shown_in(compared.unit(name), name).unit) for name in names], left=True),
        *further,
    ]
    rest = [Column(study.label, [_cell(_shown(compared, name, study), cell) for name in names]) for study in compared.columns]
    rest = [column for column in rest if set(column.cells) != {"-"}]
    out.print()
    print_table(out, title, [*fixed, *rest], keys=2)


def _shown(compared: SideBySide, name: str, study: Study) -> Value | None:
    """What a study says of a parameter, in the unit in which it is shown."""
    value = compared.value(name, study)
    return value.in_unit(*shown_in(value.unit, name)) if value is not None else None


def _values(compared: SideBySide) -> list[tuple[Study, Value]]:
    names = (*compared.names, *compared.derived)
    found = [(study, compared.value(name, study)) for name in names for study in compared.columns]
    return [(study, value) for study, value in found if value is not None]


def _common_truth(compared: SideBySide, names: Sequence[str]) -> list[float | None]:
    """The true value of each quantity where all studies that state one state the same."""
    out: list[float | None] = []
    for name in names:
        told = {value.true for study in compared.columns if (value := _shown(compared, name, study)) is not None and value.true is not None}
        out.append(told.pop() if len(told) == 1 else None)
    return out


def _differs(compared: SideBySide, name: str) -> bool:
    """Whether what is to be found is another number in another study, or not the true one."""
    found = [value for study in compared.columns if (value := compared.value(name, study)) is not None and value.reference is not None]
    return any(value.condensed is not None for value in found) or len({value.reference for value in found}) > 1


def _cell(value: Value | None, cell: Callable[[Value], str]) -> str:
    return "-" if value is None else cell(value)


def _estimate(value: Value) -> str:
    if value.std > 0.0 and not determined(value.estimate, value.std):
        return "not determined"
    return f"{number(value.estimate, value.std)} +- {number(value.std, value.std)}" if value.std > 0.0 else number(value.estimate)


def _reference(value: Value) -> str:
    return "-" if value.reference is None else f"{value.reference:.5g}"


def _error(value: Value) -> str:
    percent, sigmas = value.percent, value.sigmas
    told = [*([f"{percent:+.2f} %"] if percent is not None else []), *([f"({sigmas:+.1f})"] if sigmas is not None else [])]
    return " ".join(told) or "-"


def _published(value: Value) -> str:
    if value.published is None:
        return "-"
    printed, std = value.published
    return f"{printed:.5g} +- {std:.4g}" if std > 0.0 else f"{printed:.5g}"


def _published_error(value: Value) -> str:
    printed = value.published_value
    return "-" if printed is None else _error(printed)
