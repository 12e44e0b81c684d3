"""One flight of the campaign again: its records, its diagnosis and its truth to look at."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from exam.every_effect.flight import Flown, write_hidden
from exam.every_effect.work import EveryEffect, scored_flight_of
from exam.scores.scored_flight import ScoredFlight
from scenarios.diagnosis.diagnose import Tracing, diagnose_files
from scenarios.diagnosis.files import write_diagnosis
from scenarios.diagnosis.text import diagnosis_text
from scenarios.files.writing import study_folder, write_json
from scenarios.report.figure_formats import USUAL, Formats
from scenarios.report.summary import WIDTH
from scenarios.tasks.work import Task, seed_of


@dataclass(frozen=True, eq=False)
class OneFlight:
    """A flight with its diagnosis: its ``task``, what was flown, what the loop said, and how it is
    scored.
    """

    task: Task
    flown: Flown
    tracing: Tracing
    marked: ScoredFlight


def fly_one(
    work: EveryEffect,
    number: int,
    root: int,
    progress: Callable[[str, float], None] = lambda stage, share: None,
) -> OneFlight:
    """Flight ``number`` of the campaign whose seeds spring from ``root``: the same as in the
    campaign, to the last bit.

    Raises
    ------
    FlightidError : it cannot be flown, or its files are refused.
    """
    task = Task(number, seed_of(root, number))
    progress("flying", 0.0)
    flown = work.fly(task)
    with tempfile.TemporaryDirectory(prefix="flightid-") as folder:
        tracing = diagnose_files(write_hidden(flown, Path(folder)), progress)
    return OneFlight(task, flown, tracing, scored_flight_of(flown, tracing))


def one_text(one: OneFlight, width: int = WIDTH) -> str:
    """What `flightid diagnose` prints, and what was true."""
    return f"{diagnosis_text(one.tracing, width).rstrip()}\n\n{truth_sentence(one)}\n"


def truth_sentence(one: OneFlight) -> str:
    """What was hidden, and what the diagnosis is worth."""
    values = ", ".join(f"{local} {value:.5g}" for local, value in one.flown.values.items())
    hidden = (
        f"{one.flown.name} ({values}; SI), {one.flown.size:.0f} sigmas"
        if one.flown.name
        else "nothing"
    )
    return (
        f"flight {one.task.number}: hidden was {hidden}; the loop says {one.marked.standing.value}"
    )


def write_one(one: OneFlight, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write the diagnosis, the files that the loop was given, and ``truth.json`` (last); returns
    the folder.
    """
    write_diagnosis(one.tracing, folder, figures=figures)
    with study_folder(folder, "truth.json") as scratch:
        write_hidden(one.flown, scratch)
        write_json(scratch / "truth.json", truth_content(one))
    return Path(folder)


def truth_content(one: OneFlight) -> dict[str, Any]:
    """Content of ``truth.json``."""
    flown, true = one.flown, one.flown.carrier.train.model.parameters
    return {
        "schema": "flightid/truth/1",
        "number": one.task.number,
        "seed": one.task.seed,
        "parameters": {
            name: {"value": true[name].value, "unit": true[name].unit}
            for name in flown.carrier.free
        },
        "effects": [flown.name] if flown.name else [],
        "hidden": {flown.name: dict(flown.values)} if flown.name else {},
        "size_sigmas": flown.size,
        "noise_std": dict(flown.carrier.noise),
        "standing": one.marked.standing.value,
    }
