"""Noise levels of a series: robust deviations, sensor noise, envelopes, levels that change along a
record.

The coefficients of the orthonormal cosine transform (DCT-II) of white noise are independent, each
with the noise's variance; what a model leaves of a motion is smooth and has its power at low
frequencies. With x = 4 sin^2(w / 2), w the frequency in rad a sample, the squared coefficients have
the expectation

    S(w) = s^2 + a / x,    s, a >= 0,

the spectrum of white noise and of a random walk beside it (Harvey, Forecasting, Structural Time
Series Models and the Kalman Filter, 1989, sections 2.4 and 4.3), to which that of any motion of
first order comes down above its corner. s^2 and a are those of Whittle's likelihood: I(w) / S(w) is
chi-square with one degree of freedom. The band begins at half the Nyquist frequency and is extended
downwards as long as the next block has the power that the band foretells. The cosine transform as a
sieve of noise from what is smooth: Garcia, Computational Statistics and Data Analysis 54, 2010, p.
1167.

As NASA TM-101722 did by eye on time histories; here the smooth part is taken out by a third
difference first.

White noise with a burst of four times its level fails tests for whiteness more often than not,
since a few loud samples weigh as much as all others; divided by its local level it passes.

Isolated wrong samples: found and set aside before anything is ranked, claimed only against the
final residual.

One spike dominates every score; but in runs, or all over a channel, large residuals are a model's
fault or heavy-tailed noise, and neither is a spike.
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

# ---- A standard deviation that outliers do not move

SIGMA_PER_MEDIAN_DEVIATION = 1.4826  # median absolute deviation to sigma


def robust_sigma(values: np.ndarray) -> float:
    """Return the standard deviation from the median absolute deviation, insensitive to outliers."""
    return (
        float(SIGMA_PER_MEDIAN_DEVIATION * np.median(np.abs(values - np.median(values))))
        if values.size
        else 0.0
    )


def robust_sigma_about_zero(values: np.ndarray) -> float:
    """Return the same of values whose middle is known to be zero, such as differences of a signal
    that moves both ways.
    """
    return float(SIGMA_PER_MEDIAN_DEVIATION * np.median(np.abs(values)))


# ---- The white noise of a sensor

SHORTEST_RUN = 16  # samples of a run that is looked at
# fewest coefficients in the band: fewer give a standard deviation worse than to an eighth
FEWEST_COEFFICIENTS = 32
# begin of the band, relative to the Nyquist frequency: residuals of rigid motion have no power
# above
BAND_START_SHARE = 0.5
BAND_BLOCKS = 12  # blocks by which the band grows to the whole spectrum
FALSE_REJECTION_PROBABILITY = 0.01  # probability that a block of white noise is left out
LARGEST_GAP = 10.0  # sample intervals: a longer pause in the samples begins another run
MOST_ITERATIONS = 12
NEGLIGIBLE_POWER_SHARE = 1e-9  # smallest white share of the power


def sensor_noise(series: Sequence[np.ndarray]) -> float | None:
    """Return the standard deviation of the white part of residuals; None if they are too short or
    have no white part.

    ``series``: runs of residuals at even intervals, each ``(N,)`` and finite; of several, as of
    several records, one noise is estimated.
    """
    runs = [np.asarray(each, dtype=float) for each in series if len(each) >= SHORTEST_RUN]
    if not runs:
        return None
    # of the Nyquist frequency
    share = np.concatenate([np.arange(1, len(run)) / len(run) for run in runs])
    power = np.concatenate([_cosine_transform(run)[1:] ** 2 for run in runs])
    order = np.argsort(-share, kind="stable")
    share, power = share[order], power[order]
    count = int(np.count_nonzero(share >= BAND_START_SHARE))
    if count < FEWEST_COEFFICIENTS or not power[:count].any():
        return None
    walk = 0.25 / np.sin(0.5 * np.pi * share) ** 2
    ends = np.unique(np.linspace(count, len(share), BAND_BLOCKS).astype(int)).tolist()
    white, random = _fitted(power[:count], walk[:count])
    for end, further in pairwise(ends):
        block = power[end:further] / (white + random * walk[end:further])
        if np.mean(block) > fdtri(further - end, end, 1.0 - FALSE_REJECTION_PROBABILITY):
            break
        white, random = _fitted(power[:further], walk[:further])
    return float(np.sqrt(white)) if white > NEGLIGIBLE_POWER_SHARE * float(np.mean(power)) else None


def _cosine_transform(x: np.ndarray) -> np.ndarray:
    """Return the orthonormal cosine transform of the second kind, ``(N,)`` from ``(N,)``, but for
    its first coefficient, which is larger by root two.

    By NumPy's Fourier transform of the even samples, then the odd ones backwards (Makhoul 1980);
    loading scipy.fft takes a tenth of a second.
    """
    turned = np.exp(-0.5j * np.pi * np.arange(len(x)) / len(x))
    return np.asarray(
        np.sqrt(2.0 / len(x)) * (np.fft.fft(np.concatenate([x[::2], x[1::2][::-1]])) * turned).real
    )


def used_runs(time: np.ndarray, residual: np.ndarray, used: np.ndarray) -> list[np.ndarray]:
    """Return the used samples of a residual ``(N,)`` at ``time`` (s), as runs without a long pause;
    masked samples in between are removed.
    """
    t, r = time[used], residual[used]
    if len(t) < 2:
        return []
    steps = np.diff(t)
    return np.split(r, np.flatnonzero(steps > LARGEST_GAP * float(np.median(steps))) + 1)


def _fitted(power: np.ndarray, walk: np.ndarray) -> tuple[float, float]:
    """Return s^2 and a of Whittle's likelihood, by weighted least squares with the last step's
    weights; both at least zero.
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

WITHIN_TWO_SIGMA = 0.9545  # share of a Gaussian inside the band
_FEWEST_DIFFERENCES = 20
_STENCIL = np.array([-1.0, 3.0, -3.0, 1.0])


def noise_envelope(record: Record, stop: float | None = None) -> dict[str, float]:
    """Return the standard deviation of the noise on each output: a quarter of the width of the band
    that holds 95.45 % of it.

    Parameters
    ----------
    record : measured data, samples taken as evenly spaced.
    stop : s, end of a quiet part at the beginning; None for the whole record, which is as good as
        long as the motion is slow against the sampling: a third difference lets a motion at w rad/s
        pass by (w dt)^3/4.5 of its amplitude.

    Four samples in a row enter as d = (-y[k] + 3 y[k+1] - 3 y[k+2] + y[k+3]) / sqrt(20), which has
    the variance of white noise. The band is central (quantiles), so that isolated spikes and
    switches do not widen it.

    Raises
    ------
    RecordError : fewer than twenty such runs of valid samples in a channel, or a channel without
        any noise.
    """
    stretch = record if stop is None else record.window(None, stop)
    out = {}
    for channel in stretch.outputs:
        whole = np.convolve(~channel.valid, np.ones(len(_STENCIL)), mode="valid") < 0.5
        d = np.convolve(channel.values, _STENCIL[::-1], mode="valid")[whole] / np.sqrt(
            np.sum(_STENCIL**2)
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
                "shows no noise at all", where=where, remedy="declare the noise level"
            )
        out[channel.name] = half_width / 2.0
    return out


# ---- Noise whose level changes along a series

RECORD_PARTS = 8
LOCAL_LEVEL_FEWEST = 40  # fewest differences of a part
# smallest ratio of levels worth a correction: weights that are wrong by two hardly change a test
NOTABLE_NOISE_RATIO = 1.5
# standard deviation of the logarithm of a robust sigma of n fourth differences, times sqrt(n), by
# simulation
LOG_SIGMA_SCATTER = 1.6
# smallest difference between the quietest and loudest part, in standard deviations: by chance once
# in 5000 series
UNEVEN_NOISE_SIGMAS = 4.5
# smallest ratio of levels by second and fourth differences in a part with motion, whose noise is
# unknown
MOTION_NOISE_RATIO = 1.25


def levelled(series: np.ndarray) -> np.ndarray:
    """Return a series ``(N,)`` over its local noise level, of the same mean level; itself where
    that does not change beyond chance.

    Slow variations are kept, so that a residual that is not noise is not hidden: a part with motion
    (second differences above fourth ones) gets the level of the other parts.
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
    if ratio < NOTABLE_NOISE_RATIO or np.log(
        ratio
    ) < UNEVEN_NOISE_SIGMAS * LOG_SIGMA_SCATTER * np.sqrt(2.0 * parts / len(fourth)):
        return series
    local = _running_level(fourth, int(len(fourth) / (4 * parts)))
    middle = np.clip(np.arange(count) - 2, 0, len(local) - 1)
    # The level of a part with motion is limited to those of the others.
    level = np.clip(local, levels[determined].min(), levels[determined].max())[middle]
    return np.asarray(series / level * np.sqrt(np.mean(level**2)))


def _differences(series: np.ndarray, order: int) -> np.ndarray:
    """Return the differences of an order, scaled so that white noise keeps its standard deviation:
    6 and 70 are sums of squared binomials.
    """
    return np.diff(series, order) / np.sqrt({2: 6.0, 4: 70.0}[order])


def _running_level(fourth: np.ndarray, half: int) -> np.ndarray:
    """Robust sigma over windows of ``half`` to both sides, at every tenth of a window and linear
    between.
    """
    at = np.unique(
        np.linspace(0, len(fourth) - 1, max(2, 20 * len(fourth) // (2 * half))).astype(int)
    )
    rough = [robust_sigma_about_zero(fourth[max(0, k - half) : k + half + 1]) for k in at]
    return np.interp(np.arange(len(fourth)), at, rough)


# in robust sigmas
SPIKE_WHILE_SEARCHING = 8.0  # before the model is complete a residual is not Gaussian
SPIKE_AT_THE_END = 5.5  # Gaussian noise exceeds it once in 3e7 samples
HEAVY_TAIL = (3.7, 6.5)  # Gaussian noise puts 2 of 10,000 samples there; more is a heavy tail
HEAVY_TAIL_CHANCE = 1e-3  # p-value of that count, by Poisson's law
FEWEST_AT_EDGES = 9  # samples near the edges of an input, three of which are one edge


@dataclass(frozen=True)
class Spikes:
    """Spikes of one channel of one record: sample numbers and sizes in the channel's unit."""

    record: int
    channel: str
    samples: tuple[int, ...]
    sizes: tuple[float, ...]


def provisional_mask(residual: np.ndarray, valid: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return False at single samples far above their six neighbours, ``(m, N)``; ``edges (N,)``
    True near a switch of an input.
    """
    keep = np.ones_like(valid)
    for i in range(len(residual)):
        away = from_neighbours(residual[i], valid[i])
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
    """Masks rebuilt from the final residuals of all samples, and the spikes that may be claimed.

    ``residuals`` and ``measured`` (validity) are ``(m, N)`` a record, ``blocked (N,)`` True near
    the edge of a fitted event: a sample there is set aside but not claimed.
    """
    masks, claims = [np.ones_like(valid) for valid in measured], []
    for i, channel in enumerate(channels):
        pooled = np.concatenate(
            [residual[i][valid[i]] for residual, valid in zip(residuals, measured, strict=True)]
        )
        sigma = robust_sigma(pooled)
        if sigma == 0.0:
            continue
        heavy = _heavy_tailed(pooled / sigma)
        for r, (residual, valid) in enumerate(zip(residuals, measured, strict=True)):
            large = valid[i] & (np.abs(residual[i]) > SPIKE_AT_THE_END * sigma)
            alone = _isolated(large)
            if heavy:
                continue
            masks[r][i] = ~alone
            samples = np.flatnonzero(alone & ~blocked[r])
            if samples.size:
                claims.append(
                    Spikes(
                        r, channel, tuple(samples.tolist()), tuple(residual[i][samples].tolist())
                    )
                )
    return masks, claims


def isolated_wrong(
    residuals: Sequence[np.ndarray], valid: Sequence[np.ndarray], edges: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """True at the isolated wrong samples of one channel in each record, ``(N,)``, from the
    residuals of a fit that may be incomplete.

    A wrong sample exceeds its neighbours (as during the search) or the residual (as at the end);
    there is none if the residual has heavy tails. Near the ``edges`` of an input, where an
    incomplete model always fails, it is compared with the other edges.
    """
    away = [
        from_neighbours(residual, usable) for residual, usable in zip(residuals, valid, strict=True)
    ]
    wrong = [np.zeros(len(residual), dtype=bool) for residual in residuals]
    for series, times in ((away, SPIKE_WHILE_SEARCHING), (residuals, SPIKE_AT_THE_END)):
        pooled = np.concatenate([some[usable] for some, usable in zip(series, valid, strict=True)])
        sigma = robust_sigma(pooled)
        if sigma == 0.0 or _heavy_tailed(pooled / sigma):
            continue
        wrong = [
            result | (_isolated(usable & (np.abs(some) > times * sigma)) & ~near)
            for result, some, usable, near in zip(wrong, series, valid, edges, strict=True)
        ]
        at_edges = np.concatenate(
            [some[usable & near] for some, usable, near in zip(series, valid, edges, strict=True)]
        )
        if at_edges.size < FEWEST_AT_EDGES:
            continue
        largest = float(np.max(np.abs(at_edges)))
        others = float(np.sqrt((np.sum(at_edges**2) - largest**2) / (at_edges.size - 1)))
        if largest > times * max(others, sigma):
            wrong = [
                result | (usable & near & (np.abs(some) >= largest))
                for result, some, usable, near in zip(wrong, series, valid, edges, strict=True)
            ]
    return wrong


def input_edges(record: Record, reach: int = 1) -> np.ndarray:
    """True within ``reach`` samples of a switch of an input, ``(N,)``."""
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
    """Return the samples of a recorded input that differ from both neighbours alike, while these
    agree: no held maneuver does that.
    """
    before, after = values[:-2], values[2:]
    height = values[1:-1] - 0.5 * (before + after)
    wander = np.abs(after - before)
    usual = max(robust_sigma(np.diff(values)), 1e-3 * float(np.ptp(values)))
    result = (np.abs(height) > SPIKE_WHILE_SEARCHING * usual) & (wander < 0.25 * np.abs(height))
    return np.flatnonzero(result) + 1


def from_neighbours(series: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Each sample minus the median of its six valid neighbours; zero where it is missing."""
    at = np.flatnonzero(valid)
    out = np.zeros_like(series)
    if len(at) < 7:
        return out
    values = series[at]
    padded = np.pad(values, 3, mode="reflect")
    around = np.stack([padded[k : k + len(values)] for k in (0, 1, 2, 4, 5, 6)])
    out[at] = values - np.median(around, axis=0)
    return out


def _isolated(large: np.ndarray) -> np.ndarray:
    """Large samples without a large neighbour within two samples: outliers in runs are no
    spikes.
    """
    count = np.convolve(np.pad(large, 2), np.ones(5), mode="valid")
    return large & (count < 1.5)


def _heavy_tailed(normalised: np.ndarray) -> bool:
    """Return whether more samples lie in the tail's range than Gaussian noise explains, at one in a
    thousand (Poisson).
    """
    (low, high), size = HEAVY_TAIL, np.abs(normalised)
    count = int(np.sum((size > low) & (size < high)))
    expected = len(normalised) * (math.erfc(low / math.sqrt(2)) - math.erfc(high / math.sqrt(2)))
    tail = 1.0 - sum(
        math.exp(k * math.log(expected) - expected - math.lgamma(k + 1)) for k in range(count)
    )
    return tail < HEAVY_TAIL_CHANCE
