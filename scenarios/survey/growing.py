"""A survey's folder that grows: of its flights those that are new or changed are computed, the others are as they were."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.files.documents import found_json
from scenarios.plots.formats import Formats
from scenarios.survey.flights import Flight, Flights
from scenarios.survey.one_flight import Diagnoses, kept_of
from scenarios.tasks.study import Asked, run_study

if TYPE_CHECKING:
    from scenarios.survey.pooled_fits import PooledFits
    from scenarios.tasks.rows import Table

MAIN = "survey.json"
SCHEMA = "flightid/survey/1"
Tell = Callable[[str, float], None]


@dataclass(frozen=True)
class Grown:
    """What a survey has of its flights.

    ``kept``: of each flight by name, in the order of the file. ``computed``, ``failed`` (with the reason), ``removed`` since the last survey,
    ``before``: names of the flights that the last survey had.
    """

    kept: Mapping[str, Mapping[str, Any]]
    flights: Mapping[str, Flight]
    computed: tuple[str, ...]
    failed: Mapping[str, str]
    removed: tuple[str, ...]
    before: frozenset[str]

    @property
    def new(self) -> tuple[str, ...]:
        """Flights that the last survey had not; none in the first one."""
        return tuple(name for name in self.kept if name not in self.before) if self.before else ()


def grown(
    asked: Flights, folder: Path, jobs: int = 1, figures: Formats = (), tell: Tell = lambda stage, share: None, cluster: str | None = None
) -> Grown:
    """Diagnose the flights whose results the folder lacks, by processes or by the ``cluster`` at an address, and give all.

    Raises
    ------
    KeyboardInterrupt : Ctrl-C, with how many flights are kept. FlightidError : ``folder`` cannot be written.
    """
    before = last_survey(folder)
    missing = tuple(flight for flight in asked.flights if kept_of(flight, folder) is None)
    failed: dict[str, str] = {}
    if missing:
        work = Diagnoses(missing, folder, figures)
        try:
            table = flown(work, len(missing), jobs, folder, tell, cluster)
            ended = len(table)
        except KeyboardInterrupt:
            ended, table = 0, None
        if table is None or not table.whole:
            raise KeyboardInterrupt(f"{len(asked.flights) - len(missing) + ended} of {len(asked.flights)} flights are kept in {folder}")
        failed = {missing[int(n)].name: str(error) for n, error in zip(table.columns["number"], table.columns["error"], strict=True) if error}
    found = {flight.name: kept_of(flight, folder) for flight in asked.flights}
    kept = {name: content for name, content in found.items() if content is not None}
    for name in found:
        if name not in kept and name not in failed:
            failed[name] = "nothing was kept of it"
    computed = tuple(flight.name for flight in missing if flight.name in kept)
    had = frozenset(str(name) for name in before.get("flights", {}))
    removed = tuple(sorted(had - set(found)))
    return Grown(kept, {f.name: replace(f) for f in asked.flights}, computed, failed, removed, had)


def flown(work: Diagnoses | PooledFits, count: int, jobs: int, folder: Path, tell: Tell, cluster: str | None) -> Table:
    """The rows of a survey's work of ``count`` flights, whose files are in ``folder`` then. Raises as ``run_study``."""
    asked = Asked(count, 0, max(1, min(jobs, count)), cluster=cluster, unit="flights", elsewhere=folder)
    if cluster is None:
        return run_study(work, asked, tell)
    from scenarios.survey.on_cluster import sent

    return run_study(sent(work), asked, tell)


def last_survey(folder: Path) -> Mapping[str, Any]:
    """The document of the last survey in a folder; empty where there is none."""
    content = found_json(folder / MAIN)
    return content if isinstance(content, dict) and content.get("schema") == SCHEMA and isinstance(content.get("flights"), dict) else {}
