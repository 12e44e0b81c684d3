"""What a study tells beside its numbers: choices read from the file, and methods that see a flight
of their own.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from scenarios.studies.campaign import fly_campaign
from scenarios.studies.catalogue import load_document, load_scenario
from scenarios.studies.comparison import (
    choice_lines,
    distance_text,
    misprints,
    other_flight,
    other_flight_line,
    vehicle_line,
    vehicle_origins,
)
from scenarios.studies.declaration import Choice, choices_of, seen_by, value_text
from scenarios.studies.reading import scenario_of
from scenarios.studies.study import run_scenario
from sim.errors import DeclarationError
from sim.vehicles.library import read_parameter_set

DOCUMENT = {
    "flight": {"rate": "100 Hz", "maneuvers": [{"unit": 0.5}], "noise": True},
    "estimate": {"start": {"CL_q": {"value": -11.0, "std": 6}}},
}


def short(**flight: Any) -> dict[str, Any]:
    """The document of `rigid`, 3 s at 20 Hz, with a method that sees a flight of its own."""
    document = load_document("rigid", ["flight.duration=3", "flight.rate=20", "flight.step=0.01"])[
        0
    ]
    return {
        **document,
        "methods": [{"name": "other", "flight": flight}, {"name": "same", "terms": 2}],
    }


def test_choices_have_the_values_that_the_file_has() -> None:
    own = {
        "flight": {"rate": "not  printed", "maneuvers": {"1": {"unit": "ours"}}, "noise": "so"},
        "estimate": {"start": "guessed"},
    }
    assert choices_of(own, DOCUMENT, "key own") == (
        Choice("flight.rate", "100 Hz", "not printed"),
        Choice("flight.maneuvers.1.unit", "0.5", "ours"),
        Choice("flight.noise", "yes", "so"),
        Choice("estimate.start", "CL_q -11 +- 6", "guessed"),
    )
    assert choice_lines([Choice("a", "1", "why")]) == ["a = 1: why"]


@pytest.mark.parametrize(
    "own",
    [
        {"flight": {"rat": "x"}},
        {"flight": {"maneuvers": {"2": {"unit": "x"}}}},
        {"flight": {"rate": " "}},
        {"flight": 3},
    ],
)
def test_a_choice_of_nothing_and_one_without_a_reason_are_refused(own: dict[str, Any]) -> None:
    with pytest.raises(DeclarationError, match=r"no such value|no reason"):
        choices_of(own, DOCUMENT, "key own")


def test_long_lists_are_counted() -> None:
    assert value_text([1, 2.5]) == "1, 2.5"
    assert value_text(list(range(7))) == "(7 entries)" and value_text([{"a": 1}]) == "(1 entries)"


def test_a_change_takes_along_what_was_said_of_values_that_it_removes() -> None:
    """A maneuver without a unit of its own has no choice of the unit; what is there still is told
    with its new value.
    """
    scenario = load_scenario(
        "rigid",
        [
            'flight.maneuvers=[{input="elevator", kind="multisine", duration="8 s"}]',
            "flight.rate=50 Hz",
        ],
    )
    told = {choice.key: choice.value for choice in scenario.choices}
    assert "flight.maneuvers.1.unit" not in told and told["flight.rate"] == "50 Hz"
    assert "flight.maneuvers.1.unit" in {choice.key for choice in load_scenario("rigid").choices}
    before, after = (
        load_scenario("rigid-euler", changes)
        for changes in ([], ['methods.1.flight={duration="7 s"}'])
    )
    assert [each.key for each in before.estimations[1].choices] == [
        "flight.rate"
    ] and after.estimations[1].choices == ()
    with pytest.raises(DeclarationError, match=r"key own.flight.unit: the file has no such value"):
        load_scenario("rigid", ['own.flight.unit="why"'])


def test_a_method_sees_its_own_flight_and_the_others_the_scenarios() -> None:
    scenario = scenario_of(
        short(rate="40 Hz", noise_std={"alpha": 0.001, "q": 0.002}), "short", "short.toml"
    )
    main, other, same = scenario.estimations
    assert (
        other_flight(scenario, same) == {} == other_flight(scenario, main)
        and other_flight_line(scenario, same) == ""
    )
    assert other_flight(scenario, other) == {
        "rate": 40.0,
        "noise_std": {"alpha": 0.001, "q": 0.002},
    }, "noise of one kind replaces both"
    assert "rate 40 Hz" in other_flight_line(scenario, other) and distance_text(
        scenario.distance
    ) in other_flight_line(scenario, other)
    study = run_scenario(scenario)
    assert [len(method.result.record) for method in study.methods] == [61, 121, 61]
    assert study.methods[2].result.record is study.record
    alone = run_scenario(seen_by(scenario, other)).methods[0]
    assert np.array_equal(alone.result.estimate.values, study.methods[1].result.estimate.values), (
        "as if the scenario were flown so"
    )


def test_a_campaign_repeats_the_method_that_is_named_on_its_own_flight() -> None:
    scenario = scenario_of(short(integration="euler", step="0.05 s"), "short", "short.toml")
    runs = fly_campaign(scenario, 2, 5, "other")
    method = run_scenario(scenario, int(runs.seeds[0])).methods[1]
    assert runs.estimation.name == "other" and runs.scenario.flight.integration == "euler"
    assert runs.values[:, 0] == pytest.approx(method.result.estimate.values, rel=1e-9)


@pytest.mark.parametrize("name", ["rigid", "flexible-ac2-first-mode", "ballistic", "lateral"])
def test_all_numbers_of_a_vehicle_that_no_source_prints_are_told_or_counted(name: str) -> None:
    flight = load_scenario(name).flight
    data = read_parameter_set(flight.vehicle)
    told = vehicle_origins(flight)
    counted = sum(
        int(entry.split(" of mode")[0]) if " of mode" in entry else 1
        for names in told.values()
        for entry in names
    )
    assert counted == sum(number.origin.value in ("own", "rem", "conv") for number in data.numbers)
    assert all(words in vehicle_line(flight) for words in told)
    assert misprints(flight) == ({"Cm_eta1": ("-0.032", "0.0025")} if flight.modes else {})
