"""Flights of scenarios for their records alone: what a test engineer would hand over, and no truth."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from scenarios.api.records.record import Record, record_of
from scenarios.api.running import flown_record
from scenarios.api.shown import html
from scenarios.api.vehicle import Vehicle
from scenarios.files.declarations import named_after
from scenarios.studies.catalogue import load_document, scenario_file, scenario_kind


@dataclass(frozen=True, eq=False, repr=False)
class Flight:
    """Records of a flight, those meant to be predicted, and the vehicle as it is declared (None where the scenario has no vehicle file)."""

    records: tuple[Record, ...]
    validate: tuple[Record, ...] = ()
    vehicle: Vehicle | None = None

    @property
    def record(self) -> Record:
        """The first record."""
        return self.records[0]

    def __repr__(self) -> str:
        return f"<Flight: {', '.join(map(repr, self.records[:3]))}{', ...' if len(self.records) > 3 else ''}>"

    def _repr_html_(self) -> str:
        parts = [each._repr_html_() for each in (*self.records, *self.validate)]
        return html.page("flight", *parts, self.vehicle._repr_html_() if self.vehicle is not None else "")


def flown(name: str, seed: int | None, changes: Sequence[str]) -> Flight:
    """Fly a scenario of any kind; the same seed gives the same numbers. Raises FlightidError as the scenario's readers."""
    kind = scenario_kind(name)
    return _FLYING[kind](name, seed, changes) if kind in _FLYING else Flight((record_of(flown_record(name, seed, changes)),))


def _trace(name: str, seed: int | None, changes: Sequence[str]) -> Flight:
    from scenarios.trials.planted.flights import fly_trace
    from scenarios.trials.planted.schema import trace_scenario_of

    scenario = trace_scenario_of(*load_document(name, changes))
    with named_after(scenario_file(name)):
        flight = fly_trace(scenario, scenario.seed if seed is None else seed)
    return Flight((record_of(flight.train),), (record_of(flight.validate),), _vehicle(flight.vehicle_file))


def _jsbsim(name: str, seed: int | None, changes: Sequence[str]) -> Flight:
    from scenarios.trials.jsbsim.flight import fly_jsbsim
    from scenarios.trials.jsbsim.schema import jsbsim_of

    flight = jsbsim_of(*load_document(name, changes))
    with named_after(scenario_file(name)):
        record, _ = fly_jsbsim(flight, flight.seed if seed is None else seed)
    return Flight((record_of(record),))


def _vehicle(text: str) -> Vehicle:
    content: dict[str, Any] = tomllib.loads(text)
    return Vehicle(content)


_FLYING = {"trace": _trace, "jsbsim": _jsbsim}
