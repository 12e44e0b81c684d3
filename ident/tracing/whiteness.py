"""Is what remains noise? The spectrum below 4 Hz, for every channel of every record."""

from __future__ import annotations

import numpy as np

from ident.statistics.noise_levels import levelled
from ident.statistics.residuals import LEVEL, ResidualTest
from ident.tracing import thresholds
from ident.whole_record.gauss_newton import Fit


def whiteness(fit: Fit, label: str) -> list[ResidualTest]:
    """Test of the low-frequency spectrum for every channel of every record of a fit."""
    tests = []
    many = len(fit.layout.problems) > 1
    for r, (problem, residual) in enumerate(zip(fit.layout.problems, fit.residuals, strict=True)):
        where = f", {label}{f' record {r + 1}' if many else ''}"
        for i, name in enumerate(fit.layout.system.output_names):
            if np.count_nonzero(problem.valid[i]) < thresholds.FEWEST_SAMPLES:
                continue
            series, valid = residual[i], problem.valid[i]
            tests.append(flat_spectrum(series, valid, problem.record.time, name + where))
    return tests


def is_noise(fit: Fit, least: float = LEVEL) -> bool:
    """Whether no residual test of the fitted records has a p-value of ``least`` or less."""
    return all(test.p_value > least for test in whiteness(fit, "fitted"))


def flat_spectrum(
    residual: np.ndarray, valid: np.ndarray, time: np.ndarray, channel: str
) -> ResidualTest:
    """Is the noise below 4 Hz white there? Bartlett's test of the cumulative periodogram.

    Filters of a recorder colour noise above; what a model lacks shows where the aircraft moves.
    The p-value is Kolmogorov's with the correction of [1]_.

    References
    ----------
    .. [1] M. A. Stephens, "Use of the Kolmogorov-Smirnov, Cramer-von Mises and related statistics
       without extensive tables", Journal of the Royal Statistical Society B 32, 1970.
    """
    from scipy.special import kolmogorov

    series = np.zeros(len(residual))
    series[valid] = levelled(residual[valid])
    n = len(series)
    interval = (time[-1] - time[0]) / (n - 1)
    power = np.abs(np.fft.rfft(series)) ** 2
    inside = np.fft.rfftfreq(n, interval) <= thresholds.LOW_FREQUENCY
    inside[0] = False
    found = power[inside]
    k = len(found)
    if k < 8 or not found.sum() > 0.0:
        return ResidualTest("cumulative-periodogram", channel, 0.0, 1.0, "too short to tell")
    # Of white noise the shares are those of k - 1 ordered uniform numbers.
    share = np.cumsum(found)[:-1] / found.sum()
    rank = np.arange(1, k)
    above, below = rank / (k - 1) - share, share - (rank - 1) / (k - 1)
    most = int(np.argmax(np.maximum(above, below)))
    distance = float(max(above[most], below[most]))
    # Stephens' correction of the law's argument for few numbers.
    root = np.sqrt(k - 1.0)
    p_value = float(kolmogorov((root + 0.12 + 0.11 / root) * distance))
    at = (most + 1) / (n * interval)
    sentence = (
        f"{100.0 * share[most]:.0f} % of the power below 4 Hz lies below {at:.2g} Hz, "
        f"of white noise {100.0 * (most + 1) / k:.0f} %"
    )
    return ResidualTest("cumulative-periodogram", channel, distance, p_value, sentence)
