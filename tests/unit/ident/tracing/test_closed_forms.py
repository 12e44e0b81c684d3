"""The closed forms of the linear world, against dense Gaussian densities and quadrature."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from ident.tracing.evidence import half_normal_factor, log_mass
from ident.tracing.scan import closed_form_gains


@given(st.integers(0, 10_000), st.integers(1, 4))
@settings(max_examples=40, deadline=None)
def test_the_gain_is_that_of_the_dense_marginal_densities(seed: int, k: int) -> None:
    """Both densities of e, with the columns and without them, written with covariances."""
    rng = np.random.default_rng(seed)
    e, W = rng.normal(size=30), rng.normal(size=(30, k))
    mean, sigma = rng.normal(size=k), rng.uniform(0.2, 3.0, k)
    (gain,), factors = closed_form_gains((W.T @ W)[None], (W.T @ e)[None], mean, sigma)
    covariance = np.eye(30) + W @ np.diag(sigma**2) @ W.T
    with_them = multivariate_normal(W @ mean, covariance).logpdf(e)
    without = multivariate_normal(np.zeros(30), np.eye(30)).logpdf(e)
    assert gain == pytest.approx(with_them - without, abs=1e-5)
    precision = W.T @ W + np.diag(sigma**-2.0)
    expected = np.linalg.solve(precision, W.T @ e + mean / sigma**2)
    assert factors[0] == pytest.approx(expected, abs=1e-6)


def test_places_are_weighed_alone_and_together_alike() -> None:
    rng = np.random.default_rng(3)
    W = rng.normal(size=(5, 40, 2))
    e, mean, sigma = rng.normal(size=40), np.zeros(2), np.ones(2)
    grams, sides = W.swapaxes(1, 2) @ W, W.swapaxes(1, 2) @ e
    gains, factors = closed_form_gains(grams, sides, mean, sigma)
    for place in range(5):
        gain, factor = closed_form_gains(grams[place][None], sides[place][None], mean, sigma)
        assert gain[0] == pytest.approx(gains[place])
        assert factor[0] == pytest.approx(factors[place])


def test_a_column_that_explains_nothing_costs_its_occam_factor() -> None:
    gain, _ = closed_form_gains(np.full((1, 1, 1), 1e4), np.zeros((1, 1)), np.zeros(1), np.ones(1))
    assert gain[0] == pytest.approx(-0.5 * np.log(1.0 + 1e4), abs=1e-3)


@given(st.floats(-3.0, 3.0), st.floats(0.1, 3.0))
@settings(max_examples=30, deadline=None)
def test_the_share_on_the_allowed_side_is_an_integral(mean: float, sigma: float) -> None:
    share, _ = quad(lambda x: norm.pdf(x, mean, sigma), 0.0, mean + 30.0 * sigma, limit=200)
    assert half_normal_factor(mean, sigma) == pytest.approx(np.log(2.0 * share), abs=1e-5)


def test_a_value_far_outside_what_is_believed_weighs_as_its_tail() -> None:
    assert log_mass(0.0, 1.0, -5.0, 40.0) == pytest.approx(0.0, abs=1e-6)
    assert log_mass(-11.6, 0.5, -5.0, 5.0) == pytest.approx(norm.logsf(13.2), rel=1e-6)
