"""Commands where nothing can fork, as on Windows: the same files to the last byte, and nothing used
that Windows has not.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from scenarios.files.writing import write_record
from scenarios.tasks.processes import START_METHOD, can_fork
from sim.errors import FlightidError
from tests import loes_problem as problem
from tests.bases import LOES_CONSTANTS
from tests.integration.command_line import contents
from tests.integration.commands.test_survey_command import HEAD, LATE, short_flights
from tests.integration.commands.test_watch import START

ROOT = Path(__file__).parents[3]
COMMAND = "from scenarios.cli import main; main()"

# Found by every Python process below, before anything of flightid: it takes away what Windows has
# not.
LIKE_WINDOWS = """
import os, pathlib, select, signal, sys

for name in ("fork", "forkpty", "killpg", "setsid", "setpgid", "getuid", "geteuid", "getgid", "getpgid", "mkfifo", "wait", "wait3", "wait4",
             "sched_getaffinity", "nice", "getloadavg", "O_DIRECTORY"):
    if hasattr(os, name):
        delattr(os, name)
for name in ("SIGHUP", "SIGKILL", "SIGALRM", "SIGSTOP", "SIGCHLD", "SIGUSR1", "SIGPIPE", "pthread_sigmask", "alarm", "setitimer"):
    if hasattr(signal, name):
        delattr(signal, name)
for name in ("fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "syslog"):
    sys.modules[name] = None

def no_sockets(*arguments):
    raise OSError("select is of sockets alone")

select.select = no_sockets
with open(os.environ["FLIGHTID_TEST_SEEN"], "a") as seen:
    seen.write("process\\n")
"""  # noqa: E501

# Any fork ends the process; workers and the process of figures are started by other means.
NO_FORK = """
import os

def fork():
    with open(os.environ["FLIGHTID_TEST_SEEN"], "a") as seen:
        seen.write("fork\\n")
    os._exit(99)

os.fork = fork
"""


def run(
    folder: Path,
    arguments: list[str],
    prelude: str,
    standard_input: bytes | None = None,
    **environment: str,
) -> str:
    """What a command prints that is run in ``folder`` by a process that has run ``prelude`` first,
    as have those that it starts.
    """
    (folder / "prelude").mkdir(exist_ok=True)
    (folder / "prelude" / "sitecustomize.py").write_text(prelude)
    paths = os.pathsep.join((str(folder / "prelude"), str(ROOT)))
    found = {
        **os.environ,
        "PYTHONPATH": paths,
        "FLIGHTID_TEST_SEEN": str(folder / "seen"),
        **environment,
    }
    done = subprocess.run(
        [sys.executable, "-c", COMMAND, *arguments],
        cwd=folder,
        env=found,
        input=standard_input,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout.decode()


# when it was written, and how long it took
_RUN = (rb"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\dZ| UTC)", rb'"seconds": [\d.e-]+')


def written(folder: Path) -> dict[str, bytes]:
    """The bytes of every file, but for times; rows of a campaign as a table, since they hold
    times.
    """
    import pandas as pd

    found = {}
    for name, content in contents(folder).items():
        if name.endswith(".parquet"):
            frame = pd.read_parquet(folder / name)
            content = (
                frame[[column for column in frame if "second" not in column]].to_csv().encode()
            )
        for pattern in _RUN:
            content = re.sub(pattern, b"", content)
        found[name] = content
    return found


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``records/a.csv`` and so on, ``vehicle.toml`` and ``flights.toml``; tests only read them."""
    folder = tmp_path_factory.mktemp("flights")
    tables = short_flights(folder, {"a": LATE, "b": 0.0, "c": LATE})
    (folder / "flights.toml").write_text(HEAD + "\n".join(tables))
    return folder


def commands(flights: Path) -> Mapping[str, list[str]]:
    record, vehicle = str(flights / "records" / "a.csv"), str(flights / "aircraft.toml")
    diagnosed = ["--model", "rigid", "--vehicle", vehicle]
    return {
        "run": ["run", "rigid", "--out", "out"],
        "identify": ["identify", record, *diagnosed, "--out", "out"],
        "diagnose": [
            "diagnose",
            record,
            *diagnosed,
            "--validate",
            str(flights / "records" / "c.csv"),
            "--out",
            "out",
        ],
        "campaign": [
            "campaign",
            "ballistic",
            "--runs",
            "300",
            "--jobs",
            "2",
            "--out",
            "out",
            "--no-figures",
        ],
        "survey": [
            "survey",
            str(flights / "flights.toml"),
            "--jobs",
            "2",
            "--out",
            "out",
            "--no-figures",
        ],
    }


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    ["run", "identify", "diagnose", "campaign", pytest.param("survey", marks=pytest.mark.slow)],
)
def test_the_same_files_without_a_fork(name: str, flights: Path, tmp_path: Path) -> None:
    folders = {}
    for method, prelude in (("fork", ""), ("spawn", NO_FORK)):
        folders[method] = tmp_path / method
        folders[method].mkdir()
        run(folders[method], commands(flights)[name], prelude, None, **{START_METHOD: method})
    assert not (folders["spawn"] / "seen").exists()
    forked, spawned = (written(folder / "out") for folder in folders.values())
    assert forked.keys() == spawned.keys() and len(forked) > 3
    for file, content in forked.items():
        assert content == spawned[file], file


@pytest.mark.long
@pytest.mark.parametrize("name", ["run", "identify", "diagnose"])
def test_a_command_uses_nothing_that_windows_has_not(
    name: str, flights: Path, tmp_path: Path
) -> None:
    (tmp_path / "plain").mkdir()
    run(tmp_path / "plain", commands(flights)[name], "")
    run(tmp_path, commands(flights)[name], LIKE_WINDOWS)
    assert written(tmp_path / "out") == written(tmp_path / "plain" / "out")
    # The prelude was really run.
    assert (tmp_path / "seen").read_text().count("process") == 1


@pytest.mark.long
def test_watch_reads_a_pipe_without_select(tmp_path: Path) -> None:
    write_record(tmp_path, problem.record(11, duration=6.0, gaps=True), "flight")
    record = (tmp_path / "flight.csv").read_bytes()
    constants = "".join(f"{name} = {value}\n" for name, value in LOES_CONSTANTS.items())
    (tmp_path / "v.toml").write_text(
        f'name = "demonstrator"\n{constants}[derivatives]\n'
        + "".join(f"{n} = {v}\n" for n, v in START.items())
    )
    arguments = [
        "watch",
        "-",
        "--model",
        "loes",
        "--vehicle",
        str(tmp_path / "v.toml"),
        "--out",
        "out",
    ]
    (tmp_path / "plain").mkdir()
    run(tmp_path / "plain", arguments, "", record)
    run(tmp_path, arguments, LIKE_WINDOWS, record)
    assert written(tmp_path / "out") == written(tmp_path / "plain" / "out")


def test_the_choice_is_one_function(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(START_METHOD, raising=False)
    assert can_fork() is sys.platform.startswith("linux")
    monkeypatch.setenv(START_METHOD, "spawn")
    assert not can_fork()
    monkeypatch.setenv(START_METHOD, "threads")
    with pytest.raises(
        FlightidError,
        match=(
            r"FLIGHTID_START_METHOD: 'threads' is no start method; set it to fork or spawn, or "
            r"unset it"
        ),
    ):
        can_fork()
    monkeypatch.delattr(os, "fork", raising=False)
    monkeypatch.setenv(START_METHOD, "fork")
    with pytest.raises(FlightidError, match="cannot fork"):
        can_fork()
    monkeypatch.delenv(START_METHOD)
    assert not can_fork()


@pytest.mark.long
def test_a_wrong_start_method_is_one_line(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), START_METHOD: "forkserver"}
    arguments = [
        sys.executable,
        "-c",
        COMMAND,
        "campaign",
        "ballistic",
        "--runs",
        "300",
        "--jobs",
        "2",
        "--out",
        "out",
    ]
    done = subprocess.run(
        arguments, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    said = done.stderr.splitlines()[-1]
    assert done.returncode == 2 and "FLIGHTID_START_METHOD: 'forkserver' is no start method" in said
    assert "Traceback" not in done.stderr


@pytest.mark.long
@pytest.mark.parametrize("coding", ["cp1252", "ascii"])
def test_json_is_utf8_on_a_pipe_of_any_coding(coding: str, flights: Path, tmp_path: Path) -> None:
    import json

    arguments = [
        "check",
        str(flights / "records" / "a.csv"),
        "--vehicle",
        str(flights / "aircraft.toml"),
        "--json",
    ]
    assert json.loads(run(tmp_path, arguments, "", PYTHONIOENCODING=coding))
