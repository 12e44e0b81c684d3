"""A channel's roughness is the variance of its white noise, with motion and switches or without."""

from __future__ import annotations

import numpy as np
import pytest

from ident.compatibility.noise import roughness

COUNT = 20_000


@pytest.mark.parametrize("std", [1e-3, 0.5])
def test_the_roughness_of_white_noise_is_its_variance(std: float) -> None:
    """Within four deviations of a median of 20,000 correlated differences: 5 % of the variance."""
    assert roughness(std * np.random.default_rng(1).standard_normal(COUNT)) == pytest.approx(std**2, rel=0.06)


def test_smooth_motion_and_a_few_switches_add_nothing() -> None:
    noise, at = 1e-3 * np.random.default_rng(2).standard_normal(COUNT), np.arange(COUNT)
    moved = noise + 1e-4 * at - 1e-7 * at**2 + np.where(at // 500 % 2 == 0, 0.2, -0.2)
    assert roughness(moved) == pytest.approx(roughness(noise), rel=0.03)


def test_a_channel_without_noise_keeps_a_level_above_zero() -> None:
    ramp = np.linspace(0.0, 4.0, 500)
    assert roughness(ramp) == pytest.approx(1e-10 * np.var(ramp))
    assert roughness(np.zeros(500)) == roughness(np.zeros(2)) == 1e-20
