"""Papers by their seeds, and their table: ``python -m scenarios.trials.papers FIRST COUNT --out DIR [--jobs N | --cluster ADDRESS] [--resume]``."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from scenarios.files.writing import write_text
from scenarios.tasks.manner import Manner
from scenarios.trials.papers.series import examined, line_of
from scenarios.trials.papers.summary import reliability_table, summary_table
from sim.errors import FlightidError


def main(arguments: Sequence[str] | None = None) -> int:
    """Examine ``COUNT`` papers from seed ``FIRST`` on; each is kept as it is done, ``papers.jsonl`` has them in the order of the seeds."""
    parser = argparse.ArgumentParser(prog="python -m scenarios.trials.papers", description="random papers, one JSON line each")
    parser.add_argument("first", type=int, metavar="FIRST", help="the first seed")
    parser.add_argument("count", type=int, metavar="COUNT", help="how many seeds")
    parser.add_argument("--jobs", type=int, help="processes; left out, one for each core")
    parser.add_argument("--out", type=Path, required=True, help="folder of the papers: as they come in runs, all in papers.jsonl")
    parser.add_argument("--cluster", metavar="ADDRESS", help="work on a Dask cluster, by its scheduler's tcp://HOST:PORT")
    parser.add_argument("--resume", action="store_true", help="go on with what the folder holds")
    asked = parser.parse_args(arguments)
    if asked.first < 0 or asked.count < 1:
        parser.error("FIRST is 0 or more, COUNT is 1 or more")
    try:
        done = examined(asked.first, asked.count, Manner(asked.jobs, asked.out, asked.resume, asked.cluster))
    except FlightidError as fault:
        parser.exit(2, f"{fault}\n")
    except KeyboardInterrupt as ended:
        parser.exit(130, f"{ended}\n")
    write_text(asked.out / "papers.jsonl", "".join(json.dumps(line_of(mark), allow_nan=False) + "\n" for mark in done.found))
    if done.found:
        print("\n".join(summary_table(done.found)))
        print("\n".join(reliability_table([statement for mark in done.found for statement in mark.statements])))
    print(f"{done.ended} of {done.asked} papers, {done.words}")
    return 0 if done.whole else 130


if __name__ == "__main__":
    sys.exit(main())
