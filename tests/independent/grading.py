"""What an answer is worth: told right, noticed, missed, a false claim, or an alarm about
nothing.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

# every aircraft that exchanges speed and height has it, beside whatever else is wrong
HARMLESS = "phugoid"
SHOWN = 100  # characters of an error
QUIET = ("nothing", "phugoid")  # faults that are none: a flight with one of these needs no name


class Grade(Enum):
    """The worth of one answer, best first."""

    RIGHT = "right"
    NOTICED = "noticed"
    MISSED = "missed"
    ALARM = "alarm"
    FALSE = "FALSE"
    BROKEN = "BROKEN"


@dataclass(frozen=True)
class Fault:
    """What was put in, as the truth file has it: names that say it, names that it cannot be told
    from, columns that it spoils.
    """

    name: str
    right: frozenset[str] = frozenset()
    twins: frozenset[str] = frozenset()
    channels: tuple[str, ...] = ()


@dataclass(frozen=True)
class Answer:
    """How the command ended, what it wrote, and its last words on the error stream."""

    code: int
    content: Mapping[str, Any]
    said: str = ""

    @property
    def claims(self) -> list[Mapping[str, Any]]:
        """Claimed effects."""
        return [effect for effect in self.content.get("effects", []) if effect.get("claimed", True)]

    @property
    def findings(self) -> list[str]:
        """What is said of the record itself, one text an entry, in lower case."""
        return [str(entry).lower() for entry in self.content.get("record", {}).get("findings", [])]

    def warned_of(self, words: Sequence[str]) -> bool:
        """Whether a finding about the record, or a warning, names one of the words (an underscore
        stands for a blank).
        """
        texts = [
            *self.findings,
            *(str(warning).lower() for warning in self.content.get("warnings", [])),
        ]
        forms = [re.compile(rf"\b{re.escape(word.lower().replace('_', ' '))}\b") for word in words]
        return any(form.search(text) for text in texts for form in forms)


@dataclass(frozen=True)
class Graded:
    grade: Grade
    why: str


def says(claim: Mapping[str, Any], fault: Fault) -> bool:
    """Whether a claim names the fault, or a twin of it with the fault's name among the
    alternatives.
    """
    others = {
        str(other["name"] if isinstance(other, Mapping) else other)
        for other in claim.get("alternatives", [])
    }
    return claim["name"] in fault.right or (
        claim["name"] in fault.twins and bool(others & fault.right)
    )


def graded(faults: Sequence[Fault], answer: Answer) -> Graded:
    """The grade of an answer about a flight with these faults (none, or one named ``nothing``,
    where nothing was put in).

    A claim but the phugoid that says none of the faults is false, whatever stands beside it. All
    faults said is right. Otherwise it is noticed where one of several faults is said, the command
    refused, it called the flight unexplained, partial or ambiguous, or it warned of a column that a
    fault spoils; else missed. Where nothing was put in, no claim is right, and unexplained or
    refused an alarm.
    """
    real = [fault for fault in faults if fault.name not in QUIET]
    if answer.code not in (0, 2) or (answer.code == 0 and "verdict" not in answer.content):
        return Graded(Grade.BROKEN, f"exit code {answer.code}")
    if answer.code == 2:
        return Graded(Grade.NOTICED if real else Grade.ALARM, f"refused: {answer.said[:SHOWN]}")
    verdict = str(answer.content["verdict"])
    why = f"{verdict}: {', '.join(str(claim['name']) for claim in answer.claims) or 'no effect'}"
    if any(
        claim["name"] != HARMLESS and not any(says(claim, fault) for fault in real)
        for claim in answer.claims
    ):
        return Graded(Grade.FALSE, why)
    if not real:
        return Graded(Grade.ALARM if verdict == "unexplained" else Grade.RIGHT, why)
    said = [any(says(claim, fault) for claim in answer.claims) for fault in real]
    if all(said):
        by_twin = any(claim["name"] in fault.twins for claim in answer.claims for fault in real)
        return Graded(Grade.RIGHT, f"{why} (by a twin)" if by_twin else why)
    words = [word for fault in real for word in fault.channels]
    noticed = (
        any(said) or verdict in ("unexplained", "partial", "ambiguous") or answer.warned_of(words)
    )
    return Graded(Grade.NOTICED if noticed else Grade.MISSED, why)


def worst_derivative(answer: Answer, true: Mapping[str, float]) -> float:
    """The largest distance of an estimated derivative from the truth, in its own standard
    deviations; NaN where none is reported.
    """
    after = answer.content.get("parameters", {}).get("after", {})
    distances = [
        abs(after[name]["value"] - value) / after[name]["std"]
        for name, value in true.items()
        if name in after
    ]
    return float(np.max(distances)) if distances else float("nan")
