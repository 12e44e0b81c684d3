"""Is what remains noise? The spectrum below 4 Hz, for every channel of every record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.recording.series import measurable_noise
from ident.statistics.noise_levels import levelled, sensor_noise, used_runs
from ident.statistics.residuals import WHITENESS_P_VALUE, ResidualTest
from ident.tracing.diagnosis import FittedRecord
from ident.whole_record.gauss_newton import Fit

FEWEST_SAMPLES = 20  # with fewer the test has four lags at most, and little power
LOW_FREQUENCY = 4.0  # Hz: short periods and first elastic modes of piloted aircraft lie below


def whiteness(fit: Fit, label: str) -> list[ResidualTest]:
    """Test of the low-frequency spectrum for every channel of every record of a fit."""
    tests = []
    many = len(fit.layout.problems) > 1
    for r, (problem, residual) in enumerate(zip(fit.layout.problems, fit.residuals, strict=True)):
        where = f", {label}{f' record {r + 1}' if many else ''}"
        for i, name in enumerate(fit.layout.system.output_names):
            if np.count_nonzero(problem.valid[i]) < FEWEST_SAMPLES:
                continue
            series, valid = residual[i], problem.valid[i]
            tests.append(flat_spectrum(series, valid, problem.record.time, name + where))
    return tests


def is_noise(fit: Fit, least: float = WHITENESS_P_VALUE) -> bool:
    """Return whether no residual test of the fitted records has a p-value of ``least`` or less."""
    return all(test.p_value > least for test in whiteness(fit, "fitted"))


def flat_spectrum(
    residual: np.ndarray, valid: np.ndarray, time: np.ndarray, channel: str
) -> ResidualTest:
    """Test whether the noise below 4 Hz is white there, by Bartlett's test of the cumulative
    periodogram.

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
    inside = np.fft.rfftfreq(n, interval) <= LOW_FREQUENCY
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


# ---- Sensor noise that residuals show

RUNAWAY_RESIDUAL = 1e30  # what a residual that has run away counts as: its square is finite


def noise_floors(
    fitted: Sequence[FittedRecord], tests: Sequence[ResidualTest], levels: Mapping[str, float]
) -> dict[str, float]:
    """Sensor noise by channel: the fit's own ``levels`` where its residual is white, else that of
    the residual's high frequencies.

    A residual that shows none keeps its level; no noise is larger than it, or smaller than the
    rounding of the channel's converter.
    """
    coloured = {test.channel.partition(",")[0] for test in tests if not test.passed}
    out = dict(levels)
    for name in coloured & set(levels):
        parts = [
            residual_part(item, name)
            for item in fitted
            if name in item.channels and name in item.record.output_names
        ]
        runs = [
            run
            for part in parts
            for run in used_runs(part.item.record.time, part.residual, part.used)
        ]
        found = measurable_noise(
            sensor_noise(runs),
            [part.item.record[name].values[part.item.record[name].valid] for part in parts],
        )
        out[name] = min(levels[name], found) if found is not None else levels[name]
    return out


def noise_shown(fit: Fit, name: str) -> float | None:
    """Sensor noise that high frequencies of a fit's residuals of one output show; None where they
    tell none.
    """
    i = fit.layout.system.output_names.index(name)
    each = zip(fit.layout.problems, fit.residuals, strict=True)
    return sensor_noise(
        [
            run
            for problem, residual in each
            for run in used_runs(problem.record.time, residual[i], problem.valid[i])
        ]
    )


@dataclass(frozen=True, eq=False)
class ResidualPart:
    """Residual of one channel in one record ``(N,)``, zero where unused, with the mean taken
    off.
    """

    item: FittedRecord
    residual: np.ndarray
    used: np.ndarray

    @property
    def interval(self) -> float:
        time = self.item.record.time
        return float(time[-1] - time[0]) / (len(time) - 1)


def residual_part(item: FittedRecord, channel: str) -> ResidualPart:
    row = item.channels.index(channel)
    used = item.used[row] & item.record[channel].valid & np.isfinite(item.after[row])
    residual = np.clip(np.where(used, item.after[row], 0.0), -RUNAWAY_RESIDUAL, RUNAWAY_RESIDUAL)
    mean = float(residual[used].mean()) if np.any(used) else 0.0
    return ResidualPart(item, np.where(used, residual - mean, 0.0), used)
