"""What records offer a search: the period at which a channel would be held between updates."""

from __future__ import annotations

import numpy as np
import pytest

from ident.statistics.noise_levels import update_period


def held(
    period: float, phase: float, noise: float, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, an output that moves as in a maneuver, and what is measured of it beyond that when it
    is held.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 25.0, 0.01)

    def output(t: np.ndarray) -> np.ndarray:
        return np.sin(1.3 * t) + 0.6 * np.sin(3.1 * t + 0.4)

    shown = phase + period * np.floor((time - phase) / period)
    return time, output(time), output(shown) - output(time) + noise * rng.standard_normal(time.size)


@pytest.mark.parametrize("period", [0.04, 0.13074, 0.2137])
@pytest.mark.parametrize("noise", [0.02, 0.1])
def test_the_period_of_the_updates_is_found_closely_enough_to_follow_each_update(
    period: float, noise: float
) -> None:
    flights = [held(period, 0.013, noise, 1), held(period, 0.031, noise, 2)]
    found = update_period(*[list(each) for each in zip(*flights, strict=True)])
    updates = 25.0 / period
    assert abs(found - period) * updates < period / 4.0


def test_a_short_record_and_one_without_motion_have_an_answer() -> None:
    time = np.arange(0.0, 2.0, 0.1)
    assert update_period([time], [np.zeros(time.size)], [np.zeros(time.size)]) == np.inf
    assert update_period([time], [np.sin(time)], [np.cos(5.0 * time)]) > 0.0
