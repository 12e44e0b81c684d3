"""The kind of an input: sharp level changes at the times of a step, pulse, doublet or 3-2-1-1; the half waves of sweeps and multisines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import find_peaks

from ident.maneuver_detection.signals import Stretch, rest_level

RISES = (0.4, 1.0)  # s, within which a level change is complete
EDGE_STRENGTH = 5.5  # of the rest level of such changes, from which on one is a level change
MINOR = (0.25, 0.4)  # of the largest level change within 5 s, below which one may be the pilot's
NEAR = 5.0  # s
LONG_PULSE = 4.0  # s, from which on a level that returns is a step
LONGEST = 16.0  # s, of one level
LEVELS = 0.3  # of the largest level, which each must reach
RETURN = 0.6  # of the largest level, to which the input must return
CANCEL = 0.35  # of the larger, by which the two level changes of a pulse or a step may differ where the pilot moves the trim meanwhile
SETTLE = 0.6  # s before and after a pattern, over which the levels outside are averaged
SHARES = {"3-2-1-1": np.array([3.0, 2.0, 1.0, 1.0]) / 7.0}
SHARE_ERROR = 0.1  # of the whole duration, by which a level of a 3-2-1-1 may be off
UNLIKE = 2.2  # ratio of durations of the two levels of a doublet
SWITCH = 0.35  # of the amplitude, at which a half wave begins and ends
AMPLITUDE = 95.0  # per cent of the larger samples that do not exceed the amplitude
OSCILLATION = 7  # half waves, from which on an input is an oscillation
TREND = 0.65  # rank correlation of the half waves' lengths with their order, from which on an oscillation is a sweep
LINES = 0.7  # likeness of two spectra, from which on one follows the other
SPREAD = 1.6  # ratio of the first third's to the last third's mean length in a sweep


@dataclass(frozen=True)
class Lobe:
    """A run of one sign beyond the switching level: samples ``first`` to before ``last``, mean ``level``."""

    first: int
    last: int
    level: float

    @property
    def size(self) -> int:
        return self.last - self.first


@dataclass(frozen=True)
class Shape:
    """What an input looks like.

    Attributes
    ----------
    kind : one of ``KINDS``. first, last : samples, the end excluded. amplitude : largest level, in the input's unit.
    flatness : one less the root mean square about the levels over their size. edge : least level change over the rest level of changes.
    sharpness : least share of a level change that is complete within the shortest of ``RISES``.
    """

    kind: str
    first: int
    last: int
    amplitude: float
    flatness: float = 1.0
    edge: float = 0.0
    sharpness: float = 1.0


def lobes_of(deviation: np.ndarray, switch: float, *, join: bool = True) -> list[Lobe]:
    """Runs in which a signal stays beyond ``switch`` on one side, in their order; ``join`` makes adjacent ones of one sign one."""
    sign = np.where(deviation > switch, 1, np.where(deviation < -switch, -1, 0)).astype(np.int8)
    edges = np.flatnonzero(np.diff(sign, prepend=0, append=0))
    out: list[Lobe] = []
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        if sign[first] == 0:
            continue
        if join and out and np.sign(out[-1].level) == sign[first]:
            first = out.pop().first
        out.append(Lobe(int(first), int(last), float(np.mean(deviation[first:last]))))
    return out


def step_shapes(stretch: Stretch, values: np.ndarray, trim: np.ndarray) -> list[Shape]:
    """Steps, pulses, doublets and other sequences of levels in a control, none overlapping another; the largest come first."""
    found: list[tuple[float, Shape]] = []
    fast = _changes(stretch, values, RISES[0])
    for rise in RISES:
        moved = _changes(stretch, values, rise)
        rest = rest_level(stretch, moved)
        at, _ = find_peaks(np.abs(moved), height=EDGE_STRENGTH * rest, distance=max(2, stretch.samples(0.5 * rise)))
        for some in (at, *(_major(at, moved, stretch.samples(NEAR), share) for share in MINOR)):
            found += _patterns(stretch, values, trim, some, moved, fast, rest, rise)
    out: list[Shape] = []
    for _, shape in sorted(found, key=lambda each: -each[0]):
        if not any(shape.first < other.last and other.first < shape.last for other in out):
            out.append(shape)
    return out


def _changes(stretch: Stretch, values: np.ndarray, rise: float) -> np.ndarray:
    """The mean over half of ``rise`` after each sample less the mean before it: largest in the middle of a level change."""
    half = max(1, stretch.samples(0.5 * rise))
    total = np.cumsum(np.pad(values - values[0], (half + 1, half), mode="edge"))
    after, before = total[2 * half :] - total[half:-half], total[half:-half] - total[: -2 * half]
    return (after - before)[:values.size] / half


def _major(at: np.ndarray, moved: np.ndarray, near: int, share: float) -> np.ndarray:
    """The level changes that are no minor ones beside another."""
    sizes = np.abs(moved[at])
    first, last = np.searchsorted(at, at - near), np.searchsorted(at, at + near, side="right")
    largest = np.array([sizes[a:b].max() for a, b in zip(first, last, strict=True)])
    return at[sizes >= share * largest] if at.size else at


def _patterns(
    stretch: Stretch, values: np.ndarray, trim: np.ndarray, at: np.ndarray, moved: np.ndarray, fast: np.ndarray, rest: np.ndarray, rise: float
) -> Iterator[tuple[float, Shape]]:
    """Sequences of two to five successive level changes that make a pattern, with their merit."""
    sizes = np.abs(moved[at])
    signs = np.sign(moved[at])
    half, longest = stretch.samples(0.5 * rise), stretch.samples(LONGEST)
    for i in range(at.size):
        for m in range(2, 6):
            if i + m > at.size or signs[i + m - 1] == signs[i + m - 2] or at[i + m - 1] - at[i + m - 2] > longest:
                break
            inner = sizes[i + 1 : i + m - 1]
            ends = max(sizes[i], sizes[i + m - 1])
            if inner.size and (inner.min() < 0.7 * ends or inner.max() > 5.0 * min(sizes[i], sizes[i + m - 1])):
                continue
            kind = _kind(np.diff(at[i : i + m]) * stretch.step)
            shape = _shape(stretch, values, trim, moved, at[i : i + m], half) if kind else None
            if shape is None:
                continue
            flatness, levels, weight = shape
            some = at[i : i + m]
            edge = float(np.min(sizes[i : i + m] / rest[some]))
            largest = float(np.max(np.abs(levels)))
            jumps = np.abs(np.diff([0.0, *levels, 0.0]))
            sharpness = float(np.min(_around(np.abs(fast), some, half) / jumps))
            yield flatness * weight, Shape(kind, int(some[0]), int(some[-1]), largest, flatness, edge, sharpness)


def _around(signal: np.ndarray, at: np.ndarray, half: int) -> np.ndarray:
    """The largest values of a signal within ``half`` samples of some."""
    return np.array([signal[max(0, k - half) : k + half + 1].max() for k in at])


def _shape(
    stretch: Stretch, values: np.ndarray, trim: np.ndarray, moved: np.ndarray, at: np.ndarray, half: int
) -> tuple[float, np.ndarray, float] | None:
    """Flatness, levels and energy of a control between level changes; None where the levels are of no pattern."""
    settle = stretch.samples(SETTLE)
    before = values[max(0, at[0] - half - settle) : max(1, at[0] - half + 1)]
    after = values[at[-1] + half : at[-1] + half + settle]
    base = float(np.mean(before))
    levels, scatter, weight = [], 0.0, 0
    for first, last in zip(at[:-1], at[1:], strict=True):
        inside = min(half, (last - first) // 4)
        part = values[first + inside : last - inside + 1] - base
        levels.append(float(np.mean(part)))
        slope = _slope(part) if at.size == 2 else 0.0
        scatter += float(np.sum((part - levels[-1] - slope * (np.arange(part.size) - 0.5 * (part.size - 1))) ** 2))
        weight += part.size
    found = np.array(levels)
    largest = float(np.max(np.abs(found)))
    if np.any(found[1:] * found[:-1] >= 0.0) or np.min(np.abs(found)) < LEVELS * largest:
        return None
    cancel = abs(float(np.sum(moved[at]))) <= CANCEL * float(np.max(np.abs(moved[at])))
    if after.size and abs(float(np.mean(after)) - base) > RETURN * largest and not (at.size == 2 and cancel):
        return None
    offset = base - float(np.median(trim[at[0] : at[-1]]))
    if abs(offset) > RETURN * largest:
        return None
    flatness = 1.0 - float(np.sqrt(scatter / weight)) / largest
    return flatness, found, float(np.sum((found + offset) ** 2 * np.diff(at)))


def _slope(values: np.ndarray) -> float:
    """Slope of the straight line through values at unit distance."""
    at = np.arange(values.size) - 0.5 * (values.size - 1)
    return float(at @ values / max(float(at @ at), 1.0))


def _kind(durations: np.ndarray) -> str | None:
    if durations.size == 1:
        return "step" if durations[0] >= LONG_PULSE else "pulse"
    if durations.size == 2:
        return "doublet" if durations.max() <= UNLIKE * durations.min() else None
    if durations.size == 3:
        return "multistep"
    shares = durations / durations.sum()
    for kind, wanted in SHARES.items():
        if min(np.abs(shares - wanted).max(), np.abs(shares[::-1] - wanted).max()) <= SHARE_ERROR:
            return kind
    return "multistep"


def oscillation_of(deviation: np.ndarray) -> Shape | None:
    """A sweep where the half waves of a control about its trim become steadily shorter or longer, a multisine where there are many, else None."""
    size = np.abs(deviation)
    peak = float(size.max())
    if peak <= 0.0:
        return None
    amplitude = float(np.percentile(size[size > 0.5 * peak], AMPLITUDE))
    lobes = [lobe for lobe in lobes_of(deviation, SWITCH * amplitude) if lobe.size > 1]
    if len(lobes) < OSCILLATION:
        return None
    levels = np.abs([lobe.level for lobe in lobes])
    strong = np.flatnonzero(levels >= 0.5 * np.median(levels))
    some: Sequence[Lobe] = lobes[strong[0] : strong[-1] + 1]
    periods = np.diff([0.5 * (lobe.first + lobe.last) for lobe in some])
    if periods.size < OSCILLATION - 2:
        return None
    ranks = np.argsort(np.argsort(periods, kind="stable"), kind="stable")
    trend = abs(float(np.corrcoef(np.arange(periods.size), ranks)[0, 1]))
    third = max(1, periods.size // 3)
    ratio = float(np.mean(periods[:third]) / np.mean(periods[-third:]))
    sweep = trend >= TREND and max(ratio, 1.0 / ratio) >= SPREAD
    return Shape("sweep" if sweep else "multisine", some[0].first, some[-1].last, amplitude, trend)


def same_lines(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether two oscillations have their energy at the same frequencies, as a control has that follows another.

    Multisines that are flown together have lines of their own each. The likeness is Bhattacharyya's coefficient of the two spectra.
    """
    powers = [np.abs(np.fft.rfft(each - each.mean())) ** 2 for each in (first, second)]
    shares = [power / max(float(power.sum()), 1e-300) for power in powers]
    return float(np.sum(np.sqrt(shares[0] * shares[1]))) > LINES
