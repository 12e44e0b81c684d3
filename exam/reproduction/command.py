"""Studies of the page on the two papers, and its command.

``python -m exam papers-page [--studies DIR] [--page FILE.md] [--kept] [--jobs N]`` writes the page.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from exam.options import Parser
from exam.reproduction.declaration import PAPERS, Paper, paper_of
from exam.reproduction.lookups import (
    Found,
    Numbers,
    from_file,
    from_studies,
    keeping,
    kept_text,
    split,
)
from exam.reproduction.page import page_of
from sim.errors import DeclarationError, FlightidError

# ---- The studies of the page


def scenarios_of(papers: Iterable[Paper]) -> tuple[str, ...]:
    """Return the names of the scenarios that a page of these papers needs, sorted."""
    return tuple(
        sorted({split(f"{study}: any")[0] for paper in papers for study in studies_of(paper)})
    )


def studies_of(paper: Paper) -> Iterator[str]:
    """Return every ``SCENARIO`` or ``SCENARIO/METHOD`` that a paper's declaration names."""
    for part in paper.parts:
        yield from (group.study for group in part.values)
        yield from (matrix.study for matrix in part.matrices)
        for statement in part.statements:
            yield from (
                study
                for lookup in statement.numbers.values()
                for study in re.findall(r"([\w/-]+): ", lookup)
            )
            if statement.figure:
                yield statement.figure.partition("/")[0]


def study_in(folder: Path, name: str) -> Path:
    """Return the study folder of a scenario in ``folder``; run it with its own seed if it is
    missing.

    Raises
    ------
    DeclarationError : it cannot be run, or another study lies there.
    """
    place = folder / name
    main = place / "comparison.json"
    if not main.is_file():
        ran = subprocess.run(
            [sys.executable, "-m", "scenarios", "run", name, "--out", str(place)],
            capture_output=True,
            text=True,
            check=False,
        )
        if ran.returncode:
            told = ran.stderr.strip().splitlines() or ["no word of it"]
            raise DeclarationError(
                told[-1], where=f"flightid run {name}", remedy="see what the command says"
            )
    found = json.loads(main.read_text(encoding="utf-8")).get("scenario")
    if found != name:
        raise DeclarationError(
            f"the study of {found} lies there",
            where=str(place),
            remedy="name a folder with studies by their scenarios' names",
        )
    return place


def run_all(folder: Path, names: Iterable[str], jobs: int) -> Iterator[str]:
    """Run missing studies, ``jobs`` at a time; yield each name when its study exists, in order."""
    names = tuple(names)
    with ThreadPoolExecutor(jobs) as pool:
        for name, _ in zip(names, pool.map(partial(study_in, folder), names), strict=True):
            yield name


# ---- Write the page

PAGE = Path("docs/papers.md")


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the page and, beside it, its numbers as JSON; return 2 with one line if the declaration
    or a study is wrong.
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
    """Run the studies that ``folder`` lacks, then write the page and its numbers. Raises
    DeclarationError if the declaration or a study is wrong.
    """
    names = scenarios_of(paper_of(name) for name in PAPERS)
    for done, name in enumerate(run_all(folder, names, jobs), start=1):
        print(f"{done} of {len(names)}: {name}", file=sys.stderr, flush=True)
    text, kept = written(from_studies(lambda scenario: folder / scenario))
    page.with_suffix(".json").write_text(kept_text(kept), encoding="utf-8", newline="\n")
    page.write_text(text, encoding="utf-8", newline="\n")


def written(numbers: Numbers) -> tuple[str, dict[str, Found]]:
    """Return the page's text, and every number that it needs."""
    kept: dict[str, Found] = {}
    return page_of([paper_of(name) for name in PAPERS], keeping(numbers, kept)), kept
