"""Campaigns of the tracing loop in Python: tables, statistics, files, and one of their flights again."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import flightid as fid
from scenarios.trials.every_effect import work
from scenarios.trials.every_effect.kinds import Instance
from scenarios.trials.planted.campaign import judged_of, marked_of, named_scenario
from scenarios.trials.planted.study import run_trace
from tests.integration.command_line import CommandLine

COARSE = ("flight.step=0.02",)  # s: flown ten times as fast
TIMES = ("report.html", "report.json")  # when they were written


@pytest.fixture(scope="module")
def falls() -> fid.CampaignOfTheLoop:
    """Two flights of a body through air of another scale height, diagnosed in tenths of a second."""
    found = fid.campaign("trace-density", 2, set=COARSE, jobs=1)
    assert isinstance(found, fid.CampaignOfTheLoop)
    return found


def test_a_flight_again_by_the_seed_of_its_row(falls: fid.CampaignOfTheLoop) -> None:
    row = falls.to_dataframe().iloc[1]
    study = run_trace(named_scenario("trace-density", COARSE), int(row["seed"]))  # what flightid run trace-density --seed does
    marked = marked_of(study, judged_of(study))
    assert (marked.verdict, marked.held_out_before, marked.held_out_after) == (row["verdict"], row["held_out_before"], row["held_out_after"])
    assert dict(marked.errors) == json.loads(row["errors"]) != {}


def test_tables_of_a_campaign_say_what_its_rows_do(falls: fid.CampaignOfTheLoop) -> None:
    frame, statistics = falls.to_dataframe(), falls.statistics()
    assert list(frame["hidden"]) == ["density-scale-height"] * 2 and list(statistics.index) == ["density-scale-height"]
    row = statistics.loc["density-scale-height"]
    assert row["right"] == frame["right"].sum() and row["flights"] == 2 and row["share"] == frame["right"].mean()
    assert row["low"] == pytest.approx(0.025**0.5) if row["right"] == 2 else row["low"] >= 0.0
    assert falls.confusion().to_numpy().sum() == 2
    named = frame["probability"].dropna()
    assert falls.reliability()["names"].sum() >= (named > 0.05).sum()
    assert falls.brier is not None and falls.brier.score == pytest.approx(np.mean((named - frame.loc[named.index, "right"]) ** 2))
    errors = [abs(error) for text in frame["errors"] for error in json.loads(text).values()]
    assert falls.coverage().iloc[-1]["within_2"] == pytest.approx(np.mean([error < 2.0 for error in errors]))
    assert np.isnan(falls.false_names[0]) and falls.false_names[1:] == (0.0, 1.0)
    assert "answered right" in repr(falls) and "<table>" in falls._repr_html_()


@pytest.mark.slow
def test_python_prints_and_writes_what_the_command_does(falls: fid.CampaignOfTheLoop, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    printed = CommandLine(capsys).done(
        "campaign", "trace-density", "--runs", 2, "--jobs", 1, "--set", *COARSE, "--no-figures", "--out", tmp_path / "command"
    )
    assert printed.startswith(falls.summary())
    falls.save(tmp_path / "python", figures=False)
    written = {path.name for path in (tmp_path / "python").iterdir()}
    assert written == {path.name for path in (tmp_path / "command").iterdir()} - {"runs"}
    for name in written - {*TIMES}:
        assert (tmp_path / "python" / name).read_bytes() == (tmp_path / "command" / name).read_bytes(), name
    assert "Answers by what was hidden" in falls.report(tmp_path / "page.html").read_text()


@pytest.mark.slow
def test_every_effect_is_flown_from_python(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(work, "chosen", lambda asked: {name: (Instance("ballistic", name),) for name in asked})
    found = fid.campaign("every-effect", 2, effects=["density-scale-height"], jobs=1, out=tmp_path)
    assert isinstance(found, fid.CampaignOfTheLoop)
    frame = found.to_dataframe()
    assert list(frame["number"]) == [0, 1] and (frame["size_sigmas"] > 4.0).all() and (tmp_path / "runs" / "manifest.json").is_file()


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: fid.campaign("every-effect", 2, effects=["vanes"]), "--effects: there is no effect 'vanes'"),
        (lambda: fid.campaign("trace-vane", 2, effects=["vane-offset"]), "effects: these are of every-effect alone; leave them out"),
        (lambda: fid.campaign("trace-vane", 2, method="ekf"), "method: this campaign has no methods to choose from"),
        (lambda: fid.campaign("every-effect", 2, set=["flight.rate=20"]), "nothing of every-effect can be changed"),
        (lambda: fid.campaign("random-papers", 2), "random-papers is a campaign of the tracing loop, which is not run from Python"),
    ],
)
def test_what_cannot_be_is_refused(call, told: str) -> None:
    with pytest.raises(fid.InputError) as raised:
        call()
    assert told in str(raised.value)
