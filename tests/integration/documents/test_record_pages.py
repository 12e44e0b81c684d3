"""The pages on measured records: their commands run where the records are, and the numbers stand in
what they print.
"""

from __future__ import annotations

import importlib.util
import shlex
import sys
from pathlib import Path
from types import ModuleType

import pytest

from tests.integration.command_line import CommandLine
from tests.integration.documents.snippets import BLOCK, ROOT, run, words

RECORDS = ROOT.parent / "shared" / "flightdata"
PAGES = ("cavour", "prometheus")
present = pytest.mark.skipif(not RECORDS.is_dir(), reason="the measured records are not here")


def script(path: str) -> ModuleType:
    """A Python file of the documents, as a module."""
    found = importlib.util.spec_from_file_location(f"record_page_{Path(path).stem}", ROOT / path)
    assert found is not None and found.loader is not None
    module = importlib.util.module_from_spec(found)
    sys.modules[module.__name__] = module  # dataclasses look their module up
    found.loader.exec_module(module)
    return module


def scripted(line: str, capsys: pytest.CaptureFixture[str]) -> str:
    """Run ``python FILE ARGUMENTS`` of a page; ``> FILE`` takes what it prints."""
    _, path, *arguments = shlex.split(line)
    target = arguments[arguments.index(">") + 1] if ">" in arguments else None
    capsys.readouterr()
    script(path).main(arguments[: arguments.index(">")] if target else arguments)
    printed = capsys.readouterr().out
    if target is None:
        return printed
    Path(target).write_text(printed)
    return ""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the pages' commands run: the documents, and the records beside them."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    (tmp_path / "records").symlink_to(RECORDS)
    return tmp_path


def follow(
    page: str, folder: Path, flightid: CommandLine, capsys: pytest.CaptureFixture[str], slow: bool
) -> int:
    """Run the blocks of a page in order, those with a script only if ``slow``; the number of lines
    found in what the blocks printed.
    """
    seen, found = "", 0
    for kind, text in (
        (block[1], block[2])
        for block in BLOCK.finditer(
            (ROOT / "docs" / "records" / f"{page}.md").read_text(encoding="utf-8")
        )
    ):
        if kind == "toml":
            (folder / text.splitlines()[0].removeprefix("# file: ")).write_text(text)
        elif kind == "sh":
            python = [line for line in text.splitlines() if line.startswith("python ")]
            seen = "".join(scripted(line, capsys) for line in python if slow or ">" in line)
            if not python or ">" in text:
                seen += "".join(
                    run(line, flightid)
                    for line in text.splitlines()
                    if line.startswith("flightid ") and not slow
                )
        elif kind == "text" and seen:
            for line in text.splitlines():
                assert words(line) in words(seen), f"{line!r} is not in\n{seen}"
                found += 1
    return found


@pytest.mark.long
@present
@pytest.mark.parametrize("page", [PAGES[0], pytest.param(PAGES[1], marks=pytest.mark.slow)])
def test_what_the_program_says(
    page: str, folder: Path, flightid: CommandLine, capsys: pytest.CaptureFixture[str]
) -> None:
    assert follow(page, folder, flightid, capsys, slow=False) >= 8


@present
@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_what_stands_beside_it(
    page: str, folder: Path, flightid: CommandLine, capsys: pytest.CaptureFixture[str]
) -> None:
    """Integrators, fits and figures of the pages' own."""
    assert follow(page, folder, flightid, capsys, slow=True) >= 8


@present
@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_figures_are_drawn(page: str, folder: Path) -> None:
    (folder / "figures").mkdir()
    script(f"docs/records/{page}.py").main([str(RECORDS), "figures"])
    drawn = {path.name for path in (folder / "figures").iterdir()}
    assert (
        drawn == {path.name for path in (ROOT / "docs" / "records").glob(f"{page}-*.png")}
        and len(drawn) == 2
    )
