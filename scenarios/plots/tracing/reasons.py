"""Why a candidate was not chosen, in the few words that have room beside its bar."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ident.tracing.diagnosis import Candidate
from sim.declaration.traits import GUARD

STANDS = "cross-validated"
_LONGEST = 26  # characters
# How an answer of the cross-validation begins, and what is shown of it.
_ANSWERS = {
    "cross-validated, but": "another does better",
    STANDS: "cross-validated",
    "it does not lower": "fails held out",
    "the fall of the error": "fall within its scatter",
    "the records give": "not replicated",
    "of two records": "not replicated",
    "with two records": "explains too little",
    "its parameters are not": "not determined",
    "its parameters are beyond": "implausible",
    "a colour of the residual": "colour does as well",
    "the kinematics": "kinematics against it",
    "one-step predictions bring": "one-step predictions",
}


@dataclass(frozen=True)
class Standing:
    """What a verdict names: effects that it claims, by claim what could stand in its place, and hints.

    ``noise_left``: with the claims the residual is noise.
    """

    claimed: tuple[str, ...] = ()
    alternatives: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    hints: tuple[str, ...] = ()
    noise_left: bool = False

    @property
    def named(self) -> tuple[str, ...]:
        """All of them."""
        return (*self.claimed, *(name for each in self.alternatives.values() for name in each), *self.hints)

    def complete(self, within: tuple[str, ...]) -> bool:
        """Whether a model with these effects needed nothing more."""
        return self.noise_left and set(self.claimed) <= set(within)


def is_alternative(c: Candidate, standing: Standing) -> bool:
    """Whether a candidate could stand in the place of a claim beside all the others."""
    return any(c.name in names and set(standing.claimed) - {claim} <= set(c.within) for claim, names in standing.alternatives.items())


def reason(c: Candidate, standing: Standing, beside: Sequence[Candidate]) -> str:
    """What a candidate is to the verdict, or what spoke against it; ``beside`` are the candidates of the same round."""
    if c.name in standing.claimed:
        return "claimed"
    if is_alternative(c, standing):
        return "an alternative"
    if c.name in standing.hints:
        return "hint only"
    if standing.complete(c.within) and not c.remark:
        return "not needed"
    if not c.plausible:
        return "implausible"
    if c.name.startswith(GUARD):
        return "no effect of the library"
    if c.remark:
        return answer(c.remark)
    winner = next((each for each in beside if each.name in standing.claimed), None)
    return _against(c, winner, beside)


def _against(c: Candidate, winner: Candidate | None, beside: Sequence[Candidate]) -> str:
    if c.held_out_change is not None and c.held_out_change > 0.0:
        return "fails held out"
    if not c.fitted:
        return "screened: brings less"
    if winner is None:
        return "brings less" if c.gain < max(each.gain for each in beside) else "not replicated"
    if c.gain > winner.gain:
        worse = None not in (c.held_out_change, winner.held_out_change) and (c.held_out_change or 0.0) > (winner.held_out_change or 0.0)
        return "worse held out" if worse else "costs more parameters"
    return "like the claimed, less" if winner.name in c.collinear_with else "brings less"


def answer(remark: str) -> str:
    """An answer of the cross-validation in few words."""
    short = next((words for start, words in _ANSWERS.items() if remark.startswith(start)), remark.removeprefix("it "))
    return short if len(short) <= _LONGEST else f"{short[: _LONGEST - 1].rsplit(' ', 1)[0]} …"
