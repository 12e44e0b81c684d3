"""What record and prior determine, against a regression done by hand and against draws."""

from __future__ import annotations

import numpy as np
import pytest

from ident.statistics.intervals import determination

RNG = np.random.default_rng(7)
PRIOR = np.array([0.5, 2.0, 1e-3, 4.0])
# Two parameters seen together only, one seen well, one not at all.
SLOPES = np.zeros((60, 4))
SLOPES[:, 0] = SLOPES[:, 1] = RNG.standard_normal(60)
SLOPES[:, 2] = 1e4 * RNG.standard_normal(60)


def test_deviations_are_those_of_the_inverse_information() -> None:
    found = determination(("a", "b", "c", "d"), SLOPES, PRIOR)
    covariance = np.linalg.inv(SLOPES.T @ SLOPES + np.diag(PRIOR**-2.0))
    assert found.posterior_std == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-9)


def test_the_share_of_the_prior_is_what_wrong_priors_scatter() -> None:
    found = determination(("a", "b", "c", "d"), SLOPES, PRIOR)
    covariance = np.linalg.inv(SLOPES.T @ SLOPES + np.diag(PRIOR**-2.0))
    rng = np.random.default_rng(8)
    means, noise = PRIOR * rng.standard_normal((4000, 4)), rng.standard_normal((4000, 60))
    # estimates of a truth of zero: one part by the prior's means, one by noise
    from_prior = (means * PRIOR**-2.0) @ covariance
    from_noise = noise @ SLOPES @ covariance
    share = from_prior.var(axis=0) / (from_prior + from_noise).var(axis=0)
    assert found.prior_share == pytest.approx(share, abs=0.05)
    assert found.prior_share[3] == pytest.approx(1.0, abs=1e-12)


def test_directions_are_counted() -> None:
    found = determination(("a", "b", "c", "d"), SLOPES, PRIOR)
    assert (found.unseen, found.determined) == (2, 2)
    assert found.effective == pytest.approx(2.0, abs=0.1)
    assert found.directions @ found.directions.T == pytest.approx(np.eye(4), abs=1e-12)
    (first, part), *_ = found.composition(0)
    assert first == "c" and part == pytest.approx(1.0, abs=0.05)
    assert {name for name, _ in found.composition(1, 2)} == {"a", "b"}


def test_fewer_samples_than_parameters_leave_the_rest_to_the_prior() -> None:
    found = determination(("a", "b", "c", "d"), SLOPES[:1], PRIOR)
    assert found.unseen == 3 and len(found.strengths) == 4
    assert np.all(found.posterior_std <= PRIOR * (1 + 1e-12))
