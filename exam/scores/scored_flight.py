"""The score of one flight with a known truth: hidden effects, conclusion of the loop, and given
names with their probabilities.
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
    """Outcome of the question whether anything is missing in the model; the values are the words in
    files.
    """

    NAMED = "named"
    AMBIGUOUS = "ambiguous"
    UNEXPLAINED = "unexplained"
    NOTHING = "nothing missing"


class Standing(Enum):
    """An outcome compared with the truth, the best first. ``NOTHING`` is right if nothing is
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
    """A name with the probability that the loop gave it, whether it is the ``first`` of its claim
    or an alternative, and whether it is ``right``.
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
    hidden : names of the hidden effects, in and outside the library.
    given : names of the claims.
    right : whether every hidden effect, and nothing else, is named by a claim or among its
        alternatives; if nothing is hidden, whether nothing is claimed.
    false : claims that do not correspond to any true cause.
    stated : all names that have a probability.
    errors : errors of the parameters of effects that are named right, in reported sigmas, by
        ``EFFECT.PARAMETER``.
    held_out_before, held_out_after : root mean square error on the held-out record over the noise,
        all channels.
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
        """The outcome compared with the truth."""
        if self.outcome is Outcome.NAMED:
            return Standing.RIGHT if self.right else Standing.WRONG
        if self.outcome is Outcome.AMBIGUOUS:
            return Standing.AMONG if self.right else Standing.BESIDE
        return Standing.UNEXPLAINED if self.outcome is Outcome.UNEXPLAINED else Standing.NOTHING


def claims_of(diagnosis: Diagnosis) -> list[Claim]:
    """Return the claimed effects, without hints."""
    return [claim for claim in diagnosis.effects if claim.claimed]


def outcome_of(verdict: str, claims: Collection[object]) -> Outcome:
    """Return the outcome of a verdict with its claims."""
    if verdict == Verdict.CONSISTENT.value:
        return Outcome.NOTHING
    if verdict == Verdict.UNEXPLAINED.value or not claims:
        return Outcome.UNEXPLAINED
    return Outcome.AMBIGUOUS if verdict == Verdict.AMBIGUOUS.value else Outcome.NAMED


def plain_name(name: str) -> str:
    """Return a name without the number of an effect of which a record may have several."""
    plain = name.partition("#")[0]
    return plain.partition(":")[0] if plain.startswith(NUMBERED) else plain


def stated_by(claims: Sequence[Claim], right: Collection[str]) -> tuple[Stated, ...]:
    """Return all names of some claims that have a probability; ``right`` are the names that count
    as right.
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
    """Return the errors of effects' parameters in reported sigmas, by ``EFFECT.PARAMETER``.

    ``truth`` has the true local values by name of the effect.
    """
    return {
        f"{claim.name}.{local}": float((found.value - truth[claim.name][local]) / found.std)
        for claim in claims
        for local, found in claim.parameters.items()
        if local in truth.get(claim.name, {}) and math.isfinite(found.std) and found.std > 0.0
    }


def is_curve(name: str) -> bool:
    """Return whether an effect of the library is a curve.

    Its coefficients depend on the range that a search saw, so no truth can be compared with them.
    """
    return any(isinstance(effect, RangedCurve) for effect in library() if effect.name == name)


def over_noise(figures: ErrorFigures, noise: Mapping[str, float]) -> float:
    """Return the root mean square of a simulation error over the noise of its channels; it is one
    for noise alone.
    """
    squares = [
        (rmse / noise[name]) ** 2
        for name, rmse in figures.rmse.items()
        if noise.get(name, 0.0) > 0.0
    ]
    return math.sqrt(sum(squares) / len(squares)) if squares else math.nan
