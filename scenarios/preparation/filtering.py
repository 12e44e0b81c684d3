"""One filter for all channels, inputs too: what is done to input and output alike cancels in a linear model.

Butterworth of fourth order, run forwards and backwards: no phase, half the amplitude at the corner.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scenarios.preparation.plan import Plan
from sim.errors import RecordError
from sim.propagation import MOST_STEPS
from sim.record import Channel, Hold, Record

ORDER = 4
BELOW_HALF = 0.8  # of half the new rate: corner of the filter ahead of resampling
EVEN = 0.01  # of the interval, by which even samples may be off
SAME = 1e-6  # of the rate, within which a record has the rate that is asked for already
FEWEST = 40  # samples that a filter needs to be of use
REACH = 0.5  # periods of the corner, about a gap, in which a filtered sample rests on what was filled in


def filtered(record: Record, plan: Plan) -> tuple[Record, str]:
    """The record behind the plan's filter and at its rate, and a sentence on it; the same object where the plan asks for neither.

    Uneven samples are laid on an even grid first. A held input is taken at the middle of each interval, where its
    samples stand for the signal; afterwards inputs are linear. A sample near a gap rests on interpolation and counts as missing.

    Raises
    ------
    RecordError : a rate above the record's, a corner above half its rate or below one period a record, or too few samples.
    """
    step = float(np.median(np.diff(record.time)))
    if plan.lowpass is None and (plan.rate is None or (abs(plan.rate * step - 1.0) < SAME and _is_even(record.time, step))):
        return record, ""
    corner, said = _corner(record, plan, 1.0 / step)
    time = _even(record.time, step)
    rows = {channel.name: _on(time, record, channel) for channel in record.channels}
    if len(time) < FEWEST:
        raise RecordError(f"{len(time)} samples are too few for a filter", where=record.name, remedy="leave out --rate and --lowpass")
    from scipy.signal import butter, sosfiltfilt

    sections = butter(ORDER, corner, fs=1.0 / step, output="sos")
    pad = min(len(time) - 1, round(3.0 / (corner * step)))
    smooth = {name: sosfiltfilt(sections, values, padlen=pad) for name, (values, _) in rows.items()}
    near = {name: _near_gaps(known, int(np.ceil(REACH / (corner * step)))) for name, (_, known) in rows.items()}
    new = time if plan.rate is None else time[0] + np.arange(int((time[-1] - time[0]) * plan.rate * (1.0 + 1e-9)) + 1) / plan.rate
    if plan.rate is not None:
        from scipy.interpolate import CubicSpline

        smooth_inputs = smooth
        smooth = {name: CubicSpline(time, values)(new) for name, values in smooth.items()}
        smooth |= {channel.name: _for_lines(time, smooth_inputs[channel.name], new) for channel in record.inputs}
        near = {name: np.interp(new, time, bad.astype(float)) > 0.0 for name, bad in near.items()}
    inputs = tuple(Channel.of(channel.name, channel.unit, smooth[channel.name]) for channel in record.inputs)
    outputs = tuple(Channel.of(c.name, c.unit, np.where(near[c.name], np.nan, smooth[c.name])) for c in record.outputs)
    return replace(record, time=new, inputs=inputs, outputs=outputs, hold=Hold.LINEAR), said


def _corner(record: Record, plan: Plan, rate: float) -> tuple[float, str]:
    corners, said = [], ""
    if plan.rate is not None:
        if plan.rate > rate * (1.0 + EVEN):
            remedy = "give a lower rate: more samples than were taken tell nothing"
            raise RecordError(f"--rate {plan.rate:g} Hz is above the record's {rate:.4g} Hz", where=record.name, remedy=remedy)
        corners.append(0.5 * BELOW_HALF * plan.rate)
        if corners[0] * (record.time[-1] - record.time[0]) < 1.0:
            what = f"--rate {plan.rate:g} Hz leaves nothing of a record of {record.time[-1] - record.time[0]:.4g} s"
            raise RecordError(what, where=record.name, remedy="give a higher rate, several samples for each of the motion's own periods")
        said = f"resampled from {rate:.4g} to {plan.rate:g} Hz, "
    if plan.lowpass is not None:
        if plan.lowpass > 0.5 * rate * (1.0 - EVEN):
            remedy = "give a lower corner, or leave the option out"
            raise RecordError(f"--lowpass {plan.lowpass:g} Hz is not below half the record's {rate:.4g} Hz", where=record.name, remedy=remedy)
        if plan.lowpass * (record.time[-1] - record.time[0]) < 1.0:
            what = f"--lowpass {plan.lowpass:g} Hz leaves nothing of a record of {record.time[-1] - record.time[0]:.4g} s"
            raise RecordError(what, where=record.name, remedy="give a higher corner, above the motion's own frequencies")
        corners.append(plan.lowpass)
    corner = min(corners)
    held = "; its inputs were held: loads that follow them at once are then read half a sample late" if record.hold is Hold.PREVIOUS else ""
    inputs = f", inputs linear since then{held}" if record.inputs else ""
    return corner, f"{record.name}: {said}all channels behind one zero-phase low-pass of {corner:.3g} Hz{inputs}"


def _even(time: np.ndarray, step: float) -> np.ndarray:
    if _is_even(time, step):
        return time
    count = (time[-1] - time[0]) / step * (1.0 + 1e-9) + 1
    if count > MOST_STEPS:
        what = f"a grid of {step:.3g} s over {time[-1] - time[0]:.3g} s has {count:.2g} samples"
        raise RecordError(what, where="column time", remedy="check the unit of the times, or read a part of them with --from and --to")
    return time[0] + step * np.arange(int(count))


def _is_even(time: np.ndarray, step: float) -> bool:
    return bool(np.all(np.abs(np.diff(time) - step) <= EVEN * step))


def _on(time: np.ndarray, record: Record, channel: Channel) -> tuple[np.ndarray, np.ndarray]:
    """A channel at ``time``, gaps bridged, and where its samples on both sides are there."""
    t, known = record.time, channel.valid
    if channel.name in record.input_names and record.hold is Hold.PREVIOUS:
        from scipy.interpolate import CubicSpline

        middles = 0.5 * (t + np.append(t[1:], 2.0 * t[-1] - t[-2]))
        return CubicSpline(middles, channel.values)(np.maximum(time, middles[0])), np.ones(len(time), dtype=bool)
    return np.interp(time, t[known], channel.values[known]), np.interp(time, t, known.astype(float)) > 1.0 - 1e-9


def _for_lines(time: np.ndarray, values: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Values at ``new`` whose straight lines come nearest to the signal by least squares: its own samples would cut its peaks."""
    from scipy.linalg import solveh_banded

    at = np.clip(np.searchsorted(new, time, side="right") - 1, 0, len(new) - 2)
    right = np.clip((time - new[at]) / (new[at + 1] - new[at]), 0.0, 1.0)
    left, n = 1.0 - right, len(new)
    diagonal = np.bincount(at, left**2, n) + np.bincount(at + 1, right**2, n)
    beside = np.concatenate([[0.0], np.bincount(at, left * right, n)[:-1]])
    goal = np.bincount(at, left * values, n) + np.bincount(at + 1, right * values, n)
    return np.asarray(solveh_banded(np.vstack([beside, diagonal]), goal))


def _near_gaps(known: np.ndarray, reach: int) -> np.ndarray:
    return np.asarray(np.convolve(~known, np.ones(2 * reach + 1), mode="same") > 0.5) if not np.all(known) else ~known
