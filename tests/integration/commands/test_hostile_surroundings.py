"""Commands where the system refuses something: a full disk, few open files, signals; paths and
files that have no end.
"""

from __future__ import annotations

import gzip
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from tests.integration.command_line import VEHICLE, CommandLine, contents

ROOT = Path(__file__).parents[3]
PATIENCE = 60.0  # s, on the busiest machine


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flightid: CommandLine) -> Path:
    """A folder with a short record and a vehicle file, the current one."""
    monkeypatch.chdir(tmp_path)
    short = ("--set", "flight.duration=6", "--set", "flight.rate=25")
    flightid.done("simulate", "rigid", "--out", "flight.csv", *short)
    (tmp_path / "vehicle.toml").write_text(VEHICLE)
    return tmp_path


IDENTIFY = ("identify", "flight.csv", "--model", "rigid", "--vehicle", "vehicle.toml")


def run(
    folder: Path,
    *arguments: str,
    stdout: int = subprocess.DEVNULL,
    before: Callable[[], None] | None = None,
) -> tuple[int, str]:
    """A command in a process of its own: its exit code and what it says on stderr."""
    ended = subprocess.run(
        [sys.executable, "-m", "scenarios", *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdin=subprocess.DEVNULL,
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=before,
        timeout=PATIENCE,
        check=False,
    )
    return ended.returncode, ended.stderr


def refused(ended: tuple[int, str], *parts: str) -> None:
    code, said = ended
    assert code == 2, said
    assert said.startswith("flightid: ") and said.count("\n") == 1 and "; " in said
    assert all(part in said for part in parts), said


def limited(kind: int, most: int) -> Callable[[], None]:
    return lambda: resource.setrlimit(kind, (most, most))


@pytest.fixture
def full() -> Iterator[int]:
    if not Path("/dev/full").exists():
        pytest.skip("the system has no /dev/full")
    handle = os.open("/dev/full", os.O_WRONLY)
    yield handle
    os.close(handle)


@pytest.mark.long
@pytest.mark.parametrize("call", [("--help",), ("vehicles",), IDENTIFY])
def test_a_full_standard_output_is_one_line(place: Path, full: int, call: tuple[str, ...]) -> None:
    refused(run(place, *call, stdout=full), "the output: No space left on device", "make room")


@pytest.mark.long
@pytest.mark.parametrize(
    ("call", "named"),
    [
        ((*IDENTIFY, "--out", "found", "--figures", "none"), "found: "),
        ((*IDENTIFY, "--state-space", "model.json"), "model.json: "),
        (("simulate", "rigid", "--out", "new.csv"), "new.csv: "),
        (("simulate", "trace-vane", "--out", "new.csv"), "new.csv: "),
    ],
)
def test_a_full_disk_leaves_nothing_half_written(
    place: Path, call: tuple[str, ...], named: str
) -> None:
    """A limit of the size of files fails within a write, as a full disk does."""
    before = contents(place)
    refused(
        run(place, *call, before=limited(resource.RLIMIT_FSIZE, 512)), named, "cannot be written"
    )
    assert contents(place) == before


@pytest.mark.long
def test_a_file_system_without_room_leaves_nothing_half_written(place: Path) -> None:
    disk = place / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=16k", "tmpfs", str(disk)]
    try:
        mounted = subprocess.run(mount, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        mounted = False
    if not mounted:
        pytest.skip("no file system can be mounted here")
    try:
        refused(
            run(place, *IDENTIFY, "--out", "disk/found", "--figures", "none"),
            "disk/found: ",
            "No space left",
            "make room",
        )
        refused(
            run(place, "simulate", "rigid", "--out", "disk/new.csv"),
            "disk/new.csv: ",
            "No space left",
        )
        assert contents(disk) == {} and list(disk.iterdir()) == []
    finally:
        subprocess.run(["umount", str(disk)], check=True)


@pytest.mark.long
@pytest.mark.parametrize("handles", [6, 9, 12])
def test_too_few_open_files_are_one_line_and_leave_nothing(place: Path, handles: int) -> None:
    before = contents(place)
    call = ("run", "rigid", "--set", "flight.duration=6", "--out", "study")
    refused(
        run(place, *call, before=limited(resource.RLIMIT_NOFILE, handles)),
        "Too many open files",
        "ulimit -n",
    )
    assert contents(place) == before and not list(place.glob(".study*"))


@pytest.mark.long
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_signal_that_ends_leaves_nothing_temporary(
    place: Path, number: signal.Signals, code: int
) -> None:
    before = contents(place)
    code_text = (
        "import signal, sys, time, pathlib\n"
        # tests that are started in the background inherit that it is ignored
        f"signal.signal({int(number)}, signal.SIG_DFL)\n"
        "from scenarios.studies import folder\n"
        "def slow(*arguments, **named):\n"
        "    pathlib.Path('begun').touch()\n"
        "    time.sleep(60)\n"
        "folder.write_record = slow\n"
        "from scenarios.cli import main\n"
        "main(sys.argv[1:])\n"
    )
    command = [
        sys.executable,
        "-c",
        code_text,
        "run",
        "rigid",
        "--out",
        "study",
        "--figures",
        "none",
    ]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        command,
        cwd=place,
        env=environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as running:
        began = time.monotonic()
        while not (place / "begun").exists():
            assert running.poll() is None and time.monotonic() - began < PATIENCE, (
                running.communicate()
            )
            time.sleep(0.05)
        assert list(place.glob(".study-*"))
        running.send_signal(number)
        out, err = running.communicate(timeout=PATIENCE)
    (place / "begun").unlink()
    assert (running.returncode, out, err) == (code, "", "flightid: stopped; nothing was written\n")
    assert contents(place) == before and not list(place.glob(".study-*"))


def test_a_signal_that_is_ignored_stays_ignored() -> None:
    code = (
        "import os, signal, sys\n"
        "from scenarios.cli.application import ending_signals\n"
        "signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "with ending_signals() as came:\n"
        "    os.kill(os.getpid(), signal.SIGHUP)\n"
        "sys.exit(len(came))\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    assert (
        subprocess.run([sys.executable, "-c", code], env=environment, check=False).returncode == 0
    )


@pytest.mark.sampled
@pytest.mark.parametrize("call", ["record", "vehicle", "channels", "model", "reference", "study"])
@pytest.mark.parametrize("kind", ["zero", "sparse", "pipe", "folder", "circle", "long"])
def test_a_path_without_an_end_or_a_file_is_one_line(
    flightid: CommandLine, place: Path, monkeypatch: pytest.MonkeyPatch, call: str, kind: str
) -> None:
    monkeypatch.setattr("scenarios.files.sources.PIPE_TIMEOUT", 0.1)
    os.symlink("circle.csv", place / "circle.csv")
    os.mkfifo(place / "pipe.csv")
    with (place / "sparse.csv").open("wb") as sparse:
        sparse.truncate(1 << 40)
    path = {"zero": "/dev/zero", "folder": ".", "long": "x" * 300}.get(kind, f"{kind}.csv")
    calls = {
        "record": ("identify", path, "--model", "rigid", "--vehicle", "vehicle.toml"),
        "vehicle": (*IDENTIFY[:-1], path),
        "channels": (*IDENTIFY, "--channels", path),
        "model": ("identify", "flight.csv", "--model", path if kind != "folder" else "./"),
        "reference": ("watch", "flight.csv", "--model", "loes", "--reference", path),
        "study": ("report", path),
    }
    before = set(place.iterdir())
    said = flightid.refused(*calls[call])
    if call in ("record", "vehicle", "channels"):
        words = {
            "zero": "device",
            "sparse": "MiB",
            "pipe": "nothing writes",
            "folder": "folder",
            "circle": "cannot be read",
            "long": "File name too long",
        }
        assert words[kind] in said, said
    assert set(place.iterdir()) == before


@pytest.mark.long
def test_bombs_are_refused_by_their_size_with_the_limit(
    flightid: CommandLine, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit is lowered: a true bomb of a gibibyte would take the test too long."""
    import pandas

    monkeypatch.setattr("scenarios.files.sources.MOST_RECORD", 1 << 20)
    monkeypatch.setattr("scenarios.files.formats.registry.MOST_RECORD", 1 << 20)
    monkeypatch.setattr("scenarios.files.measured.columns.MOST_RECORD", 1 << 20)
    monkeypatch.setattr("scenarios.files.sources.MOST_NUMBERS", 1 << 17)
    rows = 1 << 18
    (place / "bomb.csv.gz").write_bytes(gzip.compress(b"time,alpha\n" + b"0,0\n" * rows))
    savemat(
        place / "bomb.mat", {"time": np.zeros(rows), "alpha": np.zeros(rows)}, do_compression=True
    )
    pandas.DataFrame({"time": np.zeros(rows), "alpha": np.zeros(rows)}).to_parquet(
        place / "bomb.parquet"
    )
    for name in ("bomb.csv.gz", "bomb.mat", "bomb.parquet"):
        assert (place / name).stat().st_size < 1 << 16
        said = flightid.refused("check", name, "--vehicle", "vehicle.toml")
        assert name in said and "more than the 1 MiB that are read at most" in said


@pytest.mark.long
def test_packed_files_of_usual_size_are_read(flightid: CommandLine, place: Path) -> None:
    import pandas

    table = pandas.read_csv(place / "flight.csv")
    table.to_parquet(place / "packed.parquet")
    savemat(
        place / "packed.mat", {name: table[name].to_numpy() for name in table}, do_compression=True
    )
    (place / "packed.csv.gz").write_bytes(gzip.compress((place / "flight.csv").read_bytes()))
    tables = [
        flightid.done("identify", name, *IDENTIFY[2:], "--method", "equation-error")
        for name in ("flight.csv", "packed.csv.gz", "packed.mat", "packed.parquet")
    ]
    rows = [[line for line in text.splitlines() if line.startswith("  C")][:6] for text in tables]
    assert len(rows[0]) == 6 and rows == [rows[0]] * len(rows)


@pytest.mark.sampled
@pytest.mark.parametrize(
    "out",
    [
        "x" * 300,
        "circle",
        "circle/study",
        "/dev/full",
        "flight.csv",
        "flight.csv/study",
    ],
)
def test_a_folder_that_cannot_be_is_one_line(flightid: CommandLine, place: Path, out: str) -> None:
    os.symlink("circle", place / "circle")
    before = contents(place)
    said = flightid.refused(
        *IDENTIFY, "--method", "equation-error", "--figures", "none", "--out", out
    )
    assert out[:50] in said and contents(place) == before


@pytest.mark.long
def test_the_longest_name_of_a_folder_serves(flightid: CommandLine, place: Path) -> None:
    flightid.done("run", "rigid", "--out", "y" * 255, "--figures", "none")
    assert (place / ("y" * 255) / "comparison.json").is_file()


@pytest.mark.long
@pytest.mark.parametrize(
    "theirs", ["new.json", "new_validate.json", "new_vehicle.toml", "new_validate.csv"]
)
def test_simulate_takes_no_file_of_somebody_else(
    flightid: CommandLine, place: Path, theirs: str
) -> None:
    (place / theirs).write_text('{"mine": 1}')
    before = contents(place)
    assert theirs in flightid.refused("simulate", "trace-vane", "--out", "new.csv")
    assert contents(place) == before
    (place / theirs).unlink()
    flightid.done("simulate", "trace-vane", "--out", "new.csv")
    # its own files are replaced
    flightid.done("simulate", "trace-vane", "--out", "new.csv", "--seed", "7")
    assert sorted(path.name for path in place.glob("new*")) == [
        "new.csv",
        "new.json",
        "new_validate.csv",
        "new_validate.json",
        "new_vehicle.toml",
    ]
