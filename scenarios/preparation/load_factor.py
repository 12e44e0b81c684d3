"""The load factor from a vertical accelerometer: nz = -az/g0, az the specific force along the body's z axis (down), m/s2."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.errors import RecordError
from sim.maths.constants import G0
from sim.record import Channel, Record

MIDDLE = 1.5  # largest plausible ratio of a signal that stands still to one g


def with_load_factor(record: Record) -> tuple[Record, str]:
    """The record with ``nz`` (g, positive up) in the place of ``az``, and a sentence on it, empty where nothing was done.

    Raises
    ------
    RecordError : az is that of inverted flight: most likely it is positive up in this file.
    """
    if "az" not in record.output_names or "nz" in record.output_names:
        return record, ""
    az = record["az"]
    nz = Channel.of("nz", "g", np.where(az.valid, -az.values / G0, np.nan))
    outputs = tuple(nz if channel.name == "az" else channel for channel in record.outputs)
    level = float(np.median(nz.values[nz.valid]))
    if level < -1.0 / MIDDLE:
        what = f"the middle of az is {-G0 * level:+.3g} m/s2, but az is positive down: {-G0:.3g} m/s2 in level flight"
        raise RecordError(what, where=f"{record.name}, channel az", remedy="turn its sign, or hand it over as nz if it is positive up")
    return replace(record, outputs=outputs), f"{record.name}: nz is -az/{G0:g}"
