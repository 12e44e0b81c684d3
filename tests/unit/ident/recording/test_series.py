"""The step of a converter, under later calibration and printing; noise that samples can bear."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ident.recording.series import least_bit, measurable_noise

STEP = 360.0 / 65536.0


def walk(seed: int, noise: float) -> np.ndarray:
    """A motion in steps of the converter."""
    rng, k = np.random.default_rng(seed), np.arange(800)
    return STEP * np.round(
        (3.0 * np.sin(k / 80.0) + noise * STEP * rng.standard_normal(800)) / STEP
    )


@pytest.mark.parametrize("seed", range(5))
def test_the_step_is_seen_after_printing_and_under_a_calibration_that_drifts(seed: int) -> None:
    levels = walk(seed, 0.7)
    printed = np.round(levels, 5)
    drifting = np.round(levels * (1.0 + 0.02 * np.linspace(-1.0, 1.0, 800)), 5)
    for values in (levels, printed, drifting):
        assert least_bit(values) == pytest.approx(STEP, rel=0.03)


@pytest.mark.parametrize("seed", range(20))
def test_noise_and_motion_have_no_step(seed: int) -> None:
    rng, k = np.random.default_rng(seed), np.arange(600)
    values = np.sin(k / rng.uniform(5.0, 80.0)) + 10.0 ** rng.uniform(
        -4.0, 0.0
    ) * rng.standard_normal(600)
    assert least_bit(values) == 0.0
    assert least_bit(np.round(values, 6)) < 1.1e-6


def test_no_noise_is_smaller_than_rounding_or_measured_in_a_computed_channel() -> None:
    rounded, smooth = walk(1, 0.0), np.sin(np.arange(800) / 80.0)
    assert measurable_noise(1e-12, [rounded]) == pytest.approx(STEP / math.sqrt(12.0), rel=0.01)
    assert measurable_noise(0.02, [rounded]) == 0.02
    assert measurable_noise(3e-13, [smooth]) is None and measurable_noise(None, [rounded]) is None


def test_a_steady_fall_on_uneven_samples_shows_its_printed_step_alone() -> None:
    rng = np.random.default_rng(6)
    time = np.cumsum(rng.choice([0.1, 0.2], 150, p=[0.7, 0.3]))
    assert least_bit(np.round(4000.0 - 147.0 * time)) == 1.0
