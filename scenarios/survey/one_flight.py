"""One flight checked and diagnosed, and what is kept of it, as a task of the engine."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenarios.files.documents import found_json
from scenarios.files.writing import write_json
from scenarios.plots.formats import Formats
from scenarios.survey.flights import Flight
from scenarios.tasks.work import Row, Task
from sim.errors import FlightidError

SCHEMA = "flightid/survey-flight/1"
KEPT = "flight.json"
FOLDER = "flights"


@dataclass(frozen=True)
class Diagnoses:
    """The work of a survey: each task is a flight, whose folder it writes."""

    flights: tuple[Flight, ...]
    folder: Path
    figures: Formats = ()
    name: str = "flights diagnosed"
    block: int = 1

    @property
    def columns(self) -> Mapping[str, str]:
        return {"flight": "text", "verdict": "text"}

    def identity(self) -> Mapping[str, Any]:
        return {"flights": [flight.digest for flight in self.flights]}

    def run(self, tasks: Sequence[Task]) -> Sequence[Row | str]:
        return [self._one(self.flights[task.number]) for task in tasks]

    def _one(self, flight: Flight) -> Row | str:
        try:
            kept = diagnosed(flight, self.folder / FOLDER / flight.name, self.figures)
        except FlightidError as error:
            return str(error)
        return {"flight": flight.name, "verdict": kept["verdict"]}


def diagnosed(flight: Flight, folder: Path, figures: Formats) -> dict[str, Any]:
    """Check and diagnose a flight, write its study, and last ``flight.json``, whose content is given back.

    Raises FlightidError for anything that keeps the flight from being used.
    """
    from scenarios.diagnosis.diagnose import diagnose_files
    from scenarios.diagnosis.report.content import quantities
    from scenarios.diagnosis.report.files import write_diagnosis
    from scenarios.diagnosis.report.text import headline

    started = time.perf_counter()
    tracing = diagnose_files(flight.request())
    (folder / KEPT).unlink(missing_ok=True)  # what it says is no longer of this folder
    write_diagnosis(tracing, folder, figures=figures)
    d = tracing.diagnosis
    content = {
        "schema": SCHEMA,
        "digest": flight.digest,
        "name": flight.name,
        "verdict": d.verdict.value,
        "headline": headline(tracing),
        "effects": [
            {"name": c.name, "claimed": c.claimed, "alternatives": list(c.alternatives), "parameters": quantities(c.parameters)} for c in d.effects
        ],
        "derivatives": quantities(d.after),
        "check": kinematics_of(flight),
        "simulated": tracing.simulated,
        "seconds": round(time.perf_counter() - started, 3),
    }
    write_json(folder / KEPT, content)
    return content


def kinematics_of(flight: Flight) -> dict[str, Any]:
    """What the kinematics say of a flight's sensors, or why they say nothing."""
    from scenarios.compatibility.check import check_files
    from scenarios.compatibility.text import finding_lines

    try:
        found = check_files(flight.request())
    except FlightidError as error:
        return {"done": False, "sentences": [f"{error.what}"], "findings": []}
    names = list(dict.fromkeys(finding.name for finding in found.result.findings if finding.stands))
    return {"done": True, "sentences": list(finding_lines(found)), "findings": names}


def kept_of(flight: Flight, folder: Path) -> dict[str, Any] | None:
    """What is kept of a flight where it is still of this record, vehicle, model, options and version; else None."""
    content = found_json(folder / FOLDER / flight.name / KEPT)
    sound = isinstance(content, dict) and content.get("schema") == SCHEMA and content.get("digest") == flight.digest
    return content if sound else None
