"""Summary lines of a study, and levels of flying qualities in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from ident.flying_qualities.levels import STANDARD, WORST, Flown, ModeLevel
from ident.statistics.residuals import ResidualTest
from scenarios.report.quantities import (
    derived_line,
    determined,
    in_hertz,
    number_text,
    shown_in,
    spaced,
)
from scenarios.report.text_tables import WIDTH, print_lines, shortened

if TYPE_CHECKING:
    from rich.console import Console


# ---- Levels of flying qualities in words, and as they stand in the JSON files

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
    shares = sorted(
        (
            (share, number)
            for number, share in enumerate(level.probabilities, start=1)
            if share >= LEAST
        ),
        reverse=True,
    )
    return (
        "not determined "
        f"({', '.join(f'{_named(number)} {_percent(share)}' for share, number in shares)})"
    )


def level_sentence(level: ModeLevel) -> str:
    """The mode, its level, and what keeps it from the next better one."""
    why = limit_text(level)
    return f"{level.mode} {level_text(level)}{f': {why}' if why else ''}"


def limit_text(level: ModeLevel) -> str:
    """What keeps the estimate from the next better level; empty at level 1."""
    if not level.decided_by:
        return ""
    words, unit = QUANTITIES[level.decided_by]
    least, spaced = (
        "at least" if level.value < level.limit else "at most",
        f" {unit}" if unit else "",
    )
    value = f"{level.value:.3g}{spaced}" if math.isfinite(level.value) else "none"
    return f"{words} {value}, asked {least} {level.limit:.3g}{spaced}"


def levels_heading(flown: Flown) -> str:
    """Standard, class and category, and what of them nobody declared."""
    assumed = (
        f" ({' and '.join(flown.assumed)} assumed, as neither an option (--class, --category) nor "
        "the vehicle file gives it)"
        if flown.assumed
        else ""
    )
    return f"levels by {STANDARD}, class {flown.aircraft_class}, category {flown.category}{assumed}"


def levels_line(levels: Sequence[ModeLevel], flown: Flown, tests: Sequence[ResidualTest]) -> str:
    """All levels in one line; empty where the model has no mode that the standard speaks of.

    Probabilities are those of the sigmas: where a residual test fails, what the model lacks is not
    in them, and the line says so.
    """
    if not levels:
        return ""
    doubted = (
        ""
        if all(test.passed for test in tests)
        else ", not valid here: the residual shows that the model is incomplete"
    )
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
    """``"the Dutch roll was level 2 (99 %), is level 1 (97 %)"`` for each mode whose level these
    data tell before and after, and which differs.
    """
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
        out |= {
            "decided_by": {
                "quantity": level.decided_by,
                "estimate": level.value,
                "limit": level.limit,
            }
        }
    return out


# ---- The summary that every study begins with

SHOWN = 3  # numbers that a summary names
BELOW = "below; --out FOLDER keeps them"
PAGE = "report.html"  # in the folder of every study
TEXT = "study.txt"  # what its command printed, or more
HERE = "below, and the files of this folder"


@dataclass(frozen=True)
class Summary:
    """What was done, what came of it, the numbers that matter most, what the fit leaves, and where
    more is to be read; a line each.
    """

    study: str
    outcome: str
    result: str = ""
    residual: str = ""
    details: str = BELOW


def summary_lines(summary: Summary, width: int = WIDTH) -> list[str]:
    """A line for each part that says something; what is too long ends in dots between two words and
    stands in full below.
    """
    return [shortened(text, width, f"{label:10}") for label, text in vars(summary).items() if text]


def print_summary(out: Console, summary: Summary) -> None:
    """Print the summary, and an empty line."""
    print_lines(out, [*summary_lines(summary, out.width), ""])


def details_in(folder: Path | None) -> str:
    """Where more is to be read: below, and in the study's folder, beginning with its page."""
    return BELOW if folder is None else f"below; in {folder / PAGE}"


def written_to(folder: Path) -> str:
    """The last line of a command that wrote a study."""
    return f"written to {folder}; begin with {folder / PAGE}"


def value_phrase(name: str, value: float, std: float, unit: str) -> str:
    """``"Cm_alpha -1.657 +- 0.002 1/rad"``, in the unit in which it is shown."""
    if std > 0.0 and not determined(value, std):
        return f"{name} not determined"
    factor, text = shown_in(unit, name)
    sigma = f" +- {number_text(factor * std, factor * std)}" if std > 0.0 else ""
    return (
        f"{name} "
        f"{number_text(factor * value, factor * std)}{sigma}{spaced(text)}{in_hertz(value, name, unit)}"  # noqa: E501
    )


def result_phrase(
    values: Sequence[tuple[str, float, float, str]], derived: Mapping[str, tuple[float, float]]
) -> str:
    """What follows from the parameters where anything does, and the first of them (name, value,
    sigma, unit), ``SHOWN`` in all.
    """
    follows = derived_line(dict(list(derived.items())[:SHOWN]))
    room = SHOWN - min(len(derived), SHOWN)
    named = [value_phrase(*each) for each in values[:room]]
    more = f"; {len(values) - room} more" if named and len(values) > room else ""
    return "; ".join([*([follows] if follows else []), *named]) + more


def residual_phrase(tests: Sequence[ResidualTest]) -> str:
    """``"consistent with noise in alpha and nz; not in q"``; empty where nothing was tested."""
    channels = list(dict.fromkeys(test.channel.partition(",")[0] for test in tests))
    failed = [
        name
        for name in channels
        if any(not test.passed and test.channel.partition(",")[0] == name for test in tests)
    ]
    sound = [name for name in channels if name not in failed and name != "all"]
    if not failed:
        return f"consistent with noise in {_listed(sound)}" if sound else ""
    named = [name for name in failed if name != "all"]
    told = f"more than noise in {_listed(named)}" if named else "not consistent with noise"
    return f"{told}; consistent with noise in {_listed(sound)}" if sound and named else told


def _listed(words: Sequence[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)
