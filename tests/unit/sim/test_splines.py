"""Shapes of smooth curves against SciPy's natural splines, and their evaluation in every form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from sim.maths import Shapes, combine, natural_shapes, shape_names

RANGES = [(-0.1, 0.1), (-0.02, 0.13), (0.01, 0.2), (-0.3, 0.0), (0.4, 3.1)]
FORMS = [(fine, flat) for fine in (False, True) for flat in (False, True)]
every_form = pytest.mark.parametrize(("fine", "flat"), FORMS)
every_range = pytest.mark.parametrize(("low", "high"), RANGES)


def each(shapes: Shapes, x: np.ndarray) -> np.ndarray:
    """Every function by itself: ``(n, len(x))``."""
    return np.array([combine(shapes, x, row.tolist()) for row in np.eye(shapes.count)])


@every_form
@every_range
def test_shapes_are_natural_splines_without_value_and_slope_at_the_anchor(
    low: float, high: float, fine: bool, flat: bool
) -> None:
    shapes = natural_shapes(low, high, fine, 0.0, flat)
    first, last = min(low, 0.0), max(high, 0.0)
    knots = np.linspace(first, last, 11 if fine else 6)
    x = np.linspace(first, last, 301)
    assert shapes.count == len(shape_names(fine, flat)) == len(knots) - (2 if flat else 1)
    for j, ordinates in enumerate(each(shapes, knots)):
        spline = CubicSpline(knots, ordinates, bc_type="natural")
        np.testing.assert_allclose(each(shapes, x)[j], spline(x), atol=1e-12)
        assert spline(0.0) == pytest.approx(0.0, abs=1e-12)
        if flat:
            assert spline(0.0, 1) * (last - first) == pytest.approx(0.0, abs=1e-11)
    assert np.linalg.matrix_rank(each(shapes, knots), tol=1e-8) == shapes.count


@every_form
@every_range
def test_shapes_are_orthonormal_in_the_mean_over_the_range(
    low: float, high: float, fine: bool, flat: bool
) -> None:
    shapes = natural_shapes(low, high, fine, 0.0, flat)
    x = min(low, 0.0) + (max(high, 0.0) - min(low, 0.0)) * (np.arange(20000) + 0.5) / 20000
    values = each(shapes, x)
    np.testing.assert_allclose(values @ values.T / x.size, np.eye(shapes.count), atol=5e-4)


@pytest.mark.parametrize("flat", [False, True])
def test_the_finer_form_begins_with_the_usual_one(flat: bool) -> None:
    x = np.linspace(-0.1, 0.2, 50)
    usual, fine = (
        natural_shapes(-0.05, 0.12, False, 0.0, flat),
        natural_shapes(-0.05, 0.12, True, 0.0, flat),
    )
    np.testing.assert_allclose(each(fine, x)[: usual.count], each(usual, x), atol=1e-11)
    assert fine.count == usual.count + 5


@every_form
def test_beyond_the_range_the_curve_goes_on_straight(fine: bool, flat: bool) -> None:
    shapes = natural_shapes(-0.1, 0.2, fine, 0.0, flat)
    for side, step in ((-0.1, -0.05), (0.2, 0.05)):
        values = each(shapes, side + step * np.arange(5))
        np.testing.assert_allclose(np.diff(values, 2, axis=1), 0.0, atol=1e-12)
        inside = each(shapes, np.array([side - 1e-7 * np.sign(step), side]))
        np.testing.assert_allclose(
            np.sign(step) * (inside[:, 1] - inside[:, 0]) / 1e-7,
            (values[:, 1] - values[:, 0]) / step,
            rtol=1e-5,
            atol=1e-4,
        )


@every_form
def test_numbers_arrays_and_batches_agree_and_carry_complex_steps(fine: bool, flat: bool) -> None:
    generator = np.random.default_rng(3)
    shapes = natural_shapes(-0.1, 0.2, fine, 0.0, flat)
    x = np.linspace(-0.15, 0.25, 41)
    sizes = generator.standard_normal((shapes.count, 3))
    step = 1e-30
    moved = x + 1j * step
    together = combine(shapes, moved[:, None], list(sizes))
    for run in range(3):
        one = [combine(shapes, complex(value), sizes[:, run].tolist()) for value in moved]
        np.testing.assert_allclose(together[:, run].real, np.real(one), rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(together[:, run].imag, np.imag(one), rtol=1e-10, atol=1e-40)
        row = combine(shapes, moved, sizes[:, run].tolist())
        np.testing.assert_allclose(row, together[:, run], rtol=1e-12, atol=1e-12)
    numbers = combine(shapes, 0.03, list(sizes))
    np.testing.assert_allclose(
        numbers, combine(shapes, np.array([[0.03]]), list(sizes))[0], rtol=1e-12
    )
    inner = np.linspace(-0.14, 0.24, 37)
    slope = combine(shapes, inner + 1j * step, sizes[:, 0].tolist()).imag / step
    difference = (
        combine(shapes, inner + 1e-6, sizes[:, 0].tolist())
        - combine(shapes, inner - 1e-6, sizes[:, 0].tolist())
    ) / 2e-6
    np.testing.assert_allclose(slope, difference, rtol=1e-6, atol=1e-5 * np.max(np.abs(slope)))


def test_sizes_of_zero_give_zero_exactly_and_no_range_is_taken_for_one() -> None:
    shapes = natural_shapes(0.0, 0.0)
    assert combine(shapes, 0.4, [0.0] * 4) == 0.0
    assert np.all(combine(shapes, np.linspace(-2, 2, 9), [0.0] * 4) == 0.0)


@pytest.mark.parametrize("x", [float("nan"), float("inf"), -float("inf")])
def test_what_is_not_finite_stays_so_without_an_exception(x: float) -> None:
    assert not np.isfinite(combine(natural_shapes(-0.1, 0.1), x, [1.0] * 4))
    with np.errstate(invalid="ignore"):
        assert np.isfinite(
            combine(natural_shapes(-0.1, 0.1), np.array([x, 0.0]), [1.0] * 4)
        ).tolist() == [False, True]
