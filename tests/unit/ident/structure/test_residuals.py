"""Standard deviations from the residuals of few samples: their autocovariances and freedom."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag, toeplitz
from scipy.stats import norm, t

from ident.structure.products import autocovariances_of, covariance_of, freedom_of

LAGS = 9
COLOUR = np.array([1.0, 0.6])  # a moving average, as windows that overlap by half make


def slow(count: int) -> np.ndarray:
    """Columns that move slowly beside a constant."""
    x = np.linspace(0.0, 2.0 * np.pi, count)
    return np.stack([np.ones(count), np.sin(x), np.cos(2.0 * x)], axis=1)


def noise(rng: np.random.Generator, count: int) -> np.ndarray:
    return np.convolve(rng.standard_normal(count + 1), COLOUR, "valid")


def split(rows: np.ndarray, cut: int) -> list[np.ndarray]:
    return [rows[:cut], rows[cut:]]


def expected_sums(X: np.ndarray, cut: int) -> np.ndarray:
    """Sums of lagged products of residuals that unit autocovariances make, all matrices written
    out.
    """
    n = len(X)
    R = np.eye(n) - X @ np.linalg.pinv(X)
    found = np.zeros((LAGS, LAGS))
    for i in range(LAGS):
        later = block_diag(np.eye(cut, k=i), np.eye(n - cut, k=i))
        for k in range(LAGS):
            one = block_diag(np.eye(cut, k=k), np.eye(n - cut, k=k))
            colour = one if k == 0 else one + one.T
            found[i, k] = np.trace(R @ later @ R @ colour)
    return found


def test_autocovariances_are_those_that_explain_the_products_of_the_residuals() -> None:
    X, cut = slow(70), 40
    z = noise(np.random.default_rng(3), 70)
    e = z - X @ np.linalg.lstsq(X, z, rcond=None)[0]
    parts, residuals = split(X, cut), split(e, cut)
    found = autocovariances_of(parts, residuals)
    sums = [sum(float(r[: len(r) - lag] @ r[lag:]) for r in residuals) for lag in range(LAGS)]
    np.testing.assert_allclose(expected_sums(X, cut) @ found, sums, rtol=1e-8, atol=1e-8)
    plain = autocovariances_of(parts, residuals, unbiased=False)
    np.testing.assert_allclose(plain, np.array(sums) / 67)


def test_without_a_valid_solution_the_products_are_divided_by_the_samples() -> None:
    """Residuals that change their sign each time, among few samples with many columns."""
    e = np.array([1.0, -1.0] * 5)
    X = np.vander(np.linspace(-1.0, 1.0, 10), 8)
    found = autocovariances_of([X], [e])
    assert np.all(np.abs(found) <= found[0]) or found[0] == pytest.approx(10.0 / 2.0)
    assert np.all(np.isfinite(found))


def test_freedom_is_that_of_a_quadratic_form_of_the_residuals() -> None:
    """Mean and variance of e' W e with normal e, by large matrices."""
    n = 600
    X = slow(n)
    z = noise(np.random.default_rng(5), n)
    e = z - X @ np.linalg.lstsq(X, z, rcond=None)[0]
    found = freedom_of([X], [e])
    window = np.minimum(2.0 * (1.0 - np.arange(LAGS) / LAGS), 1.0)
    colour = toeplitz(np.r_[window * autocovariances_of([X], [e]), np.zeros(n - LAGS)])
    inverse = np.linalg.inv(X.T @ X)
    for place in range(3):
        lags = [(inverse @ X[: n - lag].T @ X[lag:] @ inverse)[place, place] for lag in range(LAGS)]
        weights = toeplitz(np.r_[window * lags, np.zeros(n - LAGS)])
        both = weights @ colour
        expected = np.trace(both) ** 2 / np.trace(both @ both)
        assert found[place] == pytest.approx(expected, rel=0.03)


def test_two_sigma_hold_the_truth_as_often_as_of_a_normal_distribution() -> None:
    """Sixty samples, slow columns, true values of zero."""
    X, before, after = slow(60), [], []
    for seed in range(1000):
        z = noise(np.random.default_rng(seed), 60)
        values = np.linalg.lstsq(X, z, rcond=None)[0]
        e = z - X @ values
        plain = np.sqrt(np.diag(covariance_of([X], [e], local=False)))
        sigma = np.sqrt(np.diag(covariance_of([X], [e], local=False, unbiased=True)))
        wider = t.ppf(norm.cdf(2.0), freedom_of([X], [e])) / 2.0
        before.append(np.abs(values) < 2.0 * plain)
        after.append(np.abs(values) < 2.0 * sigma * wider)
    assert np.mean(before) < 0.85 and abs(np.mean(after) - 0.9545) < 0.02
