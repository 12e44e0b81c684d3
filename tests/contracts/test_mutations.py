"""The table of mutants fits the code as it is, and its runner sees a test that is missing."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.mutation.run import ROOT, Mutant, Result, mutated, run
from tests.mutation.table import MUTANTS

ROOMS = ("sim", "ident", "scenarios", "flightid", "exam")


@pytest.mark.parametrize("mutant", MUTANTS, ids=str)
def test_a_mutant_changes_one_place_of_a_file_that_still_is_python(mutant: Mutant) -> None:
    assert mutant.old != mutant.new
    ast.parse(mutated((ROOT / mutant.file).read_text(encoding="utf-8"), mutant))
    assert mutant.tests and all((ROOT / test).exists() for test in mutant.tests)


def test_no_mutant_is_listed_twice_and_every_room_has_some() -> None:
    assert len({(mutant.file, mutant.old, mutant.new) for mutant in MUTANTS}) == len(MUTANTS)
    assert {mutant.file.split("/")[0] for mutant in MUTANTS} == set(ROOMS)


@pytest.fixture
def tree(tmp_path: Path) -> Iterator[Path]:
    """A program of one line and its tests; the boundary has none."""
    for folder in ("room", "tests/unit/room"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "pytest.ini").write_text("[pytest]\npythonpath = .\n", encoding="utf-8")
    head = "from room.law import above\n\ndef test_it():\n"
    for file, text in {
        "room/law.py": "def above(x):\n    return x > 1.0\n",
        "tests/test_far.py": f"{head}    assert above(2.0)\n",
        "tests/unit/room/test_law.py": f"{head}    assert not above(0.5)\n",
    }.items():
        (tmp_path / file).write_text(text, encoding="utf-8")
    yield tmp_path


@pytest.mark.long
def test_the_runner_tells_killed_from_survived_and_broken(tree: Path) -> None:
    before = (tree / "room" / "law.py").read_text(encoding="utf-8")
    changes = {
        "x < 1.0": Result.KILLED,
        "x > 0.1": Result.KILLED_BY_NEIGHBOURS,
        "x >= 1.0": Result.SURVIVED,
        "x >": Result.BROKEN,
    }
    mutants = [Mutant("room/law.py", "x > 1.0", new, ("tests/test_far.py",)) for new in changes]
    absent = Mutant("room/law.py", "y > 1.0", "y", ("tests/test_far.py",))
    found = [(result, by) for _, result, by in run([*mutants, absent], tree)]
    assert [result for result, _ in found] == [*changes.values(), Result.BROKEN]
    assert found[0][1] == "tests/test_far.py::test_it"
    assert found[1][1] == "tests/unit/room/test_law.py::test_it"
    assert (tree / "room" / "law.py").read_text(encoding="utf-8") == before


@pytest.mark.long
def test_nothing_is_tried_with_tests_that_fail_anyway(tree: Path) -> None:
    failing = "def test_it():\n    assert False\n"
    (tree / "tests" / "test_far.py").write_text(failing, encoding="utf-8")
    mutant = Mutant("room/law.py", "x > 1.0", "x < 1.0", ("tests/test_far.py",))
    with pytest.raises(RuntimeError, match=r"test_far\.py::test_it\): mend them first"):
        next(run([mutant], tree))
