"""Test of residuals for white noise: the spectrum below 4 Hz, for every channel of every record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.recording.series import measurable_noise
from ident.statistics.noise_levels import levelled, robust_sigma, sensor_noise, used_runs
from ident.statistics.residuals import WHITENESS_P_VALUE, ResidualTest
from ident.tracing.diagnosis import FittedRecord
from ident.whole_record.gauss_newton import Fit

FITTED, HELD_OUT = "fitted", "held out"  # labels of residuals
FEWEST_SAMPLES = 20  # with fewer the test has four lags at most, and little power
LOW_FREQUENCY = 4.0  # Hz: short periods and first elastic modes of piloted aircraft lie below


def whiteness(fit: Fit, label: str) -> list[ResidualTest]:
    """Test of the low-frequency spectrum for every channel of every record of a fit."""
    return [
        flat_spectrum(residual, valid, time, channel)
        for channel, residual, valid, time in _labelled(fit, label)
        if np.count_nonzero(valid) >= FEWEST_SAMPLES
    ]


def _labelled(fit: Fit, label: str) -> Iterator[tuple[str, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield name, residual ``(N,)``, valid samples ``(N,)`` and time ``(N,)`` of every channel of
    every record.
    """
    many = len(fit.layout.problems) > 1
    for r, (problem, residual) in enumerate(zip(fit.layout.problems, fit.residuals, strict=True)):
        where = f", {label}{f' record {r + 1}' if many else ''}"
        for i, name in enumerate(fit.layout.system.output_names):
            yield name + where, residual[i], problem.valid[i], problem.record.time


def is_noise(fit: Fit, least: float = WHITENESS_P_VALUE) -> bool:
    """Return whether no residual test of the fitted records has a p-value of ``least`` or less."""
    return all(test.p_value > least for test in whiteness(fit, FITTED))


def flat_spectrum(
    residual: np.ndarray, valid: np.ndarray, time: np.ndarray, channel: str
) -> ResidualTest:
    """Test whether the noise below 4 Hz is white, by Bartlett's test of the cumulative periodogram.

    Recorders' filters colour the noise above; errors of a model appear at the frequencies of the
    motion. The p-value is Kolmogorov's with the correction of [1]_.

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
    # For white noise the shares are k - 1 ordered uniform numbers.
    share = np.cumsum(found)[:-1] / found.sum()
    rank = np.arange(1, k)
    above, below = rank / (k - 1) - share, share - (rank - 1) / (k - 1)
    most = int(np.argmax(np.maximum(above, below)))
    distance = float(max(above[most], below[most]))
    # Stephens' correction for few numbers.
    root = np.sqrt(k - 1.0)
    p_value = float(kolmogorov((root + 0.12 + 0.11 / root) * distance))
    at = (most + 1) / (n * interval)
    sentence = (
        f"{100.0 * share[most]:.0f} % of the power below 4 Hz lies below {at:.2g} Hz, "
        f"of white noise {100.0 * (most + 1) / k:.0f} %"
    )
    return ResidualTest("cumulative-periodogram", channel, distance, p_value, sentence)


# ---- Bursts of noise

BURST_BLOCK = 0.5  # s


@dataclass(frozen=True)
class NoiseBurst:
    """An interval in which the residual of a channel is louder than in the rest of its record.

    ``channel`` : with the record, as in residual tests. ``begin``, ``end`` : s. ``ratio`` : of the
    standard deviations. ``p_value`` : of its loudest half second.
    """

    channel: str
    begin: float
    end: float
    ratio: float
    p_value: float


def noise_bursts(fit: Fit, label: str, tests: Sequence[ResidualTest]) -> list[NoiseBurst]:
    """Return the significant bursts of a fit: at most one for each channel with white residual in
    each record.

    ``tests`` : residual tests of the fit, of the same ``label`` (``whiteness``).
    """
    white = {test.channel for test in tests if test.passed}
    found = (
        loudest_spell(residual[valid], time[valid], channel)
        for channel, residual, valid, time in _labelled(fit, label)
        if channel in white
    )
    return [burst for burst in found if burst is not None]


def loudest_spell(residual: np.ndarray, time: np.ndarray, channel: str) -> NoiseBurst | None:
    """Return the half seconds in which a residual ``(N,)`` is louder than the median; None where
    chance explains the loudest.

    Variances of half seconds are compared by the F distribution. Squares of filtered noise are
    correlated, which lowers the degrees of freedom.
    """
    from scipy.special import fdtrc

    size = max(10, round(BURST_BLOCK * (len(time) - 1) / (time[-1] - time[0])))
    count = len(residual) // size
    if count < 4:
        return None
    squares = ((residual - residual.mean()) ** 2)[: count * size].reshape(count, size)
    blocks = squares.mean(axis=1)
    # Degrees of freedom for correlated squares: from lag one within blocks, and from the robust
    # scatter of the logarithms (variance 2 over the degrees of freedom).
    around = squares / np.maximum(blocks[:, None], 1e-300) - 1.0
    alike = np.mean(around[:, 1:] * around[:, :-1]) / max(float(np.mean(around**2)), 1e-300)
    alike = np.clip(alike + 1.0 / size, 0.0, 0.9)
    scatter = robust_sigma(np.log(np.maximum(blocks, 1e-300)))
    freedom = min(size * (1.0 - alike) / (1.0 + alike), 2.0 / max(scatter**2, 1e-300))
    ratios = blocks / max(float(np.median(blocks)), 1e-300)
    p_values = np.minimum(1.0, count * fdtrc(freedom, freedom * count / 2.0, ratios))
    loudest = int(np.argmax(ratios))
    if not p_values[loudest] < WHITENESS_P_VALUE:
        return None
    first = last = loudest
    while first > 0 and p_values[first - 1] < 0.5:
        first -= 1
    while last < count - 1 and p_values[last + 1] < 0.5:
        last += 1
    return NoiseBurst(
        channel,
        float(time[first * size]),
        float(time[min((last + 1) * size, len(time)) - 1]),
        float(np.sqrt(ratios[first : last + 1].mean())),
        float(p_values[loudest]),
    )


# ---- Sensor noise from residuals

RUNAWAY_RESIDUAL = 1e30  # value of a divergent residual: its square is finite


def noise_floors(
    fitted: Sequence[FittedRecord], tests: Sequence[ResidualTest], levels: Mapping[str, float]
) -> dict[str, float]:
    """Return the sensor noise by channel: the fit's own ``levels`` where its residual is white,
    else that of the residual's high frequencies.

    Without high-frequency noise the residual's level is used. The result lies between the rounding
    of the converter and the residual's level.
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
    """Return the sensor noise from high frequencies of the residuals of one output; None if
    undetermined.
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
    """Residual of one channel in one record ``(N,)``, zero where unused, with its mean removed."""

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
