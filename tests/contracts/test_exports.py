"""`import flightid`: every public name is there, nothing is loaded before it is asked for, and what
hides a room is told by its file.
"""

from __future__ import annotations

import ast
import inspect
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import flightid
import flightid.plot

ROOT = Path(__file__).parents[2]
HEAVY = (
    "numpy",
    "scipy",
    "pandas",
    "matplotlib",
    "control",
    "xarray",
    "typer",
    "rich",
    "pydantic",
    "scenarios",
    "ident",
    "sim",
)


def told_to_editors() -> Iterator[str]:
    """Names that the package imports for type checking only."""
    tree = ast.parse((ROOT / "flightid" / "__init__.py").read_text(encoding="utf-8"))
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    for node in block.body:
        if isinstance(node, ast.ImportFrom):
            yield from (item.asname or item.name for item in node.names)
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            yield node.target.id


def test_every_export_is_there_and_said_to_editors() -> None:
    assert sorted(told_to_editors()) == sorted(flightid.__all__) == sorted(dir(flightid))
    for name in flightid.__all__:
        value = getattr(flightid, name)
        assert value is getattr(flightid, name) and (name == "__version__" or inspect.getdoc(value))
    assert re.match(r"\d+(\.\d+)*", flightid.__version__)
    with pytest.raises(AttributeError, match="module 'flightid' has no attribute 'identity'"):
        _ = flightid.identity


def test_every_figure_is_a_function_of_a_result() -> None:
    # What makes a figure zoom in a notebook takes a figure.
    names = [name for name in flightid.plot.__all__ if name.lower() != "interactive"]
    functions = [getattr(flightid.plot, name) for name in names]
    assert [each.__name__ for each in functions] == names
    assert all(
        inspect.getdoc(each) and "Figure" in str(inspect.signature(each).return_annotation)
        for each in functions
    )


# Keywords that are another word in Python: `from`, `class` and `set` are its own, and the rest are
# told by what they return.
WORDS = {"from": "start", "to": "stop", "class": "aircraft_class", "set": "set"}
LEFT_OUT = {"json", "quiet", "out", "figures", "no_figures", "state_space", "help", "model_file"}


@pytest.mark.parametrize(
    "command",
    [
        "identify",
        "diagnose",
        "predict",
        "check",
        "run",
        "campaign",
        "design",
        "response",
        "structure",
        "export",
    ],
)
def test_keywords_are_the_options_of_the_command(command: str) -> None:
    import typer.main

    from scenarios.cli import app

    options = {
        text.removeprefix("--").replace("-", "_")
        for parameter in typer.main.get_command(app).commands[command].params  # type: ignore[attr-defined]
        for text in parameter.opts
        if text.startswith("--")
    }
    keywords = set(inspect.signature(getattr(flightid, FUNCTIONS.get(command, command))).parameters)
    wanted = {WORDS.get(option, option) for option in options} - LEFT_OUT
    assert {name for name in wanted if name not in keywords} <= OF_THE_COMMAND_ALONE[command]


# A response is also what a result holds, so the function has the longer name.
FUNCTIONS = {"response": "frequency_response"}
OF_THE_COMMAND_ALONE: dict[str, set[str]] = {
    "identify": set(),
    "diagnose": set(),
    "predict": set(),
    "check": set(),
    "design": set(),
    "run": {"compare"},
    "response": set(),
    "structure": set(),
    "export": {"model", "stop"},  # --to is the target there
    # A flight of one's own is a scenario file in Python.
    "campaign": {"model", "vehicle", "input", "noise", "duration", "rate"},
}


def test_the_import_brings_nothing_along() -> None:
    probe = f"import sys, flightid; print([name for name in {HEAVY} if name in sys.modules])"
    run = subprocess.run(
        [sys.executable, "-c", probe], cwd=ROOT, capture_output=True, text=True, timeout=60
    )
    assert (run.stdout, run.stderr) == ("[]\n", "")


HIDDEN = [
    ("sim.py", ("-c", "import flightid")),
    ("ident/__init__.py", ("-m", "flightid", "list")),
    ("scenarios.py", ("-c", "import scenarios, flightid")),
]


@pytest.mark.parametrize(("hidden", "call"), HIDDEN)
def test_what_hides_a_room_is_told_by_its_file(
    tmp_path: Path, hidden: str, call: tuple[str, ...]
) -> None:
    file = tmp_path / hidden
    file.parent.mkdir(exist_ok=True)
    file.write_text("VALUE = 1\n")
    environment = {"PYTHONPATH": str(ROOT), "PATH": ""}
    run = subprocess.run(
        [sys.executable, *call],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    last = run.stderr.rstrip().splitlines()[-1]
    place, room = (
        file.parent if file.name == "__init__.py" else file,
        Path(hidden).parts[0].removesuffix(".py"),
    )
    assert (
        run.returncode == 1
        and f"ImportError: {place} hides the package {room!r} of flightid: rename it" in last
    )
    assert call[0] == "-c" or run.stderr.count("\n") == 1


def test_a_folder_that_hides_nothing_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "simulation.py").write_text("")
    environment = {"PYTHONPATH": str(ROOT), "PATH": ""}
    run = subprocess.run(
        [sys.executable, "-c", "import flightid"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (run.returncode, run.stderr) == (0, "")
