"""Check of the raw columns of records: refusals, masks, warnings, and the findings as text and
JSON; isolated wrong samples set aside.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from ident.recording.inspection import inspect
from ident.recording.series import (
    Certainty,
    Expectations,
    FindingQuantity,
    Kind,
    RecordFinding,
    quantity_text,
)
from ident.statistics.noise_levels import input_edges, isolated_wrong_samples
from scenarios.files.sources import LARGEST_NUMBER
from scenarios.files.user_models import is_own
from scenarios.preparation.plan import Plan
from scenarios.report.document import Column, Table
from sim.declaration.effect import AIRSPEEDS
from sim.declaration.model import Model
from sim.errors import RecordError, instant, time_span
from sim.maths import G0
from sim.propagation import MOST_STEPS
from sim.record import Channel, Record

# ---- Check of raw columns and its consequences

TRUST = "--trust-record"
WARNED, NOTED = "a warning", "only noted"  # how a finding was handled


@dataclass(frozen=True, eq=False)
class HandledFinding:
    """A finding in a record.

    Attributes
    ----------
    record : name of the record.
    finding : the finding.
    done : how it was handled, in words.
    masked : number of samples that were masked.
    """

    record: str
    finding: RecordFinding
    done: str
    masked: int = 0

    @property
    def sentence(self) -> str:
        """The finding in words: ``"train.csv: alpha is updated every 2 samples ..."``."""
        return f"{self.record}: {self.finding.channel} {self.finding.sentence}"


@dataclass(frozen=True, eq=False)
class RecordCheck:
    """Findings in the raw columns of all records.

    Attributes
    ----------
    records : names of the records.
    seen : the findings.
    trusted : whether findings are only warnings; then no sample is masked and no record refused.
    """

    records: tuple[str, ...] = ()
    seen: tuple[HandledFinding, ...] = ()
    trusted: bool = False

    @property
    def doubts(self) -> list[str]:
        """Probable errors with their remedies, one sentence each."""
        return [_with_remedy(handled) for handled in self.seen if handled.done == WARNED]

    @property
    def set_aside(self) -> list[str]:
        """Masked samples and the reasons, one sentence each."""
        return [f"{handled.sentence}; {handled.done}" for handled in self.seen if handled.masked]

    @property
    def lines(self) -> list[str]:
        """Masked samples and further notes, one sentence each."""
        return [
            f"{handled.sentence}; {handled.done}" if handled.masked else handled.sentence
            for handled in self.seen
            if handled.done != WARNED
        ]


NOTHING_SEEN = RecordCheck()


def expectations_of(model: Model) -> Expectations:
    """Return the properties of a record that follow from a declared model: airspeed, gravity, and
    the pitch acceleration due to its first input.
    """
    if is_own(model):
        return Expectations(aircraft=False)
    parameters = {item.name: item.value for item in model.parameters}
    airspeed = next((parameters[name] for name in AIRSPEEDS if name in parameters), None)
    gravity = parameters.get("gravity", G0)
    if "density_scale_height" in parameters:
        return Expectations(airspeed, gravity, scale_height=parameters["density_scale_height"])
    if "M_delta" in parameters:
        return Expectations(airspeed, gravity, parameters["M_delta"])
    needed = ("air_density", "wing_area", "chord", "pitch_inertia", "Cm_de")
    if airspeed is None or any(name not in parameters for name in needed):
        return Expectations(airspeed, gravity)
    density, area, chord, inertia, derivative = (parameters[name] for name in needed)
    moment = 0.5 * density * airspeed**2 * area * chord
    return Expectations(airspeed, gravity, moment / inertia * derivative, angular_control=True)


def joined(checks: Sequence[RecordCheck], *, trusted: bool) -> RecordCheck:
    """Return the findings of records that were checked one by one."""
    return RecordCheck(
        tuple(dict.fromkeys(name for check in checks for name in check.records)),
        tuple(handled for check in checks for handled in check.seen),
        trusted,
    )


def checked_records(
    records: Sequence[Record], expected: Expectations, plan: Plan
) -> tuple[list[Record], RecordCheck]:
    """Return the records, with samples without information masked, and the findings.

    Raises
    ------
    RecordError : a certain fault that would make all results wrong. With ``plan.trusted`` it is a
        warning.
    """
    checked, handled_findings = [], []
    for record in records:
        _refuse_endless(record)
        if any(np.max(np.abs(channel.values)) > LARGEST_NUMBER for channel in record.channels):
            checked.append(record)  # the squares would overflow; the fit reports such values
            continue
        for finding in inspect(record, expected):
            record, handled = _handled(record, finding, plan)
            handled_findings.append(handled)
        checked.append(record)
    names = tuple(dict.fromkeys(record.name for record in records))
    return checked, RecordCheck(names, tuple(handled_findings), plan.trusted)


def _refuse_endless(record: Record) -> None:
    """Raise RecordError if the record has too many intervals to simulate."""
    with np.errstate(over="ignore"):
        interval = float(np.median(np.diff(record.time)))
        duration = float(record.time[-1] - record.time[0])
    if not duration / interval <= MOST_STEPS:
        span = time_span(record.time[0], record.time[-1], 4)
        problem = f"it goes from {span} in steps of {interval:.3g} s"
        remedy = "correct wrong times, or read a part of the rows with --from and --to"
        raise RecordError(problem, where=f"{record.name}, column time", remedy=remedy)


def _handled(record: Record, finding: RecordFinding, plan: Plan) -> tuple[Record, HandledFinding]:
    """Return the record after a finding: refused, unchanged, interpolated or masked."""
    if finding.certainty is Certainty.CERTAIN and not plan.trusted:
        remedy = f"{finding.remedy} ({TRUST} takes it as it is)"
        raise RecordError(
            finding.sentence, where=f"{record.name}, {_place(finding)}", remedy=remedy
        )
    if finding.certainty is Certainty.NOTED:
        return record, HandledFinding(record.name, finding, NOTED)
    if plan.trusted or finding.certainty is not Certainty.COSTS_INFORMATION:
        return record, HandledFinding(record.name, finding, WARNED)
    channel = record[finding.channel]
    mask = finding.mask & channel.valid
    filtered = plan.rate is not None or plan.lowpass is not None
    if filtered and finding.kind in (Kind.HELD, Kind.INTERPOLATED):
        # A filter needs every sample, and interpolates between updates anyway.
        updated = channel.valid & ~mask
        values = np.interp(record.time, record.time[updated], channel.values[updated])
        values = np.where(channel.valid, values, np.nan)
        done = "replaced by straight lines between updates, for the filter"
    elif np.all(mask | ~channel.valid):
        return record, HandledFinding(record.name, finding, WARNED)
    else:
        values = np.where(mask, np.nan, channel.with_gaps())
        done = "set aside"
    handled = HandledFinding(record.name, finding, done, int(np.count_nonzero(mask)))
    return _with_output(record, channel.name, values), handled


def _with_output(record: Record, name: str, values: np.ndarray) -> Record:
    outputs = tuple(
        Channel.of(name, channel.unit, values) if channel.name == name else channel
        for channel in record.outputs
    )
    return replace(record, outputs=outputs)


def _place(finding: RecordFinding) -> str:
    noun = "channels" if " and " in finding.channel else "channel"
    return f"{noun} {finding.channel}"


def _with_remedy(handled: HandledFinding) -> str:
    remedy = handled.finding.remedy
    return f"{handled.sentence}; {remedy}" if remedy else handled.sentence


# ---- The findings as text, tables and JSON


def record_content(check: RecordCheck) -> dict[str, Any]:
    """Return the entry ``record`` of a study: names of the records, findings, and number of masked
    samples by record and channel.
    """
    masked: dict[str, dict[str, int]] = {}
    for handled in check.seen:
        if handled.masked:
            channel = handled.finding.channel
            channels = masked.setdefault(handled.record, {})
            channels[channel] = channels.get(channel, 0) + handled.masked
    return {
        "looked_at": list(check.records),
        "trusted": check.trusted,
        "findings": [_content(handled) for handled in check.seen],
        "masked": masked,
    }


def record_lines(check: RecordCheck) -> list[str]:
    """Return lines for a terminal on masked samples and other notes."""
    return [f"record: {line}" for line in check.lines]


def record_table(check: RecordCheck) -> Table:
    """Return the findings as a table of a page."""
    columns = tuple(map(Column, ("record", "channel", "seen", "when", "done")))
    rows = tuple(
        (
            handled.record,
            handled.finding.channel,
            handled.finding.sentence,
            _times_text(handled.finding),
            f"{handled.masked} samples {handled.done}" if handled.masked else handled.done,
        )
        for handled in check.seen
    )
    caption = (
        "What the raw columns show, before any fit; samples that were set aside count in no fit "
        "and no error"
    )
    return Table(caption, columns, rows)


def _content(handled: HandledFinding) -> dict[str, Any]:
    finding = handled.finding
    return {
        "record": handled.record,
        "channel": finding.channel,
        "kind": finding.kind.value,
        "certainty": finding.certainty.value,
        "times": [[begin, end] for begin, end in finding.times],
        "numbers": {
            name: {"value": number.value, "unit": number.unit}
            for name, number in finding.numbers.items()
            if math.isfinite(number.value)
        },
        "masked": handled.masked,
        "done": handled.done,
        "sentence": f"{finding.channel} {finding.sentence}",
        **({"remedy": finding.remedy} if finding.remedy else {}),
    }


MOST_NAMED_TIMES = 3  # times that a sentence or a table names


def _times_text(finding: RecordFinding) -> str:
    if not finding.times:
        return "throughout"
    texts = [
        f"{instant(begin)} s" if begin == end else f"{time_span(begin, end, 4)}"
        for begin, end in finding.times[:MOST_NAMED_TIMES]
    ]
    more = len(finding.times) - len(texts)
    return ", ".join(texts) + (f" and {more} more" if more else "")


# ---- Isolated wrong samples of a measured record

Result = TypeVar("Result")


def isolated_outliers(
    outputs: Sequence[str], simulated: Sequence[np.ndarray], records: Sequence[Record]
) -> list[dict[str, np.ndarray]]:
    """Find isolated outliers from the residuals of simulations.

    Parameters
    ----------
    outputs : outputs that are simulated.
    simulated : simulated outputs of each record, shape ``(m, N)``.
    records : the records with all their samples.

    Returns
    -------
    Masks of each record by channel, shape ``(N,)``, True at an outlier; none for other channels.
    """
    masks: list[dict[str, np.ndarray]] = [{} for _ in records]
    if len(simulated) != len(records):
        return masks
    for row, name in enumerate(outputs if simulated else ()):
        with_output = [k for k, record in enumerate(records) if name in record.output_names]
        if not with_output:
            continue
        valid = [records[k][name].valid & np.isfinite(simulated[k][row]) for k in with_output]
        residuals = [
            np.where(valid_row, records[k][name].values - simulated[k][row], 0.0)
            for k, valid_row in zip(with_output, valid, strict=True)
        ]
        wrong = isolated_wrong_samples(
            residuals, valid, [input_edges(records[k]) for k in with_output]
        )
        for k, mask in zip(with_output, wrong, strict=True):
            if np.any(mask):
                masks[k][name] = mask
    return masks


def same_points(
    masks: Sequence[dict[str, np.ndarray]], other_masks: Sequence[dict[str, np.ndarray]]
) -> bool:
    """Return whether two lists of masks mark the same samples."""
    return all(
        a.keys() == b.keys() and all(np.array_equal(a[name], b[name]) for name in a)
        for a, b in zip(masks, other_masks, strict=True)
    )


def repeated_without_outliers(
    run: Callable[[Sequence[Record]], Result],
    simulations: Callable[[Result], tuple[Sequence[str], Sequence[np.ndarray]]],
    records: Sequence[Record],
    repetitions: int,
) -> tuple[Result, Sequence[Record], list[dict[str, np.ndarray]]]:
    """Run a fit again without isolated outliers, until their masks no longer change.

    ``simulations`` returns the outputs of a result and their simulations, as `isolated_outliers`
    takes them. Returns the last result, its records, and the masks by record and channel.
    """
    result, kept = run(records), records
    masks: list[dict[str, np.ndarray]] = [{} for _ in records]
    for _ in range(repetitions):
        new_masks = isolated_outliers(*simulations(result), records)
        if same_points(new_masks, masks):
            break
        masks = new_masks
        kept = [without(record, mask) for record, mask in zip(records, masks, strict=True)]
        result = run(kept)
    return result, kept, masks


def left_out(before: Record, after: Record) -> dict[str, np.ndarray]:
    """Return masks of the samples that a record has ``before`` and no longer ``after``.

    By channel, shape ``(N,)``; only channels with such samples.
    """
    masks = {channel.name: before[channel.name].valid & ~channel.valid for channel in after.outputs}
    return {name: mask for name, mask in masks.items() if np.any(mask)}


def without(record: Record, masks: dict[str, np.ndarray]) -> Record:
    """Return a record whose samples at the masks, ``(N,)`` by channel, are missing."""
    if not masks:
        return record

    def masked(channel: Channel) -> Channel:
        mask = masks.get(channel.name)
        if mask is None:
            return channel
        values = np.where(mask, np.nan, channel.with_gaps())
        return Channel.of(channel.name, channel.unit, values)

    return replace(record, outputs=tuple(map(masked, record.outputs)))


def with_outliers(
    look: RecordCheck, records: Sequence[Record], masks: Sequence[dict[str, np.ndarray]]
) -> RecordCheck:
    """Return the record check with the outliers of the records added."""
    findings = [
        _wild_points(record, name, mask)
        for record, masks_of_record in zip(records, masks, strict=True)
        for name, mask in masks_of_record.items()
    ]
    return replace(look, seen=(*look.seen, *findings))


def _wild_points(record: Record, name: str, mask: np.ndarray) -> HandledFinding:
    """Return the finding on the outliers of a channel, which are set aside."""
    times, count = record.time[mask].tolist(), int(np.count_nonzero(mask))
    places = ", ".join(f"{instant(time)} s" for time in times[:MOST_NAMED_TIMES]) + (
        " and so on" if count > MOST_NAMED_TIMES else ""
    )
    channel = record[name]
    distance = np.abs(channel.values - np.median(channel.values[channel.valid]))[mask]
    sentence = (
        f"has {count} wild point{'s' if count > 1 else ''}, far from the samples around and from "
        f"the fit ({places})"
    )
    farthest = quantity_text(float(np.max(distance)), channel.unit)
    sentence += f", up to {farthest} from the middle of the channel"
    numbers = {"samples": FindingQuantity(float(count), "1")}
    finding = RecordFinding(
        name,
        Kind.WILD_POINTS,
        Certainty.COSTS_INFORMATION,
        sentence,
        "",
        tuple((t, t) for t in times),
        numbers,
        mask,
    )
    return HandledFinding(record.name, finding, "set aside", count)
