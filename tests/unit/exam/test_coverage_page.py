"""The page of measured coverage: every scenario that can be is in the plan, every parameter is
judged, and the counts are right.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from scipy.stats import binomtest

from exam.coverage.every_scenario import PAGE, RUNS, judged, main, page_of
from scenarios.studies.catalogue import IDENTIFICATION, load_scenario, scenario_names

ROOT = Path(__file__).parents[3]
NUMBERS = ROOT / PAGE.with_suffix(".json")


def test_every_scenario_of_estimators_is_in_the_plan_and_its_methods_exist() -> None:
    ours = set(scenario_names(IDENTIFICATION))
    assert ours == {name for name, method in RUNS if method == "main"}
    for name, method in RUNS:
        assert method in {each.name for each in load_scenario(name).estimations}, (name, method)


@pytest.mark.parametrize(
    ("share", "wrong", "said"),
    [
        (0.951, None, "holds"),
        (0.90, None, "not told from 95.4 %"),
        (
            0.60,
            2.5,
            "σ too small by a factor of 2.50: model; without this cause 95.0 % (91.0 to 98.0 %)",
        ),
        (
            1.00,
            0.05,
            "σ too large by a factor of 20: model; without this cause 95.0 % (91.0 to 98.0 %)",
        ),
    ],
)
def test_what_is_said_of_a_parameter(share: float, wrong: float | None, said: str) -> None:
    each: dict = {"within_2": share, "low": share - 0.02, "high": share}
    if wrong is not None:
        each["wrong"] = {
            "factor": wrong,
            "because_of": "model",
            "right_within_2": 0.95,
            "right_low": 0.91,
            "right_high": 0.98,
            "right_runs": 64,
        }
    assert judged(each) == said


def test_what_only_the_prior_knows_is_not_identifiable() -> None:
    each = {"within_2": 1.0, "low": 0.95, "high": 1.0, "prior_share": 0.934}
    assert judged(each) == "not identifiable: 93 % of the variance is the prior's"
    assert judged({**each, "prior_share": 0.2}) == "not told from 95.4 %"


def test_the_page_is_that_of_its_numbers_and_every_parameter_outside_says_why(
    tmp_path: Path,
) -> None:
    kept = json.loads(NUMBERS.read_text(encoding="utf-8"))["campaigns"]
    assert {(each["scenario"], each["method"]): each["runs"] for each in kept} == RUNS
    page = page_of(kept)
    assert page == (ROOT / PAGE).read_text(encoding="utf-8")
    for campaign in kept:
        for name, each in campaign["parameters"].items():
            hits, level = (
                round(each["within_2"] * campaign["settled"]),
                1.0 - 0.05 / len(campaign["parameters"]),
            )
            interval = binomtest(hits, campaign["settled"]).proportion_ci(level, method="exact")
            assert ("wrong" in each) == (not interval.low <= 0.954499736 <= interval.high), (
                campaign["scenario"],
                name,
            )
            assert f"| {name} | {100 * each['within_2']:.1f} % |" in page
    (tmp_path / "page.json").write_text(NUMBERS.read_text(encoding="utf-8"), encoding="utf-8")
    assert (
        main(["--kept", "--page", str(tmp_path / "page.md")]) == 0
        and (tmp_path / "page.md").read_text(encoding="utf-8") == page
    )
