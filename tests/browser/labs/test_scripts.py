"""Every lab runs as a script, as a marimo notebook does without marimo's page."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("marimo", reason='no marimo: python -m pip install -e ".[labs]"')

ROOT = Path(__file__).parents[3]
LABS = sorted((ROOT / "flightid" / "labs").glob("lab*.py"))


ALL = """
import runpy, sys, traceback
failed = []
for path in sys.argv[1:]:
    try:
        runpy.run_path(path, run_name="__main__")
    except Exception:
        traceback.print_exc()
        failed.append(path)
sys.exit(len(failed))
"""


def test_each_lab_runs_as_a_script(tmp_path: Path) -> None:
    """In one process for all: to import takes longer than what most labs compute."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    run = subprocess.run(
        [sys.executable, "-c", ALL, *map(str, LABS)],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert (run.returncode, run.stderr) == (0, "")


def test_a_lab_that_fails_is_seen(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.py"
    wrong.write_text("raise ValueError('no flight')\n", encoding="utf-8")
    run = subprocess.run(
        [sys.executable, "-c", ALL, str(wrong)], capture_output=True, text=True, timeout=60
    )
    assert run.returncode == 1 and "no flight" in run.stderr


def test_marimo_finds_nothing_wrong_with_them() -> None:
    # One process for all: marimo needs longer to start than to check.
    run = subprocess.run(
        [sys.executable, "-m", "marimo", "check", "--strict", *map(str, LABS)],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert run.returncode == 0, run.stdout + run.stderr


def test_marimo_finds_a_name_that_two_cells_define(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.py"
    cell = "@app.cell\ndef _():\n    a = 1\n    return (a,)\n\n\n"
    wrong.write_text(f"import marimo\n\napp = marimo.App()\n\n\n{cell}{cell}", encoding="utf-8")
    run = subprocess.run(
        [sys.executable, "-m", "marimo", "check", "--strict", str(LABS[0]), str(wrong)],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert run.returncode == 1 and "wrong.py" in run.stdout + run.stderr
