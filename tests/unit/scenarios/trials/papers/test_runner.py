"""The runner writes one line a paper, the same for any number of workers but for the time it takes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ident.tracing.diagnosis import Verdict
from scenarios.trials.papers import examination
from scenarios.trials.papers.__main__ import main, marks_of
from scenarios.trials.papers.examination import examine, write_paper
from sim.errors import RecordError
from tests.diagnoses import tracing_of

KEYS = {"statements", "seed", "model", "aircraft", "rate", "channels", "group", "hidden", "values", "verdict", "claims", "right", "wrong", "said"}


@pytest.fixture
def loop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(examination, "diagnose_files", lambda request: tracing_of(Verdict.CONSISTENT))


def without_time(text: str) -> list[dict]:
    return [{key: value for key, value in json.loads(line).items() if key != "seconds"} for line in text.splitlines()]


@pytest.mark.slow
def test_lines_are_the_same_for_any_number_of_workers(loop: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for jobs in (1, 2):
        assert main(["20", "2", "--jobs", str(jobs), "--out", str(tmp_path / f"{jobs}.jsonl")]) == 0
    one, two = ((tmp_path / f"{jobs}.jsonl").read_text() for jobs in (1, 2))
    assert without_time(one) == without_time(two)
    assert [line["seed"] for line in without_time(one)] == [20, 21]
    assert all(set(line) == KEYS | {"held_out_error", "errors_in_sigmas"} for line in without_time(one))
    assert "within 2 sigmas" in capsys.readouterr().out


@pytest.mark.slow
def test_a_mark_says_what_the_paper_hides(loop: None, tmp_path: Path) -> None:
    mark = next(iter(marks_of(range(21, 22), 1)))
    written = write_paper(21, tmp_path)
    assert mark.paper == written.paper and mark.values == written.values


def test_a_refused_paper_is_told_without_the_name_of_its_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(request) -> None:
        raise RecordError("the sign is turned", where=str(request.records[0]))

    monkeypatch.setattr(examination, "diagnose_files", refuse)
    assert examine(22).said == examine(22).said == "train.csv: the sign is turned"


@pytest.mark.parametrize("words", [["-1", "3"], ["1", "0"], ["1", "2", "--jobs", "0"], ["one", "2"]])
def test_bad_numbers_are_refused(words: list[str], tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as fault:
        main([*words, "--out", str(tmp_path / "none.jsonl")])
    assert fault.value.code == 2


@pytest.mark.slow
def test_a_paper_is_diagnosed_and_marked() -> None:
    mark, again = examine(31), examine(31)
    assert mark.seconds > 0.0 and mark.held_out > 0.0
    assert (mark.verdict, mark.claims, mark.errors, mark.held_out) == (again.verdict, again.claims, again.errors, again.held_out)
