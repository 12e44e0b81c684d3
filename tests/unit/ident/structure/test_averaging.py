"""Standard deviations over the models that explain the data as well."""

from __future__ import annotations

import numpy as np
import pytest

from ident.structure.averaging import averaged_covariance
from ident.structure.products import products_of
from sim.aerodynamics import parse_term

NAMES = ("alpha", "beta", "q", "elevator")
OFFERED = tuple(parse_term(text, NAMES) for text in ("1", "alpha", "q", "elevator", "alpha^2"))
LINEAR = (1, 2, 3)


def data(together: float, size: float, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Columns of the offered terms, alpha and elevator correlated, and a coefficient with noise."""
    rng = np.random.default_rng(seed)
    alpha, q, own = rng.standard_normal((3, 200))
    elevator = together * alpha + np.sqrt(1.0 - together**2) * own
    columns = np.stack([np.ones(200), alpha, q, elevator, alpha**2], axis=1)
    return columns, 1.0 + 2.0 * alpha + q + size * elevator + rng.standard_normal(200)


def averaged(columns: np.ndarray, z: np.ndarray, chosen: list[int]) -> tuple[np.ndarray, ...]:
    """Standard deviations of the chosen values, of this model and averaged."""
    part = columns[:, chosen]
    values, square, *_ = np.linalg.lstsq(part, z, rcond=None)
    covariance = float(square[0]) / (len(z) - len(chosen)) * np.linalg.inv(part.T @ part)
    products = products_of([columns], [z], OFFERED)
    even = np.diag(covariance)
    constituents: list[list[int]] = [[], [], [], [], [1]]
    found, other = averaged_covariance(products, chosen, covariance, even, LINEAR, constituents)
    assert other is None or 0.0 < other.probability <= 1.0
    return values, np.sqrt(even), np.sqrt(np.diag(found))


def test_it_is_the_mean_over_the_models_one_term_away() -> None:
    """All models written out: least squares of each, weighted by its probability."""
    columns, z = data(0.9, 0.15)
    chosen = [0, 1, 2]
    values, sigma, found = averaged(columns, z, chosen)
    s2 = float(np.sum((z - columns[:, chosen] @ values) ** 2)) / (200 - 3)
    models = [[0, 1, 2], [0, 1, 2, 3], [0, 1, 2, 4], [0, 2], [0, 1]]
    models += [[0, 2, 3], [0, 1, 3], [0, 1, 4]]  # alpha^2 takes no place of alpha
    logs, seconds = [], []
    for model in models:
        part = columns[:, model]
        fitted, square, *_ = np.linalg.lstsq(part, z, rcond=None)
        # One product is offered: its prior odds are 1, as those of each linear term.
        logs.append(-0.5 * float(square[0]) / s2 - 0.5 * len(model) * np.log(200))
        spread = s2 * np.diag(np.linalg.inv(part.T @ part))
        each = dict(zip(model, zip(fitted, spread, strict=True), strict=True))
        seconds.append(
            [
                each[i][1] + (each[i][0] - value) ** 2 if i in each else value**2
                for i, value in zip(chosen, values, strict=True)
            ]
        )
    shares = np.exp(np.array(logs) - max(logs))
    expected = np.sqrt(np.maximum(shares @ np.array(seconds) / shares.sum(), sigma**2))
    assert found == pytest.approx(expected, rel=2e-3)
    assert found[1] > 1.2 * sigma[1]


def test_models_are_compared_without_the_noise_of_signals() -> None:
    """All models written out by sums from which the known noise of alpha is taken."""
    rng = np.random.default_rng(4)
    n, std = 400, 0.3
    alpha, q, own = rng.standard_normal((3, n))
    elevator = 0.9 * alpha + 0.4 * own
    error = std * rng.standard_normal(n)
    # The coefficient is turned by the measured alpha, as drag is.
    z = 1.0 + 2.0 * alpha + q + 0.1 * elevator + 0.5 * error + 0.5 * rng.standard_normal(n)
    seen = alpha + error
    columns = np.stack([np.ones(n), seen, q, elevator, seen**2], axis=1)
    slopes = std * np.stack([0 * seen, 0 * seen + 1, 0 * seen, 0 * seen, 2 * seen], axis=1)
    turned = np.full(n, 0.5 * std)
    products = products_of([columns], [z], OFFERED, [(slopes[None], turned[None])])
    gram, cross = columns.T @ columns - slopes.T @ slopes, columns.T @ z - slopes.T @ turned
    chosen = [0, 1, 2]

    def fitted(model: list[int]) -> tuple[np.ndarray, np.ndarray, float]:
        inverse = np.linalg.inv(gram[np.ix_(model, model)])
        values = inverse @ cross[model]
        spread = np.diag(inverse @ columns[:, model].T @ columns[:, model] @ inverse)
        return values, spread, float(z @ z - values @ cross[model])

    values, own_spread, _ = fitted(chosen)
    s2 = float(np.sum((z - columns[:, chosen] @ values) ** 2)) / (n - 3)
    models = [[0, 1, 2], [0, 1, 2, 3], [0, 1, 2, 4], [0, 2], [0, 1]]
    models += [[0, 2, 3], [0, 1, 3], [0, 1, 4]]
    logs, seconds = [], []
    for model in models:
        there, spread, left = fitted(model)
        logs.append(-0.5 * left / s2 - 0.5 * len(model) * np.log(n))
        each = dict(zip(model, zip(there, s2 * spread, strict=True), strict=True))
        seconds.append(
            [
                each[i][1] + (each[i][0] - value) ** 2 if i in each else value**2
                for i, value in zip(chosen, values, strict=True)
            ]
        )
    shares = np.exp(np.array(logs) - max(logs))
    expected = np.sqrt(np.maximum(shares @ np.array(seconds) / shares.sum(), s2 * own_spread))
    covariance = np.diag(s2 * own_spread)
    constituents: list[list[int]] = [[], [], [], [], [1]]
    found, _ = averaged_covariance(
        products, chosen, covariance, np.diag(covariance), LINEAR, constituents
    )
    assert np.sqrt(np.diag(found)) == pytest.approx(expected, rel=2e-3)
    assert np.any(expected > 1.1 * np.sqrt(s2 * own_spread))


def test_where_no_other_model_explains_the_data_nothing_changes() -> None:
    columns, z = data(0.0, 3.0)
    _, sigma, found = averaged(columns, z, [0, 1, 2, 3])
    assert np.all(found >= sigma) and found == pytest.approx(sigma, rel=0.05)


def test_intervals_hold_the_truth_where_a_weak_term_is_left_out() -> None:
    """The elevator is left out, however clear it is, and biases alpha."""
    plain, whole = [], []
    for seed in range(300):
        columns, z = data(0.8, 0.2, seed)
        values, sigma, found = averaged(columns, z, [0, 1, 2])
        error = np.abs(values - np.array([1.0, 2.0, 1.0]))
        plain.append(error[1] < 2.0 * sigma[1])
        whole.append(error[1] < 2.0 * found[1])
    # 40 % and 76 %: models two terms away do not count, nor those that a search would choose.
    assert np.mean(plain) < 0.5 and np.mean(whole) > 0.7


def test_the_model_that_makes_deviations_larger_is_named() -> None:
    """The elevator took the place of alpha, with which it is nearly proportional."""
    columns, z = data(0.995, 0.0)
    part = columns[:, [0, 2, 3]]
    values, square, *_ = np.linalg.lstsq(part, z, rcond=None)
    covariance = float(square[0]) / 197 * np.linalg.inv(part.T @ part)
    products = products_of([columns], [z], OFFERED)
    constituents: list[list[int]] = [[], [], [], [], [1]]
    found, other = averaged_covariance(
        products, [0, 2, 3], covariance, np.diag(covariance), LINEAR, constituents
    )
    assert other is not None and (other.added, other.removed) == (1, 3)
    assert other.probability > 0.5 and 2.0 * np.sqrt(found[2, 2]) > abs(values[2])
