"""What the documents show is true: their files are read, their commands run, their outputs appear,
their links lead somewhere.
"""

from __future__ import annotations

import re
import types
import typing
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from scenarios.cli.application import COMMANDS
from scenarios.studies import schema
from tests.integration.command_line import CommandLine
from tests.integration.documents.snippets import (
    DOCUMENTS,
    MOST_NOT_RUN,
    NOT_RUN,
    ROOT,
    SLOW,
    Reader,
    blocks,
    is_run,
    name_of,
    snippets,
    why_not_run,
)

LINK = re.compile(r"\]\(([^)#\s]+)\)")
FOLLOWED = [
    path
    for path in DOCUMENTS
    if any(why_not_run(path, snippet) is None for _, snippet in snippets(path))
]


@pytest.fixture
def blank_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are set up and written, and nothing is drawn on them: that takes half of the time
    here, and tests of figures do it.
    """
    monkeypatch.setattr(Figure, "draw", lambda figure, renderer: None)


@pytest.mark.long
@pytest.mark.parametrize(
    "path",
    [
        pytest.param(
            path, id=name_of(path), marks=[pytest.mark.slow] if name_of(path) in SLOW else []
        )
        for path in FOLLOWED
    ],
)
def test_commands_do_what_the_document_shows(
    path: Path,
    flightid: CommandLine,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    blank_figures: None,
) -> None:
    """See ``Reader``."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for folder in ("docs", "labs"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    reader = Reader(flightid)
    reader.follow(path)
    assert reader.lines or not any(kind == "text" for kind, _ in blocks(path))


def test_every_snippet_is_run_or_has_a_reason() -> None:
    for path in DOCUMENTS:
        for kind, snippet in snippets(path):
            assert is_run(kind, snippet) or why_not_run(path, snippet), (
                f"{name_of(path)}: {snippet.splitlines()[0]}"
            )
    for page, start in NOT_RUN:
        assert any(snippet.startswith(start) for _, snippet in snippets(ROOT / page)), (
            f"{page} no longer has {start!r}"
        )
    assert len(NOT_RUN) <= MOST_NOT_RUN
    assert {*SLOW} <= {name_of(path) for path in FOLLOWED}


def test_a_page_that_is_wrong_is_seen(
    tmp_path: Path, flightid: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.integration.documents.snippets.ROOT", tmp_path)
    page = tmp_path / "page.md"
    page.write_text("```python\nx = 2\n```\n\n```python\nprint(3 * x)\n```\n\n```text\n6\n```\n")
    (reader := Reader(flightid)).follow(page)
    assert reader.lines == 1
    page.write_text(page.read_text().replace("6", "7"))
    with pytest.raises(AssertionError, match="'7' is not in"):
        Reader(flightid).follow(page)
    page.write_text("```sh\nmake install\n```\n")
    ((kind, snippet),) = snippets(page)
    assert not is_run(kind, snippet) and why_not_run(page, snippet) is None


@pytest.mark.parametrize("path", DOCUMENTS, ids=name_of)
def test_links_lead_somewhere(path: Path) -> None:
    for target in LINK.findall(path.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (path.parent / target).exists(), target


SECTIONS: dict[str, type[BaseModel]] = {
    "The file": schema.ScenarioTable,
    "`[flight]`": schema.FlightTable,
    "`[[flight.maneuvers]]`": schema.ManeuverTable,
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
    """The fields of a table but those that it takes over from another one, which are documented
    there.
    """
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
    assert documented(title) == {
        field.alias or name: shown(field.default) for name, field in own_fields(model).items()
    }


def test_every_scenario_is_listed_with_its_title_and_fits_a_terminal(flightid: CommandLine) -> None:
    text = (ROOT / "docs" / "scenarios.md").read_text(encoding="utf-8")
    section = text.split("\n## The built-in ones\n")[1].split("\n## ")[0]
    lines = flightid.done("list").splitlines()
    listed = [line.split(maxsplit=1) for line in lines]
    assert re.findall(r"^\| `(\S+)` \| (.*) \|$", section, re.MULTILINE) == [
        (name, title.strip()) for name, title in listed
    ]
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
        kind
        for kind in vars(schema).values()
        if isinstance(kind, type)
        and issubclass(kind, BaseModel)
        and kind not in (BaseModel, schema.Strict)
    }
    assert tables == set(SECTIONS.values())


def choices(annotation: object) -> tuple[str, ...]:
    if typing.get_origin(annotation) is typing.Literal:
        return typing.get_args(annotation)
    if isinstance(annotation, types.UnionType):
        return tuple(choice for part in typing.get_args(annotation) for choice in choices(part))
    return ()


def test_the_commands_of_the_reference_are_those_that_exist() -> None:
    listed = {
        function.__name__.rstrip("_") for functions in COMMANDS.values() for function in functions
    }
    text = (ROOT / "docs" / "reference.md").read_text(encoding="utf-8")
    assert {name for name in listed if f"| `flightid {name}" not in text} == set()
    assert set(re.findall(r"^\| `flightid (\w+)", text, re.MULTILINE)) <= listed
