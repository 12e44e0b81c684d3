"""Statistics of a campaign against scipy and brute force on its own estimates."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest
from scipy.stats import binomtest, chi2

from scenarios.studies.campaign import CampaignRuns, fly_campaign
from scenarios.studies.campaign_report import squares_sentence
from scenarios.studies.campaign_statistics import (
    campaign_statistics,
    squares,
    statistics_content,
    statistics_csv,
)
from scenarios.studies.catalogue import load_scenario

RUNS = 48


@pytest.fixture(scope="module")
def campaign() -> CampaignRuns:
    return fly_campaign(load_scenario("rigid", ("flight.duration=4 s", "flight.rate=50")), RUNS, 2)


def test_bias_scatter_and_coverage_are_those_of_the_estimates(campaign: CampaignRuns) -> None:
    found = campaign_statistics(campaign)
    assert found.names == campaign.names
    for i, each in enumerate(found.parameters):
        error = campaign.values[i] - each.reference
        assert each.bias == pytest.approx(
            error.mean(), abs=1e-12
        ) and each.bias_std == pytest.approx(np.std(error, ddof=1) / RUNS**0.5)
        assert each.ratio == pytest.approx(
            np.std(error, ddof=1) / np.sqrt(np.mean(campaign.std[i] ** 2))
        )
        ends = [
            each.ratio * ((RUNS - 1) / chi2.ppf(share, RUNS - 1)) ** 0.5 for share in (0.975, 0.025)
        ]
        assert each.ratio_interval == pytest.approx(ends)
        for within in each.coverage:
            hits = sum(
                abs(e) <= within.sigmas * s for e, s in zip(error, campaign.std[i], strict=True)
            )
            interval = binomtest(hits, RUNS).proportion_ci(0.95, method="exact")
            assert within.share == hits / RUNS and within.interval == pytest.approx(
                (interval.low, interval.high), abs=1e-12
            )
        assert each.bound is not None and each.efficiency == pytest.approx(
            (each.bound / each.scatter) ** 2
        )


def test_nees_and_nis_are_means_over_their_degrees(campaign: CampaignRuns) -> None:
    found = campaign_statistics(campaign)
    assert found.nees is not None and found.nis is not None
    assert found.nees.mean == pytest.approx(np.mean(campaign.nees) / 6)
    assert found.nees.interval == pytest.approx(
        [end / (6 * RUNS) for end in chi2.interval(0.95, 6 * RUNS)]
    )
    assert found.nis.mean == pytest.approx(campaign.nis.sum() / campaign.degrees.sum())
    low, high = chi2.interval(0.95, campaign.degrees)
    assert found.nis.inside == np.mean((campaign.nis >= low) & (campaign.nis <= high))


@pytest.mark.parametrize(
    ("factor", "said"), [(1.0, "as it should be"), (1.3, "too large"), (0.7, "too small")]
)
def test_a_wrong_nees_is_called_so(factor: float, said: str) -> None:
    drawn = factor * np.random.default_rng(3).chisquare(6, 500)
    found = squares("NEES", drawn, np.full(500, 6))
    assert found is not None and found.right == (factor == 1.0) and said in squares_sentence(found)


def test_runs_without_a_sum_are_left_out_and_none_gives_none() -> None:
    found = squares("NIS", np.array([5.0, np.nan, 7.0, 3.0]), np.array([6, 6, 6, 0]))
    assert found is not None and found.values.tolist() == [5.0, 7.0] and found.mean == 1.0
    assert squares("NIS", np.zeros(3), np.zeros(3, dtype=int)) is None


def test_the_table_and_the_document_say_the_same(campaign: CampaignRuns) -> None:
    found = campaign_statistics(campaign)
    rows = {row["parameter"]: row for row in csv.DictReader(io.StringIO(statistics_csv(found)))}
    content = statistics_content(found)
    assert list(rows) == list(content["parameters"]) == list(campaign.names)
    for name, document in content["parameters"].items():
        for key, value in document.items():
            assert rows[name][key] == (value if isinstance(value, str) else repr(value))
