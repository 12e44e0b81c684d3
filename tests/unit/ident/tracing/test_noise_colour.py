"""Noise with two levels, held against white noise and against a second way of computing it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from ident.tracing.evidence import evidence_of
from ident.tracing.problem import search_context
from ident.whole_record.coloured_noise import ColouredNoise, cosine_transform, fast_transform_blocks
from ident.whole_record.gauss_newton import Fit
from sim.declaration.proposal import Traceable
from sim.effects.library import effects_for
from sim.record import Record
from tests.diagnoses import NOISE
from tests.tracing_problem import OUTPUTS, declared, fit_of, planted, problem_of, with_output


def filtered_noise(record: Record, seed: int) -> Record:
    """A record with noise in addition to its own: white noise behind a filter of 8 Hz."""
    rng = np.random.default_rng(seed)
    interval = float(record.time[1] - record.time[0])
    b, a = butter(2, 8.0 * 2.0 * interval)
    for name in OUTPUTS:
        added = 3.0 * NOISE[name] * lfilter(b, a, rng.standard_normal(len(record)))
        record = with_output(record, name, record[name].values + added)
    return record


def smooth_fit(seed: int = 3) -> Fit:
    return fit_of(problem_of([filtered_noise(planted(seed=seed), seed)])).fit


def test_white_noise_has_two_levels_alike() -> None:
    noise = ColouredNoise(fit_of(problem_of([planted(seed=3)])).fit)
    gained = noise.log_likelihood - noise.fit.log_likelihood
    # Twice the gain by one more level for each of three outputs is chi-squared.
    assert 0.0 <= gained < 10.0


def cosine_basis(n: int) -> np.ndarray:
    k = np.arange(n)
    basis = np.sqrt(2.0 / n) * np.cos(np.pi * np.outer(k, k + 0.5) / n)
    basis[0] /= np.sqrt(2.0)
    return np.asarray(basis)


@pytest.mark.parametrize("n", [1, 2, 23, 240, 1201])
def test_the_transform_is_that_of_blocks_and_its_inverse_brings_the_values_back(n: int) -> None:
    values = np.random.default_rng(n).standard_normal((2, 3, n))
    found = cosine_transform(values)
    for block in fast_transform_blocks(n):
        wanted = values[..., block] @ cosine_basis(block.stop - block.start).T
        np.testing.assert_allclose(found[..., block], wanted, atol=1e-11)
    np.testing.assert_allclose(cosine_transform(found, inverse=True), values, atol=1e-11)


def test_the_likelihood_is_that_of_independent_cosine_coefficients() -> None:
    fit = smooth_fit()
    noise, total = ColouredNoise(fit), 0.0
    (problem,), (residual,) = fit.layout.problems, fit.residuals
    interval = float(problem.record.time[1] - problem.record.time[0])
    for each in residual:
        found, frequency = [], []
        for block in fast_transform_blocks(residual.shape[1]):
            n = block.stop - block.start
            found += list(cosine_basis(n) @ each[block])
            frequency += [k / (2 * n * interval) for k in range(n)]
        low = np.array(frequency) < 4.0
        for part in (np.array(found)[low], np.array(found)[~low]):
            total -= 0.5 * len(part) * (np.log(2.0 * np.pi * np.mean(part**2)) + 1.0)
    assert noise.log_likelihood == pytest.approx(total, rel=1e-9)
    assert noise.log_likelihood > fit.log_likelihood + 50.0


def test_whitened_residuals_have_mean_square_one_and_the_same_in_time() -> None:
    noise = ColouredNoise(smooth_fit())
    over_frequency, in_time = noise.residual(0), noise.in_time(0)
    assert np.mean(over_frequency**2, axis=1) == pytest.approx(np.ones(3), rel=1e-9)
    assert np.sum(in_time**2) == pytest.approx(np.sum(over_frequency**2), rel=1e-9)


def test_normal_equations_are_those_of_whitened_sensitivities() -> None:
    noise = ColouredNoise(smooth_fit())
    normal, gradient = noise.normal_equations()
    A, e = noise.sensitivities(0), noise.residual(0)
    flat = A.reshape(-1, A.shape[2])
    at = np.arange(len(gradient))[noise.fit.layout.columns(0)]
    np.testing.assert_allclose(normal[np.ix_(at, at)], flat.T @ flat, rtol=1e-8, atol=1e-6)
    np.testing.assert_allclose(gradient[at], flat.T @ e.ravel(), rtol=1e-6, atol=1e-5)


def test_filtered_noise_does_not_make_evidence_for_an_absent_effect() -> None:
    """Under white noise the log evidence of an absent effect scatters by more."""
    (drift,) = [each for each in effects_for(declared().equations) if each.name == "sensor-drift:q"]
    assert isinstance(drift, Traceable)
    gained, white = [], []
    for seed in range(12):
        problem = problem_of([filtered_noise(planted(seed=seed), seed)], [drift])
        less, more = fit_of(problem), fit_of(problem, [drift])
        context = search_context(less, problem.predicted)
        gained.append(evidence_of(more, context)[0] - evidence_of(less, context)[0])
        white.append(more.fit.log_likelihood - less.fit.log_likelihood)
    assert max(gained) < 0.8 * max(white)
    assert max(gained) < 5.0


@pytest.mark.parametrize("colour", ["white", "coloured"])
def test_products_of_moved_columns_are_those_of_columns_moved_one_by_one(colour: str) -> None:
    fit = smooth_fit() if colour == "coloured" else fit_of(problem_of([planted(seed=3)])).fit
    (problem,) = fit.layout.problems
    count, rng = problem.valid.shape[1], np.random.default_rng(1)
    valid = problem.valid.copy()
    valid[1, 40:60] = False
    masked = replace(problem, valid=valid)
    fit = replace(fit, problem=replace(fit.problem, layout=replace(fit.layout, problems=(masked,))))
    noise = ColouredNoise(fit)
    columns, others = rng.standard_normal((2, count)), rng.standard_normal((3, count))
    squares, products = noise.products_at_all_shifts(0, 1, columns, others)
    sigma = np.sqrt(fit.variance[1])
    for shift in (0, 1, count // 2, count - 2):
        moved = np.zeros((2, 1, count))
        moved[:, 0, shift:] = columns[:, : count - shift]
        (whitened,) = noise.whitened(
            0, np.where(valid[1], moved, 0.0) / sigma, slice(1, 2)
        ).swapaxes(0, 1)
        size = float(np.abs(whitened @ whitened.T).max())
        np.testing.assert_allclose(squares[shift], whitened @ whitened.T, atol=1e-9 * size)
        np.testing.assert_allclose(products[shift], whitened @ others.T, atol=1e-9 * size)
