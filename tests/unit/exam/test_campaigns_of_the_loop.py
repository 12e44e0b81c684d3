"""Campaigns of the tracing loop with one table: every seed flown, counted and written."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from exam import detection
from exam.__main__ import main
from exam.clean import CleanRun
from exam.detection import WEAK, Alarm, Detection, Finding
from exam.random_cases.case import Case, CaseScore, Named
from exam.repeated import LoopFlights, fly_all
from ident.tracing.diagnosis import Diagnosis, Verdict
from scenarios.tasks.study import Execution
from tests.diagnoses import tracing_of


@pytest.fixture(autouse=True)
def loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """A loop that finds the same everywhere."""
    consistent, traced = (
        tracing_of(verdict).diagnosis for verdict in (Verdict.CONSISTENT, Verdict.TRACED)
    )

    def told(declared, true, setting, rng) -> tuple[Diagnosis, float]:
        return (consistent if declared is true else traced), 1.0

    monkeypatch.setattr(detection, "traced", told)
    monkeypatch.setattr(detection, "size_of", lambda model, effect, gain, setting: WEAK[effect][1])


CASE = Case(4, "light", ("a", "b"), frozenset({"z", "y", "x"}), False, ("alpha",), 50.0)
SAMPLES: dict[Any, Any] = {
    Alarm: Alarm(1, "light", "traced", ("a",), 1.5, "alpha and q only"),
    Detection: Detection(2, "input-delay", 25.0, 0.1, Finding.AMBIGUOUS, (), 0.25),
    CleanRun: CleanRun(
        3, "loes", "consistent", (), ("b",), {"M_q": 0.1 + 0.2}, {"M_q": 1.0 / 3.0}, 2.0
    ),
    CaseScore: CaseScore(
        CASE,
        "traced",
        ("a",),
        True,
        False,
        {"M_q": math.inf},
        0.5,
        1.0,
        ((Named("a", True),),),
        (),
        {"a": {"delay": 0.1}},
        "",
    ),
}


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
    words = (
        name,
        "--runs",
        str(runs),
        "--seed",
        "1",
        "--jobs",
        "1",
        "--no-figures",
        "--out",
        str(tmp_path / "out"),
    )
    assert main(words) == 0
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
        assert (together["detected"], together["named right"], together["named wrong"]) == (
            "9",
            "1",
            "8",
        )


@pytest.mark.parametrize("found", [*SAMPLES])
def test_what_is_kept_of_a_flight_is_what_was_found(found: Any) -> None:
    made: list[Any] = []

    def fly(number: int, seed: int) -> Any:
        made.append(SAMPLES[found])
        return made[-1]

    flown = fly_all(LoopFlights("x", fly, found, {}), 2, 3, Execution())
    assert flown.found == made and flown.whole and flown.words == "seeds from 3"


def test_a_flight_that_fails_is_told_and_ends_nothing() -> None:
    def fly(number: int, seed: int) -> Alarm:
        if number == 1:
            raise ValueError("no such air")
        return SAMPLES[Alarm]

    flown = fly_all(LoopFlights("x", fly, Alarm, {}), 3, 3, Execution())
    assert len(flown.found) == 2 and flown.ended == 3
    assert flown.words == "seeds from 3; 1 failed and is left out (1 ValueError: no such air)"
    assert flown.content == {"seed": 3, "runs": 3, "failures": {"ValueError: no such air": 1}}
