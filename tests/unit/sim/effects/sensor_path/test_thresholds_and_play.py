"""Thresholds of gyros, play of vanes and turned gyros: against loops written a second time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from sim.effects.instances import backlash
from sim.effects.sensor_path.sensor_calibration import SensorScale
from sim.effects.sensor_path.sensor_mounting import TurnedGyro
from sim.effects.sensor_path.sensor_play import SensorBacklash, SensorDeadband
from tests.bases import fly_model, lateral_flight, lateral_model, rigid_flight, rigid_model

ANGLES = arrays.arrays(float, st.integers(2, 40), elements=st.floats(-0.2, 0.2))


def follower(values: np.ndarray, half_width: float) -> np.ndarray:
    """A play, one sample after the other."""
    out, at = [], values[0]
    for value in values:
        at = min(max(at, value - half_width), value + half_width)
        out.append(at)
    return np.array(out)


@given(ANGLES, st.floats(0.0, 0.1))
def test_a_play_follows_at_its_distance(values: np.ndarray, half_width: float) -> None:
    np.testing.assert_allclose(
        backlash(values, half_width), follower(values, half_width), rtol=0.0, atol=1e-15
    )


def test_a_vane_with_play_loses_each_reversal() -> None:
    flight = rigid_flight()
    alpha = fly_model(rigid_model(), flight)[0]
    model = rigid_model().with_effects(SensorBacklash("alpha"))
    read = fly_model(model.with_values({"sensor-backlash:alpha.half_width": 0.004}), flight)
    assert np.max(np.abs(read[0] - alpha)) <= 0.004 + 1e-12
    # The samples miss the turns between them: a play seen at samples alone lags by no more.
    np.testing.assert_allclose(read[0], follower(alpha, 0.004), rtol=0.0, atol=3e-4)
    for other, plain in zip(read[1:], fly_model(rigid_model(), flight)[1:], strict=True):
        np.testing.assert_array_equal(other, plain)


def test_a_gyro_shows_nothing_below_its_threshold() -> None:
    flight = rigid_flight()
    q = fly_model(rigid_model(), flight)[1]
    model = rigid_model().with_effects(SensorDeadband("q"))
    read = fly_model(model.with_values({"sensor-deadband:q.half_width": 0.01}), flight)[1]
    expected = np.where(np.abs(q) < 0.01, 0.0, np.sign(q) * (np.abs(q) - 0.01))
    np.testing.assert_allclose(read, expected, rtol=0.0, atol=1e-15)
    assert np.any(read == 0.0) and np.any(read != 0.0)


@pytest.mark.parametrize(("channel", "other"), [("r", "p"), ("p", "r")])
def test_a_turned_gyro_feels_the_true_other_rate(channel: str, other: str) -> None:
    flight, model = lateral_flight(), lateral_model()
    names = [signal.name for signal in model.equations.outputs]
    plain = dict(zip(names, fly_model(model, flight), strict=True))
    turned = model.with_effects(TurnedGyro(channel, other), SensorScale(other))
    values = {f"sensor-coupling:{channel}.share": 0.08, f"sensor-scale:{other}.scale": 1.3}
    read = dict(zip(names, fly_model(turned.with_values(values), flight), strict=True))
    expected = plain[channel] + 0.08 * plain[other]
    np.testing.assert_allclose(read[channel], expected, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(read[other], 1.3 * plain[other], rtol=0.0, atol=1e-14)
