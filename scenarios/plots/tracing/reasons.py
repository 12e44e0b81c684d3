"""Why a candidate was not chosen, in the few words that have room beside its bar."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ident.tracing.diagnosis import Candidate
from sim.declaration.proposal import GUARD


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
    if standing.complete(c.within) or c.weight <= 0.0:
        return "not needed"
    if c.name.startswith(GUARD):
        return "no effect of the library"
    if not c.fitted:
        return "linearised: brings less"
    winner = next((each for each in beside if each.name in standing.claimed), None)
    if winner is None:
        return "brings less" if c.weight < max(each.weight for each in beside) else "not spread evenly"
    return "like the claimed, less" if winner.name in c.collinear_with else "brings less"
