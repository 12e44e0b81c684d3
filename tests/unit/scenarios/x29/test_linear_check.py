"""The flown loop against the linear one: closed form for a stepped stick, and a second writing of
both loops.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from scenarios.x29.content import linear_content
from scenarios.x29.declaration import LinearCheck, linear_check, linear_sentence
from sim.closed_loop.airframe import load_x29
from sim.closed_loop.nonlinear import fly_closed_loop, three_two_one_one
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
