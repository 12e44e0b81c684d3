"""The runner writes one line a paper, the same for any number of processes but for the time it takes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ident.tracing.diagnosis import Verdict
from scenarios.trials.papers import examination, series
from scenarios.trials.papers.__main__ import main
from scenarios.trials.papers.examination import examine, write_paper
from scenarios.trials.papers.paper import Mark, Named, Paper
from scenarios.trials.papers.series import line_of
from sim.errors import RecordError
from tests.diagnoses import tracing_of

KEYS = {"statements", "seed", "model", "aircraft", "rate", "channels", "group", "hidden", "values", "verdict", "claims", "right", "wrong", "said"}


@pytest.fixture
def loop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(examination, "diagnose_files", lambda request: tracing_of(Verdict.CONSISTENT))


def without_time(text: str) -> list[dict]:
    return [{key: value for key, value in json.loads(line).items() if key != "seconds"} for line in text.splitlines()]


def lines(folder: Path) -> list[dict]:
    return without_time((folder / "papers.jsonl").read_text())


def marked(seed: int) -> Mark:
    paper = Paper(seed, "trainer", ("vane-offset",), frozenset({"vane-offset"}), False, ("alpha", "q"), 50.0, "rigid", "one effect")
    return Mark(paper, "traced", ("vane-offset",), True, False, {"Cm_q": 0.1 * seed}, 1.25, 3.0, ((Named("vane-offset", True),),))


def test_a_series_is_the_same_stopped_and_raised(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(series, "examine", marked)
    assert main(["20", "1", "--jobs", "1", "--out", str(tmp_path / "grown")]) == 0
    assert main(["20", "2", "--jobs", "1", "--out", str(tmp_path / "grown"), "--resume"]) == 0
    told = capsys.readouterr().out
    assert "within 2 sigmas" in told and told.endswith("2 of 2 papers, seeds from 20\n")
    assert [line["seed"] for line in lines(tmp_path / "grown")] == [20, 21]
    assert lines(tmp_path / "grown")[1] == without_time(json.dumps(line_of(marked(21))))[0]
    assert all(set(line) == KEYS | {"held_out_error", "errors_in_sigmas"} for line in lines(tmp_path / "grown"))
    with pytest.raises(SystemExit) as fault:
        main(["21", "2", "--out", str(tmp_path / "grown"), "--resume"])
    assert fault.value.code == 2 and "another study" in capsys.readouterr().err


@pytest.mark.slow
def test_a_series_is_the_same_for_any_number_of_processes(tmp_path: Path) -> None:
    for jobs in ("1", "2"):
        assert main(["20", "3", "--jobs", jobs, "--out", str(tmp_path / jobs)]) == 0
    assert lines(tmp_path / "1") == lines(tmp_path / "2")


@pytest.mark.slow
def test_a_mark_says_what_the_paper_hides(loop: None, tmp_path: Path) -> None:
    mark = examine(21)
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
        main([*words, "--out", str(tmp_path / "none")])
    assert fault.value.code == 2


@pytest.mark.slow
def test_a_paper_is_diagnosed_and_marked() -> None:
    mark, again = examine(31), examine(31)
    assert mark.seconds > 0.0 and mark.held_out > 0.0
    assert (mark.verdict, mark.claims, mark.errors, mark.held_out) == (again.verdict, again.claims, again.errors, again.held_out)
