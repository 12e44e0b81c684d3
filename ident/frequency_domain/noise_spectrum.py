"""The noise of each output along the frequency: one level for all, or one for each of some bands where one will not do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

SURE = 1e-3  # probability, over all outputs, below which one level is not believed
FEWEST = 12  # harmonics of a band: its level is then known to 20 %
MOST = 6  # bands: the noise of a sensor or of slow turbulence changes by decades, not from line to line
REACH = 3  # harmonics on either side that tell the level about one: seven give it to 40 %, which a sum over all averages out


def one_band(count: int) -> np.ndarray:
    """Band of each of ``count`` frequencies: the same."""
    return np.zeros(count, dtype=int)


def equal_bands(omegas: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Band of each frequency of each record, so that each holds as many of all of them; as many bands as ``FEWEST`` and ``MOST`` allow."""
    every = np.sort(np.concatenate(omegas))
    count = int(np.clip(len(every) // FEWEST, 1, MOST))
    edges = every[[round(k * len(every) / count) for k in range(1, count)]]
    return [np.searchsorted(edges, omega, side="right") for omega in omegas]


def levels(
    residuals: Sequence[np.ndarray], known: Sequence[np.ndarray], bands: Sequence[np.ndarray], floor: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean square of the residuals ``(m, f)`` by output and band, ``(m, b)``, not below ``floor (m,)``, and how many there are."""
    width = 1 + max(int(np.max(band)) for band in bands)
    total, count = np.zeros((len(floor), width)), np.zeros((len(floor), width))
    for residual, measured, band in zip(residuals, known, bands, strict=True):
        for b in range(width):
            total[:, b] += np.where(measured, np.sum(np.abs(residual[:, band == b]) ** 2, axis=1), 0.0)
            count[:, b] += np.where(measured, np.count_nonzero(band == b), 0.0)
    return np.where(count > 0, np.maximum(total / np.maximum(count, 1.0), floor[:, None]), 1.0), count


def coloured(residuals: Sequence[np.ndarray], known: Sequence[np.ndarray], bands: Sequence[np.ndarray], floor: np.ndarray) -> bool:
    """Whether the bands' levels differ by more than chance, in any output.

    Squares of transforms of noise are exponential, so twice the log likelihood ratio of one level to several is chi-squared with as
    many degrees as there are further levels.
    """
    from scipy.special import gammaincc  # scipy.stats takes half a second to load

    apart, count = levels(residuals, known, bands, floor)
    together, _ = levels(residuals, known, [np.zeros_like(band) for band in bands], floor)
    degrees = apart.shape[1] - 1
    if degrees == 0:
        return False
    told = np.flatnonzero(count.sum(axis=1) > 0)
    ratio = 2.0 * np.sum(count[told] * np.log(together[told] / apart[told]), axis=1)
    return bool(np.min(gammaincc(0.5 * degrees, 0.5 * np.maximum(ratio, 0.0)), initial=1.0) * max(len(told), 1) < SURE)


def about_each(power: np.ndarray) -> np.ndarray:
    """Means of the powers, or cross powers, ``(k, f)`` over the neighbours of each frequency."""
    width = min(2 * REACH + 1, power.shape[1])
    kernel = np.ones(width)
    count = np.convolve(np.ones(power.shape[1]), kernel, mode="same")
    return np.array([np.convolve(row, kernel, mode="same") for row in power]) / count
