"""Wild points of a measured record are found beside a model that lacks something; what a model
misses at the edges of an input is none.
"""

from __future__ import annotations

import numpy as np
import pytest

from ident.statistics.noise_levels import isolated_wrong_samples

N = 400
SWITCHES = (50, 110, 170, 200, 230)
EDGES = np.zeros(N, dtype=bool)
for at in SWITCHES:
    EDGES[at - 1 : at + 2] = True


def wrong(residual: np.ndarray) -> list[int]:
    (mask,) = isolated_wrong_samples([residual], [np.ones(N, dtype=bool)], [EDGES])
    return np.flatnonzero(mask).tolist()


@pytest.mark.parametrize("seed", range(20))
def test_noise_has_none_and_wild_points_are_found_wherever_they_are(seed: int) -> None:
    noise = np.random.default_rng(seed).standard_normal(N)
    assert wrong(noise) == []
    for places in ([7], [90, 140, 391], [110], [33, 200]):
        wild = noise.copy()
        wild[places] += 25.0
        assert wrong(wild) == places


@pytest.mark.parametrize("seed", range(5))
def test_a_misfit_that_varies_slowly_hides_none(seed: int) -> None:
    slow = 10.0 * np.sin(np.arange(N) / 15.0)
    wild = np.random.default_rng(seed).standard_normal(N) + slow
    wild[[90, 300]] += 60.0
    assert wrong(wild) == [90, 300]


@pytest.mark.parametrize("seed", range(5))
def test_what_a_model_misses_at_every_edge_is_no_wild_point(seed: int) -> None:
    """As a late control does that is sampled slowly: one sample at each edge."""
    missed = np.random.default_rng(seed).standard_normal(N)
    missed[[*SWITCHES]] += np.array([1.0, -1.0, 1.0, -1.0, 1.0]) * 20.0
    assert wrong(missed) == []


def test_heavy_tails_are_no_wild_points() -> None:
    assert wrong(np.random.default_rng(3).standard_t(2.0, N)) == []
