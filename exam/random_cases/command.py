"""Random cases by their seeds, and the tables of what was found in them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from exam.options import STOPPED, Parser, ended_in_one_line, manner_of
from exam.random_cases.case import CaseScore
from exam.random_cases.examination import GROUPS
from exam.random_cases.series import examined, line_of, score_of_line
from exam.random_cases.summary import reliability_table, summary_table
from scenarios.files.writing import write_text
from sim.errors import DeclarationError

LINES = "cases.jsonl"


def random_cases(arguments: Sequence[str] | None = None) -> int:
    """Cases whose model, vehicle, record and hidden cause are drawn from a seed."""
    return _examine("random", arguments)


def foreign_causes(arguments: Sequence[str] | None = None) -> int:
    """Random cases that hide a cause that no effect of the library names."""
    return _examine("foreign", arguments)


def recorder_faults(arguments: Sequence[str] | None = None) -> int:
    """Random cases that hide a fault of the recorder."""
    return _examine("recorder", arguments)


def _examine(name: str, arguments: Sequence[str] | None) -> int:
    """Examine COUNT cases from seed FIRST on.

    Each is kept as it is done; ``cases.jsonl`` has them in the order of the seeds.
    """
    parser = Parser(name, "random cases, one JSON line each")
    parser.add_argument("first", type=int, metavar="FIRST", help="the first seed")
    parser.add_argument("count", type=int, metavar="COUNT", help="how many seeds")
    parser.add_manner(out_required=True)
    asked = parser.parse_args(arguments)
    if asked.first < 0 or asked.count < 1:
        parser.error("FIRST is 0 or more, COUNT is 1 or more")
    group = name if name in GROUPS else ""

    def work() -> int:
        done = examined(asked.first, asked.count, manner_of(asked), group)
        lines = [json.dumps(line_of(score), allow_nan=False) + "\n" for score in done.found]
        write_text(asked.out / LINES, "".join(lines))
        _print_tables(done.found)
        print(f"{done.ended} of {done.asked} cases, {done.words}")
        return 0 if done.whole else STOPPED

    return ended_in_one_line(name, work)


def score(arguments: Sequence[str] | None = None) -> int:
    """Tables of random cases that were examined before, from the files of one or several series."""
    parser = Parser("score", "tables of random cases from their files")
    parser.add_argument("files", type=Path, nargs="+", metavar="CASES.jsonl")
    asked = parser.parse_args(arguments)

    def work() -> int:
        found = [each for file in asked.files for each in _read(file)]
        _print_tables(found)
        print(f"{len(found)} cases")
        return 0

    return ended_in_one_line("score", work)


def _read(file: Path) -> list[CaseScore]:
    try:
        lines = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    except ValueError as fault:
        what = f"this is not one JSON object a line: {fault}"
        remedy = "name a file that python -m exam random wrote"
        raise DeclarationError(what, where=str(file), remedy=remedy) from None
    return [score_of_line(line) for line in lines]


def _print_tables(found: Sequence[CaseScore]) -> None:
    if found:
        print("\n".join(summary_table(found)))
        statements = [statement for each in found for statement in each.statements]
        print("\n".join(reliability_table(statements)))
