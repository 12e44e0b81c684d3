"""The summary that every study begins with: five lines at most, each of the terminal's width; the details follow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ident.statistics.residuals import ResidualTest
from scenarios.terminal.display_units import in_hertz, shown_in, spaced
from scenarios.terminal.numbers import derived_line, number
from scenarios.terminal.paragraphs import WIDTH, print_lines, shortened
from scenarios.terminal.quantities import determined

if TYPE_CHECKING:
    from rich.console import Console

SHOWN = 3  # numbers that a summary names
BELOW = "below; --out FOLDER keeps them"
PAGE = "report.html"  # in the folder of every study
HERE = "below, and the files of this folder"


@dataclass(frozen=True)
class Summary:
    """What was done, what came of it, the numbers that matter most, what the fit leaves, and where more is to be read; a line each."""

    study: str
    outcome: str
    result: str = ""
    residual: str = ""
    details: str = BELOW


def summary_lines(summary: Summary, width: int = WIDTH) -> list[str]:
    """A line for each part that says something; what is too long ends in dots between two words and stands in full below."""
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
    sigma = f" +- {number(factor * std, factor * std)}" if std > 0.0 else ""
    return f"{name} {number(factor * value, factor * std)}{sigma}{spaced(text)}{in_hertz(value, name, unit)}"


def result_phrase(values: Sequence[tuple[str, float, float, str]], derived: Mapping[str, tuple[float, float]]) -> str:
    """What follows from the parameters where anything does, and the first of them (name, value, sigma, unit), ``SHOWN`` in all."""
    follows = derived_line(dict(list(derived.items())[:SHOWN]))
    room = SHOWN - min(len(derived), SHOWN)
    named = [value_phrase(*each) for each in values[:room]]
    more = f"; {len(values) - room} more" if named and len(values) > room else ""
    return "; ".join([*([follows] if follows else []), *named]) + more


def residual_phrase(tests: Sequence[ResidualTest]) -> str:
    """``"the noise alone in alpha and nz; not in q"``; empty where nothing was tested."""
    channels = list(dict.fromkeys(test.channel.partition(",")[0] for test in tests))
    failed = [name for name in channels if any(not test.passed and test.channel.partition(",")[0] == name for test in tests)]
    sound = [name for name in channels if name not in failed and name != "all"]
    if not failed:
        return f"the noise alone in {_listed(sound)}" if sound else ""
    named = [name for name in failed if name != "all"]
    told = f"more than noise in {_listed(named)}" if named else "not what the noise alone would give"
    return f"{told}; the noise alone in {_listed(sound)}" if sound and named else told


def _listed(words: Sequence[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)
