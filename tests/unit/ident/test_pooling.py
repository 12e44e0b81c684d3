"""Pooling of estimates over flights: oracles written a second way, and simulated nulls."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import chi2, kstest, multivariate_normal, norm
from scipy.stats import t as student

from ident.pooling import (
    Evidence,
    _gains_about,
    adjusted_p_values,
    condition_on_shared_value,
    fit_trend,
    outlying_flights,
    pool_values,
    pooled_without_flight,
    recurrence,
)


def restricted_oracle(values: np.ndarray, sigmas: np.ndarray) -> float:
    """Scatter by the likelihood of contrasts alone, in which the mean never stands."""
    n = len(values)
    contrasts = np.linalg.svd(np.ones((1, n)))[2][1:]
    seen = contrasts @ values

    def cost(log_scatter: np.ndarray) -> float:
        covariance = contrasts @ np.diag(sigmas**2 + np.exp(2.0 * log_scatter[0])) @ contrasts.T
        return float(np.linalg.slogdet(covariance)[1] + seen @ np.linalg.solve(covariance, seen))

    return float(
        np.exp(
            min(
                (minimize(cost, [start], method="Nelder-Mead") for start in (-4.0, -1.0, 1.0)),
                key=lambda each: each.fun,
            ).x[0]
        )
    )


def test_scatter_and_common_value_are_those_of_the_contrasts() -> None:
    rng = np.random.default_rng(1)
    sigmas = rng.uniform(0.1, 1.0, 15)
    values = 3.0 + 0.7 * rng.standard_normal(15) + sigmas * rng.standard_normal(15)
    found = pool_values(values, sigmas)
    scatter = restricted_oracle(values, sigmas)
    weight = 1.0 / (sigmas**2 + scatter**2)
    assert found.scatter == pytest.approx(scatter, rel=1e-3)
    assert found.value == pytest.approx(np.average(values, weights=weight), rel=1e-4)
    assert found.sigma >= 1.0 / np.sqrt(weight.sum()) * 0.999
    assert found.low < found.value < found.high


@pytest.mark.long
def test_intervals_hold_the_truth_and_one_value_is_called_one() -> None:
    rng = np.random.default_rng(2)
    held, p_same = [], []
    for _ in range(300):
        sigmas = rng.uniform(0.2, 1.0, 8)
        values = 0.5 * rng.standard_normal(8) + sigmas * rng.standard_normal(8)
        found = pool_values(values, sigmas)
        held.append(found.low < 0.0 < found.high)
        p_same.append(pool_values(sigmas * rng.standard_normal(8), sigmas).p_same)
    assert np.mean(held) > 0.91  # of 95 %: 300 draws scatter by 1.3 %
    assert kstest(p_same, "uniform").pvalue > 1e-3


def weighted_least_squares(
    design: np.ndarray, values: np.ndarray, variance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients and covariance by the whitened problem, widened where the residuals scatter by
    more than ``variance``.
    """
    root = 1.0 / np.sqrt(variance)
    found, _, _, _ = np.linalg.lstsq(root[:, None] * design, root * values, rcond=None)
    left = root * (values - design @ found)
    factor = max(1.0, float(left @ left) / (len(values) - design.shape[1]))
    return found, factor * np.linalg.inv((root[:, None] * design).T @ (root[:, None] * design))


@pytest.mark.parametrize("n", [3, 5, 12])
def test_the_sigma_of_a_common_value_is_that_of_least_squares_and_never_less_than_of_known_scatter(
    n: int,
) -> None:
    widened = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        sigmas = np.exp(rng.normal(0.0, 1.0, n))
        values = 3.0 + sigmas * rng.standard_normal(n) + 0.5 * rng.standard_normal(n)
        found = pool_values(values, sigmas)
        (value,), covariance = weighted_least_squares(
            np.ones((n, 1)), values, sigmas**2 + found.scatter**2
        )
        assert (found.value, found.sigma**2) == pytest.approx((value, covariance[0, 0]))
        assert found.high - found.value == pytest.approx(student.ppf(0.975, n - 1) * found.sigma)
        widened += bool(found.sigma**2 * np.sum(1.0 / (sigmas**2 + found.scatter**2)) > 1.01)
        exact = np.average(values, weights=sigmas**-2.0)
        assert found.p_same == pytest.approx(
            chi2.sf(np.sum(((values - exact) / sigmas) ** 2), n - 1)
        )
    assert 0 < widened < 12, "both cases are met"


@pytest.mark.parametrize("n", [4, 5, 12])
def test_a_trend_is_a_weighted_regression_with_students_probability(n: int) -> None:
    widened = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        sigmas, condition = np.exp(rng.normal(0.0, 1.0, n)), rng.uniform(100.0, 200.0, n)
        values = (
            2.0 + 0.01 * condition + sigmas * rng.standard_normal(n) + 0.3 * rng.standard_normal(n)
        )
        found = fit_trend(values, sigmas, condition)
        assert found is not None
        variance = sigmas**2 + found.scatter**2
        design = np.stack([np.ones(n), condition - found.middle], axis=1)
        line, covariance = weighted_least_squares(design, values, variance)
        assert (found.at_middle, found.slope) == pytest.approx((line[0], line[1]))
        np.testing.assert_allclose(found.covariance, covariance, rtol=1e-6, atol=1e-9)
        assert found.slope_sigma == pytest.approx(np.sqrt(covariance[1, 1]))
        assert found.p_value == pytest.approx(
            2.0 * student.sf(abs(line[1]) / found.slope_sigma, n - 2)
        )
        least = np.linalg.inv(design.T @ (design / variance[:, None]))[1, 1]
        widened += bool(found.slope_sigma**2 > 1.01 * least)
    assert 0 < widened < 12, "both cases are met"


@pytest.mark.parametrize("scatter", [0.0, 0.7, 3.0])
def test_how_far_a_flight_is_off_counts_its_own_sigma_and_the_scatter_between_flights_once_each(
    scatter: float,
) -> None:
    """Residuals at the quantiles of a Gaussian of variance sigma^2 + scatter^2 are off by these
    quantiles, whatever their common value.
    """
    quantiles = norm.ppf((np.arange(101) + 0.5) / 101.0)
    off, out = outlying_flights(5.0 + np.hypot(0.5, scatter) * quantiles, np.full(101, 0.5))
    np.testing.assert_allclose(off, quantiles, rtol=0.02, atol=1e-9)
    assert not out.any()


def test_a_single_flight_keeps_its_own_value() -> None:
    found = pool_values(np.array([2.0]), np.array([0.3]))
    assert (found.value, found.sigma, found.scatter) == (2.0, 0.3, 0.0)


def test_scaling_and_order_change_nothing_but_the_unit() -> None:
    rng = np.random.default_rng(3)
    values, sigmas = rng.standard_normal(9), rng.uniform(0.1, 0.5, 9)
    plain, other = (
        pool_values(values, sigmas),
        pool_values(1e-4 * values[::-1], 1e-4 * sigmas[::-1]),
    )
    assert other.value == pytest.approx(1e-4 * plain.value, rel=1e-4)
    assert other.scatter == pytest.approx(1e-4 * plain.scatter, rel=1e-3)


@pytest.mark.long
def test_a_trend_is_found_with_its_sigma_and_none_where_there_is_none() -> None:
    rng = np.random.default_rng(4)
    off, p_null = [], []
    for _ in range(200):
        condition, sigmas = rng.uniform(100.0, 200.0, 12), rng.uniform(0.05, 0.2, 12)
        noise = 0.1 * rng.standard_normal(12) + sigmas * rng.standard_normal(12)
        found, null = (
            fit_trend(2.0 + 0.01 * condition + noise, sigmas, condition),
            fit_trend(noise, sigmas, condition),
        )
        assert found is not None
        assert null is not None
        off.append((found.slope - 0.01) / found.slope_sigma)
        p_null.append(null.p_value)
    assert 0.85 < np.std(off) < 1.2
    assert np.mean(np.array(p_null) < 0.05) < 0.1
    assert found is not None
    line, band = found.band(np.array([found.middle]))
    assert line[0] == pytest.approx(found.at_middle)
    assert band[0] == pytest.approx(np.sqrt(found.covariance[0, 0]))


def test_no_trend_is_told_of_one_condition_or_of_three_flights() -> None:
    assert fit_trend(np.arange(5.0), np.ones(5), np.full(5, 7.0)) is None
    assert fit_trend(np.arange(3.0), np.ones(3), np.arange(3.0)) is None


def test_false_discoveries_against_the_step_up_rule() -> None:
    p = np.random.default_rng(5).uniform(size=30) ** 2
    for level in (0.01, 0.05, 0.2):
        ordered = np.sort(p)
        passed = [i for i in range(30) if ordered[i] <= level * (i + 1) / 30]
        taken = set(np.flatnonzero(p <= ordered[passed[-1]])) if passed else set()
        assert set(np.flatnonzero(adjusted_p_values(p) <= level)) == taken


def test_one_flight_stands_out_and_clean_ones_do_not() -> None:
    rng = np.random.default_rng(6)
    false = 0
    for _ in range(100):
        sigmas = rng.uniform(0.5, 1.5, 20)
        left = sigmas * rng.standard_normal(20)
        false += outlying_flights(left, sigmas)[1].sum()
        left[3] += 9.0
        assert outlying_flights(left, sigmas)[1][3]
    assert false <= 6


def test_conditioning_every_flight_is_the_joint_fit() -> None:
    rng = np.random.default_rng(7)
    blocks, targets = rng.standard_normal((4, 30, 3)), rng.standard_normal((4, 30))
    # All at once: two unknowns of each flight, the third shared.
    design = np.zeros((120, 9))
    for i in range(4):
        design[30 * i : 30 * i + 30, [2 * i, 2 * i + 1, 8]] = blocks[i]
    inverse = np.linalg.inv(design.T @ design)
    joint = inverse @ design.T @ targets.ravel()
    covariances = np.array([np.linalg.inv(b.T @ b) for b in blocks])
    estimates = np.array(
        [c @ b.T @ y for c, b, y in zip(covariances, blocks, targets, strict=True)]
    )
    weights = 1.0 / covariances[:, 2, 2]
    value, covariance = (
        np.array([weights @ estimates[:, 2] / weights.sum()]),
        np.array([[1.0 / weights.sum()]]),
    )
    assert value[0] == pytest.approx(joint[8])
    at = np.array([2])
    for i in range(4):
        others = pooled_without_flight(
            value, covariance, estimates[i, at], covariances[i][np.ix_(at, at)]
        )
        assert others is not None
        moved, left = condition_on_shared_value(estimates[i], covariances[i], at, *others)
        mine = [2 * i, 2 * i + 1, 8]
        assert moved == pytest.approx(joint[mine])
        assert left == pytest.approx(inverse[np.ix_(mine, mine)])


def flights(values: np.ndarray, sigmas: np.ndarray, rng: np.random.Generator) -> Evidence:
    """Linear flights: each estimate with its own noise; the gain is what least squares gives over
    zero.
    """
    seen = values + sigmas * rng.standard_normal(len(values))
    return Evidence(0.5 * (seen / sigmas) ** 2, seen[:, None], (sigmas**2)[:, None, None])


@pytest.mark.parametrize("k", [1, 2])
def test_what_a_flight_gains_by_a_common_value_is_its_marginal_likelihood(k: int) -> None:
    """Its own value is drawn about the common one, with a scatter that is a share of it; without
    the effect it is zero.
    """
    rng = np.random.default_rng(14)
    roots = rng.standard_normal((6, k, k)) + 2.0 * np.eye(k)
    covariance = roots @ roots.transpose(0, 2, 1)
    seen = 3.0 * rng.standard_normal((6, k))
    best = 0.5 * np.einsum("ni,nij,nj->n", seen, np.linalg.inv(covariance), seen)
    values, scatters = rng.standard_normal((3, k)) * 4.0, np.array([0.0, 0.2, 0.8])
    found, _ = _gains_about(Evidence(best, seen, covariance), values, scatters)
    for c in range(3):
        between = np.diag((scatters[c] * values[c]) ** 2)
        for n in range(6):
            having = multivariate_normal.logpdf(seen[n], values[c], covariance[n] + between)
            assert found[c, n] == pytest.approx(
                having - multivariate_normal.logpdf(seen[n], np.zeros(k), covariance[n])
            )


def test_an_effect_of_the_aircraft_is_told_even_where_no_flight_tells_it_alone() -> None:
    rng = np.random.default_rng(8)
    # 1.7 sigmas a flight
    found = recurrence(flights(np.full(40, 1.0), np.full(40, 0.6), rng), candidates=30)
    assert found.recurs
    assert found.belongs == "aircraft"
    assert abs(found.value[0] - 1.0) < 4.0 * np.sqrt(found.covariance[0, 0])
    assert found.agrees


def test_half_of_the_flights_split_clearly() -> None:
    rng = np.random.default_rng(9)
    truth = np.tile([0.0, 1.0], 20)
    found = recurrence(flights(truth, np.full(40, 0.12), rng), candidates=30)
    assert found.belongs == "some flights"
    assert np.array_equal(found.has, truth > 0)
    assert np.array_equal(found.has_not, truth == 0)
    assert found.share == pytest.approx(0.5, abs=0.05)


def test_one_flight_alone_makes_no_recurrence_however_loud() -> None:
    rng = np.random.default_rng(10)
    truth = np.zeros(40)
    truth[7] = 50.0
    found = recurrence(flights(truth, np.ones(40), rng))
    assert not found.recurs
    assert found.belongs == "no flight"


def test_values_that_differ_do_not_agree() -> None:
    rng = np.random.default_rng(11)
    lag = 3.0 / np.linspace(80.0, 200.0, 20)  # s: an arm of 3 m read as a time
    arm = recurrence(flights(np.full(20, 3.0), np.full(20, 0.15), rng))
    other = recurrence(flights(lag, 0.05 * lag, rng))
    assert arm.agrees
    assert not other.agrees
    assert other.scatter > 0.05


@pytest.mark.slow
def test_chance_of_a_false_recurrence_is_bounded() -> None:
    """The tail that decides is compared at a level that a few hundred draws can count."""
    rng = np.random.default_rng(12)
    found = [recurrence(flights(np.zeros(20), rng.uniform(0.5, 2.0, 20), rng)) for _ in range(150)]
    p = np.array([each.p_value for each in found])
    assert not any(each.recurs for each in found)
    for level in (0.02, 0.1, 0.3):
        assert np.mean(p < level) < level + 3.0 * np.sqrt(level * (1 - level) / len(p)), level


def test_clean_fleets_show_no_recurrence() -> None:
    rng = np.random.default_rng(13)
    assert not any(
        recurrence(flights(np.zeros(12), rng.uniform(0.5, 2.0, 12), rng)).recurs for _ in range(8)
    )
