"""Maneuvers in a record file: found, printed, and written for the commands that use them."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from ident.maneuver_detection import (
    AXES,
    LONGEST_GAP,
    DetectedManeuver,
    FlightSignals,
    active_share,
    find_maneuvers,
)
from scenarios.files.declarations import CHANNEL_UNITS, ColumnChoice
from scenarios.files.measured.columns import RecordFile, opened, with_names
from scenarios.files.records import read_record, refuse_rate
from scenarios.files.sources import InputFile, versions
from scenarios.files.writing import study_folder, write_json, write_text
from scenarios.preparation.measured_inputs import with_load_factors
from scenarios.preparation.plan import FILE, DeclaredParts, Part, Plan
from scenarios.report.document import (
    MISSING,
    PURE,
    Bullets,
    Cell,
    Column,
    Number,
    Page,
    Prose,
    Table,
    as_sentence,
    known,
    now,
    reproduction,
    section,
    table,
)
from scenarios.report.figure_formats import USUAL, Drawn, Formats
from scenarios.report.folder import figures, write_page
from scenarios.report.quantities import console, shown_in, spaced
from scenarios.report.summary import BELOW, Summary, print_paragraph, print_summary
from scenarios.report.terminal import show_table
from sim.record import Record

# ---- A record file searched for maneuvers

CONTROLS = tuple(AXES)
MOTION = (
    "alpha",
    "q",
    "nz",
    "theta",
    "airspeed",
    "height",
    "altitude",
    "beta",
    "p",
    "r",
    "phi",
    "az",
)
LEAD, TAIL = (
    2.0,
    5.0,
)  # s of a record before and after an input that belong to its maneuver: rest, and the response
PART = (
    f"part to use: the input with {LEAD:g} s of rest before it and {TAIL:g} s of response after "
    "it, at most half way to the next maneuver"
)
DIGITS = 3  # after the point, of the times in maneuvers.toml


@dataclass(frozen=True)
class NumberedManeuver:
    """A maneuver of a record.

    Attributes
    ----------
    number : from 1 on, in the order of the times.
    name : axis, kind and a count, ``"pitch-doublet-2"``.
    found : what the search found.
    unit : of its amplitude.
    start, stop : s, the part of the record to use: with rest before the input and the response
        after it.
    """

    number: int
    name: str
    found: DetectedManeuver
    unit: str
    start: float
    stop: float


@dataclass(frozen=True, eq=False, repr=False)
class FoundManeuvers:
    """The maneuvers of a record file.

    Attributes
    ----------
    identity : the file.
    record : searched channels, SI; controls are among the outputs, which may have missing samples.
    maneuvers : in the order of their times.
    active : share of the time in which an input moves beyond its rest level.
    path : of the file, None if the record is in memory.
    simulated : the record is simulated.
    unread : columns that look like channels but need a channel map, by channel.
    surfaces : of the channel map, not used as controls in the search.
    """

    identity: InputFile
    record: Record
    maneuvers: tuple[NumberedManeuver, ...]
    active: float
    path: Path | None = None
    simulated: bool = False
    unread: Mapping[str, str] = field(default_factory=dict)
    surfaces: tuple[str, ...] = ()

    @property
    def parts(self) -> DeclaredParts:
        """The parts of the record as ``maneuvers.toml`` declares them."""
        some = tuple(Part(each.number, each.name, each.start, each.stop) for each in self.maneuvers)
        return DeclaredParts(self.identity.name, self.identity.name, self.identity.sha256, some)

    @property
    def cautions(self) -> tuple[str, ...]:
        """Cautions for the user, one sentence each."""
        inputs = [name for name in CONTROLS if name in self.record.output_names]
        cautions = (
            []
            if inputs
            else [f"no input is recorded ({', '.join(CONTROLS)}): turns alone are found"]
        )
        if self.surfaces:
            missing = [name for name in CONTROLS if name not in inputs]
            cautions.append(
                f"{', '.join(self.surfaces)}: not searched; add the control that they make to the "
                f"channel map ({' or '.join(missing or CONTROLS)}), such as elevator = "
                '"0.5*(COLUMN_LEFT + COLUMN_RIGHT)"'
            )
        moves = [each for each in self.maneuvers if each.found.kind != "trim"]
        if inputs and not moves:
            cautions.append(
                "no maneuver found: no input has the form of one, and none rises above what it "
                "does at rest"
            )
        if self.unread:
            alike = [f"{column} looks like {channel}" for channel, column in self.unread.items()]
            name = self.identity.name if self.path is None else self.path
            cautions.append(
                f"{', '.join(alike)}: not read, since only a channel map says so; "
                f"flightid map {name} --out DRAFT drafts one for --channels DRAFT/channels.toml"
            )
        return tuple(cautions)

    def __repr__(self) -> str:
        return f"<Maneuvers of {self.identity.name}: {len(self.maneuvers)}>"


def maneuvers_of(
    source: Path | RecordFile,
    channels: Mapping[str, ColumnChoice] | None = None,
    plan: Plan | None = None,
) -> FoundManeuvers:
    """Search a record file of any length.

    ``plan`` : names of its columns, and its rate where it has no clock or several; None: its own.

    Raises
    ------
    RecordError : anything in the file that keeps it from being used; none of the channels that are
        searched.
    """
    plan = plan or Plan()
    file = with_names(opened(source), plan.columns)
    if plan.rate is not None:
        refuse_rate(file, channels)
    record, _ = with_load_factors(
        read_record(file, (), (*CONTROLS, *MOTION), channels, rate=plan.rate)
    )
    signals = signals_of(record)
    found = find_maneuvers(signals)
    path = None if file.in_memory else file.path
    return FoundManeuvers(
        file.identity,
        record,
        numbered(found, record),
        active_share(signals),
        path,
        file.sidecar.simulated,
        _unread(file, record) if channels is None else {},
        tuple(name for name in channels or () if name not in CHANNEL_UNITS),
    )


def _unread(file: RecordFile, record: Record) -> Mapping[str, str]:
    """Return the columns that look like a control or a rate that the record lacks, by channel."""
    from scenarios.preparation.drafting import recognised

    missing = [name for name in (*CONTROLS, "p", "q", "r") if name not in record.output_names]
    return recognised(file, missing) if missing else {}


def signals_of(record: Record) -> FlightSignals:
    """Return a record's controls and motion as the search takes them."""
    values = {channel.name: channel.with_gaps() for channel in record.channels}
    return FlightSignals(
        record.time,
        {name: values[name] for name in CONTROLS if name in values},
        {name: each for name, each in values.items() if name not in CONTROLS},
    )


def numbered(found: Sequence[DetectedManeuver], record: Record) -> tuple[NumberedManeuver, ...]:
    """Return the maneuvers with numbers, names and parts of the record that do not reach into the
    next maneuver's.
    """
    counts: Counter[str] = Counter()
    out = []
    for number, each in enumerate(found, start=1):
        stem = each.kind if each.kind == "trim" else f"{each.axis}-{each.kind}"
        counts[stem] += 1
        start, stop = _part(each, found, record)
        out.append(
            NumberedManeuver(
                number,
                f"{stem}-{counts[stem]}",
                each,
                record[each.channel].unit if each.channel else "",
                start,
                stop,
            )
        )
    return tuple(out)


def _part(
    each: DetectedManeuver, found: Sequence[DetectedManeuver], record: Record
) -> tuple[float, float]:
    """Return the input with ``LEAD`` and ``TAIL``, up to a pause in the rows and half way to its
    neighbours; a trim point as it is.
    """
    if each.kind == "trim":
        return round(each.start, DIGITS), round(each.end, DIGITS)
    start, stop = each.start - LEAD, each.end + TAIL
    for other in found:
        if other.kind == "trim" or other is each:
            continue
        if other.end <= each.start:
            start = max(start, 0.5 * (other.end + each.start))
        elif other.start >= each.end:
            stop = min(stop, 0.5 * (each.end + other.start))
    first = int(np.searchsorted(record.time, start))
    last = int(np.searchsorted(record.time, stop, side="right")) - 1
    pauses = np.flatnonzero(np.diff(record.time[first : last + 1]) > LONGEST_GAP) + first
    middle = 0.5 * (each.start + each.end)
    first = max([first, *(int(k) + 1 for k in pauses if record.time[k] < middle)])
    last = min([last, *(int(k) for k in pauses if record.time[k] >= middle)])
    return round(float(record.time[first]), DIGITS), round(float(record.time[last]), DIGITS)


# ---- A search in the terminal: a summary, and a table with a row for each maneuver


def print_maneuvers(
    found: FoundManeuvers, out: Console | None = None, details: str = BELOW
) -> None:
    """Print a search."""
    out = out or console()
    print_summary(out, maneuvers_summary(found, details))
    for line in found.cautions:
        print_paragraph(out, f"warning: {line}", indent=0)
    show_table(out, maneuvers_table(found))
    if any(each.found.excitation for each in found.maneuvers):
        print_paragraph(
            out,
            "t values: each derivative over its standard deviation, by equation error on this "
            "maneuver alone; below about 5 it hardly determines it",
            indent=0,
        )
    if found.maneuvers:
        print_paragraph(out, f"{PART}; identify, diagnose and check take these options", indent=0)


def maneuvers_summary(found: FoundManeuvers, details: str = BELOW) -> Summary:
    """Return the record, what was found, and how much of the time an input moves."""
    record, kinds = found.record, Counter(each.found.kind for each in found.maneuvers)
    moves = sum(count for kind, count in kinds.items() if kind != "trim")
    named = ", ".join(f"{count} {kind}" for kind, count in kinds.items() if kind != "trim")
    return Summary(
        f"{found.identity.name}, {len(record)} samples, {record.time[0]:g} to {record.time[-1]:g} "
        "s",
        f"{moves} maneuver{'s' if moves != 1 else ''}{f' ({named})' if named else ''}, "
        f"{kinds['trim']} trim point{'s' if kinds['trim'] != 1 else ''}",
        f"an input moves beyond its noise in {100.0 * found.active:.1f} % of the time",
        "",
        details,
    )


def maneuvers_table(found: FoundManeuvers) -> Table:
    """Return a row for each maneuver and trim point."""
    some = found.maneuvers
    columns: list[tuple[Column, Sequence[Cell]]] = [
        (Column("no.", PURE), [Number(each.number, digits=0) for each in some]),
        (Column("start", "s"), [Number(each.found.start, digits=2) for each in some]),
        (Column("end", "s"), [Number(each.found.end, digits=2) for each in some]),
        (Column("axis"), [each.found.axis for each in some]),
        (Column("kind"), [each.found.kind for each in some]),
        (Column("input"), [each.found.channel or MISSING for each in some]),
        (Column("amplitude", PURE), [_amplitude(each) for each in some]),
        (Column("part to use"), [options_text(each) for each in some]),
    ]
    for name, unit, digits in (("airspeed", "m/s", 1), ("height", "m", 0)):
        if any(name in each.found.conditions for each in some):
            cells = [known(each.found.conditions.get(name), digits) for each in some]
            columns.append((Column(name, unit), cells))
    if any(each.found.excitation for each in some):
        columns.append((Column("t values"), [excitation_text(each) for each in some]))
    return table("maneuvers and trim points", *columns)


def _kinds_text(found: FoundManeuvers) -> str:
    """``"1 × doublet, 2 × sweep, 1 × trim"``: how many of each kind; empty if nothing was found."""
    kinds = Counter(each.found.kind for each in found.maneuvers)
    return ", ".join(
        f"{count}\N{NO-BREAK SPACE}×\N{NO-BREAK SPACE}{kind}" for kind, count in kinds.items()
    )


def _amplitude(each: NumberedManeuver) -> Cell:
    if not each.found.channel:
        return MISSING
    factor, unit = shown_in(each.unit, each.found.channel)
    value = factor * each.found.amplitude
    return Number(value, unit=unit, shown=f"{value:.3g}{spaced(unit)}")


def options_text(each: NumberedManeuver) -> str:
    """``"--from 7 --to 16"``: the options of other commands that select a maneuver."""
    return f"--from {each.start:.9g} --to {each.stop:.9g}"


def excitation_text(each: NumberedManeuver) -> str:
    """``"Cm_alpha 12, Cm_q 8.1"``."""
    return (
        ", ".join(
            f"{name} {value:.2g}" if value < 10.0 else f"{name} {value:.0f}"
            for name, value in each.found.excitation.items()
        )
        or MISSING
    )


# ---- The page of a search


def maneuvers_page(found: FoundManeuvers, drawn: Sequence[Drawn] = ()) -> Page:
    """Return the page of a search with the figures ``drawn``."""
    name, summary = found.identity.name, maneuvers_summary(found)
    moves = sum(each.found.kind != "trim" for each in found.maneuvers)
    used = (
        f"The file {FILE} holds the part of the record to use for each: {LEAD:g} s before the "
        f"input to {TAIL:g} s after it, or half way to "
        "its neighbour.",
        f"flightid identify {name} --maneuver N uses one of them, by number or name; diagnose and "
        "survey do so as well.",
        "A t value is a derivative over its standard deviation, by equation error on this maneuver "
        "alone; below about 5 it hardly determines it.",
    )
    return Page(
        title=f"{name}: maneuvers",
        kind="Maneuvers in a long record",
        verdict=f"{moves} maneuver{'s' if moves != 1 else ''}",
        tone="plain",
        sentence=as_sentence(_kinds_text(found)),
        summary=(as_sentence(summary.result),),
        warnings=tuple(map(as_sentence, found.cautions)),
        sections=(
            *section("The whole flight", *figures(drawn)),
            *section(
                "Maneuvers",
                maneuvers_table(found),
                Prose(
                    f"Start and end are the times of the input. {as_sentence(PART)}",
                    "note",
                ),
            ),
            *section("How they are used", Bullets(used)),
        ),
        reproduction=reproduction(
            ["flightid", "maneuvers", name], "", [("searched", name, found.identity.sha256)]
        ),
        created=now(),
    )


# ---- The folder of a search

MAIN = "maneuvers.json"
SCHEMA = "flightid/maneuvers/1"
_HEAD = """\
# Maneuvers of one record, for --maneuver NUMBER or NAME of identify, diagnose and survey. Edit it freely: names and times, further
# tables, tables deleted. Times are in s and include rest before the input and the response after it.
"""  # noqa: E501


def write_maneuvers(found: FoundManeuvers, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write a search into ``folder``, whole or not at all; returns the folder."""
    with study_folder(folder, MAIN) as scratch:
        drawn: tuple[Drawn, ...] = ()
        if figures:
            from scenarios.plots.drawing import draw_for_page
            from scenarios.plots.maneuvers import figure_flight

            drawn = draw_for_page(
                [("flight", partial(figure_flight, found, found.identity.name))], scratch, figures
            )
        write_text(scratch / FILE, maneuvers_toml(found))
        write_page(scratch, maneuvers_page(found, drawn))
        write_json(scratch / MAIN, maneuvers_content(found))
    return Path(folder)


def maneuvers_toml(found: FoundManeuvers) -> str:
    """Return the content of ``maneuvers.toml``."""
    lines = [
        _HEAD,
        f"record = {_text(found.identity.name)}",
        f"sha256 = {_text(found.identity.sha256)}",
    ]
    for each in found.maneuvers:
        lines += [
            "",
            "[[maneuvers]]",
            f"number = {each.number}",
            f"name = {_text(each.name)}",
            f"from = {each.start!r}",
            f"to = {each.stop!r}",
            f"axis = {_text(each.found.axis)}",
            f"kind = {_text(each.found.kind)}",
        ]
    return "\n".join(lines) + "\n"


def _text(text: str) -> str:
    """A text as TOML writes it; JSON's escapes are among TOML's, but for the delete character."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def maneuvers_content(found: FoundManeuvers) -> dict[str, Any]:
    """Return the content of ``maneuvers.json``: SI, nz in g."""
    return {
        "schema": SCHEMA,
        "maneuvers": [_content(each) for each in found.maneuvers],
        "active_share": found.active,
        "warnings": list(found.cautions),
        "inputs": {"records": [found.identity.name], "sha256": [found.identity.sha256]},
        "versions": versions(),
    }


def _content(each: NumberedManeuver) -> dict[str, Any]:
    one = each.found
    moved = (
        {"channel": one.channel, "amplitude": one.amplitude, "unit": each.unit}
        if one.channel
        else {}
    )
    return {
        "number": each.number,
        "name": each.name,
        "start": one.start,
        "end": one.end,
        "from": each.start,
        "to": each.stop,
        "axis": one.axis,
        "kind": one.kind,
        **moved,
        **dict(one.conditions),
        "excitation": dict(one.excitation),
    }
