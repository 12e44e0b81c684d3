"""A short record of the low-order equivalent system, flown by itself, and the fourteen-state filter
for it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from scenarios.identification.low_order import loes_filter_system
from sim.declaration.compile import compile_model
from sim.declaration.model import System
from sim.record import Channel, Record
from sim.vehicles.factory import model_from_constants
from tests.bases import LOES_CONSTANTS, LOES_VALUES, Flight, fly, loes_model, three_two_one_one

NOISE = {"alpha": 0.001, "q": 0.002, "nz": 0.02}
TRUE_DELAY = 0.118


def record(
    seed: int,
    duration: float = 7.0,
    rate: float = 25.0,
    gaps: bool = False,
    delay: float = TRUE_DELAY,
) -> Record:
    """A 3-2-1-1 with noise; with ``gaps`` some samples are missing, one row wholly."""
    time = np.arange(round(duration * rate) + 1) / rate
    stick = three_two_one_one(time, size=1.0)[None]
    rows = fly(
        compile_model(loes_model().with_values({"delay": delay})),
        Flight(time, stick, max_step=0.005),
    )
    rng = np.random.default_rng(seed)
    noisy = {
        name: row + NOISE[name] * rng.standard_normal(time.size)
        for name, row in zip(NOISE, rows, strict=True)
    }
    if gaps:
        noisy["q"][10:14] = np.nan
        for row in noisy.values():
            row[40] = np.nan
    units = {"alpha": "rad", "q": "rad/s", "nz": "g"}
    return Record(
        time,
        (Channel.of("stick", "in", stick[0]),),
        tuple(Channel.of(name, units[name], row) for name, row in noisy.items()),
    )


def system(
    flown: Record, share: float = 1.15, density: Mapping[str, float] | None = None
) -> System:
    """The filter, started at ``share`` times the true values."""
    start = {name: share * value for name, value in LOES_VALUES.items()} | {
        "L_q": 1.0,
        "delay": 0.0,
    }
    return loes_filter_system(
        model_from_constants("loes", LOES_CONSTANTS, start), flown, NOISE, density or {"q": 1e-6}
    )
