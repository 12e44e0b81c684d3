"""Noise levels of a series: robust standard deviations, sensor noise, envelopes, levels that change
along a record, and isolated wrong samples.

Sensor noise. The orthonormal cosine transform (DCT-II) separates noise from a smooth motion
(Garcia, Computational Statistics and Data Analysis 54, 2010, p. 1167). The coefficients of white
noise are independent and have its variance. A motion that a model has not fitted has its power at
low frequencies. Let w be the frequency in rad per sample and x = 4 sin^2(w / 2). The squared
coefficients of white noise and a random walk have the expectation

    S(w) = s^2 + a / x,    s, a >= 0

(Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, sections 2.4 and
4.3). The spectrum of any first-order motion has this form above its corner frequency. s^2 and a
maximise Whittle's likelihood: the squared coefficients over S(w) are chi-square with one degree of
freedom. The band begins at half the Nyquist frequency and is extended downwards as long as the next
block has the power that the band predicts.

Noise envelope. It is the band that contains a given share of the noise. NASA TM-101722 read it from
time histories; here a third difference removes the smooth part first.

Local level. White noise with a burst of four times its level fails most tests for whiteness, since
a few large samples have as much weight as all others. Divided by its local level it passes.

Spikes. One spike dominates every measure of fit. Isolated wrong samples are therefore masked before
models are compared, but reported from the final residual only. Large residuals in runs, or
everywhere in a channel, are not spikes but an error of the model or heavy-tailed noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import fdtri

from sim.errors import RecordError
from sim.record import Record

# ---- Standard deviation that is insensitive to outliers

SIGMA_PER_MEDIAN_DEVIATION = 1.4826  # sigma over median absolute deviation of normal numbers


def robust_sigma(values: np.ndarray) -> float:
    """Return the standard deviation from the median absolute deviation, insensitive to outliers."""
    if not values.size:
        return 0.0
    return float(SIGMA_PER_MEDIAN_DEVIATION * np.median(np.abs(values - np.median(values))))


def robust_sigma_about_zero(values: np.ndarray) -> float:
    """Return the robust standard deviation of values whose median is known to be zero, such as
    differences of a signal that moves both ways.
    """
    return float(SIGMA_PER_MEDIAN_DEVIATION * np.median(np.abs(values)))


# ---- The white noise of a sensor

SHORTEST_RUN = 16  # fewest samples of a run of residuals that is used
# fewest coefficients in the band; they give the standard deviation to an eighth
FEWEST_COEFFICIENTS = 32
# lowest frequency of the first band, over the Nyquist frequency: residuals of rigid motion have no
# power above it
BAND_START_SHARE = 0.5
BAND_BLOCKS = 12  # number of blocks by which the band grows to the whole spectrum
FALSE_REJECTION_PROBABILITY = 0.01  # probability that a block of white noise is left out
LARGEST_GAP = 10.0  # a longer pause, in sample intervals, begins another run
MOST_ITERATIONS = 12  # iterations of the weights in Whittle's likelihood
NEGLIGIBLE_POWER_SHARE = 1e-9  # white power below this share of all power counts as none


def sensor_noise(series: Sequence[np.ndarray]) -> float | None:
    """Return the standard deviation of the white part of residuals; None if they are too short or
    have no white part.

    ``series`` are runs of finite residuals ``(N,)`` at even intervals with the same noise, for
    example one of each record.
    """
    runs = [np.asarray(run, dtype=float) for run in series if len(run) >= SHORTEST_RUN]
    if not runs:
        return None
    # share : frequency of a coefficient over the Nyquist frequency
    share = np.concatenate([np.arange(1, len(run)) / len(run) for run in runs])
    power = np.concatenate([_cosine_transform(run)[1:] ** 2 for run in runs])
    order = np.argsort(-share, kind="stable")
    share, power = share[order], power[order]
    count = int(np.count_nonzero(share >= BAND_START_SHARE))
    if count < FEWEST_COEFFICIENTS or not power[:count].any():
        return None
    walk = 0.25 / np.sin(0.5 * np.pi * share) ** 2
    ends = np.unique(np.linspace(count, len(share), BAND_BLOCKS).astype(int)).tolist()
    white, random = _white_and_walk(power[:count], walk[:count])
    for end, further in pairwise(ends):
        block = power[end:further] / (white + random * walk[end:further])
        if np.mean(block) > fdtri(further - end, end, 1.0 - FALSE_REJECTION_PROBABILITY):
            break
        white, random = _white_and_walk(power[:further], walk[:further])
    return float(np.sqrt(white)) if white > NEGLIGIBLE_POWER_SHARE * float(np.mean(power)) else None


def _cosine_transform(x: np.ndarray) -> np.ndarray:
    """Return the orthonormal cosine transform of the second kind ``(N,)`` of ``x (N,)``, except
    that its first coefficient is too large by the square root of two.

    It is computed by a Fourier transform of the even samples followed by the odd ones backwards
    (Makhoul 1980), since the import of scipy.fft would take a tenth of a second.
    """
    phase = np.exp(-0.5j * np.pi * np.arange(len(x)) / len(x))
    return np.asarray(
        np.sqrt(2.0 / len(x)) * (np.fft.fft(np.concatenate([x[::2], x[1::2][::-1]])) * phase).real
    )


def used_runs(time: np.ndarray, residual: np.ndarray, used: np.ndarray) -> list[np.ndarray]:
    """Return the samples ``used`` of a residual ``(N,)`` at ``time (N,)``, s, as runs without a
    long pause. Single masked samples within a run are left out.
    """
    t, r = time[used], residual[used]
    if len(t) < 2:
        return []
    steps = np.diff(t)
    return np.split(r, np.flatnonzero(steps > LARGEST_GAP * float(np.median(steps))) + 1)


def _white_and_walk(power: np.ndarray, walk: np.ndarray) -> tuple[float, float]:
    """Return s^2 and a, at least zero, that maximise Whittle's likelihood of the squared
    coefficients ``power (K,)``. ``walk (K,)`` is 1/x.

    Weighted least squares are repeated, each time with weights from the result before.
    """
    white, random = float(np.mean(power)), 0.0
    for _ in range(MOST_ITERATIONS):
        weight = (white + random * walk) ** -2.0
        n, u, v = float(weight.sum()), float(weight @ walk), float((weight * walk) @ walk)
        y, z = float(weight @ power), float((weight * walk) @ power)
        determinant = n * v - u * u
        slope = (n * z - u * y) / determinant if determinant > 0.0 else 0.0
        level = (y - u * slope) / n
        slope, level = (slope, level) if slope > 0.0 else (0.0, y / n)
        if level <= 0.0:  # no white part
            level, slope = 1e-3 * NEGLIGIBLE_POWER_SHARE * float(np.mean(power)), z / v
        white, random = level, slope
    return white, random


# ---- Measurement noise of a record

WITHIN_TWO_SIGMA = 0.9545  # probability of a normal number within two sigmas
_FEWEST_DIFFERENCES = 20  # fewest third differences that give a noise level
_THIRD_DIFFERENCE = np.array([-1.0, 3.0, -3.0, 1.0])  # weights of consecutive samples


def noise_envelope(record: Record, stop: float | None = None) -> dict[str, float]:
    """Return output -> standard deviation of its noise: a quarter of the width of the band that
    contains 95.45 % of the noise.

    Parameters
    ----------
    record : measured data, whose samples are taken as evenly spaced.
    stop : end of a part without motion at the beginning, s. None takes the whole record. This gives
        the same result where the motion is slow compared with the sampling: a third difference
        passes (w dt)^3/4.5 of the amplitude of a motion at w rad/s.

    Four consecutive samples give d = (-y[k] + 3 y[k+1] - 3 y[k+2] + y[k+3]) / sqrt(20), which has
    the variance of the white noise. The band is between quantiles, so that isolated spikes and
    switches do not widen it.

    Raises
    ------
    RecordError : where a channel has fewer than twenty such differences, or no noise.
    """
    stretch = record if stop is None else record.window(None, stop)
    envelope = {}
    for channel in stretch.outputs:
        complete = np.convolve(~channel.valid, np.ones(len(_THIRD_DIFFERENCE)), mode="valid") < 0.5
        d = np.convolve(channel.values, _THIRD_DIFFERENCE[::-1], mode="valid")[complete] / np.sqrt(
            np.sum(_THIRD_DIFFERENCE**2)
        )
        where = f"{record.name}, channel {channel.name}"
        if d.size < _FEWEST_DIFFERENCES:
            raise RecordError(
                f"{d.size} runs of four samples are too few for a noise envelope",
                where=where,
                remedy="give a longer stretch",
            )
        half_width = float(np.quantile(np.abs(d - np.median(d)), WITHIN_TWO_SIGMA))
        if half_width == 0.0:
            raise RecordError(
                "the channel has no noise", where=where, remedy="declare the noise level"
            )
        envelope[channel.name] = half_width / 2.0
    return envelope


# ---- Noise whose level changes along a series

RECORD_PARTS = 8  # largest number of parts of a series whose levels are compared
LOCAL_LEVEL_FEWEST = 40  # fewest differences of a part
# smallest ratio of levels that is corrected; a smaller ratio hardly changes a test
NOTABLE_NOISE_RATIO = 1.5
# standard deviation of the logarithm of a robust sigma from n fourth differences, times sqrt(n), by
# simulation
LOG_SIGMA_SCATTER = 1.6
# smallest difference of the logarithms of the largest and least level, in standard deviations;
# chance gives it once in 5000 series
UNEVEN_NOISE_SIGMAS = 4.5
# a part contains motion, so that its noise is unknown, where the level from second differences is
# more than this times the level from fourth differences
MOTION_NOISE_RATIO = 1.25


def with_constant_level(series: np.ndarray) -> np.ndarray:
    """Return a series ``(N,)`` divided by its local noise level and multiplied by its rms level;
    unchanged where the level changes no more than by chance.

    The level of a part with motion is limited to the range of the other parts, so that a residual
    that is not noise stays visible.
    """
    count = len(series)
    parts = min(RECORD_PARTS, count // LOCAL_LEVEL_FEWEST)
    if parts < 3:
        return series
    second, fourth = _differences(series, 2)[1:-1], _differences(series, 4)
    edges = np.linspace(0, len(fourth), parts + 1).astype(int)
    levels = np.array([robust_sigma_about_zero(fourth[a:b]) for a, b in pairwise(edges)])
    seconds = np.array([robust_sigma_about_zero(second[a:b]) for a, b in pairwise(edges)])
    determined = (levels > 0.0) & (seconds < MOTION_NOISE_RATIO * levels)
    if np.count_nonzero(determined) < 3:
        return series
    ratio = float(levels[determined].max() / levels[determined].min())
    scatter = LOG_SIGMA_SCATTER * np.sqrt(2.0 * parts / len(fourth))
    if ratio < NOTABLE_NOISE_RATIO or np.log(ratio) < UNEVEN_NOISE_SIGMAS * scatter:
        return series
    local = _running_level(fourth, int(len(fourth) / (4 * parts)))
    middle = np.clip(np.arange(count) - 2, 0, len(local) - 1)
    # Limit the level of a part with motion to the range of the other parts.
    level = np.clip(local, levels[determined].min(), levels[determined].max())[middle]
    return np.asarray(series / level * np.sqrt(np.mean(level**2)))


def _differences(series: np.ndarray, order: int) -> np.ndarray:
    """Return the differences of order 2 or 4, scaled so that white noise keeps its standard
    deviation. The divisors are sums of squared binomial coefficients.
    """
    return np.diff(series, order) / np.sqrt({2: 6.0, 4: 70.0}[order])


def _running_level(fourth: np.ndarray, half: int) -> np.ndarray:
    """Return the robust sigma ``(N,)`` over ``half`` samples on both sides, interpolated."""
    at = np.unique(
        np.linspace(0, len(fourth) - 1, max(2, 20 * len(fourth) // (2 * half))).astype(int)
    )
    levels = [robust_sigma_about_zero(fourth[max(0, k - half) : k + half + 1]) for k in at]
    return np.interp(np.arange(len(fourth)), at, levels)


# ---- Isolated wrong samples

# smallest spike, in robust sigmas, while the model is incomplete and its residual not normal
SPIKE_WHILE_SEARCHING = 8.0
# smallest spike of the final residual, in robust sigmas; normal noise has one in 3e7 samples
SPIKE_AT_THE_END = 5.5
# range of the tail, in robust sigmas: 2 of 10,000 samples of normal noise are in it
HEAVY_TAIL = (3.7, 6.5)
HEAVY_TAIL_CHANCE = 1e-3  # the tail is heavy where Poisson's law gives its count a smaller p-value
FEWEST_AT_EDGES = 9  # fewest samples near the edges of an input; each edge has three


@dataclass(frozen=True)
class Spikes:
    """Spikes of one channel of one record.

    Attributes
    ----------
    record : position of the record.
    channel : name of the channel.
    samples : positions of the samples.
    sizes : residuals of these samples, in the unit of the channel.
    """

    record: int
    channel: str
    samples: tuple[int, ...]
    sizes: tuple[float, ...]


def provisional_mask(residual: np.ndarray, valid: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return a mask ``(m, N)`` that is False at single samples of a ``residual (m, N)`` far from
    their six neighbours.

    ``valid (m, N)`` is False where a sample is missing. ``edges (N,)`` is True near a switch of an
    input, where no sample is masked.
    """
    keep = np.ones_like(valid)
    for i in range(len(residual)):
        away = difference_from_neighbours(residual[i], valid[i])
        sigma = robust_sigma(away[valid[i]])
        if sigma > 0:
            keep[i] = ~(_isolated(np.abs(away) > SPIKE_WHILE_SEARCHING * sigma) & ~edges)
    return keep


def final_spikes(
    records: Sequence[Record],
    channels: Sequence[str],
    residuals: Sequence[np.ndarray],
    measured: Sequence[np.ndarray],
    blocked: Sequence[np.ndarray],
) -> tuple[list[np.ndarray], list[Spikes]]:
    """Return the masks ``(m, N)`` of all records, False at isolated wrong samples, and the spikes
    to report. Both follow from the final residuals.

    Parameters
    ----------
    channels : names of the m outputs.
    residuals : ``(m, N)`` of each record.
    measured : ``(m, N)`` of each record, True where a sample is valid.
    blocked : ``(N,)`` of each record, True near the edge of a fitted event: a sample there is
        masked but not reported.
    """
    masks, claims = [np.ones_like(valid) for valid in measured], []
    for i, channel in enumerate(channels):
        pooled = np.concatenate(
            [residual[i][valid[i]] for residual, valid in zip(residuals, measured, strict=True)]
        )
        sigma = robust_sigma(pooled)
        if sigma == 0.0 or _heavy_tailed(pooled / sigma):
            continue
        for r, (residual, valid) in enumerate(zip(residuals, measured, strict=True)):
            large = valid[i] & (np.abs(residual[i]) > SPIKE_AT_THE_END * sigma)
            alone = _isolated(large)
            masks[r][i] = ~alone
            samples = np.flatnonzero(alone & ~blocked[r])
            if samples.size:
                sizes = residual[i][samples].tolist()
                claims.append(Spikes(r, channel, tuple(samples.tolist()), tuple(sizes)))
    return masks, claims


def isolated_wrong_samples(
    residuals: Sequence[np.ndarray], valid: Sequence[np.ndarray], edges: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """Return a mask ``(N,)`` of each record that is True at isolated wrong samples of one channel.

    ``residuals``, ``valid`` and ``edges`` are ``(N,)`` of each record. The model of the residuals
    may be incomplete. A wrong sample is far from its neighbours, as in `provisional_mask`, or has a
    large residual, as in `final_spikes`. There is none where the residual has heavy tails. Near the
    ``edges`` of an input an incomplete model always has large residuals: a sample there is compared
    with those at the other edges.
    """
    away = [
        difference_from_neighbours(residual, usable)
        for residual, usable in zip(residuals, valid, strict=True)
    ]
    wrong = [np.zeros(len(residual), dtype=bool) for residual in residuals]
    for series, sigmas in ((away, SPIKE_WHILE_SEARCHING), (residuals, SPIKE_AT_THE_END)):
        pooled = np.concatenate(
            [values[usable] for values, usable in zip(series, valid, strict=True)]
        )
        sigma = robust_sigma(pooled)
        if sigma == 0.0 or _heavy_tailed(pooled / sigma):
            continue
        wrong = [
            mask | (_isolated(usable & (np.abs(values) > sigmas * sigma)) & ~near)
            for mask, values, usable, near in zip(wrong, series, valid, edges, strict=True)
        ]
        at_edges = np.concatenate(
            [
                values[usable & near]
                for values, usable, near in zip(series, valid, edges, strict=True)
            ]
        )
        if at_edges.size < FEWEST_AT_EDGES:
            continue
        largest = float(np.max(np.abs(at_edges)))
        others = float(np.sqrt((np.sum(at_edges**2) - largest**2) / (at_edges.size - 1)))
        if largest > sigmas * max(others, sigma):
            wrong = [
                mask | (usable & near & (np.abs(values) >= largest))
                for mask, values, usable, near in zip(wrong, series, valid, edges, strict=True)
            ]
    return wrong


def input_edges(record: Record, reach: int = 1) -> np.ndarray:
    """Return a mask ``(N,)`` that is True within ``reach`` samples of a switch of an input: a step
    of more than a fifth of its range.
    """
    near = np.zeros(len(record), dtype=bool)
    for channel in record.inputs:
        step = np.abs(np.diff(channel.values, prepend=channel.values[0]))
        span = float(np.ptp(channel.values))
        near |= step > 0.2 * span if span > 0 else False
    wide = near.copy()
    for shift in range(1, reach + 1):
        wide[shift:] |= near[:-shift]
        wide[:-shift] |= near[shift:]
    return wide


def input_spikes(values: np.ndarray) -> np.ndarray:
    """Return the positions of single samples of an input that differ from both neighbours while the
    neighbours agree. No held maneuver has such a sample.
    """
    before, after = values[:-2], values[2:]
    height = values[1:-1] - 0.5 * (before + after)
    neighbour_difference = np.abs(after - before)
    usual_step = max(robust_sigma(np.diff(values)), 1e-3 * float(np.ptp(values)))
    spikes = (np.abs(height) > SPIKE_WHILE_SEARCHING * usual_step) & (
        neighbour_difference < 0.25 * np.abs(height)
    )
    return np.flatnonzero(spikes) + 1


def difference_from_neighbours(series: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Return each sample of a series ``(N,)`` minus the median of its six valid neighbours; zero
    where a sample is missing.
    """
    at = np.flatnonzero(valid)
    difference = np.zeros_like(series)
    if len(at) < 7:
        return difference
    values = series[at]
    padded = np.pad(values, 3, mode="reflect")
    around = np.stack([padded[k : k + len(values)] for k in (0, 1, 2, 4, 5, 6)])
    difference[at] = values - np.median(around, axis=0)
    return difference


def _isolated(large: np.ndarray) -> np.ndarray:
    """Return a mask ``(N,)`` of the large samples without a large neighbour within two samples."""
    count = np.convolve(np.pad(large, 2), np.ones(5), mode="valid")
    return large & (count < 1.5)


def _heavy_tailed(normalised: np.ndarray) -> bool:
    """Return whether significantly more samples are in the range ``HEAVY_TAIL`` than normal noise
    would have. ``normalised (N,)`` are samples over their sigma.
    """
    (low, high), size = HEAVY_TAIL, np.abs(normalised)
    count = int(np.sum((size > low) & (size < high)))
    expected = len(normalised) * (math.erfc(low / math.sqrt(2)) - math.erfc(high / math.sqrt(2)))
    tail = 1.0 - sum(
        math.exp(k * math.log(expected) - expected - math.lgamma(k + 1)) for k in range(count)
    )
    return tail < HEAVY_TAIL_CHANCE


# ---- Periods in residuals: the updates of a held output, and the strongest oscillations

_SMOOTHED_BINS = 801  # width of the smoothing window of a spectrum, in frequency bins
_SLOWEST_UPDATE_RATE = 2.0  # Hz: at lower frequencies a spectral line is motion
_MOST_PEAKS = 3  # largest number of peaks of a residual spectrum
_LEAST_PEAK_DISTANCE = 0.15  # smallest distance of two peaks, relative to the frequency


def update_period(
    times: Sequence[np.ndarray], predicted: Sequence[np.ndarray], residuals: Sequence[np.ndarray]
) -> float:
    """Return the most likely period, s, of the updates of an output that is held between updates;
    infinite where the spectrum has no line.

    The delay of a held output is a sawtooth between zero and the period. The residual of the output
    is minus the delay times its slope. The product of residual and slope therefore has a line at
    the frequency of the updates.

    Parameters
    ----------
    times : ``(N,)`` of each record, s.
    predicted, residuals : ``(N,)`` of each record, in the unit of the output.
    """
    from scipy.ndimage import uniform_filter1d

    interval = float(np.median(np.concatenate([np.diff(time) for time in times])))
    longest = max(len(time) for time in times)
    size = 8 * longest
    power = np.zeros(size // 2 + 1)
    for values, residual in zip(predicted, residuals, strict=True):
        product = residual * np.gradient(values)
        power += (
            np.abs(np.fft.rfft((product - product.mean()) * np.hanning(len(product)), size)) ** 2
        )
    frequency = np.fft.rfftfreq(size, interval)
    # The power of the maneuver decreases with frequency: a line exceeds the power around it.
    around = uniform_filter1d(power, _SMOOTHED_BINS)
    inside = (frequency > _SLOWEST_UPDATE_RATE) & (frequency < 0.5 / interval)
    height = np.where(inside, power / np.maximum(around, 1e-300), 0.0)
    at = int(np.argmax(height))
    return 1.0 / float(frequency[at]) if height[at] > 0 else np.inf


def spectral_peaks(
    records: Sequence[Record],
    residuals: Sequence[np.ndarray],
    valid: Sequence[np.ndarray],
    variance: np.ndarray,
) -> tuple[float, ...]:
    """Return up to three frequencies (rad/s) at which the normalised residuals have most power, the
    strongest first. They are at least 15 % apart.

    Missing samples count as zero. Samples are taken as evenly spaced at their mean interval.

    Parameters
    ----------
    residuals, valid : ``(m, N)`` of each record.
    variance : ``(m,)`` noise variance of each output.
    """
    peak_power: dict[float, float] = {}
    for record, residual, mask in zip(records, residuals, valid, strict=True):
        n = residual.shape[1]
        interval = float((record.time[-1] - record.time[0]) / (n - 1))
        power = np.sum(
            np.abs(np.fft.rfft(np.where(mask, residual, 0.0), axis=1)) ** 2 / variance[:, None],
            axis=0,
        )
        omega = 2.0 * np.pi * np.fft.rfftfreq(n, interval)
        smooth = np.convolve(power, [0.25, 0.5, 0.25], mode="same")
        for k in range(2, len(smooth) - 1):
            if smooth[k] >= smooth[k - 1] and smooth[k] > smooth[k + 1]:
                peak_power[float(omega[k])] = float(smooth[k]) / n
    chosen: list[float] = []
    for frequency in sorted(peak_power, key=lambda f: -peak_power[f]):
        if all(abs(frequency - other) > _LEAST_PEAK_DISTANCE * other for other in chosen):
            chosen.append(frequency)
        if len(chosen) == _MOST_PEAKS:
            break
    return tuple(chosen)
