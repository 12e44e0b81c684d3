"""One channel as it was sampled: its valid samples, its least bit, and the noise on top of its motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.statistics.robust import robust_sigma_about_zero
from sim.record import Channel, Record

FEWEST = 20  # samples that a word on a channel needs
ON_THE_GRID = 0.02  # of the least bit, within which a value lies on its grid: what rounding of a conversion leaves is far less
WHITE = 1.5  # ratio of the noise by second and by fourth differences: 1 for white noise, 10 and more for motion alone
RESOLVED = 0.7
STEPPED = 0.1  # of a converter's step, within which nine tenths of the differences lie on its multiples; a fifth of them by chance
BOTH_WAYS = 0.05  # share of the differences that rise or rest, and that fall or rest, in a signal that shows its converter
LATTICE = 3.5  # steps of a converter up to which differences are compared: a calibration that drifts shifts larger ones
# A converter behind a correction that moves on (an angle of attack brought to the c.g., an airspeed worked out from two
# pressures): within a fifth of its step lie two fifths of any other differences, .7 to .97 of the ATTAS records'.
SPREAD, SHARE, MOST_OTHERS, ENOUGH = 0.2, 0.65, 0.9, 100
TURNS = 0.2  # share of the differences of other sign than the one before: of a motion without noise hardly any are
FINE_DIGITS = 0.05  # of the usual difference: digits that are printed so coarsely have steps of their own
FINEST = 1e-6  # of a channel's span: the step of a converter of twenty bits, finer than any sensor's noise
SMALLEST = 1e-9  # of a channel's span, below which a scatter is rounding


@dataclass(frozen=True, eq=False)
class Series:
    """The valid samples of a channel, in their order.

    Attributes
    ----------
    time, values : shape ``(n,)``, s and the channel's unit. rows : their rows in the record.
    least_bit : the step of a grid on which all values lie; 0 where there is none that the samples show.
    noise : standard deviation of what changes from sample to sample without a motion, by fourth differences; robust.
    white : whether second differences give the same noise, so that it is noise indeed and not fast motion.
    """

    name: str
    unit: str
    time: np.ndarray
    values: np.ndarray
    rows: np.ndarray
    least_bit: float
    noise: float
    white: bool

    @property
    def resolved(self) -> bool:
        """Whether the noise is seen above the least bit. Rounding makes noise of a third of a bit look like 0.6."""
        return self.white and self.noise > RESOLVED * self.least_bit

    @property
    def span(self) -> float:
        return float(np.ptp(self.values)) if self.values.size else 0.0


def series_of(record: Record, channel: Channel) -> Series:
    """A channel's valid samples with what they say of its resolution and noise."""
    rows = np.flatnonzero(channel.valid)
    time, values = record.time[rows], channel.values[rows]
    noise, white = _noise(time, values)
    return Series(channel.name, channel.unit, time, values, rows, least_bit(values), noise, white)


def least_bit(values: np.ndarray) -> float:
    """The step of the converter; 0 where the values show none.

    It is the largest step of which all differences between values are multiples (Euclid's algorithm on floats), or the coarser one of
    which neighbouring samples differ by multiples: a calibration after the converter, and printed digits, shift its levels a little.
    """
    exact = exact_step(values)
    return max(exact, _converter_step(values, exact))


def measurable_noise(level: float | None, values: Sequence[np.ndarray]) -> float | None:
    """An estimate of a channel's noise that its samples can bear: at least the rounding of its converter, step/sqrt(12); None where they show none.

    ``level``: the estimate, None where there is none. ``values``: the channel's valid samples in each record. An estimate below a millionth of
    the channel's span without a converter's step is that of a computed or smoothed channel, or of an estimator at its limit.
    """
    if level is None:
        return None
    rounding = max((least_bit(each) for each in values if each.size), default=0.0) / math.sqrt(12.0)
    span = max((float(np.ptp(each)) for each in values if each.size), default=0.0)
    return None if max(level, rounding) <= FINEST * span else max(level, rounding)


def exact_step(values: np.ndarray) -> float:
    """The largest step of which all differences between values are multiples: of a converter, or of the digits that were printed."""
    levels = np.unique(values)
    if levels.size < 2:
        return 0.0
    steps = np.diff(levels)
    rounding = 64.0 * float(np.spacing(np.max(np.abs(levels))))
    finest = max(SMALLEST * float(np.ptp(levels)), rounding / ON_THE_GRID)
    steps = steps[steps > rounding]
    bit = float(np.min(steps)) if steps.size else 0.0
    while bit > finest:
        off = np.abs(steps - bit * np.round(steps / bit))
        off = off[off > ON_THE_GRID * bit + rounding]
        if not off.size:
            return bit
        bit = float(np.min(off))
    return 0.0


def _converter_step(values: np.ndarray, exact: float) -> float:
    """The step of which small differences of neighbouring samples are multiples within a tenth of it; 0 where there is none."""
    differences = np.diff(values)
    sizes = np.abs(differences)
    if sizes.size < FEWEST or min(np.mean(differences >= 0.0), np.mean(differences <= 0.0)) < BOTH_WAYS:
        return 0.0  # a signal that only rises or falls has steps of its rate, which say nothing of a converter
    least = max(3.0 * exact, SMALLEST * float(np.ptp(values)))
    moving = np.sort(sizes[sizes > least])
    if moving.size < FEWEST:
        return 0.0
    starts = np.quantile(moving, (0.02, 0.1, 0.2, 0.3, 0.4, 0.5))
    found = max(_lattice_step(sizes, start) for start in starts.tolist())
    turning = float(np.mean(differences[1:] * differences[:-1] < 0.0))
    return found or (_blurred_step(moving) if exact < FINE_DIGITS * float(np.median(moving)) and turning > TURNS else 0.0)


def _lattice_step(sizes: np.ndarray, step: float) -> float:
    """The step near a first guess on whose multiples nine tenths of the smaller sizes lie; 0 where they do not."""
    near, count = sizes, sizes
    for _ in range(3):
        near = sizes[sizes < LATTICE * step]
        count = np.round(near / step)
        if np.count_nonzero(count) < FEWEST:
            return 0.0
        step = float(count @ near / (count @ count))
    several = len(np.unique(count[count > 0.0])) > 1
    return step if several and np.mean(np.abs(near / step - count) < STEPPED) > 0.9 else 0.0


def _blurred_step(moving: np.ndarray) -> float:
    """The step on whose multiples, blurred by a correction behind the converter, most sizes lie; 0 where there is none.

    ``moving``: sizes of differences, zeros left out. The step is at most three times smaller than they usually are, and two
    multiples of it or more occur: a triangle has one.
    """
    usual = float(np.median(moving))
    best, found = SHARE, 0.0
    for step in np.geomspace(usual / LATTICE, 2.0 * usual, 100).tolist():
        ratio = moving[moving < LATTICE * step] / step
        if ratio.size < ENOUGH:
            continue
        count = np.round(ratio)
        inside = np.abs(ratio - count) < SPREAD
        share, occurring = float(np.mean(inside)), np.bincount(count[inside].astype(int))
        if share > best and np.max(occurring) < MOST_OTHERS * np.sum(occurring):
            best, found = share, step
    return found


def scaled_differences(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Each sample less the line between its neighbours, scaled to the noise of one sample; NaN across gaps; ``(n - 2,)``."""
    before, after = np.diff(time)[:-1], np.diff(time)[1:]
    share = before / (before + after)
    off = values[1:-1] - (1.0 - share) * values[:-2] - share * values[2:]
    usual = float(np.median(np.diff(time)))
    near = np.maximum(before, after) < 3.0 * usual
    return np.where(near, off / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2), np.nan)


def fourth_differences(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Differences of the second differences, scaled to the noise of one sample where sampling is even; ``(n - 4,)``."""
    second = scaled_differences(time, values) * np.sqrt(1.5)
    return (second[1:-1] - 0.5 * (second[:-2] + second[2:])) * np.sqrt(16.0 / 70.0)


def _noise(time: np.ndarray, values: np.ndarray) -> tuple[float, bool]:
    if values.size < FEWEST:
        return 0.0, False
    second, fourth = scaled_differences(time, values), fourth_differences(time, values)
    second, fourth = second[np.isfinite(second)], fourth[np.isfinite(fourth)]
    if fourth.size < FEWEST // 2:
        return 0.0, False
    by_second, by_fourth = robust_sigma_about_zero(second), robust_sigma_about_zero(fourth)
    real = by_fourth > SMALLEST * float(np.ptp(values))
    return (by_fourth if real else 0.0), bool(real and by_second < WHITE * by_fourth)


def runs_of(same: np.ndarray) -> np.ndarray:
    """Begin and end (exclusive) of every run of True, shape ``(runs, 2)``."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8)))
    return edges.reshape(-1, 2)
