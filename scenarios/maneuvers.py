"""Maneuvers in a record file: found, printed, and written for the commands that use them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from scenarios.files.aircraft_files import toml_string
from scenarios.files.declarations import CHANNEL_UNITS, ColumnChoice
from scenarios.files.measured.columns import RecordFile, opened, with_names
from scenarios.files.records import read_record, refuse_rate
from scenarios.files.sources import InputFile, versions
from scenarios.files.writing import study_folder, write_json, write_text
from scenarios.plots import draw_into
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

if TYPE_CHECKING:
    from scenarios.plots.drawing import Named

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
LEAD = 2.0  # s of rest before an input that belong to its maneuver
TAIL = 5.0  # s of response after an input that belong to its maneuver
PART = (
    f"part to use: the input with {LEAD:g} s of rest before it and {TAIL:g} s of response after "
    "it, at most half way to the next maneuver"
)
DIGITS = 3  # decimals of the times in maneuvers.toml, s


@dataclass(frozen=True)
class NumberedManeuver:
    """A maneuver of a record.

    Attributes
    ----------
    number : number from 1 on, in the order of time.
    name : axis, kind and count of this kind, as ``"pitch-doublet-2"``.
    found : the maneuver as detected.
    unit : unit of its amplitude.
    start, stop : s, part of the record to use: rest, input and response.
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
    identity : name and hash of the file.
    record : searched channels in SI units. Controls are among the outputs, because their samples
        may be missing.
    maneuvers : the maneuvers in the order of time.
    active : share of the time in which an input moves beyond its rest level.
    path : path of the file; None if the record is in memory.
    simulated : whether the record is simulated.
    unread : channel -> column that looks like it but is read only with a channel map.
    surfaces : surfaces in the channel map that the search does not use as controls.
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
        parts = tuple(
            Part(maneuver.number, maneuver.name, maneuver.start, maneuver.stop)
            for maneuver in self.maneuvers
        )
        return DeclaredParts(self.identity.name, self.identity.name, self.identity.sha256, parts)

    @property
    def cautions(self) -> tuple[str, ...]:
        """Cautions for the user, one sentence each."""
        inputs = [name for name in CONTROLS if name in self.record.output_names]
        cautions = (
            []
            if inputs
            else [f"no input is recorded ({', '.join(CONTROLS)}): only turns can be found"]
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
                "no maneuver found: no input moves beyond its rest level in the form of a maneuver"
            )
        if self.unread:
            alike = [f"{column} looks like {channel}" for channel, column in self.unread.items()]
            name = self.identity.name if self.path is None else self.path
            cautions.append(
                f"{', '.join(alike)}: not read without a channel map; "
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
    """Return the maneuvers in a record of any length.

    Parameters
    ----------
    source : the record.
    channels : channel map; None takes the channels with their usual names.
    plan : names of the columns, and the rate (Hz) of a file without a clock or with several; None
        takes those of the file.

    Raises
    ------
    RecordError : the file cannot be used, or has none of the searched channels.
    """
    plan = plan or Plan()
    file = with_names(opened(source), plan.columns)
    if plan.rate is not None:
        refuse_rate(file, channels)
    record, _ = with_load_factors(
        read_record(file, (), (*CONTROLS, *MOTION), channels, rate=plan.rate)
    )
    signals = signals_of(record)
    detected = find_maneuvers(signals)
    path = None if file.in_memory else file.path
    return FoundManeuvers(
        file.identity,
        record,
        numbered(detected, record),
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
    """Return the controls and the motion of a record as the detection takes them."""
    values = {channel.name: channel.with_gaps() for channel in record.channels}
    return FlightSignals(
        record.time,
        {name: values[name] for name in CONTROLS if name in values},
        {name: each for name, each in values.items() if name not in CONTROLS},
    )


def numbered(detected: Sequence[DetectedManeuver], record: Record) -> tuple[NumberedManeuver, ...]:
    """Return the maneuvers with numbers, names, and the parts of the record to use.

    The parts of two maneuvers do not overlap.
    """
    counts: Counter[str] = Counter()
    maneuvers = []
    for number, maneuver in enumerate(detected, start=1):
        stem = maneuver.kind if maneuver.kind == "trim" else f"{maneuver.axis}-{maneuver.kind}"
        counts[stem] += 1
        start, stop = _part_to_use(maneuver, detected, record)
        maneuvers.append(
            NumberedManeuver(
                number,
                f"{stem}-{counts[stem]}",
                maneuver,
                record[maneuver.channel].unit if maneuver.channel else "",
                start,
                stop,
            )
        )
    return tuple(maneuvers)


def _part_to_use(
    maneuver: DetectedManeuver, detected: Sequence[DetectedManeuver], record: Record
) -> tuple[float, float]:
    """Return start and end (s) of the part of a record to use for a maneuver.

    The part is the input with ``LEAD`` before it and ``TAIL`` after it. It ends at a pause in the
    rows, and half way to the next maneuver. The part of a trim point is the trim point.
    """
    if maneuver.kind == "trim":
        return round(maneuver.start, DIGITS), round(maneuver.end, DIGITS)
    start, stop = maneuver.start - LEAD, maneuver.end + TAIL
    for other in detected:
        if other.kind == "trim" or other is maneuver:
            continue
        if other.end <= maneuver.start:
            start = max(start, 0.5 * (other.end + maneuver.start))
        elif other.start >= maneuver.end:
            stop = min(stop, 0.5 * (maneuver.end + other.start))
    first = int(np.searchsorted(record.time, start))
    last = int(np.searchsorted(record.time, stop, side="right")) - 1
    pauses = np.flatnonzero(np.diff(record.time[first : last + 1]) > LONGEST_GAP) + first
    middle = 0.5 * (maneuver.start + maneuver.end)
    first = max([first, *(int(k) + 1 for k in pauses if record.time[k] < middle)])
    last = min([last, *(int(k) for k in pauses if record.time[k] >= middle)])
    return round(float(record.time[first]), DIGITS), round(float(record.time[last]), DIGITS)


# ---- A search in the terminal: a summary, and a table with a row for each maneuver


def print_maneuvers(
    found: FoundManeuvers, out: Console | None = None, details: str = BELOW
) -> None:
    """Print the maneuvers of a record: a summary, cautions and a table."""
    out = out or console()
    print_summary(out, maneuvers_summary(found, details))
    for line in found.cautions:
        print_paragraph(out, f"warning: {line}", indent=0)
    show_table(out, maneuvers_table(found))
    if any(each.found.excitation for each in found.maneuvers):
        print_paragraph(
            out,
            "t values: each derivative over its standard deviation, by equation error on this "
            "maneuver alone; below about 5 the maneuver hardly determines the derivative",
            indent=0,
        )
    if found.maneuvers:
        print_paragraph(out, f"{PART}; identify, diagnose and check take these options", indent=0)


def maneuvers_summary(found: FoundManeuvers, details: str = BELOW) -> Summary:
    """Return a summary: the record, counts of maneuvers, and the share of time of moving inputs."""
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
    maneuvers = found.maneuvers
    columns: list[tuple[Column, Sequence[Cell]]] = [
        (Column("no.", PURE), [Number(each.number, digits=0) for each in maneuvers]),
        (Column("start", "s"), [Number(each.found.start, digits=2) for each in maneuvers]),
        (Column("end", "s"), [Number(each.found.end, digits=2) for each in maneuvers]),
        (Column("axis"), [each.found.axis for each in maneuvers]),
        (Column("kind"), [each.found.kind for each in maneuvers]),
        (Column("input"), [each.found.channel or MISSING for each in maneuvers]),
        (Column("amplitude", PURE), [_amplitude(each) for each in maneuvers]),
        (Column("part to use"), [options_text(each) for each in maneuvers]),
    ]
    for name, unit, digits in (("airspeed", "m/s", 1), ("height", "m", 0)):
        if any(name in each.found.conditions for each in maneuvers):
            cells = [known(each.found.conditions.get(name), digits) for each in maneuvers]
            columns.append((Column(name, unit), cells))
    if any(each.found.excitation for each in maneuvers):
        columns.append((Column("t values"), [excitation_text(each) for each in maneuvers]))
    return table("maneuvers and trim points", *columns)


def _kinds_text(found: FoundManeuvers) -> str:
    """Return the count of each kind, as ``"1 × doublet, 2 × sweep"``; empty without maneuvers."""
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
    """Return the options of other commands that select a maneuver, as ``"--from 7 --to 16"``."""
    return f"--from {each.start:.9g} --to {each.stop:.9g}"


def excitation_text(each: NumberedManeuver) -> str:
    """Return the t values of the derivatives, as ``"Cm_alpha 12, Cm_q 8.1"``."""
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
        "alone; below about 5 the maneuver hardly determines the derivative.",
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
                Prose(f"Start and end are the times of the input. {as_sentence(PART)}", "note"),
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
# Maneuvers of one record, for --maneuver NUMBER or NAME of identify, diagnose and survey.
# You may change names and times, and add or delete tables.
# Times are in s. They include rest before the input and the response after it.
"""


def maneuver_figures(found: FoundManeuvers) -> Iterator[Named]:
    """Yield the figure of the flight: file stem and drawing function."""
    from scenarios.plots.maneuvers import figure_flight

    yield "flight", partial(figure_flight, found, found.identity.name)


def write_maneuvers(found: FoundManeuvers, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write all files of a search into ``folder``, or none if one fails; return the folder."""
    with study_folder(folder, MAIN) as scratch:
        drawn = draw_into(scratch, maneuver_figures(found), figures)
        write_text(scratch / FILE, maneuvers_toml(found))
        write_page(scratch, maneuvers_page(found, drawn))
        write_json(scratch / MAIN, maneuvers_content(found))
    return Path(folder)


def maneuvers_toml(found: FoundManeuvers) -> str:
    """Return the content of ``maneuvers.toml``."""
    lines = [
        _HEAD,
        f"record = {toml_string(found.identity.name)}",
        f"sha256 = {toml_string(found.identity.sha256)}",
    ]
    for each in found.maneuvers:
        lines += [
            "",
            "[[maneuvers]]",
            f"number = {each.number}",
            f"name = {toml_string(each.name)}",
            f"from = {each.start!r}",
            f"to = {each.stop!r}",
            f"axis = {toml_string(each.found.axis)}",
            f"kind = {toml_string(each.found.kind)}",
        ]
    return "\n".join(lines) + "\n"


def maneuvers_content(found: FoundManeuvers) -> dict[str, Any]:
    """Return the content of ``maneuvers.json``, in SI units, nz in g."""
    return {
        "schema": SCHEMA,
        "maneuvers": [_content(each) for each in found.maneuvers],
        "active_share": found.active,
        "warnings": list(found.cautions),
        "inputs": {"records": [found.identity.name], "sha256": [found.identity.sha256]},
        "versions": versions(),
    }


def _content(each: NumberedManeuver) -> dict[str, Any]:
    detected = each.found
    moved_input = (
        {"channel": detected.channel, "amplitude": detected.amplitude, "unit": each.unit}
        if detected.channel
        else {}
    )
    return {
        "number": each.number,
        "name": each.name,
        "start": detected.start,
        "end": detected.end,
        "from": each.start,
        "to": each.stop,
        "axis": detected.axis,
        "kind": detected.kind,
        **moved_input,
        **dict(detected.conditions),
        "excitation": dict(detected.excitation),
    }
