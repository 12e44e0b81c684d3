"""What differences between records make of sigmas."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ident.tracing.replication.between_records import inflation


def test_two_grown_sigmas_hold_the_mean_whatever_the_number_of_records() -> None:
    """Values that scatter twice as much as their sigmas say, with six derivatives and two to six records."""
    rng = np.random.default_rng(1)
    for count in (2, 3, 5):
        held, flights = 0, 600
        for _ in range(flights):
            sigma = rng.uniform(0.5, 2.0, (6, count))
            values = 2.0 * sigma * rng.standard_normal((6, count))
            weight = sigma**-2
            mean, std = np.sum(weight * values, axis=1) / weight.sum(axis=1), weight.sum(axis=1) ** -0.5
            held += int(np.count_nonzero(np.abs(mean) < 2.0 * inflation(values, sigma) * std))
        assert 0.93 < held / (6 * flights) < 0.985, (count, held / (6 * flights))


def test_one_derivative_borrows_from_none() -> None:
    """Ten times its sigma: two records hold as much as Student's t does for one degree of freedom, no less."""
    rng = np.random.default_rng(2)
    for count in (2, 3, 5):
        sigma = rng.uniform(0.5, 2.0, (4000, 1, count))
        values = 10.0 * sigma * rng.standard_normal(sigma.shape)
        weight = sigma**-2
        mean, std = np.sum(weight * values, axis=2) / weight.sum(axis=2), weight.sum(axis=2) ** -0.5
        held = np.mean([abs(m[0]) < 2.0 * inflation(v, s)[0] * d[0] for m, v, s, d in zip(mean, values, sigma, std, strict=True)])
        assert 0.94 < held < 0.97, (count, held)


def test_one_derivative_that_differs_does_not_take_the_others_with_it() -> None:
    sigma = np.ones((6, 5))
    values = np.tile([1.0, -1.0, 1.0, -1.0, 0.0], (6, 1))
    wild = values.copy()
    wild[0] *= 20.0
    calm, one = inflation(values, sigma), inflation(wild, sigma)
    assert one[0] > 8.0 and np.allclose(one[1:], calm[1:])


@given(st.integers(2, 6), st.integers(1, 8), st.integers(0, 2**32 - 1), st.floats(1e-6, 1e6))
def test_growth_knows_no_unit_and_never_shrinks(count: int, rows: int, seed: int, unit: float) -> None:
    rng = np.random.default_rng(seed)
    values, sigma = rng.standard_normal((rows, count)), rng.uniform(0.1, 1.0, (rows, count))
    factors = inflation(values, sigma)
    assert np.all(factors >= 1.0) and np.all(np.isfinite(factors))
    assert np.allclose(inflation(unit * values + 3.0 * unit, unit * sigma), factors)
