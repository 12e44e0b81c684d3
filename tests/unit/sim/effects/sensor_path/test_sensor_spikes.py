"""Spikes: as many samples as declared, each by the declared size, and in the input not felt by the
vehicle.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.effects.library import find_effect
from sim.effects.sensor_path.sensor_spikes import Bursts, InputSpikes, SensorSpikes
from sim.effects.sensor_path.sensor_timing import SensorLag
from sim.vehicles.uncoupled import Loes
from tests.bases import fly_model, rigid_flight, rigid_model

FLIGHT = rigid_flight()
HELD = {"duration": 6.0, "width": 0.02}


def values(name: str, size: float) -> dict[str, float]:
    return {
        f"sensor-spikes:{name}.{local}": value for local, value in {**HELD, "size": size}.items()
    }


@pytest.mark.long
@settings(max_examples=15, deadline=None)
@given(st.integers(1, 9), st.integers(0, 1000))
def test_as_many_isolated_samples_as_declared_are_off_by_the_size(count: int, seed: int) -> None:
    model = (
        rigid_model()
        .with_effects(SensorSpikes("q", "rad/s", 0.05, Bursts(count, seed)))
        .with_values(values("q", 0.4))
    )
    off = fly_model(model, FLIGHT)[1] - fly_model(rigid_model(), FLIGHT)[1]
    hit = np.flatnonzero(np.abs(off) > 1e-9)
    assert len(hit) == count and np.all(np.diff(hit) > 5)
    np.testing.assert_allclose(np.abs(off[hit]), 0.4, rtol=1e-12)


def test_seeds_differ_and_repeat() -> None:
    def at(seed: int) -> np.ndarray:
        model = (
            rigid_model()
            .with_effects(SensorSpikes("alpha", "rad", 0.05, Bursts(8, seed)))
            .with_values(values("alpha", 0.4))
        )
        return fly_model(model, FLIGHT)[0]

    np.testing.assert_array_equal(at(1), at(1))
    assert np.any(at(1) != at(2))


def test_a_lag_of_the_sensor_does_not_spread_them() -> None:
    lagged = rigid_model().with_effects(SensorLag("q"))
    spiky = (
        rigid_model()
        .with_effects(SensorSpikes("q", "rad/s", 0.05), SensorLag("q"))
        .with_values(values("q", 0.4))
    )
    off = np.abs(fly_model(spiky, FLIGHT)[1] - fly_model(lagged, FLIGHT)[1])
    assert np.count_nonzero(off > 1e-9) == 6


def test_the_vehicle_does_not_feel_a_spike_of_the_recorded_input() -> None:
    model = rigid_model().with_effects(InputSpikes()).with_values(values("elevator", 0.3))
    clean = fly_model(rigid_model(), FLIGHT)
    edges = np.append(FLIGHT.time, FLIGHT.time[-1] + 0.02)
    p = type("P", (), {**HELD, "size": 0.3})
    error = InputSpikes().bursts.errors(edges[:-1], edges[1:], p)  # over each sample's hold
    hit = np.abs(error) > 1e-9
    assert np.count_nonzero(hit) == 6 and np.abs(error[hit]) == pytest.approx(0.3)
    recorded = replace(FLIGHT, u=FLIGHT.u + error)
    for got, expected in zip(fly_model(model, recorded), clean, strict=True):
        np.testing.assert_allclose(got, expected, rtol=0.0, atol=1e-9)
    assert np.max(np.abs(fly_model(rigid_model(), recorded)[2] - clean[2])) > 0.1, (
        "without the effect they are felt"
    )


def test_the_stick_has_its_own() -> None:
    assert find_effect("sensor-spikes:stick", Loes()).name == "sensor-spikes:stick"
