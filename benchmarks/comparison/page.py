"""docs/performance.md and performance.json from the results of a run."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from benchmarks.comparison.compare import Result, result_json
from benchmarks.comparison.job import Job
from benchmarks.comparison.timing import Quartiles

SCHEMA = "flightid/performance/1"
COMMAND = "python -m benchmarks"


@dataclass(frozen=True)
class Table:
    """One table of the page under a heading, with a sentence before it; ``data`` is what
    performance.json keeps of it.
    """

    title: str
    about: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    data: Any = field(default=None)


FIGURE = "![Times of the others over flightid's](performance.png)"
Compared = Sequence[tuple[Job, Sequence[Result]]]


def seconds(value: float) -> str:
    """A time with three digits and the unit that suits it."""
    if value >= 1.0:
        return f"{value:.3g} s"
    return f"{1e3 * value:.3g} ms" if value >= 1e-3 else f"{1e6 * value:.3g} us"


def times(ratio: Quartiles | None) -> str:
    """A ratio with its quartiles, e.g. `2.1 (2.0-2.2)`."""
    if ratio is None:
        return ""
    if ratio.number < 2:
        return _digits(ratio.median)
    return f"{_digits(ratio.median)} ({_digits(ratio.lower)}-{_digits(ratio.upper)})"


def page(machine: Mapping[str, str], compared: Compared, others: Sequence[Table]) -> str:
    """The page."""
    lines = ["# Performance", "", _introduction(), "", *_machine(machine)]
    lines += ["", *_standing(compared), "", FIGURE] if compared else []
    for job, results in compared:
        lines += [
            "",
            f"## {job.title}",
            "",
            _flat(job.about),
            "",
            *_table(HEAD, [_row(each, each.contender is job.ours) for each in results]),
        ]
    for table in others:
        lines += [
            "",
            f"## {table.title}",
            "",
            _flat(table.about),
            "",
            *_table(table.head, table.rows),
        ]
    return "\n".join(lines) + "\n"


def document(machine: Mapping[str, str], compared: Compared, others: Sequence[Table]) -> str:
    """The same numbers as JSON."""
    jobs = [
        {
            "name": job.name,
            "title": job.title,
            "contenders": [result_json(each) for each in results],
        }
        for job, results in compared
    ]
    content = {
        "schema": SCHEMA,
        "machine": dict(machine),
        "jobs": jobs,
        "tables": {table.title: table.data for table in others},
    }
    return json.dumps(content, indent=1) + "\n"


HEAD = (
    "program",
    "warm",
    "warm, times flightid",
    "cold",
    "cold, times flightid",
    "memory, MiB",
    "answer",
)


def _introduction() -> str:
    return _flat(f"""
        Written by `{COMMAND}` ([how](../benchmarks/README.md)), the numbers also as [performance.json](performance.json). All programs of a table
        did the same work in one run, in turn, with one thread each. *Warm* is a call in a process that has done it before, *cold* a whole process:
        start, imports, compilation, one call. Ratios are the other's time over flightid's, round by round, the median with its quartiles: above 1
        flightid is ahead. Quote ratios; times are of this machine. *Memory* is the peak of the cold process. *Answer* says how near the answers are.
        """)  # noqa: E501


def _machine(machine: Mapping[str, str]) -> list[str]:
    return _table(("machine", ""), [(name, value) for name, value in machine.items()])


def _standing(compared: Compared) -> list[str]:
    """Where flightid is behind or level, and where an answer differs."""
    lines = ["## Where flightid is behind", ""]
    behind = []
    for job, results in compared:
        for each in results[1:]:
            for way, ratio in (("warm", each.warm_ratio), ("cold", each.cold_ratio)):
                if ratio is not None and ratio.lower <= 1.0:
                    word = "behind" if ratio.upper < 1.0 else "level with"
                    behind.append(
                        f"- {job.title}, {way}: {word} {each.contender.label}, which takes "
                        f"{times(ratio)} times as long."
                    )
    lines += behind or ["Nowhere in this run."]
    apart = [
        f"- {job.title}: {each.contender.label}."
        for job, results in compared
        for each in results[1:]
        if not each.agreement.near
    ]
    return (
        lines
        if not apart
        else [
            *lines,
            "",
            "Not the same answer within the stated tolerance, so that times do not compare:",
            "",
            *apart,
        ]
    )


def _row(result: Result, ours: bool) -> tuple[str, ...]:
    name = result.contender.label
    if result.absent or result.warm is None or result.cold is None:
        return (name, result.absent, "", "", "", "", "")
    share = result.contender.share
    label = name if share == 1.0 else f"{name}, scaled from {share:.2g} of the work"
    ratios = ("1", "1") if ours else (times(result.warm_ratio), times(result.cold_ratio))
    answer = (
        ""
        if ours
        else result.agreement.said
        if result.agreement.near
        else f"**not the same**: {result.agreement.said}"
    )
    memory = "" if result.memory is None else f"{result.memory:.0f}"
    return (
        label,
        seconds(result.warm.median),
        ratios[0],
        seconds(result.cold.median),
        ratios[1],
        memory,
        answer,
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    def line(cells: Sequence[str]) -> str:
        return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"

    return [line(head), "|" + "---|" * len(head), *(line(row) for row in rows)]


def _digits(value: float) -> str:
    return f"{value:.0f}" if value >= 100.0 else f"{value:.2g}" if value < 10.0 else f"{value:.3g}"


def _flat(text: str) -> str:
    return " ".join(text.split())
