"""The delays of a watched bank, weighed by a refined delay and its sigma."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ident.banks.delays import DELAYS
from scenarios.watching.study import nearest

GRID = np.array(DELAYS)


@given(st.floats(0.0, 0.2), st.floats(1e-4, 0.05))
def test_weights_are_the_probabilities_that_a_delay_is_the_nearest(
    value: float, std: float
) -> None:
    weights = nearest(GRID, value, std)
    assert weights.sum() == pytest.approx(1.0) and np.all(weights >= 0.0)
    # Seen in a mirror the weights are in the other order.
    np.testing.assert_allclose(
        nearest(0.2 - GRID[::-1], 0.2 - value, std)[::-1], weights, atol=1e-9
    )


def test_weights_are_those_that_are_counted() -> None:
    value, std, drawn = 0.107, 0.012, np.random.default_rng(1)
    at = np.argmin(np.abs(value + std * drawn.standard_normal(100_000)[:, None] - GRID), axis=1)
    np.testing.assert_allclose(
        nearest(GRID, value, std), np.bincount(at, minlength=len(GRID)) / 100_000, atol=0.006
    )
    assert nearest(GRID, 0.05, 0.0).tolist() == [0.0, 0.0, 1.0, *[0.0] * 6]
