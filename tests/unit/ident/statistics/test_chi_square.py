"""Intervals by chi-square against scipy's distribution and against numbers that were drawn."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from ident.statistics.intervals import (
    chi_square_quantile,
    deviation_factors,
    mean_square_interval,
    within_chi_square,
)


@pytest.mark.parametrize("degrees", [1, 6, 99, 1602, 1602000])
@pytest.mark.parametrize("share", [0.025, 0.5, 0.975])
def test_a_quantile_is_scipys(degrees: int, share: float) -> None:
    assert chi_square_quantile(share, degrees) == pytest.approx(chi2.ppf(share, degrees), rel=1e-9)


@pytest.mark.parametrize("count", [3, 20, 400])
def test_the_interval_of_a_deviation_holds_the_true_one_as_often_as_it_says(count: int) -> None:
    low, high = deviation_factors(count)
    drawn = np.random.default_rng(count).normal(0.0, 3.0, (4000, count)).std(axis=1, ddof=1)
    held = np.mean((low * drawn <= 3.0) & (high * drawn >= 3.0))
    assert held == pytest.approx(0.95, abs=4.0 * np.sqrt(0.95 * 0.05 / 4000))


def test_of_one_number_no_deviation_is_told() -> None:
    assert deviation_factors(1) == (0.0, float("inf"))


def test_mean_squares_and_single_sums_lie_where_chi_square_says() -> None:
    rng, degrees, runs = np.random.default_rng(5), 6, 3000
    sums = (rng.standard_normal((runs, degrees)) ** 2).sum(axis=1)
    low, high = mean_square_interval(runs * degrees)
    assert (runs * degrees * low, runs * degrees * high) == pytest.approx(
        chi2.interval(0.95, runs * degrees), rel=1e-9
    )
    found = within_chi_square(sums, np.full(runs, degrees))
    assert (
        found.tolist()
        == ((sums >= chi2.ppf(0.025, degrees)) & (sums <= chi2.ppf(0.975, degrees))).tolist()
    )
    assert found.mean() == pytest.approx(0.95, abs=4.0 * np.sqrt(0.95 * 0.05 / runs))
