"""One sampled channel: valid samples, resolution, noise; and the findings of the record check."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
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


@dataclass(frozen=True, eq=False)
class RecordFinding:
    """A finding in the raw columns.

    Attributes
    ----------
    channel : the channel's name, several joined by " and ", or ``"time"``.
    sentence : the finding, without its subject, the channel.
    remedy : advice to the user; may be empty.
    times : begin and end, s, of each place; empty for the whole record.
    mask : shape ``(N,)`` of the record's rows, True at samples of ``channel`` that carry no
        information; of length zero where none are named.
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
    """Values that a record is compared with, None if unknown.

    Attributes
    ----------
    airspeed : m/s.
    gravity : m/s2.
    control_power : rad/s2 per unit of the control, the pitch acceleration that the first input
        makes, with its sign.
    angular_control : the first input is an angle, so that ``control_power`` tells radians from
        degrees.
    scale_height : m, of the air's density, of a body that falls through it; its height then obeys
        gravity and drag.
    aircraft : channels named alpha, q, nz and so on are those of an aircraft, whose motion ties
        them together.
    """

    airspeed: float | None = None
    gravity: float = 9.80665
    control_power: float | None = None
    angular_control: bool = False
    aircraft: bool = True
    scale_height: float | None = None


def shown(value: float, unit: str) -> str:
    """Return a value in the unit in which people read it: angles in degrees."""
    factor, label = (
        (180.0 / math.pi, unit.replace("rad", "deg", 1)) if unit.startswith("rad") else (1.0, unit)
    )
    return f"{factor * value:.3g}{'' if label in ('', '1') else f' {label}'}"


# ---- One channel as it was sampled

FEWEST_SAMPLES = 20  # fewest samples of a channel that is judged
# largest distance of a value from its grid, in least bits: rounding of a conversion is far less
GRID_TOLERANCE = 0.02
# largest ratio of the noise by second and by fourth differences that is white: 1 for white noise,
# 10 and more for motion
LARGEST_WHITE_RATIO = 1.5
RESOLVED_BITS = 0.7
# largest distance of nine tenths of the differences from multiples of a converter's step; by chance
# a fifth of them
MULTIPLE_TOLERANCE = 0.1
# smallest share of the differences >= 0, and of those <= 0, in a signal that shows its converter's
# step
LEAST_SIGN_SHARE = 0.05
# largest differences compared, in steps of the converter: a drifting calibration shifts larger ones
MOST_LATTICE_STEPS = 3.5
# Scatter about multiples of the step after a varying correction (alpha at the c.g., airspeed from
# pressures): by chance two fifths lie within it, in ATTAS records 0.7 to 0.97.
STEP_SCATTER_SHARE = 0.2  # share of the quantisation step
STEP_DIFFERENCE_SHARE = 0.65  # smallest share of the differences within that scatter
LARGEST_OTHER_SHARE = 0.9  # largest share of other differences
FEWEST_DIFFERENCES = 100
# smallest share of the differences that change sign: hardly any do in a motion without noise
LEAST_TURN_SHARE = 0.2
# largest printed digit, over the usual difference, that does not hide a converter
LARGEST_DIGIT_SHARE = 0.05
# smallest step of a converter, as a share of the channel's span (twenty bits)
FINEST_STEP_SHARE = 1e-6
ROUNDING_SHARE = 1e-9  # largest rounding, as a share of the channel's span


@dataclass(frozen=True, eq=False)
class Series:
    """The valid samples of a channel.

    Attributes
    ----------
    time, values : shape ``(n,)``, s and the channel's unit.
    rows : their rows in the record.
    least_bit : step of the grid on which all values lie; 0 without a grid.
    noise : standard deviation of what changes from sample to sample without a motion, by fourth
        differences; robust.
    white : whether second differences give the same noise, so that it is noise indeed and not fast
        motion.
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
        """Whether the noise exceeds the least bit. Rounding makes noise of a third of a bit look
        like 0.6.
        """
        return self.white and self.noise > RESOLVED_BITS * self.least_bit

    @property
    def span(self) -> float:
        return float(np.ptp(self.values)) if self.values.size else 0.0


def series_of(record: Record, channel: Channel) -> Series:
    """Return the valid samples of a channel, with its resolution and noise."""
    rows = np.flatnonzero(channel.valid)
    time, values = record.time[rows], channel.values[rows]
    noise, white = _noise(time, values)
    return Series(channel.name, channel.unit, time, values, rows, least_bit(values), noise, white)


def least_bit(values: np.ndarray) -> float:
    """Return the step of the converter; 0 where the values show none.

    It is the largest common divisor of all differences between values (Euclid's algorithm on
    floats), or a coarser one of the differences of neighbouring samples: calibrations and printed
    digits shift the levels a little.
    """
    exact = exact_step(values)
    return max(exact, _converter_step(values, exact))


def measurable_noise(level: float | None, values: Sequence[np.ndarray]) -> float | None:
    """Return the estimate of a channel's noise, raised to the rounding of its converter,
    step/sqrt(12); None if the samples show no noise.

    ``level``: the estimate, None where there is none. ``values``: the channel's valid samples in
    each record. An estimate below a millionth of the span, without a converter's step, belongs to a
    computed or smoothed channel or to an estimator at its limit.
    """
    if level is None:
        return None
    rounding = max((least_bit(each) for each in values if each.size), default=0.0) / math.sqrt(12.0)
    span = max((float(np.ptp(each)) for each in values if each.size), default=0.0)
    return None if max(level, rounding) <= FINEST_STEP_SHARE * span else max(level, rounding)


def exact_step(values: np.ndarray) -> float:
    """Return the largest step of which all differences between values are multiples: of a
    converter, or of the digits that were printed.
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
        off = np.abs(steps - bit * np.round(steps / bit))
        off = off[off > GRID_TOLERANCE * bit + rounding]
        if not off.size:
            return bit
        bit = float(np.min(off))
    return 0.0


def _converter_step(values: np.ndarray, exact: float) -> float:
    """Return the step of which small differences of neighbouring samples are multiples within a
    tenth of it; 0 where there is none.
    """
    differences = np.diff(values)
    sizes = np.abs(differences)
    if (
        sizes.size < FEWEST_SAMPLES
        or min(np.mean(differences >= 0.0), np.mean(differences <= 0.0)) < LEAST_SIGN_SHARE
    ):
        # a monotonic signal has steps of its rate, not of a converter
        return 0.0
    least = max(3.0 * exact, ROUNDING_SHARE * float(np.ptp(values)))
    moving = np.sort(sizes[sizes > least])
    if moving.size < FEWEST_SAMPLES:
        return 0.0
    starts = np.quantile(moving, (0.02, 0.1, 0.2, 0.3, 0.4, 0.5))
    result = max(_lattice_step(sizes, start) for start in starts.tolist())
    turning = float(np.mean(differences[1:] * differences[:-1] < 0.0))
    return result or (
        _blurred_step(moving)
        if exact < LARGEST_DIGIT_SHARE * float(np.median(moving)) and turning > LEAST_TURN_SHARE
        else 0.0
    )


def _lattice_step(sizes: np.ndarray, step: float) -> float:
    """Return the step near a first guess of which nine tenths of the small sizes are multiples; 0
    without one.
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
    """Return the step of which most sizes are multiples, up to the scatter of a later correction; 0
    without one.

    ``moving``: sizes of differences, zeros left out. The median size is at most three steps, and at
    least two different multiples occur (a triangle has one).
    """
    usual = float(np.median(moving))
    best, result = STEP_DIFFERENCE_SHARE, 0.0
    for step in np.geomspace(usual / MOST_LATTICE_STEPS, 2.0 * usual, 100).tolist():
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
    """Return each sample minus the line between its neighbours, scaled to the noise of one sample;
    NaN across gaps; ``(n - 2,)``.
    """
    before, after = np.diff(time)[:-1], np.diff(time)[1:]
    share = before / (before + after)
    off = values[1:-1] - (1.0 - share) * values[:-2] - share * values[2:]
    usual = float(np.median(np.diff(time)))
    near = np.maximum(before, after) < 3.0 * usual
    return np.where(near, off / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2), np.nan)


def fourth_differences(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the differences of the second differences, scaled to the noise of one sample where
    sampling is even; ``(n - 4,)``.
    """
    second = scaled_differences(time, values) * np.sqrt(1.5)
    return (second[1:-1] - 0.5 * (second[:-2] + second[2:])) * np.sqrt(16.0 / 70.0)


def _noise(time: np.ndarray, values: np.ndarray) -> tuple[float, bool]:
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

# least bit over noise: below it rounding adds at most a twelfth to the noise's variance
COARSE_STEP_BITS = 1.0
FEWEST_LEVELS = 4  # fewest levels of a measurement
PARTS = (8, 4)
COARSE_NOISE_BITS = 2.0  # noise in least bits below which its median takes few values
FEWEST_PART_SAMPLES = 30  # fewest samples of a part
NOTABLE_NOISE_RATIO = 2.0  # smallest ratio of noise levels worth a note: weights are wrong by four
# Standard deviation of the logarithm of a robust sigma of n fourth differences, times sqrt(n): 1.58
# by simulation (1.17 if they were independent).
LOG_SCATTER = 1.6
# smallest difference between the quietest and loudest of eight parts, in standard deviations: by
# chance once in 5000 channels
UNEVEN_SIGMAS = 4.5
# noise ratio from which samples are named: they have a sixteenth of the information and the same
# weight
LOUD_SAMPLE_RATIO = 4.0
LOCAL_LEVEL_SAMPLES = 25  # samples on either side for a local noise level
LARGEST_MASKED_SHARE = (
    0.5  # largest masked share of a channel: beyond it the loud part is the normal one
)
# smallest ratio of the noise by second and fourth differences that shows motion
MOTION_NOISE_RATIO = 1.4


def coarse(series: Series) -> RecordFinding | None:
    """Return a note if the least bit is coarse against the noise: residuals are then rounding, not
    Gaussian.
    """
    bit = series.least_bit
    if not bit or series.span < FEWEST_LEVELS * bit or bit < COARSE_STEP_BITS * series.noise:
        return None
    text = (
        f"has a least bit of {shown(bit, series.unit)}, coarse against its noise: smaller things "
        "are not in the record, and rounding is not white"
    )
    numbers = {"least_bit": FindingQuantity(bit, series.unit)} | (
        {"noise": FindingQuantity(series.noise, series.unit)} if series.noise else {}
    )
    return RecordFinding(series.name, Kind.RESOLUTION, Certainty.NOTED, text, "", (), numbers)


@dataclass(frozen=True)
class _NoisePart:
    """A part of a channel: the standard deviation of its noise, were all roughness noise, and what
    else may have made that.

    Attributes
    ----------
    slow : the motion between two samples is less than the roughness, in the mean square and
        robustly, so that it cannot have made it.
    motion : root mean square of the change from sample to sample, beyond that of white noise as
        rough.
    rough : by input its own noise level or roughness.
    samples : how many the level is taken from.
    times : begin and end, s.
    white : whether second and fourth differences show the same level, as those of noise do.
    """

    level: float
    white: bool
    slow: bool
    motion: float
    rough: tuple[float, ...]
    samples: int
    times: tuple[float, float]


def changing_noise(
    series: Series, count: int, inputs: Sequence[Series] = (), others: Sequence[Series] = ()
) -> RecordFinding | None:
    """Return a finding if the noise in one part of a record of ``count`` rows is several times that
    in another; from ``LOUD_SAMPLE_RATIO`` on its samples are named.

    Roughness from motion or inputs is not sensor noise. A loud part counts if the motion is slow
    against the sampling, or equal to that of a quiet part; the ratio is reduced by that of the
    ``inputs``. If ``others``, the remaining outputs, are rougher too, the cause is the air or the
    structure.
    """
    if not series.white or series.noise < COARSE_NOISE_BITS * series.least_bit:
        return None
    for parts in PARTS:
        result = _between_parts(
            series, min(parts, len(series.values) // FEWEST_PART_SAMPLES), count, (inputs, others)
        )
        if result is not None:
            return result
    return None


def _parts(series: Series, parts: int, inputs: Sequence[Series]) -> list[_NoisePart]:
    """Return the parts of a channel that have enough samples."""
    second = scaled_differences(series.time, series.values)[1:-1]
    fourth = fourth_differences(series.time, series.values)
    out = []
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
            rough = tuple(_roughness(other, begin, end) for other in inputs)
            out.append(
                _NoisePart(
                    level,
                    white,
                    slow,
                    float(np.sqrt(max(power, 0.0))),
                    rough,
                    int(np.count_nonzero(finite)),
                    (begin, end),
                )
            )
    return out


def _roughness(other: Series, begin: float, end: float) -> float:
    """Return the size of the fourth differences of a channel between two times, half a step of its
    converter at least.
    """
    inside = (other.time >= begin) & (other.time <= end)
    if np.count_nonzero(inside) < FEWEST_PART_SAMPLES // 2:
        return 0.0
    fourth = fourth_differences(other.time[inside], other.values[inside])
    fourth = fourth[np.isfinite(fourth)]
    return max(robust_sigma_about_zero(fourth) if fourth.size else 0.0, 0.5 * other.least_bit)


def _ratio_beyond_inputs(quiet: _NoisePart, loud: _NoisePart) -> float:
    """Return the ratio of two noise levels divided by that of an input; zero if the motion explains
    it.
    """
    if not loud.slow and quiet.motion < loud.motion:
        return 0.0
    more = 1.0
    for before, after in zip(quiet.rough, loud.rough, strict=True):
        if after > before:
            more = max(more, after / before if before > 0.0 else np.inf)
    return loud.level / quiet.level / more


def _others_rougher(quiet: _NoisePart, loud: _NoisePart, others: Sequence[Series]) -> bool:
    """Return whether another output is significantly rougher as well."""
    least = max(
        NOTABLE_NOISE_RATIO,
        float(
            np.exp(UNEVEN_SIGMAS * LOG_SCATTER * np.sqrt(1.0 / quiet.samples + 1.0 / loud.samples))
        ),
    )
    return any(
        _roughness(other, *loud.times) > least * _roughness(other, *quiet.times) > 0.0
        for other in others
    )


def _is_significant(quiet: _NoisePart, loud: _NoisePart) -> bool:
    """Return whether the noise of one part is significantly larger than that of another."""
    ratio = _ratio_beyond_inputs(quiet, loud)
    scatter = LOG_SCATTER * np.sqrt(1.0 / quiet.samples + 1.0 / loud.samples)
    return bool(ratio >= NOTABLE_NOISE_RATIO and np.log(ratio) >= UNEVEN_SIGMAS * scatter)


def _between_parts(
    series: Series, parts: int, count: int, beside: tuple[Sequence[Series], Sequence[Series]]
) -> RecordFinding | None:
    if parts < 3:
        return None
    inputs, others = beside
    every = _parts(series, parts, inputs)
    result = [one for one in every if one.white]
    pairs = [
        (quiet, loud)
        for quiet in result
        for loud in result
        if loud.level > quiet.level
        and _is_significant(quiet, loud)
        and not _others_rougher(quiet, loud, others)
    ]
    if len(result) < 3 or not pairs:
        return None
    low, high = max(pairs, key=lambda pair: pair[1].level / pair[0].level)
    text = "has noise that changes along the record: "
    text += ", ".join(
        f"{shown(one.level, series.unit)} from {time_span(one.times[0], one.times[1], 4)}"
        for one in (low, high)
    )
    numbers = {
        "least": FindingQuantity(low.level, series.unit),
        "greatest": FindingQuantity(high.level, series.unit),
    }
    mask = np.zeros(count, dtype=bool)
    between = float(np.sqrt(low.level * high.level))
    above = [loud.level for _, loud in pairs if loud.level > between]
    below = [one.level for one in result if one.level <= between]
    if np.median(above) > LOUD_SAMPLE_RATIO * np.median(below):
        loud = _loud_samples(
            fourth_differences(series.time, series.values), between, len(series.values)
        )
        moved = [
            one
            for one in every
            if one.level > between and not any(one is other for _, other in pairs)
        ]
        mask[series.rows[loud & ~_in_parts(series.time, moved)]] = True
    if 0.0 < np.count_nonzero(mask) < LARGEST_MASKED_SHARE * len(series.values):
        return RecordFinding(
            series.name,
            Kind.NOISE_LEVEL,
            Certainty.COSTS_INFORMATION,
            text,
            "",
            (high.times,),
            numbers,
            mask,
        )
    remedy = (
        "one noise level is fitted to the whole record: sigmas are a mean; cut out the noisy part "
        "if it is a fault"
    )
    return RecordFinding(
        series.name, Kind.NOISE_LEVEL, Certainty.LIKELY, text, remedy, (high.times,), numbers
    )


def _in_parts(time: np.ndarray, parts: Sequence[_NoisePart]) -> np.ndarray:
    """Return whether times lie in one of the parts."""
    inside = np.zeros(len(time), dtype=bool)
    for one in parts:
        inside |= (time >= one.times[0]) & (time <= one.times[1])
    return inside


def _loud_samples(fourth: np.ndarray, above: float, count: int) -> np.ndarray:
    """Return the samples, of ``count``, at which the noise over a short window is above a level."""
    finite = np.isfinite(fourth)
    padded = np.pad(np.where(finite, np.abs(fourth), np.nan), LOCAL_LEVEL_SAMPLES, mode="reflect")
    local = SIGMA_PER_MEDIAN_DEVIATION * np.nanmedian(
        np.lib.stride_tricks.sliding_window_view(padded, 2 * LOCAL_LEVEL_SAMPLES + 1), axis=1
    )
    loud = np.zeros(count, dtype=bool)
    loud[2 : len(local) + 2] = local > above
    return loud
