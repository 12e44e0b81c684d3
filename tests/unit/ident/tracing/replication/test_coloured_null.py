"""The colour of residuals: innovations of known autoregressions, and the share of what could be explained that a prediction explains."""

from __future__ import annotations

import numpy as np
import pytest

from ident.tracing.replication.coloured_null import coloured_gain, explained_share, innovation_level
from tests.residual_stubs import left_by


def autoregression(coefficients: tuple[float, ...], std: float, n: int = 6000, seed: int = 1) -> np.ndarray:
    """x[k] = sum_i a_i x[k - i] + e[k], written out; its beginning left out."""
    rng = np.random.default_rng(seed)
    x = np.zeros(n + 500)
    for k in range(len(coefficients), len(x)):
        x[k] = sum(a * x[k - i] for i, a in enumerate(coefficients, start=1)) + std * rng.standard_normal()
    return x[500:]


@pytest.mark.parametrize("coefficients", [(), (0.9,), (1.6, -0.8), (0.5, 0.2, -0.4)])
def test_innovations_of_an_autoregression_are_what_drives_it(coefficients: tuple[float, ...]) -> None:
    series = autoregression(coefficients, 0.3)
    level = innovation_level(series, np.ones(len(series), dtype=bool))
    assert level == pytest.approx(2.0 * np.log(0.3), abs=0.06)


def test_missing_samples_and_silence_do_no_harm() -> None:
    series, rng = autoregression((0.9,), 1.0), np.random.default_rng(2)
    valid = rng.random(len(series)) > 0.05
    assert np.isfinite(innovation_level(np.where(valid, series, 1e9), valid))
    assert np.isfinite(innovation_level(np.zeros(100), np.ones(100, dtype=bool)))


def test_the_order_is_paid_for() -> None:
    """White noise asks for none and is its own innovation; one order costs ln(n)/n a sample."""
    white = autoregression((), 0.3)
    everywhere = np.ones(len(white), dtype=bool)
    assert innovation_level(white, everywhere) == pytest.approx(np.log(np.var(white)), abs=1e-12)
    series = autoregression((0.9,), 0.3)
    centred = series - series.mean()
    reflection = (centred[1:] @ centred[:-1]) / (centred @ centred)
    expected = np.log(np.var(series) * (1.0 - reflection**2)) + np.log(len(series)) / len(series)
    assert innovation_level(series, everywhere) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("left", [0.3, 0.9])
@pytest.mark.parametrize("memory", [0.0, 0.8, 0.95])
def test_the_share_that_is_explained_of_a_residual_that_becomes_smaller(memory: float, left: float) -> None:
    """x[k] = a x[k - 1] + e[k] has the variance of e over 1 - a^2: what follows from its past could be explained, e could not."""
    before = autoregression((memory,), 1.0, n=20000)[None]
    share = explained_share([left_by(before)], [left_by(left * before)])
    explained, possible = -2.0 * np.log(left), -2.0 * np.log(left) - np.log(1.0 - memory**2)
    assert share == pytest.approx(explained / possible, abs=0.02)


def test_all_is_explained_where_white_noise_is_left_and_channels_share_alike() -> None:
    """A slow motion of ten times the noise: down to the noise is all, and of two channels that could lose as much one is half."""
    noise, slow = autoregression((), 1.0, n=4000), 10.0 * np.sin(np.arange(4000) / 300.0)
    both, one = np.stack([noise + slow, noise - slow]), np.stack([noise, noise - slow])
    assert explained_share([left_by(both)], [left_by(np.stack([noise, noise]))]) == pytest.approx(1.0, abs=0.02)
    assert explained_share([left_by(both)], [left_by(one)]) == pytest.approx(0.5, abs=0.05)
    assert explained_share([left_by(both)], [left_by(both)]) == 0.0
    # Records are counted together, and of one that is too short to have a colour nothing is said.
    assert explained_share([left_by(both)] * 2, [left_by(both), left_by(np.stack([noise, noise]))]) == pytest.approx(0.5, abs=0.05)
    assert explained_share([left_by(both[:, :40])], [left_by(both[:, :40])]) == 1.0


def test_what_colour_gains_is_counted_by_sample() -> None:
    """Half the samples for each unit that ln(variance) of the innovations falls; what only changes its colour by being coloured gains nothing."""
    series = autoregression((0.9,), 1.0, n=3000)[None]
    assert coloured_gain([left_by(series)], [left_by(0.5 * series)]) == pytest.approx(3000.0 * np.log(2.0))
    white = autoregression((), 1.0, n=3000)[None]
    assert abs(coloured_gain([left_by(series)], [left_by(white)])) < 0.03 * 3000.0
