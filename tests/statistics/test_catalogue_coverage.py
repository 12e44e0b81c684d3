"""Over 200 seeds: do the intervals of the catalogue's main results hold what they should?"""

from __future__ import annotations

import numpy as np
import pytest

from scenarios.studies.catalogue import load_scenario
from tests.repeated import Repeated, repeat

SEEDS = range(1, 201)


def repeated(name: str, method: str = "main") -> Repeated:
    scenario = load_scenario(name)
    return repeat(scenario, next(item for item in scenario.estimations if item.name == method), SEEDS)


@pytest.mark.slow
def test_rigid_intervals_hold_the_truth_as_often_as_they_say() -> None:
    runs = repeated("rigid")
    assert 0.93 <= np.mean(runs.coverage()) <= 0.97
    assert np.all((runs.coverage() >= 0.905) & (runs.coverage() <= 0.99)), dict(zip(runs.names, runs.coverage(), strict=True))


@pytest.mark.slow
def test_ballistic_intervals_hold_the_truth() -> None:
    runs = repeated("ballistic")
    assert runs.coverage()[0] >= 0.93
    assert abs(np.mean(runs.sigmas)) < 0.25, "no bias beyond its scatter over 200 runs, 0.07"


@pytest.mark.slow
@pytest.mark.parametrize(("method", "low", "high"), [("paper-two-terms", -70, -40), ("paper-start-rk4", -12, -4), ("one-pass", -1.1, -0.5)])
def test_the_biases_that_the_ballistic_scenario_explains(method: str, low: float, high: float) -> None:
    assert low < np.mean(repeated("ballistic", method).sigmas) < high


@pytest.mark.slow
def test_one_pass_of_the_ballistic_filter_covers_too_little_and_the_cure_works_from_the_papers_start() -> None:
    assert repeated("ballistic", "one-pass").coverage()[0] < 0.9
    assert repeated("ballistic", "paper-start-cured").coverage()[0] >= 0.93


@pytest.mark.slow
@pytest.mark.parametrize("name", ["flexible-ac1-equivalent", "flexible-ac2-equivalent"])
def test_equivalents_lie_within_three_sigma_of_the_condensed_values(name: str) -> None:
    assert np.all(repeated(name).coverage(3.0) >= 0.99)
    assert np.any(repeated(name, "no-process-noise").coverage(3.0) == 0.0), "without process noise the sigmas are no bound of the error"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["flexible-ac1-first-mode", "flexible-ac2-first-mode"])
def test_first_mode_intervals_hold_the_condensed_values(name: str) -> None:
    assert np.mean(repeated(name).coverage()) >= 0.95
    assert np.mean(repeated(name, "no-process-noise").coverage()) < 0.9, "sigmas along unseen directions are spurious"
