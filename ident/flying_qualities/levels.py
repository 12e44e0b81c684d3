"""Levels of flying qualities and their probabilities. The limits of the levels are in
``handling_qualities.toml``.

Short period. With the derivatives of the low-order equivalent system (docs/nomenclature.md),
airspeed V and gravity g, w^2 = L_alpha M_q - L_q M_alpha and 2 zeta w = -(L_alpha + M_q). The
steady state at a constant stick and speed gives

    n/alpha = (V/g) (-L_alpha + L_delta M_alpha/M_delta) / (L_q - L_delta M_q/M_delta),

which is -(V/g) L_alpha for L_delta = 0 and L_q = 1. The control anticipation parameter is CAP =
w^2 / (n/alpha) (Bihrle, AFFDL-TR-65-198, 1966).

Modes of a model. Random samples of the characteristics of the modes are drawn from their Gaussian
distribution and converted to damping ratios, frequencies and times. The level of a mode in a sample
is the worst one of its quantities. The probability of a level is the share of samples with it.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import numpy as np

from ident.estimate import Estimate
from ident.flying_qualities.modes import Characteristics
from sim.errors import DeclarationError, ModelError
from sim.maths import COMPLEX_STEP

# ---- Levels of the short period of an estimated low-order equivalent system

UNITS = {
    "natural_frequency": "rad/s",
    "damping_ratio": "1",
    "delay": "s",
    "total_delay": "s",
    "load_factor_slope": "g/rad",
    "control_anticipation": "1/(g s2)",
    "roll_time_constant": "s",
    "dutch_roll_frequency": "rad/s",
    "dutch_roll_damping": "1",
    "dutch_roll_damping_rate": "rad/s",
}
CLASSES = ("I", "II-C", "II-L", "III", "IV")
CATEGORIES = ("A", "B", "C")
_REQUIRED_PARAMETERS = (
    "L_alpha",
    "M_alpha",
    "L_delta",
    "M_delta",
    "L_q",
    "M_q",
    "inv_tau",
    "delay",
)
INTERVAL_SIGMAS = 2.0  # half width, in sigmas, of the interval for the best and the worst level
WORST_LEVEL = 4  # number for "none of the three levels is met"


@dataclass(frozen=True)
class Quality:
    """A flying-qualities parameter. ``value`` and its standard deviation ``std``, by linearisation,
    are in ``unit``.
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
    raised_by : for the damping rate of the Dutch roll, by how much the lower limit of each level
        rises for each (rad/s)^2 of frequency^2 |phi/beta| above ``LARGEST_STEADY_COUPLING``; empty
        for other parameters.
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
    level : level of the value, 1 to 3, or ``WORST_LEVEL`` if it is outside all ranges.
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
    for name in _REQUIRED_PARAMETERS:
        if name not in values:
            raise ModelError(
                "it is neither estimated nor given",
                where=f"handling qualities, {name}",
                remedy="give its value under fixed",
            )
    centre = _short_period_quantities(values, airspeed, gravity)
    gradients = {name: np.zeros(len(estimate.names)) for name in centre}
    for column, name in enumerate(estimate.names):
        if name in _REQUIRED_PARAMETERS:
            stepped = _short_period_quantities(
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


def criteria_in_category(aircraft_class: str, category: str) -> list[LevelCriterion]:
    """Return the criteria for a class and a category, with those that hold for all categories."""
    return [each for each in criteria(aircraft_class) if each.category in (category, "all")]


@cache
def _all_criteria() -> tuple[LevelCriterion, ...]:
    """Return the criteria of ``handling_qualities.toml`` for all classes."""
    entries = tomllib.loads(
        (files("ident.flying_qualities") / "handling_qualities.toml").read_text(encoding="utf-8")
    )["criteria"]
    return tuple(
        LevelCriterion(
            entry["quantity"],
            entry["category"],
            tuple((float(a), float(b)) for a, b in entry["levels"]),
            entry["source"],
            tuple(entry.get("classes", CLASSES)),
            tuple(map(float, entry.get("raised_by", ()))),
        )
        for entry in entries
    )


def levels(
    quality_values: Sequence[Quality], level_criteria: Sequence[LevelCriterion] | None = None
) -> tuple[QualityLevel, ...]:
    """Return the level of each parameter in each of its criteria, in the order of the criteria.

    Without ``level_criteria``, those of class IV apply.
    """
    by_name = {quality.name: quality for quality in quality_values}
    out = []
    for criterion in criteria() if level_criteria is None else level_criteria:
        if criterion.quantity not in by_name:
            continue
        quality = by_name[criterion.quantity]
        half_width = INTERVAL_SIGMAS * quality.std
        low, high = quality.value - half_width, quality.value + half_width
        if quality.unit == "s":  # a delay or a time constant is not negative
            low = max(low, min(0.0, quality.value))
        edges = [edge for pair in criterion.levels for edge in pair if low < edge < high]
        ends = sorted([low, *edges, high])
        # Levels change at edges only: one point between successive edges, and both ends, suffice.
        midpoints = [0.5 * (a + b) for a, b in pairwise(ends)]
        reached = [level_of(value, criterion) for value in (low, *midpoints, high)]
        out.append(
            QualityLevel(
                criterion, quality, level_of(quality.value, criterion), min(reached), max(reached)
            )
        )
    return tuple(out)


def level_of(value: float, criterion: LevelCriterion) -> int:
    """Return the best level whose range contains the value; ``WORST_LEVEL`` if none does."""
    for number, (low, high) in enumerate(criterion.levels, start=1):
        if low <= value <= high:
            return number
    return WORST_LEVEL


def _short_period_quantities(
    p: Mapping[str, Any], airspeed: float, gravity: float
) -> dict[str, Any]:
    """Return quantity -> value for parameters ``p`` of the low-order equivalent system, one of
    which may have a complex step.
    """
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


# ---- Levels of the modes of a model

STANDARD = "MIL-F-8785C"
# a level with a smaller probability is reported together with other levels; 0.95 is two sigmas
DETERMINED_PROBABILITY = 0.95
LEVEL_DRAWS = 20000  # the standard error of a probability is then at most 0.35 %
# (rad/s)^2: a Dutch roll whose frequency^2 |phi/beta| is larger needs more damping
LARGEST_STEADY_COUPLING = 20.0
# quantities that have limits, by mode
MODES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "short period": (
            "damping_ratio",
            "natural_frequency",
            "control_anticipation",
            "load_factor_slope",
        ),
        "phugoid": ("phugoid_damping", "phugoid_time_to_double"),
        "Dutch roll": ("dutch_roll_damping", "dutch_roll_damping_rate", "dutch_roll_frequency"),
        "roll mode": ("roll_time_constant",),
        "spiral": ("spiral_time_to_double",),
        "roll-spiral oscillation": ("roll_spiral_damping_rate",),
        "delay": ("delay",),
    }
)


@dataclass(frozen=True)
class FlightPhase:
    """Aircraft class and flight-phase category.

    Attributes
    ----------
    aircraft_class : one of ``CLASSES``.
    category : one of ``CATEGORIES``.
    assumed : which of ``"class"`` and ``"category"`` are not declared but assumed.
    uncrewed_mass : mass, kg, if the class is not declared and the aircraft is too light for a crew,
        else None. The levels of the standard do not apply to such an aircraft.
    """

    aircraft_class: str = "II-L"
    category: str = "B"
    assumed: tuple[str, ...] = ("class", "category")
    uncrewed_mass: float | None = None


@dataclass(frozen=True)
class ModeLevel:
    """The level of one mode.

    Attributes
    ----------
    mode : one of ``MODES``.
    level : most probable level, or ``WORST_LEVEL`` if that is none of the three.
    probabilities : probabilities of level 1, of 2, of 3, and of none of the three.
    decided_by : name of the quantity whose estimate has the worst level; empty if all have level 1.
    value, limit : estimate of this quantity, and its limit for the next better level.
    sources : paragraphs of the standard.
    """

    mode: str
    level: int
    probabilities: tuple[float, ...]
    decided_by: str
    value: float
    limit: float
    sources: tuple[str, ...]

    @property
    def probability(self) -> float:
        """Probability of the most probable level."""
        return self.probabilities[self.level - 1]

    @property
    def determined(self) -> bool:
        """Whether the most probable level has at least ``DETERMINED_PROBABILITY``."""
        return self.probability >= DETERMINED_PROBABILITY


LIGHTEST_CREWED = 100.0  # kg: a lighter aircraft carries no pilot


def flight_phase_of(
    aircraft_class: str | None, category: str | None, mass: float | None = None
) -> FlightPhase:
    """Return the flight phase with a declared class and category. The defaults of `FlightPhase` are
    assumed for None.

    Class II means II-L, land-based. ``mass`` is in kg, or None if it is not known. It tells whether
    an aircraft without a declared class is too light for a crew.

    Raises
    ------
    DeclarationError : for an unknown class or category.
    """
    assumed = tuple(
        name for name, given in (("class", aircraft_class), ("category", category)) if given is None
    )
    default = FlightPhase()
    known_class = (
        default.aircraft_class if aircraft_class is None else aircraft_class.strip().upper()
    )
    known_class = "II-L" if known_class == "II" else known_class
    known_category = default.category if category is None else category.strip().upper()
    if known_class not in CLASSES:
        raise DeclarationError(
            f"there is no class {aircraft_class!r}",
            where="--class",
            remedy="use I, II, III or IV, or II-C for class II on carriers",
        )
    if known_category not in CATEGORIES:
        raise DeclarationError(
            f"there is no category {category!r}",
            where="--category",
            remedy="use A (rapid maneuvers), B (gradual maneuvers) or C (terminal phases)",
        )
    uncrewed = aircraft_class is None and mass is not None and mass < LIGHTEST_CREWED
    return FlightPhase(known_class, known_category, assumed, mass if uncrewed else None)


def mode_levels(characteristics: Characteristics, phase: FlightPhase) -> tuple[ModeLevel, ...]:
    """Return the level of each mode of a model, in the order of ``MODES``; empty for an uncrewed
    aircraft.

    The random samples of the characteristics are the same in every call.
    """
    if phase.uncrewed_mass is not None:
        return ()
    level_criteria = criteria_in_category(phase.aircraft_class, phase.category)
    estimates = _mode_quantities(characteristics.names, characteristics.values[:, None])
    sampled = _mode_quantities(characteristics.names, _random_samples(characteristics))
    out = []
    for mode, names in MODES.items():
        mode_criteria = [
            criterion
            for criterion in level_criteria
            if criterion.quantity in names and criterion.quantity in sampled
        ]
        if mode_criteria:
            out.append(_level(mode, mode_criteria, estimates, sampled))
    return tuple(out)


def _level(
    mode: str,
    mode_criteria: Sequence[LevelCriterion],
    estimates: Mapping[str, np.ndarray],
    sampled: Mapping[str, np.ndarray],
) -> ModeLevel:
    """Return the level of a mode by its criteria. ``estimates`` and ``sampled`` are quantity ->
    values, ``(1,)`` at the estimate and ``(N,)`` of the random samples.
    """
    sampled_levels = np.max(
        [_levels_reached(criterion, sampled) for criterion in mode_criteria], axis=0
    )
    probabilities = tuple(
        float(np.mean(sampled_levels == number)) for number in range(1, WORST_LEVEL + 1)
    )
    level = int(np.argmax(probabilities)) + 1
    limiting = max(
        mode_criteria, key=lambda criterion: int(_levels_reached(criterion, estimates)[0])
    )
    decided_by, value, limit = "", 0.0, 0.0
    estimated_level = int(_levels_reached(limiting, estimates)[0])
    if estimated_level > 1:
        decided_by, value = limiting.quantity, float(estimates[limiting.quantity][0])
        low, high = (
            float(np.broadcast_to(edge, 1)[0])
            for edge in _level_range(limiting, estimated_level - 1, estimates)
        )
        limit = low if value < low else high
    return ModeLevel(
        mode,
        level,
        probabilities,
        decided_by,
        value,
        limit,
        tuple(dict.fromkeys(criterion.source for criterion in mode_criteria)),
    )


def _levels_reached(criterion: LevelCriterion, quantities: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the best level ``(N,)`` that each random sample reaches in one criterion."""
    value = quantities[criterion.quantity]
    reached = np.full(value.shape, WORST_LEVEL)
    for number in range(len(criterion.levels), 0, -1):
        low, high = _level_range(criterion, number, quantities)
        reached[(value >= low) & (value <= high)] = number
    return reached


def _level_range(
    criterion: LevelCriterion, number: int, quantities: Mapping[str, np.ndarray]
) -> tuple[np.ndarray | float, float]:
    """Return the lower and the upper limit of a level. The lower limit of the damping rate of a
    Dutch roll may be different in each of N samples: ``(N,)``.
    """
    low, high = criterion.levels[number - 1]
    if not criterion.raised_by:
        return low, high
    excess = (
        quantities["dutch_roll_frequency"] ** 2 * quantities["bank_ratio"] - LARGEST_STEADY_COUPLING
    )
    return low + criterion.raised_by[number - 1] * np.maximum(excess, 0.0), high


def _random_samples(characteristics: Characteristics) -> np.ndarray:
    """Return antithetic Gaussian samples ``(k, LEVEL_DRAWS)``, the same in every call."""
    scale = np.sqrt(np.maximum(np.diag(characteristics.covariance), 0.0))
    inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)
    values, vectors = np.linalg.eigh(characteristics.covariance * np.outer(inverse, inverse))
    root = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    half = root @ np.random.default_rng(0).standard_normal((len(scale), LEVEL_DRAWS // 2))
    return characteristics.values[:, None] + np.concatenate([half, -half], axis=1)


def _mode_quantities(names: Sequence[str], draws: np.ndarray) -> dict[str, np.ndarray]:
    """Return quantity -> ``(N,)`` from N samples ``draws (k, N)`` of characteristics ``names``."""
    values = dict(zip(names, draws, strict=True))
    out: dict[str, np.ndarray] = {}
    for mode, prefix in (
        ("short_period", ""),
        ("phugoid", "phugoid_"),
        ("dutch_roll", "dutch_roll_"),
        ("roll_spiral", "roll_spiral_"),
    ):
        if f"{mode}_rate" in values:
            out |= {
                f"{prefix}{name}": value
                for name, value in _quantities_of_quadratic(
                    values[f"{mode}_rate"], values[f"{mode}_stiffness"]
                ).items()
            }
    if "natural_frequency" in out and "load_factor_slope" in values:
        slope = values["load_factor_slope"]
        out["load_factor_slope"] = slope
        out["control_anticipation"] = np.divide(
            out["natural_frequency"] ** 2,
            slope,
            out=np.full_like(slope, -math.inf),
            where=slope > 0,
        )
    if "roll_root" in values:
        root = values["roll_root"]
        out["roll_time_constant"] = np.divide(
            -1.0, root, out=np.full_like(root, math.inf), where=root < 0
        )
        out["spiral_time_to_double"] = _times_to_double(values["spiral_root"])
    if "delay" in values:
        out["delay"] = np.maximum(values["delay"], 0.0)  # no delay is negative
    return out | {name: values[name] for name in ("bank_ratio",) if name in values}


def _quantities_of_quadratic(rate: np.ndarray, stiffness: np.ndarray) -> dict[str, np.ndarray]:
    """Return the quantities of the two roots of s^2 + rate s + stiffness.

    If the roots are real and of opposite sign, the frequency is zero and the damping ratio minus
    infinity.
    """
    frequency = np.sqrt(np.maximum(stiffness, 0.0))
    damping = np.divide(
        0.5 * rate, frequency, out=np.full_like(rate, -math.inf), where=frequency > 0
    )
    growth = -0.5 * rate + np.sqrt(np.maximum(0.25 * rate**2 - stiffness, 0.0))
    damping_rate = np.where(stiffness > 0, 0.5 * rate, -growth)
    return {
        # The short period uses the first two names, all other modes those below with a prefix.
        "natural_frequency": frequency,
        "damping_ratio": damping,
        "frequency": frequency,
        "damping": damping,
        "damping_rate": damping_rate,
        "time_to_double": _times_to_double(growth),
    }


def _times_to_double(growth: np.ndarray) -> np.ndarray:
    """Return the times to double, s, for growth rates, 1/s; infinite without growth."""
    return np.divide(math.log(2.0), growth, out=np.full_like(growth, math.inf), where=growth > 0)
