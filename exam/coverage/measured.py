"""One campaign and what is judged of its sigmas, as JSON."""

from __future__ import annotations

from typing import Any

from exam.coverage.plan import SEED
from scenarios.studies.campaign import Rebuilt, fly_campaign
from scenarios.studies.campaign_causes import Finding, judge
from scenarios.studies.campaign_report import cause_sentences, cause_word
from scenarios.studies.campaign_statistics import ParameterStatistics
from scenarios.studies.catalogue import load_document, load_scenario
from scenarios.tasks.study import Execution


def measured(name: str, method: str, runs: int, jobs: int | None = 1) -> dict[str, Any]:
    """Coverage of each parameter, and why a sigma is wrong. Raises FlightidError as
    ``fly_campaign``.
    """
    document, short, where = load_document(name)
    rebuilt_scenario = Rebuilt(
        {key: value for key, value in document.items() if key != "kind"}, short, where
    )
    campaign = fly_campaign(
        load_scenario(name),
        runs,
        SEED,
        method,
        execution=Execution(jobs),
        rebuilt_scenario=rebuilt_scenario,
    )
    judged = judge(campaign)
    why = {each.name: each for each in judged.findings.found}
    return {
        "scenario": name,
        "method": method,
        "label": campaign.estimation.label,
        "runs": runs,
        "settled": runs - campaign.broken,
        "parameters": {
            each.name: _parameter(each, why.get(each.name)) for each in judged.statistics.parameters
        },
        "because": cause_sentences(judged.findings),
    }


def _parameter(each: ParameterStatistics, finding: Finding | None) -> dict[str, Any]:
    content: dict[str, Any] = {
        "within_2": each.two.share,
        "low": each.two.interval[0],
        "high": each.two.interval[1],
    }
    content |= {"prior_share": each.prior_share} if each.prior_share is not None else {}
    if finding is None:
        return content
    right = finding.coverage
    wrong = {
        "factor": finding.wrong.factor,
        "because_of": cause_word(finding),
        "right_within_2": right.share,
        "right_runs": right.runs,
    }
    return {
        **content,
        "wrong": {**wrong, "right_low": right.interval[0], "right_high": right.interval[1]},
    }
