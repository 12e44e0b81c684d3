"""One flight whose truth is known, marked: what was hidden, what the loop concluded, which names it
gave and how sure it was.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

from ident.statistics.residuals import ErrorFigures
from ident.tracing.diagnosis import Claim, Diagnosis, Verdict
from sim.declaration.proposal import RangedCurve
from sim.effects.library import library

NUMBERED = ("elastic-mode",)  # effects of which a record may have several, under numbers


class Outcome(Enum):
    """What became of the question whether anything is missing; the value is what files say."""

    NAMED = "named"
    AMBIGUOUS = "ambiguous"
    UNEXPLAINED = "unexplained"
    NOTHING = "nothing missing"


class Standing(Enum):
    """An outcome held against the truth, the best first; ``NOTHING`` is right where nothing is
    hidden.
    """

    RIGHT = "named right"
    AMONG = "ambiguous, the right name among them"
    UNEXPLAINED = "unexplained"
    NOTHING = "nothing missing"
    BESIDE = "ambiguous, the right name not among them"
    WRONG = "named wrong"


@dataclass(frozen=True)
class Stated:
    """A name with the probability that the loop gave it: ``first`` of its claim or an alternative,
    and whether it is ``right``.
    """

    name: str
    probability: float
    first: bool
    right: bool


@dataclass(frozen=True)
class ScoredFlight:
    """One flight.

    Attributes
    ----------
    hidden : names of what was hidden, of effects of the library and others. given : names of the
    claims. right : every hidden effect is named, by a claim or among its alternatives, and nothing
    else; nothing is claimed where nothing is hidden. false : claims behind which nothing true
    stands. stated : every name that has a probability. errors : of the parameters of effects that
    are named right, in reported sigmas, by ``EFFECT.PARAMETER``. held_out_before, held_out_after :
    root mean square error on the held-out record over the noise, all channels.
    """

    hidden: tuple[str, ...]
    verdict: str
    outcome: Outcome
    given: tuple[str, ...]
    right: bool
    false: tuple[str, ...] = ()
    stated: tuple[Stated, ...] = ()
    errors: Mapping[str, float] = field(default_factory=dict)
    held_out_before: float = math.nan
    held_out_after: float = math.nan

    @property
    def standing(self) -> Standing:
        """The outcome against the truth."""
        if self.outcome is Outcome.NAMED:
            return Standing.RIGHT if self.right else Standing.WRONG
        if self.outcome is Outcome.AMBIGUOUS:
            return Standing.AMONG if self.right else Standing.BESIDE
        return Standing.UNEXPLAINED if self.outcome is Outcome.UNEXPLAINED else Standing.NOTHING


def claims_of(diagnosis: Diagnosis) -> list[Claim]:
    """What is claimed, hints left out."""
    return [claim for claim in diagnosis.effects if claim.claimed]


def outcome_of(verdict: str, claims: Collection[object]) -> Outcome:
    """The outcome of a verdict with its claims."""
    if verdict == Verdict.CONSISTENT.value:
        return Outcome.NOTHING
    if verdict == Verdict.UNEXPLAINED.value or not claims:
        return Outcome.UNEXPLAINED
    return Outcome.AMBIGUOUS if verdict == Verdict.AMBIGUOUS.value else Outcome.NAMED


def plain_name(name: str) -> str:
    """A name without the number that an effect bears of which a record may have several."""
    plain = name.partition("#")[0]
    return plain.partition(":")[0] if plain.startswith(NUMBERED) else plain


def stated_by(claims: Sequence[Claim], right: Collection[str]) -> tuple[Stated, ...]:
    """All names of some claims that have a probability; ``right`` are the names that count as
    right.
    """
    return tuple(
        Stated(name, p, name == claim.name, plain_name(name) in right)
        for claim in claims
        for name, p in claim.probability.items()
        if math.isfinite(p)
    )


def parameter_errors(
    claims: Sequence[Claim], truth: Mapping[str, Mapping[str, float]]
) -> dict[str, float]:
    """Errors of effects' parameters in reported sigmas, ``EFFECT.PARAMETER``; ``truth`` has true
    local values by name of an effect.
    """
    return {
        f"{claim.name}.{local}": float((found.value - truth[claim.name][local]) / found.std)
        for claim in claims
        for local, found in claim.parameters.items()
        if local in truth.get(claim.name, {}) and math.isfinite(found.std) and found.std > 0.0
    }


def is_curve(name: str) -> bool:
    """Whether an effect of the library is a curve, whose coefficients hang on the range that a
    search saw: no truth is comparable with them.
    """
    return any(isinstance(effect, RangedCurve) for effect in library() if effect.name == name)


def over_noise(figures: ErrorFigures, noise: Mapping[str, float]) -> float:
    """Root mean square of a simulation error over the noise of its channels: one where only noise
    is left.
    """
    squares = [
        (rmse / noise[name]) ** 2
        for name, rmse in figures.rmse.items()
        if noise.get(name, 0.0) > 0.0
    ]
    return math.sqrt(sum(squares) / len(squares)) if squares else math.nan
