"""Papers one by one into a file, and their table: ``python -m scenarios.trials.papers FIRST COUNT --out FILE.jsonl [--jobs N]``."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from scenarios.trials.calibration import as_line
from scenarios.trials.papers.examination import examine
from scenarios.trials.papers.paper import Mark
from scenarios.trials.papers.summary import reliability_table, summary_table


def main(arguments: Sequence[str] | None = None) -> int:
    """Examine ``COUNT`` papers from seed ``FIRST`` on; each is written as it is done, in the order of the seeds, whoever works at it."""
    parser = argparse.ArgumentParser(prog="python -m scenarios.trials.papers", description="random papers, one JSON line each")
    parser.add_argument("first", type=int, metavar="FIRST", help="the first seed")
    parser.add_argument("count", type=int, metavar="COUNT", help="how many seeds")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, required=True, help="JSON lines, one a paper")
    asked = parser.parse_args(arguments)
    if asked.first < 0 or asked.count < 1 or asked.jobs < 1:
        parser.error("FIRST is 0 or more, COUNT and --jobs are 1 or more")
    marks: list[Mark] = []
    with asked.out.open("w", encoding="utf-8") as file:
        for mark in marks_of(range(asked.first, asked.first + asked.count), asked.jobs):
            marks.append(mark)
            file.write(json.dumps(line_of(mark), allow_nan=False) + "\n")
            file.flush()
            print(f"\r{len(marks)} of {asked.count} papers", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    print("\n".join(summary_table(marks)))
    print("\n".join(reliability_table([statement for mark in marks for statement in mark.statements])))
    return 0


def marks_of(seeds: range, jobs: int) -> Iterator[Mark]:
    """Marks in the order of their seeds, each as soon as it and those before it are there."""
    if jobs == 1:
        yield from map(examine, seeds)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(examine, seeds)


def line_of(mark: Mark) -> Mapping[str, Any]:
    """What one line of the file holds; a number that is not finite is left out."""
    paper = mark.paper
    return {
        **{"seed": paper.seed, "model": paper.model, "aircraft": paper.aircraft, "rate": paper.rate, "channels": paper.channels},
        **{"group": paper.group, "hidden": paper.hidden, "values": mark.values, "verdict": mark.verdict},
        "claims": [[{"name": named.name, "hidden": named.hidden} for named in claim] for claim in mark.claims],
        "statements": [as_line(statement) for statement in mark.statements],
        **{"right": mark.right, "wrong": mark.wrong, "said": mark.said},
        "held_out_error": mark.held_out if math.isfinite(mark.held_out) else -1.0,
        "errors_in_sigmas": {name: error for name, error in mark.errors.items() if math.isfinite(error)},
        "seconds": mark.seconds,
    }


if __name__ == "__main__":
    sys.exit(main())
