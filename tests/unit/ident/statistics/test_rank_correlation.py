"""Spearman's rank correlation against SciPy's, ties and all."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import rankdata, spearmanr

from ident.statistics.rank_correlation import p_value_of_growth, ranks


@pytest.mark.parametrize("seed", range(5))
def test_ranks_and_p_values_are_those_of_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = rng.integers(0, 12, 40).astype(float)
    b = 0.2 * seed * a + rng.standard_normal(40)
    assert np.array_equal(ranks(a), rankdata(a))
    assert p_value_of_growth(a, b) == pytest.approx(spearmanr(a, b, alternative="greater").pvalue, rel=1e-9)


def test_what_grows_together_is_sure_and_a_constant_tells_nothing() -> None:
    a = np.arange(30.0)
    assert p_value_of_growth(a, a**3) < 1e-100
    assert p_value_of_growth(a, -a) == pytest.approx(1.0)
    assert np.isnan(p_value_of_growth(a, np.ones(30)))
