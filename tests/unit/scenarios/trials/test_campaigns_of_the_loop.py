"""Campaigns of the tracing loop by the command line: every seed flown, counted and written."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from ident.tracing.diagnosis import Diagnosis, Verdict
from scenarios.api.running import LOOP
from scenarios.commands.campaign import run_campaign
from scenarios.commands.trials import TRIALS
from scenarios.studies.catalogue import scenario_names
from scenarios.trials import detection
from scenarios.trials.detection import WEAK
from scenarios.trials.many import of_each_seed
from scenarios.trials.papers import examination
from sim.errors import DeclarationError
from tests.diagnoses import tracing_of


@pytest.fixture(autouse=True)
def loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """One process, and a loop that finds the same everywhere."""
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    consistent, traced = (tracing_of(verdict).diagnosis for verdict in (Verdict.CONSISTENT, Verdict.TRACED))

    def told(declared, true, setting, rng) -> tuple[Diagnosis, float]:
        return (consistent if declared is true else traced), 1.0

    monkeypatch.setattr(detection, "traced", told)
    monkeypatch.setattr(detection, "size_of", lambda model, effect, gain, setting: WEAK[effect][1])
    monkeypatch.setattr(examination, "diagnose_files", lambda request: tracing_of(Verdict.CONSISTENT))


def test_the_command_knows_the_campaigns_and_they_take_no_scenarios_name() -> None:
    assert set(LOOP) == set(TRIALS) and not set(TRIALS) & set(scenario_names())


@pytest.mark.parametrize(
    ("name", "runs", "rows"),
    [
        ("false-alarms", 4, {"three channels": "1", "alpha and q only": "2", "all": "4"}),
        ("weak-effects", 9, {"input-deadband": "1", "all": "9"}),
    ],
)
def test_flights_are_counted_in_groups_and_together(
    name: str, runs: int, rows: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_campaign(name, runs, 1, tmp_path / "out", [])
    said = capsys.readouterr().out
    assert f"{name}: {runs} flights, seeds 1 to {runs}" in said and "written to" in said
    content = json.loads((tmp_path / "out" / "campaign.json").read_text())
    first = "setting" if name == "false-alarms" else "effect"
    assert rows.items() <= {row[first]: row["runs"] for row in content["table"]}.items()
    assert (content["scenario"], content["first_seed"], content["runs"]) == (name, 1, runs)
    together = next(row for row in content["table"] if row[first] == "all")
    if name == "false-alarms":
        assert (together["false claims"], together["not consistent"]) == ("0", "0")
    else:  # the loop here says dead band to everything
        assert (together["detected"], together["named right"], together["named wrong"]) == ("9", "1", "8")


@pytest.mark.slow
def test_papers_are_drawn_flown_and_marked(capsys: pytest.CaptureFixture[str]) -> None:
    run_campaign("random-papers", 3, 5, None, [])
    said = capsys.readouterr().out
    assert "seeds 5 to 7" in said and "wrong claims, upper 95 %" in said


def test_nothing_of_them_can_be_set() -> None:
    with pytest.raises(DeclarationError, match="nothing of random-papers can be changed; leave it out"):
        run_campaign("random-papers", 3, None, None, ["flight.rate=50"])


def _negative(seed: int) -> int:
    return -seed


def test_seeds_come_in_their_order_however_many_work() -> None:
    told: list[float] = []
    assert of_each_seed(_negative, range(3, 9), lambda stage, share: told.append(share), workers=2) == tuple(range(-3, -9, -1))
    assert of_each_seed(_negative, range(3, 9)) == tuple(range(-3, -9, -1))
    assert told == sorted(told) and told[-1] == 1.0
