"""Of an identification whose residual is not white: the noise of the sensors, apart from what else the fit leaves."""

from __future__ import annotations

import numpy as np

from ident.recording.series import measurable_noise
from ident.statistics.noise_levels import sensor_noise, used_runs
from scenarios.identification.result import Identification
from scenarios.terminal.display_units import shown_in, spaced

UNMEASURABLE = "not measurable from this record"


def estimated_noise(found: Identification) -> dict[str, float]:
    """Sensor noise (SI) of each output whose residual fails a test, where the high frequencies of what free simulations miss show it."""
    return {name: level for name, level in _levels(found).items() if level is not None}


def _levels(found: Identification) -> dict[str, float | None]:
    """The same with None where a record is too short, or its samples are too smooth for a sensor's; never below the rounding of a converter."""
    coloured = {test.channel.partition(",")[0] for test in found.tests if not test.passed}
    out: dict[str, float | None] = {}
    for name in found.estimate.output_names:
        runs, values = [], []
        for fit in found.fits:
            if fit.held_out or fit.figures is None or name not in coloured or name not in fit.record.output_names:
                continue
            channel = fit.record[name]
            residual = channel.values - fit.simulated[fit.outputs.index(name)]
            runs += used_runs(fit.record.time, residual, channel.valid & np.isfinite(residual))
            values.append(channel.values[channel.valid])
        if values:
            out[name] = measurable_noise(sensor_noise(runs), values)
    return out


def noise_phrase(found: Identification) -> str:
    """``"sensor noise (estimated, 1 sigma): q 0.09 deg/s"``; empty where every residual is white, and is the noise."""
    levels = []
    for name, level in _levels(found).items():
        if level is None:
            levels.append(f"{name} {UNMEASURABLE}")
            continue
        unit = next(record[name].unit for record in (found.record, *found.others) if name in record.output_names)
        factor, shown = shown_in(unit, name)
        levels.append(f"{name} {factor * level:.3g}{spaced(shown)}")
    return f"sensor noise (estimated from high frequencies, 1 sigma): {', '.join(levels)}" if levels else ""
