"""Smoothing and slopes by polynomials fitted to a moving window of samples.

Savitzky and Golay, Analytical Chemistry 36(8), 1964, with the weights of every window formed anew, so that sampling may
be uneven and samples may be missing. At the ends of a record the window stays whole and the fit is read off its side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_EVEN = 1e-9  # of an interval, by which intervals of even sampling may differ
HALF_WIDTHS = (2, 3, 4, 6, 8, 11, 16, 23, 32, 45, 64)


@dataclass(frozen=True, eq=False)
class Windows:
    """Weights of N windows of W consecutive rows.

    Attributes
    ----------
    first : ``(N,)`` first row of each window.
    value, slope : ``(N, W)`` weights that give the fit and its derivative (1/s) at each row; zero for missing samples.
    usable : ``(N,)`` False where fewer than half the window's samples are there, or a gap stretches it to more than
        twice its usual length; its weights are then zero.
    """

    first: np.ndarray
    value: np.ndarray
    slope: np.ndarray
    usable: np.ndarray

    def gather(self, rows: np.ndarray) -> np.ndarray:
        """The entries of ``rows (N, ...)`` in each window, ``(N, W, ...)``."""
        return rows[self.first[:, None] + np.arange(self.value.shape[1])]


def windows(time: np.ndarray, valid: np.ndarray, half_width: int, degree: int) -> Windows:
    """Windows of ``2 half_width + 1`` rows about each row of ``time (N,)``, polynomials of ``degree``."""
    n = len(time)
    width = min(2 * half_width + 1, n)
    first = np.clip(np.arange(n) - half_width, 0, n - width)
    gaps = np.diff(time)
    if n > 2 * width and np.all(valid) and np.ptp(gaps) < _EVEN * gaps[0]:
        # All windows are alike but for the row that they are read at.
        few = windows(time[: 2 * width], valid[: 2 * width], half_width, degree)
        place = np.arange(n) - first
        like = np.where(place <= half_width, place, place + width)
        return Windows(first, few.value[like], few.slope[like], few.usable[like])
    rows = first[:, None] + np.arange(width)
    there = valid[rows]
    offset = time[rows] - time[:, None]
    span = np.abs(offset).max(axis=1)
    usable = there.sum(axis=1) >= max(degree + 2, (width + 1) // 2)
    usable &= (time[rows[:, -1]] - time[rows[:, 0]]) <= 2.0 * (width - 1) * float(np.median(np.diff(time)))
    powers = (offset / span[:, None])[:, :, None] ** np.arange(degree + 1) * there[:, :, None]
    normal = np.swapaxes(powers, 1, 2) @ powers
    normal[~usable] = np.eye(degree + 1)
    weights = np.linalg.solve(normal, np.swapaxes(powers, 1, 2)) * usable[:, None, None]
    slope = weights[:, 1] / span[:, None] if degree else np.zeros_like(weights[:, 0])
    return Windows(first, weights[:, 0], slope, usable)


def smoothed(time: np.ndarray, values: np.ndarray, valid: np.ndarray, half_width: int, degree: int = 2) -> np.ndarray:
    """Fit at every row, ``(N,)``; where no window is usable, linear between the samples."""
    fit = windows(time, valid, half_width, degree)
    return np.where(fit.usable, np.sum(fit.value * fit.gather(values), axis=1), np.interp(time, time[valid], values[valid]))


def half_width_by_cross_validation(time: np.ndarray, values: np.ndarray, valid: np.ndarray, degree: int = 2) -> int:
    """The half width of ``HALF_WIDTHS``, of at most a sixth of the record, that best predicts each sample from the others.

    Least mean square of (z - fit) / (1 - own weight), the residual with the sample left out (Allen 1974, Stone 1974).
    """
    best, least = HALF_WIDTHS[0], np.inf
    for half_width in HALF_WIDTHS:
        if half_width > max(len(time) // 6, HALF_WIDTHS[0]):
            break
        fit = windows(time, valid, half_width, degree)
        at = np.flatnonzero(fit.usable & valid)
        if at.size == 0:
            continue
        own = fit.value[at, at - fit.first[at]]
        left_out = (values[at] - np.sum(fit.value * fit.gather(values), axis=1)[at]) / np.maximum(1.0 - own, 1e-6)
        score = float(np.mean(left_out**2))
        if score < least:
            best, least = half_width, score
    return best
