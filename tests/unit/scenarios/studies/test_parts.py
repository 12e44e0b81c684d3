"""What causes of wrong sigmas are told by: which are judged wrong, misfit and colour of residuals,
noise levels by likelihood, coloured scatter.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from scenarios.studies.campaign import EstimatorRuns
from scenarios.studies.campaign_causes import (
    predicted_by_colour,
    predicted_by_prior,
    split,
    wrong_sigmas,
)
from scenarios.studies.campaign_statistics import Bound, coverage_of
from scenarios.studies.campaign_trials import STATES, Level, likely_levels
from scenarios.studies.catalogue import load_scenario
from scenarios.tasks.work import tasks_of

SHORT = ("flight.duration=4 s", "flight.rate=50", "flight.step=0.01")


def statistics_of(sigmas: np.ndarray) -> Any:
    return SimpleNamespace(
        sigmas=sigmas,
        parameters=[
            SimpleNamespace(two=coverage_of(row)[1], coverage=coverage_of(row)) for row in sigmas
        ],
    )


def test_right_campaigns_are_called_wrong_as_seldom_as_said() -> None:
    rng, draws = np.random.default_rng(4), 150
    called = [
        bool(wrong_sigmas(statistics_of(rng.standard_normal((8, 300))))) for _ in range(draws)
    ]
    assert np.mean(called) < 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / draws)


@pytest.mark.parametrize("factor", [3.0, 0.4])
def test_the_factor_is_that_by_which_sigmas_are_wrong(factor: float) -> None:
    drawn = np.random.default_rng(6).standard_normal((3, 20000))
    drawn[1] *= factor
    (wrong,) = wrong_sigmas(statistics_of(drawn))
    assert wrong.at == 1 and wrong.too_small == (factor > 1.0)
    assert wrong.factor == pytest.approx(factor, rel=0.03) and wrong.rms == pytest.approx(
        factor, rel=0.03
    )


def test_a_common_misfit_and_the_colour_of_the_rest_are_told_apart() -> None:
    rng, runs, count = np.random.default_rng(8), 40, 400
    valid = np.ones((2, count), dtype=bool)
    valid[1, ::5] = False
    noise = rng.standard_normal((2, count, runs))
    for at in range(1, count):
        noise[0, at] = 0.8 * noise[0, at - 1] + 0.6 * noise[0, at]
    white = split(noise, valid, ("alpha", "q"))
    assert white.misfit == 0.0 and white.coloured
    assert white.colour == pytest.approx([0.8, 0.0], abs=0.03) and white.lags[
        :, 0
    ] == pytest.approx([1.0, 1.0], abs=0.06)
    wave = 0.5 * np.sin(np.arange(count) / 20.0)[None, :, None]
    both = split(noise + wave, valid, ("alpha", "q"))
    assert both.misfit == pytest.approx(
        0.5 / np.sqrt(2.0), rel=0.1
    ) and both.colour == pytest.approx(white.colour, abs=1e-9)


def test_coloured_noise_is_foretold_as_it_scatters_a_linear_estimator() -> None:
    rng, count, runs = np.random.default_rng(9), 300, 6000
    time = np.arange(count) / 50.0
    slopes = np.stack([np.sin(time), np.exp(-time)], axis=1) / 5.0
    prior = np.diag([4.0, 0.0])
    gain = np.linalg.inv(slopes.T @ slopes + prior)
    noise = rng.standard_normal((count, runs))
    for at in range(1, count):
        noise[at] = 0.7 * noise[at - 1] + np.sqrt(1.0 - 0.49) * noise[at]
    errors = gain @ slopes.T @ noise + gain @ prior @ rng.normal(0.0, [[0.5], [0.0]], (2, runs))
    stated = np.sqrt(np.diag(gain))
    bound = Bound(("a", "b"), stated, stated, np.zeros(2), stated, gain, slopes)
    residuals = split(noise[None, :, :60], np.ones((1, count), dtype=bool), ("y",))
    foretold = predicted_by_colour(bound, residuals)
    assert foretold is not None
    np.testing.assert_allclose(foretold, errors.std(axis=1) / stated, rtol=0.06)
    assert np.all(foretold > 1.8)


def test_errors_by_a_prior_are_its_pull_and_what_scatter_is_left() -> None:
    bound = Bound(
        ("a",), np.array([2.0]), np.array([0.3]), np.array([0.4]), np.array([0.5]), np.eye(1)
    )
    foretold, share = predicted_by_prior(bound, 0)
    assert foretold == pytest.approx(1.0) and share == pytest.approx(1.0 - 0.36)


@pytest.mark.parametrize(
    ("assumed", "agrees"), [(1.0, True), (1.04, True), (1.3, False), (0.7, False)]
)
def test_levels_agree_within_their_spread_or_for_every_purpose(
    assumed: float, agrees: bool
) -> None:
    assert Level("q", "rad/s", assumed, 1.0, 0.01).agrees == agrees


@pytest.mark.long
def test_a_wrong_measurement_noise_is_found_by_likelihood() -> None:
    scenario = load_scenario(
        "rigid", (*SHORT, "flight.rate=20", "estimate.noise_std={alpha=0.0044, q=0.0011}")
    )
    found = likely_levels(
        EstimatorRuns(scenario, scenario.estimations[0]),
        [task.seed for task in tasks_of(3, range(4))],
    )
    assert found is not None and found.estimation is not None and not found.agree
    levels = {item.name: item for item in found.items}
    for name in ("alpha", "q"):
        assert levels[name].found == pytest.approx(
            scenario.flight.noise_std[name], rel=5.0 * levels[name].spread
        )
        assert 0.02 < levels[name].spread < 0.1 and not levels[name].agrees
    assert levels[STATES].found == 0.0 and found.estimation.process_noise == {}


@pytest.mark.slow
def test_process_noise_that_is_not_declared_and_such_that_is_tenfold_are_found() -> None:
    flown = "flight.process_noise={alpha=2e-6, q=2e-6}"
    for declared, expected in (
        (("estimate.process_noise={alpha=2e-5, q=2e-5}",), 0.1**0.5),
        ((), None),
    ):
        scenario = load_scenario("rigid", (*SHORT, flown, *declared))
        found = likely_levels(
            EstimatorRuns(scenario, scenario.estimations[0]),
            [task.seed for task in tasks_of(3, range(12))],
        )
        assert found is not None and found.estimation is not None
        level = next(item for item in found.items if item.name == STATES)
        assert not level.agrees
        if expected is not None:
            assert level.found == pytest.approx(expected, rel=4.0 * level.spread)
        else:
            assert level.assumed == 0.0 and found.estimation.process_noise["alpha"] > 1e-7
