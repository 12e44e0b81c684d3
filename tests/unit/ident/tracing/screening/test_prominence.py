"""Peaks and their prominence, against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import find_peaks

from ident.tracing.screening.prominence import prominent_peaks


@given(st.lists(st.integers(-5, 5), min_size=0, max_size=40))
def test_as_scipy_finds_them(heights: list[int]) -> None:
    places, prominences = prominent_peaks(np.array(heights, dtype=float))
    # Scipy puts a level top at its middle: its left edge is ours.
    _, told = find_peaks(np.array(heights, dtype=float), prominence=0.0, plateau_size=1)
    theirs = dict(zip(told["left_edges"].tolist(), told["prominences"].tolist(), strict=True))
    assert dict(zip(places.tolist(), prominences.tolist(), strict=True)) == theirs
    assert list(prominences) == sorted(prominences, reverse=True)


def test_the_sharp_peak_before_the_higher_slope() -> None:
    """A rise of which a bump is part: the bump is low over its surroundings, the peak that stands
    alone is not.
    """
    y = np.array([0.0, 4.0, 0.0, 5.0, 6.0, 5.9, 7.0, 8.0])
    places, prominences = prominent_peaks(y)
    assert places.tolist() == [1, 4]
    assert prominences == pytest.approx([4.0, 0.1])
