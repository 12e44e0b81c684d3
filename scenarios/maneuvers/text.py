"""A search in the terminal: a summary, and a table with a row for each maneuver."""

from __future__ import annotations

from collections import Counter

from rich.console import Console

from scenarios.maneuvers.finding import Maneuvers, NumberedManeuver
from scenarios.terminal.display_units import shown_in, spaced
from scenarios.terminal.numbers import console
from scenarios.terminal.paragraphs import print_paragraph
from scenarios.terminal.summary import BELOW, Summary, print_summary
from scenarios.terminal.tables import Column, print_table

ABSENT = "-"  # in a cell of what is not recorded


def print_maneuvers(found: Maneuvers, out: Console | None = None, details: str = BELOW) -> None:
    """Print a search."""
    out = out or console()
    print_summary(out, maneuvers_summary(found, details))
    for line in found.cautions:
        print_paragraph(out, f"warning: {line}", indent=0)
    print_table(out, "maneuvers", table_columns(found))
    if any(each.found.excitation for each in found.maneuvers):
        print_paragraph(
            out,
            "t values: each derivative over its standard deviation, by equation error on this maneuver alone",
            indent=0,
        )


def maneuvers_summary(found: Maneuvers, details: str = BELOW) -> Summary:
    """The record, what was found, and how much of the time an input moves."""
    record, kinds = found.record, Counter(each.found.kind for each in found.maneuvers)
    moves = sum(count for kind, count in kinds.items() if kind != "trim")
    named = ", ".join(f"{count} {kind}" for kind, count in kinds.items() if kind != "trim")
    return Summary(
        f"{found.identity.name}, {len(record)} samples, {record.time[0]:g} to {record.time[-1]:g} s",
        f"{moves} maneuver{'s' if moves != 1 else ''}{f' ({named})' if named else ''}, {kinds['trim']} trim point{'s' if kinds['trim'] != 1 else ''}",
        f"an input moves beyond its noise in {100.0 * found.active:.1f} % of the time",
        "",
        details,
    )


def table_columns(found: Maneuvers) -> list[Column]:
    """The columns of the table."""
    some = found.maneuvers
    columns = [
        Column("no.", [str(each.number) for each in some]),
        Column("start, s", [f"{each.found.start:.2f}" for each in some]),
        Column("end, s", [f"{each.found.end:.2f}" for each in some]),
        Column("axis", [each.found.axis for each in some], left=True),
        Column("kind", [each.found.kind for each in some], left=True),
        Column("input", [each.found.channel or ABSENT for each in some], left=True),
        Column("amplitude", [amplitude_text(each) for each in some]),
    ]
    for name, unit, digits in (("airspeed", "m/s", 1), ("height", "m", 0)):
        if any(name in each.found.conditions for each in some):
            cells = [f"{each.found.conditions[name]:.{digits}f}" if name in each.found.conditions else ABSENT for each in some]
            columns.append(Column(f"{name}, {unit}", cells))
    if any(each.found.excitation for each in some):
        columns.append(Column("t values", [excitation_text(each) for each in some], left=True))
    return columns


def amplitude_text(each: NumberedManeuver) -> str:
    """``"2.31 deg"``."""
    if not each.found.channel:
        return ABSENT
    factor, unit = shown_in(each.unit, each.found.channel)
    return f"{factor * each.found.amplitude:.3g}{spaced(unit)}"


def excitation_text(each: NumberedManeuver) -> str:
    """``"Cm_alpha 12, Cm_q 8.1"``."""
    return ", ".join(f"{name} {value:.2g}" if value < 10.0 else f"{name} {value:.0f}" for name, value in each.found.excitation.items()) or ABSENT
