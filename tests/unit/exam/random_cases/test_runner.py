"""The runner writes one line a case, the same for any number of processes but for the time it
takes.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from exam.random_cases import examination
from exam.random_cases.case import Case, CaseScore, Named
from exam.random_cases.examination import (
    examine,
    line_of,
    random_cases,
    score,
    score_of_line,
    write_case,
)
from exam.random_cases.kinds import KINDS
from ident.tracing.diagnosis import Verdict
from sim.errors import RecordError
from tests.diagnoses import tracing_of

KEYS = {
    "statements",
    "seed",
    "model",
    "aircraft",
    "rate",
    "channels",
    "group",
    "hidden",
    "values",
    "verdict",
    "claims",
    "right",
    "wrong",
    "said",
}


@pytest.fixture
def loop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        examination, "diagnose_files", lambda request: tracing_of(Verdict.CONSISTENT)
    )


def without_time(text: str) -> list[dict]:
    return [
        {key: value for key, value in json.loads(line).items() if key != "seconds"}
        for line in text.splitlines()
    ]


def lines(folder: Path) -> list[dict]:
    return without_time((folder / "cases.jsonl").read_text())


def scored(seed: int, group: str = "") -> CaseScore:
    case = Case(
        seed,
        "trainer",
        ("vane-offset",),
        frozenset({"vane-offset"}),
        False,
        ("alpha", "q"),
        50.0,
        "rigid",
        "one effect",
    )
    return CaseScore(
        case,
        "traced",
        ("vane-offset",),
        True,
        False,
        {"Cm_q": 0.1 * seed},
        1.25,
        3.0,
        ((Named("vane-offset", True),),),
    )


def test_a_series_is_the_same_stopped_and_raised(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(examination, "examine", scored)
    assert random_cases(["20", "1", "--jobs", "1", "--out", str(tmp_path / "grown")]) == 0
    assert (
        random_cases(["20", "2", "--jobs", "1", "--out", str(tmp_path / "grown"), "--resume"]) == 0
    )
    told = capsys.readouterr().out
    assert "within 2 sigmas" in told and told.endswith("2 of 2 cases, seeds from 20\n")
    assert [line["seed"] for line in lines(tmp_path / "grown")] == [20, 21]
    assert lines(tmp_path / "grown")[1] == without_time(json.dumps(line_of(scored(21))))[0]
    assert all(
        set(line) == KEYS | {"held_out_error", "errors_in_sigmas"}
        for line in lines(tmp_path / "grown")
    )
    assert random_cases(["21", "2", "--out", str(tmp_path / "grown"), "--resume"]) == 2
    said = capsys.readouterr().err
    assert (
        said.startswith("python -m exam random: ")
        and "another study" in said
        and said.count("\n") == 1
    )


def test_the_tables_come_again_from_the_files(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(examination, "examine", scored)
    for first in ("20", "40"):
        assert random_cases([first, "2", "--jobs", "1", "--out", str(tmp_path / first)]) == 0
    told = capsys.readouterr().out
    files = [str(tmp_path / first / "cases.jsonl") for first in ("20", "40")]
    assert score(files[:1]) == 0
    assert told.startswith(capsys.readouterr().out.removesuffix("2 cases\n"))
    assert score(files) == 0 and capsys.readouterr().out.endswith("4 cases\n")
    assert score_of_line(json.loads(Path(files[0]).read_text().splitlines()[1])) == scored(21)
    (tmp_path / "other.jsonl").write_text('{"seed": 3}\n')
    (tmp_path / "broken.jsonl").write_text("{\n")
    for name in ("other", "broken"):
        assert score([str(tmp_path / f"{name}.jsonl")]) == 2
        said = capsys.readouterr().err
        assert "name a file that python -m exam random wrote" in said and said.count("\n") == 1


@pytest.mark.long
@pytest.mark.parametrize("group", ["foreign", "recorder"])
def test_a_group_that_is_asked_for_is_drawn(group: str, tmp_path: Path) -> None:
    case = write_case(11, tmp_path, group).case
    (name,) = case.hidden
    assert KINDS[name].group == group == case.group
    assert case.model == write_case(11, tmp_path).case.model  # all else is the seed's


@pytest.mark.slow
def test_a_series_is_the_same_for_any_number_of_processes(tmp_path: Path) -> None:
    for jobs in ("1", "2"):
        assert random_cases(["20", "3", "--jobs", jobs, "--out", str(tmp_path / jobs)]) == 0
    assert lines(tmp_path / "1") == lines(tmp_path / "2")


@pytest.mark.slow
def test_a_score_says_what_the_case_hides(loop: None, tmp_path: Path) -> None:
    score = examine(21)
    written = write_case(21, tmp_path)
    assert score.case == written.case and score.values == written.values


def test_a_refused_case_is_told_without_the_name_of_its_folder(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(request) -> None:
        raise RecordError("the sign is turned", where=str(request.records[0]))

    monkeypatch.setattr(examination, "diagnose_files", refuse)
    assert examine(22).said == examine(22).said == "train.csv: the sign is turned"


@pytest.mark.parametrize(
    "words", [["-1", "3"], ["1", "0"], ["1", "2", "--jobs", "0"], ["one", "2"]]
)
def test_bad_numbers_are_refused(words: list[str], tmp_path: Path) -> None:
    try:
        code: object = random_cases([*words, "--out", str(tmp_path / "none")])
    except SystemExit as fault:
        code = fault.code
    assert code == 2 and not (tmp_path / "none").exists()


@pytest.mark.slow
def test_a_case_is_diagnosed_and_scored() -> None:
    score, again = examine(31), examine(31)
    assert score.seconds > 0.0 and score.held_out > 0.0
    assert (score.verdict, score.claims, score.errors, score.held_out) == (
        again.verdict,
        again.claims,
        again.errors,
        again.held_out,
    )
