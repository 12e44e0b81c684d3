"""The bound against central differences of the true flight, and its account of priors against
estimates of a linear problem.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scenarios.studies.campaign import EstimatorRuns
from scenarios.studies.campaign_statistics import Bound, _passes, bound_of
from scenarios.studies.catalogue import load_scenario
from scenarios.studies.estimating import fly_scenario

SHORT = ("flight.duration=4 s", "flight.rate=50")


def slopes_of_the_truth(names: tuple[str, ...]) -> np.ndarray:
    """Slopes ``(M, n)`` of the true outputs by the true derivatives, in units of the noise: the
    vehicle flown with each of them changed.
    """
    scenario = load_scenario("rigid", (*SHORT, "flight.step=0.01"))
    _, truth = fly_scenario(scenario, 1)
    columns = []
    for name in names:
        flown = []
        size = 1e-3 * abs(truth.parameters[name].value)
        for step in (size, -size):
            changed = replace(
                scenario.flight, derivatives={name: truth.parameters[name].value + step}
            )
            outputs = fly_scenario(replace(scenario, flight=changed), 1)[1].outputs
            flown.append(
                np.concatenate([outputs[key] / truth.noise_std[key] for key in ("alpha", "q")])
            )
        columns.append((flown[0] - flown[1]) / (2.0 * size))
    return np.array(columns).T


def test_the_bound_of_a_calm_flight_is_that_of_the_true_outputs_slopes() -> None:
    scenario = load_scenario("rigid", SHORT)
    # States that are known at the start: what central differences of the true flight tell, too.
    known = replace(
        scenario.estimations[0],
        initial={
            name: replace(each, std=1e-9) for name, each in scenario.estimations[0].initial.items()
        },
    )
    bound = bound_of(EstimatorRuns(scenario, known))
    assert bound is not None
    slopes = slopes_of_the_truth(bound.names)
    np.testing.assert_allclose(
        bound.data, np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes))), rtol=2e-3
    )


def test_with_process_noise_the_bound_is_wider_and_without_nearly_any_it_is_the_calm_one() -> None:
    def bound(density: float) -> np.ndarray:
        scenario = load_scenario("rigid", SHORT)
        forced = replace(
            scenario,
            flight=replace(
                scenario.flight, process_noise={"alpha": density, "q": density} if density else {}
            ),
        )
        found = bound_of(EstimatorRuns(forced, forced.estimations[0]))
        assert found is not None
        return found.data

    calm = bound(0.0)
    # by a filter, which linearises sample by sample
    np.testing.assert_allclose(bound(1e-14), calm, rtol=2e-2)
    assert np.all(bound(1e-5) > 1.3 * calm)


@pytest.mark.parametrize(("data", "prior"), [(3.0, 1.0), (1.0, 9.0), (5.0, 0.0)])
def test_the_share_of_a_prior_is_that_of_the_information(data: float, prior: float) -> None:
    """Of one unknown: P = 1/(F + P0), scattering by P F P; a prior that narrows anew counts for
    none of a larger scatter.
    """
    whole = data + prior
    bound = Bound(
        ("a", "b"),
        np.full(2, data**-0.5),
        np.array([np.sqrt(data) / whole, 2.0 / np.sqrt(whole)]),
        np.zeros(2),
        np.full(2, whole**-0.5),
        np.eye(2),
    )
    assert bound.prior_share == pytest.approx([prior / whole, 0.0])


@pytest.mark.parametrize(("passes", "spread"), [(1, np.inf), (3, np.inf), (3, 20.0), (4, 2.0)])
def test_stated_sigma_scatter_and_pull_are_those_of_a_linear_estimator(
    passes: int, spread: float
) -> None:
    rng, n, runs = np.random.default_rng(7), 3, 20000
    slopes, prior, off = (
        rng.standard_normal((10, n)) * [1.0, 0.3, 0.1],
        np.array([0.5, 1.0, 2.0]),
        np.array([1.0, -2.0, 3.0]),
    )
    data = slopes.T @ slopes
    stated, gain, left = _passes(data, prior, passes, spread)
    # The estimator itself, on records with noise of one about a truth of zero.
    score = slopes.T @ rng.standard_normal((10, runs))
    theta, width = np.repeat(off[:, None], runs, axis=1), prior
    for _ in range(passes):
        told = np.diag(width**-2.0)
        covariance = np.linalg.inv(data + told)
        theta = covariance @ (score + told @ theta)
        width = np.minimum(prior, spread * np.sqrt(np.diag(covariance)))
    np.testing.assert_allclose(stated, np.sqrt(np.diag(covariance)), rtol=1e-9)
    np.testing.assert_allclose(
        np.sqrt(np.diag(gain @ data @ gain.T)), theta.std(axis=1), rtol=5.0 / np.sqrt(2 * runs)
    )
    np.testing.assert_allclose(
        left @ off, theta.mean(axis=1), atol=5.0 * float(np.max(theta.std(axis=1))) / np.sqrt(runs)
    )


def test_a_prior_that_rules_is_told_and_methods_without_priors_have_none() -> None:
    tight = load_scenario("rigid", (*SHORT, "estimate.start.Cm_q={value = -28.0, std = 0.01}"))
    bound = bound_of(EstimatorRuns(tight, tight.estimations[0]))
    assert bound is not None
    at = bound.names.index("Cm_q")
    assert bound.prior_share[at] > 0.99 and bound.pull[at] == pytest.approx(6.75, rel=0.05)
    free = load_scenario("lateral")
    other = bound_of(EstimatorRuns(free, free.estimations[0]))
    assert other is not None and not other.prior_share.any() and not other.pull.any()
    np.testing.assert_array_equal(other.scatter, other.data)
