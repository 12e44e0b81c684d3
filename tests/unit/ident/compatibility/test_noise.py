"""A channel's roughness is the variance of its white noise, with motion and switches or without."""

from __future__ import annotations

import numpy as np
import pytest

from ident.compatibility.check import compatibility
from ident.compatibility.signals import roughness, rounding_variance
from ident.compatibility.trials import CompatibilitySettings
from tests.recorded_flight import flight, rounded

COUNT = 20_000


@pytest.mark.parametrize("std", [1e-3, 0.5])
def test_the_roughness_of_white_noise_is_its_variance(std: float) -> None:
    """Within four deviations of a median of 20,000 correlated differences: 5 % of the variance."""
    assert roughness(std * np.random.default_rng(1).standard_normal(COUNT)) == pytest.approx(
        std**2, rel=0.06
    )


def test_smooth_motion_and_a_few_switches_add_nothing() -> None:
    noise, at = 1e-3 * np.random.default_rng(2).standard_normal(COUNT), np.arange(COUNT)
    moved = noise + 1e-4 * at - 1e-7 * at**2 + np.where(at // 500 % 2 == 0, 0.2, -0.2)
    assert roughness(moved) == pytest.approx(roughness(noise), rel=0.03)


def test_a_channel_without_noise_keeps_a_level_above_zero() -> None:
    ramp = np.linspace(0.0, 4.0, 500)
    assert roughness(ramp) == pytest.approx(1e-10 * np.var(ramp))
    assert roughness(np.zeros(500)) == roughness(np.zeros(2)) == 1e-20


def test_no_channel_has_less_noise_than_its_rounding() -> None:
    """Rounding to steps of d leaves d^2/12; what has no steps is stored in single precision at
    best.
    """
    moved = 0.3 * np.sin(0.013 * np.arange(COUNT))
    assert rounding_variance(np.round(moved / 0.01) * 0.01) == pytest.approx(
        0.01**2 / 12.0, rel=1e-6
    )
    assert rounding_variance(np.linspace(0.0, 4.0, 500)) == pytest.approx(
        (2.0**-23 * 4.0) ** 2 / 12.0
    )
    noisy = moved + 1e-3 * np.random.default_rng(3).standard_normal(COUNT)
    assert rounding_variance(noisy) < 1e-4 * 1e-3**2
    assert rounding_variance(np.zeros(100)) == 0.0


@pytest.mark.long
def test_the_check_finds_no_noise_below_that_of_rounding() -> None:
    """A gyro in steps of 0.001 rad/s and an accelerometer in steps of 0.01 g, without any noise of
    their own.
    """
    coarse = rounded(
        flight(outputs=("alpha", "q", "nz", "theta")), q=1e-3, nz=1e-2, alpha=1e-3, theta=1e-3
    )
    levels = compatibility([coarse], CompatibilitySettings(110.0)).joint.noise_std
    for name, step in (("q", 1e-3), ("nz", 1e-2), ("alpha", 1e-3), ("theta", 1e-3)):
        assert levels[name] >= 0.999 * step / np.sqrt(12.0)
