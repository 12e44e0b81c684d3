"""A sine of rising frequency as an input."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from sim.maneuvers.multisine import _GAUSS_POINTS, _bad
from sim.maneuvers.steps import SWITCH_TOLERANCE
from sim.record import Hold


class Spacing(Enum):
    """How a sweep passes through its frequencies."""

    LINEAR = "equal time for equal frequency differences"
    LOGARITHMIC = "equal time for equal frequency ratios"


@dataclass(frozen=True)
class Sweep:
    """A sinusoid whose frequency runs through a band, with cosine tapers at both ends.

    u = amplitude w(t) sin(phi(t)), phi(start) = 0; phi' runs from ``low`` to ``high``; w rises as
    (1 - cos)/2 over ``taper`` s and falls likewise. Zero outside ``[start, start + duration]``.

    Attributes
    ----------
    amplitude : in the input's unit.
    low, high : rad/s, ``0 < low``; ``high`` may lie below ``low``.
    duration, start, taper : s; two tapers fit into the duration.
    """

    amplitude: float
    low: float
    high: float
    duration: float
    start: float = 0.0
    taper: float = 0.0
    spacing: Spacing = Spacing.LINEAR

    def __post_init__(self) -> None:
        if not all(math.isfinite(v) for v in (self.amplitude, self.low, self.high, self.duration, self.start, self.taper)):
            raise _bad("sweep", "a number is not finite", "give finite numbers")
        if not (self.low > 0 and self.high > 0):
            raise _bad("sweep", f"band {self.low:g} to {self.high:g} rad/s", "give positive frequencies")
        if not self.duration > 0:
            raise _bad("sweep", f"duration {self.duration:g} s", "give a positive duration")
        if not 0 <= self.taper <= 0.5 * self.duration:
            raise _bad("sweep", f"taper {self.taper:g} s", "give a taper between zero and half the duration")

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
        return np.where((s >= -SWITCH_TOLERANCE) & (s < self.duration - SWITCH_TOLERANCE), self._inside(s), 0.0)

    def before(self, t: Any) -> np.ndarray:
        s = np.asarray(t, dtype=float) - self.start
        return np.where((s > SWITCH_TOLERANCE) & (s <= self.duration + SWITCH_TOLERANCE), self._inside(s), 0.0)

    def mean(self, begin: Any, end: Any) -> np.ndarray:
        """Mean over each interval by Gauss-Legendre panels short against the period: exact to rounding."""
        begin, end = np.broadcast_arrays(np.asarray(begin, dtype=float), np.asarray(end, dtype=float))
        panel = 0.5 / max(self.low, self.high)
        nodes, weights = np.polynomial.legendre.leggauss(_GAUSS_POINTS)
        out = np.empty(begin.shape)
        inner = np.asarray(self.breakpoints)
        for index in np.ndindex(begin.shape):
            a, b = begin[index], end[index]
            cuts = np.concatenate([[a], inner[(inner > a) & (inner < b)], [b]])
            counts = np.maximum(1, np.ceil(np.diff(cuts) / panel)).astype(int)
            edges = np.append(np.concatenate([np.linspace(c, d, n, endpoint=False) for c, d, n in zip(cuts[:-1], cuts[1:], counts, strict=True)]), b)
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
