"""A record file searched for maneuvers: each with a number, a name, its units and the part of the record to use for it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ident.maneuver_detection import AXES, PAUSE, FlightSignals, Maneuver, active_share, find_maneuvers
from scenarios.files.channels import ColumnChoice
from scenarios.files.measured.record_file import RecordFile, opened, with_names
from scenarios.files.records import read_record, refuse_rate
from scenarios.files.sources import InputFile
from scenarios.preparation.load_factor import with_load_factors
from scenarios.preparation.maneuver_file import Part, Parts
from scenarios.preparation.plan import Plan
from sim.record import Record

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
DIGITS = 3  # behind the point, of the times in maneuvers.toml


@dataclass(frozen=True)
class NumberedManeuver:
    """A maneuver of a record.

    Attributes
    ----------
    number : from 1 on, in the order of the times. name : axis, kind and a count, ``"pitch-doublet-2"``.
    found : what the search found. unit : of its amplitude.
    start, stop : s, the part of the record to use: with rest before the input and the response after it.
    """

    number: int
    name: str
    found: Maneuver
    unit: str
    start: float
    stop: float


@dataclass(frozen=True, eq=False, repr=False)
class Maneuvers:
    """The maneuvers of a record file.

    Attributes
    ----------
    identity : the file. record : its channels that were searched, SI; controls stand among the outputs, where samples may be missing.
    maneuvers : in the order of their times. active : share of the time in which an input moves beyond its rest level.
    path : of the file, None where the record is in memory. simulated : a program made it.
    unread : columns that look like channels and were not read, by channel: a channel map names them.
    """

    identity: InputFile
    record: Record
    maneuvers: tuple[NumberedManeuver, ...]
    active: float
    path: Path | None = None
    simulated: bool = False
    unread: Mapping[str, str] = field(default_factory=dict)

    @property
    def parts(self) -> Parts:
        """The parts of the record as ``maneuvers.toml`` declares them."""
        some = tuple(Part(each.number, each.name, each.start, each.stop) for each in self.maneuvers)
        return Parts(self.identity.name, self.identity.name, self.identity.sha256, some)

    @property
    def cautions(self) -> tuple[str, ...]:
        """What a user should know, one sentence each."""
        inputs = [name for name in CONTROLS if name in self.record.output_names]
        cautions = [] if inputs else [f"no input is recorded ({', '.join(CONTROLS)}): turns alone are found"]
        moves = [each for each in self.maneuvers if each.found.kind != "trim"]
        if inputs and not moves:
            cautions.append("no maneuver found: no input has the form of one, and none rises above what it does at rest")
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


def maneuvers_of(source: Path | RecordFile, channels: Mapping[str, ColumnChoice] | None = None, plan: Plan | None = None) -> Maneuvers:
    """Search a record file of any length.

    ``plan`` : names of its columns, and its rate where it has no clock or several; None: its own.

    Raises
    ------
    RecordError : anything in the file that keeps it from being used; none of the channels that are searched.
    """
    plan = plan or Plan()
    file = with_names(opened(source), plan.columns)
    if plan.rate is not None:
        refuse_rate(file, channels)
    record, _ = with_load_factors(read_record(file, (), (*CONTROLS, *MOTION), channels, rate=plan.rate))
    signals = signals_of(record)
    found = find_maneuvers(signals)
    path = None if file.in_memory else file.path
    return Maneuvers(
        file.identity,
        record,
        numbered(found, record),
        active_share(signals),
        path,
        file.sidecar.simulated,
        _unread(file, record) if channels is None else {},
    )


def _unread(file: RecordFile, record: Record) -> Mapping[str, str]:
    """Columns that look like a control or a rate that the record lacks, by channel."""
    from scenarios.preparation.drafting import recognised

    missing = [name for name in (*CONTROLS, "p", "q", "r") if name not in record.output_names]
    return recognised(file, missing) if missing else {}


def signals_of(record: Record) -> FlightSignals:
    """A record's controls and motion as the search takes them."""
    values = {channel.name: channel.with_gaps() for channel in record.channels}
    return FlightSignals(
        record.time,
        {name: values[name] for name in CONTROLS if name in values},
        {name: each for name, each in values.items() if name not in CONTROLS},
    )


def numbered(found: Sequence[Maneuver], record: Record) -> tuple[NumberedManeuver, ...]:
    """Maneuvers with numbers, names and parts of the record that do not reach into the next maneuver's."""
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


def _part(each: Maneuver, found: Sequence[Maneuver], record: Record) -> tuple[float, float]:
    """The input with ``LEAD`` and ``TAIL``, up to a pause in the rows and half way to its neighbours; a trim point as it is."""
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
    first, last = (
        int(np.searchsorted(record.time, start)),
        int(np.searchsorted(record.time, stop, side="right")) - 1,
    )
    pauses = np.flatnonzero(np.diff(record.time[first : last + 1]) > PAUSE) + first
    middle = 0.5 * (each.start + each.end)
    first = max([first, *(int(k) + 1 for k in pauses if record.time[k] < middle)])
    last = min([last, *(int(k) for k in pauses if record.time[k] >= middle)])
    return round(float(record.time[first]), DIGITS), round(float(record.time[last]), DIGITS)
