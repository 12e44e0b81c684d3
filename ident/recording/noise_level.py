"""The least bit against the noise; and noise whose level changes along a record, from fourth differences, which hardly see the motion."""

from __future__ import annotations

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


def changing_noise(series: Series, count: int) -> Finding | None:
    """Noise of one part of a record ``count`` rows long that is several times that of another: from ``LOUD`` times on its samples are named."""
    if not series.white or series.noise < BITS * series.least_bit:
        return None
    for parts in PARTS:
        found = _between_parts(series, min(parts, len(series.values) // FEWEST), count)
        if found is not None:
            return found
    return None


def _between_parts(series: Series, parts: int, count: int) -> Finding | None:
    if parts < 3:
        return None
    second, fourth = scaled_differences(series.time, series.values)[1:-1], fourth_differences(series.time, series.values)
    levels, sizes, where = [], [], []
    for rows in np.array_split(np.arange(len(fourth)), parts):
        known = np.isfinite(fourth[rows])
        if np.count_nonzero(known) < FEWEST // 2:
            continue
        level = max(robust_sigma_about_zero(fourth[rows][known]), 0.5 * series.least_bit, SMALLEST * series.span)
        if level > 0.0 and robust_sigma_about_zero(second[rows][known]) < MOTION * level:
            levels.append(level)
            sizes.append(int(np.count_nonzero(known)))
            where.append((float(series.time[rows[0]]), float(series.time[rows[-1] + 4])))
    if len(levels) < 3:
        return None
    low, high = int(np.argmin(levels)), int(np.argmax(levels))
    ratio = levels[high] / levels[low]
    scatter = SCATTER * np.sqrt(1.0 / sizes[low] + 1.0 / sizes[high])
    if ratio < FACTOR or np.log(ratio) < SURE * scatter:
        return None
    quiet, loud = (f"{shown(levels[i], series.unit)} from {where[i][0]:.4g} to {where[i][1]:.4g} s" for i in (low, high))
    told = f"has noise that changes along the record: {quiet}, {loud}"
    numbers = {"least": Number(levels[low], series.unit), "greatest": Number(levels[high], series.unit)}
    mask = np.zeros(count, dtype=bool)
    between = float(np.sqrt(levels[low] * levels[high]))
    above, below = [level for level in levels if level > between], [level for level in levels if level <= between]
    if np.median(above) > LOUD * np.median(below):
        mask[series.rows[_loud(fourth, between, len(series.values))]] = True
    if 0.0 < np.count_nonzero(mask) < MOST * len(series.values):
        return Finding(series.name, Kind.NOISE_LEVEL, Certainty.COSTS_INFORMATION, told, "", (where[high],), numbers, mask)
    remedy = "one noise level is fitted to the whole record: sigmas are a mean; cut out the noisy part if it is a fault"
    return Finding(series.name, Kind.NOISE_LEVEL, Certainty.LIKELY, told, remedy, (where[high],), numbers)


def _loud(fourth: np.ndarray, above: float, count: int) -> np.ndarray:
    """Which of ``count`` samples lie where the noise, over a short window, is above a level."""
    known = np.isfinite(fourth)
    padded = np.pad(np.where(known, np.abs(fourth), np.nan), WINDOW, mode="reflect")
    local = ROBUST * np.nanmedian(np.lib.stride_tricks.sliding_window_view(padded, 2 * WINDOW + 1), axis=1)
    loud = np.zeros(count, dtype=bool)
    loud[2 : len(local) + 2] = local > above
    return loud
