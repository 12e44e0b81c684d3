"""What the documents show is true: their files are read, their commands run, their outputs appear, their links lead somewhere."""

from __future__ import annotations

import re
import runpy
import shlex
import types
import typing
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from scenarios.studies.scenario_file import schema
from tests.integration.command_line import CommandLine

ROOT = Path(__file__).parents[3]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "labs").rglob("*.md")])
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)#\s]+)\)")


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def blocks(path: Path) -> Iterator[tuple[str, str]]:
    for found in BLOCK.finditer(path.read_text(encoding="utf-8")):
        yield found[1], found[2]


def words(text: str) -> str:
    return " ".join(text.split())


READERS_FILES = {"docs/how-to/own-effect.md", "docs/records/cavour.md", "docs/records/prometheus.md"}  # commands on files that only the reader has
WITH_COMMANDS = [
    path
    for path in DOCUMENTS
    if name_of(path) not in READERS_FILES and any(kind == "sh" and re.search(r"^flightid ", text, re.MULTILINE) for kind, text in blocks(path))
]


@pytest.mark.parametrize("path", WITH_COMMANDS, ids=name_of)
def test_commands_do_what_the_document_shows(path: Path, flightid: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A ``toml`` or ``python`` block that begins with ``# file: NAME`` is that file, and ``python NAME`` runs it; ``# refused`` behind
    a command means exit code 2; each line of a ``text`` block stands in what the commands before it printed or wrote."""
    monkeypatch.chdir(tmp_path)
    for folder in ("docs", "labs"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    seen = ""
    for kind, text in blocks(path):
        if kind in ("toml", "python") and text.startswith("# file: "):
            (tmp_path / text.splitlines()[0].removeprefix("# file: ")).write_text(text)
        elif kind == "sh":
            for line in text.splitlines():
                if line.startswith("python ") and not line.startswith("python -m "):
                    runpy.run_path(line.split()[1])
            seen = "".join(run(line, flightid) for line in text.splitlines() if line.startswith("flightid "))
        elif kind == "text":
            for line in text.splitlines():
                assert words(line) in words(seen), f"{line!r} is not in\n{seen}"


IN_PYTHON = [
    path for path in DOCUMENTS if path not in WITH_COMMANDS and any(kind == "python" and "import flightid" in text for kind, text in blocks(path))
]


@pytest.mark.parametrize("path", IN_PYTHON, ids=name_of)
def test_cells_do_what_the_document_shows(path: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The ``python`` blocks of a page that begins with an import of the library run one after the other, as cells of one notebook do;
    each line of a ``text`` block stands in what the block before it printed."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    seen = ""
    for kind, text in blocks(path):
        if kind == "toml":
            (tmp_path / text.splitlines()[0].removeprefix("# file: ")).write_text(text)
        elif kind == "python":
            exec(compile(text, str(path), "exec"), names)
            seen = capsys.readouterr().out
        elif kind == "text":
            for line in text.splitlines():
                assert words(line) in words(seen), f"{line!r} is not in\n{seen}"


def run(line: str, flightid: CommandLine) -> str:
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


@pytest.mark.parametrize("path", DOCUMENTS, ids=name_of)
def test_links_lead_somewhere(path: Path) -> None:
    for target in LINK.findall(path.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (path.parent / target).exists(), target


SECTIONS: dict[str, type[BaseModel]] = {
    "The file": schema.ScenarioTable,
    "`[flight]`": schema.FlightTable,
    "`[[flight.maneuvers]]`": schema.Maneuver,
    "`[estimate]`": schema.EstimateTable,
    "`[[methods]]`": schema.MethodTable,
    "`[methods.flight]`": schema.OtherFlightTable,
    "`[estimate.start]` and `[estimate.initial]`": schema.SpreadTable,
    "`published`": schema.PublishedTable,
    "`[repeated]`": schema.RepeatedTable,
    "`[[repeated.flights]]`": schema.VariationTable,
    "`[sweep]`": schema.SweepTable,
    "`[[sweep.marks]]`": schema.MarkTable,
}


def documented(title: str) -> dict[str, str]:
    """Key -> default of the table under a heading of docs/scenarios.md."""
    text = (ROOT / "docs" / "scenarios.md").read_text(encoding="utf-8")
    section = text.split(f"\n## {title}\n")[1].split("\n## ")[0]
    rows = [line.strip("|").split("|") for line in section.splitlines() if line.startswith("| `")]
    return {key.strip().strip("`"): default.strip() for key, default, *_ in rows}


def own_fields(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """The fields of a table but those that it takes over from another one, which are documented there."""
    return {name: model.model_fields[name] for name in model.__annotations__}


def shown(default: object) -> str:
    if default is PydanticUndefined:
        return "required"
    if default is None:
        return "none"
    if default in ("", [], {}):
        return "empty"
    return f"`{str(default).lower() if isinstance(default, bool) else default}`"


@pytest.mark.parametrize("title", SECTIONS)
def test_scenario_keys_and_defaults_are_documented(title: str) -> None:
    model = SECTIONS[title]
    assert documented(title) == {field.alias or name: shown(field.default) for name, field in own_fields(model).items()}


def test_every_scenario_is_listed_with_its_title_and_fits_a_terminal(flightid: CommandLine) -> None:
    text = (ROOT / "docs" / "scenarios.md").read_text(encoding="utf-8")
    section = text.split("\n## The built-in ones\n")[1].split("\n## ")[0]
    lines = flightid.done("list").splitlines()
    listed = [line.split(maxsplit=1) for line in lines]
    assert re.findall(r"^\| `(\S+)` \| (.*) \|$", section, re.MULTILINE) == [(name, title.strip()) for name, title in listed]
    assert max(len(line) for line in lines) <= 80


def test_every_choice_of_a_scenario_is_documented() -> None:
    text = (ROOT / "docs" / "scenarios.md").read_text(encoding="utf-8")
    for title, model in SECTIONS.items():
        section = text.split(f"\n## {title}\n")[1].split("\n## ")[0]
        for field in own_fields(model).values():
            for choice in choices(field.annotation):
                assert f"`{choice}`" in section, (title, choice)


def test_every_table_of_the_schema_is_documented() -> None:
    tables = {
        kind for kind in vars(schema).values() if isinstance(kind, type) and issubclass(kind, BaseModel) and kind not in (BaseModel, schema.Strict)
    }
    assert tables == set(SECTIONS.values())


def choices(annotation: object) -> tuple[str, ...]:
    if typing.get_origin(annotation) is typing.Literal:
        return typing.get_args(annotation)
    if isinstance(annotation, types.UnionType):
        return tuple(choice for part in typing.get_args(annotation) for choice in choices(part))
    return ()


def test_the_commands_of_the_readme_are_those_that_exist(flightid: CommandLine) -> None:
    listed = {line.split()[0] for line in flightid.done("--help").split("Commands:")[1].splitlines() if line.startswith("  ") and line[2] != " "}
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert {name for name in listed if f"| `flightid {name}" not in text} == set()
    assert set(re.findall(r"^\| `flightid (\w+)", text, re.MULTILINE)) <= listed
