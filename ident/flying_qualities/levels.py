"""Levels of flying qualities of the short period of an estimated low-order equivalent system.

With the derivatives of the low-order equivalent system (docs/nomenclature.md), airspeed V and
gravity g, w^2 = L_alpha M_q - L_q M_alpha and 2 zeta w = -(L_alpha + M_q). The steady state at a
constant stick and speed gives

    n/alpha = (V/g) (-L_alpha + L_delta M_alpha/M_delta) / (L_q - L_delta M_q/M_delta),

which is -(V/g) L_alpha for L_delta = 0 and L_q = 1. The control anticipation parameter is CAP =
w^2 / (n/alpha) (Bihrle, AFFDL-TR-65-198, 1966). The limits of the levels are in
``handling_qualities.toml``.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import pairwise
from typing import Any

import numpy as np

from ident.estimate import Estimate
from sim.errors import ModelError
from sim.maths import COMPLEX_STEP

UNITS = {
    "natural_frequency": "rad/s",
    "damping_ratio": "1",
    "delay": "s",
    "total_delay": "s",
    "load_factor_slope": "g/rad",
    "control_anticipation": "1/(g s2)",
}
CLASSES = ("I", "II-C", "II-L", "III", "IV")
CATEGORIES = ("A", "B", "C")
_NEEDED = ("L_alpha", "M_alpha", "L_delta", "M_delta", "L_q", "M_q", "inv_tau", "delay")
INTERVAL_SIGMAS = 2.0


@dataclass(frozen=True)
class Quality:
    """A flying-qualities parameter: its value and standard deviation, by linearisation, in
    ``unit``.
    """

    name: str
    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class LevelCriterion:
    """Ranges of a flying-qualities parameter in one flight-phase category.

    Attributes
    ----------
    quantity : name of the parameter.
    category : flight-phase category, or ``"all"``.
    levels : range ``(low, high)`` of levels 1, 2 and 3.
    source : paragraph of the specification.
    classes : classes of aircraft to which the criterion applies.
    raised_by : for a Dutch roll, the increase of the lower end of each level for each (rad/s)^2 by
        which its squared frequency times |phi/beta| exceeds 20; empty for others.
    """

    quantity: str
    category: str
    levels: tuple[tuple[float, float], ...]
    source: str
    classes: tuple[str, ...] = CLASSES
    raised_by: tuple[float, ...] = ()


@dataclass(frozen=True)
class QualityLevel:
    """A parameter compared with a criterion.

    Attributes
    ----------
    level : level of the value, 1 to 3, or 4 if it is outside all ranges.
    best, worst : best and worst level within two standard deviations.
    """

    criterion: LevelCriterion
    quality: Quality
    level: int
    best: int
    worst: int

    @property
    def uncertain(self) -> bool:
        """Whether a boundary between levels is within two standard deviations."""
        return self.best != self.worst


def qualities(
    estimate: Estimate, airspeed: float, gravity: float, fixed: Mapping[str, float] | None = None
) -> tuple[Quality, ...]:
    """Return natural frequency, damping ratio, delays, n/alpha and CAP of an estimate of the
    low-order equivalent system.

    Parameters
    ----------
    airspeed, gravity : m/s, m/s2.
    fixed : parameter -> value, of parameters that were not estimated, such as ``{"delay": 0.125}``;
        they have no uncertainty.

    Returns
    -------
    ``delay`` is the pure delay. ``total_delay`` is the pure delay plus 1/inv_tau, the delay of the
    lag at low frequency. Quantities that do not exist are left out: frequency, damping and CAP if
    w^2 <= 0, and ``total_delay`` if inv_tau <= 0.

    Raises
    ------
    ModelError : if a parameter is neither estimated nor fixed.
    """
    values = {**(fixed or {}), **estimate.as_dict()}
    for name in _NEEDED:
        if name not in values:
            raise ModelError(
                "it is neither estimated nor given",
                where=f"handling qualities, {name}",
                remedy="give its value under fixed",
            )
    centre = _evaluate(values, airspeed, gravity)
    gradients = {name: np.zeros(len(estimate.names)) for name in centre}
    for column, name in enumerate(estimate.names):
        if name in _NEEDED:
            stepped = _evaluate(
                {**values, name: complex(values[name], COMPLEX_STEP)}, airspeed, gravity
            )
            for quantity in centre:
                gradients[quantity][column] = np.imag(stepped[quantity]) / COMPLEX_STEP
    out = []
    for quantity, value in centre.items():
        variance = float(gradients[quantity] @ estimate.covariance @ gradients[quantity])
        out.append(
            Quality(quantity, float(np.real(value)), max(variance, 0.0) ** 0.5, UNITS[quantity])
        )
    return tuple(out)


def criteria(aircraft_class: str = "IV") -> tuple[LevelCriterion, ...]:
    """Return the criteria for an aircraft class of ``CLASSES``."""
    return tuple(criterion for criterion in _all_criteria() if aircraft_class in criterion.classes)


@cache
def _all_criteria() -> tuple[LevelCriterion, ...]:
    """Return the criteria of ``handling_qualities.toml`` for all classes."""
    entries = tomllib.loads(
        (files("ident.flying_qualities") / "handling_qualities.toml").read_text(encoding="utf-8")
    )["criteria"]
    return tuple(
        LevelCriterion(
            e["quantity"],
            e["category"],
            tuple((float(a), float(b)) for a, b in e["levels"]),
            e["source"],
            tuple(e.get("classes", CLASSES)),
            tuple(map(float, e.get("raised_by", ()))),
        )
        for e in entries
    )


def levels(
    quality_values: Sequence[Quality], against: Sequence[LevelCriterion] | None = None
) -> tuple[QualityLevel, ...]:
    """Return the level of each parameter in each of its criteria, in the order of the criteria.

    ``against`` are the criteria; None takes those of class IV.
    """
    by_name = {quality.name: quality for quality in quality_values}
    out = []
    for criterion in criteria() if against is None else against:
        if criterion.quantity not in by_name:
            continue
        quality = by_name[criterion.quantity]
        low, high = (
            quality.value - INTERVAL_SIGMAS * quality.std,
            quality.value + INTERVAL_SIGMAS * quality.std,
        )
        if quality.unit == "s":  # a delay or a time constant is not negative
            low = max(low, min(0.0, quality.value))
        edges = [edge for pair in criterion.levels for edge in pair if low < edge < high]
        ends = sorted([low, *edges, high])
        # Levels change at edges only: one point between successive edges, and both ends, suffice.
        inside = [0.5 * (a + b) for a, b in pairwise(ends)]
        reached = [level_of(value, criterion) for value in (low, *inside, high)]
        out.append(
            QualityLevel(
                criterion, quality, level_of(quality.value, criterion), min(reached), max(reached)
            )
        )
    return tuple(out)


def level_of(value: float, criterion: LevelCriterion) -> int:
    """Return the best level whose range contains the value; 4 if none does."""
    for number, (low, high) in enumerate(criterion.levels, start=1):
        if low <= value <= high:
            return number
    return 4


def _evaluate(p: Mapping[str, Any], airspeed: float, gravity: float) -> dict[str, Any]:
    """Return quantity -> value for parameters ``p``, of which one may be complex."""
    stiffness = p["L_alpha"] * p["M_q"] - p["L_q"] * p["M_alpha"]
    ratio = p["L_delta"] / p["M_delta"] if p["M_delta"] else 0.0
    slope = (
        airspeed / gravity * (ratio * p["M_alpha"] - p["L_alpha"]) / (p["L_q"] - ratio * p["M_q"])
    )
    out: dict[str, Any] = {}
    if np.real(stiffness) > 0:
        frequency = np.sqrt(stiffness)
        out = {
            "natural_frequency": frequency,
            "damping_ratio": -(p["L_alpha"] + p["M_q"]) / (2.0 * frequency),
        }
    out["delay"] = p["delay"]
    if np.real(p["inv_tau"]) > 0:
        out["total_delay"] = p["delay"] + 1.0 / p["inv_tau"]
    out["load_factor_slope"] = slope
    if np.real(stiffness) > 0 and np.real(slope) > 0:
        out["control_anticipation"] = stiffness / slope
    return out
