"""The snippets of the documents: how each is run, and the few that are not, with the reason."""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import re
import runpy
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

ROOT = Path(__file__).parents[3]
DOCUMENTS = sorted(
    path
    for path in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "labs").rglob("*.md"))
    if path.is_relative_to(ROOT / "docs" / "made") is False  # written when the site is built
)
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)

# Lines of `sh` blocks and `python` blocks that no test of a page runs, by page and beginning, with
# the reason. Keep it short.
BY_CI = "`.ci/run` runs it in a fresh environment"
RECORDS = "needs the measured records; test_record_pages.py runs it where they are"
NOT_RUN: dict[tuple[str, str], str] = {
    ("README.md", "python -m pip install -e . && flightid run rigid"): BY_CI,
    ("README.md", 'python -m pip install -e ".[test]" && python -m pytest'): BY_CI,
    ("CONTRIBUTING.md", 'python -m pip install -e ".[test]" && python -m pytest'): BY_CI,
    ("docs/start.md", "python -m pip install -e ."): BY_CI,
    ("docs/README.md", 'python -m pip install -e ".[docs]"'): BY_CI,
    ("docs/README.md", "python -m sphinx"): BY_CI,
    ("docs/how-to/labs.md", 'python -m pip install -e ".[labs]"'): BY_CI,
    ("labs/README.md", 'python -m pip install -e ".[labs]"'): BY_CI,
    (
        "docs/how-to/labs.md",
        "flightid lab 5",
    ): "opens a browser and waits; tests/browser walks through every lab",
    ("docs/how-to/watch.md", "telemetry-decoder --csv |"): "stands for a program of the reader's",
    ("docs/records/cavour.md", ""): RECORDS,
    ("docs/records/prometheus.md", ""): RECORDS,
}
MOST_NOT_RUN = 12  # more are a sign that pages show what nobody can follow

# Pages whose commands take long: they run with `-m slow`, and what stands here is tested otherwise
# by default.
SLOW = {
    "docs/how-to/cluster.md": (
        "tests/unit/scenarios/tasks/test_cluster.py runs on a cluster of its own"
    ),
    "docs/how-to/survey.md": "tests/unit/scenarios/survey surveys a smaller fleet",
    "docs/how-to/own-effect.md": (
        "tests/contracts/test_new_effect.py takes the page's effect through the whole loop"
    ),
}


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def blocks(path: Path) -> Iterator[tuple[str, str]]:
    """Kind and text of every fenced block that says what it is, in order."""
    for found in BLOCK.finditer(path.read_text(encoding="utf-8")):
        yield found[1], found[2]


def snippets(path: Path) -> Iterator[tuple[str, str]]:
    """What a reader would run, with its kind: each command of an ``sh`` block, and each ``python``
    block that is no file.
    """
    for kind, text in blocks(path):
        if kind == "sh":
            yield from (("sh", line) for line in commands(text))
        elif kind == "python" and not text.startswith("# file: "):
            yield kind, text


def commands(text: str) -> list[str]:
    """Commands of a block; a line that ends with a backslash goes on in the next one, and remarks
    are none.
    """
    return [
        line
        for line in re.sub(r"\\\n\s*", "", text).splitlines()
        if line.strip() and not line.startswith("#")
    ]


def why_not_run(path: Path, snippet: str) -> str | None:
    """The reason why nobody runs a snippet, None where it is run."""
    return next(
        (
            why
            for (page, start), why in NOT_RUN.items()
            if page == name_of(path) and snippet.startswith(start)
        ),
        None,
    )


def is_run(kind: str, snippet: str) -> bool:
    """Whether ``Reader`` knows how to run it: Python, the program, or a Python file of the page."""
    return (
        kind == "python"
        or re.match(r"flightid |python [\w/]+\.py$|python -m tests\.|cd [\w-]+$", snippet)
        is not None
    )


class Program(Protocol):
    """``flightid``, in this process or as one of its own."""

    def done(self, *arguments: str) -> str:
        """What it printed, exit code 0."""

    def refused(self, *arguments: str) -> str:
        """The line with which it refused."""


def words(text: str) -> str:
    return " ".join(text.split())


@dataclass
class Reader:
    """One who follows a page in an empty folder, block by block.

    A ``toml`` or ``python`` block that begins with ``# file: NAME`` is that file, any other
    ``python`` block is run after those before it; ``# refused`` behind a command means exit code 2;
    each line of a ``text`` block stands in what the block before it printed.
    """

    flightid: Program
    seen: str = ""
    lines: int = 0
    names: dict[str, Any] = field(default_factory=lambda: {"__name__": "page"})

    def follow(self, path: Path) -> None:
        for kind, text in blocks(path):
            if kind in ("toml", "python") and text.startswith("# file: "):
                Path(text.splitlines()[0].removeprefix("# file: ").strip()).write_text(
                    text, encoding="utf-8"
                )
            elif kind == "python":
                self.seen = printed_by(
                    lambda text=text: exec(compile(text, name_of(path), "exec"), self.names)
                )
            elif kind == "sh":
                self.seen = "".join(
                    self.ran(line) for line in commands(text) if why_not_run(path, line) is None
                )
            elif kind == "text" and self.seen:
                for line in text.splitlines():
                    assert words(line) in words(self.seen), f"{line!r} is not in\n{self.seen}"
                    self.lines += 1

    def ran(self, line: str) -> str:
        """What a command printed; ``> FILE`` takes it."""
        if line.startswith("cd "):
            os.chdir(line.split()[1])
            return ""
        if line.startswith("python -m tests."):
            module, *arguments = line.split()[2:]
            return printed_by(lambda: importlib.import_module(f"{module}.__main__").main(arguments))
        if line.startswith("python "):
            # Whole: processes that the program starts look for it from the folder of the tests.
            program = str(Path(line.split()[1]).resolve())
            return printed_by(lambda: runpy.run_path(program, run_name="__main__"))
        return run(line, self.flightid)


def printed_by(work: Any) -> str:
    with contextlib.redirect_stdout(io.StringIO()) as out:
        work()
    return out.getvalue()


def run(line: str, flightid: Program) -> str:
    """Run a command line of a document; ``> FILE`` takes what it prints."""
    call, _, remark = line.partition("#")
    arguments = shlex.split(call)[1:]
    if "refused" in remark:
        return flightid.refused(*arguments)
    if ">" in arguments:
        at = arguments.index(">")
        Path(arguments[at + 1]).write_text(flightid.done(*arguments[:at]))
        return ""
    return flightid.done(*arguments)
