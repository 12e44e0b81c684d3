"""What NASA TM-101722 prints of its low-order equivalents, all with our sign of the pseudo-control.

Estimates are only shown beside ours, never used to form them; start, P0 and R are what a scenario may run with as the paper did.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from scenarios.studies.scenario_file.quantities import standard_deviations
from sim.errors import DeclarationError

FILE = "short_period_dynamics.toml"
TURNED = ("delta", "L_delta", "M_delta", "delta_0")  # the paper's pseudo-control is minus ours


@dataclass(frozen=True)
class Printed:
    """A printed value and the standard deviation from its printed variance, None where none is printed."""

    value: float
    std: float | None


@dataclass(frozen=True)
class Range:
    """What the text tells of the flight: between which values the EKF had it, and what the frequency response gave."""

    low: float
    high: float
    frequency_response: float


def printed_columns() -> tuple[str, ...]:
    """Names of the columns of the paper's tables."""
    return tuple(_document()["loes"])


def printed_column(name: str) -> dict[str, Printed]:
    """A column of the paper's tables: final estimates, SI. Raises DeclarationError when there is none."""
    return _column("loes", name)


def printed_start(name: str) -> dict[str, Printed]:
    """Initial state estimate and P0 of Table 1 (``simulation``) or 2 (``flight``), SI. Raises DeclarationError when there is none."""
    return _column("initial", name)


def printed_noise(name: str) -> dict[str, float]:
    """R of Table 1 or 2 as standard deviations, rad, rad/s and g. Raises DeclarationError when there is none."""
    rows = _table("measurement_noise", name)
    return standard_deviations({}, {key: f"{row['value']} {row['unit']}" for key, row in rows.items()}, f"published {FILE}")


def printed_density(name: str) -> dict[str, float]:
    """Q of Table 1 or 2 as it stands there. Raises DeclarationError when there is none."""
    return {key: float(row["value"]) for key, row in _table("process_noise", name).items()}


def printed_checks(name: str) -> dict[str, Range]:
    """Delay (s) and damping ratio that the text tells of a column, empty where it tells nothing."""
    return {key: Range(**row) for key, row in _document()["checks"].get(name, {}).items()}


def printed_correlation(name: str) -> tuple[tuple[str, ...], np.ndarray]:
    """Names and correlation matrix ``(13, 13)`` of Table 1 or 2. Raises DeclarationError when there is none."""
    rows = _table("correlation", name)
    names = ("alpha", *rows)
    C = np.eye(len(names))
    for i, row in enumerate(rows.values(), start=1):
        C[i, :i] = C[:i, i] = row
    signs = np.array([-1.0 if each in TURNED else 1.0 for each in names])
    return names, C * np.outer(signs, signs)


def has_table(name: str) -> bool:
    """Whether a column is one of the two with start, P0, R, Q and correlations."""
    return name in _document()["initial"]


@cache
def _document() -> Mapping[str, Any]:
    return tomllib.loads(files("scenarios.studies.published").joinpath(FILE).read_text(encoding="utf-8"))


def _table(kind: str, name: str) -> Mapping[str, Any]:
    tables = _document()[kind]
    if name not in tables:
        raise DeclarationError(f"there is no column {name!r}", where=f"published {FILE}", remedy=f"use one of {', '.join(tables)}")
    found: Mapping[str, Any] = tables[name]
    return found


def _column(kind: str, name: str) -> dict[str, Printed]:
    return {key: Printed(float(e["value"]), math.sqrt(e["variance"]) if "variance" in e else None) for key, e in _table(kind, name).items()}
