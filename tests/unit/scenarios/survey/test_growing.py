"""A survey's folder that grows: only what is new or changed is computed, whatever else is there
stays as it was.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from scenarios.survey.flights import KEPT
from scenarios.survey.report import survey_text
from scenarios.survey.survey import survey_flights
from tests.integration.command_line import contents
from tests.unit.scenarios.survey.conftest import Campaign

LATE = 1.5


def document(campaign: Campaign) -> dict[str, Any]:
    """The survey's document without what another moment or another folder changes."""
    content = json.loads((campaign.out / "survey.json").read_text())
    return {
        key: value
        for key, value in content.items()
        if key not in ("created", "computed", "new", "refitted", "removed", "files")
    }


def four(campaign: Campaign) -> list[str]:
    return [campaign.fly("a", LATE), campaign.fly("b"), campaign.fly("c", LATE), campaign.fly("d")]


def test_the_first_survey_computes_all_and_says_what_recurs(campaign: Campaign) -> None:
    found = campaign.survey(*four(campaign))
    assert campaign.diagnosed == campaign.fitted == ["a", "b", "c", "d"]
    assert found.survey_files.computed == ("a", "b", "c", "d")
    assert found.survey_files.new == ()
    assert [(each.name, each.has, each.has_not) for each in found.recurs] == [
        ("sensor-delay:q", ("a", "c"), ("b", "d"))
    ]
    assert dict(found.verdicts) == {"traced": 2, "consistent": 2}
    content = json.loads((campaign.out / "survey.json").read_text())
    assert content["effects"][0]["flights"]["b"]["state"] == "does not have it"
    assert content["verdict"] == "recurs"
    rows = (campaign.out / "derivatives.csv").read_text().splitlines()
    assert rows[0].startswith("flight,derivative,unit,value,std,sigmas_off,stands_out")
    assert len(rows) == 1 + 4 * 2


def test_one_flight_more_is_one_flight_computed(campaign: Campaign) -> None:
    flights = four(campaign)
    campaign.survey(*flights)
    before = contents(campaign.out / "flights")
    found = campaign.survey(*flights, campaign.fly("e", LATE))
    assert campaign.diagnosed == campaign.fitted == ["e"]
    assert (found.survey_files.computed, found.survey_files.new, found.refitted) == (
        ("e",),
        ("e",),
        1,
    )
    assert found.recurs[0].has == ("a", "c", "e")
    after = contents(campaign.out / "flights")
    assert {name: after[name] for name in before} == before
    assert "new: e" in survey_text(found)
    assert "New since the last survey" in (campaign.out / "report.html").read_text()


def test_nothing_new_computes_nothing_and_says_the_same(campaign: Campaign) -> None:
    flights = four(campaign)
    campaign.survey(*flights)
    before = document(campaign)
    found = campaign.survey(*flights)
    assert (campaign.diagnosed, campaign.fitted, found.survey_files.computed, found.refitted) == (
        [],
        [],
        (),
        0,
    )
    assert document(campaign) == before
    everything = document(campaign)
    fresh = Campaign(campaign.folder)
    fresh.out = campaign.folder / "fresh"
    fresh.survey(*flights)
    assert document(fresh) == everything  # a folder that grew says what a new one says


def test_a_flight_that_is_no_longer_named_is_told_and_its_folder_stays(campaign: Campaign) -> None:
    flights = four(campaign)
    campaign.survey(*flights)
    found = campaign.survey(*flights[:3])
    assert campaign.diagnosed == []
    assert found.survey_files.removed == ("d",)
    assert "removed since the last survey: d" in survey_text(found)
    assert list(document(campaign)["flights"]) == ["a", "b", "c"]
    assert (campaign.out / "flights" / "d" / KEPT).is_file()
    again = campaign.survey(*flights)
    assert (campaign.diagnosed, again.survey_files.new) == ([], ("d",))


@pytest.mark.long
def test_what_is_changed_of_one_flight_computes_that_flight(campaign: Campaign) -> None:
    flights = four(campaign)
    campaign.survey(*flights)
    campaign.survey(*flights[:1], campaign.fly("b", more="vehicle = {mass = 1.0e5}"), *flights[2:])
    assert campaign.diagnosed == campaign.fitted == ["b"]
    (campaign.folder / "c.csv").write_text("1.25")  # its record
    campaign.survey(*flights)
    assert campaign.diagnosed == campaign.fitted == ["b", "c"]
    # what no diagnosis knows
    found = campaign.survey(flights[0] + "tail = 'FT-9'\ncondition = {mach = 0.3}\n", *flights[1:])
    assert campaign.diagnosed == []
    assert found.survey_files.flights["a"].tail == "FT-9"
    aircraft = campaign.folder / "aircraft.toml"
    aircraft.write_text(aircraft.read_text().replace("Cm_q = -28.0", "Cm_q = -27.0"))
    campaign.survey(*flights)
    assert campaign.diagnosed == ["a", "b", "c", "d"]


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("file", "broken"),
    [(KEPT, b"{"), ("sets.json", b"[]"), (KEPT, b'{"schema": "flightid/survey-flight/0"}')],
)
def test_a_kept_file_that_is_broken_is_computed_again(
    campaign: Campaign, broken: bytes, file: str
) -> None:
    flights = four(campaign)
    campaign.survey(*flights)
    before = document(campaign)
    (campaign.out / "flights" / "c" / file).write_bytes(broken)
    campaign.survey(*flights)
    assert campaign.diagnosed == (["c"] if file == KEPT else [])
    assert campaign.fitted == (["c"] if file == "sets.json" else [])
    assert document(campaign) == before


def test_a_broken_survey_document_counts_as_none(campaign: Campaign) -> None:
    flights = four(campaign)
    campaign.survey(*flights)
    (campaign.out / "survey.json").write_text('{"flights": 3}')
    found = campaign.survey(*flights)
    assert (campaign.diagnosed, found.survey_files.new, found.survey_files.removed) == ([], (), ())


def test_ctrl_c_keeps_the_flights_that_have_ended(campaign: Campaign) -> None:
    flights, campaign.stop_at = four(campaign), "c"
    with pytest.raises(KeyboardInterrupt, match=r"2 of 4 flights are kept in .*morning"):
        survey_flights(campaign.declare(*flights), campaign.out)
    assert not (campaign.out / "survey.json").exists()
    campaign.stop_at = ""
    campaign.survey(*flights)
    assert campaign.diagnosed == ["c", "d"]
    campaign.stop_at = "e"
    with pytest.raises(KeyboardInterrupt, match="4 of 5 flights are kept"):
        survey_flights(campaign.declare(*flights, campaign.fly("e")), campaign.out)


def test_a_flight_that_fails_is_told_and_does_not_end_the_survey(campaign: Campaign) -> None:
    flights = four(campaign)
    campaign.faults["b"] = FloatingPointError("overflow\nencountered")
    found = campaign.survey(*flights, '[[flights]]\nrecord = "gone.csv"\n')
    assert list(found.survey_files.diagnoses) == ["a", "c", "d"]
    assert found.survey_files.failed["b"] == "FloatingPointError: overflow encountered"
    assert found.survey_files.failed["gone"].endswith(
        "gone.csv: there is no such file; check the path"
    )
    assert found.recurs[0].has == ("a", "c")
    text = survey_text(found)
    assert "2 failed: b, gone" in text
    assert "b failed: FloatingPointError" in text
    content = json.loads((campaign.out / "survey.json").read_text())
    assert content["failed"] == dict(found.survey_files.failed)
    assert len(content["warnings"]) == 2
    assert "gone.csv" in (campaign.out / "report.html").read_text()
    campaign.faults.clear()
    campaign.survey(*flights, '[[flights]]\nrecord = "gone.csv"\n')
    assert campaign.diagnosed == ["b"]  # what failed is tried again


def test_a_survey_without_a_flight_that_can_be_used(campaign: Campaign, tmp_path: Path) -> None:
    found = campaign.survey('[[flights]]\nrecord = "gone.csv"\n')
    assert survey_text(found).count("NO FLIGHT") == 1
    assert json.loads((campaign.out / "survey.json").read_text())["verdict"] == "no flight"


def test_one_flight_alone(campaign: Campaign) -> None:
    found = campaign.survey(campaign.fly("a", LATE))
    assert found.recurs == ()
    assert found.alone == {"sensor-delay:q": ("a",)}
    assert "sensor-delay:q is named in a and does not recur" in survey_text(found)
    assert [each.common.flights for each in found.derivatives] == [1, 1]
