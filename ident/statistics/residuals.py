"""Are residuals or innovations what the noise alone would give? Two first tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.estimate import Estimate, FilterHistory
from ident.statistics.local_level import levelled
from ident.statistics.robust import robust_sigma_about_zero

FAR_ABOVE = 2.0  # chosen: of a channel's own noise, from which a residual is not called noise


@dataclass(frozen=True)
class ResidualTest:
    """One test: its statistic, the p-value under white Gaussian noise, and what it looked at."""

    name: str
    channel: str
    statistic: float
    p_value: float
    sentence: str

    @property
    def passed(self) -> bool:
        """True where noise alone gives such a statistic more often than once in a thousand records."""
        return self.p_value > 1e-3


def ljung_box(residual: np.ndarray, valid: np.ndarray, channel: str, lags: int = 25) -> ResidualTest:
    """Whiteness of a series ``(N,)`` over ``lags`` lags (Ljung and Box, Biometrika 65(2), 1978); missing samples are skipped.

    Where the level of the noise changes along the series it is divided out first (``levelled``). The p-value is that of a shifted gamma
    distribution with the mean, variance and skewness that the statistic has on records of this length: chi-squared, its limit, calls white
    noise of 300 samples coloured seven times too often at 1e-4.
    """
    n = int(np.count_nonzero(valid))
    series = levelled(residual[valid])
    series = series - (series.mean() if n else 0.0)
    lags = max(1, min(lags, n // 5))
    power = float(series @ series)
    if n < 10 or power == 0.0:
        return ResidualTest("ljung-box", channel, 0.0, 1.0, "too few samples to tell")
    r = np.array([series[lag:] @ series[: n - lag] for lag in range(1, lags + 1)]) / power
    statistic = float(n * (n + 2) * np.sum(r**2 / (n - np.arange(1, lags + 1))))
    p_value = _ljung_box_tail(statistic, lags, n)
    sentence = f"{'white' if p_value > 1e-3 else 'not white'} over {lags} lags, lag-1 correlation {r[0]:.2f}"
    return ResidualTest("ljung-box", channel, statistic, p_value, sentence)


def _ljung_box_tail(statistic: float, lags: int, n: int) -> float:
    """Probability of a larger statistic on white noise; the terms in lags/n are fitted to simulated noise of 60 to 3000 samples."""
    from scipy.special import chdtrc

    variance, skewness = 2.0 * lags * (1.0 + 1.8 * lags / n), np.sqrt(8.0 / lags) * (1.0 + 5.5 * lags / n)
    degrees = 8.0 / skewness**2
    scale = np.sqrt(variance / (2.0 * degrees))
    return float(chdtrc(degrees, max(0.0, (statistic - lags) / scale + degrees)))


def residual_size(residual: np.ndarray, valid: np.ndarray, channel: str) -> ResidualTest | None:
    """A failed test where a series ``(N,)`` is far larger than its own noise: wild points are white, and no noise; None where it is not.

    Its root mean square against the robust standard deviation, whose logarithm scatters by 0.93/sqrt(N) on Gaussian noise.
    """
    from scipy.special import erfc

    series = levelled(residual[valid])
    n = len(series)
    usual = robust_sigma_about_zero(series) if n >= 10 else 0.0
    ratio = float(np.sqrt(np.mean(series**2))) / usual if usual > 0.0 else 0.0
    if ratio < FAR_ABOVE:
        return None
    p_value = float(erfc(np.log(ratio) * np.sqrt(n / 2.0) / 0.93))
    return ResidualTest("size", channel, ratio, p_value, f"{ratio:.3g} times as large as its own noise: a few samples are far off")


def innovation_size(history: FilterHistory) -> ResidualTest:
    """Summed normalised innovation squared against chi-squared, both sides: are the filter's own sigmas right?"""
    from scipy.special import chdtr, chdtrc

    total, degrees = float(history.nis.sum()), int(history.degrees.sum())
    if degrees == 0:
        return ResidualTest("nis", "all", 0.0, 1.0, "no sample was used")
    p_value = float(min(1.0, 2.0 * min(chdtr(degrees, total), chdtrc(degrees, total))))
    ratio = total / degrees
    return ResidualTest("nis", "all", total, p_value, f"innovations are {np.sqrt(ratio):.3f} times the size that the filter expects")


def residual_tests(estimate: Estimate, residuals: np.ndarray, valid: np.ndarray) -> tuple[ResidualTest, ...]:
    """All tests of an estimate: innovations of a filter, else the residuals ``(m, N)`` of a whole-record fit."""
    history = estimate.history
    if history is None:
        rows = [(residuals[i], valid[i]) for i in range(len(residuals))]
    else:
        rows = [(history.innovation[i] / history.innovation_std[i], history.valid[i]) for i in range(len(history.innovation))]
    tests = [ljung_box(row, mask, name) for (row, mask), name in zip(rows, estimate.output_names, strict=True) if np.any(mask)]
    tests += [found for (row, mask), name in zip(rows, estimate.output_names, strict=True) if (found := residual_size(row, mask, name)) is not None]
    return tuple(tests) if history is None else (*tests, innovation_size(history))
