"""Load factors from accelerometers: nz = -az/g0, ny = ay/g0, nx = ax/g0, of the specific force along body axes (m/s2; x ahead, y right, z down)."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from sim.errors import RecordError
from sim.maths import G0
from sim.record import Channel, Record

MIDDLE = 1.5  # largest plausible ratio of a signal that stands still to one g
# Load factor -> the accelerometer that serves in its place, and the sign between them.
ACCELEROMETERS: Mapping[str, tuple[str, float]] = MappingProxyType({"nz": ("az", -1.0), "ny": ("ay", 1.0), "nx": ("ax", 1.0)})


def instead_of(outputs: Collection[str]) -> dict[str, str]:
    """Load factor -> accelerometer that is read where the load factor is not recorded, for a model with these outputs."""
    return {name: channel for name, (channel, _) in ACCELEROMETERS.items() if name in outputs}


def with_load_factors(record: Record, kept: Collection[str] = ()) -> tuple[Record, tuple[str, ...]]:
    """The record with load factors (g) in the place of accelerometers, and a sentence on each; of two channels for one the load factor counts.

    ``kept``: outputs of a model, whose accelerometers stay as they are.

    Raises
    ------
    RecordError : az is that of inverted flight: most likely it is positive up in this file.
    """
    told = []
    for name, (channel, sign) in ACCELEROMETERS.items():
        if channel not in record.output_names or name in record.output_names or channel in kept:
            continue
        force = record[channel]
        factor = Channel.of(name, "g", np.where(force.valid, sign * force.values / G0, np.nan))
        outputs = tuple(factor if each.name == channel else each for each in record.outputs)
        level = float(np.median(factor.values[factor.valid]))
        if name == "nz" and level < -1.0 / MIDDLE:
            what = f"the middle of az is {-G0 * level:+.3g} m/s2, but az is positive down: {-G0:.3g} m/s2 in level flight"
            raise RecordError(what, where=f"{record.name}, channel az", remedy="turn its sign, or hand it over as nz if it is positive up")
        record = replace(record, outputs=outputs)
        told.append(f"{record.name}: {name} is {'-' if sign < 0.0 else ''}{channel}/{G0:g}")
    return record, tuple(told)
