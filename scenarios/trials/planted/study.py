"""Runs a tracing scenario: fly, hand the files to the loop, score what it says against the truth."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path

from ident.tracing.diagnosis import Claim, Quantity
from ident.tracing.later_record import Predicted, predict
from scenarios.diagnosis.diagnose import diagnose_files
from scenarios.diagnosis.keeping import SPIKES
from scenarios.diagnosis.tracing import Tracing
from scenarios.preparation.plan import Request
from scenarios.trials.planted.comparable import (
    Comparable,
    Truth,
    comparable_before,
    comparable_to,
    estimated_modes,
    quantities_of,
    reasons_for,
    true_modes,
)
from scenarios.trials.planted.declaration import Expectation, TraceScenario
from scenarios.trials.planted.flights import FlownTrace, equivalent_of, fly_trace, write_flown
from scenarios.trials.planted.hiding import CLOSED_LOOP, true_vehicle
from sim.vehicles.flexibility import condense


class Grade(Enum):
    """What a diagnosis is worth once the truth is opened."""

    RIGHT = "right"
    AMBIGUOUS = "the right effects, one of them named as an alternative"
    UNDECIDED = "no effect is claimed where one should be"
    WRONG = "not what was expected"


@dataclass(frozen=True)
class Scored:
    """One derivative, parameter of an effect or modal number: true, comparable, before and after.

    Attributes
    ----------
    true : None where the truth has no such number. comparable : the value that the fitted model should find.
    before : None where there is none. condensed : of a rigid model's derivative on a flexible aircraft, else None.
    open : the flight leaves this parameter open, with or without noise. comparable_before : as ``comparable``, of ``before``.
    """

    name: str
    unit: str
    true: float | None
    comparable: float
    before: Quantity | None
    after: Quantity
    condensed: float | None = None
    open: bool = False
    comparable_before: float | None = None

    @property
    def sigmas(self) -> float:
        """Error after against the comparable value, in its reported standard deviations."""
        return (self.after.value - self.comparable) / self.after.std if self.after.std > 0 else math.nan


@dataclass(frozen=True, eq=False)
class TraceStudy:
    """A tracing scenario that has been run.

    Attributes
    ----------
    derivatives, effects, modes : estimates against what the fitted model should find, ``basis`` says how that is known.
    reasons : why a comparable value is not the true one, a sentence each.
    test : the third record predicted, which took no part in fitting or in choosing.
    """

    scenario: TraceScenario
    seed: int
    flown: FlownTrace
    tracing: Tracing
    grade: Grade
    derivatives: tuple[Scored, ...]
    effects: tuple[Scored, ...]
    modes: tuple[Scored, ...]
    basis: str
    reasons: tuple[str, ...]
    test: Predicted


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
    progress("comparing with the truth", 0.98)
    return scored(scenario, chosen, flown, tracing)


def scored(scenario: TraceScenario, seed: int, flown: FlownTrace, tracing: Tracing) -> TraceStudy:
    """A diagnosis compared with the truth, and the third record predicted by it."""
    truth = truth_of(scenario, flown)
    found, before = comparable_to(tracing, flown, truth), comparable_before(tracing, flown, truth)
    return TraceStudy(
        scenario,
        seed,
        flown,
        tracing,
        grade(scenario.expect, tracing),
        _derivatives(flown, tracing, truth, found, before),
        _effects(tracing, truth, found),
        _modes(scenario, tracing, truth, found),
        found.basis,
        reasons_for(scenario, tracing, flown, truth, found),
        predicted_test(flown, tracing),
    )


def truth_of(scenario: TraceScenario, flown: FlownTrace) -> Truth:
    """Values that are known by declaration."""
    hidden = {f"{name}.{local}": value for name, values in flown.hidden.items() for local, value in values.items()}
    modes, condensed = scenario.flight.modes, {}
    if modes and scenario.model == "rigid":
        values = {item.name: item.value for item in true_vehicle(scenario.flight).parameters}
        condensed = dict(condense(values, modes).derivatives)
    return Truth({**flown.derivatives, **hidden}, condensed, modes)


def predicted_test(flown: FlownTrace, tracing: Tracing) -> Predicted:
    """The third record predicted by the declared model and with the effects found, as `flightid predict` does."""
    d, inputs = tracing.diagnosis, {channel.name for channel in flown.test.inputs}
    assert d.trained_before is not None and d.trained_after is not None
    spiked = [name for claim in d.effects if claim.claimed and (name := claim.name.removeprefix(SPIKES)) in inputs]
    record = replace(flown.test, hold=tracing.records[0].hold, name="test.csv")
    return predict(d.trained_before, d.trained_after, tracing.model, [record], spiked)


def grade(expect: Expectation, tracing: Tracing) -> Grade:
    """Verdict and names against what is expected; an honest alternative counts as ambiguous."""
    verdict = tracing.diagnosis.verdict.value
    claims = [claim for claim in tracing.diagnosis.effects if claim.claimed]
    names = tuple(sorted(claim.name for claim in claims))
    if verdict in expect.verdicts and (names in expect.effects or (not names and not expect.effects)):
        return Grade.RIGHT
    if verdict in expect.verdicts and not names and verdict == "unexplained":
        return Grade.RIGHT
    if verdict == "ambiguous" and names in expect.effects:
        return Grade.AMBIGUOUS
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


def _derivatives(flown: FlownTrace, tracing: Tracing, truth: Truth, found: Comparable, before: Comparable) -> tuple[Scored, ...]:
    d = tracing.diagnosis
    return tuple(
        Scored(
            name,
            after.unit,
            flown.derivatives[name],
            found.values.get(name, flown.derivatives[name]),
            d.before.get(name),
            after,
            truth.condensed.get(name),
            name in found.open,
            before.values.get(name, flown.derivatives[name]),
        )
        for name, after in d.after.items()
        if name in flown.derivatives
    )


def _effects(tracing: Tracing, truth: Truth, found: Comparable) -> tuple[Scored, ...]:
    """Parameters of the effects in the fitted model, against what it should find."""
    d = tracing.diagnosis
    names = [name for name in quantities_of(d) if name not in d.after and name in found.values]
    return tuple(
        Scored(name, q.unit, truth.values.get(name), found.values[name], None, q, open=name in found.open)
        for name, q in quantities_of(d).items()
        if name in names
    )


def _modes(scenario: TraceScenario, tracing: Tracing, truth: Truth, found: Comparable) -> tuple[Scored, ...]:
    """Frequencies and damping ratios, those of elastic modes with all couplings of the aircraft."""
    d, flight = tracing.diagnosis, scenario.flight
    after = {**d.derived_after, **estimated_modes(tracing, truth.modes)}
    true = _true_modes(scenario)
    return tuple(
        Scored(name, q.unit, true.get(name), found.derived.get(name, true.get(name, 0.0)), d.derived_before.get(name), q)
        for name, q in after.items()
        if name in found.derived or (name in true and flight.own is None)
    )


def _true_modes(scenario: TraceScenario) -> dict[str, float]:
    """Frequencies and damping ratios of the true aircraft by its own equations; empty where it has no rest at zero."""
    flight = scenario.flight
    if flight.vehicle.startswith(CLOSED_LOOP):
        equivalent = equivalent_of(scenario)
        return {"natural_frequency": equivalent.natural_frequency, "damping_ratio": equivalent.damping_ratio}
    return true_modes(true_vehicle(flight)) if scenario.model in ("rigid", "flexible") else {}
