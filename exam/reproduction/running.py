"""The studies of the page: those that are there, and those that are run, each as a user would."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from exam.reproduction.declaration import Paper
from exam.reproduction.lookups import split
from sim.errors import DeclarationError


def scenarios_of(papers: Iterable[Paper]) -> tuple[str, ...]:
    """Names of the scenarios that a page of these papers asks for, sorted."""
    return tuple(
        sorted({split(f"{study}: any")[0] for paper in papers for study in studies_of(paper)})
    )


def studies_of(paper: Paper) -> Iterator[str]:
    """Every ``SCENARIO`` or ``SCENARIO/METHOD`` that a paper's declaration names."""
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
    """The study of a scenario in ``folder``, run with its own seed if it is not there; returns its
    folder.

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
    """Run what is not there yet, ``jobs`` at a time; yields each name when its study is there, in
    their order.
    """
    names = tuple(names)
    with ThreadPoolExecutor(jobs) as pool:
        for name, _ in zip(names, pool.map(partial(study_in, folder), names), strict=True):
            yield name
