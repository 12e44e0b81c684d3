"""Fundamental matrices and the discrete noise integral, eq. 13, against quadrature."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ident.filters.one_record import Exponential, Taylor, Transition, log_gaussian
from tests.oracles.kalman import fundamental, process_noise

CASES = [(Taylor(2), 2), (Taylor(3), 3), (Taylor(6), 6), (Exponential(), None)]


@pytest.mark.sampled
@pytest.mark.parametrize(("transition", "terms"), CASES)
@given(seed=st.integers(0, 10**6), dt=st.floats(1e-3, 0.5))
def test_noise_equals_its_integral(
    transition: Transition, terms: int | None, seed: int, dt: float
) -> None:
    rng = np.random.default_rng(seed)
    F, density = rng.normal(size=(4, 4)), rng.uniform(size=4) * [1.0, 0.0, 3.0, 0.1]
    Phi, noise = transition(F, density, dt)
    np.testing.assert_allclose(Phi, fundamental(F, dt, terms), rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(
        noise, process_noise(F, np.diag(density), dt, terms), rtol=1e-10, atol=1e-11
    )


@pytest.mark.parametrize(("transition", "terms"), CASES)
def test_batches_equal_one_by_one(transition: Transition, terms: int | None) -> None:
    rng = np.random.default_rng(2)
    F, density = rng.normal(size=(5, 3, 3)), rng.uniform(size=3)
    Phi, noise = transition(F, density, 0.1)
    for i in range(5):
        one, one_noise = transition(F[i], density, 0.1)
        np.testing.assert_allclose(Phi[i], one, rtol=1e-13, atol=1e-15)
        np.testing.assert_allclose(noise[i], one_noise, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize(("transition", "terms"), CASES)
def test_no_density_gives_no_noise(transition: Transition, terms: int | None) -> None:
    noise = transition(np.ones((3, 3)), np.zeros(3), 0.2)[1]
    np.testing.assert_array_equal(noise, np.zeros((3, 3)))


def test_log_gaussian_is_the_density() -> None:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(3, 3))
    y, S = rng.normal(size=3), root @ root.T + np.eye(3)
    value, squared = log_gaussian(y, S)
    assert squared == pytest.approx(y @ np.linalg.inv(S) @ y, rel=1e-12)
    assert value == pytest.approx(
        -0.5 * (squared + np.log((2 * np.pi) ** 3 * np.linalg.det(S))), rel=1e-12
    )
    with pytest.raises(np.linalg.LinAlgError):
        log_gaussian(y, -S)
