"""The delay against the plain shifted integral, and on signals whose delayed form is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sim.effects.input_path.input_delay import InputDelay
from sim.maths import COMPLEX_STEP

widths = arrays(float, st.integers(2, 30), elements=st.floats(1e-4, 2e-3))
seeds = st.integers(0, 1000)


class P:
    """Parameters as the compiled model hands them over."""

    def __init__(self, delay: object) -> None:
        self.delay = delay


def plain(edges: np.ndarray, u: np.ndarray, delay: float) -> np.ndarray:
    """Mean over each shifted cell from the integral of the hold, one cell after the other."""
    means = np.empty(len(u))
    for i in range(len(u)):
        begin, end = edges[i] - delay, edges[i + 1] - delay
        total = u[0] * max(0.0, min(end, edges[0]) - begin)
        for k in range(len(u)):
            total += u[k] * max(0.0, min(end, edges[k + 1]) - max(begin, edges[k]))
        means[i] = total / (end - begin)
    return means


@given(widths, seeds, st.floats(0.0, 0.05))
def test_is_the_shifted_hold_on_uneven_cells(width: np.ndarray, seed: int, delay: float) -> None:
    edges = np.concatenate([[3.0], 3.0 + np.cumsum(width)])
    u = np.random.default_rng(seed).standard_normal(len(width))
    np.testing.assert_allclose(
        InputDelay().act(edges, u, P(delay)), plain(edges, u, delay), atol=1e-9
    )


@given(widths, seeds)
def test_zero_delay_is_the_identity_bit_for_bit(width: np.ndarray, seed: int) -> None:
    edges = np.concatenate([[0.7], 0.7 + np.cumsum(width)])
    u = np.random.default_rng(seed).standard_normal((len(width), 3))
    for delay in (0.0, 0j, np.zeros(3)):
        np.testing.assert_array_equal(InputDelay().act(edges, u, P(delay)), u)


@given(widths, seeds, st.floats(0.0, 0.05))
def test_a_constant_input_stays_itself(width: np.ndarray, seed: int, delay: float) -> None:
    edges = np.concatenate([[100.0], 100.0 + np.cumsum(width)])
    np.testing.assert_allclose(
        InputDelay().act(edges, np.full(len(width), 0.3), P(delay)), 0.3, rtol=1e-12
    )


def test_a_step_moves_by_exactly_the_delay() -> None:
    edges = np.arange(2001) * 0.001
    u = (edges[:-1] >= 0.4995).astype(float)
    out = InputDelay().act(edges, u, P(0.0604))
    np.testing.assert_allclose(out[:560], 0.0, atol=1e-12)
    # the step falls 0.4 of the way through this cell
    assert out[560] == pytest.approx(0.6, abs=1e-9)
    np.testing.assert_allclose(out[561:], 1.0, atol=1e-12)


def test_a_delay_longer_than_the_record_leaves_the_first_value() -> None:
    edges = np.arange(11) * 0.001
    np.testing.assert_array_equal(InputDelay().act(edges, np.arange(10.0), P(1.5)), np.zeros(10))


@pytest.mark.parametrize("delay", [0.0, 0.0137, 0.5])
def test_derivative_is_that_towards_longer_delays(delay: float) -> None:
    edges = np.arange(41) * 0.001
    u = np.random.default_rng(2).standard_normal(40)
    act = InputDelay().act
    exact = act(edges, u, P(complex(delay, COMPLEX_STEP))).imag / COMPLEX_STEP
    np.testing.assert_allclose(
        exact, (act(edges, u, P(delay + 1e-7)) - act(edges, u, P(delay))) / 1e-7, atol=1e-3
    )


def test_batches_of_delays_and_of_inputs_are_one_by_one() -> None:
    generator = np.random.default_rng(3)
    edges = np.concatenate([[0.0], np.cumsum(generator.uniform(5e-4, 1e-3, 60))])
    one, many, delays = (
        generator.standard_normal(60),
        generator.standard_normal((60, 4)),
        np.array([0.0, 0.0021, 0.01, 0.3]),
    )
    act = InputDelay().act
    for i, delay in enumerate(delays):
        np.testing.assert_array_equal(act(edges, one, P(delays))[:, i], act(edges, one, P(delay)))
        np.testing.assert_array_equal(
            act(edges, many, P(delays))[:, i], act(edges, many[:, i], P(delay))
        )
        np.testing.assert_array_equal(
            act(edges, many, P(0.0021))[:, i], act(edges, many[:, i], P(0.0021))
        )
    grid = act(edges, many, P(delays[:, None]))
    assert grid.shape == (60, 4, 4)
    np.testing.assert_array_equal(grid[:, 2, 1], act(edges, many[:, 1], P(0.01)))
