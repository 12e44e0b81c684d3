"""Search for distorted channels: clipped extremes, steps of the zero, hum, filtered channels.

Steps of the zero: two straight lines, fitted to the samples before and after each row, are
extrapolated to the row. The jump is the difference of the two lines. A level, a slope and a
curvature of the signal cancel in it. Least squares remove the part of the jump that inputs and
other channels explain.

Filtered channels: white noise of a sensor fills the spectrum up to half the sample rate, and so
does the rounding of a converter after any filter. A channel whose spectrum is flat up to a cutoff
and empty above it was filtered after the conversion.
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

# ---- Clipped extremes: an extreme value at which the channel is flat

FEWEST_AT_LEVEL = 4  # fewest samples at the extreme value
FEWEST_IN_A_ROW = 3  # fewest adjacent samples at the extreme value
# probability that noise alone puts as many samples at the extreme value
FALSE_CLIPPING_PROBABILITY = 1e-6
CORNER_BENDS = 6.0  # smallest slope at a corner, over the usual second difference or the noise
CORNER_BITS = 3.0  # smallest slope at a corner, in least bits per sample
CORNER_SAMPLES = 8  # samples on either side of a run that show the usual second difference
# smallest distance of a clipped value from the median, in sigmas of the noise
CLIPPED_MOTION_SIGMAS = 6.0
# smallest share of samples at which an input changes: commanded square waves change less often
CONTINUOUS_INPUT_SHARE = 0.3


def clipped(series: Series, count: int, *, is_input: bool = False) -> list[RecordFinding]:
    """Return findings of extreme values at which a channel is flat. They mask these samples.

    The samples of an input are not masked, since the input may rest at its stop. ``count`` is the
    number of rows of the record.
    """
    if is_input and np.mean(np.diff(series.values) != 0.0) < CONTINUOUS_INPUT_SHARE:
        return []
    findings = []
    for sign, extreme in ((1.0, "highest"), (-1.0, "lowest")):
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
        if _exceeds_noise(series, values, level, at_level) or any(
            _has_corners(series, values, b, e) for b, e in inside
        ):
            finding = _clipping_finding(
                series, at_level, sign * level, extreme, count, is_input=is_input
            )
            findings.append(finding)
    return findings


def _exceeds_noise(series: Series, values: np.ndarray, level: float, at_level: np.ndarray) -> bool:
    """Return whether more samples are at the level than noise explains.

    The expected number follows from the samples in three bins below the level.
    """
    distance = level - float(np.median(values))
    if not series.resolved or distance < CLIPPED_MOTION_SIGMAS * series.noise:
        return False
    bin_width = max(series.least_bit, 0.25 * series.noise)
    below = np.count_nonzero((values < level) & (values >= level - 3.5 * bin_width))
    level_share = min(1.0, series.least_bit / bin_width) if series.least_bit else 1e-6
    expected = 2.0 * (below / 3.0 * level_share) + 0.5  # twice the expected number, to be safe
    # Poisson probability of at least as many samples at the level.
    probability = gammainc(np.count_nonzero(at_level), expected)
    return bool(probability < FALSE_CLIPPING_PROBABILITY)


def _has_corners(series: Series, values: np.ndarray, begin: int, end: int) -> bool:
    """Return whether a moving signal meets the level at a corner on both sides."""
    if end - begin < FEWEST_IN_A_ROW or begin < 3 or end + 3 > len(values):
        return False
    before = values[max(0, begin - CORNER_SAMPLES) : begin]
    after = values[end : end + CORNER_SAMPLES]
    bends = np.concatenate([np.abs(np.diff(before, 2)), np.abs(np.diff(after, 2))])
    usual = float(np.median(bends)) if bends.size else math.inf
    # Clipping shortens the first difference beside the level; the next one outwards is complete.
    slopes = (
        abs(float(values[begin - 1] - values[begin - 2])),
        abs(float(values[end + 1] - values[end])),
    )
    least_slope = max(
        CORNER_BENDS * usual, CORNER_BITS * series.least_bit, CORNER_BENDS * series.noise
    )
    return len(before) + len(after) > CORNER_SAMPLES and min(slopes) > least_slope


def _clipping_finding(
    series: Series, at_level: np.ndarray, level: float, extreme: str, count: int, *, is_input: bool
) -> RecordFinding:
    """Return the finding of a channel that is flat at its "highest" or "lowest" value."""
    runs = runs_of(at_level)
    times = tuple((float(series.time[b]), float(series.time[e - 1])) for b, e in runs if e - b > 1)
    numbers = {"level": FindingQuantity(level, series.unit)}
    text = (
        f"flat at its {extreme} value, {shown(level, series.unit)}, for "
        f"{int(np.count_nonzero(at_level))} samples"
    )
    if is_input:
        sentence = f"is {text}: at its stop, or clipped by the recorder"
        remedy = "say which, if you know: a stop is felt by the vehicle"
        return RecordFinding(
            series.name, Kind.CLIPPED, Certainty.NOTED, sentence, remedy, times, numbers
        )
    mask = np.zeros(count, dtype=bool)
    mask[series.rows[at_level]] = True
    sentence = f"is clipped: {text}"
    remedy = "widen the channel's range, or fly a smaller maneuver"
    costs = Certainty.COSTS_INFORMATION
    return RecordFinding(series.name, Kind.CLIPPED, costs, sentence, remedy, times, numbers, mask)


# ---- Zero steps: a channel jumps within one sample and keeps the offset

LINE_TIME = 0.25  # s, length of each line: a quarter period of a fast short period
FEWEST_LINE_SAMPLES = 5  # fewest samples of a straight line
MOST_LINE_SAMPLES = 25  # most samples of a straight line
STEP_SIGMAS = 8.0  # smallest step in sigmas: 3000 Gaussian rows reach 4.5, curved motion more
# smallest step over the largest jump within SURROUNDINGS_TIME, s
STEP_TO_SURROUNDINGS_RATIO = 3.0
SURROUNDINGS_TIME = 1.0
OTHER_JUMP_SIGMAS = 4.0  # largest jump of another channel at that row, in standard deviations
EXPLAINED_JUMP_SIGMAS = 4.0  # larger jumps are left out of the regression on other channels
INPUT_STEP_SHARE = 0.05  # smallest step of an input, as a share of its span
# smallest distance to the step of an input, in line lengths: the regression removes the effect of
# the step to first order only
INPUT_DISTANCE = 0.6
# largest opposite jump nearby, over the jump: side lobes of a step are 0.35, a pulse has 1
OPPOSITE_JUMP_RATIO = 0.7
CORNER_SIGMAS = 4.0  # smallest corner that tests a load, in standard deviations
CORNER_TIME = 0.8  # s, time on either side of a jump of nz in which alpha is compared
MOST_JUMPS = 3  # most steps of one channel: a channel with more steps has none reported


def zero_steps(
    series: Sequence[Series],
    inputs: Sequence[Series],
    masked: Mapping[str, np.ndarray],
    gravity_over_speed: float | None = None,
) -> list[RecordFinding]:
    """Return a warning for each step of a single channel.

    Parameters
    ----------
    masked : channel -> ``(N,)``, True at rows that are masked already.
    gravity_over_speed : 1/s. A step of nz is a load, and no fault, if alpha changes as the load
        requires; None leaves out this test.
    """
    if not series or len(series[0].values) < 4 * FEWEST_LINE_SAMPLES:
        return []
    step = float(np.median(np.diff(series[0].time)))
    length = int(np.clip(round(LINE_TIME / step), FEWEST_LINE_SAMPLES, MOST_LINE_SAMPLES))
    rows = np.unique(np.concatenate([channel.rows for channel in series]))
    if len(rows) < 6 * length:
        return []
    all_series = (*series, *inputs)
    values = {item.name: _resampled(item, rows, masked.get(item.name)) for item in all_series}
    jumps = {name: _jumps(column, length) for name, column in values.items()}
    # The pitch rate bends at a step of a control, as the running sum of the control does.
    input_sums = [
        _jumps(np.cumsum(values[channel.name] - np.mean(values[channel.name])), length)
        for channel in inputs
    ]
    noise_gain = float(np.sqrt(2.0 * np.sum(_weights(length) ** 2)))
    jump_noise = {item.name: noise_gain * item.noise + item.least_bit for item in series}
    jump_std = {name: max(noise, _robust_std(jumps[name])) for name, noise in jump_noise.items()}
    without_input_step = _rows_without_input_step(
        [values[channel.name] for channel in inputs], len(rows), round(INPUT_DISTANCE * length)
    )
    findings = []
    for channel in series:
        name = channel.name
        residual = _unexplained_jumps(
            jumps[name], [*(jumps[other] for other in jumps if other != name), *input_sums]
        )
        surroundings = round(min(SURROUNDINGS_TIME / step, len(residual)))
        for peak in _step_rows(residual, jump_noise[name], length, surroundings):
            row, size = rows[peak + length], float(residual[peak])
            near = slice(max(0, peak - 2), peak + 3)
            others_jump = any(
                np.max(np.abs(jumps[other][near])) >= OTHER_JUMP_SIGMAS * jump_std[other]
                for other in jump_std
                if other != name
            )
            if name == "nz" and _is_load(series, values, row, size, gravity_over_speed):
                continue
            if (
                not others_jump
                and without_input_step[peak + length]
                and not _any_masked(masked.get(name), rows[peak : peak + 2 * length])
            ):
                findings.append(_zero_steps_finding(channel, row, size))
    return findings


def _is_load(
    series: Sequence[Series],
    values: Mapping[str, np.ndarray],
    row: int,
    size: float,
    gravity_over_speed: float | None,
) -> bool:
    """Return whether a step of nz is a real load: alpha - int (q - (g/V) nz) dt is then a straight
    line.

    If the step is a sensor fault, this difference has a corner at the step. The test requires that
    the corner of a fault of this ``size`` (g) exceeds ``CORNER_SIGMAS`` standard deviations.
    """
    by_name = {channel.name: channel for channel in series}
    time = by_name["nz"].time
    if (
        gravity_over_speed is None
        or not {"alpha", "q"} <= set(by_name)
        or len(time) != len(values["nz"])
    ):
        return False
    step_time = time[np.searchsorted(by_name["nz"].rows, row)]
    near = np.abs(time - step_time) < CORNER_TIME
    t = time[near] - step_time
    rate = (values["q"] - gravity_over_speed * (values["nz"] - np.mean(values["nz"])))[near]
    path = values["alpha"][near] - np.concatenate(
        [[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))]
    )
    matrix = np.stack([np.ones(len(t)), t, np.maximum(t, 0.0)])
    inverse = np.linalg.pinv(matrix @ matrix.T)
    corner = float((inverse @ (matrix @ path))[2])
    std = by_name["alpha"].noise * float(np.sqrt(inverse[2, 2]))
    expected = abs(gravity_over_speed * size)
    return expected > CORNER_SIGMAS * std and abs(corner) < 0.5 * expected


def _rows_without_input_step(inputs: Sequence[np.ndarray], count: int, spacing: int) -> np.ndarray:
    """Return whether no input steps within ``spacing`` rows of each row, ``(count,)``."""
    steps = np.zeros(count)
    for values in inputs:
        steps[1:-1] += np.abs(np.diff(values, 2)) > INPUT_STEP_SHARE * float(np.ptp(values))
    return np.asarray(np.convolve(steps, np.ones(2 * spacing + 3), mode="same") < 0.5)


def _zero_steps_finding(series: Series, row: int, size: float) -> RecordFinding:
    """Return the warning of a step by ``size``, in the unit of the channel."""
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
    """Return a channel at given rows. Gaps are interpolated, and a median of three samples removes
    single wrong ones.
    """
    usable = np.ones(len(series.rows), dtype=bool) if masked is None else ~masked[series.rows]
    if np.count_nonzero(usable) < 2:
        return np.zeros(len(rows))
    values = np.interp(rows, series.rows[usable], series.values[usable])
    middle = np.median(np.stack([values[:-2], values[1:-1], values[2:]]), axis=0)
    return np.concatenate([values[:1], middle, values[-1:]])


def _weights(length: int) -> np.ndarray:
    """Return the weights ``(length,)`` of samples at 0.5, 1.5, ... The weighted sum is the value at
    0 of their regression line.
    """
    position = np.arange(length) + 0.5
    line = np.stack([np.ones(length), position])
    return np.asarray(np.linalg.solve(line @ line.T, line)[0])


def _jumps(values: np.ndarray, length: int) -> np.ndarray:
    """Return the value of the line after each row minus that of the line before it. Each line is
    fitted to ``length`` rows.
    """
    weights = _weights(length)
    kernel = np.concatenate([-weights[::-1], weights])
    return np.asarray(np.correlate(values, kernel, mode="valid"))


def _unexplained_jumps(jump: np.ndarray, others: Sequence[np.ndarray]) -> np.ndarray:
    """Return the residual of the jumps of a channel in a regression on the jumps of others. The
    second of two regressions leaves out large residuals of the first.
    """
    regressors = [other for other in others if np.any(other)]
    if not regressors:
        return jump
    X = np.stack(regressors).T
    used = np.ones(len(jump), dtype=bool)
    residual = jump
    for _ in range(2):
        coefficients = np.linalg.lstsq(X[used], jump[used], rcond=None)[0]
        residual = jump - X @ coefficients
        used = np.abs(residual) < EXPLAINED_JUMP_SIGMAS * _robust_std(residual)
        if np.count_nonzero(used) < 4 * X.shape[1]:
            break
    return np.asarray(residual)


def _robust_std(jump: np.ndarray) -> float:
    """Return the robust standard deviation of the jumps, above zero."""
    return max(robust_sigma_about_zero(jump), 1e-300)


def _step_rows(residual: np.ndarray, noise: float, length: int, surroundings: int) -> list[int]:
    """Return the positions of jumps that exceed the noise and all jumps in the surroundings, and
    have no opposite jump nearby. The result is empty if there are more than ``MOST_JUMPS``.

    ``length`` is that of a line, and ``surroundings`` the number of rows on either side.
    """
    size = np.abs(residual)
    peaks: list[int] = []
    least = STEP_SIGMAS * max(_robust_std(residual), noise)
    compared = np.zeros(len(residual), dtype=bool)
    for i in np.argsort(size)[::-1][: 20 * MOST_JUMPS]:
        if size[i] < least or len(peaks) > MOST_JUMPS:
            break
        if compared[i]:
            continue
        near = slice(max(0, i - 2 * length), i + 2 * length + 1)
        compared[near] = True
        opposite = float(np.max(-np.sign(residual[i]) * residual[near]))
        before = size[max(0, i - surroundings - length) : max(0, i - length)]
        after = size[i + length + 1 : i + length + surroundings + 1]
        beside = np.concatenate([before, after])
        if opposite < OPPOSITE_JUMP_RATIO * size[i] and (
            not beside.size or size[i] > STEP_TO_SURROUNDINGS_RATIO * float(np.max(beside))
        ):
            peaks.append(int(i))
    return peaks if len(peaks) <= MOST_JUMPS else []


def _any_masked(masked: np.ndarray | None, rows: np.ndarray) -> bool:
    return masked is not None and bool(np.any(masked[rows]))


# ---- Hum

LOWEST_HUM = 4.0  # Hz: short periods and first elastic modes of piloted aircraft lie below
EVEN_TOLERANCE = 0.02  # largest relative deviation of a step from the usual one
FEWEST_HUM_SAMPLES = 128
MOST_SAMPLES = 20_000  # most samples that are used
FLOOR_BINS = 24  # frequencies on either side of a line whose median is the noise floor
LINE_BINS = 3  # frequencies on either side that belong to a line
HUM_CHANCE = 1e-5  # probability of a false line
# The power of noise is exponential: the threshold over the noise floor is ln(frequencies/chance),
# times this factor for the scatter of the floor.
FLOOR_SCATTER_FACTOR = 1.35
FEWEST_PARTS = 6  # fewest parts of a record in which the amplitude of a line is compared
MOST_PARTS = 16  # most parts, for a strong line: they show that ringing after steps decays
FEWEST_PERIODS_PER_PART = 4.0
# N (amplitude/noise)^2 of a part that gives the amplitude with a standard deviation of one seventh
INFORMATION_PER_PART = 80.0
# smallest power of the mean amplitude over the mean power: 1 for a constant phase, 1/6 for noise
LEAST_COHERENT_SHARE = 0.85
# largest ratio of the amplitudes of 16 parts: noise gives 1.8 in one of a hundred hums
LARGEST_AMPLITUDE_RATIO = 2.5
HUM_TO_NOISE = 0.3  # smallest amplitude over the noise: a smaller hum changes no estimate
# smallest amplitude over the least bit: rounding of a periodic motion makes smaller lines
HUM_TO_BIT = 0.5
# smallest amplitude of a line in an input to which the output may respond, as a share of its span
INPUT_LINE_SHARE = 1e-4
LEAST_INPUT_COHERENCE = 0.5  # smallest coherence of such a line


def hum(series: Series, inputs: Sequence[Series]) -> RecordFinding | None:
    """Return a warning if the spectrum has a line above the frequencies of the motion; else None.

    A structural mode is no hum: it is excited and decays, while a hum keeps its amplitude and phase
    over the record.
    """
    series = replace(series, time=series.time[:MOST_SAMPLES], values=series.values[:MOST_SAMPLES])
    steps = np.diff(series.time)
    step = float(np.median(steps)) if steps.size else 0.0
    n = len(series.values)
    if (
        n < FEWEST_HUM_SAMPLES
        or np.max(np.abs(steps - step)) > EVEN_TOLERANCE * step
        or 0.5 / step <= LOWEST_HUM
    ):
        return None
    # Second differences suppress the motion at low frequencies; their gain is removed below.
    bent = np.diff(series.values, 2)
    window = np.hanning(len(bent) + 2)[1:-1]
    power = np.abs(np.fft.rfft(window * (bent - np.mean(bent)))) ** 2
    frequency = np.fft.rfftfreq(len(bent), step)
    first = int(np.searchsorted(frequency, LOWEST_HUM))
    ratio = _power_over_floor(
        power / np.maximum(2.0 * np.sin(math.pi * frequency * step), 1e-3) ** 4, first
    )
    if not ratio.size:
        return None
    peak = first + int(np.argmax(ratio))
    if ratio[peak - first] < FLOOR_SCATTER_FACTOR * math.log(len(ratio) / HUM_CHANCE):
        return None
    line_frequency = _refine_frequency(bent, step, float(frequency[peak]), float(frequency[1]))
    amplitude = float(abs(np.mean(_amplitudes(bent, step, line_frequency, FEWEST_PARTS))))
    by_noise = n * (amplitude / max(series.noise, 1e-6 * amplitude)) ** 2 / INFORMATION_PER_PART
    by_periods = line_frequency * n * step / FEWEST_PERIODS_PER_PART
    count = int(np.clip(min(by_noise, by_periods), FEWEST_PARTS, MOST_PARTS))
    amplitudes = _amplitudes(bent, step, line_frequency, count)
    sizes = np.abs(amplitudes)
    if (
        _coherence(amplitudes) < LEAST_COHERENT_SHARE
        or np.max(sizes) > LARGEST_AMPLITUDE_RATIO * np.min(sizes)
        or amplitude < max(HUM_TO_NOISE * series.noise, HUM_TO_BIT * series.least_bit)
    ):
        return None
    if any(_has_line(control, line_frequency) for control in inputs):
        return None
    text = (
        f"hums at {line_frequency:.4g} Hz with an amplitude of {shown(amplitude, series.unit)}, "
        "the same in phase and size throughout; "
        f"a hum above {0.5 / step:.3g} Hz, half the sample rate, shows as a lower frequency"
    )
    numbers = {
        "frequency": FindingQuantity(line_frequency, "Hz"),
        "amplitude": FindingQuantity(amplitude, series.unit),
    }
    remedy = (
        "filter all channels alike with --lowpass below it, or mend the wiring; mains is at 50 or "
        "60 Hz, aircraft supply at 400 Hz"
    )
    return RecordFinding(series.name, Kind.HUM, Certainty.LIKELY, text, remedy, (), numbers)


def _power_over_floor(power: np.ndarray, first: int) -> np.ndarray:
    """Return the ratio of the power to the noise floor at each frequency from position ``first`` to
    the last but one. The floor follows from the median power of the neighbouring frequencies.
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
    """Return the frequency of the line, Hz, on a grid of a twentieth of the ``spacing`` about the
    frequency ``near``, Hz.
    """
    number = np.arange(len(bent))
    window = np.hanning(len(bent) + 2)[1:-1]
    grid = near + spacing * np.linspace(-1.0, 1.0, 41)
    harmonics = np.exp(-2j * math.pi * step * grid[:, None] * number[None, :])
    return float(grid[int(np.argmax(np.abs(harmonics @ (window * bent))))])


def _amplitudes(bent: np.ndarray, step: float, line_frequency: float, count: int) -> np.ndarray:
    """Return the complex amplitude of the line in each of ``count`` parts of a record, from its
    second differences ``bent``.
    """
    number = np.arange(len(bent))
    demodulated = bent * np.exp(-2j * math.pi * line_frequency * step * number)
    gain = (2.0 * math.sin(math.pi * line_frequency * step)) ** 2
    amplitudes = []
    for rows in np.array_split(number, count):
        weights = np.hanning(len(rows) + 2)[1:-1]
        mean = complex(np.sum(weights * demodulated[rows]) / np.sum(weights))
        amplitudes.append(2.0 * mean / gain)
    return np.array(amplitudes)


def _coherence(amplitudes: np.ndarray) -> float:
    """Return the power of the mean amplitude over the mean power of the amplitudes."""
    power = float(np.mean(np.abs(amplitudes) ** 2))
    return float(abs(np.mean(amplitudes)) ** 2) / power if power > 0.0 else 0.0


def _has_line(control: Series, line_frequency: float) -> bool:
    """Return whether an input has a line at this frequency, Hz, with a constant phase."""
    step = float(np.median(np.diff(control.time)))
    bent = np.diff(control.values[:MOST_SAMPLES], 2)
    amplitudes = _amplitudes(bent, step, line_frequency, FEWEST_PARTS)
    return (
        abs(np.mean(amplitudes)) > INPUT_LINE_SHARE * control.span
        and _coherence(amplitudes) > LEAST_INPUT_COHERENCE
    )


# ---- Channels whose noise ends at a frequency

FEWEST_SPECTRUM_SAMPLES = 256
BAND_COUNT = 40  # bands of equal width up to half the sample rate
# largest power above the cutoff over the power below it: noise amplitudes of one to a hundred
EMPTY_SHARE = 1e-4
# frequency over the cutoff from which the spectrum must be empty: the power of two-way Butterworth
# filters of order 4 has fallen to 1e-4 there
CUTOFF_WIDTH_RATIO = 1.8
FEWEST_FLAT_BANDS = 4  # fewest bands of noise of one level
FEWEST_EMPTY_BANDS = 4  # fewest bands without noise
BAND_LIMITED_CHANCE = 1e-3  # probability that a flat spectrum fails the test
# Blackman-Harris window: low side lobes, so that the empty bands show no power of the others
_WINDOW_COEFFICIENTS = (0.35875, -0.48829, 0.14128, -0.01168)
WINDOW_WIDENING = 2.0  # number of frequencies that one independent power of this window covers


def band_limited(series: Series) -> RecordFinding | None:
    """Return a note if a channel has noise up to a cutoff frequency and none above; else None.

    Uneven or few samples, filters that are less steep, and motion that hides the noise give None.
    """
    time, values = series.time[:MOST_SAMPLES], series.values[:MOST_SAMPLES]
    steps = np.diff(time)
    step = float(np.median(steps)) if steps.size else 0.0
    if len(values) < FEWEST_SPECTRUM_SAMPLES:
        return None
    if np.max(np.abs(steps - step)) > EVEN_TOLERANCE * step:
        return None
    powers, frequencies_per_band = _band_powers(values), len(values) / 2.0 / BAND_COUNT
    for flat in range(BAND_COUNT - FEWEST_EMPTY_BANDS - 1, 2 * FEWEST_FLAT_BANDS - 1, -1):
        # The lower half of the bands below the cutoff may show motion.
        below = powers[flat // 2 : flat]
        first_empty = int(np.ceil(CUTOFF_WIDTH_RATIO * flat))
        above = powers[min(first_empty, BAND_COUNT - FEWEST_EMPTY_BANDS) :]
        if np.max(above) >= EMPTY_SHARE * np.median(below) or not _is_flat(
            below, 2.0 * frequencies_per_band / WINDOW_WIDENING
        ):
            continue
        share = flat / BAND_COUNT
        cutoff = 0.5 * share / step
        text = (
            f"has noise up to about {cutoff:.3g} Hz and none above, of {0.5 / step:.3g} Hz that "
            "its samples could hold: it was filtered or resampled before it was written, and one "
            f"sample in {1.0 / share:.2g} is independent"
        )
        remedy = (
            "export the channel as it was recorded; else residuals are not white, and sigmas for "
            "white noise too small"
        )
        numbers = {"cutoff": FindingQuantity(cutoff, "Hz")}
        return RecordFinding(series.name, Kind.FILTERED, Certainty.NOTED, text, remedy, (), numbers)
    return None


def _band_powers(values: np.ndarray) -> np.ndarray:
    """Return the mean power of the values in each band, ``(BAND_COUNT,)``. It is computed from
    second differences, which suppress the motion, and divided by their gain.
    """
    bent = np.diff(values, 2)
    phase = 2.0 * np.pi * (np.arange(len(bent)) + 0.5) / len(bent)
    window = sum(a * np.cos(k * phase) for k, a in enumerate(_WINDOW_COEFFICIENTS))
    power = np.abs(np.fft.rfft(window * (bent - np.mean(bent))))[1:] ** 2
    share = np.arange(1, len(power) + 1) / len(power)
    power = power / (2.0 * np.sin(0.5 * np.pi * share)) ** 4
    band = np.minimum((BAND_COUNT * share).astype(int), BAND_COUNT - 1)
    return np.asarray(
        np.bincount(band, weights=power, minlength=BAND_COUNT)
        / np.bincount(band, minlength=BAND_COUNT)
    )


def _is_flat(powers: np.ndarray, freedom: float) -> bool:
    """Return whether both halves of some bands, and their outer quarters, have equal powers by an F
    test. ``freedom`` is the number of degrees of freedom of a band.
    """
    for count in (len(powers) // 2, max(len(powers) // 4, 1)):
        ratio = float(np.mean(powers[:count]) / np.mean(powers[-count:]))
        limit = fdtri(count * freedom, count * freedom, 1.0 - BAND_LIMITED_CHANCE)
        if max(ratio, 1.0 / ratio) > limit:
            return False
    return True
