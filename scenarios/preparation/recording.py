"""The record check of raw columns: refusals, warnings, and its findings in words and JSON; isolated
wrong samples set aside.
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
    shown,
)
from ident.statistics.noise_levels import input_edges, isolated_wrong
from scenarios.files.user_models import is_own
from scenarios.preparation.plan import Plan
from scenarios.report.document import Column, Table
from sim.declaration.effect import AIRSPEEDS
from sim.declaration.model import Model
from sim.errors import RecordError, instant, time_span
from sim.maths import G0
from sim.propagation import MOST_STEPS
from sim.record import Channel, Record

# ---- Consequences of the check of raw columns

TRUST = "--trust-record"
WARNED, NOTED = "a warning", "only noted"
LARGEST_NUMBER = 1e50  # squares of larger numbers leave the range of finite ones


@dataclass(frozen=True, eq=False)
class HandledFinding:
    """A finding in a record, with the record's name and how it was handled."""

    record: str
    finding: RecordFinding
    done: str
    masked: int = 0

    @property
    def sentence(self) -> str:
        """``"train.csv: alpha is updated every 2 samples ..."``"""
        return f"{self.record}: {self.finding.channel} {self.finding.sentence}"


@dataclass(frozen=True, eq=False)
class RecordCheck:
    """Findings in the raw columns of all records of a call.

    ``trusted``: findings are only warnings; no sample is masked and no record refused.
    """

    records: tuple[str, ...] = ()
    seen: tuple[HandledFinding, ...] = ()
    trusted: bool = False

    @property
    def doubts(self) -> list[str]:
        """Probable errors with their remedies, one sentence each."""
        return [_with_remedy(one) for one in self.seen if one.done == WARNED]

    @property
    def set_aside(self) -> list[str]:
        """Masked samples and the reasons, one sentence each."""
        return [f"{one.sentence}; {one.done}" for one in self.seen if one.masked]

    @property
    def lines(self) -> list[str]:
        """Masked samples and further notes, one sentence each."""
        return [
            f"{one.sentence}; {one.done}" if one.masked else one.sentence
            for one in self.seen
            if one.done != WARNED
        ]


NOTHING_SEEN = RecordCheck()


def expectations_of(model: Model) -> Expectations:
    """Expected properties of a record of a declared model: airspeed, gravity, and the pitch
    acceleration by its first input.
    """
    if is_own(model):
        return Expectations(aircraft=False)
    p = model.parameters
    speed = next((p[name].value for name in AIRSPEEDS if name in p), None)
    gravity = p["gravity"].value if "gravity" in p else G0
    if "density_scale_height" in p:
        return Expectations(speed, gravity, scale_height=p["density_scale_height"].value)
    if "M_delta" in p:
        return Expectations(speed, gravity, p["M_delta"].value)
    if speed is not None and all(
        name in p for name in ("air_density", "wing_area", "chord", "pitch_inertia", "Cm_de")
    ):
        moment = 0.5 * p["air_density"].value * speed**2 * p["wing_area"].value * p["chord"].value
        return Expectations(
            speed,
            gravity,
            moment / p["pitch_inertia"].value * p["Cm_de"].value,
            angular_control=True,
        )
    return Expectations(speed, gravity)


def joined(looks: Sequence[RecordCheck], *, trusted: bool) -> RecordCheck:
    """Return the findings of records that were checked one by one."""
    return RecordCheck(
        tuple(dict.fromkeys(name for look in looks for name in look.records)),
        tuple(one for look in looks for one in look.seen),
        trusted,
    )


def checked_records(
    records: Sequence[Record], expected: Expectations, plan: Plan
) -> tuple[list[Record], RecordCheck]:
    """Return the records with uninformative samples masked, and the findings.

    Raises
    ------
    RecordError : a fault that is certain and would spoil every number, with its remedy; with the
        plan's ``trusted`` a warning instead.
    """
    out, seen = [], []
    for record in records:
        _refuse_endless(record)
        if any(np.max(np.abs(channel.values)) > LARGEST_NUMBER for channel in record.channels):
            out.append(record)  # no measurement; whoever fits it says so
            continue
        for finding in inspect(record, expected):
            record, one = _acted_on(record, finding, plan)
            seen.append(one)
        out.append(record)
    return out, RecordCheck(
        tuple(dict.fromkeys(record.name for record in records)), tuple(seen), plan.trusted
    )


def _refuse_endless(record: Record) -> None:
    """Raise RecordError if the record is too long to simulate."""
    with np.errstate(over="ignore"):
        usual = float(np.median(np.diff(record.time)))
        span = float(record.time[-1] - record.time[0])
    if not span / usual <= MOST_STEPS:
        whole = time_span(record.time[0], record.time[-1], 4)
        problem = f"it goes from {whole} in steps of {usual:.3g} s"
        remedy = "correct wrong times, or read a part of the rows with --from and --to"
        raise RecordError(problem, where=f"{record.name}, column time", remedy=remedy)


def _acted_on(record: Record, finding: RecordFinding, plan: Plan) -> tuple[Record, HandledFinding]:
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
    if finding.kind in (Kind.HELD, Kind.INTERPOLATED) and (
        plan.rate is not None or plan.lowpass is not None
    ):
        # A filter needs every sample; it interpolates between updates in any case.
        fresh = channel.valid & ~mask
        values = np.interp(record.time, record.time[fresh], channel.values[fresh])
        done = "replaced by straight lines between updates, for the filter"
        return _with(record, channel.name, np.where(channel.valid, values, np.nan)), HandledFinding(
            record.name, finding, done, int(np.count_nonzero(mask))
        )
    if np.all(mask | ~channel.valid):
        return record, HandledFinding(record.name, finding, WARNED)
    return _with(record, channel.name, np.where(mask, np.nan, channel.with_gaps())), HandledFinding(
        record.name, finding, "set aside", int(np.count_nonzero(mask))
    )


def _with(record: Record, name: str, values: np.ndarray) -> Record:
    outputs = tuple(
        Channel.of(name, channel.unit, values) if channel.name == name else channel
        for channel in record.outputs
    )
    return replace(record, outputs=outputs)


def _place(finding: RecordFinding) -> str:
    return (
        f"channels {finding.channel}"
        if " and " in finding.channel
        else f"channel {finding.channel}"
    )


def _with_remedy(one: HandledFinding) -> str:
    return f"{one.sentence}; {one.finding.remedy}" if one.finding.remedy else one.sentence


# ---- The raw look in words and for the JSON files

MOST_NAMED_PLACES = 3  # places of one finding that a table has room for


def record_content(look: RecordCheck) -> dict[str, Any]:
    """Return the entry ``record`` of a study: names of the records, findings, and masked samples by
    channel.
    """
    masked: dict[str, dict[str, int]] = {}
    for one in look.seen:
        if one.masked:
            channels = masked.setdefault(one.record, {})
            channels[one.finding.channel] = channels.get(one.finding.channel, 0) + one.masked
    return {
        "looked_at": list(look.records),
        "trusted": look.trusted,
        "findings": [_content(one) for one in look.seen],
        "masked": masked,
    }


def record_lines(look: RecordCheck) -> list[str]:
    """Return terminal lines on masked samples, and notes."""
    return [f"record: {line}" for line in look.lines]


def record_rows(look: RecordCheck) -> list[tuple[str, str, str, str, str]]:
    """Return the rows of a page's table: record, channel, finding, time, handling."""
    return [
        (
            one.record,
            one.finding.channel,
            one.finding.sentence,
            _when(one.finding),
            f"{one.masked} samples {one.done}" if one.masked else one.done,
        )
        for one in look.seen
    ]


def record_table(look: RecordCheck) -> Table:
    """Return the findings as a table of a page."""
    columns = tuple(map(Column, ("record", "channel", "seen", "when", "done")))
    caption = (
        "What the raw columns show, before any fit; samples that were set aside count in no fit "
        "and no error"
    )
    return Table(caption, columns, tuple(record_rows(look)))


def _content(one: HandledFinding) -> dict[str, Any]:
    finding = one.finding
    return {
        "record": one.record,
        "channel": finding.channel,
        "kind": finding.kind.value,
        "certainty": finding.certainty.value,
        "times": [[begin, end] for begin, end in finding.times],
        "numbers": {
            name: {"value": number.value, "unit": number.unit}
            for name, number in finding.numbers.items()
            if math.isfinite(number.value)
        },
        "masked": one.masked,
        "done": one.done,
        "sentence": f"{finding.channel} {finding.sentence}",
        **({"remedy": finding.remedy} if finding.remedy else {}),
    }


def _when(finding: RecordFinding) -> str:
    if not finding.times:
        return "throughout"
    return ", ".join(_span(finding.times[:MOST_NAMED_PLACES])) + (
        f" and {len(finding.times) - MOST_NAMED_PLACES} more"
        if len(finding.times) > MOST_NAMED_PLACES
        else ""
    )


def _span(times: Sequence[tuple[float, float]]) -> list[str]:
    return [
        f"{instant(begin)} s" if begin == end else f"{time_span(begin, end, 4)}"
        for begin, end in times
    ]


# ---- Isolated wrong samples of a measured record

Result = TypeVar("Result")
MOST_NAMED_TIMES = 3  # times that a sentence names


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
        wrong = isolated_wrong(residuals, valid, [input_edges(records[k]) for k in with_output])
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
    sentence += (
        f", up to {shown(float(np.max(distance)), channel.unit)} from the middle of the channel"
    )
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
