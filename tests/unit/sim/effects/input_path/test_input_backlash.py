"""The backlash against its rule applied cell by cell."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sim.effects.input_path.input_play import InputBacklash
from sim.maths import COMPLEX_STEP

inputs = arrays(
    float, st.integers(1, 40), elements=st.sampled_from([-0.3, -0.1, 0.0, 0.0, 0.05, 0.1, 0.2, 0.4])
)
widths = st.floats(0.0, 0.5)


def plain(u: np.ndarray, width: float) -> np.ndarray:
    y, out = u[0], []
    for value in u:
        if abs(value - y) > width:
            y = value - width if value > y else value + width
        out.append(y)
    return np.array(out)


def played(u: np.ndarray, width: object) -> np.ndarray:
    return np.asarray(
        InputBacklash().act(np.arange(len(u) + 1) * 0.001, u, SimpleNamespace(half_width=width))
    )


@given(inputs, widths)
def test_is_the_rule_cell_by_cell(u: np.ndarray, width: float) -> None:
    np.testing.assert_allclose(played(u, width), plain(u, width), rtol=0.0, atol=1e-15)


@given(inputs)
def test_no_play_is_the_identity_bit_for_bit(u: np.ndarray) -> None:
    for none in (0.0, 0j, np.zeros(2)):
        np.testing.assert_array_equal(played(u, none).reshape(len(u), -1)[:, 0], u)


def test_a_sine_comes_out_late_and_clipped() -> None:
    t = np.linspace(0.0, 3.0, 3001)
    y = played(np.sin(2.0 * np.pi * t), 0.2)
    assert y.max() == pytest.approx(0.8, abs=1e-5) and y.min() == pytest.approx(-0.8, abs=1e-5)
    assert y[t > 0.25][0] == pytest.approx(0.8, abs=1e-4)
    # After the crest at 0.25 s it rests until the sine has come down by twice the width, to 0.6.
    leaves = t[(t > 0.25) & (y < 0.8 - 1e-4)][0]
    before, after = np.sin(2.0 * np.pi * (leaves - 0.001)), np.sin(2.0 * np.pi * leaves)
    assert after < 0.6 - 1e-4 <= before and leaves < 0.5


@pytest.mark.parametrize("width", [0.0, 0.03, 0.1, 5.0])
def test_derivative_is_that_towards_wider_play(width: float) -> None:
    u = np.repeat(np.random.default_rng(5).standard_normal(40), 3)
    exact = played(u, complex(width, COMPLEX_STEP)).imag / COMPLEX_STEP
    np.testing.assert_allclose(exact, (plain(u, width + 1e-7) - plain(u, width)) / 1e-7, atol=1e-6)


def test_a_derivative_of_the_input_passes_through() -> None:
    t = np.linspace(0.0, 2.0, 201)
    for direction in (np.cos(t), np.ones_like(t)):
        exact = played(np.sin(5.0 * t) + 1j * COMPLEX_STEP * direction, 0.3).imag / COMPLEX_STEP
        shift = 1e-6
        expected = (
            plain(np.sin(5.0 * t) + shift * direction, 0.3)
            - plain(np.sin(5.0 * t) - shift * direction, 0.3)
        ) / (2.0 * shift)
        np.testing.assert_allclose(exact, expected, atol=1e-6)


def test_batches_are_one_by_one() -> None:
    many, widths_tried = (
        np.random.default_rng(6).standard_normal((50, 3)),
        np.array([0.0, 0.5, 2.0]),
    )
    full = played(many, widths_tried[:, None])
    assert full.shape == (50, 3, 3)
    for i, width in enumerate(widths_tried):
        np.testing.assert_array_equal(full[:, i, 2], played(many[:, 2], width))
        np.testing.assert_array_equal(
            played(many[:, 0], widths_tried)[:, i], played(many[:, 0], width)
        )
