"""Surrogate flights on the command line, with a loop that answers at once; and the loop itself in a
campaign, slow.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from exam.__main__ import main
from exam.repeated import fly_all
from exam.surrogates import study
from exam.surrogates.campaign import shares, surrogate_flights
from exam.surrogates.schema import load_surrogate, surrogate_names
from ident.tracing.diagnosis import Verdict
from scenarios.files.records import read_record
from scenarios.files.vehicles import read_vehicle
from scenarios.tasks.study import Execution
from sim.record import Hold
from tests.diagnoses import tracing_of

SHORT = (
    "--set",
    "flight.duration=8",
    "--set",
    "flight.records=[2,2]",
    "--set",
    "flight.step=0.02",
    "--set",
    "flight.rates=[25]",
)


@pytest.fixture
def examined(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs an examination that ends well; what it printed."""

    def run(*words: str) -> str:
        assert main(words) == 0
        return capsys.readouterr().out

    return run


@pytest.mark.parametrize("name", surrogate_names())
def test_every_declaration_can_be_read(name: str) -> None:
    assert load_surrogate(name).name == name


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            ("surrogate", "surrogate-on"),
            "there is no surrogate flight 'surrogate-on'; did you mean 'surrogate-one'?",
        ),
        (("surrogates", "surrogate-one", "--runs", "1"), "--runs: 1 runs; give two or more"),
        (
            ("surrogates", "--runs", "2", "--set", "flight.rat=50"),
            "surrogate-one.toml, key flight.rat",
        ),
        (("surrogate-records", "--out", "flight.txt"), "flight.txt: .txt ending; name a .csv file"),
    ],
)
def test_what_cannot_be_is_one_line(
    words: tuple[str, ...], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    said = capsys.readouterr()
    assert said.out == "" and told in said.err and said.err.count("\n") == 1


def test_simulate_writes_all_records_of_the_flight(
    examined: Callable[..., str], tmp_path: Path
) -> None:
    said = examined(
        "surrogate-records",
        "surrogate-none",
        "--seed",
        "3",
        "--out",
        str(tmp_path / "flight.csv"),
        *SHORT,
    )
    assert "2 records of one flight: flight_1.csv to flight_2.csv" in said
    names = [
        "flight_1.csv",
        "flight_1.json",
        "flight_2.csv",
        "flight_2.json",
        "flight_vehicle.toml",
    ]
    assert sorted(path.name for path in tmp_path.iterdir()) == names
    assert set(read_vehicle(tmp_path / "flight_vehicle.toml", "rigid").constants) >= {
        "mass",
        "chord",
        "airspeed",
    }
    record = read_record(tmp_path / "flight_1.csv", ["elevator"], ["alpha", "q", "nz"])
    assert record.hold is Hold.LINEAR and len(record) == 201


@pytest.mark.long
def test_run_writes_a_study(
    examined: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[int] = []

    def answer(records: list[Path], vehicle: Path, model: str, progress: object) -> object:
        seen.append(len(records))
        assert vehicle.is_file() and all(path.is_file() for path in records)
        return tracing_of(Verdict.PARTIAL)

    monkeypatch.setattr(study, "diagnosed", answer)
    said = examined(
        "surrogate", "surrogate-none", "--no-figures", "--out", str(tmp_path / "s"), *SHORT
    )
    assert (
        seen == [2]
        and "nothing dominates" in said
        and "derivatives against the nominal ones" in said
    )
    content = json.loads((tmp_path / "s" / "comparison.json").read_text())
    truth = json.loads((tmp_path / "s" / "truth.json").read_text())
    assert content["outcome"] == "partial" and content["false_claims"] == [
        "sensor-lag:alpha",
        "sensor-scale:nz",
    ]
    assert set(content["parameters"]) == set(truth["parameters"])
    assert truth["effects"] == [] and set(truth["records"]) == {"record_1", "record_2"}
    assert {"record_1.csv", "record_2.csv", "vehicle.toml", "diagnosis.json"} <= {
        path.name for path in (tmp_path / "s").iterdir()
    }


@pytest.mark.long
def test_campaign_prints_shares_with_intervals(
    examined: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        study, "diagnosed", lambda records, vehicle, model, progress: tracing_of(Verdict.CONSISTENT)
    )
    said = examined(
        "surrogates",
        "surrogate-none",
        "--runs",
        "2",
        "--out",
        str(tmp_path / "c"),
        "--set",
        "estimate.draws=0",
        *SHORT,
    )
    assert "flights with a claim that nothing true stands behind" in said and "0 of 2" in said
    content = json.loads((tmp_path / "c" / "campaign.json").read_text())
    assert content["shares"]["false_claims"]["count"] == 0
    assert content["shares"]["false_claims"]["interval"][1] == pytest.approx(1.0 - 0.025**0.5)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["surrogate-none", "surrogate-one"])
def test_campaign_of_the_loop(name: str) -> None:
    """What is asked of the loop on data that look measured, as far as so many flights can
    contradict it: an interval that excludes it fails.
    """
    found = shares(fly_all(surrogate_flights(load_surrogate(name)), 12, 500, Execution(None)).found)
    assert found["false_claims"].interval[0] <= 0.05
    assert found["held_out_worse"].interval[0] <= 0.05
    assert found["named"].interval[1] >= 0.9
    low, high = found["within_two_sigma"].interval
    assert low <= 0.98 and high >= 0.90
