"""Channels whose noise ends at a frequency: low-passed without phase, or resampled by Fourier transform, before they were written.

White noise of a sensor fills the spectrum up to half the sample rate, and a converter's rounding does so behind any filter. Where the
spectrum is flat up to a cutoff and empty above it, what was written is not what was sampled.
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtri

from ident.recording.finding import Certainty, Finding, Kind, Number
from ident.recording.series import Series

FEWEST, LONGEST = 256, 20_000  # samples that are needed, and looked at
EVEN = 0.02  # of the usual step, within which steps are even
BANDS = 40  # of equal width, up to half the sample rate
EMPTY = 1e-4  # of the level below the cutoff, that no band above it exceeds: noise of a hundredth of the size
# Ratio of the first empty frequency to the last flat one. Power falls by 1e-4 within 1.8 behind Butterworth filters of order
# 4 that run both ways; behind an analog filter of order 4, as recorders have against aliasing, within 3.2.
STEEP = 1.8
LEAST_FLAT, LEAST_EMPTY = 4, 4  # bands
CHANCE = 1e-3  # that a part of a flat spectrum is called uneven
WIDENED = 2.0  # frequencies of a windowed spectrum for an independent one


def band_limited(series: Series) -> Finding | None:
    """A note of a channel that has noise up to a cutoff and none above; None for any other, and where steps are uneven or few.

    A filter that falls less steeply, and a channel whose noise does not show above its motion, are not recognised.
    """
    time, values = series.time[:LONGEST], series.values[:LONGEST]
    step = np.diff(time)
    usual = float(np.median(step)) if step.size else 0.0
    if len(values) < FEWEST or np.max(np.abs(step - usual)) > EVEN * usual:
        return None
    levels, bins = _levels(values), len(values) / 2.0 / BANDS
    for flat in range(BANDS - LEAST_EMPTY - 1, 2 * LEAST_FLAT - 1, -1):
        below = levels[flat // 2 : flat]
        first = int(np.ceil(STEEP * flat))
        above = levels[min(first, BANDS - LEAST_EMPTY) :]
        if np.max(above) >= EMPTY * np.median(below) or not _flat(below, 2.0 * bins / WIDENED):
            continue
        cutoff = 0.5 * flat / BANDS / usual
        share = flat / BANDS
        told = f"has noise up to about {cutoff:.3g} Hz and none above, of {0.5 / usual:.3g} Hz that its samples could hold"
        told += f": it was filtered or resampled before it was written, and one sample in {1.0 / share:.2g} is independent"
        remedy = "export the channel as it was recorded; else residuals are not white, and sigmas for white noise too small"
        numbers = {"cutoff": Number(cutoff, "Hz")}
        return Finding(series.name, Kind.FILTERED, Certainty.NOTED, told, remedy, (), numbers)
    return None


def _levels(values: np.ndarray) -> np.ndarray:
    """Mean power of a channel in each band ``(BANDS,)``, by second differences, which take the motion down, and a window that leaks 1e-9."""
    bent = np.diff(values, 2)
    phase = 2.0 * np.pi * (np.arange(len(bent)) + 0.5) / len(bent)
    window = 0.35875 - 0.48829 * np.cos(phase) + 0.14128 * np.cos(2.0 * phase) - 0.01168 * np.cos(3.0 * phase)
    power = np.abs(np.fft.rfft(window * (bent - np.mean(bent))))[1:] ** 2
    share = np.arange(1, len(power) + 1) / len(power)
    power = power / (2.0 * np.sin(0.5 * np.pi * share)) ** 4
    band = np.minimum((BANDS * share).astype(int), BANDS - 1)
    return np.asarray(np.bincount(band, weights=power, minlength=BANDS) / np.bincount(band, minlength=BANDS))


def _flat(levels: np.ndarray, freedom: float) -> bool:
    """Whether the halves of a part of the spectrum have one level, and its first and last quarter, for the degrees of freedom of a band."""
    for count in (len(levels) // 2, max(len(levels) // 4, 1)):
        ratio = float(np.mean(levels[:count]) / np.mean(levels[-count:]))
        if max(ratio, 1.0 / ratio) > fdtri(count * freedom, count * freedom, 1.0 - CHANCE):
            return False
    return True
