"""Random series against theory. Bounds are four standard errors of the statistic, from the
process's own autocovariance.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from sim.errors import ModelError
from sim.truth.measurement import coloured_noise, dryden_gust, white_noise

RUNS = 400
L, V, SIGMA = 60.0, 50.0, 1.5


def test_white_noise_has_its_variance_and_no_memory() -> None:
    n = 40000
    x = white_noise(np.random.default_rng(1), n, 0.3)
    assert np.var(x) == pytest.approx(0.09, abs=4 * 0.09 * math.sqrt(2 / n))
    for lag in (1, 2, 7):
        assert np.mean(x[lag:] * x[:-lag]) == pytest.approx(0.0, abs=4 * 0.09 / math.sqrt(n))


def uneven() -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(np.tile([0.01, 0.4, 0.03, 2.0], 5))])


def test_coloured_noise_has_its_covariance_at_any_sampling() -> None:
    t = uneven()
    rng = np.random.default_rng(2)
    x = np.array([coloured_noise(rng, t, 0.7, 0.5) for _ in range(RUNS * 5)])
    expected = 0.49 * np.exp(-np.abs(t[:, None] - t) / 0.5)
    assert_covariance(x, expected)


def dryden_covariance(lag: np.ndarray) -> np.ndarray:
    """sigma^2 (1 - s / 2) exp(-s), s = V lag / L: inverse transform of the spectrum."""
    s = np.abs(lag) * V / L
    return SIGMA**2 * (1 - 0.5 * s) * np.exp(-s)


def test_dryden_gust_has_its_covariance_at_any_sampling() -> None:
    t = uneven()
    rng = np.random.default_rng(3)
    x = np.array([dryden_gust(rng, t, SIGMA, L, V) for _ in range(RUNS * 5)])
    assert_covariance(x, dryden_covariance(t[:, None] - t))


def assert_covariance(x: np.ndarray, expected: np.ndarray) -> None:
    """Sample covariance of zero-mean Gaussian rows: variance of an entry (c_ii c_jj + c_ij^2) /
    runs; 4.5 sigma for many entries.
    """
    runs = len(x)
    found = x.T @ x / runs
    variance = np.diag(expected)
    error = np.sqrt((variance[:, None] * variance + expected**2) / runs)
    assert np.max(np.abs(found - expected) / error) < 4.5


@pytest.mark.long
def test_dryden_spectrum_is_that_of_the_specification() -> None:
    dt, n, runs = 0.02, 2048, 200
    rng = np.random.default_rng(4)
    power = np.zeros(n // 2 + 1)
    window = np.hanning(n)
    for _ in range(runs):
        power += np.abs(np.fft.rfft(window * dryden_gust(rng, np.arange(n) * dt, SIGMA, L, V))) ** 2
    density = power * dt / np.sum(window**2) / runs
    omega = 2 * math.pi * np.fft.rfftfreq(n, dt)
    wave = L * omega / V
    # Phi over Omega >= 0 in rad/m becomes a two-sided density per hertz by pi / V.
    expected = SIGMA**2 * (L / math.pi) * (1 + 3 * wave**2) / (1 + wave**2) ** 2 * math.pi / V
    bands = np.array_split(np.arange(4, 120), 8)
    for band in bands:
        ratio = np.mean(density[band] / expected[band])
        # Mean of len(band) * runs periodogram values, their correlation by the window (factor
        # 1.94); 1 % for aliasing and leakage.
        assert ratio == pytest.approx(1.0, abs=4 * math.sqrt(1.94 / (len(band) * runs)) + 0.01)


def test_fine_steps_do_not_lose_the_gust() -> None:
    t = np.arange(20001) * 1e-5
    gust = dryden_gust(np.random.default_rng(5), t, SIGMA, L, V)
    # Locally a Wiener process: increments of variance sigma^2 3 V / L dt (derivative of the
    # covariance at zero is -3/2 sigma^2 V / L).
    quadratic = np.sum(np.diff(gust) ** 2)
    assert quadratic == pytest.approx(
        3 * SIGMA**2 * V / L * t[-1], rel=4 * math.sqrt(2 / 20000) + 1e-3
    )


def test_same_generator_state_gives_the_same_bytes() -> None:
    t = uneven()
    for make in (
        lambda rng: coloured_noise(rng, t, 1.0, 0.3),
        lambda rng: dryden_gust(rng, t, 1.0, 50.0, 60.0),
        lambda rng: white_noise(rng, 9, 2.0),
    ):
        assert make(np.random.default_rng(6)).tobytes() == make(np.random.default_rng(6)).tobytes()


def test_bad_numbers_are_refused() -> None:
    rng, t = np.random.default_rng(7), np.arange(4.0)
    for make in (
        lambda: white_noise(rng, 3, -1.0),
        lambda: coloured_noise(rng, t, 1.0, 0.0),
        lambda: coloured_noise(rng, t, math.nan, 1.0),
        lambda: dryden_gust(rng, t, 1.0, -5.0, 50.0),
        lambda: dryden_gust(rng, t, 1.0, 5.0, 0.0),
    ):
        with pytest.raises(ModelError, match="noise"):
            make()
