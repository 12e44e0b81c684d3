"""Elementary functions that keep complex steps, and the two array routines, against plain loops."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.maths import (
    COMPLEX_STEP,
    absolute,
    clip,
    complex_step_jacobian,
    cos,
    each_column,
    exp,
    interpolate,
    jacobian_in_one_call,
    linear_recurrence,
    log,
    maximum,
    minimum,
    once_for_alike,
    real,
    sqrt,
    where,
)

numbers = st.floats(-5.0, 5.0)
seeds = st.integers(0, 10_000)


@pytest.mark.long
@given(numbers)
def test_exp_and_cos_agree_for_every_kind_of_number(x: float) -> None:
    for function, plain, general in ((exp, math.exp, cmath.exp), (cos, math.cos, cmath.cos)):
        # NumPy has exponentials and cosines of its own for some processors, up to a few ulps from
        # the C library's.
        assert function(x) == pytest.approx(plain(x), rel=1e-14, abs=1e-15)
        assert function(complex(x, 0.2)) == general(complex(x, 0.2))
        np.testing.assert_allclose(function(np.array([x, x])), plain(x), rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize(
    ("function", "slope"),
    [
        (absolute, lambda x: math.copysign(1.0, x)),
        (lambda x: clip(x, -1.0, 2.0), lambda x: float(-1.0 < x < 2.0)),
        (lambda x: maximum(x, 0.5), lambda x: float(x > 0.5)),
        (lambda x: minimum(x, 0.5), lambda x: float(x < 0.5)),
    ],
)
@pytest.mark.parametrize("x", [-3.0, -0.3, 0.4, 0.7, 4.0])
def test_branches_keep_value_and_derivative(
    function: Callable[[Any], Any], slope: Callable[[float], float], x: float
) -> None:
    stepped = complex(x, COMPLEX_STEP)
    assert function(stepped).real == function(x)
    assert complex(function(stepped)).imag / COMPLEX_STEP == pytest.approx(slope(x))
    array = function(np.array([stepped, stepped]))
    np.testing.assert_array_equal(array.real, function(x))
    np.testing.assert_allclose(array.imag / COMPLEX_STEP, slope(x))


def test_where_chooses_without_arrays_for_plain_conditions() -> None:
    assert where(True, 1.0, 2.0) == 1.0 and where(np.bool_(False), 1.0, 2.0) == 2.0
    np.testing.assert_array_equal(where(np.array([True, False]), 1.0, 2.0), [1.0, 2.0])
    assert real(3.0) == 3.0 and real(2.0 + 1.0j) == 2.0


def nonlinear(x: Any) -> list[Any]:
    return [x[0] * exp(-x[1]), cos(x[2]) * x[0] * x[0] + absolute(x[1]), x[2] / (1.0 + x[0] * x[0])]


@given(st.lists(numbers.filter(lambda x: abs(x) > 1e-3), min_size=3, max_size=3))
def test_complex_step_jacobian_is_the_central_difference(x: list[float]) -> None:
    jacobian = complex_step_jacobian(nonlinear, x)
    for j in range(3):
        sides = []
        for sign in (1.0, -1.0):
            point = list(x)
            point[j] += sign * 1e-5
            sides.append(np.array([float(value) for value in nonlinear(point)]))
        expected = (sides[0] - sides[1]) / 2e-5
        np.testing.assert_allclose(
            jacobian[:, j], expected, rtol=1e-6, atol=1e-7 * (1.0 + np.max(np.abs(sides)))
        )


def test_complex_step_jacobian_of_constants_and_of_another_size() -> None:
    np.testing.assert_array_equal(
        complex_step_jacobian(lambda x: [1.0, x[0] + 2.0 * x[2]], [1.0, 2.0, 3.0]),
        [[0.0, 0.0, 0.0], [1.0, 0.0, 2.0]],
    )


@given(st.lists(numbers.filter(lambda x: abs(x) > 1e-3), min_size=3, max_size=3))
def test_jacobian_in_one_call_is_the_one_by_columns(x: list[float]) -> None:
    expected = complex_step_jacobian(nonlinear, x)
    np.testing.assert_allclose(
        jacobian_in_one_call(nonlinear, x),
        expected,
        rtol=1e-13,
        atol=1e-13 * np.max(np.abs(expected)),
    )
    np.testing.assert_array_equal(
        jacobian_in_one_call(lambda x: [1.0, x[0] + 2.0 * x[2]], [1.0, 2.0, 3.0]),
        [[0.0, 0.0, 0.0], [1.0, 0.0, 2.0]],
    )


@given(seeds, st.integers(2, 12))
def test_interpolate_is_numpys_on_real_numbers(seed: int, m: int) -> None:
    generator = np.random.default_rng(seed)
    knots, values = np.cumsum(generator.uniform(0.1, 1.0, m)), generator.standard_normal(m)
    x = np.concatenate([generator.uniform(knots[0] - 1.0, knots[-1] + 1.0, 20), knots])
    np.testing.assert_allclose(
        interpolate(x, knots, values), np.interp(x, knots, values), rtol=1e-13, atol=1e-14
    )


@given(seeds)
def test_interpolate_in_batches_is_one_by_one(seed: int) -> None:
    generator = np.random.default_rng(seed)
    knots, one, many = (
        np.cumsum(generator.uniform(0.1, 1.0, 8)),
        generator.standard_normal(8),
        generator.standard_normal((8, 3)),
    )
    x, xs = generator.uniform(0.0, 6.0, 15), generator.uniform(0.0, 6.0, (15, 3))
    for i in range(3):
        np.testing.assert_array_equal(
            interpolate(xs, knots, one)[:, i], interpolate(xs[:, i], knots, one)
        )
        np.testing.assert_array_equal(
            interpolate(x, knots, many)[:, i], interpolate(x, knots, many[:, i])
        )
        np.testing.assert_array_equal(
            interpolate(xs, knots, many)[:, i], interpolate(xs[:, i], knots, many[:, i])
        )


def test_interpolate_keeps_the_slope_and_drops_it_outside() -> None:
    knots, values = np.array([0.0, 1.0, 3.0]), np.array([1.0, 4.0, 2.0])
    x = np.array([-1.0, 0.5, 2.0, 5.0]) + 1j * COMPLEX_STEP
    np.testing.assert_allclose(
        interpolate(x, knots, values).imag / COMPLEX_STEP, [0.0, 3.0, -1.0, 0.0]
    )
    np.testing.assert_allclose(
        interpolate(np.array([0.5]), knots, values + 1j * values).imag, [2.5]
    )


@given(seeds, st.integers(1, 30))
def test_linear_recurrence_is_the_plain_loop(seed: int, n: int) -> None:
    generator = np.random.default_rng(seed)
    a, b = generator.uniform(-1.0, 1.0, n), generator.standard_normal(n)
    y = [0.7]
    for k in range(n):
        y.append(a[k] * y[k] + b[k])
    np.testing.assert_allclose(linear_recurrence(a, b, 0.7), y, rtol=1e-13, atol=1e-14)
    np.testing.assert_array_equal(linear_recurrence(np.zeros(n), b, 0.7)[1:], b)


@given(seeds)
def test_linear_recurrence_in_batches_and_complex(seed: int) -> None:
    generator = np.random.default_rng(seed)
    a, b, start = (
        generator.uniform(-1.0, 1.0, (20, 3)),
        generator.standard_normal((20, 3)),
        generator.standard_normal(3),
    )
    together, shared = linear_recurrence(a, b, start), linear_recurrence(a[:, 0], b, start)
    for i in range(3):
        np.testing.assert_allclose(
            together[:, i], linear_recurrence(a[:, i], b[:, i], start[i]), rtol=1e-12, atol=1e-13
        )
        np.testing.assert_allclose(
            shared[:, i], linear_recurrence(a[:, 0], b[:, i], start[i]), rtol=1e-12, atol=1e-13
        )
    stepped = linear_recurrence(a[:, 0] + 1j * COMPLEX_STEP, b[:, 0], start[0])
    np.testing.assert_allclose(stepped.real, together[:, 0], rtol=1e-12, atol=1e-13)
    shift = 1e-6
    difference = (
        linear_recurrence(a[:, 0] + shift, b[:, 0], start[0])
        - linear_recurrence(a[:, 0] - shift, b[:, 0], start[0])
    ) / (2.0 * shift)
    np.testing.assert_allclose(
        stepped.imag / COMPLEX_STEP, difference, rtol=1e-6, atol=1e-7 * np.max(np.abs(difference))
    )


def test_linear_recurrence_of_a_wide_batch_is_that_of_a_narrow_one() -> None:
    generator = np.random.default_rng(4)
    a, b, start = (
        generator.uniform(-1.0, 1.0, (30, 100)),
        generator.standard_normal((30, 100)),
        generator.standard_normal(100),
    )
    wide = linear_recurrence(a, b, start)
    np.testing.assert_allclose(
        wide[:, 40:60],
        linear_recurrence(a[:, 40:60], b[:, 40:60], start[40:60]),
        rtol=1e-13,
        atol=1e-14,
    )


def test_each_column_gets_its_own_row_and_scalars() -> None:
    rows, factors = np.arange(6.0).reshape(3, 2), np.array([[2.0], [1j], [0.5]])

    def scaled(row: np.ndarray, factor: complex, shift: float) -> np.ndarray:
        assert row.ndim == 1 and isinstance(factor, (float, complex)) and isinstance(shift, float)
        return np.cumsum(row) * factor + shift

    out = each_column(scaled, rows, factors, 3.0)
    assert out.shape == (3, 3, 2)
    np.testing.assert_array_equal(out, np.cumsum(rows, axis=0)[:, None, :] * factors + 3.0)
    np.testing.assert_array_equal(
        each_column(scaled, rows[:, 0], 2.0, np.float64(1.0)), np.cumsum(rows[:, 0]) * 2.0 + 1.0
    )


def test_what_is_alike_is_worked_out_once() -> None:
    seen: list[tuple[int, ...]] = []

    def wave(frequency: Any, phase: Any) -> Any:
        seen.append(np.shape(frequency))
        return np.cos(frequency * np.linspace(0.0, 1.0, 7) + phase)

    frequency, phase = (
        np.array([[2.0], [3.0], [2.0], [2.0]]),
        np.array([[0.0], [0.0], [0.5], [0.0]]),
    )
    np.testing.assert_array_equal(once_for_alike(wave, frequency, phase), wave(frequency, phase))
    np.testing.assert_array_equal(once_for_alike(wave, frequency, 0.5), wave(frequency, 0.5))
    assert seen == [(3, 1), (4, 1), (2, 1), (4, 1)]
    assert once_for_alike(lambda x: x + 1.0, 2.0) == 3.0


@given(st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=6), st.booleans())
def test_rows_of_alike_runs_keep_complex_steps(values: list[float], complex_: bool) -> None:
    column = np.array(values)[:, None] + (1j * COMPLEX_STEP if complex_ else 0.0)
    time = np.linspace(0.0, 2.0, 5)
    np.testing.assert_array_equal(
        once_for_alike(lambda x: x * x * time, column), column * column * time
    )


@pytest.mark.parametrize("function", [exp, log, sqrt, cos])
@pytest.mark.parametrize(
    "x", [-math.inf, -1.0, -0.0, 0.0, 1e-300, 1.0, 709.0, 800.0, math.inf, math.nan]
)
def test_a_float_gives_what_an_array_gives_and_never_raises(
    function: Callable[[Any], Any], x: float
) -> None:
    with np.errstate(all="ignore"):
        expected = function(np.array([x]))[0]
    assert function(x) == pytest.approx(float(expected), rel=1e-14, nan_ok=True)


def test_an_exponential_beyond_the_range_is_infinite_of_a_complex_step_too() -> None:
    assert exp(complex(800.0, 1e-20)) == complex(math.inf, math.inf) and exp(
        complex(800.0, 0.0)
    ) == complex(math.inf, 0.0)
    assert log(0j) == complex(-math.inf, 0.0)
    assert exp(complex(2.0, 1e-20)).imag == pytest.approx(1e-20 * math.exp(2.0))
