"""Two checkouts compared: which differences of their documents count."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.same_numbers import content, differences


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ({"a": 1.0}, {"a": 1.0 + 1e-8}),
        ({"a": 1.0}, {}),
        ({"a": [1.0, 2.0]}, {"a": [1.0]}),
        ({"a": "word"}, {"a": "other"}),
        ({"a": None}, {"a": 0.0}),
    ],
)
def test_a_difference_is_named_by_its_place(old: object, new: object) -> None:
    (line,) = differences(old, new, "study.json")
    assert line.startswith("study.json/a:")


def test_rounding_and_times_do_not_count() -> None:
    old = {"a": 1.0, "nothing": float("nan"), "seconds": 3.0, "b": [{"version": "1"}]}
    new = {"a": 1.0 + 1e-12, "nothing": float("nan"), "seconds": 9.0, "b": [{"version": "2"}]}
    assert list(differences(old, new, "")) == []


def test_a_number_that_is_none_any_more_is_a_difference() -> None:
    assert list(differences({"a": float("nan")}, {"a": 1.0}, ""))
    assert list(differences({"a": 1.0}, {"a": float("nan")}, ""))


def test_folders_that_are_made_for_a_run_count_as_one(tmp_path: Path) -> None:
    table = tmp_path / "table.csv"
    table.write_text("time,file\n0.5,scratch/flightid-ab12cd34/x.csv\n")
    assert content(table) == [["time", "file"], [0.5, "scratch/flightid-/x.csv"]]
