"""Write the page: ``python -m exam papers-page [--studies DIR] [--page FILE.md] [--kept] [--jobs
N]``.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from exam.options import Parser
from exam.reproduction.declaration import PAPERS, paper_of
from exam.reproduction.lookups import Found, Numbers, from_file, from_studies, keeping, kept_text
from exam.reproduction.page import page_of
from exam.reproduction.running import run_all, scenarios_of
from sim.errors import FlightidError

PAGE = Path("docs/papers.md")


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the page and, beside it, its numbers as JSON; 2 with one line where the declaration or
    a study is at fault.
    """
    parser = Parser("papers-page", "two papers, number by number")
    parser.add_argument(
        "--studies",
        type=Path,
        help="folder of study folders; what is missing is run into it (default: all are run)",
    )
    parser.add_argument(
        "--page",
        type=Path,
        default=PAGE,
        help="the page; its numbers go beside it as .json (default: docs/papers.md)",
    )
    parser.add_argument(
        "--kept",
        action="store_true",
        help="run nothing: take the numbers that lie beside the page, to write reasons anew",
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    asked = parser.parse_args(arguments)
    if asked.jobs < 1:
        parser.error("--jobs is 1 or more")
    try:
        if asked.kept:
            text, _ = written(from_file(asked.page.with_suffix(".json")))
            asked.page.write_text(text, encoding="utf-8", newline="\n")
        elif asked.studies is not None:
            make(asked.page, asked.studies, asked.jobs)
        else:
            with TemporaryDirectory() as folder:
                make(asked.page, Path(folder), asked.jobs)
    except (FlightidError, OSError) as error:
        print(f"python -m exam papers-page: {error}", file=sys.stderr)
        return 2
    print(f"written: {asked.page}")
    return 0


def make(page: Path, folder: Path, jobs: int = 1) -> None:
    """Run what ``folder`` lacks, then write the page and its numbers. Raises DeclarationError where
    the declaration or a study is at fault.
    """
    names = scenarios_of(paper_of(name) for name in PAPERS)
    for done, name in enumerate(run_all(folder, names, jobs), start=1):
        print(f"{done} of {len(names)}: {name}", file=sys.stderr, flush=True)
    text, kept = written(from_studies(lambda scenario: folder / scenario))
    page.with_suffix(".json").write_text(kept_text(kept), encoding="utf-8", newline="\n")
    page.write_text(text, encoding="utf-8", newline="\n")


def written(numbers: Numbers) -> tuple[str, dict[str, Found]]:
    """The page's text, and every number that it asked for."""
    kept: dict[str, Found] = {}
    return page_of([paper_of(name) for name in PAPERS], keeping(numbers, kept)), kept
