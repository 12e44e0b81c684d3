"""Maneuvers as functions of time: steps and their combinations, multisines, sweeps.

A maneuver gives its exact mean over any interval, so that in a simulation a switch acts at its own
time and not at the next step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, Protocol

import numpy as np

from sim.errors import ModelError
from sim.record import Hold

# ---- Maneuvers that are constant between switches, and how maneuvers combine

# A time this close to a switch, in s, is at the switch: samples at 0.01 k and sums of durations
# differ by rounding.
SWITCH_TOLERANCE = 1e-9


class Maneuver(Protocol):
    """An input as a function of time.

    A call returns the value at ``t`` (s, float or array); at a switch the new value. ``before(t)``
    returns the limit from the left, and ``mean(begin, end)`` the exact mean over each interval (s,
    arrays). ``breakpoints`` are the times at which value or slope may jump, in order. ``hold`` is
    the best interpolation between its samples in a record.
    """

    @property
    def breakpoints(self) -> tuple[float, ...]: ...
    @property
    def hold(self) -> Hold: ...
    def __call__(self, t: Any) -> np.ndarray: ...
    def before(self, t: Any) -> np.ndarray: ...
    def mean(self, begin: Any, end: Any) -> np.ndarray: ...


@dataclass(frozen=True)
class MultiStep:
    """Constant levels between switching times, zero before the first and after the last.

    Attributes
    ----------
    levels : value in each interval, in the unit of the input.
    times : switching times, s, increasing, one more than levels; the last may be infinite.

    Raises
    ------
    ModelError : times do not increase, numbers are not finite, or lengths do not match.
    """

    levels: tuple[float, ...]
    times: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.levels) == 0 or len(self.times) != len(self.levels) + 1:
            raise _bad(
                f"{len(self.levels)} level(s) and {len(self.times)} switching time(s)",
                "give one time more than levels, and at least one level",
            )
        if not all(
            math.isfinite(value) for value in (*self.levels, *self.times[:-1])
        ) or math.isnan(self.times[-1]):
            raise _bad("a level or a switching time is not a finite number", "give finite numbers")
        if any(
            later - earlier <= SWITCH_TOLERANCE
            for earlier, later in zip(self.times[:-1], self.times[1:], strict=True)
        ):
            raise _bad("switching times do not increase", "give every interval a positive duration")

    @property
    def breakpoints(self) -> tuple[float, ...]:
        return tuple(time for time in self.times if math.isfinite(time))

    @property
    def hold(self) -> Hold:
        return Hold.PREVIOUS

    def __call__(self, t: Any) -> np.ndarray:
        return self._padded[
            np.searchsorted(
                self._switches, np.asarray(t, dtype=float) + SWITCH_TOLERANCE, side="right"
            )
        ]

    def before(self, t: Any) -> np.ndarray:
        return self._padded[
            np.searchsorted(
                self._switches, np.asarray(t, dtype=float) - SWITCH_TOLERANCE, side="left"
            )
        ]

    def mean(self, begin: Any, end: Any) -> np.ndarray:
        begin, end = np.broadcast_arrays(
            np.asarray(begin, dtype=float), np.asarray(end, dtype=float)
        )
        first = np.searchsorted(self._switches, begin, side="right")
        last = np.searchsorted(self._switches, end, side="left")
        # Only intervals with a switch inside need an integral; elsewhere the level itself is exact.
        out = self._padded[first]
        mixed = last > first
        if np.any(mixed):
            a, b = begin[mixed], end[mixed]
            total = np.zeros(a.shape)
            for level, start, stop in zip(
                self.levels, self.times[:-1], self.times[1:], strict=True
            ):
                total += level * np.maximum(0.0, np.minimum(b, stop) - np.maximum(a, start))
            out = np.array(out)
            out[mixed] = total / (b - a)
        return out

    @property
    def _switches(self) -> np.ndarray:
        return np.asarray(self.times)

    @property
    def _padded(self) -> np.ndarray:
        return np.array([0.0, *self.levels, 0.0])


def three_two_one_one(amplitude: float, unit: float, start: float = 0.0) -> MultiStep:
    """Return a 3-2-1-1: alternating steps of 3, 2, 1, 1 ``unit`` (s), from ``start`` (s) on."""
    return alternating(amplitude, [3.0 * unit, 2.0 * unit, unit, unit], start)


def doublet(amplitude: float, unit: float, start: float = 0.0) -> MultiStep:
    """Return a doublet from ``start`` (s): ``amplitude`` for a ``unit`` (s), then its negative."""
    return alternating(amplitude, [unit, unit], start)


def pulse(amplitude: float, unit: float, start: float = 0.0) -> MultiStep:
    """Return a pulse: ``amplitude`` for one ``unit`` (s) from ``start`` (s)."""
    return alternating(amplitude, [unit], start)


def step(amplitude: float, start: float = 0.0) -> MultiStep:
    """Return a step: ``amplitude`` from ``start`` (s) on, without end."""
    return MultiStep((float(amplitude),), (float(start), math.inf))


def alternating(amplitude: float, durations: Sequence[float], start: float = 0.0) -> MultiStep:
    """Return alternating steps, the first of ``amplitude``, from ``start`` on; times in s."""
    for duration in durations:
        if not (duration > SWITCH_TOLERANCE and math.isfinite(duration)):
            raise _bad(f"a step lasts {duration:g} s", "give a positive duration")
    times = [float(start)]
    for duration in np.cumsum(durations):
        times.append(float(start + duration))
    return MultiStep(
        tuple(float(amplitude) * (-1.0) ** i for i in range(len(durations))), tuple(times)
    )


@dataclass(frozen=True)
class Sum:
    """A sum of maneuvers; without any, an input at rest. A smooth part makes its hold linear."""

    parts: tuple[Maneuver, ...] = ()

    @property
    def breakpoints(self) -> tuple[float, ...]:
        return tuple(sorted({time for part in self.parts for time in part.breakpoints}))

    @property
    def hold(self) -> Hold:
        return (
            Hold.LINEAR if any(part.hold is Hold.LINEAR for part in self.parts) else Hold.PREVIOUS
        )

    def __call__(self, t: Any) -> np.ndarray:
        return sum((part(t) for part in self.parts), start=np.zeros(np.shape(t)))

    def before(self, t: Any) -> np.ndarray:
        return sum((part.before(t) for part in self.parts), start=np.zeros(np.shape(t)))

    def mean(self, begin: Any, end: Any) -> np.ndarray:
        return sum(
            (part.mean(begin, end) for part in self.parts),
            start=np.zeros(np.broadcast_shapes(np.shape(begin), np.shape(end))),
        )


@dataclass(frozen=True)
class Delayed:
    """A maneuver that acts ``delay`` s later; earlier if the delay is negative."""

    part: Maneuver
    delay: float

    def __post_init__(self) -> None:
        if not math.isfinite(self.delay):
            raise _bad(f"delay {self.delay}", "give a finite delay in s")

    @property
    def breakpoints(self) -> tuple[float, ...]:
        return tuple(time + self.delay for time in self.part.breakpoints)

    @property
    def hold(self) -> Hold:
        return self.part.hold

    def __call__(self, t: Any) -> np.ndarray:
        return self.part(np.asarray(t) - self.delay)

    def before(self, t: Any) -> np.ndarray:
        return self.part.before(np.asarray(t) - self.delay)

    def mean(self, begin: Any, end: Any) -> np.ndarray:
        return self.part.mean(np.asarray(begin) - self.delay, np.asarray(end) - self.delay)


def sequence(parts: Sequence[Maneuver], gap: float, start: float = 0.0) -> Sum:
    """Return maneuvers one after another.

    The first begins at ``start`` (s), and each other one ``gap`` (s) after the last breakpoint of
    the one before it. Raises ModelError for a negative gap or a part without breakpoints.
    """
    if not (gap >= 0 and math.isfinite(gap)):
        raise _bad(f"gap {gap:g} s", "give a gap of zero or more")
    placed: list[Maneuver] = []
    begin = float(start)
    for part in parts:
        if not part.breakpoints:
            raise _bad("a part of the sequence has no beginning", "leave it out")
        placed.append(Delayed(part, begin - part.breakpoints[0]))
        begin = placed[-1].breakpoints[-1] + gap
    return Sum(tuple(placed))


def _bad(what: str, remedy: str) -> ModelError:
    """Return the error for a wrong maneuver."""
    return ModelError(what, where="maneuver", remedy=remedy)


# ---- Smooth maneuvers that spread their energy over a band

_GAUSS_POINTS = 8  # points of a panel in the mean of a sweep
_PEAK_POINTS_PER_PERIOD = 32  # points in a period of the highest harmonic that show the peaks
_MOST_CLIPPINGS = 200
_LEVELS = (0.75, 0.99)  # levels of the first and the last clipping, relative to the peak


@dataclass(frozen=True)
class Multisine:
    """A sum of harmonics of one period, which is repeated a whole number of times.

    u = sum_i amplitudes_i cos(2 pi harmonics_i (t - start) / period + phases_i) on ``[start, start
    + cycles period]``, zero outside. Disjoint harmonics are orthogonal over a period.
    """

    period: float
    harmonics: tuple[int, ...]
    amplitudes: tuple[float, ...]
    phases: tuple[float, ...]
    start: float = 0.0
    cycles: int = 1

    def __post_init__(self) -> None:
        if not (self.period > 0 and math.isfinite(self.period)):
            raise ModelError(
                f"period {self.period:g} s", where="multisine", remedy="give a positive period"
            )
        counts = {len(self.harmonics), len(self.amplitudes), len(self.phases)}
        if not self.harmonics or len(counts) != 1:
            raise ModelError(
                "harmonics, amplitudes and phases differ in number, or there are none",
                where="multisine",
                remedy="give each harmonic an amplitude and a phase",
            )
        distinct = len(set(self.harmonics)) == len(self.harmonics)
        if not distinct or any(each < 1 or each != int(each) for each in self.harmonics):
            raise ModelError(
                f"harmonics {list(self.harmonics)}",
                where="multisine",
                remedy="give different whole numbers from 1 on",
            )
        if not all(math.isfinite(v) for v in (*self.amplitudes, *self.phases, self.start)):
            raise ModelError(
                "a number is not finite", where="multisine", remedy="give finite numbers"
            )
        if self.cycles < 1 or self.cycles != int(self.cycles):
            raise ModelError(
                f"{self.cycles} cycles",
                where="multisine",
                remedy="give a whole number of cycles, at least one",
            )

    @property
    def end(self) -> float:
        """Time of the end, s."""
        return self.start + self.cycles * self.period

    @property
    def breakpoints(self) -> tuple[float, ...]:
        return (self.start, self.end)

    @property
    def hold(self) -> Hold:
        return Hold.LINEAR

    def __call__(self, t: Any) -> np.ndarray:
        t = np.asarray(t, dtype=float)
        return np.where(
            (t >= self.start - SWITCH_TOLERANCE) & (t < self.end - SWITCH_TOLERANCE),
            self._inside(t),
            0.0,
        )

    def before(self, t: Any) -> np.ndarray:
        t = np.asarray(t, dtype=float)
        return np.where(
            (t > self.start + SWITCH_TOLERANCE) & (t <= self.end + SWITCH_TOLERANCE),
            self._inside(t),
            0.0,
        )

    def mean(self, begin: Any, end: Any) -> np.ndarray:
        """Return the mean over each interval.

        The mean of a harmonic is its value at the middle times sin(x)/x, where x is half the phase
        that it passes in the interval.
        """
        begin, end = np.broadcast_arrays(
            np.asarray(begin, dtype=float), np.asarray(end, dtype=float)
        )
        a, b = np.clip(begin, self.start, self.end), np.clip(end, self.start, self.end)
        middle, width = 0.5 * (a + b), b - a
        total = np.zeros(begin.shape)
        for harmonic, amplitude, phase in zip(
            self.harmonics, self.amplitudes, self.phases, strict=True
        ):
            omega = 2.0 * math.pi * harmonic / self.period
            total += (
                amplitude
                * np.cos(omega * (middle - self.start) + phase)
                * np.sinc(omega * width / (2.0 * math.pi))
            )
        return total * width / (end - begin)

    def _inside(self, t: np.ndarray) -> np.ndarray:
        total = np.zeros(t.shape)
        for harmonic, amplitude, phase in zip(
            self.harmonics, self.amplitudes, self.phases, strict=True
        ):
            total += amplitude * np.cos(
                2.0 * math.pi * harmonic * (t - self.start) / self.period + phase
            )
        return total


def schroeder_multisine(
    rms: float, period: float, harmonics: Sequence[int], start: float = 0.0, cycles: int = 1
) -> Multisine:
    """Return a multisine of equal amplitudes with Schroeder's phases.

    It is shifted in time so that it begins and ends at zero. The phases phase_i = -pi i (i - 1) / n
    keep the peaks low (Schroeder, IEEE Trans. Information Theory 16(1), 1970). ``rms`` is that over
    a period, in the unit of the input; ``period`` and ``start`` are in s.
    """
    count = len(harmonics)
    if not (math.isfinite(rms) and count):
        raise ModelError(
            f"rms {rms} over {count} harmonic(s)",
            where="multisine",
            remedy="give a finite rms and at least one harmonic",
        )
    phases = tuple(-math.pi * i * (i - 1) / count for i in range(1, count + 1))
    amplitudes = (rms * math.sqrt(2.0 / count),) * count
    return _from_zero(Multisine(period, tuple(harmonics), amplitudes, phases, start, cycles))


def orthogonal_multisines(
    rms: Sequence[float], period: float, lowest: int, highest: int, start: float = 0.0
) -> tuple[Multisine, ...]:
    """Return a multisine for each input; they are mutually orthogonal over a period.

    Harmonics ``lowest`` to ``highest`` are assigned to the inputs in turn. ``rms`` has the root
    mean square for each input. Raises ModelError if there are fewer harmonics than inputs.
    """
    if highest - lowest + 1 < len(rms):
        raise ModelError(
            f"harmonics {lowest} to {highest} for {len(rms)} inputs",
            where="multisine",
            remedy="give at least one harmonic an input",
        )
    dealt = [range(lowest + i, highest + 1, len(rms)) for i in range(len(rms))]
    return tuple(
        schroeder_multisine(level, period, list(own), start)
        for level, own in zip(rms, dealt, strict=True)
    )


def least_peak_multisine(
    rms: float,
    period: float,
    harmonics: Sequence[int],
    start: float = 0.0,
    shares: Sequence[float] | None = None,
) -> Multisine:
    """Return a ``schroeder_multisine`` whose phases are improved for low peaks.

    ``shares`` : relative amplitudes of the harmonics; None for equal ones.

    In each iteration the peaks are clipped, and the phases of the clipped signal are taken (Van der
    Ouderaa, Schoukens and Renneboog, IEEE Trans. Instrumentation and Measurement 37(1), 1988). The
    level of clipping rises towards the peak. The result is the iteration with the lowest peak,
    which is never above that of Schroeder's phases.
    """
    first = schroeder_multisine(rms, period, harmonics, 0.0)
    at, count = np.asarray(first.harmonics), _PEAK_POINTS_PER_PERIOD * max(first.harmonics)
    size, phases = np.asarray(first.amplitudes), np.asarray(first.phases)
    if shares is not None:
        relative = np.asarray(shares, dtype=float)
        if relative.shape != size.shape or not (
            np.all(np.isfinite(relative)) and np.all(relative > 0.0)
        ):
            raise ModelError(
                f"shares {list(shares)}",
                where="multisine",
                remedy="give one above zero for each harmonic",
            )
        size = size * relative * math.sqrt(size.size / float(relative @ relative))
    best, lowest = phases, math.inf
    for step in range(_MOST_CLIPPINGS):
        spectrum = np.zeros(count // 2 + 1, dtype=complex)
        spectrum[at] = 0.5 * count * size * np.exp(1j * phases)
        u = np.fft.irfft(spectrum, count)
        peak = float(np.max(np.abs(u)))
        if peak < lowest:
            best, lowest = phases, peak
        level = peak * (_LEVELS[0] + (_LEVELS[1] - _LEVELS[0]) * step / _MOST_CLIPPINGS)
        phases = np.angle(np.fft.rfft(np.clip(u, -level, level))[at])
    amplitudes, phases_of_best = tuple(size.tolist()), tuple(best.tolist())
    return _from_zero(Multisine(period, first.harmonics, amplitudes, phases_of_best, start))


def _from_zero(multisine: Multisine) -> Multisine:
    """Return a multisine shifted in time within its period, so that it begins at zero."""
    shift = _first_zero(replace(multisine, start=0.0))
    phases = tuple(
        phase + 2.0 * math.pi * harmonic * shift / multisine.period
        for harmonic, phase in zip(multisine.harmonics, multisine.phases, strict=True)
    )
    return replace(multisine, phases=phases)


def _first_zero(multisine: Multisine) -> float:
    """Return the first upward zero crossing of a multisine within its period, s, by bisection.

    A multisine has zero mean, so that a crossing exists.
    """
    t = np.linspace(0.0, multisine.period, 32 * max(multisine.harmonics) + 1)
    u = multisine._inside(t)
    if not np.any(u):
        return 0.0
    at = int(np.argmax((u[:-1] <= 0) & (u[1:] > 0)))
    low, high = float(t[at]), float(t[at + 1])
    for _ in range(80):
        middle = 0.5 * (low + high)
        if multisine._inside(np.asarray(middle)) <= 0:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


# ---- A sine of rising frequency as an input


class Spacing(Enum):
    """Spacing of the frequencies of a sweep over time."""

    LINEAR = "equal time for equal frequency differences"
    LOGARITHMIC = "equal time for equal frequency ratios"


@dataclass(frozen=True)
class Sweep:
    """A sinusoid whose frequency runs through a band, with cosine tapers at both ends.

    u = amplitude w(t) sin(phi(t)), phi(start) = 0; phi' runs from ``low`` to ``high``; w rises as
    (1 - cos)/2 over ``taper`` s and falls likewise. Zero outside ``[start, start + duration]``.

    Attributes
    ----------
    amplitude : amplitude, in the unit of the input.
    low, high : first and last frequency, rad/s, above zero; ``high`` may be below ``low``.
    duration, start, taper : s; two tapers must fit into the duration.
    spacing : whether the frequency changes linearly or logarithmically.
    """

    amplitude: float
    low: float
    high: float
    duration: float
    start: float = 0.0
    taper: float = 0.0
    spacing: Spacing = Spacing.LINEAR

    def __post_init__(self) -> None:
        if not all(
            math.isfinite(v)
            for v in (self.amplitude, self.low, self.high, self.duration, self.start, self.taper)
        ):
            raise ModelError("a number is not finite", where="sweep", remedy="give finite numbers")
        if not (self.low > 0 and self.high > 0):
            raise ModelError(
                f"band {self.low:g} to {self.high:g} rad/s",
                where="sweep",
                remedy="give positive frequencies",
            )
        if not self.duration > 0:
            raise ModelError(
                f"duration {self.duration:g} s", where="sweep", remedy="give a positive duration"
            )
        if not 0 <= self.taper <= 0.5 * self.duration:
            raise ModelError(
                f"taper {self.taper:g} s",
                where="sweep",
                remedy="give a taper between zero and half the duration",
            )

    @property
    def breakpoints(self) -> tuple[float, ...]:
        end = self.start + self.duration
        inner = (self.start + self.taper, end - self.taper) if self.taper > 0 else ()
        return tuple(sorted({self.start, *inner, end}))

    @property
    def hold(self) -> Hold:
        return Hold.LINEAR

    def __call__(self, t: Any) -> np.ndarray:
        s = np.asarray(t, dtype=float) - self.start
        return np.where(
            (s >= -SWITCH_TOLERANCE) & (s < self.duration - SWITCH_TOLERANCE), self._inside(s), 0.0
        )

    def before(self, t: Any) -> np.ndarray:
        s = np.asarray(t, dtype=float) - self.start
        return np.where(
            (s > SWITCH_TOLERANCE) & (s <= self.duration + SWITCH_TOLERANCE), self._inside(s), 0.0
        )

    def mean(self, begin: Any, end: Any) -> np.ndarray:
        """Return the mean over each interval, exact to rounding.

        It is computed by Gauss-Legendre panels that are short against the period.
        """
        begin, end = np.broadcast_arrays(
            np.asarray(begin, dtype=float), np.asarray(end, dtype=float)
        )
        panel = 0.5 / max(self.low, self.high)
        nodes, weights = np.polynomial.legendre.leggauss(_GAUSS_POINTS)
        out = np.empty(begin.shape)
        inner = np.asarray(self.breakpoints)
        for index in np.ndindex(begin.shape):
            a, b = begin[index], end[index]
            cuts = np.concatenate([[a], inner[(inner > a) & (inner < b)], [b]])
            counts = np.maximum(1, np.ceil(np.diff(cuts) / panel)).astype(int)
            edges = np.append(
                np.concatenate(
                    [
                        np.linspace(c, d, n, endpoint=False)
                        for c, d, n in zip(cuts[:-1], cuts[1:], counts, strict=True)
                    ]
                ),
                b,
            )
            half = 0.5 * np.diff(edges)
            at = (edges[:-1] + half)[:, None] + half[:, None] * nodes
            out[index] = np.sum(self(at) * weights * half[:, None]) / (b - a)
        return out

    def _inside(self, s: np.ndarray) -> np.ndarray:
        s = np.clip(s, 0.0, self.duration)
        ratio = self.high / self.low
        if self.spacing is Spacing.LINEAR:
            phase = s * (self.low + 0.5 * (self.high - self.low) * s / self.duration)
        elif ratio == 1.0:
            phase = self.low * s
        else:
            rate = math.log(ratio) / self.duration
            phase = self.low * np.expm1(rate * s) / rate
        window = np.ones_like(s)
        if self.taper > 0:
            edge = np.minimum(np.minimum(s, self.duration - s) / self.taper, 1.0)
            window = 0.5 * (1.0 - np.cos(np.pi * edge))
        return self.amplitude * window * np.sin(phase)
