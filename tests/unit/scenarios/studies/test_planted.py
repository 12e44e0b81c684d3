"""Campaigns in which something is planted that makes sigmas wrong: it is named, and the right sigma
covers; in a clean one nothing is said.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from scenarios.studies.campaign import CampaignRuns, EstimatorRuns, campaign_of, fly_campaign
from scenarios.studies.campaign_causes import COLOUR, MODEL, NOISE, PRIOR, Findings, judge
from scenarios.studies.campaign_report import cause_sentences, levels_sentence
from scenarios.studies.campaign_statistics import NORMAL
from scenarios.studies.campaign_trials import LEVELS, START, TRIALS_STEPS
from scenarios.studies.catalogue import load_scenario
from scenarios.tasks.study import TaskRequest, run_study
from sim.record import Record

SHORT = ("flight.duration=8 s", "flight.rate=40", "flight.step=0.0125")


def campaign(
    name: str, runs: int, *changes: str, method: str = "main", seed: int = 1
) -> CampaignRuns:
    return fly_campaign(load_scenario(name, changes), runs, seed, method)


def told(found: Findings, cause: str, *, beside: tuple[str, ...] = ()) -> None:
    """Every wrong sigma has this cause, and its right sigma covers as one does."""
    assert found.found
    for each in found.found:
        assert cause in each.causes and set(each.causes) <= {cause, *beside}, (
            each.name,
            each.causes,
        )
        low, high = each.coverage.interval
        assert low <= NORMAL[2] <= high or abs(each.coverage.share - NORMAL[2]) < 0.06, (
            each.name,
            each.coverage,
        )


@pytest.mark.long
def test_of_a_clean_campaign_nothing_is_said() -> None:
    for seed in (1, 2):
        judged = judge(
            campaign("rigid", 150, *SHORT, "estimate.passes=4", "estimate.spread=20", seed=seed)
        )
        assert (
            judged.findings.found == ()
            and judged.findings.levels is None
            and cause_sentences(judged.findings) == []
        )


@pytest.mark.slow
def test_coarse_steps_are_told_by_finer_ones() -> None:
    found = judge(campaign("rigid-euler", 100, *SHORT)).findings
    told(found, TRIALS_STEPS)
    assert any(
        "too small" in sentence and "integration is too coarse" in sentence
        for sentence in cause_sentences(found)
    )


@pytest.mark.slow
def test_a_start_far_off_is_told_by_starting_again() -> None:
    found = judge(
        campaign(
            "ballistic", 150, "flight.duration=20 s", "flight.rate=5", method="paper-start-rk4"
        )
    ).findings
    told(found, START)
    assert found.found[0].wrong.too_small and found.found[0].again


def test_a_prior_that_rules_is_told_without_computing_again() -> None:
    tight = "estimate.start.Cm_q={value = -33.0, std = 0.05}"
    found = judge(campaign("rigid", 200, *SHORT, tight)).findings
    ours = {each.name: each for each in found.found}
    assert (
        ours["Cm_q"].causes == (PRIOR,) and ours["Cm_q"].strength > 0.8 and not ours["Cm_q"].again
    )
    assert found.levels is None or found.levels.agree


@dataclass(frozen=True, eq=False)
class CorrelatedRuns(EstimatorRuns):
    """Runs whose sensors' noise is of first order, with the declared standard deviation."""

    def record_of(self, seed: int) -> Record:
        record, truth, rng, outputs = (
            self.common.record,
            self.common.truth,
            np.random.default_rng(seed),
            [],
        )
        for channel in record.outputs:
            drive = rng.standard_normal(len(record.time))
            for at in range(1, len(drive)):
                drive[at] = 0.7 * drive[at - 1] + np.sqrt(1.0 - 0.49) * drive[at]
            outputs.append(
                replace(
                    channel,
                    values=truth.outputs[channel.name] + truth.noise_std[channel.name] * drive,
                )
            )
        return replace(record, outputs=tuple(outputs))


def test_coloured_noise_is_told_and_its_right_sigma_covers_all_runs() -> None:
    scenario = load_scenario("rigid", SHORT)
    work = CorrelatedRuns(scenario, scenario.estimations[0])
    found = judge(campaign_of(work, run_study(work, TaskRequest(200, 1)), 1)).findings
    told(found, COLOUR, beside=(START,))
    assert len(found.found) >= 5 and all(
        each.wrong.too_small and each.coverage.runs == 200 for each in found.found if not each.again
    )
    assert (
        found.found[0].strength == pytest.approx(0.7, abs=0.05)
        and sum(each.causes == (COLOUR,) for each in found.found) >= 4
    )


@pytest.mark.slow
def test_a_rigid_model_on_flexible_data_is_told_by_its_misfit() -> None:
    found = judge(
        campaign(
            "flexible-ac1-equivalent",
            120,
            "flight.duration=5 s",
            "flight.rate=50",
            method="no-process-noise",
        )
    ).findings
    told(found, MODEL)
    assert found.misfits and "cannot follow" in cause_sentences(found)[0]


@pytest.mark.slow
def test_process_noise_where_none_acts_is_told_by_likelihood() -> None:
    wrong = "estimate.process_noise={alpha=1e-5, q=1e-5}"
    found = judge(campaign("rigid", 120, *SHORT, wrong)).findings
    told(found, LEVELS, beside=(START,))
    assert not any(
        each.wrong.too_small for each in found.found
    ) and "process noise of states: none acts" in levels_sentence(found)


@pytest.mark.slow
@pytest.mark.parametrize(("declared", "small"), [(2e-5, False), (2e-7, True)])
def test_process_noise_stated_tenfold_and_a_tenth_is_told_by_likelihood(
    declared: float, small: bool
) -> None:
    noise = (
        "flight.process_noise={alpha=2e-6, q=2e-6}",
        f"estimate.process_noise={{alpha={declared}, q={declared}}}",
    )
    found = judge(campaign("rigid", 200, *SHORT, *noise)).findings
    told(found, LEVELS, beside=(START,))
    assert all(each.wrong.too_small == small for each in found.found)


@pytest.mark.slow
def test_noise_in_regressors_is_told_by_a_tenth_of_it() -> None:
    found = judge(campaign("unstable", 100, method="regression")).findings
    assert any(each.causes == (NOISE,) for each in found.found) and not any(
        MODEL in each.causes for each in found.found
    )
