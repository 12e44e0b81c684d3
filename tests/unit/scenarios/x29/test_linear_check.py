"""The flown loop against the linear one: closed form for a stepped stick, and a second writing of
both loops.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from scenarios.x29.content import linear_content
from scenarios.x29.declaration import LinearCheck, linear_check, linear_sentence
from scenarios.x29.estimating import Misfit, misfit
from sim.closed_loop.airframe import load_x29
from sim.closed_loop.nonlinear import fly_closed_loop, three_two_one_one
from sim.record import Channel, Record
from tests.oracles.x29_march import march

DURATION = 2.5


@cache
def check(name: str = "F", size: float = 1.0) -> LinearCheck:
    x29 = load_x29(name)
    return linear_check(x29, fly_closed_loop(x29, three_two_one_one(size, 0.25, 0.2), DURATION)[1])


def gained(size: float, dead_band: float, curvature: float) -> float:
    """What break-out and gearing leave of a stick that is either ``size`` or nothing, by hand."""
    beyond = size - dead_band
    return beyond * (1.0 + curvature * beyond) / size


@pytest.mark.parametrize("size", [1.0, 0.4])
def test_a_stepped_stick_is_a_linear_loop_of_another_gain(size: float) -> None:
    found, stick = check(size=size), load_x29("F").stick
    expected = 1.0 - gained(size, stick.dead_band, stick.curvature)
    for name, value in found.misfit.items():
        assert value == pytest.approx(abs(expected), rel=1e-9), name
    assert found.apart["the break-out"] == pytest.approx(stick.dead_band / size, rel=1e-9)
    assert found.apart["the gearing"] == pytest.approx(stick.curvature * size, rel=1e-9)
    assert (
        found.apart["the limits"] < 1e-12
        and found.apart["none of these"] < 1e-12
        and found.same
        and found.limited == 0.0
    )
    for at, whole, free in zip(
        found.sticks, found.curves["as flown"], found.curves["no break-out"], strict=True
    ):
        if at <= 1.0:
            assert whole == pytest.approx(
                abs(1.0 - gained(at, stick.dead_band, stick.curvature)), rel=1e-6
            )
            assert free == pytest.approx(stick.curvature * at, rel=1e-6)


def test_linear_response_is_that_of_the_oracle_without_break_out_and_gearing() -> None:
    found, x29 = check(), load_x29("F")
    straight = replace(x29, stick=replace(x29.stick, dead_band=0.0, curvature=0.0))
    expected = march(straight, three_two_one_one(1.0, 0.25, 0.2)(found.time), steps_per_frame=25)
    for row, name in enumerate(("alpha", "q", "nz")):
        np.testing.assert_allclose(
            found.linear[row], expected[name], atol=1e-5 * np.abs(expected[name]).max()
        )


def test_limits_show_where_they_are_met() -> None:
    slow = load_x29("P")
    canard, flaperon, strake = (
        replace(surface, rate=0.2 * surface.rate) for surface in slow.surfaces
    )
    slow = replace(slow, surfaces=(canard, flaperon, strake))
    found = linear_check(
        slow, fly_closed_loop(slow, three_two_one_one(1.0, 0.25, 0.2), DURATION)[1]
    )
    assert found.limited > 0.05 and found.apart["the limits"] > 0.01
    assert found.apart["none of these"] < 1e-12, (
        "without its limits the loop is the linear one again"
    )
    small = found.curves["limits alone"]
    assert small[0] < 1e-12 < 1e-3 < small[-1] or np.isnan(small[-1])


def test_a_loop_that_is_not_the_linear_one_is_told() -> None:
    found = check()
    assert "two writings of one loop" in linear_sentence(
        found
    ) and "alpha 0.49 %" in linear_sentence(found)
    wrong = replace(found, apart={**found.apart, "none of these": 1e-3})
    assert "NOT the same loop" in linear_sentence(wrong)
    departed = replace(
        found, curves={**found.curves, "as flown": (*found.curves["as flown"][:-1], float("nan"))}
    )
    assert len(linear_content(departed)["by_stick"]["as flown"]) == len(found.sticks) - 1  # type: ignore[index]


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
