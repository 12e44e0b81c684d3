"""Test of residuals for white noise: the spectrum below 4 Hz, for every channel of every record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.recording.series import measurable_noise
from ident.statistics.noise_levels import sensor_noise, used_runs
from ident.statistics.residuals import (
    WHITENESS_P_VALUE,
    NoiseBurst,
    ResidualTest,
    flat_spectrum,
    largest_burst,
)
from ident.tracing.diagnosis import FittedRecord
from ident.whole_record.gauss_newton import Fit

FITTED, HELD_OUT = "fitted", "held out"  # labels of residuals
FEWEST_SAMPLES = 20  # with fewer the test has four lags at most, and little power


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


# ---- Bursts of noise


def noise_bursts(fit: Fit, label: str, tests: Sequence[ResidualTest]) -> list[NoiseBurst]:
    """Return the significant bursts of a fit: at most one for each channel with white residual in
    each record.

    ``tests`` : residual tests of the fit, of the same ``label`` (``whiteness``).
    """
    white = {test.channel for test in tests if test.passed}
    found = (
        largest_burst(residual[valid], time[valid], channel)
        for channel, residual, valid, time in _labelled(fit, label)
        if channel in white
    )
    return [burst for burst in found if burst is not None]


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
