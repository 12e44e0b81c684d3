"""Gaps in the time of a record, and zero-phase filtering of all channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from scenarios.files.measured.grid import CORNER_SHARE, FILTER_ORDER, ROUNDING
from scenarios.files.sources import LARGEST_NUMBER
from scenarios.preparation.plan import Plan, Segment
from sim.errors import RecordError, instant, time_span
from sim.propagation import MOST_STEPS
from sim.record import Channel, Hold, Record

# A gap is longer than both limits. Of 767 simulated records at 10 to 400 Hz, even or with a jitter
# of a quarter of a step, none has a gap by these limits; of 379 records that lost up to a tenth of
# their rows at random, one has.
SHORTEST_GAP_STEPS = 5.0  # in median sample intervals
SHORTEST_GAP = 0.25  # s; over a shorter time the input keeps its last value
FEWEST_PART_SAMPLES = 30  # a part with fewer samples is not used


def gaps_of(record: Record) -> np.ndarray:
    """Return the positions of the samples before the gaps of a record, ``(G,)``."""
    steps = np.diff(record.time)
    return np.flatnonzero(steps > max(SHORTEST_GAP_STEPS * float(np.median(steps)), SHORTEST_GAP))


@dataclass(frozen=True, eq=False)
class PartedRecord:
    """A record that is predicted in parts.

    Attributes
    ----------
    name : name of the record.
    time : times of all its rows, shape ``(N,)``, s; None if its parts are resampled.
    count : number of its parts.
    """

    name: str
    time: np.ndarray | None
    count: int


def parts_of(
    parted: Sequence[PartedRecord], all_parts: Sequence[Record]
) -> list[tuple[PartedRecord, slice]]:
    """Return each record with the slice of its parts among the parts of all records."""
    ends = np.cumsum([0, *(record.count for record in parted)]).tolist()
    assert ends[-1] == len(all_parts)
    return [(record, slice(*span)) for record, span in zip(parted, pairwise(ends), strict=True)]


def put_together(
    parted: PartedRecord, parts: Sequence[Record], predictions: Sequence[Sequence[np.ndarray]]
) -> tuple[Record, list[np.ndarray]]:
    """Join the parts of a record, and predictions of the parts.

    In rows outside the parts the outputs are missing, the inputs keep their last values, and a
    prediction is its mean.

    Parameters
    ----------
    parted : the record.
    parts : its parts in the order of time.
    predictions : for each prediction, the arrays of all parts, shape ``(m, n)`` each.

    Returns
    -------
    The record and the joined predictions, shape ``(m, N)`` each.
    """
    if len(parts) == 1 and (parted.time is None or len(parts[0]) == parted.time.size):
        return replace(parts[0], name=parted.name), [of_parts[0] for of_parts in predictions]
    times = np.concatenate([part.time for part in parts])
    time = times if parted.time is None else parted.time
    places = np.searchsorted(time, times)
    before = np.clip(np.searchsorted(times, time, side="right") - 1, 0, None)
    valid = np.zeros(time.size, dtype=bool)
    valid[places] = True

    def inputs(channel: Channel) -> Channel:
        return Channel.of(
            channel.name,
            channel.unit,
            np.concatenate([part[channel.name].values for part in parts])[before],
        )

    def outputs(channel: Channel) -> Channel:
        values = [
            part[channel.name].with_gaps()
            if channel.name in part.output_names
            else np.full(len(part), np.nan)
            for part in parts
        ]
        return Channel.of(
            channel.name, channel.unit, np.where(valid, np.concatenate(values)[before], np.nan)
        )

    all_outputs = {channel.name: channel for part in reversed(parts) for channel in part.outputs}
    record = Record(
        time,
        tuple(map(inputs, parts[0].inputs)),
        tuple(map(outputs, all_outputs.values())),
        parts[0].hold,
        parted.name,
    )
    joined_predictions = []
    for of_parts in predictions:
        joined = np.concatenate(of_parts, axis=1)
        mean = joined.mean(axis=1, keepdims=True)
        joined_predictions.append(np.where(valid, joined[:, before], mean))
    return record, joined_predictions


def split_at_gaps(
    record: Record, use: str = "used as {count} record{s}"
) -> tuple[tuple[Record, ...], str]:
    """Return the parts of a record between its gaps, and a sentence on them.

    Without a gap the result is the record and an empty text. A part without a sample of any output
    is left out. So is a part of fewer than ``FEWEST_PART_SAMPLES`` samples, unless all parts are
    that short. A part has only the outputs with samples in it; its name is ``NAME[from-to s]``.

    ``use``: use of the parts, for the sentence. Raises RecordError for an impossible time.
    """
    wrong = np.flatnonzero(np.abs(record.time) > LARGEST_NUMBER)
    if wrong.size:
        what = f"{record.time[wrong[0]]:g} s is no time of a measurement"
        raise RecordError(
            what,
            where=record.name,
            remedy="correct the time stamps, or cut them off with --from and --to",
        )
    after = gaps_of(record)
    if not after.size:
        return (record,), ""
    ends = [0, *(int(position) + 1 for position in after), len(record)]
    spans = [
        (begin, end)
        for begin, end in pairwise(ends)
        if end - begin >= 2 and any(np.any(channel.valid[begin:end]) for channel in record.outputs)
    ]
    long_spans = [span for span in spans if span[1] - span[0] >= FEWEST_PART_SAMPLES] or spans
    parts = tuple(_rows(record, begin, end) for begin, end in long_spans)
    t = record.time
    shown = [f"{time_span(t[position], t[position + 1], 4)}" for position in after[:3]]
    more = f" and {after.size - 3} more" if after.size > 3 else ""
    dropped = len(ends) - 1 - len(long_spans)
    left_out = ""
    if dropped:
        parts_word = "part" if dropped == 1 else "parts"
        left_out = f"; {dropped} {parts_word} of fewer than {FEWEST_PART_SAMPLES} samples left out"
    gaps = "a gap" if after.size == 1 else f"{after.size} gaps"
    used = use.format(count=len(parts), s="s" * (len(parts) > 1))
    return parts, f"the record has {gaps} ({', '.join(shown)}{more}) and is {used}{left_out}"


def _rows(record: Record, begin: int, end: int) -> Record:
    """Return the rows of a record from ``begin`` to before ``end``, with the outputs that have a
    sample there.
    """
    measured = tuple(channel for channel in record.outputs if np.any(channel.valid[begin:end]))
    part = replace(record, outputs=measured).window(
        float(record.time[begin]), float(record.time[end - 1])
    )
    return replace(part, name=f"{record.name}[{instant(part.time[0])}-{instant(part.time[-1])} s]")


EVEN_SAMPLING_TOLERANCE = 0.01  # largest relative deviation of even sample intervals
# A record whose rate differs by a smaller share is not resampled.
SAME_RATE_TOLERANCE = 1e-6
FILTERING_FEWEST = 40  # a record with fewer samples is not filtered
# Filtered samples this near to a gap count as missing, since they depend on the interpolation
# across it. In periods of the corner frequency.
GAP_REACH_PERIODS = 0.5


def filtered(record: Record, plan: Plan) -> tuple[Record, str]:
    """Return the filtered and resampled record, and a sentence on it.

    If the plan has neither filter nor rate, the same object is returned. Uneven samples are first
    interpolated on an even grid. A held input has its samples at the middle of their intervals.
    After the filter the inputs are linear between samples. Samples near a gap count as missing.

    Raises
    ------
    RecordError : the rate is above that of the record; the corner is above half the rate of the
        record, or below one period in its duration; the record has too few samples.
    """
    step = float(np.median(np.diff(record.time)))
    if plan.lowpass is None and (
        plan.rate is None
        or (abs(plan.rate * step - 1.0) < SAME_RATE_TOLERANCE and _is_even(record.time, step))
    ):
        return record, ""
    corner, sentence = _corner_frequency(record, plan, 1.0 / step)
    time = _even_times(record.time, step)
    rows = {channel.name: _interpolated(time, record, channel) for channel in record.channels}
    if len(time) < FILTERING_FEWEST:
        raise RecordError(
            f"{len(time)} samples are too few for a filter",
            where=record.name,
            remedy="leave out --rate and --lowpass",
        )
    from scipy.signal import butter, sosfiltfilt

    sections = butter(FILTER_ORDER, corner, fs=1.0 / step, output="sos")
    pad = min(len(time) - 1, round(3.0 / (corner * step)))
    smooth = {name: sosfiltfilt(sections, values, padlen=pad) for name, (values, _) in rows.items()}
    near = {
        name: _near_gaps(valid, int(np.ceil(GAP_REACH_PERIODS / (corner * step))))
        for name, (_, valid) in rows.items()
    }
    new = time
    if plan.rate is not None:
        from scipy.interpolate import CubicSpline

        count = int((time[-1] - time[0]) * plan.rate * ROUNDING) + 1
        new = time[0] + np.arange(count) / plan.rate
        smooth = {
            name: _knots_of_lines(time, values, new)
            if name in record.input_names
            else CubicSpline(time, values)(new)
            for name, values in smooth.items()
        }
        near = {name: np.interp(new, time, bad.astype(float)) > 0.0 for name, bad in near.items()}
    inputs = tuple(
        Channel.of(channel.name, channel.unit, smooth[channel.name]) for channel in record.inputs
    )
    outputs = tuple(
        Channel.of(
            channel.name, channel.unit, np.where(near[channel.name], np.nan, smooth[channel.name])
        )
        for channel in record.outputs
    )
    return replace(record, time=new, inputs=inputs, outputs=outputs, hold=Hold.LINEAR), sentence


def _corner_frequency(record: Record, plan: Plan, rate: float) -> tuple[float, str]:
    """Return the corner frequency of the filter, Hz, and a sentence on it.

    ``rate``: sample rate of the record, Hz.
    """
    corners, sentence = [], ""
    if plan.rate is not None:
        if plan.rate > rate * (1.0 + EVEN_SAMPLING_TOLERANCE):
            remedy = "give a lower rate: more samples than were taken tell nothing"
            raise RecordError(
                f"--rate {plan.rate:g} Hz is above the record's {rate:.4g} Hz",
                where=record.name,
                remedy=remedy,
            )
        corners.append(0.5 * CORNER_SHARE * plan.rate)
        if corners[0] * (record.time[-1] - record.time[0]) < 1.0:
            what = (
                f"--rate {plan.rate:g} Hz leaves nothing of a record of "
                f"{record.time[-1] - record.time[0]:.4g} s"
            )
            raise RecordError(
                what,
                where=record.name,
                remedy="give a higher rate, several samples for each of the motion's own periods",
            )
        sentence = f"resampled from {rate:.4g} to {plan.rate:g} Hz, "
    if plan.lowpass is not None:
        if plan.lowpass > 0.5 * rate * (1.0 - EVEN_SAMPLING_TOLERANCE):
            remedy = "give a lower corner, or leave the option out"
            raise RecordError(
                f"--lowpass {plan.lowpass:g} Hz is not below half the record's {rate:.4g} Hz",
                where=record.name,
                remedy=remedy,
            )
        if plan.lowpass * (record.time[-1] - record.time[0]) < 1.0:
            what = (
                f"--lowpass {plan.lowpass:g} Hz leaves nothing of a record of "
                f"{record.time[-1] - record.time[0]:.4g} s"
            )
            raise RecordError(
                what,
                where=record.name,
                remedy="give a higher corner, above the motion's own frequencies",
            )
        corners.append(plan.lowpass)
    corner = min(corners)
    remark = (
        "; its inputs were held: the response of a load without lag then appears half a sample late"
        if record.hold is Hold.PREVIOUS
        else ""
    )
    inputs = f", inputs linear since then{remark}" if record.inputs else ""
    return (
        corner,
        f"{record.name}: {sentence}all channels after one zero-phase low-pass of {corner:.3g} "
        f"Hz{inputs}",
    )


def _even_times(time: np.ndarray, step: float) -> np.ndarray:
    """Return even times, s, with the interval ``step`` over a record; its own if they are even."""
    if _is_even(time, step):
        return time
    count = (time[-1] - time[0]) / step * ROUNDING + 1
    if count > MOST_STEPS:
        what = f"a grid of {step:.3g} s over {time[-1] - time[0]:.3g} s has {count:.2g} samples"
        raise RecordError(
            what,
            where="column time",
            remedy="check the unit of the times, or read a part of them with --from and --to",
        )
    return time[0] + step * np.arange(int(count))


def _is_even(time: np.ndarray, step: float) -> bool:
    return bool(np.all(np.abs(np.diff(time) - step) <= EVEN_SAMPLING_TOLERANCE * step))


def _interpolated(
    time: np.ndarray, record: Record, channel: Channel
) -> tuple[np.ndarray, np.ndarray]:
    """Return a channel at ``time`` with gaps bridged, and where the samples about it are valid."""
    t, valid = record.time, channel.valid
    if channel.name in record.input_names and record.hold is Hold.PREVIOUS:
        from scipy.interpolate import CubicSpline

        middles = 0.5 * (t + np.append(t[1:], 2.0 * t[-1] - t[-2]))
        values = CubicSpline(middles, channel.values)(np.maximum(time, middles[0]))
        return values, np.ones(len(time), dtype=bool)
    values = np.interp(time, t[valid], channel.values[valid])
    return values, np.interp(time, t, valid.astype(float)) > 1.0 - 1e-9


def _knots_of_lines(time: np.ndarray, values: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Return values at the times ``new`` between which lines fit a signal by least squares.

    The signal has ``values`` at ``time``. Lines between its own samples would cut its peaks.
    """
    from scipy.linalg import solveh_banded

    at = np.clip(np.searchsorted(new, time, side="right") - 1, 0, len(new) - 2)
    right = np.clip((time - new[at]) / (new[at + 1] - new[at]), 0.0, 1.0)
    left, n = 1.0 - right, len(new)
    diagonal = np.bincount(at, left**2, n) + np.bincount(at + 1, right**2, n)
    beside = np.concatenate([[0.0], np.bincount(at, left * right, n)[:-1]])
    goal = np.bincount(at, left * values, n) + np.bincount(at + 1, right * values, n)
    return np.asarray(solveh_banded(np.vstack([beside, diagonal]), goal))


def _near_gaps(valid: np.ndarray, reach: int) -> np.ndarray:
    """Return whether a missing sample is at most ``reach`` samples away, ``(N,)``."""
    if np.all(valid):
        return ~valid
    return np.asarray(np.convolve(~valid, np.ones(2 * reach + 1), mode="same") > 0.5)


def named(name: str, segment: Segment, *, several: bool) -> str:
    """Return the name of a part of a record, ``record.csv[10-25 s]``.

    ``several``: whether the record gives several parts; else the result is ``record.csv``.
    """
    if not several:
        return name
    start, stop = (
        f"{end}" if end is None else instant(end, 6) for end in (segment.start, segment.stop)
    )
    return f"{name}[{start}-{stop} s]"
