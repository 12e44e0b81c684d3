"""Each injected fault does what its definition says, on signals whose answer is known in closed
form.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.independent import injected
from tests.independent.flight import G0, Flight

STEP, OMEGA, SPEED = 1.0 / 400.0, 3.0, 80.0
TIME = STEP * np.arange(4001)
INNER = slice(400, 3600)  # away from the ends, where a shifted signal repeats


def sine(phase: float = 0.0) -> np.ndarray:
    return np.sin(OMEGA * TIME + phase)


def a_flight() -> Flight:
    speed = np.full_like(TIME, SPEED)
    return Flight(
        STEP,
        0.1 * sine(),
        0.05 * sine(0.3),
        0.08 * sine(0.7),
        1.0 + 0.3 * sine(1.1),
        0.02 * sine(1.5),
        speed,
        SPEED,
    )


def test_a_late_sensor_shows_the_past_and_a_late_surface_the_future() -> None:
    flight = a_flight()
    late = injected.late_sensor("alpha", 0.075)(flight)
    np.testing.assert_allclose(
        late.alpha[INNER], 0.05 * np.sin(OMEGA * (TIME - 0.075) + 0.3)[INNER], atol=1e-6
    )
    follows = injected.surface_follows_late(0.05)(flight)
    np.testing.assert_allclose(
        follows.elevator[INNER], 0.1 * np.sin(OMEGA * (TIME + 0.05))[INNER], atol=1e-6
    )
    recorded = injected.surface_recorded_late(0.05)(flight)
    np.testing.assert_allclose(
        recorded.elevator[INNER], 0.1 * np.sin(OMEGA * (TIME - 0.05))[INNER], atol=1e-6
    )
    assert late.q is flight.q and follows.alpha is flight.alpha


def test_a_lag_turns_a_sine_by_the_angle_of_a_first_order_system() -> None:
    lag = 0.1
    shown = injected.lagging_sensor("alpha", lag)(a_flight()).alpha
    gain, turn = 1.0 / np.hypot(1.0, OMEGA * lag), np.arctan(OMEGA * lag)
    settled = slice(1600, None)
    # Straight pieces of 2.5 ms differ from the sine by (omega h)^2 / 8 of it.
    np.testing.assert_allclose(
        shown[settled], 0.05 * gain * np.sin(OMEGA * TIME + 0.3 - turn)[settled], atol=1e-6
    )


def test_vane_and_accelerometer_ahead_feel_the_rotation() -> None:
    flight = a_flight()
    np.testing.assert_allclose(
        injected.vane_ahead(8.0)(flight).alpha, flight.alpha - 8.0 / SPEED * flight.q, atol=1e-15
    )
    # Ahead of the c.g. a growing pitch rate is an acceleration upward.
    ahead = injected.accelerometer_ahead(5.0)(flight).nz - flight.nz
    np.testing.assert_allclose(
        ahead[INNER], 5.0 / G0 * 0.08 * OMEGA * np.cos(OMEGA * TIME + 0.7)[INNER], atol=1e-5
    )
    np.testing.assert_allclose(
        injected.accelerometer_ahead(-5.0)(flight).nz - flight.nz, -ahead, atol=1e-12
    )


def test_scales_and_curves_leave_the_beginning_where_it_is() -> None:
    flight = a_flight()
    scaled = injected.wrong_scale("nz", 1.2)(flight).nz
    assert scaled[0] == flight.nz[0]
    np.testing.assert_allclose(np.diff(scaled), 1.2 * np.diff(flight.nz), atol=1e-12)
    change = flight.alpha - flight.alpha[0]
    np.testing.assert_allclose(
        injected.curved_calibration("alpha", 4.0)(flight).alpha - flight.alpha,
        4.0 * change**2,
        atol=1e-15,
    )
    coupled = injected.gyro_feels_load(0.02)(flight).q
    np.testing.assert_allclose(coupled - flight.q, 0.02 * (flight.nz - flight.nz[0]), atol=1e-15)


def test_steps_drifts_and_holds() -> None:
    flight = a_flight()
    step = injected.zero_steps("q", 0.4, 0.01)(flight).q - flight.q
    assert np.all(step[TIME < 4.0 - STEP] == 0.0) and np.allclose(step[TIME > 4.0 + STEP], 0.01)
    np.testing.assert_allclose(
        injected.drifting("nz", 0.002)(flight).nz - flight.nz, 0.002 * TIME, atol=1e-15
    )
    held = injected.held("alpha", 0.1)(flight).alpha
    np.testing.assert_allclose(
        held[:4000].reshape(100, 40),
        np.repeat(flight.alpha[:4000:40, None], 40, axis=1),
        atol=1e-15,
    )
    assert np.all(np.ptp(held[:4000].reshape(100, 40), axis=1) == 0.0)


def test_a_fast_clock_stretches_the_time_axis() -> None:
    flight = a_flight()
    fast = injected.clock_fast(1.1)(flight)
    np.testing.assert_allclose(
        fast.q[INNER], 0.08 * np.sin(OMEGA * TIME / 1.1 + 0.7)[INNER], atol=1e-6
    )
    np.testing.assert_allclose(
        fast.elevator[INNER], 0.1 * np.sin(OMEGA * TIME / 1.1)[INNER], atol=1e-6
    )


def test_nothing_does_nothing() -> None:
    flight = a_flight()
    assert injected.nothing(flight) is flight


@pytest.mark.parametrize("name", ["elevator", "alpha", "q", "nz", "theta", "airspeed"])
def test_a_signal_is_replaced_by_one_of_its_length_only(name: str) -> None:
    with pytest.raises(AssertionError):
        a_flight().with_signal(name, np.zeros(3))
