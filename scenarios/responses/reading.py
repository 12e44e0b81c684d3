"""Signals of record files by the names of their columns, for frequency responses.

A name is a channel of flightid, which is in SI units, or the header of any column, which keeps its
unit. In a log of several topics the header is ``TOPIC.FIELD``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.frequency_response import EvenSignals
from ident.recording.misread_columns import SMALL_ANGLES, large_angle_finding
from scenarios.files.declarations import CHANNEL_UNITS, TIME, ColumnChoice, split_header
from scenarios.files.formats.cells import CellTable
from scenarios.files.measured.columns import RecordFile, map_command, with_names
from scenarios.files.measured.grid import stated_unit
from scenarios.files.records import read_with_notes
from scenarios.preparation.filtering import SHORTEST_GAP, filtered, named, split_at_gaps
from scenarios.preparation.plan import Plan, Segment
from sim.errors import DeclarationError, RecordError
from sim.record import Channel, Hold, Record

EVEN_SAMPLING_TOLERANCE = 0.01  # relative deviation of even sample intervals
MOST_MISSING = 0.1  # share of an output's samples that may be interpolated
FEWEST_SAMPLES = 64  # samples of a record
LOW_RATE_RATIO = (
    1.5  # intervals of outputs over those of rows, from which outputs have a lower rate
)


@dataclass(frozen=True)
class Names:
    """Names of inputs, outputs and references, as requested."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    references: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for option, names in (("--input", self.inputs), ("--output", self.outputs)):
            if not names:
                remedy = "name a column or channel of the record"
                raise DeclarationError("no signal is named", where=option, remedy=remedy)
        all_names = (*self.inputs, *self.outputs, *self.references)
        twice = next((name for name in all_names if all_names.count(name) > 1), None)
        if twice is not None:
            what = f"{twice} is named twice"
            raise DeclarationError(what, where="--input, --output", remedy="name each signal once")
        if self.references and len(self.references) != len(self.inputs):
            what = f"{len(self.references)} for {len(self.inputs)} inputs"
            remedy = "name one reference for each input"
            raise DeclarationError(what, where="--reference", remedy=remedy)


@dataclass(frozen=True, eq=False)
class ReadSignals:
    """The signals of all parts of records.

    Attributes
    ----------
    signals : signals of each part.
    names, durations : name and duration (s) of each part.
    units : signal -> unit.
    hold : hold of the inputs between samples; None if it is unknown or removed by a filter.
    step : sampling interval, s.
    notes : sentences on the preparation.
    doubts : sentences on probably wrong units of columns.
    """

    signals: tuple[EvenSignals, ...]
    names: tuple[str, ...]
    durations: tuple[float, ...]
    units: Mapping[str, str]
    hold: Hold | None
    step: float
    notes: tuple[str, ...]
    doubts: tuple[str, ...] = ()


def read_signals(
    files: Sequence[RecordFile],
    names: Names,
    plan: Plan,
    channels: Mapping[str, ColumnChoice] | None = None,
) -> ReadSignals:
    """Read the named signals of every segment of the plan in every record.

    A segment is split into parts at long gaps.

    Raises
    ------
    RecordError : a column is missing, or a part is too short.
    """
    records: list[Record] = []
    notes: list[str] = list(plan.chosen)
    holds = set()
    for file in files:
        file = with_names(file, plan.columns)
        sidecar_hold = file.sidecar.hold if file.sidecar.states_hold else None
        holds.add(plan.hold or sidecar_hold)
        for segment in plan.segments:
            record, sentences = _read(file, names, plan, channels, segment)
            notes += sentences
            record, sentences = _rows_with_outputs(record)
            notes += sentences
            parts, gaps = split_at_gaps(record)
            if gaps:
                notes.append(f"{record.name}: {gaps}")
            for part in parts:
                part, sentence = filtered(part, plan)
                if sentence:
                    notes.append(sentence)
                records.append(part)
    step = float(np.median(np.diff(records[0].time)))
    _refuse_other_rates_and_units(records, step)
    signals = []
    for record in records:
        even_record, sentences = _evenly_sampled(record, step)
        notes += sentences
        signals.append(_signals(even_record, names, step))
    units = {channel.name: channel.unit for channel in records[0].channels}
    hold = holds.pop() if len(holds) == 1 else None
    return ReadSignals(
        tuple(signals),
        tuple(record.name for record in records),
        tuple(part.outputs.shape[1] * step for part in signals),
        units,
        None if plan.rate is not None or plan.lowpass is not None else hold,
        step,
        tuple(dict.fromkeys(notes)),
        tuple(dict.fromkeys(doubt for record in records for doubt in _unit_doubts(record))),
    )


def _unit_doubts(record: Record) -> list[str]:
    """Return a sentence for each flow angle and surface that moves too far to be in radians."""
    return [
        f"{record.name}, channel {channel.name}: {doubt.sentence}, so that its responses are in a "
        f"wrong unit; {doubt.remedy}"
        for channel in record.channels
        if channel.name in SMALL_ANGLES
        and channel.unit == "rad"
        and (doubt := large_angle_finding(channel)) is not None
    ]


def _refuse_other_rates_and_units(records: Sequence[Record], step: float) -> None:
    """Raise RecordError if records have another rate or other units than the first."""
    first = records[0]
    for record in records[1:]:
        interval = float(np.median(np.diff(record.time)))
        if abs(interval / step - 1.0) > EVEN_SAMPLING_TOLERANCE:
            what = f"{1.0 / interval:.4g} samples a second, and {1.0 / step:.4g} in {first.name}"
            remedy = "resample all records with --rate HZ"
            raise RecordError(what, where=record.name, remedy=remedy)
        for channel in record.channels:
            unit, first_unit = channel.unit, first[channel.name].unit
            if unit != first_unit:
                raise RecordError(
                    f"{channel.name} is in {unit or 'no unit'}, and in {first_unit or 'no unit'} "
                    f"in {first.name}",
                    where=record.name,
                    remedy="give all records the same units, or a channel map",
                )


def _read(
    file: RecordFile,
    names: Names,
    plan: Plan,
    channels: Mapping[str, ColumnChoice] | None,
    segment: Segment,
) -> tuple[Record, list[str]]:
    """Return the named signals of a segment of a file, and notes."""
    all_names = (*names.inputs, *names.references, *names.outputs)
    choices = {**file.choices, **(channels or {})}
    units = dict(CHANNEL_UNITS)
    for name in all_names:
        if name == TIME:
            remedy = "name a signal"
            raise DeclarationError("time is no signal", where="--input, --output", remedy=remedy)
        if name in CHANNEL_UNITS or name in choices:
            units.setdefault(name, "")
            continue
        units[name] = ""
        choices[name] = ColumnChoice(name, _stated_unit(file, name))
    used_choices = {
        name: choice for name, choice in choices.items() if name in all_names or name == TIME
    }
    record, notes = read_with_notes(
        file,
        (*names.inputs, *names.references),
        names.outputs,
        used_choices,
        segment.start,
        segment.stop,
        hold=plan.hold,
        channel_units=units,
        rate=plan.rate,
    )
    missing = [name for name in names.outputs if name not in record.output_names]
    if missing:
        remedy = f"{map_command(file.path)} lists its columns"
        raise RecordError(f"there is no column {missing[0]!r}", where=str(file.path), remedy=remedy)
    # Named by its file: a sidecar's name may be that of many files.
    several = len(plan.segments) > 1
    record = replace(record, name=named(file.identity.name, segment, several=several))
    return record, [f"{record.name}: {note}" for note in notes]


def _rows_with_outputs(record: Record) -> tuple[Record, list[str]]:
    """Return the record without long dropouts of outputs, and notes.

    Interpolation over a dropout would hide the response. If outputs have a lower rate than the
    rows, only rows with their samples are kept.
    """
    valid = np.all([channel.valid for channel in record.outputs], axis=0)
    if valid.all() or np.count_nonzero(valid) < FEWEST_SAMPLES:
        return record, []
    step = float(np.median(np.diff(record.time)))
    interval = float(np.median(np.diff(record.time[valid])))
    if interval > LOW_RATE_RATIO * step:
        names = ", ".join(channel.name for channel in record.outputs if not channel.valid.all())
        sentence = f"{names} has a sample every {interval:.3g} s: rows between are left out"
        return record.rows(valid), [f"{record.name}: {sentence}"]
    edges = np.flatnonzero(np.diff(np.concatenate([[True], valid, [True]]).astype(int)))
    keep = np.ones(len(record), dtype=bool)
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        keep[begin:end] = record.time[end - 1] - record.time[begin] + 2.0 * step <= SHORTEST_GAP
    return record.rows(keep), []


def _stated_unit(file: RecordFile, name: str) -> str | None:
    """Return the unit that a file states for a column; None without a unit or column."""
    tables: list[tuple[str, CellTable]] = [(topic.name, topic.table) for topic in file.topics]
    for topic_name, table in tables or [("", file.table)]:
        for index, header in enumerate(table.header):
            column_names = {header, split_header(header)[0]}
            if topic_name:
                column_names |= {f"{topic_name}.{column}" for column in column_names}
            if name in column_names:
                return stated_unit(table, index)
    return None


def _evenly_sampled(record: Record, step: float) -> tuple[Record, list[str]]:
    """Return the record with the sampling interval ``step`` (s) and without missing samples, and
    notes on interpolation.
    """
    notes = []
    time = record.time
    for channel in record.outputs:
        missing = 1.0 - float(channel.valid.mean())
        if missing > MOST_MISSING:
            what = f"{100.0 * missing:.0f} % of the samples of {channel.name} are missing"
            remedy = "give --rate HZ near its own rate, or choose another part"
            raise RecordError(what, where=record.name, remedy=remedy)
        if missing > 0.0:
            share = f"{100.0 * missing:.2g} % of its samples are missing and joined by lines"
            notes.append(f"{record.name}: {channel.name}: {share}")
    even = bool(np.all(np.abs(np.diff(time) - step) <= EVEN_SAMPLING_TOLERANCE * step))
    if even and not notes:
        return record, notes
    grid = time if even else time[0] + step * np.arange(int((time[-1] - time[0]) / step + 1e-6) + 1)
    if not even:
        rate = f"{1.0 / step:.4g} Hz"
        notes.append(f"{record.name}: its uneven samples are joined by lines on a grid of {rate}")

    def on_grid(channel: Channel) -> Channel:
        values = np.interp(grid, time[channel.valid], channel.values[channel.valid])
        return Channel.of(channel.name, channel.unit, values)

    inputs, outputs = tuple(map(on_grid, record.inputs)), tuple(map(on_grid, record.outputs))
    return replace(record, time=grid, inputs=inputs, outputs=outputs), notes


def _signals(record: Record, names: Names, step: float) -> EvenSignals:
    """Return the signals of a part; raise RecordError for a short part or a constant signal."""
    if len(record) < FEWEST_SAMPLES:
        what = f"{len(record)} samples are too few for a frequency response"
        raise RecordError(
            what, where=record.name, remedy=f"give a part of {FEWEST_SAMPLES} or more"
        )
    for name in (*names.inputs, *names.references, *names.outputs):
        values = record[name].values
        if not np.ptp(values) > 0.0:
            what, where = "it does not move", f"{record.name}, {name}"
            raise RecordError(what, where=where, remedy="choose a part with a maneuver")
    inputs, references = record.input_array(names.inputs), record.input_array(names.references)
    return EvenSignals(step, inputs, record.output_array(names.outputs)[0], references)
