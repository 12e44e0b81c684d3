"""Levels of flying qualities of a model's modes, each with its probability under the estimate's covariance (MIL-F-8785C).

Draws of the modes' characteristics, Gaussian, are turned into damping, frequency and times one by one and held against all limits of a mode at
once: what a level is worth is the share of the draws that reach it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from ident.flying_qualities.characteristics import Characteristics
from ident.flying_qualities.handling_qualities import CATEGORIES, CLASSES, Criterion, criteria
from sim.errors import DeclarationError

STANDARD = "MIL-F-8785C"
DETERMINED = 0.95  # the probability from which a level is told without its neighbours: that of two sigmas
DRAWS = 20000  # the probability then has a standard error of 0.35 % at most
WORST = 4  # none of the three levels is met
STEADY_COUPLING = 20.0  # (rad/s)^2 of frequency^2 |phi/beta|, beyond which a Dutch roll is asked for more damping
MODES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "short period": ("damping_ratio", "natural_frequency", "control_anticipation", "load_factor_slope"),
        "phugoid": ("phugoid_damping", "phugoid_time_to_double"),
        "Dutch roll": ("dutch_roll_damping", "dutch_roll_damping_rate", "dutch_roll_frequency"),
        "roll mode": ("roll_time_constant",),
        "spiral": ("spiral_time_to_double",),
        "roll-spiral oscillation": ("roll_spiral_damping_rate",),
        "delay": ("delay",),
    }
)


@dataclass(frozen=True)
class Flown:
    """An aircraft's class and the category of its flight phase; ``assumed`` are those of the two that nobody declared."""

    aircraft_class: str = "II-L"
    category: str = "B"
    assumed: tuple[str, ...] = ("class", "category")


@dataclass(frozen=True)
class ModeLevel:
    """The level of one mode.

    Attributes
    ----------
    mode : one of ``MODES``.
    level : the most probable, ``WORST`` below level 3. probabilities : of levels 1, 2, 3 and of none of them.
    decided_by : the quantity that keeps the estimate from the next better level, empty at level 1; ``value`` and ``limit`` are its own.
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
        """Of the most probable level."""
        return self.probabilities[self.level - 1]

    @property
    def determined(self) -> bool:
        """Whether these data tell the level."""
        return self.probability >= DETERMINED


def flown_as(aircraft_class: str | None, category: str | None) -> Flown:
    """A declared class (II stands for II-L, from land) and category; what is None is assumed. Raises DeclarationError for what does not exist."""
    assumed = tuple(name for name, given in (("class", aircraft_class), ("category", category)) if given is None)
    default = Flown()
    chosen = default.aircraft_class if aircraft_class is None else aircraft_class.strip().upper()
    chosen, phase = "II-L" if chosen == "II" else chosen, default.category if category is None else category.strip().upper()
    if chosen not in CLASSES:
        raise DeclarationError(f"there is no class {aircraft_class!r}", where="--class", remedy="use I, II, III or IV, or II-C from a carrier")
    if phase not in CATEGORIES:
        raise DeclarationError(f"there is no category {category!r}", where="--category", remedy="use A rapid, B gradual or C terminal")
    return Flown(chosen, phase, assumed)


def mode_levels(found: Characteristics, flown: Flown) -> tuple[ModeLevel, ...]:
    """The level of each mode that the model has, in the order of ``MODES``; the same characteristics give the same numbers."""
    rules = [rule for rule in criteria(flown.aircraft_class) if rule.category in (flown.category, "all")]
    centre = _quantities(found.names, found.values[:, None])
    drawn = _quantities(found.names, _draws(found))
    out = []
    for mode, names in MODES.items():
        mine = [rule for rule in rules if rule.quantity in names and rule.quantity in drawn]
        if mine:
            out.append(_level(mode, mine, centre, drawn))
    return tuple(out)


def _level(mode: str, rules: Sequence[Criterion], centre: Mapping[str, np.ndarray], drawn: Mapping[str, np.ndarray]) -> ModeLevel:
    reached = np.max([_reached(rule, drawn) for rule in rules], axis=0)
    shares = tuple(float(np.mean(reached == number)) for number in range(1, WORST + 1))
    level = int(np.argmax(shares)) + 1
    worst = max(rules, key=lambda rule: int(_reached(rule, centre)[0]))
    decided, value, limit = "", 0.0, 0.0
    at = int(_reached(worst, centre)[0])
    if at > 1:
        decided, value = worst.quantity, float(centre[worst.quantity][0])
        low, high = (float(np.broadcast_to(edge, 1)[0]) for edge in _range(worst, at - 1, centre))
        limit = low if value < low else high
    return ModeLevel(mode, level, shares, decided, value, limit, tuple(dict.fromkeys(rule.source for rule in rules)))


def _reached(rule: Criterion, quantities: Mapping[str, np.ndarray]) -> np.ndarray:
    """The best level that each draw meets."""
    value = quantities[rule.quantity]
    reached = np.full(value.shape, WORST)
    for number in range(len(rule.levels), 0, -1):
        low, high = _range(rule, number, quantities)
        reached[(value >= low) & (value <= high)] = number
    return reached


def _range(rule: Criterion, number: int, quantities: Mapping[str, np.ndarray]) -> tuple[np.ndarray | float, float]:
    low, high = rule.levels[number - 1]
    if not rule.raised_by:
        return low, high
    excess = quantities["dutch_roll_frequency"] ** 2 * quantities["bank_ratio"] - STEADY_COUPLING
    return low + rule.raised_by[number - 1] * np.maximum(excess, 0.0), high


def _draws(found: Characteristics) -> np.ndarray:
    """``(k, DRAWS)`` of a Gaussian, the same each time; each draw has its mirror image."""
    scale = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)
    values, vectors = np.linalg.eigh(found.covariance * np.outer(inverse, inverse))
    root = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    half = root @ np.random.default_rng(0).standard_normal((len(scale), DRAWS // 2))
    return found.values[:, None] + np.concatenate([half, -half], axis=1)


def _quantities(names: Sequence[str], draws: np.ndarray) -> dict[str, np.ndarray]:
    """What the limits speak of, for each draw ``(k, N)`` of the characteristics ``names``."""
    known = dict(zip(names, draws, strict=True))
    out: dict[str, np.ndarray] = {}
    for mode, prefix in (("short_period", ""), ("phugoid", "phugoid_"), ("dutch_roll", "dutch_roll_"), ("roll_spiral", "roll_spiral_")):
        if f"{mode}_rate" in known:
            out |= {f"{prefix}{name}": value for name, value in _of_pair(known[f"{mode}_rate"], known[f"{mode}_stiffness"]).items()}
    if "natural_frequency" in out and "load_factor_slope" in known:
        slope = known["load_factor_slope"]
        out["load_factor_slope"] = slope
        out["control_anticipation"] = np.divide(out["natural_frequency"] ** 2, slope, out=np.full_like(slope, -math.inf), where=slope > 0)
    if "roll_root" in known:
        root = known["roll_root"]
        out["roll_time_constant"] = np.divide(-1.0, root, out=np.full_like(root, math.inf), where=root < 0)
        out["spiral_time_to_double"] = _doubling(known["spiral_root"])
    if "delay" in known:
        out["delay"] = np.maximum(known["delay"], 0.0)  # a draw below zero is as good as none
    return out | {name: known[name] for name in ("bank_ratio",) if name in known}


def _of_pair(rate: np.ndarray, stiffness: np.ndarray) -> dict[str, np.ndarray]:
    """Of the roots of s^2 + rate s + stiffness; a pair with a root above zero and one below has no frequency, and less than no damping."""
    frequency = np.sqrt(np.maximum(stiffness, 0.0))
    damping = np.divide(0.5 * rate, frequency, out=np.full_like(rate, -math.inf), where=frequency > 0)
    growth = -0.5 * rate + np.sqrt(np.maximum(0.25 * rate**2 - stiffness, 0.0))
    damped = np.where(stiffness > 0, 0.5 * rate, -growth)
    of_short = {"natural_frequency": frequency, "damping_ratio": damping}
    return {**of_short, "frequency": frequency, "damping": damping, "damping_rate": damped, "time_to_double": _doubling(growth)}


def _doubling(growth: np.ndarray) -> np.ndarray:
    return np.divide(math.log(2.0), growth, out=np.full_like(growth, math.inf), where=growth > 0)
