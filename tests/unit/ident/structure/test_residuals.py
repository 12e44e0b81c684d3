"""Standard deviations from the residuals of few samples: their autocovariances."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag

from ident.structure.products import autocovariances_of, covariance_of

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


def test_more_intervals_hold_the_truth_where_columns_are_slow() -> None:
    """Sixty samples, true values of zero; the rest is the scatter of the variance."""
    X, before, after = slow(60), [], []
    for seed in range(1000):
        z = noise(np.random.default_rng(seed), 60)
        values = np.linalg.lstsq(X, z, rcond=None)[0]
        e = z - X @ values
        plain = np.sqrt(np.diag(covariance_of([X], [e], local=False)))
        sigma = np.sqrt(np.diag(covariance_of([X], [e], local=False, unbiased=True)))
        before.append(np.abs(values) < 2.0 * plain)
        after.append(np.abs(values) < 2.0 * sigma)
    assert np.mean(before) < 0.85 < np.mean(after)
