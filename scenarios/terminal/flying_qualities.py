"""Levels of flying qualities in words, and as they stand in the JSON files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from ident.flying_qualities.levels import STANDARD, WORST, Flown, ModeLevel
from ident.statistics.residuals import ResidualTest

LEAST = 0.01  # probability from which a level is named among several
QUANTITIES: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "damping_ratio": ("damping ratio", ""),
        "natural_frequency": ("frequency", "rad/s"),
        "control_anticipation": ("control anticipation", "1/(g s2)"),
        "load_factor_slope": ("n/alpha", "g/rad"),
        "phugoid_damping": ("damping ratio", ""),
        "phugoid_time_to_double": ("time to double", "s"),
        "dutch_roll_damping": ("damping ratio", ""),
        "dutch_roll_damping_rate": ("damping ratio times frequency", "rad/s"),
        "dutch_roll_frequency": ("frequency", "rad/s"),
        "roll_time_constant": ("time constant", "s"),
        "spiral_time_to_double": ("time to double", "s"),
        "roll_spiral_damping_rate": ("damping ratio times frequency", "rad/s"),
        "delay": ("delay", "s"),
    }
)


def level_text(level: ModeLevel) -> str:
    """``"level 1 (97 %)"``, or what it may be where these data do not tell."""
    if level.determined:
        return f"{_named(level.level)} ({_percent(level.probability)})"
    shares = sorted(((share, number) for number, share in enumerate(level.probabilities, start=1) if share >= LEAST), reverse=True)
    return f"not determined ({', '.join(f'{_named(number)} {_percent(share)}' for share, number in shares)})"


def level_sentence(level: ModeLevel) -> str:
    """The mode, its level, and what keeps it from the next better one."""
    why = limit_text(level)
    return f"{level.mode} {level_text(level)}{f': {why}' if why else ''}"


def limit_text(level: ModeLevel) -> str:
    """What keeps the estimate from the next better level; empty at level 1."""
    if not level.decided_by:
        return ""
    words, unit = QUANTITIES[level.decided_by]
    least, spaced = "at least" if level.value < level.limit else "at most", f" {unit}" if unit else ""
    value = f"{level.value:.3g}{spaced}" if math.isfinite(level.value) else "none"
    return f"{words} {value}, asked {least} {level.limit:.3g}{spaced}"


def levels_heading(flown: Flown) -> str:
    """Standard, class and category, and what of them nobody declared."""
    assumed = f" ({' and '.join(flown.assumed)} assumed: --class, --category, or the vehicle file)" if flown.assumed else ""
    return f"levels by {STANDARD}, class {flown.aircraft_class}, category {flown.category}{assumed}"


def levels_line(levels: Sequence[ModeLevel], flown: Flown, tests: Sequence[ResidualTest]) -> str:
    """All levels in one line; empty where the model has no mode that the standard speaks of.

    Probabilities are those of the sigmas: where a residual test fails, what the model lacks is not in them, and the line says so.
    """
    if not levels:
        return ""
    doubted = "" if all(test.passed for test in tests) else ", were the model right, which its residual denies"
    return f"{levels_heading(flown)}{doubted}: {'; '.join(map(level_sentence, levels))}"


def levels_content(levels: Sequence[ModeLevel], flown: Flown) -> dict[str, Any]:
    """For a JSON file: level and probability of each mode, finite numbers only."""
    return {
        "standard": STANDARD,
        "class": flown.aircraft_class,
        "category": flown.category,
        "assumed": list(flown.assumed),
        "modes": {level.mode: _content(level) for level in levels},
    }


def changes(before: Sequence[ModeLevel], after: Sequence[ModeLevel]) -> list[str]:
    """``"the Dutch roll was level 2 (99 %), is level 1 (97 %)"`` for each mode whose level these data tell before and after, and which differs."""
    new = {level.mode: level for level in after}
    pairs = [(old, new[old.mode]) for old in before if old.mode in new]
    return [
        f"the {old.mode} was {level_text(old)}, is {level_text(now)}"
        for old, now in pairs
        if old.determined and now.determined and old.level != now.level
    ]


def _named(number: int) -> str:
    return "below level 3" if number == WORST else f"level {number}"


def _percent(share: float) -> str:
    if share >= 0.9995:
        return "> 99.9 %"
    return f"{100.0 * share:.1f} %" if share >= 0.99 else f"{100.0 * share:.0f} %"


def _content(level: ModeLevel) -> dict[str, Any]:
    out: dict[str, Any] = {
        "level": level.level,
        "probability": level.probability,
        "determined": level.determined,
        "probabilities": list(level.probabilities),
        "sources": list(level.sources),
    }
    if level.decided_by and math.isfinite(level.value):
        out |= {"decided_by": {"quantity": level.decided_by, "estimate": level.value, "limit": level.limit}}
    return out
