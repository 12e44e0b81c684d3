"""Vane offset, scale and drift: what the sensors read, by hand, and that they stand in their
order.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from sim.declaration.compile import compile_model
from sim.declaration.proposal import SearchContext
from sim.effects.sensor_path.sensor_calibration import SensorDrift, SensorScale, settled
from sim.effects.sensor_path.sensor_mounting import VaneOffset
from sim.effects.sensor_path.sensor_spikes import SensorSpikes
from sim.effects.sensor_path.sensor_timing import SensorDelay, SensorLag
from tests.bases import (
    LOES_CONSTANTS,
    ballistic_flight,
    ballistic_model,
    fly,
    fly_model,
    loes_flight,
    loes_model,
    rigid_flight,
    rigid_model,
)

DRIFT = SensorDrift("alpha", "rad", 5e-4, begin=1.5)


def test_the_vane_reads_less_while_the_nose_goes_up() -> None:
    model, flight = (
        rigid_model().with_effects(VaneOffset()).with_values({"vane-offset.arm": 12.0}),
        rigid_flight(),
    )
    alpha, q, nz = fly_model(rigid_model(), flight)
    read = fly_model(model, flight)
    np.testing.assert_allclose(read[0], alpha - 12.0 / 200.6 * q, rtol=0.0, atol=1e-15)
    np.testing.assert_array_equal(read[1], q)
    np.testing.assert_array_equal(read[2], nz)


def test_the_arm_adds_to_that_of_the_equations() -> None:
    further = loes_model().with_effects(VaneOffset()).with_values({"vane-offset.arm": 4.0})
    longer = loes_model().with_values({"vane_arm": LOES_CONSTANTS["vane_arm"] + 4.0})
    for got, expected in zip(
        fly_model(further, loes_flight()), fly_model(longer, loes_flight()), strict=True
    ):
        np.testing.assert_allclose(got, expected, rtol=0.0, atol=1e-13)


def test_scale_then_drift_then_bias_whatever_the_order_they_were_added_in() -> None:
    flight = rigid_flight()
    alpha, q, _ = fly_model(rigid_model(), flight)
    expected = 1.1 * (alpha - 12.0 / 200.6 * q) + 0.002 * (flight.time - 1.5) + 0.03
    values = {
        "vane-offset.arm": 12.0,
        "sensor-scale:alpha.scale": 1.1,
        "sensor-drift:alpha.slope": 0.002,
    }
    effects = (DRIFT, SensorScale("alpha"), VaneOffset())
    for order in (effects, effects[::-1]):
        model = (
            rigid_model()
            .with_biases(["alpha"])
            .with_effects(*order)
            .with_values({**values, "bias_alpha": 0.03})
        )
        np.testing.assert_allclose(fly_model(model, flight)[0], expected, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("settling", [0.0, 1e-9, 9e-5, 1.1e-4, 0.2, 2.0])
def test_a_zero_that_settles_is_the_response_of_a_first_order_to_a_slope_that_ends(
    settling: float,
) -> None:
    """By quadrature: the slope at each time is the first one, dying out."""
    flight = rigid_flight()
    values = {"sensor-drift:alpha.slope": 0.002, "sensor-drift:alpha.settling": settling}
    late = replace(DRIFT, begin=0.0).finer()
    read = (
        fly_model(rigid_model().with_effects(late).with_values(values), flight)[0]
        - fly_model(rigid_model(), flight)[0]
    )
    expected = [quad(lambda t: 0.002 * np.exp(-settling * t), 0.0, end)[0] for end in flight.time]
    np.testing.assert_allclose(read, expected, rtol=0.0, atol=1e-15)


@given(st.floats(0.0, 2.0), st.floats(0.0, 60.0))
def test_the_slope_of_settling_is_its_derivative(rate: float, elapsed: float) -> None:
    got = settled(elapsed, complex(rate, 1e-30)).imag / 1e-30
    assert got == pytest.approx(
        -quad(lambda t: t * np.exp(-rate * t), 0.0, elapsed)[0], rel=1e-6, abs=1e-9
    )


def test_sensors_with_memory_come_in_their_order_and_spikes_last() -> None:
    effects = (SensorSpikes("q", "rad/s", 0.05), SensorLag("q"))
    for order in (effects, effects[::-1]):
        assert compile_model(rigid_model().with_effects(*order)).sensor_stages == (
            "sensor-lag:q",
            "sensor-spikes:q",
        )


ALTITUDE_FAULTS = [
    (SensorLag("altitude"), 0.1),
    (SensorDelay("altitude"), 0.1),
    (SensorScale("altitude"), 1.03),
]


@pytest.mark.sampled
@pytest.mark.parametrize(("effect", "size"), ALTITUDE_FAULTS)
def test_an_altitude_that_is_a_little_late_or_scaled_hides_behind_another_fall(
    effect: SensorLag | SensorDelay | SensorScale, size: float
) -> None:
    assert read_otherwise(effect, size) > 10.0 and left_by_another_fall(effect, size) < 0.15


@pytest.mark.slow
@pytest.mark.slow
def test_an_altitude_is_searched_for_a_large_scale_which_shows_and_not_for_lateness() -> None:
    for late in (SensorLag("altitude"), SensorDelay("altitude")):
        assert late.probes(SearchContext(0.0, 20.0, 0.1)) == () and replace(
            late, channel="q"
        ).probes(SearchContext(0.0, 20.0, 0.1))
    scale = SensorScale("altitude")
    assert scale.probes(SearchContext(0.0, 20.0, 0.1)) and left_by_another_fall(scale, 1.4) > 1.0


def read_otherwise(effect: SensorLag | SensorDelay | SensorScale, size: float) -> float:
    """By how much the altitude is read wrongly at most, in sigmas of its noise."""
    model = ballistic_model()
    return (
        float(np.max(np.abs(_read(effect, size) - fly_model(model, ballistic_flight())[0])))
        / model.noise.measurement_std["altitude"]
    )


def left_by_another_fall(effect: SensorLag | SensorDelay | SensorScale, size: float) -> float:
    """Root mean square of what another start and another beta leave of such an altitude, in sigmas
    of its noise.
    """
    from scipy.optimize import least_squares

    model, flight, read = ballistic_model(), ballistic_flight(), _read(effect, size)
    system, noise = compile_model(model), model.noise.measurement_std["altitude"]
    p, beta = list(system.parameters.values()), system.parameters.index("beta")

    def misfit(change: np.ndarray) -> np.ndarray:
        p[beta] = 2441.2 * (1.0 + 0.01 * change[2])
        return (
            fly(system, flight, p, x0=[60960.0 + 100.0 * change[0], -1828.8 + change[1]])[0] - read
        )[5:] / noise

    return float(np.sqrt(np.mean(least_squares(misfit, np.zeros(3)).fun ** 2)))


def _read(effect: SensorLag | SensorDelay | SensorScale, size: float) -> np.ndarray:
    return fly_model(
        ballistic_model()
        .with_effects(effect)
        .with_values({f"{effect.name}.{effect.parameters[0].name}": size}),
        ballistic_flight(),
    )[0]


def test_a_drift_counts_from_the_record_it_is_searched_in() -> None:
    drift = DRIFT.fitted_to(SearchContext(100.0, 120.0, 0.02))
    assert drift.name == DRIFT.name
    s = SimpleNamespace(time=np.array([100.0, 101.0]))
    read = drift.read(s, {"alpha": np.zeros(2)}, None, SimpleNamespace(slope=0.3))
    assert read["alpha"] == pytest.approx([0.0, 0.3])
