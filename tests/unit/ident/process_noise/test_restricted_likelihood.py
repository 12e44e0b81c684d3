"""Restricted likelihood against its textbook case: in a linear regression it divides by N - k where
maximum likelihood divides by N.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.process_noise.innovations_model import ProcessNoise, process_noise, restricted_levels
from ident.whole_record.gauss_newton import Fit, fit_whole_records
from ident.whole_record.layout import FitProblem, FitSettings, lay_out
from ident.whole_record.output_error import fit_covariance
from sim.declaration.compile import compile_model
from tests.linear_problem import STD, oscillator, record_of

ALL = ("place", "mixed", "speed")


def regression(samples: int, present: tuple[str, ...]) -> Fit:
    """Outputs that are linear in all unknowns: force, initial position and speed, and the bias of
    ``mixed`` where it is measured.
    """
    record = record_of(
        np.random.default_rng(samples),
        samples,
        absent=tuple(name for name in ALL if name not in present),
    )
    system = compile_model(oscillator())
    layout = lay_out([record], system, FitSettings(max_step=0.05, tolerance=1e-6))
    fit = fit_whole_records(
        FitProblem(
            layout, process_noise(system, {name: 4.0 * std for name, std in STD.items()}, present)
        )
    )
    assert fit is not None
    return fit


@pytest.mark.parametrize("samples", [60, 150])
def test_a_mean_takes_its_share_of_the_variance(samples: int) -> None:
    """One output and k linear unknowns: sigma^2 = RSS / (N - k); one step of it from RSS / N is
    exact to (k / N)^2.
    """
    fit = regression(samples, ("place",))
    k = len(fit.layout.start)
    assert k == 3 and fit.problem.names[-1] == "std_place"
    squares = float(np.sum((fit.layout.problems[0].z[0] - fit.linearisations[0].y[0]) ** 2))
    assert fit.theta[-1] ** 2 == pytest.approx(squares / samples, rel=1e-5)
    levels = restricted_levels(fit, fit_covariance(fit)[0])
    adjusted, factor = levels.theta, levels.factor
    assert adjusted[-1] ** 2 == pytest.approx(
        squares / (samples - k), rel=(k / samples) ** 2 + 0.02 * k / samples
    )
    assert adjusted[-1] == pytest.approx(factor[-1] * fit.theta[-1], rel=1e-12)
    np.testing.assert_array_equal(adjusted[:-1], fit.theta[:-1])
    np.testing.assert_array_equal(factor[:-1], 1.0)


def test_outputs_share_what_the_unknowns_take() -> None:
    """Three outputs: each loses the trace of its own part of the hat matrix (Patterson and
    Thompson, Biometrika 58(3), 1971).
    """
    fit = regression(150, ALL)
    levels = restricted_levels(fit, fit_covariance(fit)[0])
    adjusted, factor = levels.theta, levels.factor
    std, J = fit.theta[-3:], fit.linearisations[0].jacobian
    normal = sum(J[i].T @ J[i] / std[i] ** 2 for i in range(3))
    taken = np.array(
        [np.trace(np.linalg.solve(normal, J[i].T @ J[i])) / std[i] ** 2 for i in range(3)]
    )
    assert taken.sum() == pytest.approx(4.0, rel=1e-9) and fit.problem.names[-3:] == (
        "std_place",
        "std_mixed",
        "std_speed",
    )
    np.testing.assert_allclose(2.0 * np.log(factor[-3:]), taken / 150.0, rtol=0.05)
    np.testing.assert_allclose(adjusted[-3:] ** 2, std**2 / (1.0 - taken / 150.0), rtol=2e-3)


def test_a_level_at_its_bound_stays() -> None:
    """Levels reach down to a thousandth of their start: with a start a thousand times as high the
    level found is the bound.
    """
    fit = regression(60, ("place",))
    assert isinstance(fit.noise_model, ProcessNoise)
    at_bound = FitProblem(
        fit.layout, replace(fit.noise_model, std=1e3 * fit.theta[-1] * np.ones(3))
    )
    assert at_bound.low[-1] == pytest.approx(fit.theta[-1], rel=1e-12)
    held = replace(fit, problem=at_bound, theta=np.append(fit.theta[:-1], at_bound.low[-1]))
    levels = restricted_levels(held, fit_covariance(fit)[0])
    adjusted, factor = levels.theta, levels.factor
    assert adjusted[-1] == at_bound.low[-1]
    np.testing.assert_array_equal(factor, 1.0)


@pytest.mark.parametrize("samples", [60, 150])
def test_sigmas_know_that_their_noise_level_is_an_estimate(samples: int) -> None:
    """One output: each variance is proportional to sigma^2, whose logarithm has the variance 2/N;
    Student's N degrees of freedom follow.
    """
    fit = regression(samples, ("place",))
    spread = restricted_levels(fit, fit_covariance(fit)[0]).log_variance
    np.testing.assert_allclose(spread[:-1], 2.0 / samples, rtol=0.05)
    assert spread[-1] == 0.0
