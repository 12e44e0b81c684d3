"""The grade of an answer, by the truth file of a flight."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

FEW_SIGMAS = 3.0  # largest error of a good claimed size, in its own standard deviations


class Grade(Enum):
    """The grade of one answer, the best first."""

    RIGHT = "right"
    NOTICED = "noticed"
    MISSED = "missed"
    ALARM = "false alarm"
    WRONG = "wrong name"
    REFUSED = "refused"
    FAILED = "failed"


@dataclass(frozen=True)
class Answer:
    """Result of `diagnose`: exit code, content of ``diagnosis.json`` (empty without one), end of
    the error stream, processor seconds.
    """

    code: int
    content: Mapping[str, Any]
    said: str = ""
    seconds: float = float("nan")

    @property
    def claims(self) -> list[Mapping[str, Any]]:
        """Return the claimed effects."""
        return [effect for effect in self.content.get("effects", []) if effect.get("claimed", True)]

    def warned_of(self, words: Sequence[str]) -> bool:
        """Return whether a warning or a finding about the record has one of the words."""
        texts = [
            *self.content.get("warnings", []),
            *self.content.get("record", {}).get("findings", []),
        ]
        forms = [re.compile(rf"\b{re.escape(word)}\b", re.IGNORECASE) for word in words]
        return any(form.search(str(text)) for text in texts for form in forms)


def alternatives(claim: Mapping[str, Any]) -> set[str]:
    """Return the names that a claim gives as alternatives."""
    return {
        str(other["name"] if isinstance(other, Mapping) else other)
        for other in claim.get("alternatives", [])
    }


def says(claim: Mapping[str, Any], cause: Mapping[str, Sequence[str]]) -> bool:
    """Return whether a claim names a cause: by a right name, or by a similar one with a right one
    among its alternatives.
    """
    right = set(cause["right"])
    return claim["name"] in right or (
        claim["name"] in cause["near"] and bool(alternatives(claim) & right)
    )


def grade(truth: Mapping[str, Any], answer: Answer) -> tuple[Grade, str]:
    """Return the grade of an answer and its conclusion.

    For a cause outside the library (without a right name), ``unexplained`` or a similar name is
    right. A claim that names no cause and is not harmless is wrong, regardless of other claims. A
    flight without a hidden cause is right without claims and without a warning.
    """
    if answer.code == 2:
        return Grade.REFUSED, answer.said
    if answer.code != 0 or "verdict" not in answer.content:
        return Grade.FAILED, f"exit code {answer.code}: {answer.said}"
    verdict, claims, causes = str(answer.content["verdict"]), answer.claims, truth["accepted"]
    why = f"{verdict}: {', '.join(str(claim['name']) for claim in claims) or 'no effect'}"
    foreign = [cause for cause in causes if not cause["right"]]
    known = [cause for cause in causes if cause["right"]]
    harmless = set(truth["harmless"]) | {name for cause in foreign for name in cause["near"]}
    strange = [claim for claim in claims if claim["name"] not in harmless]
    if any(not any(says(claim, cause) for cause in known) for claim in strange):
        return Grade.WRONG, why
    if not causes:
        quiet = verdict == "consistent" or (bool(claims) and verdict != "unexplained")
        return (Grade.RIGHT if quiet else Grade.ALARM), why
    named = [any(says(claim, cause) for claim in claims) for cause in known]
    seen = verdict in ("unexplained", "partial", "ambiguous")
    by_near_name = any(claim["name"] in cause["near"] for cause in foreign for claim in claims)
    if all(named) and (not foreign or seen or by_near_name):
        return Grade.RIGHT, why
    words = [word for cause in causes for word in cause["words"]]
    noticed = any(named) or seen or answer.warned_of(words)
    return (Grade.NOTICED if noticed else Grade.MISSED), why


def predictable(truth: Mapping[str, Any]) -> bool:
    """Return whether the library has every cause and a free simulation can reach the noise, which
    is not so for turbulence.
    """
    return all(
        cause["right"] and "gust-turbulence" not in cause["right"] for cause in truth["accepted"]
    )


def sizes(truth: Mapping[str, Any], answer: Answer) -> list[float]:
    """Return the distances of claimed sizes from the true ones, in their own standard deviations,
    for claims of a hidden cause.
    """
    distances = []
    for claim in answer.claims:
        for parameter, true in truth["values"].get(claim["name"], {}).items():
            found = claim.get("parameters", {}).get(parameter)
            if found is not None and found.get("std"):
                distances.append((found["value"] - true) / found["std"])
    return distances


def said_with(truth: Mapping[str, Any], answer: Answer) -> list[tuple[float, bool]]:
    """Return the probability of each claim, and whether it names a cause or is harmless."""
    causes, harmless = truth["accepted"], set(truth["harmless"])
    harmless |= {name for cause in causes if not cause["right"] for name in cause["near"]}
    known = [cause for cause in causes if cause["right"]]
    return [
        (
            float(claim["probability"][claim["name"]]),
            claim["name"] in harmless or any(says(claim, cause) for cause in known),
        )
        for claim in answer.claims
        if claim["name"] in (claim.get("probability") or {})
    ]


def _columns(path: Path) -> dict[str, np.ndarray]:
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = list(csv.reader(file))
    table = np.array([[float(cell) if cell else np.nan for cell in row] for row in rows])
    return {name.partition(" [")[0]: table[:, k] for k, name in enumerate(header)}


def held_out(folder: Path, study: Path, truth: Mapping[str, Any], when: str = "after") -> float:
    """Return the root mean square error on the held-out record over the noise, for the worst
    channel; NaN without a prediction.
    """
    written = study / "validate_prediction.csv"
    if not written.exists():
        return float("nan")
    measured, predicted = _columns(folder / "validate.csv"), _columns(written)
    ratios = []
    for name, sigma in truth["sigma"].items():
        values = predicted.get(f"{when}_{name}")
        if values is not None and len(values) == len(measured[name]):
            ratios.append(float(np.sqrt(np.nanmean((values - measured[name]) ** 2))) / sigma)
    return max(ratios, default=float("nan"))
