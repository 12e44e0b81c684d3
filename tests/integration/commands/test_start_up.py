"""The command starts fast because it imports late; told in whole processes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from scenarios.cli import main

ROOT = Path(__file__).parents[3]
# typer itself may bring pydantic
HEAVY = ("numpy", "scipy", "control", "filterpy", "matplotlib", "pandas", "pint", "rich")


def process(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )


def imported_by(*arguments: str) -> set[str]:
    """Which of the heavy packages a call of the command has imported when it ends."""
    code = f"""
import sys
from scenarios.cli import main
try:
    main(sys.argv[1:])
except SystemExit as end:
    assert end.code == 0, end.code
print("imported:", *(name for name in {HEAVY!r} if name in sys.modules))
"""
    done = process(code, *arguments)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.splitlines()[-1].split()[1:])


@pytest.mark.sampled
@pytest.mark.parametrize(
    "arguments", [("--help",), ("run", "--help"), ("list",), ("list", "rigid")]
)
def test_help_and_list_import_nothing_heavy(arguments: tuple[str, ...]) -> None:
    assert imported_by(*arguments) == set()


def processor_seconds(code: str) -> float:
    """Processor time of a whole process, the least of three: other work on the machine stretches
    the wall clock, not this.
    """
    spent: list[float] = []
    for _ in range(3):
        before = os.times()
        assert process(code).returncode == 0
        after = os.times()
        spent.append(
            after.children_user
            - before.children_user
            + after.children_system
            - before.children_system
        )
    return min(spent)


def test_help_starts_fast() -> None:
    """Measured against the library that reads the command line, since machines differ: three times
    as long; with NumPy it would be five to six times.
    """
    needed = processor_seconds("from scenarios.cli import main; main(['--help'])")
    assert needed < 4.5 * processor_seconds("import typer")


@pytest.mark.long
def test_a_run_imports_neither_control_nor_pandas(tmp_path: Path) -> None:
    assert imported_by("run", "rigid", "--no-figures", "--out", str(tmp_path / "out")).isdisjoint(
        {"control", "pandas", "matplotlib", "pint"}
    )


@pytest.mark.long
def test_python_m_scenarios_is_the_command(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    call = [sys.executable, "-m", "scenarios", "run", "rigit"]
    done = subprocess.run(
        call, env=environment, capture_output=True, text=True, timeout=60, cwd=tmp_path
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "flightid: there is no scenario 'rigit'; did you mean 'rigid'?\n"


def test_a_closed_pipe_is_no_traceback() -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    call = [sys.executable, "-m", "scenarios", "vehicles", "bomber_ac1"]
    with subprocess.Popen(
        call, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as running:
        assert running.stdout is not None and running.stderr is not None
        running.stdout.close()
        assert "Traceback" not in running.stderr.read()


def test_linear_algebra_gets_one_thread_unless_the_user_says_otherwise(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "Usage" in capsys.readouterr().out
    assert (os.environ["OPENBLAS_NUM_THREADS"], os.environ["OMP_NUM_THREADS"]) == ("1", "3")
