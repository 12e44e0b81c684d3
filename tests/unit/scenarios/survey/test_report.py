"""What a survey tells of what it found: terminal, page, figures, JSON and CSV say the same, and
nothing more than is known.
"""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scenarios.report.folder import rebuilt
from scenarios.report.terminal import cell_text
from scenarios.survey.files import survey_figures, survey_page, write_survey
from scenarios.survey.report import (
    effects_table,
    flights_table,
    new_flight_phrases,
    other_cause_phrases,
    rivals_phrase,
    survey_text,
    verdict_of,
)
from scenarios.survey.survey import SurveyResult, over_flights
from sim.errors import ModelError
from tests.unit.scenarios.survey.conftest import Campaign

LATE = 1.5


def more(campaign: Campaign, count: int) -> list[str]:
    """Flights at masses of their own, every second one late."""
    return [
        campaign.fly(f"F{n:02d}", LATE * (n % 2), f"vehicle = {{mass = {1.2e5 + 1e3 * n}}}")
        for n in range(count)
    ]


@pytest.fixture
def found(campaign: Campaign) -> SurveyResult:
    return campaign.survey(*more(campaign, 6))


def test_terminal_page_and_files_say_the_same(found: SurveyResult, campaign: Campaign) -> None:
    (each,) = found.recurs
    sigma = float(np.sqrt(each.recurrence.covariance[0, 0]))
    content = json.loads((campaign.out / "survey.json").read_text())
    assert content["effects"][0]["parameters"]["value0"]["value"] == each.recurrence.value[0]
    assert content["effects"][0]["parameters"]["value0"]["std"] == sigma
    assert [
        name for name, told in content["effects"][0]["flights"].items() if told["state"] == "has it"
    ] == ["F01", "F03", "F05"]
    phrase = verdict_of(found)[1]
    value = float(phrase.split()[1])
    assert value == pytest.approx(each.recurrence.value[0], abs=0.6 * sigma)
    assert "in 3 of 6 flights" in phrase
    text, page = survey_text(found), (campaign.out / "report.html").read_text()
    assert "sensor-delay:q" in text
    assert "in 3 of 6 flights" in page
    rows = list(csv.DictReader((campaign.out / "derivatives.csv").read_text().splitlines()))
    told = {(row["flight"], row["derivative"]): float(row["value"]) for row in rows}
    for one in found.derivatives:
        for name, here in zip(one.flights, one.values, strict=True):
            assert told[name, one.name] == here
    assert {float(row["mass"]) for row in rows} == {1.2e5 + 1e3 * n for n in range(6)}


@pytest.mark.long
def test_the_page_is_made_again_from_its_folder(campaign: Campaign) -> None:
    found = campaign.survey(*more(campaign, 6))
    write_survey(found, campaign.out, figures=("png",))
    before = (campaign.out / "report.html").read_bytes()
    for name in ("effects.png", "shared.png", "over_mass.png"):
        assert (campaign.out / name).read_bytes()[:4] == b"\x89PNG"
    assert before.count(b"<svg") == 3
    (campaign.out / "report.html").unlink()
    assert rebuilt(campaign.out).read_bytes() == before


def test_flights_lead_to_their_own_pages_where_there_are_any(
    found: SurveyResult, campaign: Campaign
) -> None:
    (campaign.out / "flights" / "F03" / "report.html").write_text("its page")
    write_survey(found, campaign.out, figures=())
    page = (campaign.out / "report.html").read_text()
    assert 'href="flights/F03/report.html"' in page
    assert 'href="flights/F02/report.html"' not in page
    again = campaign.folder / "elsewhere"
    write_survey(found, again, figures=())
    assert "flights/F03" not in (again / "report.html").read_text()


def test_a_link_leads_nowhere_outside() -> None:
    from scenarios.report.document import Link

    for to in ("https://example.org", "../x.html", "/etc/passwd", "javascript:x", "a/../b", ""):
        with pytest.raises(ModelError):
            Link("x", to)


def test_figures_are_of_the_flights_that_have_the_condition(found: SurveyResult) -> None:
    drawn = dict(survey_figures(found))
    assert list(drawn) == ["effects", "shared", "over_mass"]
    assert [label.get_text() for label in drawn["effects"]().axes[0].get_xticklabels()] == [
        f"F{n:02d}" for n in range(6)
    ]
    for figure in drawn.values():
        figure().canvas.draw()


def test_columns_in_which_nothing_stands_are_left_out(
    found: SurveyResult, campaign: Campaign
) -> None:
    headings = [column.heading for column in flights_table(found).columns]
    assert headings == ["number", "flight", "verdict", "sensor-delay:q", "kinematics"]
    flights = [*more(campaign, 6), campaign.fly("G", LATE, 'tail = "T-1"\ndate = 2026-03-04')]
    grown = campaign.survey(*flights)
    shown = flights_table(grown)
    names = [
        "number",
        "flight",
        "this survey",
        "date",
        "tail",
        "verdict",
        "sensor-delay:q",
        "kinematics",
    ]
    assert [column.heading for column in shown.columns] == names
    told = ("G", "new", "2026-03-04", "T-1", "traced", "has it", "no fault found")
    assert shown.rows[0][1:] == told
    numbers = [row[0].value for row in shown.rows]  # type: ignore[union-attr]
    flown = grown.recurs[0].flights  # as the figure numbers them
    assert [flown[int(number) - 1] for number in numbers] == [row[1] for row in shown.rows]
    assert new_flight_phrases(grown) == ["traced, G: made up; it has the recurring sensor-delay:q"]


def test_unexplained_flights_are_told(found: SurveyResult) -> None:
    kept = {
        name: {**each, "verdict": "unexplained", "effects": []}
        for name, each in found.survey_files.diagnoses.items()
    }
    silent = replace(found, survey_files=replace(found.survey_files, diagnoses=kept), recurs=())
    assert verdict_of(silent) == (
        "NOTHING RECURS",
        "no effect acts in two or more of 6 flights beyond chance; 6 of them are unexplained",
    )
    assert survey_page(silent).tone == "fair"
    assert "6 unexplained" in survey_text(silent)
    calm = {
        name: {**each, "verdict": "consistent", "effects": []}
        for name, each in found.survey_files.diagnoses.items()
    }
    assert (
        survey_page(replace(silent, survey_files=replace(found.survey_files, diagnoses=calm))).tone
        == "good"
    )


def test_what_an_effect_is_told_from(found: SurveyResult) -> None:
    (each,) = found.recurs
    assert rivals_phrase(each).startswith("preferred to sensor-lag:q (likelihood ratio test: ")
    equal = replace(
        each, rivals={"vane-offset": 1.0, "sensor-lag:q": 20.0, "sensor-lag:alpha": 30.0}
    )
    assert rivals_phrase(equal) == (
        "equally likely: vane-offset; chosen since the derivatives agree better between flights, "
        "or by the flights' diagnoses; "
        "preferred to sensor-lag:q and sensor-lag:alpha (likelihood ratio test: 20 at "
        "least)"
    )
    assert rivals_phrase(replace(each, name="input-delay", rivals={})).startswith(
        "the same lag or delay in all recorded outputs"
    )
    faint, loud = (
        replace(found, recurs=(replace(each, recurrence=replace(each.recurrence, p_value=p)),))
        for p in (2e-5, 0.0)
    )
    chances = [effects_table(one).rows[0][-1] for one in (faint, loud)]
    assert [cell_text(cell) for cell in chances] == ["2e-05", "<1e-9"]


def test_forces_that_change_with_mass_ask_for_the_masses(found: SurveyResult) -> None:
    flights = tuple(found.survey_files.diagnoses)
    mass = found.conditions["mass"]
    rng = np.random.default_rng(1)
    told = [
        {
            name: (slope * mass[flight] + 1e-3 * rng.standard_normal(), 1e-3)
            for name, slope in (("CL_alpha", 1e-4), ("Cm_alpha", 1e-5))
        }
        for flight in flights
    ]
    one = replace(found, derivatives=tuple(over_flights(flights, told, found.conditions, {})))
    assert [each.name for each in one.derivatives if each.drifts] == ["CL_alpha", "Cm_alpha"]
    assert other_cause_phrases(one) == [
        "CL_alpha changes with mass, which no force coefficient does by itself: check the masses "
        "in the file of flights"
    ]
    assert other_cause_phrases(found) == []


def test_a_flight_that_could_not_be_fitted_is_told(
    campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    from scenarios.survey import growing

    plain = growing.fitted_sets

    def failing(flight: object, *given: object) -> object:
        if getattr(flight, "name", "") == "F02":
            raise ArithmeticError("no finite cost")
        return plain(flight, *given)  # type: ignore[arg-type]

    monkeypatch.setattr(growing, "fitted_sets", failing)
    found = campaign.survey(*more(campaign, 6))
    assert found.warnings == (
        "F02 could not be fitted with what recurs: ArithmeticError: no finite cost",
    )
    assert found.recurs[0].flights == ("F00", "F01", "F03", "F04", "F05")
    assert "F02 could not be fitted" in survey_text(found)
    content = json.loads((Path(campaign.out) / "survey.json").read_text())
    assert content["unfitted"] == {"F02": "ArithmeticError: no finite cost"}
