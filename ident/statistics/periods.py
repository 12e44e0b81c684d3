"""Periods in residuals: the updates of a held output, and the strongest oscillations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim.record import Record

_SMOOTHED_BINS = 801  # width of the smoothing window of a spectrum, in frequency bins
_SLOWEST_UPDATE_RATE = 2.0  # Hz: at lower frequencies a spectral line is motion
_MOST_PEAKS = 3  # largest number of peaks of a residual spectrum
_LEAST_PEAK_DISTANCE = 0.15  # smallest distance of two peaks, relative to the frequency


def update_period(
    times: Sequence[np.ndarray], predicted: Sequence[np.ndarray], residuals: Sequence[np.ndarray]
) -> float:
    """Return the most likely period, s, of the updates of an output that is held between updates;
    infinite where the spectrum has no line.

    The delay of a held output is a sawtooth between zero and the period. The residual of the output
    is minus the delay times its slope. The product of residual and slope therefore has a line at
    the frequency of the updates.

    Parameters
    ----------
    times : ``(N,)`` of each record, s.
    predicted, residuals : ``(N,)`` of each record, in the unit of the output.
    """
    from scipy.ndimage import uniform_filter1d

    interval = float(np.median(np.concatenate([np.diff(time) for time in times])))
    longest = max(len(time) for time in times)
    size = 8 * longest
    power = np.zeros(size // 2 + 1)
    for values, residual in zip(predicted, residuals, strict=True):
        product = residual * np.gradient(values)
        power += (
            np.abs(np.fft.rfft((product - product.mean()) * np.hanning(len(product)), size)) ** 2
        )
    frequency = np.fft.rfftfreq(size, interval)
    # The power of the maneuver decreases with frequency: a line exceeds the power around it.
    around = uniform_filter1d(power, _SMOOTHED_BINS)
    inside = (frequency > _SLOWEST_UPDATE_RATE) & (frequency < 0.5 / interval)
    height = np.where(inside, power / np.maximum(around, 1e-300), 0.0)
    at = int(np.argmax(height))
    return 1.0 / float(frequency[at]) if height[at] > 0 else np.inf


def spectral_peaks(
    records: Sequence[Record],
    residuals: Sequence[np.ndarray],
    valid: Sequence[np.ndarray],
    variance: np.ndarray,
) -> tuple[float, ...]:
    """Return up to three frequencies (rad/s) at which the normalised residuals have most power, the
    strongest first. They are at least 15 % apart.

    Missing samples count as zero. Samples are taken as evenly spaced at their mean interval.

    Parameters
    ----------
    residuals, valid : ``(m, N)`` of each record.
    variance : ``(m,)`` noise variance of each output.
    """
    peak_power: dict[float, float] = {}
    for record, residual, mask in zip(records, residuals, valid, strict=True):
        n = residual.shape[1]
        interval = float((record.time[-1] - record.time[0]) / (n - 1))
        power = np.sum(
            np.abs(np.fft.rfft(np.where(mask, residual, 0.0), axis=1)) ** 2 / variance[:, None],
            axis=0,
        )
        omega = 2.0 * np.pi * np.fft.rfftfreq(n, interval)
        smooth = np.convolve(power, [0.25, 0.5, 0.25], mode="same")
        for k in range(2, len(smooth) - 1):
            if smooth[k] >= smooth[k - 1] and smooth[k] > smooth[k + 1]:
                peak_power[float(omega[k])] = float(smooth[k]) / n
    chosen: list[float] = []
    for frequency in sorted(peak_power, key=lambda f: -peak_power[f]):
        if all(abs(frequency - other) > _LEAST_PEAK_DISTANCE * other for other in chosen):
            chosen.append(frequency)
        if len(chosen) == _MOST_PEAKS:
            break
    return tuple(chosen)
