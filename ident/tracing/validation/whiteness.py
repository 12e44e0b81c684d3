"""Is what remains noise? Ljung-Box and the power at low frequencies, for every channel of every
record.
"""

from __future__ import annotations

import numpy as np

from ident.statistics.noise_levels import levelled
from ident.statistics.residuals import ResidualTest, ljung_box
from ident.tracing import thresholds
from ident.whole_record.gauss_newton import Fit


def whiteness(fit: Fit, label: str) -> list[ResidualTest]:
    """Ljung-Box and low-frequency power of every channel of every record of a fit."""
    tests = []
    many = len(fit.layout.problems) > 1
    for r, (problem, residual) in enumerate(zip(fit.layout.problems, fit.residuals, strict=True)):
        where = f", {label}{f' record {r + 1}' if many else ''}"
        for i, name in enumerate(fit.layout.system.output_names):
            if np.count_nonzero(problem.valid[i]) < thresholds.FEWEST_SAMPLES:
                continue
            box = ljung_box(residual[i], problem.valid[i], name + where)
            tests += [
                box,
                low_frequency_power(
                    residual[i], problem.valid[i], problem.record.time, name + where
                ),
            ]
    return tests


def is_white(fit: Fit, least: float = thresholds.COLOURED) -> bool:
    """Whether no channel of any record shows correlation: no p-value of Ljung-Box below
    ``least``.
    """
    for problem, residual in zip(fit.layout.problems, fit.residuals, strict=True):
        for i, name in enumerate(fit.layout.system.output_names):
            enough = np.count_nonzero(problem.valid[i]) >= thresholds.FEWEST_SAMPLES
            if enough and ljung_box(residual[i], problem.valid[i], name).p_value <= least:
                return False
    return True


def low_frequency_power(
    residual: np.ndarray, valid: np.ndarray, time: np.ndarray, channel: str
) -> ResidualTest:
    """Is there more power below 4 Hz than white noise of the same total has? Chi-squared of the
    periodogram's sum.
    """
    from scipy.special import betainc

    series = np.zeros(len(residual))
    series[valid] = levelled(residual[valid])
    n = len(series)
    interval = (time[-1] - time[0]) / (n - 1)
    power = np.abs(np.fft.rfft(series)) ** 2
    low = np.fft.rfftfreq(n, interval) <= thresholds.LOW_FREQUENCY
    low[0] = False
    k, rest = int(low.sum()), int((~low).sum()) - 1
    if k < 3 or rest < 3:
        return ResidualTest(
            "low-frequency-power", channel, 1.0, 1.0, "the whole band lies below 4 Hz"
        )
    share = float(power[low].sum() / max(power[1:].sum(), 1e-300))
    # Sums of independent exponentials: the share is beta distributed.
    p_value = float(1.0 - betainc(k, rest, min(share, 1.0)))
    ratio = share * (k + rest) / k
    return ResidualTest(
        "low-frequency-power",
        channel,
        ratio,
        max(p_value, 0.0),
        f"{ratio:.2f} times the power of white noise below 4 Hz",
    )
