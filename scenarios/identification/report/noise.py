"""Of an identification whose residual is not white: the noise of the sensors, apart from what else the fit leaves."""

from __future__ import annotations

import numpy as np

from ident.statistics.sensor_noise import sensor_noise, used_runs
from scenarios.identification.result import Identification
from scenarios.terminal.display_units import shown_in, spaced


def estimated_noise(found: Identification) -> dict[str, float]:
    """Sensor noise (SI) of each output whose residual fails a test, from the high frequencies of what free simulations miss."""
    coloured = {test.channel.partition(",")[0] for test in found.tests if not test.passed}
    out = {}
    for name in found.estimate.output_names:
        runs = []
        for fit in found.fits:
            if fit.held_out or fit.figures is None or name not in coloured or name not in fit.record.output_names:
                continue
            channel = fit.record[name]
            residual = channel.values - fit.simulated[fit.outputs.index(name)]
            runs += used_runs(fit.record.time, residual, channel.valid & np.isfinite(residual))
        level = sensor_noise(runs)
        if level is not None:
            out[name] = level
    return out


def noise_phrase(found: Identification) -> str:
    """``"sensor noise (estimated, 1 sigma): q 0.09 deg/s"``; empty where every residual is white, and is the noise."""
    levels = []
    for name, level in estimated_noise(found).items():
        unit = next(record[name].unit for record in (found.record, *found.others) if name in record.output_names)
        factor, shown = shown_in(unit, name)
        levels.append(f"{name} {factor * level:.3g}{spaced(shown)}")
    return f"sensor noise (estimated from high frequencies, 1 sigma): {', '.join(levels)}" if levels else ""
