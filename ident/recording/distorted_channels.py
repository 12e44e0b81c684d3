"""Distorted channels: flat extremes, steps of the zero, hum, filtered channels.

Steps: two straight lines, through the samples before and after each row, are extrapolated to the
row. A level, a slope and a curvature cancel in their difference. The part of the difference that
inputs and other channels explain, by least squares, is subtracted.

White noise of a sensor fills the spectrum up to half the sample rate, and a converter's rounding
does so behind any filter. A spectrum that is flat up to a cutoff and empty above it was filtered.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import fdtri, gammainc

from ident.recording.series import (
    Certainty,
    FindingQuantity,
    Kind,
    RecordFinding,
    Series,
    runs_of,
    shown,
)
from ident.statistics.noise_levels import robust_sigma_about_zero
from sim.errors import instant

# ---- Flat extremes

FEWEST_AT_LEVEL = 4  # fewest samples at the level
FEWEST_IN_A_ROW = 3
CHANCE_OF_PILE = 1e-6
CORNER_BENDS = 6.0  # smallest slope at a corner, over the usual second difference or the noise
CORNER_BITS = 3.0
# distance of a level from the median, in sigmas of the noise: nearer extremes are noise
CUT_MOTION_SIGMAS = 6.0
# smallest share of changing samples of an input: commanded square waves change less often
CONTINUOUS_INPUT_SHARE = 0.3


def clipped(series: Series, count: int, *, is_input: bool = False) -> list[RecordFinding]:
    """Find levels at which a channel is flat, and mask these samples. An input may rest at its
    stop: its flat levels are reported, not masked.
    """
    if is_input and np.mean(np.diff(series.values) != 0.0) < CONTINUOUS_INPUT_SHARE:
        return []
    out = []
    for sign in (1.0, -1.0):
        values = sign * series.values
        level = float(np.max(values))
        at_level = values == level
        runs = runs_of(at_level)
        # A run at either end of the record may be trimmed flight.
        inside = [(b, e) for b, e in runs if b > 0 and e < len(values)]
        if (
            np.count_nonzero(at_level) < FEWEST_AT_LEVEL
            or not inside
            or max(e - b for b, e in inside) < FEWEST_IN_A_ROW
        ):
            continue
        if _piles_up(series, values, level, at_level) or any(
            _has_corners(series, values, b, e) for b, e in inside
        ):
            out.append(
                _clipping_finding(
                    series,
                    at_level,
                    sign * level,
                    "highest" if sign > 0 else "lowest",
                    count,
                    is_input=is_input,
                )
            )
    return out


def _piles_up(series: Series, values: np.ndarray, level: float, at_level: np.ndarray) -> bool:
    """Return whether more samples are at the level than noise explains."""
    if not series.resolved or level - float(np.median(values)) < CUT_MOTION_SIGMAS * series.noise:
        return False
    width = max(series.least_bit, 0.25 * series.noise)
    below = np.count_nonzero((values < level) & (values >= level - 3.5 * width))
    per_level = below / 3.0 * (min(1.0, series.least_bit / width) if series.least_bit else 1e-6)
    # Poisson probability of at least as many samples at the level.
    return bool(gammainc(np.count_nonzero(at_level), 2.0 * per_level + 0.5) < CHANCE_OF_PILE)


def _has_corners(series: Series, values: np.ndarray, begin: int, end: int) -> bool:
    """Return whether a moving signal meets the level at a corner on both sides."""
    if end - begin < FEWEST_IN_A_ROW or begin < 3 or end + 3 > len(values):
        return False
    around = np.concatenate([values[max(0, begin - 8) : begin], values[end : end + 8]])
    before, behind = values[max(0, begin - 8) : begin], values[end : end + 8]
    bends = np.concatenate([np.abs(np.diff(before, 2)), np.abs(np.diff(behind, 2))])
    usual = float(np.median(bends)) if bends.size else math.inf
    # Clipping shortens the first difference beside the level; the next one outwards is complete.
    slopes = (
        abs(float(values[begin - 1] - values[begin - 2])),
        abs(float(values[end + 1] - values[end])),
    )
    return len(around) > 8 and min(slopes) > max(
        CORNER_BENDS * usual, CORNER_BITS * series.least_bit, CORNER_BENDS * series.noise
    )


def _clipping_finding(
    series: Series, at_level: np.ndarray, level: float, word: str, count: int, *, is_input: bool
) -> RecordFinding:
    runs = runs_of(at_level)
    times = tuple((float(series.time[b]), float(series.time[e - 1])) for b, e in runs if e - b > 1)
    numbers = {"level": FindingQuantity(level, series.unit)}
    text = (
        f"flat at its {word} value, {shown(level, series.unit)}, for "
        f"{int(np.count_nonzero(at_level))} samples"
    )
    if is_input:
        sentence = f"is {text}: at its stop, or clipped by the recorder"
        return RecordFinding(
            series.name,
            Kind.CLIPPED,
            Certainty.NOTED,
            sentence,
            "say which, if you know: a stop is felt by the vehicle",
            times,
            numbers,
        )
    mask = np.zeros(count, dtype=bool)
    mask[series.rows[at_level]] = True
    remedy = "widen the channel's range, or fly a smaller maneuver"
    return RecordFinding(
        series.name,
        Kind.CLIPPED,
        Certainty.COSTS_INFORMATION,
        f"is clipped: {text}",
        remedy,
        times,
        numbers,
        mask,
    )


# ---- Zero steps: a channel jumps within one sample and keeps the offset

LINE_TIME = 0.25  # s, length of each line: a quarter period of a fast short period
FEWEST_LINE_SAMPLES = 5  # fewest samples of a straight line
MOST_LINE_SAMPLES = 25  # most samples of a straight line
STEP_SIGMAS = 8.0  # Smallest step, sigmas: 3000 Gaussian rows reach 4.5, curved motion more.
STEP_TO_SURROUNDINGS_RATIO = 3.0  # smallest step over the largest jump within SURROUNDINGS_TIME
SURROUNDINGS_TIME = 1.0  # s
OTHER_JUMP_SIGMAS = 4.0  # largest jump of another channel at that row, in standard deviations
INPUT_STEP_SHARE = 0.05  # smallest step of an input, as a share of its span
# smallest distance to an input's step, in line lengths: its effect is removed to first order only
INPUT_DISTANCE = 0.6
# largest opposite jump within two windows, as a share: side lobes are 0.35, a pulse has 1
OPPOSITE_JUMP_RATIO = 0.7
CORNER_SIGMAS = 4.0
CORNER_TIME = 0.8  # s, on either side of a jump of nz
MOST_JUMPS = 3  # most jumps reported of one channel


def zero_steps(
    series: Sequence[Series],
    inputs: Sequence[Series],
    masked: Mapping[str, np.ndarray],
    gravity_over_speed: float | None = None,
) -> list[RecordFinding]:
    """Find steps of single channels; each is a warning.

    ``masked``: rows by channel that are masked already. ``gravity_over_speed`` in 1/s: a step of nz
    counts as a load if alpha changes as the load requires.
    """
    if not series or len(series[0].values) < 4 * FEWEST_LINE_SAMPLES:
        return []
    step = float(np.median(np.diff(series[0].time)))
    length = int(np.clip(round(LINE_TIME / step), FEWEST_LINE_SAMPLES, MOST_LINE_SAMPLES))
    rows = np.unique(np.concatenate([each.rows for each in series]))
    if len(rows) < 6 * length:
        return []
    values = {
        each.name: _resampled(each, rows, masked.get(each.name)) for each in (*series, *inputs)
    }
    jumps = {name: _jumps(column, length) for name, column in values.items()}
    # A control step is a kink of the pitch rate: the input's running sum explains it.
    input_sums = [
        _jumps(np.cumsum(values[each.name] - np.mean(values[each.name])), length) for each in inputs
    ]
    noise_gain = float(np.sqrt(2.0 * np.sum(_weights(length) ** 2)))
    quiet = {
        each.name: max(noise_gain * each.noise + each.least_bit, _robust_std(jumps[each.name]))
        for each in series
    }
    still = _quiet_rows(
        [values[each.name] for each in inputs], len(rows), round(INPUT_DISTANCE * length)
    )
    out = []
    for each in series:
        residual = _unexplained_jumps(
            jumps[each.name], [*(jumps[name] for name in jumps if name != each.name), *input_sums]
        )
        for peak in _step_rows(
            residual,
            noise_gain * each.noise + each.least_bit,
            length,
            round(min(SURROUNDINGS_TIME / step, len(residual))),
        ):
            near = slice(max(0, peak - 2), peak + 3)
            calm = all(
                np.max(np.abs(jumps[other.name][near])) < OTHER_JUMP_SIGMAS * quiet[other.name]
                for other in series
                if other is not each
            )
            if each.name == "nz" and _is_load(
                series, values, rows[peak + length], float(residual[peak]), gravity_over_speed
            ):
                continue
            if (
                calm
                and still[peak + length]
                and not _touches(masked.get(each.name), rows[peak : peak + 2 * length])
            ):
                out.append(_zero_steps_finding(each, rows[peak + length], float(residual[peak])))
    return out


def _is_load(
    series: Sequence[Series],
    values: Mapping[str, np.ndarray],
    row: int,
    size: float,
    gravity_over_speed: float | None,
) -> bool:
    """Return whether a step of nz is a real load: alpha - int (q - (g/V) nz) dt is then a straight
    line.

    A sensor fault would show a corner of at least ``CORNER_SIGMAS`` standard deviations.
    """
    known = {each.name: each for each in series}
    time = known["nz"].time
    if (
        gravity_over_speed is None
        or not {"alpha", "q"} <= set(known)
        or len(time) != len(values["nz"])
    ):
        return False
    step_time = time[np.searchsorted(known["nz"].rows, row)]
    near = np.abs(time - step_time) < CORNER_TIME
    t = time[near] - step_time
    rate = (values["q"] - gravity_over_speed * (values["nz"] - np.mean(values["nz"])))[near]
    path = values["alpha"][near] - np.concatenate(
        [[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))]
    )
    matrix = np.stack([np.ones(len(t)), t, np.maximum(t, 0.0)])
    inverse = np.linalg.pinv(matrix @ matrix.T)
    corner = float((inverse @ (matrix @ path))[2])
    std = known["alpha"].noise * float(np.sqrt(inverse[2, 2]))
    expected = abs(gravity_over_speed * size)
    return expected > CORNER_SIGMAS * std and abs(corner) < 0.5 * expected


def _quiet_rows(inputs: Sequence[np.ndarray], count: int, spacing: int) -> np.ndarray:
    """Return the rows at which no input steps within ``spacing`` rows."""
    steps = np.zeros(count)
    for values in inputs:
        steps[1:-1] += np.abs(np.diff(values, 2)) > INPUT_STEP_SHARE * float(np.ptp(values))
    return np.asarray(np.convolve(steps, np.ones(2 * spacing + 3), mode="same") < 0.5)


def _zero_steps_finding(series: Series, row: int, size: float) -> RecordFinding:
    time = float(series.time[min(int(np.searchsorted(series.rows, row)), len(series.time) - 1)])
    load = ", or a load did that nothing recorded" if series.name in ("nz", "az") else ""
    text = (
        f"jumps by {shown(size, series.unit)} at {instant(time)} s and stays, while no input and "
        f"no other channel jumps: its zero stepped{load}"
    )
    numbers = {"time": FindingQuantity(time, "s"), "step": FindingQuantity(size, series.unit)}
    remedy = "give the parts before and after as segments, --from and --to in pairs"
    return RecordFinding(
        series.name, Kind.ZERO_STEP, Certainty.LIKELY, text, remedy, ((time, time),), numbers
    )


def _resampled(series: Series, rows: np.ndarray, masked: np.ndarray | None) -> np.ndarray:
    """Return a channel on common rows: gaps interpolated, single wrong samples removed by a median
    of three.
    """
    good = np.ones(len(series.rows), dtype=bool) if masked is None else ~masked[series.rows]
    if np.count_nonzero(good) < 2:
        return np.zeros(len(rows))
    values = np.interp(rows, series.rows[good], series.values[good])
    return np.concatenate(
        [
            values[:1],
            np.median(np.stack([values[:-2], values[1:-1], values[2:]]), axis=0),
            values[-1:],
        ]
    )


def _weights(length: int) -> np.ndarray:
    """Return the weights of samples at 0.5, 1.5, ... that give the value at 0 of their regression
    line.
    """
    position = np.arange(length) + 0.5
    matrix = np.stack([np.ones(length), position])
    return np.asarray(np.linalg.solve(matrix @ matrix.T, matrix)[0])


def _jumps(values: np.ndarray, length: int) -> np.ndarray:
    """Return the line after each row minus the line before it, each fitted to ``length`` rows."""
    weights = _weights(length)
    kernel = np.concatenate([-weights[::-1], weights])
    return np.asarray(np.correlate(values, kernel, mode="valid"))


def _unexplained_jumps(jump: np.ndarray, others: Sequence[np.ndarray]) -> np.ndarray:
    """Return the jumps less what other channels' jumps explain (least squares without the
    largest).
    """
    moving = [other for other in others if np.any(other)]
    if not moving:
        return jump
    rows = np.stack(moving).T
    keep = np.ones(len(jump), dtype=bool)
    residual = jump
    for _ in range(2):
        coefficients = np.linalg.lstsq(rows[keep], jump[keep], rcond=None)[0]
        residual = jump - rows @ coefficients
        keep = np.abs(residual) < 4.0 * _robust_std(residual)
        if np.count_nonzero(keep) < 4 * rows.shape[1]:
            break
    return np.asarray(residual)


def _robust_std(jump: np.ndarray) -> float:
    """Return the robust standard deviation of the jumps, above zero."""
    return max(robust_sigma_about_zero(jump), 1e-300)


def _step_rows(residual: np.ndarray, noise: float, length: int, around: int) -> list[int]:
    """Return the rows of jumps above noise and surroundings, without an opposite jump near."""
    size = np.abs(residual)
    out: list[int] = []
    least = STEP_SIGMAS * max(_robust_std(residual), noise)
    taken = np.zeros(len(residual), dtype=bool)
    for at in np.argsort(size)[::-1][: 20 * MOST_JUMPS]:
        if size[at] < least or len(out) > MOST_JUMPS:
            break
        if taken[at]:
            continue
        taken[max(0, at - 2 * length) : at + 2 * length + 1] = True
        near = slice(max(0, at - 2 * length), at + 2 * length + 1)
        opposite = float(np.max(-np.sign(residual[at]) * residual[near]))
        away = np.concatenate(
            [
                size[max(0, at - around - length) : max(0, at - length)],
                size[at + length + 1 : at + length + around + 1],
            ]
        )
        if opposite < OPPOSITE_JUMP_RATIO * size[at] and (
            not away.size or size[at] > STEP_TO_SURROUNDINGS_RATIO * float(np.max(away))
        ):
            out.append(int(at))
    return out if len(out) <= MOST_JUMPS else []


def _touches(masked: np.ndarray | None, rows: np.ndarray) -> bool:
    return masked is not None and bool(np.any(masked[rows]))


# ---- Hum

LOWEST_HUM = 4.0  # Hz: short periods and first elastic modes of piloted aircraft lie below
EVEN_TOLERANCE = 0.02  # largest deviation of an evenly sampled step, as a share
FEWEST_HUM_SAMPLES = 128
MOST_SAMPLES = 20_000  # most samples that are used
FLOOR_BINS = 24  # frequencies on either side of a line whose median is the noise floor
LINE_BINS = 3  # frequencies on either side that belong to a line
# The power of noise is exponential: threshold ln(frequencies/chance) times FLOOR_SCATTER_FACTOR.
HUM_CHANCE = 1e-5  # probability of a false line
FLOOR_SCATTER_FACTOR = 1.35
FEWEST_PARTS = 6  # parts of a record in which the amplitude of a line is compared
MOST_PARTS = 16  # parts for a strong line, so that ringing after steps is recognised
INFORMATION_PER_PART = 80.0  # N (amplitude/noise)^2 that gives an amplitude to one seventh
# smallest power of the mean amplitude over the mean power: 1 for a constant phase, 1/6 for noise
LEAST_COHERENT_SHARE = 0.85
# largest ratio of the amplitudes of 16 parts: noise gives 1.8 in one of a hundred hums
LARGEST_AMPLITUDE_RATIO = 2.5
HUM_TO_NOISE = 0.3  # smallest amplitude over the noise: a smaller one changes no estimate
# smallest amplitude over the least bit: rounding of a periodic motion makes smaller lines
HUM_TO_BIT = 0.5
# smallest amplitude of the same line in an input, as a share of its span: the output may respond to
# it
INPUT_LINE_SHARE = 1e-4


def hum(series: Series, inputs: Sequence[Series]) -> RecordFinding | None:
    """Return a warning of a spectral line above the motion, with frequency and amplitude.

    A structural mode decays and follows its excitation; a hum does neither.
    """
    series = replace(series, time=series.time[:MOST_SAMPLES], values=series.values[:MOST_SAMPLES])
    step = np.diff(series.time)
    usual = float(np.median(step)) if step.size else 0.0
    n = len(series.values)
    if (
        n < FEWEST_HUM_SAMPLES
        or np.max(np.abs(step - usual)) > EVEN_TOLERANCE * usual
        or 0.5 / usual <= LOWEST_HUM
    ):
        return None
    # Second differences suppress the motion at low frequencies; their gain is removed below.
    bent = np.diff(series.values, 2)
    window = np.hanning(len(bent) + 2)[1:-1]
    power = np.abs(np.fft.rfft(window * (bent - np.mean(bent)))) ** 2
    frequency = np.fft.rfftfreq(len(bent), usual)
    first = int(np.searchsorted(frequency, LOWEST_HUM))
    ratio = _power_over_floor(
        power / np.maximum(2.0 * np.sin(math.pi * frequency * usual), 1e-3) ** 4, first
    )
    if not ratio.size:
        return None
    peak = first + int(np.argmax(ratio))
    if ratio[peak - first] < FLOOR_SCATTER_FACTOR * math.log(len(ratio) / HUM_CHANCE):
        return None
    at = _refine_frequency(bent, usual, float(frequency[peak]), float(frequency[1]))
    amplitude = float(abs(np.mean(_amplitudes(bent, usual, at, FEWEST_PARTS))))
    finer = n * (amplitude / max(series.noise, 1e-6 * amplitude)) ** 2 / INFORMATION_PER_PART
    parts = _amplitudes(
        bent, usual, at, int(np.clip(min(finer, at * n * usual / 4.0), FEWEST_PARTS, MOST_PARTS))
    )
    sizes = np.abs(parts)
    if (
        _coherence(parts) < LEAST_COHERENT_SHARE
        or np.max(sizes) > LARGEST_AMPLITUDE_RATIO * np.min(sizes)
        or amplitude < max(HUM_TO_NOISE * series.noise, HUM_TO_BIT * series.least_bit)
    ):
        return None
    if any(_has_line(other, at) for other in inputs):
        return None
    text = (
        f"hums at {at:.4g} Hz with an amplitude of {shown(amplitude, series.unit)}, the same in "
        "phase and size throughout"
    )
    text += f"; a hum above {0.5 / usual:.3g} Hz, half the sample rate, shows as a lower frequency"
    numbers = {
        "frequency": FindingQuantity(at, "Hz"),
        "amplitude": FindingQuantity(amplitude, series.unit),
    }
    remedy = (
        "filter all channels alike with --lowpass below it, or mend the wiring; mains is at 50 or "
        "60 Hz, aircraft supply at 400 Hz"
    )
    return RecordFinding(series.name, Kind.HUM, Certainty.LIKELY, text, remedy, (), numbers)


def _power_over_floor(power: np.ndarray, first: int) -> np.ndarray:
    """Return the power over the noise floor at each frequency from ``first`` to the last
    but one.
    """
    above_lowest = power[first:-1]
    if len(above_lowest) < FLOOR_BINS:
        return np.zeros(0)
    padded = np.pad(
        above_lowest, FLOOR_BINS, mode="reflect" if len(above_lowest) > FLOOR_BINS else "edge"
    )
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * FLOOR_BINS + 1)
    beside = np.delete(windows, np.s_[FLOOR_BINS - LINE_BINS : FLOOR_BINS + LINE_BINS + 1], axis=1)
    floor = np.median(beside, axis=1) / math.log(2.0)
    return np.asarray(above_lowest / np.maximum(floor, 1e-300))


def _refine_frequency(bent: np.ndarray, step: float, near: float, spacing: float) -> float:
    """Return the line's frequency to a fraction of a bin, Hz."""
    number = np.arange(len(bent))
    window = np.hanning(len(bent) + 2)[1:-1]
    grid = near + spacing * np.linspace(-1.0, 1.0, 41)
    turn = np.exp(-2j * math.pi * step * grid[:, None] * number[None, :])
    return float(grid[int(np.argmax(np.abs(turn @ (window * bent))))])


def _amplitudes(bent: np.ndarray, step: float, line_frequency: float, count: int) -> np.ndarray:
    """Complex amplitude of the line in each part of a record; ``bent``: second differences."""
    number = np.arange(len(bent))
    turned = bent * np.exp(-2j * math.pi * line_frequency * step * number)
    gain = (2.0 * math.sin(math.pi * line_frequency * step)) ** 2
    parts = []
    for rows in np.array_split(number, count):
        weights = np.hanning(len(rows) + 2)[1:-1]
        parts.append(2.0 * complex(np.sum(weights * turned[rows]) / np.sum(weights)) / gain)
    return np.array(parts)


def _coherence(parts: np.ndarray) -> float:
    power = float(np.mean(np.abs(parts) ** 2))
    return float(abs(np.mean(parts)) ** 2) / power if power > 0.0 else 0.0


def _has_line(other: Series, line_frequency: float) -> bool:
    """Return whether an input has the same line with a constant phase, at its own sample rate."""
    step = float(np.median(np.diff(other.time)))
    parts = _amplitudes(np.diff(other.values[:MOST_SAMPLES], 2), step, line_frequency, FEWEST_PARTS)
    return abs(np.mean(parts)) > INPUT_LINE_SHARE * other.span and _coherence(parts) > 0.5


# ---- Channels whose noise ends at a frequency

FEWEST_SPECTRUM_SAMPLES = 256
BAND_COUNT = 40  # bands of equal width up to half the sample rate
# largest power above the cutoff over the power below it: a noise amplitude of one hundredth
EMPTY_SHARE = 1e-4
# Smallest ratio of the first empty frequency to the cutoff: two-way Butterworth filters of order 4
# fall by 1e-4 within 1.8.
CUTOFF_WIDTH_RATIO = 1.8
FEWEST_FLAT_BANDS = 4  # fewest bands of noise of one level
FEWEST_EMPTY_BANDS = 4  # fewest bands without noise
BAND_LIMITED_CHANCE = 1e-3  # probability that a flat spectrum fails the test
WINDOW_WIDENING = 2.0  # frequencies of a windowed spectrum per independent one


def band_limited(series: Series) -> RecordFinding | None:
    """Return a note if a channel has noise up to a cutoff frequency and none above; else None.

    None also for uneven or few samples, for less steep filters, and where the motion hides the
    noise.
    """
    time, values = series.time[:MOST_SAMPLES], series.values[:MOST_SAMPLES]
    step = np.diff(time)
    usual = float(np.median(step)) if step.size else 0.0
    if (
        len(values) < FEWEST_SPECTRUM_SAMPLES
        or np.max(np.abs(step - usual)) > EVEN_TOLERANCE * usual
    ):
        return None
    levels, bins = _band_powers(values), len(values) / 2.0 / BAND_COUNT
    for flat in range(BAND_COUNT - FEWEST_EMPTY_BANDS - 1, 2 * FEWEST_FLAT_BANDS - 1, -1):
        below = levels[flat // 2 : flat]
        first = int(np.ceil(CUTOFF_WIDTH_RATIO * flat))
        above = levels[min(first, BAND_COUNT - FEWEST_EMPTY_BANDS) :]
        if np.max(above) >= EMPTY_SHARE * np.median(below) or not _is_flat(
            below, 2.0 * bins / WINDOW_WIDENING
        ):
            continue
        cutoff = 0.5 * flat / BAND_COUNT / usual
        share = flat / BAND_COUNT
        text = (
            f"has noise up to about {cutoff:.3g} Hz and none above, of {0.5 / usual:.3g} Hz that "
            "its samples could hold"
        )
        text += (
            ": it was filtered or resampled before it was written, and one sample in "
            f"{1.0 / share:.2g} is independent"
        )
        remedy = (
            "export the channel as it was recorded; else residuals are not white, and sigmas for "
            "white noise too small"
        )
        numbers = {"cutoff": FindingQuantity(cutoff, "Hz")}
        return RecordFinding(series.name, Kind.FILTERED, Certainty.NOTED, text, remedy, (), numbers)
    return None


def _band_powers(values: np.ndarray) -> np.ndarray:
    """Return the mean power in each of the bands, ``(BAND_COUNT,)``, of second differences."""
    bent = np.diff(values, 2)
    phase = 2.0 * np.pi * (np.arange(len(bent)) + 0.5) / len(bent)
    window = (
        0.35875
        - 0.48829 * np.cos(phase)
        + 0.14128 * np.cos(2.0 * phase)
        - 0.01168 * np.cos(3.0 * phase)
    )
    power = np.abs(np.fft.rfft(window * (bent - np.mean(bent))))[1:] ** 2
    share = np.arange(1, len(power) + 1) / len(power)
    power = power / (2.0 * np.sin(0.5 * np.pi * share)) ** 4
    band = np.minimum((BAND_COUNT * share).astype(int), BAND_COUNT - 1)
    return np.asarray(
        np.bincount(band, weights=power, minlength=BAND_COUNT)
        / np.bincount(band, minlength=BAND_COUNT)
    )


def _is_flat(levels: np.ndarray, freedom: float) -> bool:
    """Return whether the halves of a part of the spectrum, and its outer quarters, have equal
    power.
    """
    for count in (len(levels) // 2, max(len(levels) // 4, 1)):
        ratio = float(np.mean(levels[:count]) / np.mean(levels[-count:]))
        if max(ratio, 1.0 / ratio) > fdtri(
            count * freedom, count * freedom, 1.0 - BAND_LIMITED_CHANCE
        ):
            return False
    return True
