"""Noise whose level changes is noise; a residual that is not noise stays what it is."""

from __future__ import annotations

import numpy as np
import pytest

from ident.statistics.noise_levels import _differences, with_constant_level
from ident.statistics.residuals import ljung_box

RUNS = 150


def p_values(make: object, count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    series = [make(rng, count) for _ in range(RUNS)]  # type: ignore[operator]
    return np.array([ljung_box(one, np.ones(count, dtype=bool), "nz").p_value for one in series])


def burst(rng: np.random.Generator, count: int) -> np.ndarray:
    """White noise, four times as loud for a quarter of the series."""
    series = rng.normal(size=count)
    series[count // 3 : count // 3 + count // 4] *= 4.0
    return series


def coloured_in_a_part(rng: np.random.Generator, count: int) -> np.ndarray:
    """White noise, and smooth motion of 0.8 of its size for a quarter of the series."""
    series, part = rng.normal(size=count), count // 4
    smooth = np.convolve(rng.normal(size=part + 50), np.ones(25) / 5.0, "same")[:part]
    series[part : 2 * part] += 0.8 * smooth
    return series


def plain_box(series: np.ndarray, lags: int = 25) -> float:
    """The statistic written out, of the series as it is."""
    centred, n = series - series.mean(), len(series)
    total = float(np.sum(centred**2))
    return (
        n
        * (n + 2)
        * sum(
            (float(np.sum(centred[k:] * centred[: n - k])) / total) ** 2 / (n - k)
            for k in range(1, lags + 1)
        )
    )


@pytest.mark.parametrize("order", [2, 4])
def test_differences_of_white_noise_have_its_own_level_and_none_of_a_slope(order: int) -> None:
    impulse = np.zeros(30)
    impulse[12] = 1.0
    assert np.sum(_differences(impulse, order) ** 2) == pytest.approx(1.0)
    assert np.max(np.abs(_differences(3.0 - 0.2 * np.arange(30.0), order))) < 1e-12


@pytest.mark.parametrize("count", [60, 300])
def test_of_even_noise_the_statistic_is_that_of_ljung_and_box_on_the_samples_that_are_known(
    count: int,
) -> None:
    rng = np.random.default_rng(6)
    series, valid = rng.normal(2.0, 3.0, count), np.ones(count, dtype=bool)
    lags = min(25, count // 5)
    assert ljung_box(series, valid, "q").statistic == pytest.approx(plain_box(series, lags))
    holed = np.insert(series, 7, 1e6)
    known = np.insert(valid, 7, False)
    assert ljung_box(holed, known, "q").statistic == pytest.approx(plain_box(series, lags))


@pytest.mark.long
def test_a_burst_is_no_colour() -> None:
    rng = np.random.default_rng(1)
    plain = np.array([plain_box(burst(rng, 1000)) for _ in range(RUNS)])
    # chi-squared of 25 degrees, one in ten thousand: it would be called coloured
    assert np.mean(plain > 61.6) > 0.4
    assert np.mean(p_values(burst, 1000, 1) < 1e-3) < 0.04


@pytest.mark.parametrize("count", [300, 1000])
def test_even_noise_is_left_alone_to_the_bit(count: int) -> None:
    rng = np.random.default_rng(2)
    for _ in range(RUNS):
        series = rng.normal(size=count)
        assert with_constant_level(series) is series


def test_motion_in_a_part_is_not_taken_for_noise() -> None:
    assert np.mean(p_values(coloured_in_a_part, 1000, 3) < 1e-4) > 0.75


def test_the_burst_comes_out_as_loud_as_the_rest() -> None:
    series = burst(np.random.default_rng(4), 2000)
    level = with_constant_level(series)
    loud, quiet = level[700:1100], level[1300:]
    assert np.std(loud) < 1.5 * np.std(quiet)
    assert np.std(series[700:1100]) > 3.5 * np.std(series[1300:])


def test_a_short_or_exact_series_is_left_alone() -> None:
    assert with_constant_level(np.zeros(500)) is not None and np.all(
        with_constant_level(np.zeros(500)) == 0.0
    )
    short = np.arange(20.0)
    assert with_constant_level(short) is short
