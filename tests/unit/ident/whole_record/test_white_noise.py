"""White noise as the model of what is random: against Gaussian densities maximised over the
variances.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import norm

from ident.whole_record.gauss_newton import Fit, evaluate
from ident.whole_record.layout import FitLayout, FitProblem, FitSettings, lay_out
from ident.whole_record.noise_model import WHITE, WeightedResiduals
from sim.declaration.compile import compile_model
from sim.declaration.effect import Parameter, ParameterSet
from tests.linear_problem import oscillator, record_of


def two_records() -> FitLayout:
    """Records with holes; the second lacks the last output, and nobody measures it in neither."""
    records = [
        record_of(np.random.default_rng(seed), 60 - 10 * seed, missing=True, absent=("speed",))
        for seed in (1, 2)
    ]
    return lay_out(records, compile_model(oscillator()), FitSettings(max_step=0.05))


def at_start(layout: FitLayout) -> Fit:
    fit = evaluate(FitProblem(layout), layout.start, layout.guesses(layout.start))
    assert fit is not None
    return fit


def weighted(layout: FitLayout, fit: Fit) -> WeightedResiduals:
    found = WHITE.weight_residuals(layout, fit.theta, fit.linearisations, fit.residuals, fit.counts)
    assert found is not None
    return found


def test_cost_is_the_best_gaussian_density_over_the_variances() -> None:
    layout = two_records()
    fit = at_start(layout)
    total = 0.0
    for i in range(2):
        e = np.concatenate(
            [
                (problem.z[i] - line.y[i])[problem.valid[i]]
                for problem, line in zip(layout.problems, fit.linearisations, strict=True)
            ]
        )
        found = minimize_scalar(
            lambda s, e=e: -norm.logpdf(e, scale=np.exp(s)).sum(), bracket=(-5.0, 1.0), tol=1e-12
        )
        assert fit.variance[i] == pytest.approx(np.exp(2.0 * found.x), rel=1e-6)
        total -= found.fun
    assert fit.log_likelihood == pytest.approx(total, rel=1e-10)


def test_an_output_that_nobody_measures_says_nothing() -> None:
    layout = two_records()
    fit = at_start(layout)
    assert layout.used.tolist() == [True, True, False] and fit.variance[2] == 1.0
    assert all(not np.any(residual[2]) for residual in fit.residuals)
    louder = replace(layout, smallest=np.array([0.0, 0.0, 1e6]))
    assert weighted(louder, fit).cost == weighted(layout, fit).cost


def test_where_a_variance_is_held_at_its_least_the_density_is_that_of_a_known_sigma() -> None:
    layout = two_records()
    fit = at_start(layout)
    floor = 4.0 * fit.variance
    found = weighted(replace(layout, smallest=floor), fit)
    np.testing.assert_array_equal(found.variance[:2], floor[:2])
    total = 0.0
    for i in range(2):
        e = np.concatenate(
            [
                (problem.z[i] - line.y[i])[problem.valid[i]]
                for problem, line in zip(layout.problems, fit.linearisations, strict=True)
            ]
        )
        total += norm.logpdf(e, scale=np.sqrt(floor[i])).sum()
    held = replace(fit, cost=found.cost, weighted=found)
    assert held.log_likelihood == pytest.approx(total, rel=1e-10)


def test_columns_are_whitened_by_sigma_and_left_out_where_missing() -> None:
    layout = two_records()
    fit = at_start(layout)
    columns = np.random.default_rng(3).normal(size=(3, len(layout.problems[1].record), 4))
    got, valid = fit.whiten(1, columns), layout.problems[1].valid
    for i in range(3):
        for k in range(valid.shape[1]):
            expected = columns[i, k] / np.sqrt(fit.variance[i]) if valid[i, k] else np.zeros(4)
            np.testing.assert_allclose(got[i, k], expected, rtol=1e-14)
    # The whitened residuals of an output that is used have a mean square of one.
    white = [
        fit.whiten(r, residual[:, :, None])[:, :, 0] for r, residual in enumerate(fit.residuals)
    ]
    assert sum((w**2).sum(axis=1) for w in white)[:2] == pytest.approx(fit.counts[:2], rel=1e-12)


def test_no_unknowns_of_its_own() -> None:
    layout = two_records()
    fit = at_start(layout)
    assert WHITE.names == () and WHITE.start.size == WHITE.low.size == WHITE.high.size == 0
    assert (
        WHITE.covariance_terms(layout, fit.theta, fit.linearisations, weighted(layout, fit)) is None
    )
    low, high = WHITE.step_bounds(layout, fit.theta)
    assert low is layout.low and high is layout.high


def test_gradient_is_the_slope_of_the_concentrated_cost_and_information_that_of_known_sigmas() -> (
    None
):
    layout = two_records()
    fit = at_start(layout)
    information, gradient = fit.normal_equations()
    slope = np.zeros(len(fit.theta))
    for i in range(len(slope)):
        costs = []
        for step in (-1e-4, 1e-4):
            theta = fit.theta.copy()
            theta[i] += step
            moved = evaluate(FitProblem(layout), theta, fit.trajectories)
            assert moved is not None
            costs.append(moved.cost)
        slope[i] = (costs[0] - costs[1]) / 2e-4
    np.testing.assert_allclose(gradient, slope, rtol=1e-4, atol=1e-4 * np.abs(slope).max())
    expected = np.zeros_like(information)
    for r, (problem, line) in enumerate(zip(layout.problems, fit.linearisations, strict=True)):
        at = layout.columns(r)
        for i, k in zip(*np.nonzero(problem.valid), strict=True):
            expected[np.ix_(at, at)] += (
                np.outer(line.jacobian[i, k], line.jacobian[i, k]) / fit.variance[i]
            )
    np.testing.assert_allclose(information, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_prior_enters_cost_gradient_and_information() -> None:
    model = oscillator()
    initial = ParameterSet(
        (Parameter("position", 0.2, "m", free=False), Parameter("speed", -0.1, "m/s", free=False))
    )
    system = compile_model(model.with_initial(initial))
    record = record_of(np.random.default_rng(1), 40)
    with_prior = lay_out([record], system, FitSettings(max_step=0.05, use_priors=True))
    without = lay_out([record], system, FitSettings(max_step=0.05))
    theta = with_prior.start + 0.3
    one, other = (
        evaluate(FitProblem(layout), theta, layout.guesses(theta))
        for layout in (with_prior, without)
    )
    assert one is not None and other is not None and with_prior.names == ("force", "bias_mixed")
    std, mean = np.array([0.7, 0.3]), np.array([0.1, 0.0])
    log_prior = norm.logpdf(theta, mean, std).sum() - norm.logpdf(mean, mean, std).sum()
    assert one.log_likelihood - other.log_likelihood == pytest.approx(log_prior, rel=1e-10)
    np.testing.assert_allclose(
        one.normal_equations()[0] - other.normal_equations()[0],
        np.diag(std**-2),
        rtol=1e-9,
        atol=1e-9,
    )
    np.testing.assert_allclose(
        one.normal_equations()[1] - other.normal_equations()[1], (mean - theta) / std**2, rtol=1e-8
    )
