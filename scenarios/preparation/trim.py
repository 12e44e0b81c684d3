"""What a measured record needs before it is fitted: inputs about their trim."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scenarios.files.own_models import is_own
from sim.declaration.model import Model, OfTotals
from sim.record import Channel, Record

REST = 0.05  # of an input's span, within which it rests
LEAST = 0.3  # s of rest at the beginning, without which nothing is known of the trim
OFF = 0.1  # of an input's span, that its middle is from zero where a zero is no trim
QUICK = ("alpha", "q", "nz", "az", "beta", "p", "r", "ny", "ay")  # channels in which a motion shows at once
STILL = 0.3  # of a channel's scatter over the record, by which it may change while the aircraft rests


def of_totals(model: Model) -> bool:
    """Whether the equations are of totals, not of perturbations about a trim: a user's own, those that say so, and those that know the airspeed."""
    if isinstance(model.equations, OfTotals):
        return model.equations.totals
    return is_own(model) or any(state.name == "airspeed" for state in model.equations.states)


def about_trim(record: Record) -> tuple[Record, dict[str, float]]:
    """The record with each input measured from its trim, and the trims taken off, by input and in its unit.

    The trim is the mean of the input before it first moves. A derivative does not notice where the zero of an input lies, since biases
    and initial states take it up; break-out, saturation and every curve do. An input that moves at once, and one whose
    trim is zero, stay as they are bit for bit.
    """
    trims: dict[str, float] = {}
    inputs = []
    for channel in record.inputs:
        level = _trim(record, channel.values)
        if level:
            trims[channel.name] = level
            channel = Channel.of(channel.name, channel.unit, channel.values - level)
        inputs.append(channel)
    return (replace(record, inputs=tuple(inputs)), trims) if trims else (record, trims)


def trim_sentence(record: Record, name: str) -> str:
    """What it means that no trim of an input was found although it stands off zero; empty where it does not."""
    values, unit = record[name].values, record[name].unit
    middle = float(np.median(values))
    if abs(middle) <= OFF * float(np.ptp(values)):
        return ""
    shown = f"{np.degrees(middle):.3g} deg" if unit == "rad" else f"{middle:.3g} {unit}"
    taken = f"its zero is taken, though its middle is {shown}: break-out, stops and curves count from there"
    return f"{record.name}: no rest of the {name} at the beginning tells its trim; {taken}; begin at rest (--from)"


def _trim(record: Record, values: np.ndarray) -> float:
    """Mean of an input before it first leaves the neighbourhood of its beginning; zero where it or the aircraft does not rest there."""
    time = record.time
    span = float(np.ptp(values))
    if span == 0.0:
        return 0.0
    start = float(np.median(values[: max(1, int(np.searchsorted(time, time[0] + LEAST)))]))
    away = np.abs(values - start) > REST * span
    until = int(np.argmax(away)) if np.any(away) else len(values)
    if until < 2 or time[until - 1] - time[0] < LEAST:
        return 0.0
    # The last sample before the move may already be on its way.
    until = max(2, until - 1)
    # An aircraft that still settles is in trim all the same where the input rests there most of the time, and at the end.
    usual = max(abs(float(np.median(some)) - start) for some in (values, values[int(np.searchsorted(time, time[-1] - LEAST)) :]))
    if usual > REST * span and any(_moves(channel, until) for channel in record.outputs if channel.name in QUICK):
        return 0.0
    resting = values[:until]
    level = float(np.mean(resting))
    scatter = _scatter_of_mean(resting)
    return level if abs(level) > 3.0 * scatter and abs(level) > 1e-6 * span else 0.0


def _scatter_of_mean(values: np.ndarray) -> float:
    """Standard deviation of the mean: noise counts sample by sample, a smooth motion, as a sum of sines begins with, as one value.

    The share of noise is von Neumann's ratio of the steps' mean square to twice the variance.
    """
    variance = float(np.var(values))
    if variance == 0.0:
        return 0.0
    noise = min(1.0, 0.5 * float(np.mean(np.diff(values) ** 2)) / variance)
    return float(np.sqrt(variance / max(1.0, noise * len(values))))


def _moves(channel: Channel, until: int) -> bool:
    """Whether a channel moves in its first samples, its noise left out: a maneuver that begins with a held step starts with the record."""
    first, every = channel.values[:until][channel.valid[:until]], channel.values[channel.valid]
    half = len(first) // 2
    return half > 0 and abs(float(np.mean(first[half:]) - np.mean(first[:half]))) > STILL * float(np.std(every))
