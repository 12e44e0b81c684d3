"""Sensor noise that the residuals of a fit show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.recording.series import measurable_noise
from ident.statistics.noise_levels import sensor_noise, used_runs
from ident.statistics.residuals import ResidualTest
from ident.tracing.diagnosis import FittedRecord
from ident.whole_record.gauss_newton import Fit

LARGEST = 1e30  # what a residual that has run away counts as: its square is finite


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
    residual = np.clip(np.where(used, item.after[row], 0.0), -LARGEST, LARGEST)
    mean = float(residual[used].mean()) if np.any(used) else 0.0
    return ResidualPart(item, np.where(used, residual - mean, 0.0), used)
