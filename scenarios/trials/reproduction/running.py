"""The studies of the page: those that are there, and those that are run."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

from scenarios.studies.catalogue import load_scenario, scenario_kind
from scenarios.studies.files import write_study
from scenarios.studies.repeated import fly_repeatedly
from scenarios.studies.study import run_scenario
from scenarios.trials.reproduction.declaration import Paper
from scenarios.trials.reproduction.lookups import split
from scenarios.x29.files import write_loop
from scenarios.x29.study import loop_scenario, run_loop
from sim.errors import DeclarationError


def scenarios_of(papers: Iterable[Paper]) -> tuple[str, ...]:
    """Names of the scenarios that a page of these papers asks for, sorted."""
    return tuple(sorted({split(f"{study}: any")[0] for paper in papers for study in studies_of(paper)}))


def studies_of(paper: Paper) -> Iterator[str]:
    """Every ``SCENARIO`` or ``SCENARIO/METHOD`` that a paper's declaration names."""
    for part in paper.parts:
        yield from (group.study for group in part.values)
        yield from (matrix.study for matrix in part.matrices)
        for statement in part.statements:
            yield from (study for lookup in statement.numbers.values() for study in re.findall(r"([\w/-]+): ", lookup))
            if statement.figure:
                yield statement.figure.partition("/")[0]


def study_in(folder: Path, name: str) -> Path:
    """The study of a scenario in ``folder``, run if it is not there; returns its folder. Raises DeclarationError where another one lies there."""
    place = folder / name
    main = place / "comparison.json"
    if not main.is_file():
        _run(name, place)
    found = json.loads(main.read_text(encoding="utf-8")).get("scenario")
    if found != name:
        raise DeclarationError(f"the study of {found} lies there", where=str(place), remedy="name a folder with studies by their scenarios' names")
    return place


def _run(name: str, place: Path) -> None:
    kind = scenario_kind(name)
    if kind == "identification":
        scenario = load_scenario(name)
        write_study(replace(run_scenario(scenario), repeated=fly_repeatedly(scenario, None)), place)
    elif kind == "x29":
        write_loop(run_loop(loop_scenario(name), None), place)
    else:
        raise DeclarationError(f"a scenario of kind {kind!r} has no study of a paper", where=name, remedy="name one that estimates parameters")


def run_all(folder: Path, names: Iterable[str], jobs: int) -> Iterator[str]:
    """Run what is not there yet on ``jobs`` processes; yields each name when its study is there, in their order."""
    names = tuple(names)
    if jobs == 1:
        for name in names:
            study_in(folder, name)
            yield name
        return
    with ProcessPoolExecutor(jobs) as pool:
        for name, _ in zip(names, pool.map(study_in, [folder] * len(names), names), strict=True):
            yield name
