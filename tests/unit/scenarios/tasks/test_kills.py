"""Killed at moments drawn at random - the study, one of its processes, its disk - a study that is
resumed has the table of one that ran through.
"""

from __future__ import annotations

import dataclasses
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from scenarios.tasks import work
from scenarios.tasks.study import TaskRequest, run_study
from scenarios.tasks.work import RowTable
from sim.errors import FlightidError
from tests.unit.scenarios.tasks.process_tree import below
from tests.unit.scenarios.tasks.test_study import same
from tests.unit.scenarios.tasks.toy import Toy

ROOT = Path(__file__).parents[4]
MOMENTS = 20
# 50 blocks: about 1 s of two processes, a shard each tenth of a second
WORK, ASKED = Toy(pause=0.04), TaskRequest(200, 11, jobs=2)
SCRIPT = """
import sys
from pathlib import Path
from scenarios.tasks import work
from tests.unit.scenarios.tasks.test_kills import ASKED, WORK
from scenarios.tasks.study import run_study
import dataclasses
work.SHARD_INTERVAL = 0.1
work.MOST_SHARDS = 4
print("begun", flush=True)
folder = Path(sys.argv[1])
run_study(WORK, dataclasses.replace(ASKED, folder=folder, resume=(folder / "manifest.json").exists()))
"""  # noqa: E501

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def whole() -> RowTable:
    return run_study(dataclasses.replace(WORK, pause=0.0), dataclasses.replace(ASKED, jobs=1))


def _begun(folder: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, folder],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    with process.stdout as told:
        assert told.readline() == "begun\n"
    return process


def _resumed(folder: Path) -> RowTable:
    resume = (folder / "manifest.json").exists()
    return run_study(
        dataclasses.replace(WORK, pause=0.0),
        dataclasses.replace(ASKED, folder=folder, resume=resume),
    )


@pytest.mark.parametrize("moment", range(MOMENTS))
def test_the_study_is_killed(moment: int, tmp_path: Path, whole: RowTable) -> None:
    process = _begun(tmp_path / "kept")
    time.sleep(random.Random(moment).uniform(0.0, 2.0))
    workers = below(process.pid)
    process.kill()
    process.wait()
    until = time.monotonic() + 5.0
    while any(Path(f"/proc/{worker}").exists() for worker in workers) and time.monotonic() < until:
        time.sleep(0.02)
    assert not [worker for worker in workers if Path(f"/proc/{worker}").exists()], (
        "its processes outlive it"
    )
    assert same(_resumed(tmp_path / "kept"), whole)


@pytest.mark.parametrize("moment", range(MOMENTS))
def test_a_process_of_it_is_killed(moment: int, tmp_path: Path, whole: RowTable) -> None:
    process = _begun(tmp_path / "kept")
    draw = random.Random(100 + moment)
    time.sleep(draw.uniform(0.3, 1.6))
    # The server of processes, its tracker and the workers: whichever it is, the table must be whole
    # in the end.
    workers = below(process.pid)
    if workers:
        os.kill(draw.choice(workers), signal.SIGKILL)
    try:
        process.wait(timeout=20.0)
    except subprocess.TimeoutExpired:
        process.kill()
        pytest.fail("the study hangs")
    assert same(_resumed(tmp_path / "kept"), whole)


@pytest.mark.parametrize("round_", range(MOMENTS))
def test_processes_die_as_soon_as_they_begin(round_: int) -> None:
    """Before anyone has read that they took the block: none is lost, none waits for ever, none but
    theirs is given up.
    """
    table = run_study(
        dataclasses.replace(WORK, pause=0.0, killing=tuple(range(round_, 80, 12))),
        dataclasses.replace(ASKED, count=80, jobs=3),
    )
    hit = {number // WORK.block for number in range(round_, 80, 12)}
    assert table.whole and [not sound for sound in table.sound] == [
        number // WORK.block in hit for number in range(80)
    ]


@pytest.mark.parametrize("moment", range(MOMENTS))
def test_the_disk_is_full(
    moment: int, tmp_path: Path, whole: RowTable, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    size = random.Random(200 + moment).randrange(8, 120)
    if os.geteuid() or not shutil.which("mount"):
        pytest.skip("a small file system cannot be mounted here")
    if subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}k", "tmpfs", str(disk)], capture_output=True
    ).returncode:
        pytest.skip("a small file system cannot be mounted here")
    try:
        monkeypatch.setattr(work, "SHARD_INTERVAL", 0.05)
        try:
            run_study(
                dataclasses.replace(WORK, pause=0.01),
                dataclasses.replace(ASKED, folder=disk / "kept"),
            )
        except FlightidError as error:
            assert "No space left on device" in str(error) and "are kept" in str(error)
        subprocess.run(["mount", "-o", "remount,size=10m", str(disk)], check=True)
        assert same(_resumed(disk / "kept"), whole)
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=False)
