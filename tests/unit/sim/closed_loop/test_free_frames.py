"""Stretches of free frames give what single frames give, end where a limit is met, and filter like
a loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from sim.closed_loop import nonlinear
from sim.closed_loop.airframe import X29, load_x29
from sim.closed_loop.equations import Matrices, Stepper, shaping_matrices
from sim.closed_loop.nonlinear import (
    FRAMES_PER_BLOCK,
    ClosedLoopTruth,
    FlightOutcome,
    FreeFrames,
    filtered,
    fly_closed_loop,
    free_frames,
    three_two_one_one,
)


class NeverAhead(FreeFrames):
    """Leaves every frame to be stepped by itself."""

    def ahead(self, start: np.ndarray, reference: np.ndarray) -> np.ndarray:
        return start[None]


def one_by_one(
    monkeypatch: pytest.MonkeyPatch, x29: X29, amplitude: float, duration: float
) -> ClosedLoopTruth:
    def never(x29: X29, steppers: Sequence[Stepper], departure: float) -> FreeFrames:
        return NeverAhead(**vars(free_frames(x29, steppers, departure)))

    with monkeypatch.context() as patched:
        patched.setattr(nonlinear, "free_frames", never)
        return fly_closed_loop(x29, three_two_one_one(amplitude, 0.5, 0.3), duration)[1]


def skewed(x29: X29) -> X29:
    return replace(x29, stick=replace(x29.stick, recorded_skew=2.4 * x29.frame))


def slow(x29: X29) -> X29:
    canard, flaperon, strake = x29.surfaces
    return replace(
        x29,
        surfaces=(
            replace(canard, rate=20.0),
            replace(flaperon, rate=8.0),
            replace(strake, lower=-4.0, upper=5.0),
        ),
    )


CASES = {
    "free": (load_x29("P"), 0.3, 4.0, False),
    "limited now and then": (load_x29("F"), 6.0, 8.0, True),
    "mostly limited": (slow(load_x29("P")), 2.0, 4.0, True),
    "recorded askew": (skewed(load_x29("F")), 1.0, 4.0, False),
    "recorded askew and limited": (skewed(slow(load_x29("P"))), 2.0, 4.0, True),
}


@pytest.mark.parametrize(
    ("x29", "amplitude", "duration", "limited"), CASES.values(), ids=CASES.keys()
)
def test_stretches_fly_as_single_frames_do(
    monkeypatch: pytest.MonkeyPatch, x29: X29, amplitude: float, duration: float, limited: bool
) -> None:
    expected = one_by_one(monkeypatch, x29, amplitude, duration)
    _, found = fly_closed_loop(x29, three_two_one_one(amplitude, 0.5, 0.3), duration)
    assert (expected.rate_limited | expected.command_limited | expected.stopped).any() == limited
    for name in ("command_limited", "rate_limited", "stopped"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
    for name in ("reference", "command", "alpha", "q", "nz", "surfaces", "recorded"):
        wanted = getattr(expected, name)
        np.testing.assert_allclose(
            getattr(found, name), wanted, rtol=0.0, atol=1e-9 * np.abs(wanted).max(), err_msg=name
        )
    assert np.abs(expected.alpha).max() > 1e-3


@pytest.mark.parametrize("limits", [True, False])
def test_a_departure_ends_a_stretch(monkeypatch: pytest.MonkeyPatch, limits: bool) -> None:
    # A pitch damper of the wrong sign: the aircraft runs away, with rams at their limits or with
    # rams that have none.
    x29 = load_x29("P")
    x29 = replace(x29, law=replace(x29.law, Kq=-x29.law.Kq))
    if not limits:
        canard, flaperon, strake = (
            replace(surface, rate=1e6, lower=-1e6, upper=1e6) for surface in x29.surfaces
        )
        x29 = replace(x29, surfaces=(canard, flaperon, strake))
    expected = one_by_one(monkeypatch, x29, 1.0, 20.0)
    _, found = fly_closed_loop(x29, three_two_one_one(1.0, 0.5, 0.3), 20.0)
    assert found.outcome is FlightOutcome.DEPARTED and expected.outcome is FlightOutcome.DEPARTED
    assert found.rate_limited.any() == limits
    assert found.time.size == expected.time.size
    np.testing.assert_allclose(found.alpha, expected.alpha, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    "samples", [1, FRAMES_PER_BLOCK - 1, FRAMES_PER_BLOCK, 3 * FRAMES_PER_BLOCK + 5]
)
def test_a_block_is_filtered_as_by_a_loop(samples: int) -> None:
    x29, rng = load_x29("F"), np.random.default_rng(samples)
    for block in (
        shaping_matrices(x29.stick, x29.frame),
        Matrices(
            0.4 * rng.standard_normal((3, 3)),
            rng.standard_normal((3, 1)),
            rng.standard_normal((1, 3)),
            rng.standard_normal((1, 1)),
        ),
    ):
        driven, state, expected = rng.standard_normal(samples), np.zeros(block.A.shape[0]), []
        for u in driven:
            expected.append(block.C[0] @ state + block.D[0, 0] * u)
            state = block.A @ state + block.B[:, 0] * u
        np.testing.assert_allclose(filtered(block, driven), expected, rtol=1e-10, atol=1e-12)
