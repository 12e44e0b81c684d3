"""Study folders: whole or not at all, ours replaced, the user's left alone."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path
from typing import Any

import pytest

from scenarios.files.writing import study_folder, write_json
from sim.errors import FlightidError

MAIN = "comparison.json"


def study(path: Path, *names: str, main: str = MAIN, mark: int = 0) -> None:
    with study_folder(path, main) as folder:
        for name in names:
            (folder / name).write_text(str(mark))
        write_json(folder / main, {"schema": "flightid/comparison/1", "mark": mark})


def names(path: Path) -> list[str]:
    return sorted(entry.name for entry in path.iterdir())


def test_a_missing_folder_is_made(tmp_path: Path) -> None:
    study(tmp_path / "a" / "b", "x.png")
    assert names(tmp_path / "a" / "b") == [MAIN, "x.png"] and names(tmp_path / "a") == ["b"]
    assert json.loads((tmp_path / "a" / "b" / MAIN).read_text())["files"] == [MAIN, "x.png"]


def test_an_older_run_is_replaced_and_other_files_are_left_alone(tmp_path: Path) -> None:
    target = tmp_path / "out"
    study(target, "x.png", "y.png", mark=1)
    study(target, "y.png", "p.csv", main="diagnosis.json", mark=2)
    (target / "notes.md").write_text("mine")
    (target / "z.png").write_text("mine")
    study(target, "w.png", mark=3)
    # y.png is the diagnosis's too
    assert names(target) == [MAIN, "diagnosis.json", "notes.md", "p.csv", "w.png", "y.png", "z.png"]
    assert json.loads((target / MAIN).read_text())["mark"] == 3
    assert (target / "y.png").read_text() == "2"
    assert names(tmp_path) == ["out"]


def test_a_manifest_names_nothing_outside(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    (tmp_path / "out").mkdir()
    write_json(
        tmp_path / "out" / MAIN,
        {
            "schema": "flightid/comparison/1",
            "files": ["../mine.txt", str(tmp_path / "mine.txt"), "..", ""],
        },
    )
    study(tmp_path / "out")
    assert names(tmp_path) == ["mine.txt", "out"]


def test_another_programs_json_lists_nothing_of_ours(tmp_path: Path) -> None:
    for text in ('{"files": ["mine.txt"]}', "[]", "no json"):
        (tmp_path / "mine.txt").write_text("mine")
        (tmp_path / MAIN).write_text(text)
        study(tmp_path)
        assert "mine.txt" in names(tmp_path)


@pytest.mark.parametrize("existing", [False, True])
def test_a_failure_leaves_nothing_behind(tmp_path: Path, existing: bool) -> None:
    target = tmp_path / "deep" / "out"
    if existing:
        study(target, "x.png", mark=1)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with pytest.raises(KeyboardInterrupt), study_folder(target, MAIN) as folder:
        (folder / "x.png").write_text("2")
        raise KeyboardInterrupt
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    assert names(tmp_path) == (["deep"] if existing else [])


def test_main_is_renamed_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    moved: list[str] = []
    plain = os.replace

    def watched(source: Any, target: Any) -> None:
        if Path(target).parent == tmp_path / "out":
            moved.append(Path(target).name)
        plain(source, target)

    monkeypatch.setattr(os, "replace", watched)
    study(tmp_path / "out", "z.png", "a.json")
    assert moved == ["z.png", "a.json", MAIN]


def test_a_folder_on_another_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = os.replace

    def across(source: Any, target: Any) -> None:
        if Path(source).parent != Path(target).parent:
            raise OSError(errno.EXDEV, "Invalid cross-device link")
        plain(source, target)

    monkeypatch.setattr(os, "replace", across)
    study(tmp_path / "out", "x.png")
    assert names(tmp_path / "out") == [MAIN, "x.png"] and names(tmp_path) == ["out"]


def test_folders_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "out" / "x.png").mkdir(parents=True)
    for path, part in (
        (tmp_path / "file", "not a folder"),
        (tmp_path / "file" / "sub", "cannot be written"),
        (tmp_path / "out", "there is a folder with the name"),
    ):
        with pytest.raises(FlightidError) as caught:
            study(path, "x.png")
        message = str(caught.value)
        assert (
            "\n" not in message and str(path) in message and part in message and caught.value.remedy
        )
    assert names(tmp_path) == ["file", "out"] and names(tmp_path / "out") == ["x.png"]


def test_a_study_without_its_main_file_is_a_mistake_of_ours(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="did not write"), study_folder(tmp_path / "out", MAIN):
        pass
    assert names(tmp_path) == []


@pytest.mark.parametrize(
    "wrong", [["input-delay:rudder.png"], ["over_mach.png", "over_Mach.png"], ["aux.csv"]]
)
def test_files_that_another_system_has_not_are_no_study(wrong: list[str], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"name of the file|upper and lower case"):
        study(tmp_path / "out", *wrong)
    assert names(tmp_path) == []
