"""Over 200 seeds: do the intervals of the catalogue's main results hold what they should?"""

from __future__ import annotations

import numpy as np
import pytest

from scenarios.studies.catalogue import load_scenario
from tests.repeated import Repeated, repeat

SEEDS = range(1, 201)
POUND_PER_SQUARE_FOOT = 4.882427636
BIASES = [
    ("paper-true-fall", -60, -46),
    ("paper-two-terms", -12, -6),
    ("paper-start-rk4", -11, -5),
    ("one-pass", -1.1, -0.5),
]


def repeated(name: str, method: str = "main") -> Repeated:
    scenario = load_scenario(name)
    return repeat(
        scenario, next(item for item in scenario.estimations if item.name == method), SEEDS
    )


@pytest.mark.slow
def test_rigid_intervals_hold_the_truth_as_often_as_they_say() -> None:
    runs = repeated("rigid")
    assert 0.93 <= np.mean(runs.coverage()) <= 0.97
    assert np.all((runs.coverage() >= 0.905) & (runs.coverage() <= 0.99)), dict(
        zip(runs.names, runs.coverage(), strict=True)
    )


@pytest.mark.slow
def test_ballistic_intervals_hold_the_truth() -> None:
    runs = repeated("ballistic")
    assert runs.coverage()[0] >= 0.93
    assert abs(np.mean(runs.sigmas)) < 0.25, "no bias beyond its scatter over 200 runs, 0.07"


@pytest.mark.slow
@pytest.mark.parametrize(("method", "low", "high"), BIASES)
def test_the_biases_that_the_ballistic_scenario_explains(
    method: str, low: float, high: float
) -> None:
    assert low < np.mean(repeated("ballistic", method).sigmas) < high


@pytest.mark.slow
def test_one_pass_of_the_ballistic_filter_covers_too_little_and_the_cure_works_from_the_papers_start() -> (  # noqa: E501
    None
):
    assert repeated("ballistic", "one-pass").coverage()[0] < 0.9
    assert repeated("ballistic", "paper-start-cured").coverage()[0] >= 0.93


@pytest.mark.slow
@pytest.mark.parametrize("name", ["flexible-ac1-equivalent", "flexible-ac2-equivalent"])
def test_equivalents_lie_within_three_sigma_of_the_condensed_values(name: str) -> None:
    assert np.all(repeated(name).coverage(3.0) >= 0.99)
    assert np.any(repeated(name, "no-process-noise").coverage(3.0) == 0.0), (
        "without process noise the sigmas are no bound of the error"
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["flexible-ac1-first-mode", "flexible-ac2-first-mode"])
def test_first_mode_intervals_hold_the_condensed_values(name: str) -> None:
    assert np.mean(repeated(name).coverage()) >= 0.95
    assert np.mean(repeated(name, "no-process-noise").coverage()) < 0.9, (
        "sigmas along unseen directions are spurious"
    )


@pytest.mark.slow
def test_the_papers_two_columns_are_no_two_and_three_terms_of_one_record() -> None:
    two, three = (
        repeated("ballistic", f"paper-{terms}-terms").estimate[0] / POUND_PER_SQUARE_FOOT
        for terms in ("two", "three")
    )
    assert (
        two.mean() == pytest.approx(497.6, abs=3 * 2.6 / np.sqrt(200))
        and 2.0 < two.std(ddof=1) < 3.2
    )
    moved = np.abs(three - two)
    assert np.median(moved) < 0.03 and np.quantile(moved, 0.95) < 0.2 and moved.max() < 1.937, (
        "what the printed columns differ by"
    )
    assert 0.25 < np.mean(two < 497.8827) < 0.5, "an ordinary seed of this set-up"
    assert np.mean(three > 499.8196) <= 0.02, "one at its edge"
    near = repeated("ballistic", "one-pass").estimate[0] / POUND_PER_SQUARE_FOOT
    assert 0.4 < np.mean(near < 499.8196) < 0.65 and near.min() > 497.8827, (
        "from a near start the other way round"
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "means"),
    [
        (
            "main",
            {
                "CL_alpha": 3.029,
                "CL_q": -11.45,
                "CL_de": 0.605,
                "Cm_alpha": -1.6485,
                "Cm_q": -35.37,
                "Cm_de": -2.5663,
            },
        ),
        (
            "twenty-hertz",
            {
                "CL_alpha": 3.374,
                "CL_q": -2.84,
                "CL_de": 1.095,
                "Cm_alpha": -1.5955,
                "Cm_q": -38.23,
                "Cm_de": -2.5164,
            },
        ),
    ],
)
def test_what_eulers_error_is_worth_in_the_rigid_aircraft(
    method: str, means: dict[str, float]
) -> None:
    runs = repeated("rigid-euler", method)
    for name, row in zip(runs.names, runs.estimate, strict=True):
        assert row.mean() == pytest.approx(
            means[name], abs=4 * row.std(ddof=1) / np.sqrt(200) + 6e-4 * abs(means[name])
        ), name
    assert np.mean(runs.coverage()) < 0.05
