"""Local polynomials against fits of single windows, and their width against samples left out one by
one.
"""

from __future__ import annotations

import numpy as np
import pytest

from ident.regression.state_histories import (
    HALF_WIDTHS,
    half_width_by_cross_validation,
    smoothed,
    windows,
)


def record_of(seed: int, noise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Uneven times, values of a sine with noise, and which samples are there."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.015, 0.025, 160))
    values = np.sin(4.0 * time) + noise * rng.standard_normal(160)
    return time, values, rng.random(160) > 0.1


def by_window(
    time: np.ndarray, values: np.ndarray, there: np.ndarray, k: int, half: int
) -> np.ndarray | None:
    """Parabola about sample ``k`` through the samples of its window that are there; None for fewer
    than half.
    """
    first = int(np.clip(k - half, 0, len(time) - 2 * half - 1))
    rows = np.arange(first, first + 2 * half + 1)
    rows = rows[there[rows]]
    if len(rows) < max(4, half + 1):
        return None
    return np.polynomial.polynomial.polyfit(time[rows] - time[k], values[rows], 2)


@pytest.mark.parametrize("half", [3, 8])
def test_value_and_slope_are_those_of_the_parabola_through_the_window(half: int) -> None:
    time, values, there = record_of(1, 0.1)
    fit, curve = windows(time, there, half, 2), smoothed(time, values, there, half)
    slopes = np.sum(fit.slope_weights * fit.gather(values), axis=1)
    for k in range(len(time)):
        found = by_window(time, values, there, k, half)
        assert fit.usable[k] == (found is not None)
        if found is not None:
            assert (curve[k], slopes[k]) == pytest.approx((found[0], found[1]), rel=1e-6, abs=1e-8)


@pytest.mark.parametrize(
    ("gap", "usable"), [(0.15, True), (0.19, True), (0.21, False), (1.0, False)]
)
def test_a_window_that_a_gap_stretches_to_twice_its_length_is_of_no_use(
    gap: float, usable: bool
) -> None:
    """Eleven samples at 50 Hz are 0.2 s long; a gap adds as much as it is longer than a sample."""
    time = 0.02 * np.arange(60)
    time[30:] += gap
    fit = windows(time, np.ones(60, dtype=bool), 5, 2)
    across = np.arange(25, 35)
    assert bool(np.all(fit.usable[across])) is usable and bool(np.any(fit.usable[across])) is usable
    assert np.all(np.delete(fit.usable, across)) and (
        usable or not np.any(fit.value_weights[across])
    )


@pytest.mark.parametrize("noise", [0.003, 0.05, 0.5])
def test_the_width_predicts_samples_best_that_are_left_out(noise: float) -> None:
    time, values, there = record_of(2, noise)
    scores = {}
    for half in (each for each in HALF_WIDTHS if each <= len(time) // 6):
        usable, left = windows(time, there, half, 2).usable, []
        for k in np.flatnonzero(usable & there):
            without = there.copy()
            without[k] = False
            first = int(np.clip(k - half, 0, len(time) - 2 * half - 1))
            rows = np.arange(first, first + 2 * half + 1)
            rows = rows[without[rows]]
            parabola = np.polynomial.polynomial.polyfit(time[rows] - time[k], values[rows], 2)
            left.append(values[k] - parabola[0])
        scores[half] = float(np.mean(np.square(left)))
    assert half_width_by_cross_validation(time, values, there) == min(
        scores, key=lambda half: scores[half]
    )
