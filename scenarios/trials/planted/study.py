"""Runs a tracing scenario: fly, hand the files to the loop, score what it says against the truth."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from ident.tracing.diagnosis import Claim, Quantity
from scenarios.diagnosis.diagnose import diagnose_files
from scenarios.diagnosis.tracing import Tracing
from scenarios.preparation.request import Request
from scenarios.trials.planted.declaration import Expectation, TraceScenario
from scenarios.trials.planted.flights import FlownTrace, fly_trace, write_flown


class Grade(Enum):
    """What a diagnosis is worth once the truth is opened."""

    RIGHT = "right"
    AMBIGUOUS = "the right effects, one of them named as an alternative"
    UNDECIDED = "no effect is claimed where one should be"
    WRONG = "not what was expected"


@dataclass(frozen=True)
class Scored:
    """One derivative or parameter of an effect: true, before and after; ``before`` None where there is none."""

    name: str
    unit: str
    true: float
    before: Quantity | None
    after: Quantity

    @property
    def sigmas(self) -> float:
        """Error after, in its reported standard deviations."""
        return (self.after.value - self.true) / self.after.std if self.after.std > 0 else math.nan


@dataclass(frozen=True, eq=False)
class TraceStudy:
    """A tracing scenario that has been run."""

    scenario: TraceScenario
    seed: int
    flown: FlownTrace
    tracing: Tracing
    grade: Grade
    derivatives: tuple[Scored, ...]
    effects: tuple[Scored, ...]


def run_trace(scenario: TraceScenario, seed: int | None = None, progress: Callable[[str, float], None] = lambda stage, share: None) -> TraceStudy:
    """Fly, trace on the files alone, score.

    Raises
    ------
    FlightidError : the scenario declares something that cannot be flown.
    """
    chosen = scenario.seed if seed is None else seed
    progress("flying", 0.0)
    flown = fly_trace(scenario, chosen)
    with tempfile.TemporaryDirectory(prefix="flightid-") as folder:
        train, validate, vehicle = write_flown(flown, Path(folder))
        tracing = diagnose_files(Request((train,), scenario.model, vehicle, (validate,), effort=scenario.effort), progress)
    return TraceStudy(scenario, chosen, flown, tracing, grade(scenario.expect, tracing), _derivatives(flown, tracing), _effects(flown, tracing))


def grade(expect: Expectation, tracing: Tracing) -> Grade:
    """Verdict and names against what is expected; an honest alternative counts as ambiguous."""
    verdict = tracing.diagnosis.verdict.value
    claims = [claim for claim in tracing.diagnosis.effects if claim.claimed]
    names = tuple(sorted(claim.name for claim in claims))
    if verdict in expect.verdicts and (names in expect.effects or (not names and not expect.effects)):
        return Grade.RIGHT
    if verdict in expect.verdicts and not names and verdict == "unexplained":
        return Grade.RIGHT
    if verdict != "unexplained" and any(_stands_beside(claims, accepted) for accepted in expect.effects):
        return Grade.AMBIGUOUS
    return Grade.UNDECIDED if verdict == "unexplained" and not names else Grade.WRONG


def _stands_beside(claims: list[Claim], accepted: tuple[str, ...]) -> bool:
    """Whether one exchange of a name for one of its alternatives makes the claims the accepted set."""
    names = [claim.name for claim in claims]
    for place, claim in enumerate(claims):
        for other in claim.alternatives:
            if tuple(sorted([*names[:place], other, *names[place + 1 :]])) == accepted:
                return True
    return False


def _derivatives(flown: FlownTrace, tracing: Tracing) -> tuple[Scored, ...]:
    d = tracing.diagnosis
    return tuple(
        Scored(name, after.unit, flown.derivatives[name], d.before.get(name), after) for name, after in d.after.items() if name in flown.derivatives
    )


def _effects(flown: FlownTrace, tracing: Tracing) -> tuple[Scored, ...]:
    """Parameters of effects that were hidden under the name and in the form in which they are claimed."""
    rows = []
    for claim in tracing.diagnosis.effects:
        true: Mapping[str, float] = flown.hidden.get(claim.name, {})
        for name, quantity in claim.parameters.items():
            if name in true:
                rows.append(Scored(f"{claim.name}.{name}", quantity.unit, true[name], None, quantity))
    return tuple(rows)
