"""Write the page: ``python -m exam coverage [--page FILE.md] [--kept] [--only SCENARIO] [--jobs
N]``.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from exam.coverage.measured import measured
from exam.coverage.page import page_of
from exam.coverage.plan import RUNS
from exam.options import Parser
from sim.errors import FlightidError

PAGE = Path("docs/campaign-statistics.md")


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is asked, keep the numbers beside the page after each campaign, and write the
    page; 2 with one line where that fails.
    """
    parser = Parser("coverage", "coverage of the sigmas of every scenario")
    parser.add_argument(
        "--page",
        type=Path,
        default=PAGE,
        help=f"the page; its numbers go beside it as .json (default: {PAGE})",
    )
    parser.add_argument(
        "--kept",
        action="store_true",
        help="run nothing: write the page anew from the numbers beside it",
    )
    parser.add_argument(
        "--only",
        action="append",
        metavar="SCENARIO",
        help="measure these alone, and keep what is there of the others",
    )
    parser.add_argument("--jobs", type=int, default=None, help="processes (default: one a core)")
    asked = parser.parse_args(arguments)
    numbers: Path = asked.page.with_suffix(".json")
    try:
        found = _kept(numbers) if asked.kept or asked.only else {}
        for name, method in () if asked.kept else RUNS:
            if asked.only is None or name in asked.only:
                print(f"{name}, {method}", file=sys.stderr, flush=True)
                found[name, method] = measured(name, method, RUNS[name, method], asked.jobs)
                _keep(numbers, found)
        asked.page.write_text(page_of(_ordered(found)), encoding="utf-8", newline="\n")
    except (FlightidError, OSError, ValueError, KeyError) as error:
        print(f"python -m exam coverage: {error}", file=sys.stderr)
        return 2
    print(f"written: {asked.page}")
    return 0


def _kept(numbers: Path) -> dict[tuple[str, str], dict[str, Any]]:
    if not numbers.is_file():
        return {}
    return {
        (each["scenario"], each["method"]): each
        for each in json.loads(numbers.read_text(encoding="utf-8"))["campaigns"]
    }


def _keep(numbers: Path, found: dict[tuple[str, str], dict[str, Any]]) -> None:
    numbers.write_text(
        json.dumps({"schema": "flightid/coverage/1", "campaigns": _ordered(found)}, indent=1)
        + "\n",
        encoding="utf-8",
        newline="\n",
    )


def _ordered(found: dict[tuple[str, str], dict[str, Any]]) -> list[dict[str, Any]]:
    """In the order of the plan; what is no longer in it is left out."""
    return [found[key] for key in RUNS if key in found]
