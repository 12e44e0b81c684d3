"""Search for distorted channels: interpolation, clipped extremes and zero steps.

A channel may be interpolated between samples of a lower rate. Between two measured samples, second
differences (straight line) or fourth differences (cubic) are zero to the last printed digit. At the
measured samples they are not zero, because of the noise of the sensor.

Zero steps are jumps of the bias of a sensor. Two straight lines, fitted to the samples before and
after each row, are extrapolated to the row. The jump is the difference of the two lines, in which
the level, slope and curvature of the signal cancel. Least squares removes the part of the jump that
inputs and other channels explain.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammainc

from ident.recording.series import (
    Certainty,
    Kind,
    RecordFinding,
    Series,
    exact_step,
    quantities,
    quantity_text,
    runs_of,
)
from ident.statistics.noise_levels import robust_sigma_about_zero
from sim.errors import instant

# ---- Period of the updates of a channel

# Fewest updates that show a period of k samples: by chance all of them have one phase with the
# probability k^-14.
FEWEST_UPDATES = 15
LONGEST_PERIOD = 60  # samples
ON_PHASE_SHARE = 0.97  # smallest share of changes on one phase; missing rows shift the others


def phase_period(changes: np.ndarray, count: int) -> int:
    """Return the longest period, in samples, for which nearly all changes have the same phase; 1 if
    there is none.

    ``changes`` are the positions of samples that differ from the one before, among ``count``.
    """
    best = 1
    for period in range(2, min(LONGEST_PERIOD, count // FEWEST_UPDATES) + 1):
        if np.bincount(changes % period).max() >= ON_PHASE_SHARE * len(changes):
            best = period
    return best


# ---- Interpolated channels

SINGLE_PRECISION_SHARE = 2e-7  # rounding of single precision, as a share of the largest value
# A bend is the deviation of a sample from the curve through its neighbours. The median bend at
# updates, over the rounding, must be larger than this: with less noise one in ten looks straight.
BEND_TO_ROUNDING_RATIO = 8.0
STRAIGHT_ROUNDINGS = 4.0  # largest bend of a nearly straight sample, in roundings
LARGEST_NEARLY_STRAIGHT_SHARE = 0.05  # largest share of nearly straight samples: noise gives more
STRAIGHT_SAMPLE_SHARE = 0.3  # smallest share of straight samples at uneven updates
# smallest share of the bends on the phases of the updates; missing rows shift the others
INTERPOLATED_ON_PHASE = 0.97
EVEN_STEP_TOLERANCE = 0.02  # largest relative deviation of a step from the median step
# largest share of bends at changes of an input: more bends are a response of the vehicle
RESPONSE_BEND_SHARE = 0.9
RESPONSE_TIME = 2.6  # largest distance of a response from the change, in steps of the input


@dataclass(frozen=True, eq=False)
class _Pattern:
    """A pattern of interpolation.

    Attributes
    ----------
    measured : ``(n,)`` False for interpolated samples.
    period : mean distance of measured samples, in samples.
    curve : name of the curves between them.
    """

    measured: np.ndarray
    period: float
    curve: str


def interpolation_finding(
    series: Series, count: int, inputs: Sequence[Series] = (), *, is_input: bool = False
) -> RecordFinding | None:
    """Return the finding of samples that are interpolated between measured ones; else None.

    The finding masks the interpolated samples, except those of an input. Straight lines are found
    if measured samples are at least two samples apart, or three at uneven distances. Cubics are
    found if measured samples are at least four samples apart at even distances. ``count`` is the
    number of rows of the record.
    """
    if len(series.values) < 2 * FEWEST_UPDATES:
        return None
    pattern = _straight_lines(series, inputs) or _cubics(series, inputs)
    if pattern is None:
        return None
    step = float(np.median(np.diff(series.time)))
    filled = int(np.count_nonzero(~pattern.measured))
    rate = f"measured every {pattern.period:.3g} samples ({1.0 / (pattern.period * step):.3g} Hz)"
    text = (
        f"is interpolated: {rate}, with {pattern.curve} between: {filled} of {len(series.values)} "
        "samples follow from their neighbours"
    )
    numbers = quantities(period=(pattern.period * step, "s"), samples=pattern.period)
    if is_input:
        return RecordFinding(series.name, Kind.INTERPOLATED, Certainty.NOTED, text, "", (), numbers)
    mask = np.zeros(count, dtype=bool)
    mask[series.rows[~pattern.measured]] = True
    remedy = "export the channel at the rate at which it was measured"
    return RecordFinding(
        series.name, Kind.INTERPOLATED, Certainty.COSTS_INFORMATION, text, remedy, (), numbers, mask
    )


def _rounding(series: Series) -> float:
    """Return the largest rounding error of a sample from its printed digits."""
    largest = float(np.max(np.abs(series.values)))
    return max(0.51 * exact_step(series.values), SINGLE_PRECISION_SHARE * largest)


def _straight_lines(series: Series, inputs: Sequence[Series]) -> _Pattern | None:
    """Return the pattern of straight lines between measured samples; None without it."""
    t, v = series.time, series.values
    share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    bends = np.abs(v[1:-1] - (1.0 - share) * v[:-2] - share * v[2:])
    rounding = 2.0 * _rounding(series)
    bent = bends > rounding
    moves = np.abs(v[2:] - v[:-2])[~bent] > rounding
    if (
        not _is_bimodal(bends, rounding, bent)
        or not moves.size
        or np.mean(moves) < 0.5
        or _bends_are_response(t[1:-1][bent], inputs)
    ):
        return None
    at = np.flatnonzero(bent) + 1
    period = phase_period(at, len(v))
    measured = np.zeros(len(v), dtype=bool)
    if period > 1 and len(at) * period > 0.5 * len(v):
        measured[int(np.bincount(at % period, minlength=period).argmax()) :: period] = True
        return _Pattern(measured, float(period), "straight lines")
    lines = runs_of(~bent)
    if np.mean(~bent) < STRAIGHT_SAMPLE_SHARE or len(lines) < FEWEST_UPDATES:
        return None
    # The measurements lie between rows: the first sample of each line counts as measured.
    measured[[begin for begin, _ in lines]] = True
    return _Pattern(measured, len(v) / len(lines), "straight lines")


def _cubics(series: Series, inputs: Sequence[Series]) -> _Pattern | None:
    """Return the pattern of cubics between measured samples; None without it."""
    steps = np.diff(series.time)
    if np.max(np.abs(steps - np.median(steps))) > EVEN_STEP_TOLERANCE * np.median(steps):
        return None
    bends, rounding = np.abs(np.diff(series.values, 4)), 16.0 * _rounding(series)
    bent = bends > rounding
    times = series.time[2:-2][bent]
    if not _is_bimodal(bends, rounding, bent) or _bends_are_response(times, inputs):
        return None
    at = np.flatnonzero(bent) + 2
    # Only fourth differences about a measured sample and its two neighbours contain a bend.
    for period in range(min(LONGEST_PERIOD, len(bends) // FEWEST_UPDATES), 3, -1):
        phases = np.bincount(at % period, minlength=period)
        around = phases + np.roll(phases, 1) + np.roll(phases, -1)
        phase = int(np.argmax(around))
        on_phase = around[phase] >= INTERPOLATED_ON_PHASE * len(at)
        if on_phase and len(at) * period > 1.5 * len(bends):
            measured = np.zeros(len(series.values), dtype=bool)
            measured[phase::period] = True
            return _Pattern(measured, float(period), "cubics")
    return None


def _is_bimodal(bends: np.ndarray, rounding: float, bent: np.ndarray) -> bool:
    """Return whether nearly every bend is either within the rounding or far above it (``bent``)."""
    if (
        np.count_nonzero(bent) < FEWEST_UPDATES
        or np.count_nonzero(~bent) < FEWEST_UPDATES
        or np.median(bends[bent]) < BEND_TO_ROUNDING_RATIO * rounding
    ):
        return False
    nearly_straight = bent & (bends < STRAIGHT_ROUNDINGS * rounding)
    return bool(np.mean(nearly_straight) < LARGEST_NEARLY_STRAIGHT_SHARE)


def _bends_are_response(times: np.ndarray, inputs: Sequence[Series]) -> bool:
    """Return whether the ``times (B,)``, s, of bends are those of a piecewise constant input."""
    for control in inputs:
        changes = control.time[np.flatnonzero(np.diff(control.values))]
        if not changes.size or len(changes) > 0.7 * len(control.time):
            continue
        step = float(np.median(np.diff(control.time)))
        distance = np.min(np.abs(times[:, None] - changes[None, :]), axis=1)
        response_share = np.mean(distance < RESPONSE_TIME * step)
        if response_share > RESPONSE_BEND_SHARE and len(changes) < 2 * len(times):
            return True
    return False


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


def clipping_findings(series: Series, count: int, *, is_input: bool = False) -> list[RecordFinding]:
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
    # Clipping shortens the difference next to the level, so that the next but one is used.
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
    numbers = quantities(level=(level, series.unit))
    text = (
        f"flat at its {extreme} value, {quantity_text(level, series.unit)}, for "
        f"{int(np.count_nonzero(at_level))} samples"
    )
    if is_input:
        sentence = f"is {text}: at its stop, or clipped by the recorder"
        remedy = "check which: a stop limits the real input, clipping only the recorded one"
        return RecordFinding(
            series.name, Kind.CLIPPED, Certainty.NOTED, sentence, remedy, times, numbers
        )
    mask = np.zeros(count, dtype=bool)
    mask[series.rows[at_level]] = True
    sentence = f"is clipped: {text}"
    remedy = "widen the channel's range, or fly a smaller maneuver"
    costs = Certainty.COSTS_INFORMATION
    return RecordFinding(series.name, Kind.CLIPPED, costs, sentence, remedy, times, numbers, mask)


# ---- Zero steps: the bias of a channel jumps within one sample

LINE_TIME = 0.25  # s, length of each line: a quarter period of a fast short period
FEWEST_LINE_SAMPLES = 5  # fewest samples of a straight line
MOST_LINE_SAMPLES = 25  # most samples of a straight line
# smallest step in sigmas: the largest jump of 3000 Gaussian rows is 4.5, and curved motion adds
STEP_SIGMAS = 8.0
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


def zero_step_findings(
    series: Sequence[Series],
    inputs: Sequence[Series],
    masked: Mapping[str, np.ndarray],
    gravity_over_speed: float | None = None,
) -> list[RecordFinding]:
    """Return a warning for each step of one channel while no input and no other channel jumps.

    Parameters
    ----------
    masked : channel -> ``(N,)``, True at rows that are masked already.
    gravity_over_speed : 1/s. A step of nz is a real load, and no fault, if alpha changes as the
        load requires; None leaves out this test.
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
    # At a step of a control the pitch rate has a corner, as the running sum of the control has.
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
                and not (name in masked and masked[name][rows[peak : peak + 2 * length]].any())
            ):
                findings.append(_one_zero_step_finding(channel, row, size))
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
    """Return a mask ``(count,)``, True where no input steps within ``spacing`` rows."""
    steps = np.zeros(count)
    for values in inputs:
        steps[1:-1] += np.abs(np.diff(values, 2)) > INPUT_STEP_SHARE * float(np.ptp(values))
    return np.asarray(np.convolve(steps, np.ones(2 * spacing + 3), mode="same") < 0.5)


def _one_zero_step_finding(series: Series, row: int, size: float) -> RecordFinding:
    """Return the warning of a step by ``size``, in the unit of the channel, at ``row``."""
    time = float(series.time[min(int(np.searchsorted(series.rows, row)), len(series.time) - 1)])
    load = ", or an unrecorded load did" if series.name in ("nz", "az") else ""
    text = (
        f"jumps by {quantity_text(size, series.unit)} at {instant(time)} s and keeps the offset, "
        f"while no input and no other channel jumps: its bias changed{load}"
    )
    numbers = quantities(time=(time, "s"), step=(size, series.unit))
    remedy = "give the parts before and after as segments, --from and --to in pairs"
    return RecordFinding(
        series.name, Kind.ZERO_STEP, Certainty.LIKELY, text, remedy, ((time, time),), numbers
    )


def _resampled(series: Series, rows: np.ndarray, masked: np.ndarray | None) -> np.ndarray:
    """Return a channel at given rows, gaps interpolated, after a median of three samples."""
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
    """Return the value of the line after each row minus that of the line before it."""
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
        surrounding = np.concatenate([before, after])
        if opposite < OPPOSITE_JUMP_RATIO * size[i] and (
            not surrounding.size or size[i] > STEP_TO_SURROUNDINGS_RATIO * np.max(surrounding)
        ):
            peaks.append(int(i))
    return peaks if len(peaks) <= MOST_JUMPS else []
