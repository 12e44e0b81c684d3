"""The least bit against the noise; and noise whose level changes along a record, from fourth differences, which hardly see the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.recording.finding import Certainty, Finding, Kind, Number, shown
from ident.recording.series import SMALLEST, Series, fourth_differences, scaled_differences
from ident.statistics.robust import ROBUST, robust_sigma_about_zero

COARSE = 1.0  # least bits over noise: below it rounding adds a twelfth of the noise's variance at most
DISTINCT = 4  # levels, fewer of which make no measurement
PARTS = (8, 4)
BITS = 2.0  # least bits of noise, below which a median of its size is one of few levels
FEWEST = 30  # samples of a part
FACTOR = 2.0  # chosen: weights that are wrong by four in the variance are worth a word
# Scatter of the logarithm of a robust sigma of n fourth differences, times sqrt(n): 1.17 for independent ones, 1.58 by simulation for these.
SCATTER = 1.6
SURE = 4.5  # of its standard deviations, between the quietest and the loudest of eight parts: by chance once in 5000 channels
LOUD = 4.0  # chosen: a sample four times as uncertain as others carries a sixteenth of their information and weighs as much in a fit
WINDOW = 25  # samples to both sides, over which a local level is taken
MOST = 0.5  # of a channel may be set aside: beyond it the loud part is the record
MOTION = 1.4  # ratio of the noise by second and fourth differences, beyond which a part shows motion


def coarse(series: Series) -> Finding | None:
    """A note where the least bit is coarse against the noise, so that residuals are rounding and not Gaussian."""
    bit = series.least_bit
    if not bit or series.span < DISTINCT * bit or bit < COARSE * series.noise:
        return None
    told = f"has a least bit of {shown(bit, series.unit)}, coarse against its noise: smaller things are not in the record, and rounding is not white"
    numbers = {"least_bit": Number(bit, series.unit)} | ({"noise": Number(series.noise, series.unit)} if series.noise else {})
    return Finding(series.name, Kind.RESOLUTION, Certainty.NOTED, told, "", (), numbers)


@dataclass(frozen=True)
class _Part:
    """A part of a channel: the standard deviation of its noise, were all roughness noise, and what else may have made that.

    Attributes
    ----------
    slow : the motion between two samples is less than the roughness, in the mean square and robustly, so that it cannot have made it.
    motion : root mean square of the change from sample to sample, beyond that of white noise as rough.
    rough : by input its own noise level or roughness. samples : how many the level is taken from. times : begin and end, s.
    white : whether second and fourth differences show the same level, as those of noise do.
    """

    level: float
    white: bool
    slow: bool
    motion: float
    rough: tuple[float, ...]
    samples: int
    times: tuple[float, float]


def changing_noise(series: Series, count: int, inputs: Sequence[Series] = (), others: Sequence[Series] = ()) -> Finding | None:
    """Noise of one part of a record ``count`` rows long that is several times that of another: from ``LOUD`` times on its samples are named.

    Roughness that the motion or an input can have made is no noise of the sensor: a loud part counts where the motion is slow against the
    sampling, or against a quiet part that moved as much; and only by as much as no ``inputs`` were rougher there. Where ``others``, the
    remaining outputs, became rougher in the same part, it is the air or the structure.
    """
    if not series.white or series.noise < BITS * series.least_bit:
        return None
    for parts in PARTS:
        found = _between_parts(series, min(parts, len(series.values) // FEWEST), count, (inputs, others))
        if found is not None:
            return found
    return None


def _parts(series: Series, parts: int, inputs: Sequence[Series]) -> list[_Part]:
    """The parts of a channel that have enough samples."""
    second, fourth = scaled_differences(series.time, series.values)[1:-1], fourth_differences(series.time, series.values)
    out = []
    for rows in np.array_split(np.arange(len(fourth)), parts):
        known = np.isfinite(fourth[rows])
        if np.count_nonzero(known) < FEWEST // 2:
            continue
        level = max(robust_sigma_about_zero(fourth[rows][known]), 0.5 * series.least_bit, SMALLEST * series.span)
        if level > 0.0:
            white = robust_sigma_about_zero(second[rows][known]) < MOTION * level
            begin, end = float(series.time[rows[0]]), float(series.time[rows[-1] + 4])
            steps, rough4 = np.diff(series.values[rows[0] : rows[-1] + 5]), fourth[rows][known]
            power = float(np.mean(steps**2) - 2.0 * np.mean(rough4**2))
            slow = power < float(np.mean(rough4**2)) and robust_sigma_about_zero(steps) ** 2 < 3.0 * level**2
            rough = tuple(_roughness(other, begin, end) for other in inputs)
            out.append(_Part(level, white, slow, float(np.sqrt(max(power, 0.0))), rough, int(np.count_nonzero(known)), (begin, end)))
    return out


def _roughness(other: Series, begin: float, end: float) -> float:
    """Size of the fourth differences of a channel between two times, half a step of its converter at least."""
    inside = (other.time >= begin) & (other.time <= end)
    if np.count_nonzero(inside) < FEWEST // 2:
        return 0.0
    fourth = fourth_differences(other.time[inside], other.values[inside])
    fourth = fourth[np.isfinite(fourth)]
    return max(robust_sigma_about_zero(fourth) if fourth.size else 0.0, 0.5 * other.least_bit)


def _beyond_inputs(quiet: _Part, loud: _Part) -> float:
    """Ratio of two levels, less the ratio by which an input was rougher: a linear system makes no more of it. Zero where the motion made it."""
    if not loud.slow and quiet.motion < loud.motion:
        return 0.0
    more = 1.0
    for before, after in zip(quiet.rough, loud.rough, strict=True):
        if after > before:
            more = max(more, after / before if before > 0.0 else np.inf)
    return loud.level / quiet.level / more


def _shared(quiet: _Part, loud: _Part, others: Sequence[Series]) -> bool:
    """Whether another output is rougher as well, by more than its roughness scatters."""
    least = max(FACTOR, float(np.exp(SURE * SCATTER * np.sqrt(1.0 / quiet.samples + 1.0 / loud.samples))))
    return any(_roughness(other, *loud.times) > least * _roughness(other, *quiet.times) > 0.0 for other in others)


def _sure(quiet: _Part, loud: _Part) -> bool:
    """Whether the noise of a part is larger than that of another by more than its estimates scatter."""
    ratio = _beyond_inputs(quiet, loud)
    scatter = SCATTER * np.sqrt(1.0 / quiet.samples + 1.0 / loud.samples)
    return bool(ratio >= FACTOR and np.log(ratio) >= SURE * scatter)


def _between_parts(series: Series, parts: int, count: int, beside: tuple[Sequence[Series], Sequence[Series]]) -> Finding | None:
    if parts < 3:
        return None
    inputs, others = beside
    every = _parts(series, parts, inputs)
    found = [one for one in every if one.white]
    pairs = [
        (quiet, loud) for quiet in found for loud in found if loud.level > quiet.level and _sure(quiet, loud) and not _shared(quiet, loud, others)
    ]
    if len(found) < 3 or not pairs:
        return None
    low, high = max(pairs, key=lambda pair: pair[1].level / pair[0].level)
    told = "has noise that changes along the record: "
    told += ", ".join(f"{shown(one.level, series.unit)} from {one.times[0]:.4g} to {one.times[1]:.4g} s" for one in (low, high))
    numbers = {"least": Number(low.level, series.unit), "greatest": Number(high.level, series.unit)}
    mask = np.zeros(count, dtype=bool)
    between = float(np.sqrt(low.level * high.level))
    above = [loud.level for _, loud in pairs if loud.level > between]
    below = [one.level for one in found if one.level <= between]
    if np.median(above) > LOUD * np.median(below):
        loud = _loud(fourth_differences(series.time, series.values), between, len(series.values))
        moved = [one for one in every if one.level > between and not any(one is other for _, other in pairs)]
        mask[series.rows[loud & ~_inside(series.time, moved)]] = True
    if 0.0 < np.count_nonzero(mask) < MOST * len(series.values):
        return Finding(series.name, Kind.NOISE_LEVEL, Certainty.COSTS_INFORMATION, told, "", (high.times,), numbers, mask)
    remedy = "one noise level is fitted to the whole record: sigmas are a mean; cut out the noisy part if it is a fault"
    return Finding(series.name, Kind.NOISE_LEVEL, Certainty.LIKELY, told, remedy, (high.times,), numbers)


def _inside(time: np.ndarray, parts: Sequence[_Part]) -> np.ndarray:
    """Which times lie in one of the parts."""
    inside = np.zeros(len(time), dtype=bool)
    for one in parts:
        inside |= (time >= one.times[0]) & (time <= one.times[1])
    return inside


def _loud(fourth: np.ndarray, above: float, count: int) -> np.ndarray:
    """Which of ``count`` samples lie where the noise, over a short window, is above a level."""
    known = np.isfinite(fourth)
    padded = np.pad(np.where(known, np.abs(fourth), np.nan), WINDOW, mode="reflect")
    local = ROBUST * np.nanmedian(np.lib.stride_tricks.sliding_window_view(padded, 2 * WINDOW + 1), axis=1)
    loud = np.zeros(count, dtype=bool)
    loud[2 : len(local) + 2] = local > above
    return loud
