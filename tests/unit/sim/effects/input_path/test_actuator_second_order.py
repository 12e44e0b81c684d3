"""The actuator of second order against finer steps, closed forms and the lag that it includes."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from sim.effects.input_path.actuator import UNLIMITED, ActuatorLag, ActuatorSecondOrder
from sim.maths import COMPLEX_STEP

SERVO = ActuatorSecondOrder()


def act(edges: np.ndarray, u: np.ndarray, frequency: object, damping: object) -> np.ndarray:
    return np.asarray(SERVO.act(edges, u, SimpleNamespace(frequency=frequency, damping=damping)))


@settings(max_examples=15)
@given(
    st.integers(0, 1000),
    st.floats(1.0, 150.0),
    st.sampled_from([0.05, 0.5, 1.0 - 1e-9, 1.0, 1.0 + 1e-7, 1.3, 4.0]),
)
def test_is_the_mean_of_the_response_on_uneven_cells(
    seed: int, frequency: float, damping: float
) -> None:
    generator = np.random.default_rng(seed)
    edges = np.concatenate([[2.0], 2.0 + np.cumsum(generator.uniform(2e-3, 1e-2, 9))])
    u = generator.standard_normal(9)
    state, means = np.array([u[0], 0.0, 0.0]), []
    for value, a, b in zip(u, edges[:-1], edges[1:], strict=True):

        def rates(t: float, x: np.ndarray, command: float = value) -> list[float]:
            return [x[1], frequency**2 * (command - x[0]) - 2.0 * damping * frequency * x[1], x[0]]

        end = solve_ivp(rates, (a, b), [*state[:2], 0.0], rtol=1e-11, atol=1e-13).y[:, -1]
        means.append(end[2] / (b - a))
        state = end
    np.testing.assert_allclose(act(edges, u, frequency, damping), means, rtol=0.0, atol=1e-8)


def test_a_step_overshoots_by_what_the_damping_says_and_is_late_by_the_area() -> None:
    edges, frequency, damping = np.arange(4001) * 0.001, 25.0, 0.4
    u = (edges[:-1] >= 0.5).astype(float)
    d = act(edges, u, frequency, damping)
    assert d.max() - 1.0 == pytest.approx(
        np.exp(-np.pi * damping / np.sqrt(1.0 - damping**2)), rel=1e-3
    )
    assert np.sum(u - d) * 0.001 == pytest.approx(2.0 * damping / frequency, rel=1e-9)


def test_with_much_damping_it_is_the_lag() -> None:
    edges = np.arange(2001) * 0.001
    u = np.sin(7.0 * edges[:-1]) * (edges[:-1] > 0.3)
    lag = np.asarray(ActuatorLag().act(edges, u, SimpleNamespace(time_constant=0.08)))
    damping = 50.0
    np.testing.assert_allclose(act(edges, u, 2.0 * damping / 0.08, damping), lag, atol=5e-3)


@pytest.mark.parametrize("none", [UNLIMITED, complex(UNLIMITED), np.full(3, UNLIMITED)])
def test_no_actuator_is_the_identity_bit_for_bit(none: object) -> None:
    u = np.random.default_rng(1).standard_normal((40, 3))
    np.testing.assert_array_equal(act(np.arange(41) * 0.001, u, none, 0.5), u)


@pytest.mark.parametrize(
    ("frequency", "damping"), [(20.0, 0.5), (40.0, 1.0), (3.0, 1.0), (90.0, 3.0)]
)
def test_derivatives_are_central_differences(frequency: float, damping: float) -> None:
    edges = np.arange(501) * 0.001
    u = np.sign(np.sin(11.0 * edges[:-1]))
    by_frequency = act(edges, u, complex(frequency, COMPLEX_STEP), damping).imag / COMPLEX_STEP
    by_damping = act(edges, u, frequency, complex(damping, COMPLEX_STEP)).imag / COMPLEX_STEP
    for exact, moved in (
        (by_frequency, (1e-4 * frequency, 0.0)),
        (by_damping, (0.0, 1e-4 * damping)),
    ):
        ends = [
            act(edges, u, frequency + sign * moved[0], damping + sign * moved[1])
            for sign in (1.0, -1.0)
        ]
        np.testing.assert_allclose(
            exact, (ends[0] - ends[1]) / (2.0 * sum(moved)), atol=1e-5 * np.max(np.abs(exact))
        )


def test_batches_are_one_by_one() -> None:
    many, frequencies = (
        np.random.default_rng(2).standard_normal((60, 4)),
        np.array([UNLIMITED, 20.0, 5.0]),
    )
    edges = np.arange(61) * 0.001
    full = act(edges, many, frequencies[:, None], 0.6)
    assert full.shape == (60, 3, 4)
    for i, frequency in enumerate(frequencies):
        np.testing.assert_allclose(
            full[:, i, 1], act(edges, many[:, 1], frequency, 0.6), rtol=1e-13, atol=1e-14
        )


def test_state_form_is_the_oscillator_and_vanishes_with_it() -> None:
    p = SimpleNamespace(frequency=10.0, damping=0.5)
    assert SERVO.rates(1.0, [0.4, 2.0], p) == (2.0, pytest.approx(100.0 * 0.6 - 10.0 * 2.0))
    assert SERVO.pass_on(1.0, [0.4, 2.0], p) == 0.4
    gone = SimpleNamespace(frequency=UNLIMITED, damping=0.5)
    assert (
        SERVO.rates(1.0, [0.4, 2.0], gone) == (0.0, 0.0)
        and SERVO.pass_on(1.0, [0.4, 2.0], gone) == 1.0
    )
