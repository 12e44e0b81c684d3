"""Smooth maneuvers that spread their energy over a band: frequency sweep and orthogonal multisines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.errors import ModelError
from sim.maneuvers.steps import SWITCH_TOLERANCE
from sim.record import Hold

_GAUSS_POINTS = 8
_FINE = 32  # points in a period of the highest harmonic, where peaks are looked for
_CLIPPINGS = 200
_LEVELS = (0.75, 0.99)  # of the peak, at which the first and the last clipping cut


@dataclass(frozen=True)
class Multisine:
    """A sum of harmonics of one period, repeated a whole number of times.

    u = sum_i amplitudes_i cos(2 pi harmonics_i (t - start) / period + phases_i) on
    ``[start, start + cycles period]``, zero outside. Disjoint harmonics are orthogonal over a period.
    """

    period: float
    harmonics: tuple[int, ...]
    amplitudes: tuple[float, ...]
    phases: tuple[float, ...]
    start: float = 0.0
    cycles: int = 1

    def __post_init__(self) -> None:
        if not (self.period > 0 and math.isfinite(self.period)):
            raise _bad("multisine", f"period {self.period:g} s", "give a positive period")
        if not self.harmonics or len({len(self.harmonics), len(self.amplitudes), len(self.phases)}) != 1:
            raise _bad("multisine", "harmonics, amplitudes and phases differ in number, or there are none", "give each harmonic one of both")
        if any(harmonic < 1 or harmonic != int(harmonic) for harmonic in self.harmonics) or len(set(self.harmonics)) != len(self.harmonics):
            raise _bad("multisine", f"harmonics {list(self.harmonics)}", "give different whole numbers from 1 on")
        if not all(math.isfinite(v) for v in (*self.amplitudes, *self.phases, self.start)):
            raise _bad("multisine", "a number is not finite", "give finite numbers")
        if self.cycles < 1 or self.cycles != int(self.cycles):
            raise _bad("multisine", f"{self.cycles} cycles", "give a whole number of cycles, at least one")

    @property
    def end(self) -> float:
        """Time at which it is over, s."""
        return self.start + self.cycles * self.period

    @property
    def breakpoints(self) -> tuple[float, ...]:
        return (self.start, self.end)

    @property
    def hold(self) -> Hold:
        return Hold.LINEAR

    def __call__(self, t: Any) -> np.ndarray:
        t = np.asarray(t, dtype=float)
        return np.where((t >= self.start - SWITCH_TOLERANCE) & (t < self.end - SWITCH_TOLERANCE), self._inside(t), 0.0)

    def before(self, t: Any) -> np.ndarray:
        t = np.asarray(t, dtype=float)
        return np.where((t > self.start + SWITCH_TOLERANCE) & (t <= self.end + SWITCH_TOLERANCE), self._inside(t), 0.0)

    def mean(self, begin: Any, end: Any) -> np.ndarray:
        """Mean over each interval: a harmonic's mean is its value at the middle times sin(x)/x of half its phase advance."""
        begin, end = np.broadcast_arrays(np.asarray(begin, dtype=float), np.asarray(end, dtype=float))
        a, b = np.clip(begin, self.start, self.end), np.clip(end, self.start, self.end)
        middle, width = 0.5 * (a + b), b - a
        total = np.zeros(begin.shape)
        for harmonic, amplitude, phase in zip(self.harmonics, self.amplitudes, self.phases, strict=True):
            omega = 2.0 * math.pi * harmonic / self.period
            total += amplitude * np.cos(omega * (middle - self.start) + phase) * np.sinc(omega * width / (2.0 * math.pi))
        return total * width / (end - begin)

    def _inside(self, t: np.ndarray) -> np.ndarray:
        total = np.zeros(t.shape)
        for harmonic, amplitude, phase in zip(self.harmonics, self.amplitudes, self.phases, strict=True):
            total += amplitude * np.cos(2.0 * math.pi * harmonic * (t - self.start) / self.period + phase)
        return total


def schroeder_multisine(rms: float, period: float, harmonics: Sequence[int], start: float = 0.0, cycles: int = 1) -> Multisine:
    """A multisine of equal amplitudes with Schroeder's phases, shifted in time so that it begins and ends at zero.

    phase_i = -pi i (i - 1) / n keeps the peaks low (Schroeder, IEEE Trans. Information Theory 16(1), 1970).
    ``rms`` in the input's unit over a period, ``period`` and ``start`` in s.
    """
    count = len(harmonics)
    if not (math.isfinite(rms) and count):
        raise _bad("multisine", f"rms {rms} over {count} harmonic(s)", "give a finite rms and at least one harmonic")
    phases = [-math.pi * i * (i - 1) / count for i in range(1, count + 1)]
    amplitude = rms * math.sqrt(2.0 / count)
    plain = Multisine(period, tuple(harmonics), (amplitude,) * count, tuple(phases), 0.0)
    shift = _first_zero(plain)
    turned = tuple(phase + 2.0 * math.pi * harmonic * shift / period for harmonic, phase in zip(harmonics, phases, strict=True))
    return Multisine(period, tuple(harmonics), (amplitude,) * count, turned, start, cycles)


def orthogonal_multisines(
    rms: Sequence[float], period: float, lowest: int, highest: int, start: float = 0.0, cycles: int = 1
) -> tuple[Multisine, ...]:
    """One multisine an input, harmonics ``lowest`` to ``highest`` dealt out in turn, hence mutually orthogonal over a period.

    Raises ModelError when an input would be left without a harmonic.
    """
    if highest - lowest + 1 < len(rms):
        raise _bad("multisine", f"harmonics {lowest} to {highest} for {len(rms)} inputs", "give at least one harmonic an input")
    dealt = [range(lowest + i, highest + 1, len(rms)) for i in range(len(rms))]
    return tuple(schroeder_multisine(level, period, list(own), start, cycles) for level, own in zip(rms, dealt, strict=True))


def least_peak_multisine(
    rms: float,
    period: float,
    harmonics: Sequence[int],
    start: float = 0.0,
    cycles: int = 1,
    shares: Sequence[float] | None = None,
) -> Multisine:
    """``schroeder_multisine`` with its phases improved until the peaks hardly fall any more.

    ``shares`` : relative amplitudes of the harmonics; None for equal ones.

    Peaks are clipped and the phases of what is left kept, the clipping ever slighter (Van der Ouderaa, Schoukens and Renneboog, IEEE Trans.
    Instrumentation and Measurement 37(1), 1988); of all that was passed the lowest peak is taken, so it is never above Schroeder's.
    """
    first = schroeder_multisine(rms, period, harmonics, 0.0)
    at, count = np.asarray(first.harmonics), _FINE * max(first.harmonics)
    size, phases = np.asarray(first.amplitudes), np.asarray(first.phases)
    if shares is not None:
        relative = np.asarray(shares, dtype=float)
        if relative.shape != size.shape or not (np.all(np.isfinite(relative)) and np.all(relative > 0.0)):
            raise _bad("multisine", f"shares {list(shares)}", "give one above zero for each harmonic")
        size = size * relative * math.sqrt(size.size / float(relative @ relative))
    best, lowest = phases, math.inf
    for step in range(_CLIPPINGS):
        spectrum = np.zeros(count // 2 + 1, dtype=complex)
        spectrum[at] = 0.5 * count * size * np.exp(1j * phases)
        u = np.fft.irfft(spectrum, count)
        peak = float(np.max(np.abs(u)))
        if peak < lowest:
            best, lowest = phases, peak
        level = peak * (_LEVELS[0] + (_LEVELS[1] - _LEVELS[0]) * step / _CLIPPINGS)
        phases = np.angle(np.fft.rfft(np.clip(u, -level, level))[at])
    amplitudes = tuple(size.tolist())
    plain = Multisine(period, first.harmonics, amplitudes, tuple(best.tolist()), 0.0)
    shift = _first_zero(plain)
    turned = tuple(phase + 2.0 * math.pi * harmonic * shift / period for harmonic, phase in zip(first.harmonics, best.tolist(), strict=True))
    return Multisine(period, first.harmonics, amplitudes, turned, start, cycles)


def peak_factor(multisine: Multisine) -> float:
    """Largest magnitude over root mean square, of a sine the root of two."""
    t = np.arange(_FINE * max(multisine.harmonics)) * multisine.period / (_FINE * max(multisine.harmonics))
    u = multisine._inside(t)
    return float(np.max(np.abs(u)) / np.sqrt(np.mean(u**2)))


def _first_zero(multisine: Multisine) -> float:
    """First upward zero of a multisine within its period, s, by bisection; it has zero mean, so there is one."""
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


def _bad(where: str, what: str, remedy: str) -> ModelError:
    return ModelError(what, where=where, remedy=remedy)
