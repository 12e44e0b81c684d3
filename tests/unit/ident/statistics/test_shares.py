"""Intervals of shares against scipy's binomial and against campaigns whose true share is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import beta, binomtest, norm

from ident.statistics.intervals import clopper_pearson, clustered_share

PARAMETERS = 6


@pytest.mark.parametrize(
    ("count", "of"),
    [(0, 1), (1, 1), (0, 200), (200, 200), (19, 20), (5, 100), (137, 412), (9500, 10000)],
)
@pytest.mark.parametrize("level", [0.95, 0.6827])
def test_exact_interval_equals_scipys(count: int, of: int, level: float) -> None:
    expected = binomtest(count, of).proportion_ci(level, method="exact")
    assert clopper_pearson(count, of, level) == pytest.approx(
        (expected.low, expected.high), rel=1e-9, abs=1e-15
    )
    tail = 0.5 * (1.0 - level)
    if 0 < count < of:
        assert clopper_pearson(count, of, level) == pytest.approx(
            (beta.ppf(tail, count, of - count + 1), beta.isf(tail, count + 1, of - count))
        )


def test_without_a_trial_every_share_is_possible() -> None:
    assert clopper_pearson(0, 0) == (0.0, 1.0)
    assert clustered_share(np.array([]), np.array([]), np.random.default_rng(0)) == (0.0, 1.0)
    assert clustered_share(np.zeros(3), np.zeros(3), np.random.default_rng(0)) == (0.0, 1.0)


def campaign(correlation: float, runs: int, rng: np.random.Generator) -> np.ndarray:
    """Hits by run of six parameters whose errors, in sigmas, have one common correlation."""
    common, own = rng.standard_normal((runs, 1)), rng.standard_normal((runs, PARAMETERS))
    errors = np.sqrt(correlation) * common + np.sqrt(1.0 - correlation) * own
    return np.sum(np.abs(errors) <= 2.0, axis=1)


@pytest.mark.slow
def test_pooled_binomial_interval_of_correlated_parameters_is_too_narrow_and_the_clustered_one_is_not() -> (  # noqa: E501
    None
):
    true, rng, repeats, runs = 2.0 * norm.cdf(2.0) - 1.0, np.random.default_rng(1), 200, 80
    held = np.zeros(2)
    widths = np.zeros(2)
    for _ in range(repeats):
        hits = campaign(0.9, runs, rng)
        pooled = clopper_pearson(int(hits.sum()), runs * PARAMETERS)
        clustered = clustered_share(hits, np.full(runs, PARAMETERS), rng)
        held += [low <= true <= high for low, high in (pooled, clustered)]
        widths += [high - low for low, high in (pooled, clustered)]
    narrow, wide = held / repeats
    assert narrow < 0.85, "six correlated parameters are no six trials"
    assert wide > 0.88 and widths[1] > 1.5 * widths[0]


def test_of_independent_parameters_both_intervals_are_alike() -> None:
    hits = campaign(0.0, 400, np.random.default_rng(2))
    pooled = clopper_pearson(int(hits.sum()), 400 * PARAMETERS)
    clustered = clustered_share(hits, np.full(400, PARAMETERS), np.random.default_rng(3))
    assert clustered == pytest.approx(pooled, abs=0.005)


def test_runs_of_one_trial_give_the_binomial_interval() -> None:
    hits = (np.random.default_rng(4).random(500) < 0.9).astype(float)
    assert clustered_share(hits, np.ones(500), np.random.default_rng(5)) == clopper_pearson(
        int(hits.sum()), 500
    )
    # A run without a trial says nothing.
    assert clustered_share(
        np.array([1, 0, 0]), np.array([1, 0, 1]), np.random.default_rng(5)
    ) == clopper_pearson(1, 2)


def test_runs_that_all_say_the_same_count_once_each() -> None:
    rng = np.random.default_rng(6)
    assert clustered_share(np.full(20, 6), np.full(20, 6), rng) == clopper_pearson(20, 20)
    assert clustered_share(np.zeros(20), np.array([3, 4] * 10), rng) == clopper_pearson(0, 20)
    assert clustered_share(np.full(20, 3), np.full(20, 6), rng) == clopper_pearson(10, 20)


def test_same_generator_gives_the_same_interval() -> None:
    hits = campaign(0.5, 30, np.random.default_rng(7))
    one, two = (
        clustered_share(hits, np.full(30, PARAMETERS), np.random.default_rng(8)) for _ in range(2)
    )
    assert one == two
