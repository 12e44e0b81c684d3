"""Kind of an input from its shape: patterns of levels, and oscillations."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ident.maneuver_detection.signals import EvenSegment, rest_level

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
        for selected in (
            at,
            *(
                _major_changes(at, moved, stretch.samples(NEAR_TIME), share)
                for share in MINOR_CHANGE_SHARES
            ),
        ):
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
    pulses = sorted(
        ((merit, one) for merit, one in shapes if one.kind == "pulse"),
        key=lambda each: each[1].first,
    )
    for i, (merit, one) in enumerate(pulses):
        for other_merit, other in pulses[i + 1 :]:
            sizes = (one.last - one.first, other.last - other.first)
            if other.first - one.last > min(sizes):
                break
            signs = np.mean(deviation[one.first : one.last]) * np.mean(
                deviation[other.first : other.last]
            )
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
    """Return the pattern of the level changes at the samples ``at``, with its merit; None if they
    form no pattern.
    """
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
    """Return the mean of a signal over half of ``rise``, s, after each sample minus the mean over
    the same time before it, ``(N,)``.
    """
    half = max(1, stretch.samples(0.5 * rise))
    total = np.cumsum(np.pad(values - values[0], (half + 1, half), mode="edge"))
    after, before = total[2 * half :] - total[half:-half], total[half:-half] - total[: -2 * half]
    return (after - before)[: values.size] / half


def _major_changes(at: np.ndarray, moved: np.ndarray, near: int, share: float) -> np.ndarray:
    """Return the level changes ``at`` without minor ones: those smaller than ``share`` of the
    largest change within ``near`` samples.
    """
    sizes = np.abs(moved[at])
    first, last = np.searchsorted(at, at - near), np.searchsorted(at, at + near, side="right")
    largest = np.array([sizes[a:b].max() for a, b in zip(first, last, strict=True)])
    return at[sizes >= share * largest] if at.size else at


def _levels(control: _Control, at: np.ndarray) -> tuple[float, np.ndarray, float] | None:
    """Return flatness, levels and energy of the control between level changes; None if these form
    no pattern.
    """
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
    changes_cancel = abs(float(jumps.sum())) <= CHANGE_DIFFERENCE_SHARE * float(
        np.max(np.abs(jumps))
    )
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
    return (
        Shape("multisine", half_waves[0].first, half_waves[-1].last, amplitude, trend)
        if len(half_waves) >= FEWEST_HALF_WAVES - 1
        else None
    )


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
