"""Spectra of residuals: autoregressions against Lyapunov's equation, sums over frequencies against
sums over samples, causes that outputs share.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov
from scipy.stats import t

from ident.statistics.residual_spectrum import (
    RecordScores,
    _ScoreTransforms,
    autoregression,
    common_disturbance,
    joint_autoregressions,
    paired_autocovariance,
    sandwich,
    score_covariance,
    student_factor,
)

A1 = np.array([[-0.8, 0.2, 0.0], [0.1, -0.5, 0.1], [0.0, -0.3, -0.6]])
NOISE = np.array([[1.0, 0.3, 0.0], [0.3, 2.0, 0.5], [0.0, 0.5, 1.0]])


def lags(count: int) -> np.ndarray:
    """Autocovariances of e[k] + A1 e[k - 1] = w[k], ``(count + 1, 3, 3)``, from Lyapunov's
    equation.
    """
    out = [solve_discrete_lyapunov(-A1, NOISE)]
    for _ in range(count):
        out.append(-A1 @ out[-1])
    return np.array(out)


def series(rng: np.random.Generator, count: int) -> np.ndarray:
    """The process ``(3, count)``, begun as if it had run for ever."""
    root, e = np.linalg.cholesky(NOISE), np.empty((3, count))
    e[:, 0] = np.linalg.cholesky(lags(0)[0]) @ rng.standard_normal(3)
    for k in range(1, count):
        e[:, k] = -A1 @ e[:, k - 1] + root @ rng.standard_normal(3)
    return e


def white(scores: np.ndarray, residual: np.ndarray) -> RecordScores:
    return RecordScores(
        np.arange(scores.shape[2]), scores, scores, residual, np.ones(residual.shape, dtype=bool)
    )


def test_an_autoregression_is_recovered_from_its_autocovariance() -> None:
    first, second = list(joint_autoregressions(lags(6), 600.0))[:2]
    np.testing.assert_allclose(first.coefficients, A1[None], atol=1e-12)
    np.testing.assert_allclose(first.covariance, NOISE, atol=1e-12)
    np.testing.assert_allclose(second.coefficients, [A1, np.zeros((3, 3))], atol=1e-10)
    assert first.criterion < second.criterion
    # Of one output: Yule and Walker of AR(2), rho_1 = a1/(1 - a2) with e[k] = a1 e[k - 1] + a2 e[k
    # - 2] + w[k].
    rho = [1.0, 1.2 / 1.5]
    for _ in range(4):
        rho.append(1.2 * rho[-1] - 0.5 * rho[-2])
    coefficients, variance = autoregression(np.array(rho), 1000.0)
    np.testing.assert_allclose(coefficients, [-1.2, 0.5], atol=1e-12)
    assert variance == pytest.approx(1.0 - 1.2 * rho[1] + 0.5 * rho[2], rel=1e-12)


def test_autocovariances_of_what_is_no_process_end_the_search() -> None:
    assert list(joint_autoregressions(np.array([np.eye(2), 1.5 * np.eye(2)]), 500.0)) == []
    coefficients, variance = autoregression(np.array([1.0, 1.5]), 500.0)
    assert coefficients.size == 0 and variance == 1.0


def test_pairs_with_missing_samples_count_what_is_there() -> None:
    rng = np.random.default_rng(1)
    residual, valid = rng.normal(size=(2, 50)), rng.random((2, 50)) < 0.7
    found = paired_autocovariance(np.where(valid, residual, 0.0), valid, 4)
    for k in range(5):
        for i in range(2):
            for j in range(2):
                there = [s for s in range(50 - k) if valid[i, s + k] and valid[j, s]]
                expected = (
                    np.mean([residual[i, s + k] * residual[j, s] for s in there]) * (50 - k) / 50
                )
                assert found[k, i, j] == pytest.approx(expected, rel=1e-9)


@pytest.mark.long
def test_the_covariance_of_a_gradient_is_the_double_sum_of_its_noise() -> None:
    """Gradients of many series have the scatter that the mean of the estimated covariances says,
    and the exact double sum says too.
    """
    rng, n = np.random.default_rng(2), 300
    scores = np.cumsum(rng.normal(size=(3, n, 2)), axis=1) / 10.0
    R = lags(n)
    exact = np.zeros((2, 2))
    for a in range(n):
        for b in range(n):
            exact += scores[:, a].T @ (R[a - b] if a >= b else R[b - a].T) @ scores[:, b]
    # No unknown follows the noise: the inverse is zero, and the autocovariances stay as they are.
    found = [
        score_covariance([white(scores, series(rng, n))], np.zeros((2, 2))).middle
        for _ in range(60)
    ]
    np.testing.assert_allclose(
        np.sqrt(np.diag(np.median(found, axis=0))), np.sqrt(np.diag(exact)), rtol=0.08
    )
    apart = sum(
        scores[i, a][:, None] * scores[i, b] * R[abs(a - b)][i, i]
        for i in range(3)
        for a in range(n)
        for b in range(n)
    )
    # What outputs share matters here: as if each had noise of its own, the answer is another.
    assert np.any(np.abs(np.diag(apart) / np.diag(exact) - 1.0) > 0.2)


@pytest.mark.long
def test_what_a_fit_takes_from_its_residuals_is_given_back() -> None:
    """Four slow unknowns of 200 samples of AR(1) noise: variances from the residuals as they are
    come out a third too small.
    """
    rng, n, k = np.random.default_rng(3), 200, 4
    X = np.stack([np.cos(np.pi * j * (np.arange(n) + 0.5) / n) for j in range(k)], 1)
    inverse = np.linalg.inv(X.T @ X)
    R = 0.8 ** np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    exact = np.diag(inverse @ X.T @ R @ X @ inverse)
    root, given, plain = np.linalg.cholesky(R), [], []
    for _ in range(100):
        noise = root @ rng.standard_normal(n)
        residual = (noise - X @ (inverse @ (X.T @ noise)))[None]
        scores = RecordScores(np.arange(k), X[None], X[None], residual, np.ones((1, n), dtype=bool))
        given.append(np.diag(inverse @ score_covariance([scores], inverse).middle @ inverse))
        plain.append(np.diag(inverse @ score_covariance([scores], 0.0 * inverse).middle @ inverse))
    corrected, not_corrected = (np.mean(each, axis=0) / exact for each in (given, plain))
    np.testing.assert_allclose(corrected, 1.0, atol=0.25)
    assert np.all(not_corrected < 0.75)


def test_the_noise_that_a_fit_follows_is_taken_from_covariances_of_all_pairs_of_samples() -> None:
    """By transforms as by dense matrices: with the noise's covariance G of all samples, a residual
    (I - J S) e has G - J S G - G S^T J^T + J S G S^T J^T.
    """
    rng, m, n, c = np.random.default_rng(4), 3, 60, 4
    jacobian = np.cumsum(rng.normal(size=(m, n, c)), axis=1)
    weights = jacobian * np.array([1.0, 0.5, 2.0])[:, None, None]
    residual = series(rng, n)
    flat = jacobian.transpose(1, 0, 2).reshape(-1, c)  # sample by sample
    inverse = np.linalg.inv(flat.T @ weights.transpose(1, 0, 2).reshape(-1, c))
    scores = RecordScores(np.arange(c), weights, jacobian, residual, np.ones((m, n), dtype=bool))
    record = _ScoreTransforms(scores)
    scale = np.sqrt(np.mean(residual**2, axis=1))
    noise = np.fft.irfft(record.density, record.size, axis=0)
    shift = np.subtract.outer(np.arange(n), np.arange(n))
    G = noise[shift].transpose(0, 2, 1, 3).reshape(m * n, m * n)
    J = flat / np.tile(scale, n)[:, None]
    S = inverse @ (weights.transpose(1, 0, 2).reshape(-1, c) * np.tile(scale, n)[:, None]).T
    followed = J @ S @ G + G @ S.T @ J.T - J @ S @ G @ S.T @ J.T
    blocks = followed.reshape(n, m, n, m)
    expected = [
        record.measured[k] + sum(blocks[s + k, :, s] for s in range(n - k)) / n
        for k in range(record.lags + 1)
    ]
    np.testing.assert_allclose(
        inverse @ record.score_covariance() @ inverse.T, S @ G @ S.T, rtol=1e-9
    )
    record.refit(inverse, S @ G @ S.T)
    np.testing.assert_allclose(record.autocovariance, expected, rtol=1e-9, atol=1e-12)


def test_sigmas_of_few_samples_are_students() -> None:
    """A mean of n white samples has n - 1 degrees of freedom; the level alone is unknown, so
    Satterthwaite's are n.
    """
    residual = np.random.default_rng(1).standard_normal((1, 20))
    scores = white(np.ones((1, 20, 1)), residual)
    found = score_covariance([scores], np.array([[1.0 / 20.0]]))
    variance = found.middle[0, 0] / 400.0
    assert student_factor(np.array([variance]), found.spread)[0] == pytest.approx(
        t.ppf(0.97725, 20) / 2.0, rel=0.01
    )
    assert np.sqrt(sandwich(np.array([[1.0 / 20.0]]), [scores])[0, 0]) == pytest.approx(
        np.sqrt(variance) * t.ppf(0.97725, 20) / 2.0, rel=0.01
    )
    np.testing.assert_array_equal(student_factor(np.array([2.0]), np.array([0.0])), 1.0)


def test_a_cause_that_outputs_share_is_seen_and_noise_of_each_is_not() -> None:
    rng, seen, not_seen = np.random.default_rng(6), 0, 0
    for _ in range(20):
        gust = np.zeros(600)
        for k in range(1, 600):
            gust[k] = 0.97 * gust[k - 1] + 0.24 * rng.standard_normal()
        late = np.concatenate([np.zeros(15), gust[:-15]])
        sensors = 0.3 * rng.standard_normal((3, 600))
        seen += common_disturbance(
            [sensors + np.array([gust, late, 0.5 * (gust + late)])], [np.ones((3, 600), dtype=bool)]
        )
        own = rng.standard_normal((3, 600))
        for k in range(1, 600):
            own[:, k] = 0.9 * own[:, k - 1] + 0.44 * own[:, k]
        not_seen += not common_disturbance([own], [np.ones((3, 600), dtype=bool)])
    assert seen == 20 and not_seen >= 19
    assert not common_disturbance([np.zeros((2, 50))], [np.ones((2, 50), dtype=bool)])


@pytest.mark.parametrize("lags", [[0.0, 1.0], [-1.0, 0.5], [1e-300, 1e10, 1.0]])
def test_the_autocovariance_of_no_process_has_no_memory(lags: list[float]) -> None:
    with np.errstate(all="raise"):
        coefficients, variance = autoregression(np.array(lags), 100.0)
    assert len(coefficients) == 0 and variance == max(lags[0], 1e-300)


def test_unknowns_that_explain_more_than_all_noise_leave_the_residuals_spectrum() -> None:
    rng = np.random.default_rng(4)
    jacobian = np.ones((1, 200, 1)) + 1e-3 * rng.standard_normal((1, 200, 1))
    residual = rng.standard_normal((1, 200))
    known = np.ones((1, 200), dtype=bool)
    scores = RecordScores(np.array([0]), jacobian, jacobian, residual, known)
    with np.errstate(all="raise"):
        # A covariance a thousand times too large takes more from the noise than there is.
        found = score_covariance([scores], np.array([[-1.0]]))
    assert np.all(np.isfinite(found.middle)) and found.middle[0, 0] > 0.0
