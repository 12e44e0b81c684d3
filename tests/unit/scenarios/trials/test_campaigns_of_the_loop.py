"""Campaigns of the tracing loop by the command line: every seed flown, counted and written."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from ident.tracing.diagnosis import Diagnosis, Verdict
from scenarios.commands.campaign import run_campaign
from scenarios.commands.trials import TRIALS
from scenarios.studies.catalogue import scenario_names
from scenarios.tasks.manner import Manner
from scenarios.trials import detection
from scenarios.trials.clean import CleanRun
from scenarios.trials.detection import WEAK, Alarm, Detection, Finding
from scenarios.trials.names import EVERY, LOOP
from scenarios.trials.papers import examination
from scenarios.trials.papers.paper import Mark, Named, Paper
from scenarios.trials.repeated import LoopFlights, fly_all
from sim.errors import DeclarationError
from tests.diagnoses import tracing_of


@pytest.fixture(autouse=True)
def loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """A loop that finds the same everywhere."""
    consistent, traced = (tracing_of(verdict).diagnosis for verdict in (Verdict.CONSISTENT, Verdict.TRACED))

    def told(declared, true, setting, rng) -> tuple[Diagnosis, float]:
        return (consistent if declared is true else traced), 1.0

    monkeypatch.setattr(detection, "traced", told)
    monkeypatch.setattr(detection, "size_of", lambda model, effect, gain, setting: WEAK[effect][1])
    monkeypatch.setattr(examination, "diagnose_files", lambda request: tracing_of(Verdict.CONSISTENT))


PAPER = Paper(4, "light", ("a", "b"), frozenset({"z", "y", "x"}), False, ("alpha",), 50.0)
SAMPLES: dict[Any, Any] = {
    Alarm: Alarm(1, "light", "traced", ("a",), 1.5, "alpha and q only"),
    Detection: Detection(2, "input-delay", 25.0, 0.1, Finding.AMBIGUOUS, (), 0.25),
    CleanRun: CleanRun(3, "loes", "consistent", (), ("b",), {"M_q": 0.1 + 0.2}, {"M_q": 1.0 / 3.0}, 2.0),
    Mark: Mark(PAPER, "traced", ("a",), True, False, {"M_q": math.inf}, 0.5, 1.0, ((Named("a", True),),), (), {"a": {"delay": 0.1}}, ""),
}


def test_the_command_knows_the_campaigns_and_they_take_no_scenarios_name() -> None:
    assert set(LOOP) == {*TRIALS, EVERY} and not set(TRIALS) & set(scenario_names())


@pytest.mark.parametrize(
    ("name", "runs", "rows"),
    [
        ("false-alarms", 4, {"three channels": "2", "alpha and q only": "1", "all": "4"}),
        ("weak-effects", 9, {"input-deadband": "1", "all": "9"}),
    ],
)
def test_flights_are_counted_in_groups_and_together(
    name: str, runs: int, rows: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_campaign(name, runs, 1, Manner(1, tmp_path / "out"), [])
    said = capsys.readouterr().out
    assert f"{name}: {runs} flights, seeds from 1" in said and "written to" in said
    content = json.loads((tmp_path / "out" / "campaign.json").read_text())
    first = "setting" if name == "false-alarms" else "effect"
    assert rows.items() <= {row[first]: row["runs"] for row in content["table"]}.items()
    assert (content["scenario"], content["seed"], content["runs"]) == (name, 1, runs)
    together = next(row for row in content["table"] if row[first] == "all")
    if name == "false-alarms":
        assert (together["false claims"], together["not consistent"]) == ("0", "0")
    else:  # the loop here says dead band to everything
        assert (together["detected"], together["named right"], together["named wrong"]) == ("9", "1", "8")


@pytest.mark.slow
def test_papers_are_drawn_flown_and_marked(capsys: pytest.CaptureFixture[str]) -> None:
    run_campaign("random-papers", 3, 5, Manner(), [])
    said = capsys.readouterr().out
    assert "seeds from 5" in said and "wrong claims, upper 95 %" in said


def test_nothing_of_them_can_be_set() -> None:
    with pytest.raises(DeclarationError, match="nothing of random-papers can be changed; leave it out"):
        run_campaign("random-papers", 3, None, Manner(), ["flight.rate=50"])


@pytest.mark.parametrize("name", [*TRIALS])
def test_what_is_kept_of_a_flight_is_what_was_found(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    kind = TRIALS[name]
    made: list[Any] = []

    def fly(number: int, seed: int) -> Any:
        made.append(SAMPLES[kind.kind])
        return made[-1]

    flown = fly_all(LoopFlights(name, fly, kind.kind, {}), 2, 3, Manner())
    assert flown.found == made and flown.whole and flown.words == "seeds from 3"


def test_a_flight_that_fails_is_told_and_ends_nothing() -> None:
    def fly(number: int, seed: int) -> Alarm:
        if number == 1:
            raise ValueError("no such air")
        return SAMPLES[Alarm]

    flown = fly_all(LoopFlights("x", fly, Alarm, {}), 3, 3, Manner())
    assert len(flown.found) == 2 and flown.ended == 3
    assert flown.words == "seeds from 3; 1 failed and is left out (1 ValueError: no such air)"
    assert flown.content == {"seed": 3, "runs": 3, "failures": {"ValueError: no such air": 1}}
