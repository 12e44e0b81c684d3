"""Measures of how a closed-loop study misses its record, on signals whose measures are known."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from scenarios.x29.estimating import Misfit, misfit
from sim.record import Channel, Record

NAMES, STEP, COUNT = ("alpha", "q", "nz"), 0.02, 4000
TIME = STEP * np.arange(COUNT)
NOISE = np.array([0.001, 0.002, 0.01])


def measured(
    z: np.ndarray,
    simulated: np.ndarray,
    innovation: np.ndarray,
    stretch: tuple[float, float] | None = None,
    peak: tuple[float, float] | None = None,
) -> Misfit:
    """Misfit of simulated outputs ``(3, N)`` where q has these innovations, expected of size 2."""
    record = Record(
        TIME, (), tuple(Channel.of(name, "1", row) for name, row in zip(NAMES, z, strict=True))
    )
    rows = np.stack([np.zeros(COUNT), innovation, np.zeros(COUNT)])
    history = SimpleNamespace(
        innovation=rows,
        innovation_std=np.full(rows.shape, 2.0),
        valid=np.ones(rows.shape, dtype=bool),
        nis=(innovation / 2.0) ** 2,
        degrees=np.ones(COUNT, dtype=int),
    )
    estimate: Any = SimpleNamespace(output_names=NAMES, history=history)
    return misfit(record, simulated, estimate, NOISE, stretch, peak)


def white(seed: int = 1) -> np.ndarray:
    return 2.0 * np.random.default_rng(seed).standard_normal(COUNT)


def test_of_white_innovations_a_fifth_of_the_power_lies_below_a_fifth_of_the_band() -> None:
    z = np.zeros((3, COUNT))
    found = measured(z, z, white())
    # 2000 frequencies, each with an exponential share: the sum of 400 of them scatters by 0.9 %.
    assert found.low_share == pytest.approx(0.2, abs=0.036)
    assert abs(found.lag_one) < 4.0 / math.sqrt(COUNT) and found.ratio == pytest.approx(
        1.0, abs=0.05
    )
    nyquist = 0.5 / STEP
    for share, low in ((0.05, 1.0), (0.18, 1.0), (0.22, 0.0), (0.9, 0.0)):
        line = np.sin(2.0 * math.pi * round(share * nyquist * TIME[-1]) / (COUNT * STEP) * TIME)
        assert measured(z, z, line).low_share == pytest.approx(low, abs=1e-3), share


def test_innovations_that_remember_show_it_in_the_first_lag_and_their_size() -> None:
    drawn, row = white(2), np.zeros(COUNT)
    for k in range(1, COUNT):
        row[k] = 0.6 * row[k - 1] + 0.8 * drawn[k]
    z = np.zeros((3, COUNT))
    assert measured(z, z, row).lag_one == pytest.approx(0.6, abs=4.0 * 0.8 / math.sqrt(COUNT))
    assert measured(z, z, 3.0 * white()).ratio == pytest.approx(3.0, abs=0.15)


def test_errors_are_in_sigmas_of_each_output_inside_and_outside_of_a_stretch() -> None:
    z = np.zeros((3, COUNT))
    inside = (TIME >= 10.0) & (TIME <= 20.0)
    simulated = np.stack([np.full(COUNT, 0.003), np.where(inside, -0.008, 0.004), np.zeros(COUNT)])
    found = measured(z, simulated, white(), stretch=(10.0, 20.0))
    assert (found.rms["alpha"], found.rms["nz"]) == pytest.approx((3.0, 0.0))
    assert (found.stretch, found.elsewhere) == pytest.approx((4.0, 2.0))
    none = measured(z, simulated, white())
    assert (none.stretch, none.elsewhere, none.peak_percent) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(("share", "percent"), [(0.8, -20.0), (1.25, 25.0)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_peak_is_the_largest_rate_of_the_interval_on_either_side(
    share: float, percent: float, sign: float
) -> None:
    bump = sign * np.exp(-(((TIME - 30.0) / 2.0) ** 2))
    far = np.where(TIME > 50.0, 5.0, 0.0)
    z = np.stack([np.zeros(COUNT), bump + far, np.zeros(COUNT)])
    found = measured(z, share * z, white(), peak=(20.0, 40.0))
    assert found.peak_measured == pytest.approx(
        sign, rel=1e-3
    ) and found.peak_percent == pytest.approx(percent)
