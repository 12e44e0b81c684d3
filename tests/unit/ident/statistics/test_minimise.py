"""The Levenberg-Marquardt loop against SciPy's, which is written another way; its ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from ident.statistics.minimise import Descent, LocalModel, Minimum, local_model, minimise

T = np.linspace(0.0, 3.0, 40)
FREE = np.full(2, np.inf)


def decay(x: np.ndarray) -> np.ndarray:
    """A decaying exponential of size and rate ``x (2,)``."""
    return np.asarray(x[0] * np.exp(-x[1] * T))


@dataclass
class LeastSquares:
    """Half the squares of ``residual(x)`` within bounds, slopes by differences."""

    residual: Callable[[np.ndarray], np.ndarray]
    low: np.ndarray
    high: np.ndarray
    enough: float = 1e-20
    tried: int = 0

    def model(self, x: np.ndarray) -> LocalModel:
        steps = 1e-6 * np.eye(len(x))
        slopes = [(self.residual(x + h) - self.residual(x - h)) / 2e-6 for h in steps]
        J = np.array(slopes).T
        return local_model(J.T @ J, -J.T @ self.residual(x), x, self.low, self.high)

    def trial(self, x: np.ndarray, model: LocalModel, damping: float) -> np.ndarray | None:
        self.tried += 1
        there = np.clip(x + model.scale * model.step(damping), self.low, self.high)
        squares = (float(self.residual(each) @ self.residual(each)) for each in (there, x))
        return there if next(squares) <= next(squares) else None

    def settled(self, x: np.ndarray, model: LocalModel) -> bool:
        return model.predicted_gain < self.enough

    def found(self, start: np.ndarray, steps: int = 200) -> Minimum[np.ndarray]:
        return minimise(Descent(self.model, self.trial, self.settled), start, steps)


@settings(max_examples=25)
@given(
    st.floats(0.5, 3.0),
    st.floats(0.2, 2.0),
    st.floats(0.5, 3.0),
    st.floats(0.2, 2.0),
    st.integers(0, 2**31),
)
def test_it_ends_where_another_minimiser_ends(
    size: float, rate: float, size_0: float, rate_0: float, seed: int
) -> None:
    z = decay(np.array([size, rate])) + 0.01 * np.random.default_rng(seed).standard_normal(len(T))
    start = np.array([size_0, rate_0])
    ours = LeastSquares(lambda x: decay(x) - z, -FREE, FREE).found(start)
    theirs = least_squares(lambda x: decay(x) - z, start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert ours.point == pytest.approx(theirs.x, rel=1e-5, abs=1e-6)


def test_it_follows_a_bent_valley_to_its_end() -> None:
    def rosenbrock(x: np.ndarray) -> np.ndarray:
        return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])

    found = LeastSquares(rosenbrock, -FREE, FREE).found(np.array([-1.2, 1.0]))
    assert found.point == pytest.approx([1.0, 1.0], abs=1e-6) and not found.stuck


def test_bounds_hold_and_what_is_pressed_does_not_move() -> None:
    z = decay(np.array([2.0, 1.0]))
    low, high = np.array([0.0, 0.0]), np.array([1.5, 5.0])
    found = LeastSquares(lambda x: decay(x) - z, low, high).found(np.array([1.0, 0.5]))
    theirs = least_squares(lambda x: decay(x) - z, [1.0, 0.5], bounds=(low, high), xtol=1e-14)
    assert found.point[0] == 1.5 and not found.model.movable[0]
    assert found.point[1] == pytest.approx(theirs.x[1], rel=1e-4)


def test_units_of_the_unknowns_do_not_enter() -> None:
    z, unit = decay(np.array([2.0, 1.0])), np.array([1e-4, 1e3])

    class Scaled(LeastSquares):
        def model(self, x: np.ndarray) -> LocalModel:
            plain = LeastSquares(lambda y: decay(y) - z, -FREE, FREE)
            slopes = [
                (plain.residual(x * unit + h) - plain.residual(x * unit - h)) / 2e-6
                for h in 1e-6 * np.eye(2)
            ]
            J = np.array(slopes).T * unit
            return local_model(J.T @ J, -J.T @ self.residual(x), x, self.low, self.high)

    start = np.array([1.0, 0.4])
    plain = LeastSquares(lambda x: decay(x) - z, -FREE, FREE).found(start)
    scaled = Scaled(lambda x: decay(x * unit) - z, -FREE, FREE).found(start / unit)
    assert scaled.point * unit == pytest.approx(plain.point, rel=1e-6)
    assert scaled.steps == plain.steps


def test_no_descent_ends_it_and_says_so() -> None:
    search = LeastSquares(lambda x: x, -FREE, FREE)
    descent = Descent(search.model, lambda x, model, damping: None, lambda x, model: False)
    found = minimise(descent, np.ones(2), 100)
    # from 1e-4 to 1e8 by tens
    assert found.stuck and found.steps == 13 and np.array_equal(found.point, np.ones(2))
    assert not minimise(descent, np.ones(2), 12).stuck


def test_a_shortcut_takes_the_place_of_a_damped_step() -> None:
    search = LeastSquares(lambda x: x - 3.0, -FREE, FREE)
    there = iter([np.full(2, 3.0)])
    found = minimise(
        Descent(search.model, search.trial, search.settled, lambda x, model: next(there, None)),
        np.zeros(2),
        10,
    )
    assert np.array_equal(found.point, np.full(2, 3.0))
    assert (found.steps, search.tried) == (1, 0)
