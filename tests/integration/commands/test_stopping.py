"""Ctrl-C as a terminal sends it, to all processes of a command: one line says what is kept, the
exit code is 130, nothing is half written.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

import flightid as fid
from scenarios.cli.options import output_options
from scenarios.files.writing import study_folder
from scenarios.trials import planted_study as study
from tests.integration.command_line import CommandLine
from tests.integration.commands.test_cli_run import small

ROOT = Path(__file__).parents[3]
PATIENCE = 25.0  # s, on the busiest machine; the flights below would take a minute

# Flights of which the first two end at once and the others take a minute; the file says that one of
# these has begun.
CAMPAIGN = """
import time, pathlib, sys
from exam.__main__ import main
from exam.hidden_effects import campaign
from scenarios.trials.planted_study import Grade

flown = []

def judged(scenario, seed):
    flown.append(seed)
    if len(flown) > 2:
        time.sleep(1.0)
        pathlib.Path("begun").write_text("")
        time.sleep(60)
    return campaign.TraceJudged(seed, "traced", Grade.RIGHT, ("vane-offset",), (("vane-offset", True),), ("vane-offset",), (), ())

campaign.judge_trace = judged
sys.exit(main(sys.argv[1:]))
"""  # noqa: E501


# The same of runs of an estimator, one in a block.
ESTIMATOR = """
import time, pathlib, sys
from scenarios.cli import main
from scenarios.studies import campaign

plain, begun = campaign.EstimatorRuns.run, []

def run(self, tasks):
    begun.append(tasks)
    if len(begun) > 2:
        time.sleep(1.0)
        pathlib.Path("begun").write_text("")
        time.sleep(60)
    return plain(self, tasks)

campaign.EstimatorRuns.run, campaign.EstimatorRuns.block = run, 1
main(sys.argv[1:])
"""


def stopped(code: str, folder: Path, *arguments: str) -> tuple[int, str, str]:
    """Run a command in a session of its own, send Ctrl-C to all of it when it has ``begun``; exit
    code and the two streams.
    """
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    command = [sys.executable, "-c", code, *arguments]
    with subprocess.Popen(
        command, env=environment, cwd=folder, text=True, start_new_session=True, **pipes
    ) as running:  # type: ignore[call-overload]
        begin = time.monotonic()
        while not (folder / "begun").exists():
            assert running.poll() is None and time.monotonic() - begin < 60.0, running.communicate()
            time.sleep(0.05)
        os.killpg(running.pid, signal.SIGINT)
        try:
            out, err = running.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            os.killpg(running.pid, signal.SIGKILL)
            raise
    with pytest.raises(ProcessLookupError):
        os.killpg(running.pid, 0)  # no worker is left
    return running.returncode, out, err


@pytest.mark.long
@pytest.mark.skipif(not hasattr(os, "killpg"), reason="signals of a terminal")
def test_a_campaign_keeps_the_table_of_the_flights_that_had_ended(tmp_path: Path) -> None:
    code, out, err = stopped(
        CAMPAIGN,
        tmp_path,
        "hidden-effects",
        "trace-vane",
        "--runs",
        "9",
        "--seed",
        "1",
        "--jobs",
        "1",
        "--out",
        "kept",
    )
    kept = (
        "the table of the 2 of 9 flights that had ended is in kept; the same command with --resume "
        "goes on"
    )
    assert (code, err) == (130, f"python -m exam hidden-effects: stopped; {kept}\n")
    assert "stopped after 2 of 9, seeds from 1" in out
    content = json.loads((tmp_path / "kept" / "campaign.json").read_text())
    assert (content["runs"], content["asked"], content["seed"]) == (2, 9, 1)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["begun", "kept"]


@pytest.mark.long
@pytest.mark.skipif(not hasattr(os, "killpg"), reason="signals of a terminal")
def test_a_campaign_of_an_estimator_keeps_the_runs_that_had_ended(tmp_path: Path) -> None:
    words = ("campaign", "ballistic", "--runs", "9", "--seed", "1", "--jobs", "1", "--out", "kept")
    code, _, err = stopped(ESTIMATOR, tmp_path, *words)
    kept = (
        "the table of the 2 of 9 runs that had ended is in kept; the same command with --resume "
        "goes on"
    )
    assert (code, err) == (130, f"flightid: stopped; {kept}\n")
    content = json.loads((tmp_path / "kept" / "campaign.json").read_text())
    assert (content["runs"], content["asked"], content["seed"]) == (2, 9, 1)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["begun", "kept"]


def test_finished_studies_stay_and_the_one_on_its_way_leaves_nothing(
    flightid: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "fly_trace", lambda *_: signal.raise_signal(signal.SIGINT))
    call = flightid(
        "run",
        small(tmp_path / "short.toml"),
        "trace-vane",
        "--out",
        tmp_path / "kept",
        "--no-figures",
    )
    assert (call.code, call.err) == (
        130,
        f"flightid: stopped; 1 of 2 studies are finished: {tmp_path}/kept/short\n",
    )
    assert f"written to {tmp_path}/kept/short" in call.out
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["short"]
    assert (tmp_path / "kept" / "short" / "comparison.json").is_file()


def test_ctrl_c_while_files_are_put_in_place_waits_until_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    move = os.replace

    def with_signal(source: Path, target: Path) -> None:
        signal.raise_signal(signal.SIGINT)
        move(source, target)

    with (
        pytest.raises(KeyboardInterrupt, match=r"the study in .*study is whole"),
        study_folder(tmp_path / "study", "study.json") as scratch,
    ):
        (scratch / "table.csv").write_text("1\n")
        (scratch / "study.json").write_text('{"schema": "flightid/study/1"}')
        monkeypatch.setattr(os, "replace", with_signal)
    assert json.loads((tmp_path / "study" / "study.json").read_text())["files"] == [
        "study.json",
        "table.csv",
    ]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["study"]


@pytest.mark.parametrize("kept", [False, True])
def test_what_is_stopped_names_no_folder_that_is_gone(tmp_path: Path, kept: bool) -> None:
    with (
        pytest.raises(KeyboardInterrupt) as stopped,
        output_options(
            tmp_path / "study" if kept else None,
            (),
            quiet=True,
            as_json=True,
            documents=["campaign.json"],
        ) as told,
    ):
        raise KeyboardInterrupt(f"the table is in {told.out}")
    assert str(stopped.value) == (f"the table is in {tmp_path}/study" if kept else "")


def test_a_campaign_in_python_is_whole_or_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "scenarios.studies.campaign.fly_campaign",
        lambda *_: SimpleNamespace(seeds=range(1, 4), asked=9),
    )
    with pytest.raises(KeyboardInterrupt, match="3 of 9 runs"):
        fid.campaign("rigid", 9)
