"""Levels of flying qualities of estimated models, with their probabilities.

With the states of the low-order equivalent system (L_alpha and so on, V the airspeed, g gravity):
w^2 = L_alpha M_q - L_q M_alpha and 2 zeta w = -(L_alpha + M_q); steady state of a held stick at
constant speed gives n/alpha = (V/g) (-L_alpha + L_delta M_alpha/M_delta) / (L_q - L_delta
M_q/M_delta), which is -(V/g) L_alpha for L_delta = 0, L_q = 1; the control anticipation parameter
is CAP = w^2 / (n/alpha) (Bihrle, AFFDL-TR-65-198, 1966).

Each Gaussian draw of the modes' characteristics is turned into damping, frequency and times, and
compared with all limits of a mode at once. The probability of a level is the share of the draws
that reach it.

Low-order forms that are fitted to frequency responses (short period, roll mode, Dutch roll) are
compared with the same limits. For the form ``pitch`` at constant speed n/alpha = V / (g T_theta2)
and CAP = omega^2 / (n/alpha) (MIL-STD-1797A, 4.2.1.2; Bihrle, AFFDL-TR-65-198, 1966).
Limits of the levels: ``handling_qualities.toml``.
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

# ---- Short-period flying qualities of an estimated low-order equivalent system

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
    """A flying-qualities parameter: value and standard deviation (by linearisation) in ``unit``."""

    name: str
    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class LevelCriterion:
    """Ranges ``(low, high)`` of levels 1, 2 and 3 of a parameter in one flight-phase category.

    ``source``: paragraph of the specification; ``classes`` of aircraft it applies to.
    ``raised_by``: increase of the low ends of a Dutch roll for each (rad/s)^2 by which its squared
    frequency times |phi/beta| exceeds 20.
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
    level : 1 to 3, or 4 for outside all of them.
    best, worst : the range of levels within two standard deviations.
    """

    criterion: LevelCriterion
    quality: Quality
    level: int
    best: int
    worst: int

    @property
    def uncertain(self) -> bool:
        """Whether a boundary lies within two standard deviations."""
        return self.best != self.worst


def qualities(
    estimate: Estimate, airspeed: float, gravity: float, fixed: Mapping[str, float] | None = None
) -> tuple[Quality, ...]:
    """Natural frequency, damping, delays, n/alpha and CAP of an estimate that names the low-order
    equivalent system's parameters.

    Parameters
    ----------
    airspeed, gravity : m/s, m/s2.
    fixed : values of the parameters that were not estimated, e.g. ``{"delay": 0.125}``; they carry
        no uncertainty.

    Returns
    -------
    ``delay`` is the pure delay, ``total_delay`` adds the lag's 1/inv_tau, which is its delay at low
    frequency. A quantity that does not exist is left out: frequency, damping and CAP where the
    short period does not oscillate (w^2 <= 0), the lag's where inv_tau <= 0.

    Raises
    ------
    ModelError : a parameter that is neither estimated nor fixed.
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
            moved = _evaluate(
                {**values, name: complex(values[name], COMPLEX_STEP)}, airspeed, gravity
            )
            for quantity in centre:
                gradients[quantity][column] = np.imag(moved[quantity]) / COMPLEX_STEP
    out = []
    for quantity, value in centre.items():
        variance = float(gradients[quantity] @ estimate.covariance @ gradients[quantity])
        out.append(
            Quality(quantity, float(np.real(value)), max(variance, 0.0) ** 0.5, UNITS[quantity])
        )
    return tuple(out)


def criteria(aircraft_class: str = "IV") -> tuple[LevelCriterion, ...]:
    """Return the boundaries for an aircraft class of ``CLASSES``; class IV if none is given."""
    return tuple(criterion for criterion in _every() if aircraft_class in criterion.classes)


@cache
def _every() -> tuple[LevelCriterion, ...]:
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
    """Compare every parameter with every criterion for it, in the order of the criteria."""
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
        spots = sorted([low, *edges, high])
        # Levels change at edges only: one point inside each piece, and the ends, see them all.
        inside = [0.5 * (a + b) for a, b in pairwise(spots)]
        reached = [level_of(value, criterion) for value in (low, *inside, high)]
        out.append(
            QualityLevel(
                criterion, quality, level_of(quality.value, criterion), min(reached), max(reached)
            )
        )
    return tuple(out)


def level_of(value: float, criterion: LevelCriterion) -> int:
    """Return the best level whose range contains the value, 4 if none does."""
    for number, (low, high) in enumerate(criterion.levels, start=1):
        if low <= value <= high:
            return number
    return 4


def _evaluate(p: Mapping[str, Any], airspeed: float, gravity: float) -> dict[str, Any]:
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
