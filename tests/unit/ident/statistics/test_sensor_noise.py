"""Sensor noise from residuals that hold motion besides: within ten per cent where the noise alone,
drift, first and second order motion are left.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from ident.statistics.noise_levels import _cosine_transform, sensor_noise, used_runs

SEEDS, SAMPLES, SIGMA = 60, 1000, 0.3


def first_order(rng: np.random.Generator, corner: float) -> np.ndarray:
    """Runs ``(SEEDS, SAMPLES)`` of unit variance of a motion with a time constant of ``corner``
    samples.
    """
    pole = np.exp(-1.0 / corner)
    driven = rng.standard_normal((SEEDS, SAMPLES + 500))
    return (
        np.sqrt(1.0 - pole**2) * np.asarray(lfilter([1.0], [1.0, -pole], driven, axis=1))[:, 500:]
    )


def second_order(rng: np.random.Generator, omega: float, damping: float) -> np.ndarray:
    """The same of an oscillation of ``omega`` rad a sample."""
    radius = np.exp(-damping * omega)
    driven = rng.standard_normal((SEEDS, SAMPLES + 1000))
    found = np.asarray(
        lfilter(
            [1.0],
            [1.0, -2.0 * radius * np.cos(omega * np.sqrt(1.0 - damping**2)), radius**2],
            driven,
            axis=1,
        )
    )[:, 1000:]
    return found / found.std(axis=1, keepdims=True)


def left_besides(kind: str, rng: np.random.Generator) -> np.ndarray:
    k = np.arange(SAMPLES) / SAMPLES
    return {
        "nothing": lambda: np.zeros((SEEDS, SAMPLES)),
        "drift": lambda: np.tile(8.0 * k, (SEEDS, 1)),
        "a tone": lambda: 5.0 * np.sin(10.0 * np.pi * k + rng.uniform(0.0, 6.0, (SEEDS, 1))),
        "gusts": lambda: first_order(rng, 25.0),
        "slow gusts": lambda: 3.0 * first_order(rng, 100.0),
        "a short period": lambda: 3.0 * second_order(rng, 0.08, 0.3),
        "a mode": lambda: 2.0 * second_order(rng, 0.3, 0.05),
    }[kind]()


@pytest.mark.sampled
@pytest.mark.parametrize(
    "kind", ["nothing", "drift", "a tone", "gusts", "slow gusts", "a short period", "a mode"]
)
def test_the_noise_is_found_within_ten_per_cent(kind: str) -> None:
    rng = np.random.default_rng(7)
    residuals = SIGMA * (rng.standard_normal((SEEDS, SAMPLES)) + left_besides(kind, rng))
    found = np.array([sensor_noise([row]) for row in residuals], dtype=float) / SIGMA
    assert np.mean(np.abs(found - 1.0) < 0.1) >= 0.9, np.round(found, 3)
    assert abs(found.mean() - 1.0) < 0.05
    if kind != "nothing":
        assert np.all(residuals.std(axis=1) > 1.2 * SIGMA), "the residual itself is no estimate"


def test_two_records_give_one_noise_and_scale_with_it() -> None:
    rng = np.random.default_rng(1)
    runs = [rng.standard_normal(600) + np.linspace(0.0, 4.0, 600), rng.standard_normal(400)]
    one = sensor_noise(runs)
    assert one == pytest.approx(1.0, abs=0.1) and sensor_noise(
        [10.0 * run for run in runs]
    ) == pytest.approx(10.0 * (one or 0.0), rel=1e-9)


def test_what_tells_nothing_gives_nothing() -> None:
    assert sensor_noise([]) is None and sensor_noise([np.ones(10)]) is None
    assert sensor_noise([np.zeros(500)]) is None
    assert sensor_noise([np.random.default_rng(0).standard_normal(40)]) is None, (
        "twenty coefficients tell too little"
    )


def test_a_long_pause_parts_runs_and_a_sample_set_aside_does_not() -> None:
    time = np.concatenate([np.arange(50) * 0.02, 5.0 + np.arange(50) * 0.02])
    used = np.ones(100, dtype=bool)
    used[[10, 70]] = False
    runs = used_runs(time, np.arange(100.0), used)
    assert [len(run) for run in runs] == [49, 49] and runs[1][0] == 50.0
    assert used_runs(time, time, np.zeros(100, dtype=bool)) == []


@pytest.mark.parametrize("count", [16, 17, 101, 1000])
def test_the_cosine_transform_is_scipys(count: int) -> None:
    from scipy.fft import dct

    x = np.random.default_rng(count).standard_normal(count)
    np.testing.assert_allclose(
        _cosine_transform(x)[1:], dct(x, norm="ortho")[1:], rtol=0.0, atol=1e-12
    )
