"""The covariance correction for coloured residuals: white leaves it alone, coloured gives the
scatter that is really there.
"""

from __future__ import annotations

import numpy as np
import pytest

from ident.statistics.residual_spectrum import autocovariance, corrected_covariance, effective_share
from ident.whole_record.layout import FitSettings
from ident.whole_record.output_error import fit_output_error
from sim.declaration.compile import compile_model
from sim.record import Channel, Record
from tests.bases import fly, rigid_flight, rigid_model
from tests.rigid_problem import FREE


def ar1(rng: np.random.Generator, shape: tuple[int, ...], correlation: float) -> np.ndarray:
    """First-order coloured noise of unit variance along the last axis."""
    out = rng.standard_normal(shape)
    for k in range(1, shape[-1]):
        out[..., k] = correlation * out[..., k - 1] + np.sqrt(1.0 - correlation**2) * out[..., k]
    return out


def regression(
    residual: np.ndarray, X: np.ndarray, valid: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """White and corrected covariance of a linear regression with this residual, ``(1, N)``."""
    valid = np.ones_like(residual, dtype=bool) if valid is None else valid
    variance = np.sum(np.where(valid, residual, 0.0) ** 2, axis=1) / valid.sum(axis=1)
    inverse = np.linalg.inv(np.einsum("in,nj,nk->jk", valid / variance[:, None], X, X))
    return inverse, corrected_covariance(
        inverse, [(np.arange(X.shape[1]), X[None], residual, valid)], variance
    )


def test_autocovariance_is_the_sum_of_products() -> None:
    series = np.random.default_rng(1).normal(size=37)
    expected = [sum(series[i] * series[i + lag] for i in range(37 - lag)) / 37 for lag in range(9)]
    np.testing.assert_allclose(autocovariance(series, 8), expected, rtol=1e-12, atol=1e-14)


def test_white_residuals_leave_sigma_nearly_alone() -> None:
    rng, ratios = np.random.default_rng(3), []
    X = np.stack([np.sin(np.arange(400) / 15.0), np.cos(np.arange(400) / 40.0)], 1)
    for _ in range(40):
        inverse, corrected = regression(rng.standard_normal((1, 400)), X)
        ratios.append(np.sqrt(np.diag(corrected) / np.diag(inverse)))
    assert np.all(np.min(ratios, axis=0) >= 1.0 - 1e-12)
    assert np.all(np.mean(ratios, axis=0) < 1.15)


@pytest.mark.long
@pytest.mark.parametrize("correlation", [0.6, 0.9, 0.97])
def test_coloured_regression_has_the_scatter_that_is_stated(correlation: float) -> None:
    """Against the closed form of an AR(1) regression, (X'X)^-1 X' R X (X'X)^-1 with R = rho^|i -
    j|; and two sigmas hold 95 %.
    """
    n, runs = 500, 400
    rng, X = (
        np.random.default_rng(4),
        np.stack([np.sin(np.arange(n) / 15.0), np.cos(np.arange(n) / 40.0)], 1),
    )
    solver, errors, stated, white = np.linalg.pinv(X), [], [], []
    for _ in range(runs):
        noise = ar1(rng, (n,), correlation)
        estimate = solver @ noise
        inverse, corrected = regression((noise - X @ estimate)[None], X)
        errors.append(estimate)
        stated.append(np.diag(corrected))
        white.append(np.diag(inverse))
    R = correlation ** np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    exact = np.sqrt(np.diag(solver @ R @ solver.T))
    ratio = np.median(np.sqrt(stated), axis=0) / exact
    # Student's factor is in it: of noise with a long memory 500 samples are few.
    assert np.all(ratio > 0.95) and np.all(ratio < {0.6: 1.06, 0.9: 1.12, 0.97: 1.3}[correlation])
    inside = np.mean(np.abs(errors) < 2.0 * np.sqrt(stated), axis=0)
    # The standard error of a share of 400 is 1 %.
    assert np.all(inside > 0.925) and np.all(inside < 0.985)
    assert np.all(np.median(np.sqrt(white), axis=0) / exact < (0.6 if correlation == 0.6 else 0.35))


def test_missing_samples_do_not_count() -> None:
    rng = np.random.default_rng(5)
    X, residual = rng.normal(size=(200, 2)), ar1(rng, (1, 200), 0.7)
    valid = rng.random((1, 200)) < 0.7
    spoilt = np.where(valid, residual, 0.0)
    X_spoilt = np.where(valid[0][:, None], X, 1e6)
    inverse, corrected = regression(spoilt, X, valid)
    variance = np.sum(spoilt**2, axis=1) / valid.sum(axis=1)
    again = corrected_covariance(inverse, [(np.arange(2), X_spoilt[None], spoilt, valid)], variance)
    np.testing.assert_allclose(again, corrected, rtol=1e-12)


@pytest.mark.long
def test_output_error_sigma_matches_the_scatter_of_coloured_noise() -> None:
    model, flight, rng = rigid_model(), rigid_flight(6.0, 25.0), np.random.default_rng(6)
    system = compile_model(model)
    clean, std = np.array(fly(system, flight)), np.array([0.002, 0.002, 0.01])
    errors, corrected, white = [], [], []
    for run in range(40):
        z = clean + std[:, None] * ar1(rng, clean.shape, 0.8)
        channels = tuple(
            Channel.of(name, "1", row) for name, row in zip(("alpha", "q", "nz"), z, strict=True)
        )
        record = Record(flight.time, (Channel.of("elevator", "rad", flight.u[0]),), channels)
        estimate = fit_output_error([record], system, FitSettings(max_step=0.04))
        errors.append(estimate.values - model.parameters.values(FREE))
        corrected.append(estimate.std**2)
        if run < 8:
            white.append(
                fit_output_error([record], system, FitSettings(max_step=0.04, coloured=False)).std
                ** 2
            )
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    # 40 runs tell a scatter to 11 %.
    honest = np.sqrt(np.mean(corrected, axis=0)) / rms
    assert np.all(honest > 0.7) and np.all(honest < 1.5)
    assert np.all(np.sqrt(np.mean(white, axis=0)) < np.sqrt(np.mean(corrected, axis=0)))
    assert np.median(np.sqrt(np.mean(white, axis=0)) / rms) < 0.6


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_share_of_samples_that_count_follows_bartlett(rho: float) -> None:
    """1/(1 + 2 sum rho^2k) = (1 - rho^2)/(1 + rho^2) for a first-order colour."""
    series = ar1(np.random.default_rng(1), (1, 6000), rho)
    share = effective_share([series], [np.ones(series.shape, dtype=bool)])
    assert share == pytest.approx((1.0 - rho**2) / (1.0 + rho**2), rel=0.2)


def test_a_prior_keeps_the_combination_that_the_record_knows() -> None:
    # Only the sum of two parameters is seen: each alone is as uncertain as the prior says, the sum
    # is not.
    rng = np.random.default_rng(5)
    slope = np.sin(np.arange(500) / 20.0)
    X, residual = np.stack([slope, slope], 1), rng.standard_normal((1, 500))
    prior, variance = np.eye(2), np.array([float(np.mean(residual**2))])
    inverse = np.linalg.inv(X.T @ X / variance + prior)
    corrected = corrected_covariance(
        inverse, [(np.arange(2), X[None], residual, np.ones((1, 500), dtype=bool))], variance, prior
    )
    assert np.diag(corrected) == pytest.approx(0.5, rel=0.02)
    assert np.ones(2) @ corrected @ np.ones(2) == pytest.approx(
        np.ones(2) @ inverse @ np.ones(2), rel=0.5
    )
