"""`flightid lab` and what every lab must have; no notebook is run here, for marimo may be absent
(see `tests/browser/labs`).
"""

from __future__ import annotations

import ast
import importlib.util
import re
import shlex
import socket
from pathlib import Path

import pytest

from flightid.labs.workings import close, command
from scenarios.cli.libraries import lab_files, title_of
from tests.integration.command_line import CommandLine

LABS = lab_files()


def test_nine_labs_are_listed(flightid: CommandLine) -> None:
    lines = flightid.done("lab").splitlines()
    assert [*LABS] == [*range(1, 10)]
    assert lines[:9] == [f"{number}  {title_of(path)}" for number, path in LABS.items()]
    assert len({title_of(path) for path in LABS.values()}) == 9 and "find the effect" in lines[4]


@pytest.mark.parametrize("number", LABS)
def test_a_lab_has_what_a_lab_must_have(number: int) -> None:
    text = LABS[number].read_text(encoding="utf-8")
    cells = [node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)]
    assert len(cells) > 7 and all(
        any("cell" in ast.unparse(mark) for mark in cell.decorator_list) for cell in cells
    )
    for part in (
        f"page.heading(\n        {number},",
        "## Theory",
        "$$",
        "Questions",
        "page.interactive_figure(",
        'if __name__ == "__main__":\n    app.run()',
    ):
        assert part in text, part
    # Markdown takes a line that begins with a sign for a list, also within an equation.
    assert not [line for line in text.splitlines() if re.match(r"\s+[-+=] [^\"]*\\", line)]


@pytest.mark.parametrize("number", LABS)
def test_a_key_stands_apart_and_answers_every_question(number: int, flightid: CommandLine) -> None:
    key = flightid.done("lab", number, "--key")
    assert key.startswith(f"# Key of lab {number}, ")
    text = LABS[number].read_text(encoding="utf-8")
    asked = text.count("page.Question(") or len(re.findall(r"^    \d\. ", text, re.MULTILINE))
    answered = len(re.findall(r"^(?:\d\. |\d\. and )", key, re.MULTILINE)) + key.count(". and ")
    assert answered == asked > 4


def test_a_copy_is_ones_own(flightid: CommandLine, tmp_path: Path) -> None:
    told = flightid.done("lab", 2, "--copy", tmp_path / "mine")
    copy = tmp_path / "mine" / LABS[2].name
    assert copy.read_bytes() == LABS[2].read_bytes() and str(copy) in told
    copy.write_text("mine")
    assert "you may have changed it" in flightid.refused("lab", 2, "--copy", tmp_path / "mine")
    assert copy.read_text() == "mine"


def test_what_cannot_be_opened_is_refused_in_one_line(
    flightid: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "there is no lab 10" in flightid.refused("lab", 10)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert 'pip install -e ".[labs]"' in flightid.refused("lab", 1)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert f"port {port} is taken" in flightid.refused("lab", 1, "--port", port)


def test_it_is_served_to_this_machine_alone(
    flightid: CommandLine, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    called: list[list[str]] = []

    def call(line: list[str]) -> int:
        called.append(line)
        return 0

    monkeypatch.setattr("scenarios.cli.libraries.subprocess.call", call)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    monkeypatch.chdir(tmp_path)
    flightid.done("lab", 1, "--no-browser")
    assert called[0][1:] == [
        "-m",
        "marimo",
        "run",
        str(LABS[1]),
        "--host",
        "127.0.0.1",
        "--headless",
    ]
    flightid.done("lab", 1, "--edit")
    assert (
        called[1][2:6] == ["marimo", "edit", LABS[1].name, "--host"]
        and (tmp_path / LABS[1].name).is_file()
    )
    (tmp_path / LABS[1].name).write_text("mine")
    flightid.done("lab", 1, "--edit")
    assert (tmp_path / LABS[1].name).read_text() == "mine"


def test_a_command_line_survives_the_shell() -> None:
    changes = ("flight.rate=50 Hz", 'estimate.outputs=["alpha"]', "methods=[]")
    words = shlex.split(command("run", "rigid", changes, "--seed", "1").replace("\\\n", " "))
    assert words[:5] == ["flightid", "run", "rigid", "--seed", "1"]
    assert tuple(words[6::2]) == changes and set(words[5::2]) == {"--set"}


def test_an_answer_is_close_by_a_share() -> None:
    assert close(-10.4, -10.3, 0.05) and not close(-11.0, -10.3, 0.05)
    assert not close(None, 1.0, 0.5) and not close(10.3, -10.3, 0.05)
