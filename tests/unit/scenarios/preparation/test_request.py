"""Proposed commands read the records as the command that proposes them did."""

from __future__ import annotations

from pathlib import Path

from scenarios.preparation.plan import Request, plan_of, reading_options


def test_options_of_a_reading_are_those_that_were_given() -> None:
    plan = plan_of([1.0, 20.5], [12.0, 30.0], "linear", 50.0, 8.0, trusted=True, columns="time, q")
    request = Request((Path("a.txt"),), channels=Path("map.toml"), plan=plan)
    channels, columns, rate = ["--channels", "map.toml"], ["--columns", "time,q"], ["--rate", "50"]
    parts = ["--from", "1", "--to", "12", "--from", "20.5", "--to", "30", "--hold", "linear"]
    every = [*channels, *parts, *rate, "--lowpass", "8", *columns, "--trust-record"]
    assert reading_options(request) == every
    assert reading_options(request, opening=True) == [*channels, *rate, *columns]
    assert reading_options(request, opening=True, rate=False) == [*channels, *columns]
    assert reading_options(Request((Path("a.csv"),))) == []


def test_a_part_with_one_end_has_one_option() -> None:
    assert reading_options(Request((Path("a.csv"),), plan=plan_of([3.0]))) == ["--from", "3"]
