"""States that a record shows: those measured, and those that are the rate of a measured one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.regression.local_polynomial import windows
from ident.regression.state_histories import rate_relations
from sim.declaration.model import System
from sim.record import Record

SPAN = 60  # a slope is taken over two sixtieths of the record


def known_states(record: Record, system: System, p: Sequence[float] | np.ndarray | None = None) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Position of a state -> times ``(k,)`` and values ``(k,)``; good enough to begin a fit with.

    Of a measured state the bias of its sensor is taken off, at parameters ``p`` (the System's own when None). Slopes are those of
    straight lines over a window, after a running median of five against spikes.
    """
    names = system.state_names
    found: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    for i, name in enumerate(names):
        if name in record.output_names:
            channel = record[name]
            found[i] = record.time[channel.valid], channel.values[channel.valid] - _bias(system, name, p)
    if len(found) in (0, len(names)):
        return found
    for source, rate in rate_relations(system, record.time).items():
        i, j = names.index(source), names.index(rate)
        if i in found and j not in found and len(found[i][0]) > 12:
            time, values = found[i]
            padded = np.pad(values, 2, mode="edge")
            calm = np.median([padded[k : k + len(values)] for k in range(5)], axis=0)
            fit = windows(time, np.ones(len(time), dtype=bool), max(3, len(time) // SPAN), 1)
            slope = np.sum(fit.slope * fit.gather(calm), axis=1)
            found[j] = time[fit.usable], slope[fit.usable]
    return found


def _bias(system: System, name: str, p: Sequence[float] | np.ndarray | None) -> float:
    parameters, bias = system.parameters, f"bias_{name}"
    if bias not in parameters.names:
        return 0.0
    return parameters[bias].value if p is None else float(p[parameters.index(bias)])
