"""Stick inputs: exact switching times, closed forms, and repeatable hand-flown histories."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.closed_loop.nonlinear import (
    SmoothStick,
    SteppedStick,
    doublet,
    manual_stick,
    three_two_one_one,
)
from sim.errors import ModelError


def test_3211_switches_at_exactly_its_times() -> None:
    stick = three_two_one_one()
    assert stick.times == (1.0, 2.5, 3.5, 4.0, 4.5) and stick.levels == (1.0, -1.0, 1.0, -1.0, 0.0)
    assert stick(
        np.array([0.0, 0.9999, 1.0, 2.4999, 2.5, 3.5, 4.0, 4.4999, 4.5, 20.0])
    ).tolist() == [0, 0, 1, 1, -1, 1, -1, -1, 0, 0]


@given(frame=st.integers(0, 1600), unit=st.sampled_from([0.1, 0.3, 0.5, 0.7]))
def test_switches_do_not_slip_a_frame_by_rounding(frame: int, unit: float) -> None:
    # 7 units of u frames each, counted in whole frames of 12.5 ms.
    stick, frames = three_two_one_one(unit=unit), round(unit * 80)
    place = (frame - 80) / frames
    expected = 0.0 if not 0 <= place < 7 else (1.0 if place < 3 or 5 <= place < 6 else -1.0)
    assert stick(np.array(frame / 80.0)) == expected
    assert stick(np.array(frame * 0.0125)) == expected


def test_doublet_is_balanced() -> None:
    time = np.arange(0.0, 5.0, 0.0125)
    assert np.sum(doublet(0.7, unit=0.8)(time)) == pytest.approx(0.0, abs=1e-12)
    assert set(doublet(0.7)(time).tolist()) == {0.0, 0.7, -0.7}


def test_smooth_stick_obeys_its_differential_equation() -> None:
    stick, w, h = SmoothStick((0.5, 1.5), (1.0, -0.4), 8.0), 8.0, 1e-4
    for time in (0.2, 0.7, 1.2, 1.6, 3.0):
        before, now, after = stick(np.array([time - h, time, time + h]))
        level = 0.0 if time < 0.5 else (1.0 if time < 1.5 else -0.4)
        assert (after - 2 * now + before) / h**2 + 2 * w * (after - before) / (
            2 * h
        ) + w**2 * now == pytest.approx(w**2 * level, abs=1e-3)


def test_hand_flown_repeats_with_its_generator_and_rests_sometimes() -> None:
    time = np.arange(0.0, 30.0, 0.0125)
    one = manual_stick(np.random.default_rng(5), 30.0)(time)
    np.testing.assert_array_equal(one, manual_stick(np.random.default_rng(5), 30.0)(time))
    assert np.max(np.abs(one - manual_stick(np.random.default_rng(6), 30.0)(time))) > 0.5
    assert one[0] == 0.0 and abs(one[-1]) < 1e-2
    assert 0.3 < np.max(np.abs(one)) <= 1.0 and np.min(one) < -0.3 < 0.3 < np.max(one)
    # Smooth: no jump from frame to frame beyond the hand's fastest, 2 in times w/e.
    assert np.max(np.abs(np.diff(one))) < 2.0 * 10.0 / np.e * 0.0125
    resting = [
        s
        for seed in range(8)
        for s in manual_stick(np.random.default_rng(seed), 30.0).levels[:-1]
        if abs(s) <= 0.1
    ]
    assert len(resting) > 8


@given(seed=st.integers(0, 1000), duration=st.floats(0.5, 40.0))
def test_hand_flown_serves_any_duration(seed: int, duration: float) -> None:
    stick = manual_stick(np.random.default_rng(seed), duration)
    assert np.all(np.abs(stick(np.linspace(0.0, duration, 50))) <= 1.0)


@pytest.mark.parametrize(
    ("times", "levels", "message"),
    [
        ((), (), "0 times"),
        ((1.0,), (1.0, 2.0), "1 times and 2 levels"),
        ((1.0, 1.0), (1.0, 2.0), "do not increase"),
        ((0.0,), (float("nan"),), "not finite"),
    ],
)
def test_wrong_steps_are_refused(
    times: tuple[float, ...], levels: tuple[float, ...], message: str
) -> None:
    with pytest.raises(ModelError, match=message):
        SteppedStick(times, levels)
    with pytest.raises(ModelError, match=message):
        SmoothStick(times, levels, 5.0)


def test_a_hand_without_bandwidth_is_refused() -> None:
    with pytest.raises(ModelError, match="bandwidth"):
        SmoothStick((0.0,), (1.0,), 0.0)
