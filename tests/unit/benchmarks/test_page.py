"""The page names who is behind whom, who is not installed and whose answer differs; the JSON holds
the same.
"""

from __future__ import annotations

import json
from importlib import metadata

import pytest

from benchmarks.comparison.compare import Result
from benchmarks.comparison.figure import drawn
from benchmarks.comparison.job import Agreement, Contender, Job
from benchmarks.comparison.machine import machine
from benchmarks.comparison.page import SCHEMA, Table, document, page, seconds, times
from benchmarks.comparison.timing import Quartiles

OURS = Contender("a", "flightid")
QUICK, SLOW, GONE, WRONG = (
    Contender("b", name) for name in ("quick peer", "slow peer", "gone peer", "wrong peer")
)
JOB = Job(
    "job",
    "A job",
    "Some\nwork.",
    OURS,
    (QUICK, SLOW, GONE, WRONG),
    lambda small: {},
    lambda *all: Agreement("", True),
)
MACHINE = {"processor": "a machine", "date": "2026-01-02"}


def spread(value: float) -> Quartiles:
    return Quartiles(value, 0.9 * value, 1.1 * value, 5)


def result(contender: Contender, ratio: float, agreement: Agreement | None = None) -> Result:
    near = agreement or Agreement("rounding apart", True)
    return Result(
        contender, "", near, spread(0.01 * ratio), spread(1.0), spread(ratio), spread(2.0), 50.0
    )


RESULTS = (
    result(OURS, 1.0),
    result(QUICK, 0.5),
    result(SLOW, 7.0),
    Result(GONE, "gone not installed"),
    result(WRONG, 3.0, Agreement("9 sigma apart", False)),
)


def test_the_page_says_who_is_ahead_and_who_is_not() -> None:
    text = page(MACHINE, [(JOB, RESULTS)], [])
    behind = text.split("## Where flightid is behind")[1].split("## A job")[0]
    assert "behind quick peer" in behind and "0.5 (0.45-0.55)" in behind
    assert "slow peer" not in behind and "gone peer" not in behind
    assert "wrong peer" in behind.split("Not the same answer")[1]
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    assert any(line.startswith("| gone peer | gone not installed |") for line in rows)
    assert any("**not the same**: 9 sigma apart" in line for line in rows)
    assert any(line == "| processor | a machine |" for line in rows)
    assert "Some work." in text


def test_the_figure_has_a_row_for_each_peer_that_was_measured() -> None:
    few, many = (drawn([(JOB, results)]) for results in (RESULTS[:2], RESULTS))
    heights = [int.from_bytes(each[20:24], "big") for each in (few, many)]
    assert few.startswith(b"\x89PNG") and heights[1] - heights[0] == pytest.approx(
        2 * 0.36 * 110, abs=2
    )


def test_every_row_has_the_cells_of_its_head() -> None:
    table = Table("More", "About it.", ("one", "two"), (("a|b", "c"),), {"n": 1})
    lines = page(MACHINE, [(JOB, RESULTS)], [table]).splitlines()
    cells = 0
    for line in lines:
        if not line.startswith("|"):
            cells = 0
        elif cells:
            assert line.count("|") == cells, line
        else:
            cells = line.count("|")
    assert "| a/b | c |" in lines


def test_the_document_holds_the_same_numbers() -> None:
    found = json.loads(document(MACHINE, [(JOB, RESULTS)], [Table("More", "", ("x",), (), [1, 2])]))
    assert (
        found["schema"] == SCHEMA
        and found["tables"] == {"More": [1, 2]}
        and found["machine"] == MACHINE
    )
    quick, gone = found["jobs"][0]["contenders"][1], found["jobs"][0]["contenders"][3]
    assert quick["warm_ratio"]["median"] == 0.5 and quick["same_answer"] is True
    assert gone["absent"] == "gone not installed" and gone["warm_s"] is None


@pytest.mark.parametrize(
    ("value", "text"),
    [(2.345, "2.35 s"), (0.0123, "12.3 ms"), (4.56e-5, "45.6 us"), (1e-3, "1 ms")],
)
def test_times_have_a_unit(value: float, text: str) -> None:
    assert seconds(value) == text


def test_a_single_round_has_no_spread() -> None:
    assert times(Quartiles(123.4, 123.4, 123.4, 1)) == "123"
    assert times(None) == ""


def test_who_is_not_installed_says_what_is_missing() -> None:
    assert (
        Contender("b", "peer", "no-such-package", ("numpy", "no_such_package")).absent
        == "no_such_package not installed"
    )
    assert Contender("b", "peer", missing=lambda: "no C compiler").absent == "no C compiler"
    assert Contender("b", "peer", "numpy", ("numpy",)).absent == ""
    assert (
        Contender("b", "peer", "no-such-package").version
        == ""
        != Contender("b", "peer", "numpy").version
    )


def test_the_machine_is_told_with_its_versions() -> None:
    found = machine()
    assert found["numpy"] == metadata.version("numpy") and found["Python"].startswith("3.")
    assert all(isinstance(value, str) and value for value in found.values())
