"""The rate limit against finer steps and closed forms."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.effects.input_path.actuator import UNLIMITED_RATE, ActuatorRateLimit
from sim.maths import COMPLEX_STEP

seeds = st.integers(0, 1000)
rates = st.floats(0.05, 50.0)


def act(edges: np.ndarray, u: np.ndarray, rate: object) -> np.ndarray:
    return np.asarray(ActuatorRateLimit().act(edges, u, SimpleNamespace(rate=rate)))


def brute_force(edges: np.ndarray, u: np.ndarray, rate: float, parts: int = 400) -> np.ndarray:
    """Mean over each cell of a march that moves by the rate times the step, or onto the command,
    whichever is less.
    """
    y, means = u[0], []
    for value, width in zip(u, np.diff(edges), strict=True):
        most, total = rate * width / parts, 0.0
        for _ in range(parts):
            new = y + min(max(value - y, -most), most)
            total += 0.5 * (y + new)
            y = new
        means.append(total / parts)
    return np.array(means)


@given(seeds, rates)
def test_is_the_mean_of_the_march_on_uneven_cells(seed: int, rate: float) -> None:
    generator = np.random.default_rng(seed)
    edges = np.concatenate([[2.0], 2.0 + np.cumsum(generator.uniform(2e-4, 1e-3, 20))])
    u = np.repeat(0.01 * generator.standard_normal(8), [1, 2, 5, 1, 3, 1, 4, 3])
    np.testing.assert_allclose(
        act(edges, u, rate), brute_force(edges, u, rate), rtol=0.0, atol=1e-5 * rate / 50.0 + 1e-9
    )


@pytest.mark.parametrize("noise", [0.0, 0.001, 0.02])
def test_is_the_mean_of_the_march_where_it_is_behind_for_hundreds_of_cells_and_where_it_turns_round_in_most(  # noqa: E501
    noise: float,
) -> None:
    edges, rate = np.arange(801) * 0.005, 0.3
    u = 0.4 * np.sin(3.0 * np.minimum(edges[:-1], 1.2)) + noise * np.random.default_rng(
        2
    ).standard_normal(800)
    expected = brute_force(edges, u, rate)
    turns = np.flatnonzero(np.diff(np.sign(u - expected)))
    assert np.diff(turns).max() > 100 and (noise < 0.02 or len(turns) > 50)
    np.testing.assert_allclose(act(edges, u, rate), expected, rtol=0.0, atol=1e-5 * rate)


def test_a_step_becomes_a_ramp_that_ends_within_a_cell() -> None:
    edges = np.arange(101) * 0.001
    u = np.where(edges[:-1] >= 0.0195, 0.01, 0.0)
    y = act(edges, u, 0.16)  # 62.5 ms
    np.testing.assert_allclose(y[:20], 0.0)
    np.testing.assert_allclose(y[20:82], 0.16 * (edges[20:82] + 0.0005 - 0.02), rtol=1e-12)
    assert y[82] == pytest.approx(0.01 - 0.5 * 0.16 * 0.0005**2 / 0.001, rel=1e-12)
    np.testing.assert_allclose(y[83:], 0.01, rtol=1e-14)


def test_a_fast_sine_becomes_a_triangle() -> None:
    edges = np.arange(6001) * 0.001
    y = act(edges, np.sign(np.sin(2.0 * np.pi * 5.0 * (edges[:-1] + 0.0005))), 2.0)
    assert np.ptp(y[3000:]) == pytest.approx(2.0 * 0.1, rel=0.02)


@given(seeds)
def test_unlimited_is_the_identity_bit_for_bit(seed: int) -> None:
    u = np.random.default_rng(seed).standard_normal((30, 2))
    for none in (UNLIMITED_RATE, complex(UNLIMITED_RATE), np.full(2, UNLIMITED_RATE)):
        np.testing.assert_array_equal(act(np.arange(31) * 0.001, u, none), u)


def test_a_limit_above_all_rates_is_hardly_felt() -> None:
    u = np.random.default_rng(3).standard_normal(30)
    # The surface arrives after d/rate, within the cell: the mean is short by d^2/(2 rate) over the
    # cell's length.
    d = np.diff(u, prepend=u[0])
    np.testing.assert_allclose(
        act(np.arange(31) * 0.001, u, 1e8),
        u - d * np.abs(d) / (2.0 * 1e8 * 0.001),
        rtol=0.0,
        atol=1e-14,
    )


@pytest.mark.parametrize("rate", [0.37, 5.1, 400.0])
def test_derivative_by_the_rate(rate: float) -> None:
    edges = np.arange(201) * 0.001
    u = np.repeat(0.1 * np.random.default_rng(4).standard_normal(20), 10)
    exact = act(edges, u, complex(rate, COMPLEX_STEP)).imag / COMPLEX_STEP
    step = 1e-6 * rate
    np.testing.assert_allclose(
        exact, (act(edges, u, rate + step) - act(edges, u, rate - step)) / (2.0 * step), atol=1e-8
    )


def test_a_derivative_of_the_input_passes_through() -> None:
    edges = np.arange(401) * 0.001
    u, direction = 0.1 * np.sin(40.0 * edges[:-1]), np.cos(3.0 * edges[:-1])
    exact = act(edges, u + 1j * COMPLEX_STEP * direction, 2.5).imag / COMPLEX_STEP
    step = 1e-8
    expected = (act(edges, u + step * direction, 2.5) - act(edges, u - step * direction, 2.5)) / (
        2.0 * step
    )
    np.testing.assert_allclose(exact, expected, atol=1e-6)


def test_batches_are_one_by_one() -> None:
    many, tried = (
        np.random.default_rng(6).standard_normal((50, 3)),
        np.array([0.5, 20.0, UNLIMITED_RATE]),
    )
    edges = np.arange(51) * 0.001
    full = act(edges, many, tried[:, None])
    assert full.shape == (50, 3, 3)
    for i, rate in enumerate(tried):
        np.testing.assert_array_equal(full[:, i, 2], act(edges, many[:, 2], rate))
        np.testing.assert_array_equal(
            act(edges, many[:, 0], tried)[:, i], act(edges, many[:, 0], rate)
        )
