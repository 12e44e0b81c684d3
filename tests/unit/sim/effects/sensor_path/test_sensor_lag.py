"""The sensor's lag on signals whose response is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from sim.effects.sensor_path.sensor_timing import SensorLag
from sim.maths import COMPLEX_STEP

LAG = SensorLag("q")


class P:
    """Parameters as the compiled model hands them over."""

    def __init__(self, time_constant: object) -> None:
        self.time_constant = time_constant


def continuous(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values at the two ends of each sub-step of a channel that does not jump."""
    return values, values[1:]


def test_a_ramp_is_late_by_the_time_constant() -> None:
    steps = np.random.default_rng(1).uniform(0.001, 0.02, 300)
    t = np.concatenate([[0.0], np.cumsum(steps)])
    tau = 0.08
    begin, end = LAG.act(steps, *continuous(2.0 + 3.0 * t), P(tau))
    expected = 2.0 + 3.0 * (t - tau + tau * np.exp(-t / tau))
    np.testing.assert_allclose(begin, expected, rtol=0.0, atol=1e-13)
    np.testing.assert_array_equal(end, begin[1:])


def test_a_jump_is_answered_by_the_exponential() -> None:
    steps = np.full(100, 0.01)
    begin, end = np.zeros(101), np.zeros(100)
    begin[40:], end[40:] = 1.0, 1.0
    y, _ = LAG.act(steps, begin, end, P(0.05))
    t = np.arange(101) * 0.01 - 0.4
    np.testing.assert_allclose(y, np.where(t > 0, 1.0 - np.exp(-t / 0.05), 0.0), atol=1e-14)


def test_an_oscillation_shows_the_gain_and_phase_of_a_lag_to_second_order() -> None:
    omega, tau, errors = 7.0, 0.11, []
    for n in (200, 400):
        t = np.linspace(0.0, 2.0, n + 1)
        y, _ = LAG.act(np.diff(t), *continuous(np.sin(omega * t)), P(tau))
        a = omega * tau
        exact = (np.sin(omega * t) - a * np.cos(omega * t) + a * np.exp(-t / tau)) / (1.0 + a * a)
        errors.append(np.max(np.abs(y - exact)))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)
    assert errors[1] < 2e-4


def jumping(seed: int, shape: tuple[int, ...] = ()) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    return (
        generator.uniform(0.002, 0.01, 50),
        generator.standard_normal((51, *shape)),
        generator.standard_normal((50, *shape)),
    )


@pytest.mark.parametrize("zero", [0.0, 0j, np.zeros(3)])
def test_zero_is_the_identity_bit_for_bit(zero: object) -> None:
    steps, begin, end = jumping(4, (3,))
    new_begin, new_end = LAG.act(steps, begin, end, P(zero))
    np.testing.assert_array_equal(new_begin, begin)
    np.testing.assert_array_equal(new_end, end)


def test_starts_settled_at_the_first_value() -> None:
    steps, begin, end = jumping(5)
    assert LAG.act(steps, begin, end, P(0.3))[0][0] == begin[0]


def test_derivative_at_zero_is_minus_the_slope_and_one_sided() -> None:
    t = np.linspace(0.0, 1.0, 101)
    values = np.sin(5.0 * t)
    y, _ = LAG.act(np.diff(t), *continuous(values), P(complex(0.0, COMPLEX_STEP)))
    np.testing.assert_allclose(y.imag[1:] / COMPLEX_STEP, -np.diff(values) / 0.01, rtol=1e-12)
    ahead, _ = LAG.act(np.diff(t), *continuous(values), P(1e-6))
    np.testing.assert_allclose(y.imag / COMPLEX_STEP, (ahead - values) / 1e-6, atol=2e-3)


def test_batches_are_one_by_one() -> None:
    steps, begin, end = jumping(6, (4,))
    lags = np.array([0.0, 0.001, 0.05, 1.0])
    for i, lag in enumerate(lags):
        alone = LAG.act(steps, begin[:, i], end[:, i], P(lag))
        for got, many, one in zip(
            alone,
            LAG.act(steps, begin, end, P(lags)),
            LAG.act(steps, begin, end, P(lag)),
            strict=True,
        ):
            np.testing.assert_allclose(many[:, i], got, rtol=1e-13, atol=1e-14)
            np.testing.assert_allclose(one[:, i], got, rtol=1e-13, atol=1e-14)
        for got, many in zip(
            LAG.act(steps, begin[:, 0], end[:, 0], P(lag)),
            LAG.act(steps, begin[:, 0], end[:, 0], P(lags)),
            strict=True,
        ):
            np.testing.assert_allclose(many[:, i], got, rtol=1e-13, atol=1e-14)


def test_state_form_is_the_lag_and_vanishes_with_it() -> None:
    assert LAG.rates(1.0, [0.4], P(0.2)) == (pytest.approx(3.0),)
    assert LAG.pass_on(1.0, [0.4], P(0.2)) == 0.4
    assert LAG.rates(1.0, [0.4], P(0.0)) == (0.0,)
    assert LAG.pass_on(1.0, [0.4], P(0.0)) == 1.0
