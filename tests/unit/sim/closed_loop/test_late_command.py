"""A computing delay of any length against transfer functions written a second way, and against the
loop of whole frames.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from sim.closed_loop.airframe import load_x29
from sim.closed_loop.equations import sampled_loop
from sim.closed_loop.linear import frequency_response, loop_margins, margins, open_loop
from sim.errors import ModelError
from tests.oracles.x29_frequency import signals

OMEGA = np.array([0.35, 1.0, 3.0, 9.0, 14.0, 27.0, 60.0])


def by_aliases(name: str, late: float, aliases: int = 4000) -> np.ndarray:
    """The open loop as a sum over aliases: a pure delay is a factor exp(-s late) of each of them,
    of any length.
    """
    x29 = load_x29(name)
    T, law = x29.frame, x29.law
    s = 1j * (OMEGA[:, None] + 2.0 * np.pi / T * np.arange(-aliases, aliases + 1))
    held = (1.0 - np.exp(-s * T)) / (s * T) * np.exp(-s * late)
    seen = {
        key: np.sum(held * value, axis=1)
        for key, value in signals(x29, s).items()
        if key in ("gyro", "accelerometer")
    }
    z = np.exp(1j * OMEGA * T)
    tustin = 2.0 / T * (z - 1.0) / (z + 1.0)
    blend = (
        (1.0 + tustin / law.lead)
        / (1.0 + tustin / law.lag)
        * (law.Kn * seen["accelerometer"] + law.Kq * seen["gyro"])
    )
    return np.asarray(blend + law.Ki / tustin * (seen["accelerometer"] + law.Kqi * seen["gyro"]))


@pytest.mark.parametrize(
    ("name", "frames"), [("S", 0.0), ("S", 0.37), ("F", 1.62), ("D", 2.0), ("F", 2.5)]
)
def test_open_loop_is_that_of_the_oracle_at_any_delay(name: str, frames: float) -> None:
    x29 = load_x29(name)
    found = sampled_loop(x29, frames * x29.frame).open_loop(np.exp(1j * OMEGA * x29.frame))
    np.testing.assert_allclose(found, by_aliases(name, frames * x29.frame), rtol=2e-6)


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_whole_frames_are_those_of_the_law(frames: int) -> None:
    x29 = load_x29("F")
    usual, late = (
        replace(x29, law=replace(x29.law, delay_frames=frames)),
        sampled_loop(x29, frames * x29.frame),
    )
    z = np.exp(1j * OMEGA * x29.frame)
    np.testing.assert_allclose(late.open_loop(z), open_loop(usual)(z), rtol=1e-10)
    np.testing.assert_allclose(late.response(OMEGA), frequency_response(usual, OMEGA), rtol=1e-10)


def test_margins_fall_with_the_delay_by_its_phase() -> None:
    x29 = load_x29("F")
    sweep = np.geomspace(0.5, 120.0, 240)
    found = [
        loop_margins(sampled_loop(x29, late).open_loop, sweep)
        for late in (0.4 * x29.frame, x29.frame, 1.6 * x29.frame)
    ]
    assert found[1].phase == pytest.approx(margins(x29).phase, abs=1e-3)
    for one, other in pairwise(found):
        # Far below the folding frequency the delay turns the response and leaves its size.
        assert one.phase - other.phase == pytest.approx(
            np.degrees(one.crossover * 0.6 * x29.frame), abs=0.02
        )


def test_a_command_before_its_frame_is_refused() -> None:
    with pytest.raises(ModelError, match="give 0 or more"):
        sampled_loop(load_x29("S"), -0.001)
