"""Records of ten minutes at 100 Hz are fitted at their own rate, within seconds and a gigabyte."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

import flightid
from sim.record import Record
from tests.bases import Flight, rigid_model, three_two_one_one
from tests.rigid_problem import FREE, TRUE, noisy, rigid_start

PAUSE = 40.0  # s, from one maneuver to the next


def several_maneuvers(samples: int) -> Record:
    """The rigid aircraft at 100 Hz in one 3-2-1-1 after the other, of four lengths and both
    signs.
    """
    time = np.arange(samples) / 100.0
    starts = np.arange(5.0, time[-1] - 12.0, PAUSE)
    steps = [
        three_two_one_one(time, start=at, unit=0.4 + 0.1 * (i % 4), size=0.03 * (-1) ** i)
        for i, at in enumerate(starts.tolist())
    ]
    return noisy(rigid_model(), Flight(time, np.sum(steps, axis=0)[None]), np.random.default_rng(1))


def fitted_within(samples: int, most: float) -> None:
    """A fit of the record settles at the truth; ``most``: GB at its peak."""
    record, start = several_maneuvers(samples), rigid_start()
    values = {item.name: item.value for item in start.parameters}
    derivatives = {name: values[name] for name in FREE}
    vehicle = {
        "name": "bomber",
        "derivatives": derivatives,
        **{name: value for name, value in values.items() if name not in FREE},
    }
    columns = {"time": record.time, **{channel.name: channel.values for channel in record.channels}}
    tracemalloc.start()
    try:
        found = flightid.identify(columns, "rigid", vehicle, hold="previous")
        peak = tracemalloc.get_traced_memory()[1] / 1e9
    finally:
        tracemalloc.stop()
    assert found.details.found.estimate.outcome.name == "CONVERGED"
    assert found.details.found.estimate.iterations < 20
    assert np.max(np.abs((found.values - TRUE) / found.sigmas)) < 4.0
    assert peak < most


@pytest.mark.long
def test_two_minutes_with_three_maneuvers() -> None:
    fitted_within(12_000, 0.2)


@pytest.mark.slow
def test_ten_minutes_with_fifteen_maneuvers() -> None:
    fitted_within(60_000, 1.0)
