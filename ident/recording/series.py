"""One sampled channel with its valid samples, resolution and noise; and the findings of the record
check.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from ident.statistics.noise_levels import SIGMA_PER_MEDIAN_DEVIATION, robust_sigma_about_zero
from sim.errors import time_span
from sim.record import Channel, Record

# ---- Findings of the record check

NO_ROWS = np.zeros(0, dtype=bool)


class Kind(Enum):
    """Kind of a recording error."""

    HELD = "held"
    INTERPOLATED = "interpolated"
    FILTERED = "filtered"
    STUCK = "stuck"
    CLIPPED = "clipped"
    DROPOUT = "dropout"
    WILD_POINTS = "wild points"
    ROWS_MISSING = "rows missing"
    RESOLUTION = "resolution"
    ZERO_STEP = "zero step"
    NOISE_LEVEL = "noise level"
    HUM = "hum"
    UNIT = "unit"
    SIGN = "sign"
    EXCHANGED = "exchanged"
    TIME_BASE = "time base"


class Certainty(Enum):
    """Consequence of a finding: refuse the record, warn the user, mask samples, or only note it."""

    CERTAIN = "certain"
    LIKELY = "likely"
    COSTS_INFORMATION = "costs information"
    NOTED = "noted"


@dataclass(frozen=True)
class FindingQuantity:
    """A number of a finding with its unit, SI and radians, nz in g."""

    value: float
    unit: str


def quantities(**numbers: float | tuple[float, str]) -> dict[str, FindingQuantity]:
    """Return the numbers of a finding by name: values with their units, or values of unit 1."""
    return {
        name: FindingQuantity(*number)
        if isinstance(number, tuple)
        else FindingQuantity(number, "1")
        for name, number in numbers.items()
    }


@dataclass(frozen=True, eq=False)
class RecordFinding:
    """A finding in the raw columns.

    Attributes
    ----------
    channel : name of the channel, several names joined by " and ", or ``"time"``.
    sentence : the finding in words without the subject, which is the channel.
    remedy : advice to the user; may be empty.
    times : begin and end, s, of each place; empty for the whole record.
    mask : ``(N,)`` True at rows whose sample of ``channel`` has no information; of length zero
        where no rows are named.
    """

    channel: str
    kind: Kind
    certainty: Certainty
    sentence: str
    remedy: str = ""
    times: tuple[tuple[float, float], ...] = ()
    numbers: Mapping[str, FindingQuantity] = field(default_factory=dict)
    mask: np.ndarray = field(default_factory=lambda: NO_ROWS)

    @property
    def count(self) -> int:
        """Number of masked samples."""
        return int(np.count_nonzero(self.mask))


@dataclass(frozen=True)
class Expectations:
    """Values of the vehicle file that a record is compared with; None where one is unknown.

    Attributes
    ----------
    airspeed : m/s.
    gravity : m/s2.
    control_power : pitch acceleration per unit of the first input, rad/s2, with its sign.
    angular_control : whether the first input is an angle, so that ``control_power`` distinguishes
        radians from degrees.
    scale_height : of the air density, m, for a body that falls under gravity and drag.
    aircraft : whether the channels named alpha, q, nz and so on are those of an aircraft, so that
        the kinematics relate them.
    """

    airspeed: float | None = None
    gravity: float = 9.80665
    control_power: float | None = None
    angular_control: bool = False
    aircraft: bool = True
    scale_height: float | None = None


def quantity_text(value: float, unit: str) -> str:
    """Return a value with its unit as text, angles in degrees."""
    if unit.startswith("rad"):
        value, unit = 180.0 / math.pi * value, unit.replace("rad", "deg", 1)
    return f"{value:.3g}{'' if unit in ('', '1') else f' {unit}'}"


# ---- One channel as it was sampled

FEWEST_SAMPLES = 20  # fewest samples of a channel that is checked
# largest distance of a value from its grid, in least bits: conversions round far less
GRID_TOLERANCE = 0.02
# largest ratio of the noise by second differences to that by fourth ones, for white noise: it is 1,
# and 10 or more for motion
LARGEST_WHITE_RATIO = 1.5
RESOLVED_BITS = 0.7  # larger noise, in least bits, is resolved
# share of a step: nine tenths of the small differences are as near to its multiples; by chance a
# fifth of them are
MULTIPLE_TOLERANCE = 0.1
# smallest share of differences >= 0, and of those <= 0, in a signal that shows a converter step
LEAST_SIGN_SHARE = 0.05
# largest differences that are used, in steps: a drift of the calibration shifts larger ones
MOST_LATTICE_STEPS = 3.5
# A varying correction (alpha at the c.g., airspeed from pressures) blurs the multiples of a step.
# Within this share of a step are 0.7 to 0.97 of the differences in ATTAS records; by chance 0.4.
STEP_SCATTER_SHARE = 0.2
STEP_DIFFERENCE_SHARE = 0.65  # smallest share of the differences within that scatter
LARGEST_OTHER_SHARE = 0.9  # largest share of differences that are the same multiple
FEWEST_DIFFERENCES = 100  # fewest differences that show a blurred step
# smallest share of successive differences of opposite sign: a motion without noise has hardly any
LEAST_TURN_SHARE = 0.2
# largest printed digit, over the median difference, that does not hide a converter
LARGEST_DIGIT_SHARE = 0.05
FINEST_STEP_SHARE = 1e-6  # smallest step of a converter, over the range of the channel (20 bits)
ROUNDING_SHARE = 1e-9  # largest rounding, over the range of the channel


@dataclass(frozen=True, eq=False)
class Series:
    """The valid samples of a channel.

    Attributes
    ----------
    time, values : ``(n,)``, s and the unit of the channel.
    rows : ``(n,)`` their rows in the record.
    least_bit : step of the grid of all values; 0 without a grid.
    noise : robust standard deviation of the noise, by fourth differences.
    white : whether second differences give the same noise, so that it is not fast motion.
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
        """Whether the noise exceeds the least bit. With rounding, noise of a third of a bit seems
        to be 0.6 bits.
        """
        return self.white and self.noise > RESOLVED_BITS * self.least_bit

    @property
    def span(self) -> float:
        """Range of the values."""
        return float(np.ptp(self.values)) if self.values.size else 0.0


def series_of(record: Record, channel: Channel) -> Series:
    """Return the valid samples of a channel, with its resolution and noise."""
    rows = np.flatnonzero(channel.valid)
    time, values = record.time[rows], channel.values[rows]
    noise, white = _noise(time, values)
    return Series(channel.name, channel.unit, time, values, rows, least_bit(values), noise, white)


def least_bit(values: np.ndarray) -> float:
    """Return the step of the converter; 0 where the values show none.

    The step is the largest common divisor of all differences between values, by Euclid's algorithm
    on floats. Where calibrations or printed digits shift the levels, it is the coarser step that
    successive differences show.
    """
    exact = exact_step(values)
    return max(exact, _converter_step(values, exact))


def measurable_noise(level: float | None, values: Sequence[np.ndarray]) -> float | None:
    """Return the noise ``level`` of a channel, or the rounding error of its converter, step over
    sqrt(12), if this is larger; None without noise. ``values`` are the valid samples by record.

    A level below a millionth of the range, without a step, is that of a computed or smoothed
    channel, or of an estimator at its limit.
    """
    if level is None:
        return None
    samples = [row for row in values if row.size]
    rounding = max((least_bit(row) for row in samples), default=0.0) / math.sqrt(12.0)
    span = max((float(np.ptp(row)) for row in samples), default=0.0)
    noise = max(level, rounding)
    return None if noise <= FINEST_STEP_SHARE * span else noise


def exact_step(values: np.ndarray) -> float:
    """Return the largest step of which all differences between values are multiples; 0 without one.
    A converter or printed digits cause such a step.
    """
    levels = np.unique(values)
    if levels.size < 2:
        return 0.0
    steps = np.diff(levels)
    rounding = 64.0 * float(np.spacing(np.max(np.abs(levels))))
    finest = max(ROUNDING_SHARE * float(np.ptp(levels)), rounding / GRID_TOLERANCE)
    steps = steps[steps > rounding]
    bit = float(np.min(steps)) if steps.size else 0.0
    while bit > finest:
        remainder = np.abs(steps - bit * np.round(steps / bit))
        remainder = remainder[remainder > GRID_TOLERANCE * bit + rounding]
        if not remainder.size:
            return bit
        bit = float(np.min(remainder))
    return 0.0


def _converter_step(values: np.ndarray, exact: float) -> float:
    """Return the step of which small successive differences are multiples within a tenth of it; 0
    without one. ``exact`` is the result of `exact_step`.
    """
    differences = np.diff(values)
    sizes = np.abs(differences)
    if (
        sizes.size < FEWEST_SAMPLES
        or min(np.mean(differences >= 0.0), np.mean(differences <= 0.0)) < LEAST_SIGN_SHARE
    ):
        # The steps of a monotonic signal follow from its rate, not from a converter.
        return 0.0
    least = max(3.0 * exact, ROUNDING_SHARE * float(np.ptp(values)))
    moving = np.sort(sizes[sizes > least])
    if moving.size < FEWEST_SAMPLES:
        return 0.0
    starts = np.quantile(moving, (0.02, 0.1, 0.2, 0.3, 0.4, 0.5))
    result = max(_lattice_step(sizes, start) for start in starts.tolist())
    turning = float(np.mean(differences[1:] * differences[:-1] < 0.0))
    if result > 0.0:
        return result
    fine_digits = exact < LARGEST_DIGIT_SHARE * float(np.median(moving))
    return _blurred_step(moving) if fine_digits and turning > LEAST_TURN_SHARE else 0.0


def _lattice_step(sizes: np.ndarray, step: float) -> float:
    """Return the step near the guess ``step`` of which nine tenths of the small differences are
    multiples; 0 without one. ``sizes`` are absolute differences.
    """
    near, count = sizes, sizes
    for _ in range(3):
        near = sizes[sizes < MOST_LATTICE_STEPS * step]
        count = np.round(near / step)
        if np.count_nonzero(count) < FEWEST_SAMPLES:
            return 0.0
        step = float(count @ near / (count @ count))
    several = len(np.unique(count[count > 0.0])) > 1
    whole = np.abs(near / step - count) < MULTIPLE_TOLERANCE
    return step if several and np.mean(whole) > 0.9 else 0.0


def _blurred_step(moving: np.ndarray) -> float:
    """Return the step of which most differences are multiples, apart from the scatter of a later
    correction; 0 without one.

    ``moving`` are the absolute differences that are not zero. At least two different multiples must
    occur: all differences of a triangular signal are equal without a converter.
    """
    median = float(np.median(moving))
    best, result = STEP_DIFFERENCE_SHARE, 0.0
    for step in np.geomspace(median / MOST_LATTICE_STEPS, 2.0 * median, 100).tolist():
        ratio = moving[moving < MOST_LATTICE_STEPS * step] / step
        if ratio.size < FEWEST_DIFFERENCES:
            continue
        count = np.round(ratio)
        inside = np.abs(ratio - count) < STEP_SCATTER_SHARE
        share, occurring = float(np.mean(inside)), np.bincount(count[inside].astype(int))
        if share > best and np.max(occurring) < LARGEST_OTHER_SHARE * np.sum(occurring):
            best, result = share, step
    return result


def scaled_differences(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return each sample minus the line between its neighbours, ``(n - 2,)``, scaled to the noise
    of one sample; NaN across gaps.
    """
    before, after = np.diff(time)[:-1], np.diff(time)[1:]
    share = before / (before + after)
    off = values[1:-1] - (1.0 - share) * values[:-2] - share * values[2:]
    usual = float(np.median(np.diff(time)))
    near = np.maximum(before, after) < 3.0 * usual
    return np.where(near, off / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2), np.nan)


def fourth_differences(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the fourth differences ``(n - 4,)``, scaled to the noise of one sample where sampling
    is even.
    """
    second = scaled_differences(time, values) * np.sqrt(1.5)
    return (second[1:-1] - 0.5 * (second[:-2] + second[2:])) * np.sqrt(16.0 / 70.0)


def _noise(time: np.ndarray, values: np.ndarray) -> tuple[float, bool]:
    """Return the noise of a channel by fourth differences, and whether it is white."""
    if values.size < FEWEST_SAMPLES:
        return 0.0, False
    second, fourth = scaled_differences(time, values), fourth_differences(time, values)
    second, fourth = second[np.isfinite(second)], fourth[np.isfinite(fourth)]
    if fourth.size < FEWEST_SAMPLES // 2:
        return 0.0, False
    by_second, by_fourth = robust_sigma_about_zero(second), robust_sigma_about_zero(fourth)
    real = by_fourth > ROUNDING_SHARE * float(np.ptp(values))
    return (by_fourth if real else 0.0), bool(real and by_second < LARGEST_WHITE_RATIO * by_fourth)


def runs_of(same: np.ndarray) -> np.ndarray:
    """Return begin and end (exclusive) of every run of True, shape ``(runs, 2)``."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8)))
    return edges.reshape(-1, 2)


# ---- The least bit against the noise

# smallest coarse step, over the noise: a smaller one adds at most a twelfth to the variance
COARSE_STEP_BITS = 1.0
FEWEST_LEVELS = 4  # fewest levels of a measurement
PARTS = (8, 4)  # numbers of parts of a record whose noise is compared
COARSE_NOISE_BITS = 2.0  # smaller noise, in least bits, has a median of few values
FEWEST_PART_SAMPLES = 30  # fewest samples of a part
NOTABLE_NOISE_RATIO = 2.0  # smallest ratio of noise levels in a finding: weights are wrong by four
# standard deviation of the logarithm of a robust sigma of n fourth differences, times sqrt(n): 1.58
# by simulation (1.17 if they were independent)
LOG_SCATTER = 1.6
# smallest difference of the logarithms of two levels, in standard deviations; the largest and least
# of eight parts have it by chance in one of 5000 channels
UNEVEN_SIGMAS = 4.5
# samples with a larger noise ratio are masked: their information is a sixteenth at the same weight
LOUD_SAMPLE_RATIO = 4.0
LOCAL_LEVEL_SAMPLES = 25  # samples on each side for a local noise level
LARGEST_MASKED_SHARE = 0.5  # of a channel: with a larger share, the loud part is the normal one
# smallest ratio of the noise by second differences to that by fourth ones that shows motion
MOTION_NOISE_RATIO = 1.4


def resolution_finding(series: Series) -> RecordFinding | None:
    """Return a note if the least bit is coarse against the noise: residuals are then rounding, not
    Gaussian.
    """
    bit = series.least_bit
    if not bit or series.span < FEWEST_LEVELS * bit or bit < COARSE_STEP_BITS * series.noise:
        return None
    text = (
        f"has a least bit of {quantity_text(bit, series.unit)}, coarse against its noise: smaller "
        "motion is not recorded, and rounding errors are not white"
    )
    numbers = quantities(least_bit=(bit, series.unit)) | (
        quantities(noise=(series.noise, series.unit)) if series.noise else {}
    )
    return RecordFinding(series.name, Kind.RESOLUTION, Certainty.NOTED, text, "", (), numbers)


@dataclass(frozen=True)
class _NoisePart:
    """A part of a channel, with its roughness (robust fourth differences) and the possible causes.

    Attributes
    ----------
    level : standard deviation of the noise if it causes all of the roughness.
    white : whether second differences have the same level, as those of noise have.
    slow : whether the change between two samples is too small to cause the roughness.
    motion : rms change between two samples, without that of white noise of this level.
    input_roughness : roughness of each input.
    samples : number of samples that give the level.
    times : begin and end, s.
    """

    level: float
    white: bool
    slow: bool
    motion: float
    input_roughness: tuple[float, ...]
    samples: int
    times: tuple[float, float]


def noise_level_finding(
    series: Series, count: int, inputs: Sequence[Series] = (), others: Sequence[Series] = ()
) -> RecordFinding | None:
    """Return a finding if the noise in one part of a record of ``count`` rows is several times that
    in another. If the ratio exceeds ``LOUD_SAMPLE_RATIO``, the finding masks the noisy samples.

    Roughness by motion or inputs is no sensor noise. In a loud part, the motion must therefore be
    slow against the sampling, or no faster than in a quiet part; and the ratio of the noise levels
    is divided by that of the roughness of the ``inputs``. If ``others``, the remaining outputs, are
    rougher too, the air or the structure is the cause.
    """
    if not series.white or series.noise < COARSE_NOISE_BITS * series.least_bit:
        return None
    for parts in PARTS:
        result = _finding_between_parts(
            series, min(parts, len(series.values) // FEWEST_PART_SAMPLES), count, inputs, others
        )
        if result is not None:
            return result
    return None


def _parts(series: Series, parts: int, inputs: Sequence[Series]) -> list[_NoisePart]:
    """Return the parts of a channel that have enough samples."""
    second = scaled_differences(series.time, series.values)[1:-1]
    fourth = fourth_differences(series.time, series.values)
    noise_parts = []
    for rows in np.array_split(np.arange(len(fourth)), parts):
        finite = np.isfinite(fourth[rows])
        if np.count_nonzero(finite) < FEWEST_PART_SAMPLES // 2:
            continue
        level = max(
            robust_sigma_about_zero(fourth[rows][finite]),
            0.5 * series.least_bit,
            ROUNDING_SHARE * series.span,
        )
        if level > 0.0:
            white = robust_sigma_about_zero(second[rows][finite]) < MOTION_NOISE_RATIO * level
            begin, end = float(series.time[rows[0]]), float(series.time[rows[-1] + 4])
            steps, rough4 = np.diff(series.values[rows[0] : rows[-1] + 5]), fourth[rows][finite]
            power = float(np.mean(steps**2) - 2.0 * np.mean(rough4**2))
            slow = (
                power < float(np.mean(rough4**2))
                and robust_sigma_about_zero(steps) ** 2 < 3.0 * level**2
            )
            motion, samples = float(np.sqrt(max(power, 0.0))), int(np.count_nonzero(finite))
            rough = tuple(_roughness(other, begin, end) for other in inputs)
            noise_parts.append(_NoisePart(level, white, slow, motion, rough, samples, (begin, end)))
    return noise_parts


def _roughness(other: Series, begin: float, end: float) -> float:
    """Return the robust fourth differences of a channel between two times, at least half a step."""
    inside = (other.time >= begin) & (other.time <= end)
    if np.count_nonzero(inside) < FEWEST_PART_SAMPLES // 2:
        return 0.0
    fourth = fourth_differences(other.time[inside], other.values[inside])
    fourth = fourth[np.isfinite(fourth)]
    return max(robust_sigma_about_zero(fourth) if fourth.size else 0.0, 0.5 * other.least_bit)


def _ratio_beyond_inputs(quiet: _NoisePart, loud: _NoisePart) -> float:
    """Return the ratio of two noise levels over that of the inputs; zero if motion explains it."""
    if not loud.slow and quiet.motion < loud.motion:
        return 0.0
    input_ratio = 1.0
    for before, after in zip(quiet.input_roughness, loud.input_roughness, strict=True):
        if after > before:
            input_ratio = max(input_ratio, after / before if before > 0.0 else np.inf)
    return loud.level / quiet.level / input_ratio


def _others_rougher(quiet: _NoisePart, loud: _NoisePart, others: Sequence[Series]) -> bool:
    """Return whether another output is significantly rougher as well."""
    scatter = LOG_SCATTER * np.sqrt(1.0 / quiet.samples + 1.0 / loud.samples)
    least = max(NOTABLE_NOISE_RATIO, float(np.exp(UNEVEN_SIGMAS * scatter)))
    return any(
        _roughness(other, *loud.times) > least * _roughness(other, *quiet.times) > 0.0
        for other in others
    )


def _is_significant(quiet: _NoisePart, loud: _NoisePart) -> bool:
    """Return whether the noise of one part is significantly larger than that of another."""
    ratio = _ratio_beyond_inputs(quiet, loud)
    scatter = LOG_SCATTER * np.sqrt(1.0 / quiet.samples + 1.0 / loud.samples)
    return bool(ratio >= NOTABLE_NOISE_RATIO and np.log(ratio) >= UNEVEN_SIGMAS * scatter)


def _finding_between_parts(
    series: Series, parts: int, count: int, inputs: Sequence[Series], others: Sequence[Series]
) -> RecordFinding | None:
    """Return the finding for a record in ``parts`` equal parts, or None."""
    if parts < 3:
        return None
    all_parts = _parts(series, parts, inputs)
    white_parts = [part for part in all_parts if part.white]
    pairs = [
        (quiet, loud)
        for quiet in white_parts
        for loud in white_parts
        if loud.level > quiet.level
        and _is_significant(quiet, loud)
        and not _others_rougher(quiet, loud, others)
    ]
    if len(white_parts) < 3 or not pairs:
        return None
    low, high = max(pairs, key=lambda pair: pair[1].level / pair[0].level)
    text = "has noise that changes along the record: "
    text += ", ".join(
        f"{quantity_text(part.level, series.unit)} from {time_span(*part.times, 4)}"
        for part in (low, high)
    )
    numbers = quantities(least=(low.level, series.unit), greatest=(high.level, series.unit))
    mask = np.zeros(count, dtype=bool)
    between = float(np.sqrt(low.level * high.level))
    above = [loud.level for _, loud in pairs if loud.level > between]
    below = [part.level for part in white_parts if part.level <= between]
    if np.median(above) > LOUD_SAMPLE_RATIO * np.median(below):
        loud = _loud_samples(
            fourth_differences(series.time, series.values), between, len(series.values)
        )
        moving = [
            part
            for part in all_parts
            if part.level > between and not any(part is loud_part for _, loud_part in pairs)
        ]
        mask[series.rows[loud & ~_in_parts(series.time, moving)]] = True
    remedy = (
        "one mean noise level is fitted to the whole record; cut out the noisy part if it is a "
        "fault"
    )
    finding = RecordFinding(
        series.name, Kind.NOISE_LEVEL, Certainty.LIKELY, text, remedy, (high.times,), numbers
    )
    if 0.0 < np.count_nonzero(mask) < LARGEST_MASKED_SHARE * len(series.values):
        return replace(finding, certainty=Certainty.COSTS_INFORMATION, remedy="", mask=mask)
    return finding


def _in_parts(time: np.ndarray, parts: Sequence[_NoisePart]) -> np.ndarray:
    """Return a mask ``(N,)``, True where a time of ``time (N,)`` is in one of the parts."""
    inside = np.zeros(len(time), dtype=bool)
    for part in parts:
        inside |= (time >= part.times[0]) & (time <= part.times[1])
    return inside


def _loud_samples(fourth: np.ndarray, above: float, count: int) -> np.ndarray:
    """Return a mask ``(count,)`` where the noise in a short window exceeds the level ``above``."""
    finite = np.isfinite(fourth)
    padded = np.pad(np.where(finite, np.abs(fourth), np.nan), LOCAL_LEVEL_SAMPLES, mode="reflect")
    local = SIGMA_PER_MEDIAN_DEVIATION * np.nanmedian(
        np.lib.stride_tricks.sliding_window_view(padded, 2 * LOCAL_LEVEL_SAMPLES + 1), axis=1
    )
    loud = np.zeros(count, dtype=bool)
    loud[2 : len(local) + 2] = local > above
    return loud
