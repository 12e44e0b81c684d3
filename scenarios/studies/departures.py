"""What a study must tell beside its numbers: values that no source gives, of its scenario and of its vehicle, and methods that saw another flight."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from scenarios.studies.declaration import Choice, Estimation, Flight, Scenario
from sim.vehicles.library import Origin, VehicleData, read_parameter_set

HEADING = "chosen by this project [own]; no source prints it, or it prints another:"
TOLD = (Origin.OWN, Origin.REMEMBERED, Origin.CONVERTED)  # origins that a reader would not expect of a published aircraft
_MODAL = re.compile(r"(?:omega|zeta|generalized_mass|CL_eta|CL_etadot|Cm_eta|Cm_etadot|Ceta)(\d+)(?:_|$)")


def choice_lines(choices: Sequence[Choice]) -> list[str]:
    """One line a choice: key, value and reason."""
    return [f"{choice.key} = {choice.value}: {choice.reason}" for choice in choices]


def choices_content(choices: Sequence[Choice]) -> dict[str, dict[str, str]]:
    """The same for a JSON file, by key."""
    return {choice.key: {"value": choice.value, "reason": choice.reason} for choice in choices}


def vehicle_origins(flight: Flight) -> dict[str, list[str]]:
    """Numbers of a built-in vehicle that its source does not print, by what their origin means; those of an elastic mode are counted."""
    if flight.own is not None:
        return {}
    data = read_parameter_set(flight.vehicle)
    return {origin.words: names for origin in TOLD if (names := _names(data, origin, flight))}


def _names(data: VehicleData, origin: Origin, flight: Flight) -> list[str]:
    """Rigid numbers of an origin by name, modal ones of the modes that fly as ``"11 of mode 2"``."""
    rigid, modal = [], Counter[int]()
    for number in data.numbers:
        mode = _MODAL.match(number.name)
        if number.origin is origin and mode is None:
            rigid.append(number.name)
        elif number.origin is origin and mode is not None and int(mode[1]) <= flight.modes:
            modal[int(mode[1])] += 1
    return [name for name in rigid if name not in flight.derivatives] + [f"{count} of mode {mode}" for mode, count in sorted(modal.items())]


def vehicle_line(flight: Flight) -> str:
    """What is to be said of the vehicle's numbers in one line; empty where its source prints all of them and none as it flies otherwise."""
    told = [f"{', '.join(names)} ({words})" for words, names in vehicle_origins(flight).items()]
    told += [f"{name} flies with {flies}, printed {printed}" for name, (flies, printed) in misprints(flight).items()]
    return f"numbers of {flight.vehicle} that its source does not print so: {'; '.join(told)}" if told else ""


def misprints(flight: Flight) -> dict[str, tuple[str, str]]:
    """Numbers of a built-in vehicle that fly otherwise than the paper prints them: both as text, by name."""
    if flight.own is not None:
        return {}
    modes = [(number, _MODAL.match(number.name)) for number in read_parameter_set(flight.vehicle).numbers if number.printed_by_paper]
    return {number.name: (number.printed, number.printed_by_paper) for number, mode in modes if mode is None or int(mode[1]) <= flight.modes}


def other_flight(scenario: Scenario, estimation: Estimation) -> Mapping[str, Any]:
    """What the flight of an estimation has in the place of the scenario's, by key, SI; empty where it sees the scenario's own."""
    if estimation.flight is None:
        return {}
    pairs = ((item.name, getattr(scenario.flight, item.name), getattr(estimation.flight, item.name)) for item in fields(Flight))
    return {name: theirs for name, ours, theirs in pairs if theirs != ours}


def other_flight_line(scenario: Scenario, estimation: Estimation) -> str:
    """The same in words, with how far that flight is from the model; empty where there is no other flight."""
    if estimation.flight is None:
        return ""
    changed = "; ".join(f"{name} {_worded(name, value)}" for name, value in other_flight(scenario, estimation).items())
    return f"its own flight: {changed}; truth and model: {estimation.distance or scenario.distance}"


def _worded(name: str, value: Any) -> str:
    unit = {"duration": " s", "step": " s", "rate": " Hz"}.get(name, "")
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {entry:.4g}" for key, entry in value.items()) + " (SI)"
    if isinstance(value, tuple):
        return ", ".join(f"{plan.kind} of {plan.input}" for plan in value)
    return f"{value:g}{unit}" if isinstance(value, float) else str(value)
