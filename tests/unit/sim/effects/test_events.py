"""Edges of events: their shape, and that their area does not feel the grid."""

from __future__ import annotations

import numpy as np
import pytest

from sim.effects.loads import edge_width, risen
from sim.maths import COMPLEX_STEP


def test_an_edge_is_a_straight_ramp_centred_on_its_time() -> None:
    np.testing.assert_allclose(
        risen(np.array([0.9, 0.96, 1.0, 1.02, 1.05, 2.0]), 1.0, 0.1), [0.0, 0.1, 0.5, 0.7, 1.0, 1.0]
    )
    assert risen(0.5, 1.0, 0.1) == 0.0 and risen(1.5, 1.0, 0.1) == 1.0
    assert risen(1.01, complex(1.0, COMPLEX_STEP), 0.1).imag / COMPLEX_STEP == pytest.approx(-10.0)


@pytest.mark.parametrize("multiple", [1, 2, 3])
def test_its_area_in_runge_kutta_steps_is_that_of_a_sharp_edge(multiple: int) -> None:
    # A Runge-Kutta step of a rate that depends on time alone is Simpson's rule.
    h = 0.01
    begin = h * np.arange(100)
    for at in 0.4 + np.linspace(0.0, h, 23):
        width = multiple * h
        area = np.sum(
            h
            / 6.0
            * (
                risen(begin, at, width)
                + 4.0 * risen(begin + 0.5 * h, at, width)
                + risen(begin + h, at, width)
            )
        )
        assert area == pytest.approx(1.0 - at, abs=1e-13)


@pytest.mark.parametrize(
    ("interval", "expected"),
    [(0.02, 0.01), (0.1, 0.01), (1.0 / 30.0, 1.0 / 120.0), (0.005, 0.005), (0.0, 0.01)],
)
def test_the_width_is_the_sub_step_of_a_usual_fit(interval: float, expected: float) -> None:
    assert edge_width(interval) == pytest.approx(expected)
    assert edge_width(0.25, 0.1) == pytest.approx(0.25 / 3.0)
