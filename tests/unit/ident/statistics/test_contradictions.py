"""Estimates that the declared value contradicts: by sign, by size, and only where their sigma does not excuse them."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ident.statistics.contradictions import contradiction

SIZES = st.floats(1e-3, 1e3)


@pytest.mark.parametrize(
    ("value", "std", "declared", "word"),
    [
        (2.1, 5e-9, -1.67, "other sign"),
        (2.1, 1.2, -1.67, ""),
        (-1.2, 0.1, -1.67, ""),
        (-6.0, 0.1, -1.67, "times as large"),
        (-6.0, 0.8, -1.67, ""),
        (0.0, 0.0, -1.67, ""),
        (5.0, 0.1, 0.0, ""),
        (math.nan, 0.1, 1.0, ""),
        (-5.0, math.inf, 1.0, ""),
    ],
)
def test_by_hand(value: float, std: float, declared: float, word: str) -> None:
    found = contradiction(value, std, declared)
    assert (word in found) if word else (found == "")


@given(SIZES, SIZES, st.sampled_from([-1.0, 1.0]), st.floats(-10.0, 10.0))
def test_signs_and_units_do_not_matter_and_it_is_an_interval_that_misses(size: float, std: float, sign: float, value: float) -> None:
    """Said the other way round: the interval of two sigmas does not meet the one from zero to three times the declared value."""
    declared = sign * size
    low, high = sorted((0.0, 3.0 * declared))
    margin = min(abs(value + 2 * std - low), abs(value - 2 * std - high))
    if margin > 1e-9 * (abs(value) + std + size):
        assert bool(contradiction(value, std, declared)) is (value + 2 * std < low or value - 2 * std > high)
    assert bool(contradiction(value, std, declared)) is bool(contradiction(-value, std, -declared))
