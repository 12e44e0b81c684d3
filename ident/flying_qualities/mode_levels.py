"""Levels of flying qualities of the modes of a model, with their probabilities.

Each random sample of the characteristics of the modes, from their Gaussian distribution, is
converted to damping ratios, frequencies and times, and compared with all limits of a mode together.
The probability of a level is the share of the samples that reach it. The limits are in
``handling_qualities.toml``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from ident.flying_qualities.levels import CATEGORIES, CLASSES, LevelCriterion, criteria
from ident.flying_qualities.modes import Characteristics
from sim.errors import DeclarationError

STANDARD = "MIL-F-8785C"
# smallest probability of a level that is reported without its neighbours (two sigmas)
DETERMINED_PROBABILITY = 0.95
LEVEL_DRAWS = 20000  # the standard error of a probability is then at most 0.35 %
WORST_LEVEL = 4  # number for "none of the three levels is met"
# (rad/s)^2: a Dutch roll with a larger frequency^2 |phi/beta| needs more damping
STEADY_COUPLING = 20.0
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
    uncrewed_mass : mass, kg, of an aircraft that has no declared class and is too light for a crew;
        it has no levels. None for other aircraft.
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
    probabilities : probabilities of levels 1, 2 and 3, and of none of them.
    decided_by : name of the quantity that prevents the next better level at the estimate; empty at
        level 1.
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
    """Return the flight phase with a declared class and category; None assumes the default.

    Class II means II-L, land-based. ``mass`` is in kg, None if it is not known: an aircraft without
    a declared class that is too light for a crew has no levels. Raises DeclarationError for an
    unknown class or category.
    """
    assumed = tuple(
        name for name, given in (("class", aircraft_class), ("category", category)) if given is None
    )
    default = FlightPhase()
    chosen = default.aircraft_class if aircraft_class is None else aircraft_class.strip().upper()
    chosen, phase = (
        "II-L" if chosen == "II" else chosen,
        default.category if category is None else category.strip().upper(),
    )
    if chosen not in CLASSES:
        raise DeclarationError(
            f"there is no class {aircraft_class!r}",
            where="--class",
            remedy="use I, II, III or IV, or II-C from a carrier",
        )
    if phase not in CATEGORIES:
        raise DeclarationError(
            f"there is no category {category!r}",
            where="--category",
            remedy="use A rapid, B gradual or C terminal",
        )
    light = aircraft_class is None and mass is not None and mass < LIGHTEST_CREWED
    return FlightPhase(chosen, phase, assumed, mass if light else None)


def mode_levels(characteristics: Characteristics, flown: FlightPhase) -> tuple[ModeLevel, ...]:
    """Return the level of each mode of a model, in the order of ``MODES``; empty for an uncrewed
    aircraft.

    The random samples of the characteristics are the same in every call.
    """
    if flown.uncrewed_mass is not None:
        return ()
    rules = [
        rule for rule in criteria(flown.aircraft_class) if rule.category in (flown.category, "all")
    ]
    centre = _quantities(characteristics.names, characteristics.values[:, None])
    sampled = _quantities(characteristics.names, _draws(characteristics))
    out = []
    for mode, names in MODES.items():
        mode_rules = [rule for rule in rules if rule.quantity in names and rule.quantity in sampled]
        if mode_rules:
            out.append(_level(mode, mode_rules, centre, sampled))
    return tuple(out)


def _level(
    mode: str,
    rules: Sequence[LevelCriterion],
    centre: Mapping[str, np.ndarray],
    sampled: Mapping[str, np.ndarray],
) -> ModeLevel:
    """Return the level of a mode by its criteria, for the estimate ``centre`` and all samples."""
    reached = np.max([_reached(rule, sampled) for rule in rules], axis=0)
    shares = tuple(float(np.mean(reached == number)) for number in range(1, WORST_LEVEL + 1))
    level = int(np.argmax(shares)) + 1
    worst = max(rules, key=lambda rule: int(_reached(rule, centre)[0]))
    decided, value, limit = "", 0.0, 0.0
    at = int(_reached(worst, centre)[0])
    if at > 1:
        decided, value = worst.quantity, float(centre[worst.quantity][0])
        low, high = (float(np.broadcast_to(edge, 1)[0]) for edge in _range(worst, at - 1, centre))
        limit = low if value < low else high
    return ModeLevel(
        mode,
        level,
        shares,
        decided,
        value,
        limit,
        tuple(dict.fromkeys(rule.source for rule in rules)),
    )


def _reached(rule: LevelCriterion, quantities: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the best level ``(N,)`` that each random sample reaches in one criterion."""
    value = quantities[rule.quantity]
    reached = np.full(value.shape, WORST_LEVEL)
    for number in range(len(rule.levels), 0, -1):
        low, high = _range(rule, number, quantities)
        reached[(value >= low) & (value <= high)] = number
    return reached


def _range(
    rule: LevelCriterion, number: int, quantities: Mapping[str, np.ndarray]
) -> tuple[np.ndarray | float, float]:
    """Return the range of a level, with the raised lower end of a Dutch roll ``(N,)``."""
    low, high = rule.levels[number - 1]
    if not rule.raised_by:
        return low, high
    excess = quantities["dutch_roll_frequency"] ** 2 * quantities["bank_ratio"] - STEADY_COUPLING
    return low + rule.raised_by[number - 1] * np.maximum(excess, 0.0), high


def _draws(characteristics: Characteristics) -> np.ndarray:
    """Return random samples ``(k, LEVEL_DRAWS)`` of the characteristics, as antithetic pairs of
    Gaussian numbers; the same in every call.
    """
    scale = np.sqrt(np.maximum(np.diag(characteristics.covariance), 0.0))
    inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)
    values, vectors = np.linalg.eigh(characteristics.covariance * np.outer(inverse, inverse))
    root = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    half = root @ np.random.default_rng(0).standard_normal((len(scale), LEVEL_DRAWS // 2))
    return characteristics.values[:, None] + np.concatenate([half, -half], axis=1)


def _quantities(names: Sequence[str], draws: np.ndarray) -> dict[str, np.ndarray]:
    """Return quantity -> ``(N,)`` for all quantities that have limits, from N samples ``draws (k,
    N)`` of the characteristics ``names``.
    """
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
                for name, value in _quantities_of_pair(
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
        out["spiral_time_to_double"] = _doubling(values["spiral_root"])
    if "delay" in values:
        out["delay"] = np.maximum(values["delay"], 0.0)  # no delay is negative
    return out | {name: values[name] for name in ("bank_ratio",) if name in values}


def _quantities_of_pair(rate: np.ndarray, stiffness: np.ndarray) -> dict[str, np.ndarray]:
    """Return the quantities of the roots of s^2 + rate s + stiffness. Real roots of opposite sign
    have the frequency zero and negative damping.
    """
    frequency = np.sqrt(np.maximum(stiffness, 0.0))
    damping = np.divide(
        0.5 * rate, frequency, out=np.full_like(rate, -math.inf), where=frequency > 0
    )
    growth = -0.5 * rate + np.sqrt(np.maximum(0.25 * rate**2 - stiffness, 0.0))
    damped = np.where(stiffness > 0, 0.5 * rate, -growth)
    with_short_period_names = {"natural_frequency": frequency, "damping_ratio": damping}
    return {
        **with_short_period_names,
        "frequency": frequency,
        "damping": damping,
        "damping_rate": damped,
        "time_to_double": _doubling(growth),
    }


def _doubling(growth: np.ndarray) -> np.ndarray:
    """Return the times to double, s, for growth rates, 1/s; infinite without growth."""
    return np.divide(math.log(2.0), growth, out=np.full_like(growth, math.inf), where=growth > 0)
