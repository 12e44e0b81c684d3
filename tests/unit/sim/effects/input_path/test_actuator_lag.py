"""The actuator's lag against finer steps and closed forms."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.effects.input_path.actuator import ActuatorLag
from sim.maths import COMPLEX_STEP

LAG = ActuatorLag()
seeds = st.integers(0, 1000)
lags = st.floats(1e-3, 2.0)


def act(edges: np.ndarray, u: np.ndarray, time_constant: object) -> np.ndarray:
    return np.asarray(LAG.act(edges, u, SimpleNamespace(time_constant=time_constant)))


def brute_force(
    edges: np.ndarray, u: np.ndarray, time_constant: float, parts: int = 200
) -> np.ndarray:
    """Mean over each cell by midpoint sums of many implicit midpoint steps."""
    y, means = u[0], []
    for value, width in zip(u, np.diff(edges), strict=True):
        a, total = width / parts / time_constant, 0.0
        for _ in range(parts):
            new = ((1.0 - 0.5 * a) * y + a * value) / (1.0 + 0.5 * a)
            total += 0.5 * (y + new)
            y = new
        means.append(total / parts)
    return np.array(means)


@pytest.mark.long
@given(seeds, lags)
def test_is_the_mean_of_the_response_on_uneven_cells(seed: int, time_constant: float) -> None:
    generator = np.random.default_rng(seed)
    edges = np.concatenate([[2.0], 2.0 + np.cumsum(generator.uniform(2e-4, 1e-3, 12))])
    u = generator.standard_normal(12)
    np.testing.assert_allclose(
        act(edges, u, time_constant), brute_force(edges, u, time_constant), rtol=0.0, atol=5e-6
    )


def test_a_step_is_answered_by_the_exponential() -> None:
    edges, tau = np.arange(1001) * 0.001, 0.05
    y = act(edges, (edges[:-1] >= 0.1995).astype(float), tau)
    reached = -np.expm1(-np.maximum(edges - 0.2, 0.0) / tau)
    expected = np.where(edges[1:] > 0.2001, 1.0 - tau / 0.001 * np.diff(reached), 0.0)
    np.testing.assert_allclose(y, expected, atol=1e-12)


def test_area_lost_to_a_step_is_the_time_constant() -> None:
    edges = np.arange(4001) * 0.001
    u = (edges[:-1] >= 0.5).astype(float)
    assert np.sum(u - act(edges, u, 0.13)) * 0.001 == pytest.approx(0.13, rel=1e-9)


@pytest.mark.parametrize("none", [0.0, 0j, np.zeros(3)])
def test_no_lag_is_the_identity_bit_for_bit(none: object) -> None:
    u = np.random.default_rng(1).standard_normal((40, 3))
    np.testing.assert_array_equal(act(np.arange(41) * 0.001, u, none), u)


@pytest.mark.parametrize("time_constant", [0.0, 0.02, 1.0])
def test_derivative_is_that_towards_longer_lags(time_constant: float) -> None:
    edges, t = np.arange(501) * 0.001, np.arange(500) * 0.001
    u = np.sin(7.0 * t)
    exact = act(edges, u, complex(time_constant, COMPLEX_STEP)).imag / COMPLEX_STEP
    step = 1e-7
    np.testing.assert_allclose(
        exact,
        (act(edges, u, time_constant + step) - act(edges, u, time_constant)) / step,
        atol=1e-4 * np.max(np.abs(exact)),
    )


def test_batches_are_one_by_one() -> None:
    many, lags_tried = (
        np.random.default_rng(2).standard_normal((60, 4)),
        np.array([0.0, 0.004, 0.3]),
    )
    edges = np.arange(61) * 0.001
    full = act(edges, many, lags_tried[:, None])
    assert full.shape == (60, 3, 4)
    for i, lag in enumerate(lags_tried):
        np.testing.assert_allclose(
            full[:, i, 1], act(edges, many[:, 1], lag), rtol=1e-13, atol=1e-14
        )
        np.testing.assert_allclose(
            act(edges, many[:, 0], lags_tried)[:, i],
            act(edges, many[:, 0], lag),
            rtol=1e-13,
            atol=1e-14,
        )


def test_state_form_is_the_lag_and_vanishes_with_it() -> None:
    assert LAG.rates(1.0, [0.4], SimpleNamespace(time_constant=0.2)) == (pytest.approx(3.0),)
    assert LAG.pass_on(1.0, [0.4], SimpleNamespace(time_constant=0.2)) == 0.4
    assert LAG.rates(1.0, [0.4], SimpleNamespace(time_constant=0.0)) == (0.0,)
    assert LAG.pass_on(1.0, [0.4], SimpleNamespace(time_constant=0.0)) == 1.0
