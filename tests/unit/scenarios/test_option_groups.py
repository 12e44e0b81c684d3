"""Options that several commands share."""

from __future__ import annotations

import dataclasses
import inspect
from contextlib import nullcontext
from pathlib import Path

import pytest
import typer.main

from scenarios.cli import app
from scenarios.cli.application import refuse_foreign_digits
from scenarios.cli.model_commands import identify
from scenarios.cli.options import GROUPS, Output, Preparation, with_groups
from sim.errors import DeclarationError


def test_a_group_becomes_its_options_in_place() -> None:
    taken: list[object] = []

    def command(records: list[Path], *, preparation: Preparation, last: int = 3) -> None:
        taken.extend((records, preparation, last))

    opened = with_groups(command)
    names = [each.name for each in dataclasses.fields(Preparation)]
    assert list(inspect.signature(opened).parameters) == ["records", *names, "last"]
    opened([Path("a.csv")], rate=20.0, last=4)
    assert taken == [[Path("a.csv")], Preparation(rate=20.0), 4]


def test_the_groups_of_a_command_reach_the_shell() -> None:
    command = typer.main.get_command(app).commands["identify"]  # type: ignore[attr-defined]
    shown = {parameter.name for parameter in command.params}
    for group in GROUPS:
        assert {each.name for each in dataclasses.fields(group)} <= shown
    assert shown == set(inspect.signature(identify).parameters)


def test_a_folder_and_no_figures(tmp_path: Path) -> None:
    with Output(out=tmp_path, no_figures=True).writing() as told:
        assert told.out == tmp_path and told.figures == ()


@pytest.mark.parametrize(
    ("words", "refused"),
    [
        (["maneuvers", "--rate", "1_0", "flight.csv"], True),
        (["maneuvers", "--rate", "5", "1_0"], False),  # the name of a file
        (["response", "--band", "0.5", "1_0", "flight.csv"], True),
        (["response", "--band=0.5", "1_0"], False),
        (["response", "--input", "1_0", "flight.csv"], False),  # the name of a column
    ],
)
def test_only_numbers_of_options_must_be_plain(words: list[str], refused: bool) -> None:
    with pytest.raises(DeclarationError, match="1_0") if refused else nullcontext():
        refuse_foreign_digits(words)
