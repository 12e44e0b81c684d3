"""Kinds of maneuvers, from the shape of an input (patterns of levels, oscillations) and from the
motion of the aircraft (turns, pull-ups, trim points).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

from ident.maneuver_detection.signals import DetectedManeuver, EvenSegment, rest_level, trim_of

# ---- Kind of an input from its shape

RISES = (0.4, 1.0)  # s, durations of a level change that are tried, the shortest first
EDGE_STRENGTH = 5.5  # smallest level change, relative to changes at rest
# Limits of minor level changes, which may be corrections by the pilot, relative to the largest
# change within NEAR_TIME, s. Patterns are also searched without the changes below each limit.
MINOR_CHANGE_SHARES = (0.25, 0.4)
NEAR_TIME = 5.0
LONG_PULSE = 4.0  # s, longest pulse; a longer level is a step
LONGEST_LEVEL = 16.0  # s, longest level of a pattern
LEAST_LEVEL_SHARE = 0.3  # smallest level of a pattern, relative to the largest
# largest difference of the levels before and after a pattern, relative to its largest level
RETURN_SHARE = 0.6
# largest sum of the level changes of a pattern, relative to the largest one, after which the input
# has returned whatever the level afterwards is: the trim may have changed
CHANGE_DIFFERENCE_SHARE = 0.35
# largest sum of a pattern's level changes, relative to the largest level
LARGEST_NET_CHANGE_SHARE = 0.8
# exponent of the number of levels in the merit of a pattern: it prefers the more complete of two
# similar ones
LEVEL_COUNT_EXPONENT = 0.15
STEADY_BEFORE = 2.0  # s, time of constant level before a lasting step
STEADY_AFTER = LONG_PULSE  # s, time of constant level after it
STEP_SCATTER_SHARE = 0.15  # largest scatter of these levels, relative to the step
LASTING_STEP_TIME = 10.0  # s, duration of a maneuver with a lasting step
OUTSIDE_TIME = 0.6  # s before and after a pattern, over which the levels outside are averaged
# durations of the levels of a pattern, relative to the whole
SHARES = {"3-2-1-1": np.array([3.0, 2.0, 1.0, 1.0]) / 7.0}
SHARE_ERROR = 0.1  # largest error of such a duration, relative to the whole
# smallest flatness and edge of each half of a doublet with a pause, as for a single pulse
PAUSED_DOUBLET_LIMITS = (0.75, 7.0)
LARGEST_DOUBLET_RATIO = 2.2  # ratio of durations of the two levels of a doublet
HALF_WAVE_EDGE_SHARE = 0.35  # level at which a half wave begins and ends, relative to the amplitude
# percentile, among samples above half of the peak, that is the amplitude
AMPLITUDE_PERCENTILE = 95.0
FEWEST_HALF_WAVES = 7  # fewest half waves of an oscillation
# smallest rank correlation of the lengths of half waves with their order in a sweep
SWEEP_RANK_CORRELATION = 0.65
# smallest similarity of the spectra of two controls of which one follows the other
SAME_SPECTRUM_SIMILARITY = 0.7
# smallest ratio of the mean lengths of half waves in the first and the last third of a sweep
SWEEP_LENGTH_RATIO = 1.6


@dataclass(frozen=True)
class Lobe:
    """Successive samples, ``first`` to ``last - 1``, that exceed a limit on one side. ``level`` is
    their mean.
    """

    first: int
    last: int
    level: float

    @property
    def size(self) -> int:
        """Number of samples."""
        return self.last - self.first


@dataclass(frozen=True)
class Shape:
    """Shape of an input.

    Attributes
    ----------
    kind : one of ``KINDS``.
    first, last : first sample, and the one after the last.
    amplitude : largest level, in the unit of the input.
    flatness : one minus the rms deviation from the levels over the largest level; for an
        oscillation, the rank correlation of the lengths of its half waves with their order.
    edge : smallest level change over the rest level of changes.
    sharpness : smallest share of a level change that is complete within the shortest of ``RISES``.
    """

    kind: str
    first: int
    last: int
    amplitude: float
    flatness: float = 1.0
    edge: float = 0.0
    sharpness: float = 1.0

    def overlaps(self, other: Shape, gap: int = 0) -> bool:
        """Return whether two shapes have fewer than ``gap`` samples between them."""
        return self.first < other.last + gap and other.first < self.last + gap


def lobes_of(deviation: np.ndarray, switch: float, *, join: bool = True) -> list[Lobe]:
    """Return the runs of a signal above ``switch`` or below minus ``switch``, in order. ``join``
    merges successive runs of the same sign.
    """
    sign = np.where(deviation > switch, 1, np.where(deviation < -switch, -1, 0)).astype(np.int8)
    edges = np.flatnonzero(np.diff(sign, prepend=0, append=0))
    out: list[Lobe] = []
    for first, last in itertools.pairwise(edges.tolist()):
        if sign[first] == 0:
            continue
        if join and out and np.sign(out[-1].level) == sign[first]:
            first = out.pop().first
        out.append(Lobe(first, last, float(np.mean(deviation[first:last]))))
    return out


def step_shapes(stretch: EvenSegment, values: np.ndarray, trim: np.ndarray) -> list[Shape]:
    """Return the steps, pulses, doublets and other patterns of levels of a control, without
    overlap. Lasting steps come last, all others in the order of their merit.

    ``values (N,)`` is the control, and ``trim (N,)`` its local trim.
    """
    from scipy.signal import find_peaks  # takes long to import, and most commands search nothing

    result: dict[tuple[int, ...], tuple[float, Shape]] = {}
    fast = _changes_within(stretch, values, RISES[0])
    for rise in RISES:
        moved = _changes_within(stretch, values, rise)
        rest = rest_level(stretch, moved)
        at, _ = find_peaks(
            np.abs(moved), height=EDGE_STRENGTH * rest, distance=max(2, stretch.samples(0.5 * rise))
        )
        control = _Control(
            stretch, values, trim, moved, fast, rest, max(1, stretch.samples(0.5 * rise))
        )
        near = stretch.samples(NEAR_TIME)
        major = (_major_changes(at, moved, near, share) for share in MINOR_CHANGE_SHARES)
        for selected in (at, *major):
            for times in _change_sequences(stretch, selected, moved):
                if times not in result and (one := _pattern(control, np.array(times))) is not None:
                    result[times] = one
    every = [*result.values(), *_doublets_with_pause(values - trim, list(result.values()))]
    out: list[Shape] = []
    for _, shape in sorted(every, key=lambda each: (-each[0], each[1].first)):
        if not any(shape.overlaps(other) for other in out):
            out.append(shape)
    return [*out, *_lasting_steps(control, at, out)]


def _doublets_with_pause(
    deviation: np.ndarray, shapes: Sequence[tuple[float, Shape]]
) -> Iterator[tuple[float, Shape]]:
    """Return doublets with a pause between their halves, each with its merit. The halves are pulses
    of opposite sign and similar duration, and the pause is at most the shorter duration.

    ``shapes`` are pairs of a merit and a shape.
    """
    pulses = [each for each in shapes if each[1].kind == "pulse"]
    pulses.sort(key=lambda each: each[1].first)
    for i, (merit, one) in enumerate(pulses):
        for other_merit, other in pulses[i + 1 :]:
            sizes = (one.last - one.first, other.last - other.first)
            if other.first - one.last > min(sizes):
                break
            means = [np.mean(deviation[each.first : each.last]) for each in (one, other)]
            signs = means[0] * means[1]
            amplitudes = (one.amplitude, other.amplitude)
            if (
                other.first <= one.last
                or signs >= 0.0
                or max(sizes) > LARGEST_DOUBLET_RATIO * min(sizes)
                or min(amplitudes) < LEAST_LEVEL_SHARE * max(amplitudes)
            ):
                continue
            worst = [
                min(getattr(one, name), getattr(other, name))
                for name in ("flatness", "edge", "sharpness")
            ]
            if worst[0] >= PAUSED_DOUBLET_LIMITS[0] and worst[1] >= PAUSED_DOUBLET_LIMITS[1]:
                yield (
                    (merit + other_merit) * 2.0**LEVEL_COUNT_EXPONENT,
                    Shape("doublet", one.first, other.last, max(amplitudes), *worst),
                )


def _lasting_steps(control: _Control, at: np.ndarray, others: Sequence[Shape]) -> Iterator[Shape]:
    """Return steps that last: single level changes between constant levels, away from the shapes
    ``others``. ``at`` are the samples of all level changes.

    Such a step ends ``LASTING_STEP_TIME`` after its begin, or at the next level change.
    """
    values, half = control.values, control.half
    before, after, away = (
        control.stretch.samples(s) for s in (STEADY_BEFORE, STEADY_AFTER, NEAR_TIME)
    )
    for k, following in zip(at.tolist(), [*at.tolist(), values.size][1:], strict=True):
        parts = (
            values[max(0, k - half - before) : max(1, k - half + 1)],
            values[k + half : k + half + after],
        )
        if (
            min(part.size for part in parts) < 0.5 * before
            or following - k < after
            or any(o.first < k + away and k < o.last + away for o in others)
        ):
            continue
        jump = float(parts[1].mean() - parts[0].mean())
        scatter = max(float(part.std()) for part in parts)
        if scatter > STEP_SCATTER_SHARE * abs(jump):
            continue
        sharpness = float(np.max(np.abs(control.fast[max(0, k - half) : k + half + 1]))) / abs(jump)
        edge = float(abs(control.moved[k]) / control.rest[k])
        yield Shape(
            "step",
            k,
            min(following, k + control.stretch.samples(LASTING_STEP_TIME)),
            abs(jump),
            1.0 - scatter / abs(jump),
            edge,
            sharpness,
        )


@dataclass(frozen=True, eq=False)
class _Control:
    """A control in a search for patterns with one duration of level changes.

    Attributes
    ----------
    values, trim : ``(N,)`` control and its trim.
    moved : ``(N,)`` change within the duration about each sample.
    fast : ``(N,)`` change within the shortest of ``RISES``.
    rest : ``(N,)`` rest level of ``moved``.
    half : half of the duration, samples.
    """

    stretch: EvenSegment
    values: np.ndarray
    trim: np.ndarray
    moved: np.ndarray
    fast: np.ndarray
    rest: np.ndarray
    half: int


def _change_sequences(
    stretch: EvenSegment, at: np.ndarray, moved: np.ndarray
) -> Iterator[tuple[int, ...]]:
    """Return sequences of two to five level changes of alternate sign, after which the control is
    near its initial level: the samples of the changes.
    """
    times, jumps, longest = at.tolist(), moved[at].tolist(), stretch.samples(LONGEST_LEVEL)
    for i in range(len(times) - 1):
        level = jumps[i]
        sign = 1.0 if level > 0.0 else -1.0
        levels = [level * sign]
        for k in range(i + 1, min(i + 5, len(times))):
            if times[k] - times[k - 1] > longest or jumps[k] * jumps[k - 1] > 0.0:
                break
            level += jumps[k]
            largest = max(levels)
            if abs(level) <= LARGEST_NET_CHANGE_SHARE * largest or (
                k == i + 1 and abs(level) <= LARGEST_NET_CHANGE_SHARE * abs(jumps[k])
            ):
                yield tuple(times[i : k + 1])
            sign = -sign
            if level * sign < 0.5 * LEAST_LEVEL_SHARE * largest:
                break
            levels.append(level * sign)


def _pattern(control: _Control, at: np.ndarray) -> tuple[float, Shape] | None:
    """Return the pattern of the level changes ``at``, with its merit; None if they form none."""
    kind = _kind(np.diff(at) * control.stretch.step)
    result = _levels(control, at) if kind else None
    if kind is None or result is None:
        return None
    flatness, levels, energy = result
    edge = float(np.min(np.abs(control.moved[at]) / control.rest[at]))
    jumps = np.abs(np.diff([0.0, *levels, 0.0]))
    fast = [
        float(np.max(np.abs(control.fast[max(0, k - control.half) : k + control.half + 1])))
        for k in at
    ]
    sharpness = float(np.min(np.array(fast) / jumps))
    return flatness * energy * levels.size**LEVEL_COUNT_EXPONENT, Shape(
        kind, int(at[0]), int(at[-1]), float(np.max(np.abs(levels))), flatness, edge, sharpness
    )


def _changes_within(stretch: EvenSegment, values: np.ndarray, rise: float) -> np.ndarray:
    """Return the mean over half of ``rise``, s, after each sample minus that before, ``(N,)``."""
    half = max(1, stretch.samples(0.5 * rise))
    total = np.cumsum(np.pad(values - values[0], (half + 1, half), mode="edge"))
    after, before = total[2 * half :] - total[half:-half], total[half:-half] - total[: -2 * half]
    return (after - before)[: values.size] / half


def _major_changes(at: np.ndarray, moved: np.ndarray, near: int, share: float) -> np.ndarray:
    """Return the level changes without those below ``share`` of the largest one within ``near``."""
    sizes = np.abs(moved[at])
    first, last = np.searchsorted(at, at - near), np.searchsorted(at, at + near, side="right")
    largest = np.array([sizes[a:b].max() for a, b in zip(first, last, strict=True)])
    return at[sizes >= share * largest] if at.size else at


def _levels(control: _Control, at: np.ndarray) -> tuple[float, np.ndarray, float] | None:
    """Return flatness, levels and energy between level changes; None if they form no pattern."""
    values, half, settle = control.values, control.half, control.stretch.samples(OUTSIDE_TIME)
    before = float(values[max(0, at[0] - half - settle) : max(1, at[0] - half + 1)].mean())
    later = values[at[-1] + half : at[-1] + half + settle]
    after = float(later.mean()) if later.size else before
    base = before if at.size == 2 else 0.5 * (before + after)
    levels, scatter, weight = [], 0.0, 0
    for first, last in zip(at[:-1].tolist(), at[1:].tolist(), strict=True):
        inside = min(half, (last - first) // 4)
        part = values[first + inside : last - inside + 1] - base
        levels.append(float(part.mean()))
        line = (
            _slope(part) * (np.arange(part.size) - 0.5 * (part.size - 1)) if at.size == 2 else 0.0
        )
        scatter += float(np.sum((part - levels[-1] - line) ** 2))
        weight += part.size
    result = np.array(levels)
    largest = float(np.max(np.abs(result)))
    if (
        np.any(result[1:] * result[:-1] >= 0.0)
        or np.min(np.abs(result)) < LEAST_LEVEL_SHARE * largest
    ):
        return None
    jumps = control.moved[at]
    largest_jump = float(np.max(np.abs(jumps)))
    changes_cancel = abs(float(jumps.sum())) <= CHANGE_DIFFERENCE_SHARE * largest_jump
    if abs(after - before) > RETURN_SHARE * largest and not changes_cancel:
        return None
    offset = base - float(np.median(control.trim[at[0] : at[-1]]))
    if abs(offset) > (RETURN_SHARE if at.size == 2 else 1.0) * largest:
        return None
    flatness = 1.0 - float(np.sqrt(scatter / weight)) / largest
    return flatness, result, float(np.sum((result + offset) ** 2 * np.diff(at)))


def _slope(values: np.ndarray) -> float:
    """Return the slope of the straight line through values at unit distance."""
    at = np.arange(values.size) - 0.5 * (values.size - 1)
    return float(at @ values / max(float(at @ at), 1.0))


def _kind(durations: np.ndarray) -> str | None:
    """Return the kind of a pattern from the durations of its levels, s; None without a kind."""
    if durations.size == 1:
        return "step" if durations[0] >= LONG_PULSE else "pulse"
    if durations.size == 2:
        return "doublet" if durations.max() <= LARGEST_DOUBLET_RATIO * durations.min() else None
    if durations.size == 3:
        return "multistep"
    shares = durations / durations.sum()
    for kind, wanted in SHARES.items():
        if min(np.abs(shares - wanted).max(), np.abs(shares[::-1] - wanted).max()) <= SHARE_ERROR:
            return kind
    return "multistep"


def oscillation_of(deviation: np.ndarray) -> Shape | None:
    """Return the oscillation in a signal: a sweep if its half waves become steadily shorter or
    longer, else a multisine; None if there are too few half waves.
    """
    size = np.abs(deviation)
    peak = float(size.max())
    if peak <= 0.0:
        return None
    amplitude = float(np.percentile(size[size > 0.5 * peak], AMPLITUDE_PERCENTILE))
    lobes = [
        lobe for lobe in lobes_of(deviation, HALF_WAVE_EDGE_SHARE * amplitude) if lobe.size > 1
    ]
    if len(lobes) < FEWEST_HALF_WAVES:
        return None
    levels = np.abs([lobe.level for lobe in lobes])
    strong = np.flatnonzero(levels >= 0.5 * np.median(levels))
    half_waves = lobes[strong[0] : strong[-1] + 1]
    trend, ratio = _trend(half_waves)
    if trend >= SWEEP_RANK_CORRELATION and max(ratio, 1.0 / ratio) >= SWEEP_LENGTH_RATIO:
        return Shape("sweep", half_waves[0].first, half_waves[-1].last, amplitude, trend)
    if len(half_waves) < FEWEST_HALF_WAVES - 1:
        return None
    return Shape("multisine", half_waves[0].first, half_waves[-1].last, amplitude, trend)


def _trend(lobes: Sequence[Lobe]) -> tuple[float, float]:
    """Return the rank correlation of the lengths of half waves with their order, and the ratio of
    the mean lengths in the first and in the last third.
    """
    periods = np.diff([0.5 * (lobe.first + lobe.last) for lobe in lobes])
    if periods.size < FEWEST_HALF_WAVES - 2:
        return 0.0, 1.0
    ranks = np.argsort(np.argsort(periods, kind="stable"), kind="stable")
    third = max(1, periods.size // 3)
    trend = abs(float(np.corrcoef(np.arange(periods.size), ranks)[0, 1]))
    return trend, float(np.mean(periods[:third]) / np.mean(periods[-third:]))


def same_lines(first: np.ndarray, second: np.ndarray) -> bool:
    """Return whether two oscillations have their energy at the same frequencies.

    A control that follows another one has the same spectral lines; simultaneous multisines have
    different ones. The measure is the Bhattacharyya coefficient of the two spectra.
    """
    powers = [np.abs(np.fft.rfft(each - each.mean())) ** 2 for each in (first, second)]
    shares = [power / max(float(power.sum()), 1e-300) for power in powers]
    return float(np.sum(np.sqrt(shares[0] * shares[1]))) > SAME_SPECTRUM_SIMILARITY


# ---- Turns, pull-ups and trim points, from the motion of the aircraft

ALL_AXES = "all"  # axis of a trim point
LEAST_TURN_BANK = math.radians(12.0)  # smallest bank angle of a turn
TURN_EDGE_SHARE = 0.25  # bank at which a turn begins and ends, relative to its median bank
HELD_BANK_TIME = 8.0  # s, shortest time for which the bank is within a fifth of its median
LEAST_HELD_SHARE = 0.5  # smallest share of a turn with constant bank
PULL_UP_LOAD = 0.25  # g, smallest load factor of a pull-up beyond that of the bank
PULL_UP_TIME = 1.2  # s, shortest time above half of the largest load factor
MOTION_AVERAGING_TIME = 0.5  # s, time over which motion is averaged
SHORTEST_TRIM = 10.0  # s, shortest trim point
# Largest change of 1 s averages within SHORTEST_TRIM in a trim point; that of the airspeed is
# relative.
TRIM_SPREAD = {
    "airspeed": 0.025,
    "height": 8.0,
    "altitude": 8.0,
    "theta": math.radians(1.5),
    "phi": math.radians(4.0),
}


def turns(stretch: EvenSegment) -> list[DetectedManeuver]:
    """Return the turns: parts of a segment in which the bank angle is held."""
    if "phi" not in stretch.outputs:
        return []
    averaged = stretch.samples(MOTION_AVERAGING_TIME)
    bank = uniform_filter1d(stretch.outputs["phi"], averaged, mode="nearest")
    result = []
    for lobe in lobes_of(bank, LEAST_TURN_BANK, join=False):
        middle = float(np.median(bank[lobe.first : lobe.last]))
        held = np.abs(bank - middle) < 0.2 * abs(middle)
        if np.count_nonzero(held[lobe.first : lobe.last]) * stretch.step < HELD_BANK_TIME:
            continue
        first, last = _extended_to_level(
            bank * math.copysign(1.0, middle), lobe, TURN_EDGE_SHARE * abs(middle)
        )
        held_time = np.count_nonzero(held[first:last]) * stretch.step
        if held_time > LEAST_HELD_SHARE * (last - first) * stretch.step:
            result.append(
                maneuver_of(stretch, Shape("turn", first, last, abs(middle)), "roll", "phi")
            )
    return result


def maneuver_of(
    stretch: EvenSegment, shape: Shape, axis: str, channel: str = ""
) -> DetectedManeuver:
    """Return the maneuver whose shape is that of an input, of a bank angle or of a quiet part."""
    start, end = (
        float(stretch.time[min(k, stretch.time.size - 1)]) for k in (shape.first, shape.last)
    )
    return DetectedManeuver(start, end, axis, shape.kind, channel, shape.amplitude)


def _extended_to_level(signal: np.ndarray, lobe: Lobe, level: float) -> tuple[int, int]:
    """Return the samples before and after a positive lobe where the signal is below ``level``."""
    before = np.flatnonzero(signal[: lobe.first] < level)
    after = np.flatnonzero(signal[lobe.last :] < level)
    return int(before[-1]) if before.size else 0, lobe.last + int(
        after[0]
    ) if after.size else signal.size - 1


def load_factor_excursions(stretch: EvenSegment) -> list[tuple[int, int]]:
    """Return the parts in which the load factor differs from that of the bank angle for some time:
    the first sample of each, and the one after the last.
    """
    if "nz" not in stretch.outputs:
        return []
    steady = 1.0
    if "phi" in stretch.outputs:
        steady = 1.0 / np.maximum(np.cos(stretch.outputs["phi"]), 0.2)
    averaged = stretch.samples(MOTION_AVERAGING_TIME)
    excess = uniform_filter1d(stretch.outputs["nz"] - steady, averaged, mode="nearest")
    excess = excess - trim_of(stretch, excess)
    result = []
    for lobe in lobes_of(excess, PULL_UP_LOAD, join=False):
        inside = np.abs(excess[lobe.first : lobe.last])
        if np.count_nonzero(inside > 0.5 * inside.max()) * stretch.step >= PULL_UP_TIME:
            result.append((lobe.first, lobe.last))
    return result


def trim_points(
    stretch: EvenSegment, quiet: np.ndarray, controls: Mapping[str, np.ndarray]
) -> list[DetectedManeuver]:
    """Return the trim points: parts of at least ``SHORTEST_TRIM`` in which inputs are quiet, and
    airspeed, height, attitude and controls are constant.

    Parameters
    ----------
    quiet : ``(N,)`` True at samples without activity of a control.
    controls : control -> ``(N,)`` largest change of its 1 s averages, in the unit of the control.
    """
    size = stretch.samples(SHORTEST_TRIM)
    steady = quiet.copy()
    spreads: dict[str, float | np.ndarray] = {
        name: spread for name, spread in TRIM_SPREAD.items() if name in stretch.outputs
    }
    for name, spread in (*spreads.items(), *controls.items()):
        values = (stretch.inputs if name in controls else stretch.outputs)[name]
        smooth = uniform_filter1d(values, stretch.samples(1.0), mode="nearest")
        allowed = spread * np.abs(smooth) if name == "airspeed" else spread
        around = maximum_filter1d(smooth, size, mode="nearest") - minimum_filter1d(
            smooth, size, mode="nearest"
        )
        steady &= around <= allowed
    # Each steady sample is the middle of a steady window: a run extends by half a window.
    result: list[DetectedManeuver] = []
    for first, last in runs_of(steady):
        low, high = max(0, first - size // 2), min(quiet.size, last + size // 2)
        while low < first and not quiet[low:first].all():
            low += 1 + int(np.flatnonzero(~quiet[low:first])[-1])
        not_quiet = np.flatnonzero(~quiet[last:high])
        high = last + int(not_quiet[0]) if not_quiet.size else high
        if (high - low) * stretch.step >= SHORTEST_TRIM:
            if result and stretch.time[low] <= result[-1].end:
                low = int(np.searchsorted(stretch.time, result.pop().start))
            result.append(maneuver_of(stretch, Shape("trim", low, high - 1, 0.0), ALL_AXES))
    return result


def runs_of(mask: np.ndarray) -> np.ndarray:
    """Return the first sample of each run of True, and the one after the last, ``(K, 2)``."""
    return np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)


def mean_conditions(stretch: EvenSegment, start: float, end: float) -> dict[str, float]:
    """Return the mean ``"airspeed"`` and ``"height"`` between two times, s, if recorded."""
    rows = stretch.rows(start, end)
    conditions = {"airspeed": "airspeed", "altitude": "height", "height": "height"}
    return {
        condition: float(np.mean(stretch.outputs[name][rows]))
        for name, condition in conditions.items()
        if name in stretch.outputs
    }
