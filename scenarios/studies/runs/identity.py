"""Everything on which the rows of a campaign depend, as JSON."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from enum import Enum
from typing import Any

from scenarios.studies.declaration import Estimation, Scenario
from sim.errors import DeclarationError

WORDS = ("label", "explanation", "published", "choices", "own", "flight", "distance", "engine")  # of an estimation, on which no number depends


def identity_of(scenario: Scenario, estimation: Estimation) -> dict[str, Any]:
    """Flight, estimation and the user's files by their hashes; what is only said of them is left out."""
    said = {field.name: getattr(estimation, field.name) for field in dataclasses.fields(estimation) if field.name not in WORDS}
    flown = {field.name: getattr(scenario.flight, field.name) for field in dataclasses.fields(scenario.flight) if field.name != "own"}
    return {
        "scenario": scenario.name,
        "flight": plain(flown),
        "estimation": plain(said),
        "files": {file.name: file.sha256 for file in scenario.files},
    }


def plain(value: Any) -> Any:
    """A declaration's value as JSON has it: infinite numbers and what is not there as text."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(name): plain(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    if isinstance(value, Enum):
        return value.name
    if value is None:
        return "none"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, str | bool | int | float):
        return value
    raise DeclarationError(f"a {type(value).__name__} has no place in a manifest", where="campaign")
