"""The command line of the examinations: what there is, and what is typed wrong."""

from __future__ import annotations

import pytest

from exam.__main__ import EXAMINATIONS, main
from scenarios.studies import catalogue


def test_help_names_every_examination(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    told = [
        line.split()[0] for line in capsys.readouterr().out.splitlines() if line.startswith("  ")
    ]
    assert told == [*EXAMINATIONS]


@pytest.mark.parametrize("name", [*EXAMINATIONS])
def test_every_examination_says_what_it_takes(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    assert ended.value.code == 0 and capsys.readouterr().out.startswith(
        f"usage: python -m exam {name} "
    )


def test_an_unknown_name_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rando"]) == 2
    assert capsys.readouterr() == (
        "",
        "python -m exam: there is no examination 'rando'; did you mean 'random'?\n",
    )


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("random", "1"), "the following arguments are required: COUNT, --out"),
        (("clean", "--runs", "two"), "argument --runs: invalid int value: 'two'"),
        (("clean", "--runs", "2", "--seed", "-3"), "argument --seed"),
        (("every-effect",), "give one of --runs and --only"),
        (("every-effect", "--runs", "2", "--only", "1"), "give one of --runs and --only"),
        (("every-effect", "--only", "-1"), "--only takes a number of 0 or more"),
        (("every-effect", "--effects", "vanes", "--runs", "2"), "there is no effect 'vanes'"),
        (("hidden-effects", "trace-vain", "--runs", "2"), "there is no scenario 'trace-vain'"),
        (("hidden-effects", "rigid", "--runs", "2"), "rigid.toml"),
        (("hidden-effects", "trace-vane", "--runs", "2", "--figures", "bmp"), "'bmp' is no format"),
    ],
)
def test_what_is_typed_wrong_is_one_line(
    words: tuple[str, ...], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        code: object = main(words)
    except SystemExit as ended:
        code = ended.code
    said = capsys.readouterr()
    assert code == 2 and said.out == "" and told in said.err and said.err.count("\n") == 1


def test_what_moved_leads_to_an_examination() -> None:
    assert {*catalogue.EXAMINATIONS.values()} <= {*EXAMINATIONS}
    assert not {*catalogue.EXAMINATIONS} & {*catalogue.scenario_names()}


def test_an_examination_that_is_stopped_says_so_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stopped(rest: list[str]) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr("exam.independent.command.main", stopped)
    assert main(["independent"]) == 130
    printed = capsys.readouterr()
    assert printed.err == "python -m exam: ended before it was done\n" and not printed.out
