"""The sensor's delay against a reading of the straight pieces one by one."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.effects.sensor_path.sensor_timing import JUMP_SPREAD_TIME, SensorDelay
from sim.maths import COMPLEX_STEP

DELAY = SensorDelay("nz")
seeds = st.integers(0, 1000)


def act(
    steps: np.ndarray, begin: np.ndarray, end: np.ndarray, delay: object
) -> tuple[np.ndarray, np.ndarray]:
    return DELAY.act(steps, begin, end, SimpleNamespace(delay=delay))


def jumping(
    seed: int, shape: tuple[int, ...] = (), jumps: bool = True
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Uneven sub-steps longer than the aperture, values at both of their ends."""
    generator = np.random.default_rng(seed)
    steps, begin = generator.uniform(0.002, 0.01, 50), generator.standard_normal((51, *shape))
    return steps, begin, generator.standard_normal((50, *shape)) if jumps else begin[1:].copy()


def plain(steps: np.ndarray, begin: np.ndarray, end: np.ndarray, time: float) -> float:
    """Value at a time; within the aperture before a jump the way from its one side to the other."""
    edges = np.concatenate([[0.0], np.cumsum(steps)])
    if time <= 0.0:
        return float(begin[0])
    for k, step in enumerate(steps):
        if edges[k] < time <= edges[k + 1]:
            slope = (end[k] - begin[k]) / step
            value = begin[k] + slope * (time - edges[k])
            over = 1.0 - (edges[k + 1] - time) / JUMP_SPREAD_TIME
            return float(value + max(0.0, over) * (begin[k + 1] - end[k]))
    raise AssertionError("beyond the record")


@given(seeds, st.floats(0.0, 0.4))
def test_reads_the_straight_pieces_at_the_earlier_time(seed: int, delay: float) -> None:
    steps, begin, end = jumping(seed)
    edges = np.concatenate([[0.0], np.cumsum(steps)])
    y, _ = act(steps, begin, end, delay)
    np.testing.assert_allclose(y, [plain(steps, begin, end, t - delay) for t in edges], atol=1e-9)


def test_a_jump_moves_by_exactly_the_delay_and_is_not_smeared() -> None:
    steps = np.full(100, 0.005)
    begin, end = np.zeros(101), np.zeros(100)
    begin[40:], end[40:] = 1.0, 1.0
    for delay, first in ((0.02, 44), (0.0213, 45), (0.0249, 45), (0.025, 45), (0.0263, 46)):
        y, _ = act(steps, begin, end, delay)
        np.testing.assert_allclose(y, np.arange(101) >= first, atol=1e-9)
    # Less than the aperture beyond a whole number of sub-steps: between the two.
    assert act(steps, begin, end, 0.0204)[0][44] == pytest.approx(0.6)


def test_both_ends_keep_a_jump_that_meets_an_edge() -> None:
    steps = np.full(100, 2.0**-8)  # sums without rounding
    begin, end = np.zeros(101), np.zeros(100)
    begin[40:], end[40:] = 1.0, 1.0
    y, before = act(steps, begin, end, 10 * 2.0**-8)
    assert y[50] == 1.0 and before[49] == 0.0


@pytest.mark.parametrize("none", [0.0, 0j, np.zeros(3)])
def test_no_delay_is_the_identity_bit_for_bit(none: object) -> None:
    steps, begin, end = jumping(4, (3,))
    new_begin, new_end = act(steps, begin, end, none)
    np.testing.assert_array_equal(new_begin, begin)
    np.testing.assert_array_equal(new_end, end)


def test_before_the_record_the_first_value_holds() -> None:
    steps, begin, end = jumping(5)
    for part in act(steps, begin, end, 1.9):
        np.testing.assert_array_equal(part, np.full(len(part), begin[0]))


@pytest.mark.parametrize("delay", [0.0, 0.0137, 0.21])
@pytest.mark.parametrize("jumps", [False, True])
def test_derivative_is_that_towards_longer_delays(delay: float, jumps: bool) -> None:
    steps, begin, end = jumping(6, jumps=jumps)
    exact = act(steps, begin, end, complex(delay, COMPLEX_STEP))[0].imag / COMPLEX_STEP
    ahead, here = act(steps, begin, end, delay + 1e-8)[0], act(steps, begin, end, delay)[0]
    np.testing.assert_allclose(exact, (ahead - here) / 1e-8, rtol=1e-4, atol=1e-4)


def test_batches_are_one_by_one() -> None:
    steps, begin, end = jumping(7, (4,))
    tried = np.array([0.0, 0.001, 0.05, 1.0])
    for i, delay in enumerate(tried):
        alone = act(steps, begin[:, i], end[:, i], delay)
        for got, many, one in zip(
            alone, act(steps, begin, end, tried), act(steps, begin, end, delay), strict=True
        ):
            np.testing.assert_array_equal(many[:, i], got)
            np.testing.assert_array_equal(one[:, i], got)
        for got, many in zip(
            act(steps, begin[:, 0], end[:, 0], delay),
            act(steps, begin[:, 0], end[:, 0], tried),
            strict=True,
        ):
            np.testing.assert_array_equal(many[:, i], got)
