"""The command writes both files or none, and a process that fails is named."""

from __future__ import annotations

import json
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.comparison import command
from benchmarks.comparison.command import main
from benchmarks.comparison.whole_process import ONE_THREAD, ProcessFailed, measured
from benchmarks.jobs import flight


@pytest.fixture(autouse=True)
def own_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the command sets for its own process is undone."""
    for name, value in ONE_THREAD.items():
        monkeypatch.setenv(name, value)


@pytest.mark.long
def test_one_job_is_written_as_page_and_document(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(
        "benchmarks.jobs.catalogue.JOBS", (replace(flight.JOB, peers=flight.JOB.peers[:1]),)
    )
    assert main(["--quick", "--jobs", "truth", "--out", str(tmp_path)]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "performance.json",
        "performance.md",
        "performance.png",
    ]
    found = json.loads((tmp_path / "performance.json").read_text(encoding="utf-8"))
    ours, *peers = found["jobs"][0]["contenders"]
    assert (
        ours["warm_ratio"]["median"] == 1.0
        and ours["cold_s"]["median"] > ours["warm_s"]["median"] > 0.0
    )
    assert peers and all(
        each["absent"] or (each["same_answer"] and each["peak_memory_mib"] > 10.0) for each in peers
    )
    assert "## Simulation of a flight" in (tmp_path / "performance.md").read_text(encoding="utf-8")
    assert "truth: warm" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--jobs", "nothing"], "there is no job 'nothing'"),
        (["--out", "nowhere"], "there is no folder"),
    ],
)
def test_what_is_not_there_is_told(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2 and said in capsys.readouterr().err


def test_stopped_it_leaves_what_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    (tmp_path / "performance.md").write_text("before", encoding="utf-8")
    monkeypatch.setattr("benchmarks.comparison.compare.compare", stopped)
    assert main(["--quick", "--jobs", "ekf", "--out", str(tmp_path)]) == command.STOPPED
    assert [path.name for path in tmp_path.iterdir()] == ["performance.md"]
    assert (tmp_path / "performance.md").read_text(encoding="utf-8") == "before"
    assert "nothing was written" in capsys.readouterr().err


def test_a_process_is_measured_with_its_memory(tmp_path: Path) -> None:
    little = measured([sys.executable, "-c", "pass"], tmp_path)
    much = measured(
        [sys.executable, "-c", "import time; x = bytearray(200 << 20); time.sleep(0.2)"], tmp_path
    )
    assert much.memory - little.memory == pytest.approx(200.0, abs=5.0)
    assert much.seconds > 0.2


def test_a_process_is_ended_with_its_children_where_this_one_is_stopped(tmp_path: Path) -> None:
    def stop(number: int, frame: object) -> None:
        if (tmp_path / "number").is_file():  # the process runs
            raise KeyboardInterrupt

    script = (
        "import os, time; open('.number', 'w').write(str(os.getpid())); os.rename('.number', "
        "'number'); time.sleep(60)"
    )
    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, 0.1, 0.1)
    try:
        with pytest.raises(KeyboardInterrupt):
            measured([sys.executable, "-c", script], tmp_path)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    number = int((tmp_path / "number").read_text(encoding="utf-8"))
    for _ in range(100):
        if (
            not Path(f"/proc/{number}/cmdline").exists()
            or not Path(f"/proc/{number}/cmdline").read_bytes()
        ):
            return
        time.sleep(0.05)
    raise AssertionError(f"process {number} is still there")


def test_a_process_that_fails_is_named(tmp_path: Path) -> None:
    with pytest.raises(ProcessFailed, match="no such thing"):
        measured([sys.executable, "-c", "raise SystemExit('no such thing')"], tmp_path)
