"""Estimates that the declared value contradicts: by sign, by size, and only where their sigma does
not excuse them.
"""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ident.statistics.residuals import contradiction, shortfall

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
def test_signs_and_units_do_not_matter_and_it_is_an_interval_that_misses(
    size: float, std: float, sign: float, value: float
) -> None:
    """Said the other way round: the interval of two sigmas does not meet the one from zero to three
    times the declared value.
    """
    declared = sign * size
    low, high = sorted((0.0, 3.0 * declared))
    margin = min(abs(value + 2 * std - low), abs(value - 2 * std - high))
    if margin > 1e-9 * (abs(value) + std + size):
        assert bool(contradiction(value, std, declared)) is (
            value + 2 * std < low or value - 2 * std > high
        )
    assert bool(contradiction(value, std, declared)) is bool(contradiction(-value, std, -declared))


@pytest.mark.parametrize(
    ("value", "std", "declared", "word"),
    [
        (-0.167, 0.001, -1.67, "10 times smaller"),
        (-0.35, 0.002, -28.0, "80 times smaller"),
        (-0.5, 0.1, -1.67, ""),
        (-0.6, 0.001, -1.67, ""),
        (0.0, 0.01, -1.67, "not distinguishable from zero"),
        (0.01, 0.02, -1.67, "not distinguishable from zero"),
        (0.0, 0.3, -1.67, ""),
        (0.2, 0.01, -1.67, ""),
        (0.0, 0.1, 0.0, ""),
        (math.nan, 0.1, 1.0, ""),
        (0.0, math.inf, 1.0, ""),
    ],
)
def test_a_value_too_small_by_hand(value: float, std: float, declared: float, word: str) -> None:
    found = shortfall(value, std, declared)
    assert (word in found) if word else (found == "")
    assert not (found and contradiction(value, std, declared))


@given(SIZES, SIZES, st.sampled_from([-1.0, 1.0]), st.floats(-10.0, 10.0))
def test_a_value_too_small_is_an_interval_within_a_third(
    size: float, std: float, sign: float, value: float
) -> None:
    declared = sign * size
    inside = abs(value) + 2 * std < size / 3.0
    turned = sign * value + 2 * std < 0.0
    if min(abs(abs(value) + 2 * std - size / 3.0), abs(sign * value + 2 * std)) > 1e-9 * (
        abs(value) + std + size
    ):
        assert bool(shortfall(value, std, declared)) is (inside and not turned)
    assert bool(shortfall(value, std, declared)) is bool(shortfall(-value, std, -declared))
