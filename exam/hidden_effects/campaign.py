"""Many flights of one tracing scenario: how often the verdict is the expected one, what is hidden
is named, and something false is claimed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

from exam.repeated import LoopFlights
from exam.scores.rates import Scores, hidden_label
from exam.scores.scored_flight import (
    ScoredFlight,
    claims_of,
    is_curve,
    outcome_of,
    over_noise,
    parameter_errors,
    plain_name,
    stated_by,
)
from exam.scoring import Share, same_fault, share_of_flights, share_within_flights
from ident.tracing.diagnosis import Claim, Verdict
from scenarios.studies.catalogue import load_document
from scenarios.trials.planted_declaration import Grade, TraceScenario
from scenarios.trials.planted_flights import trace_scenario_of
from scenarios.trials.planted_study import TraceStudy, run_trace

SIGMAS = 2.0


@dataclass(frozen=True)
class TraceJudged:
    """One flight of a tracing scenario.

    ``claimed`` : claims with their alternatives, ``"a/b"``. ``named`` : each hidden effect that the
    library has, and whether a claim names it, ``alone`` those that are named without an
    alternative. ``false`` : claims behind which nothing true stands. ``inside`` : of each
    derivative whether its interval of two sigmas, with what was claimed, holds the truth.
    """

    seed: int
    verdict: str
    grade: Grade
    claimed: tuple[str, ...]
    named: tuple[tuple[str, bool], ...]
    alone: tuple[str, ...]
    false: tuple[str, ...]
    inside: tuple[tuple[str, bool], ...]
    marked: ScoredFlight | None = None


def judge_trace(scenario: TraceScenario, seed: int) -> TraceJudged:
    """Fly and diagnose one flight, and hold it against what was hidden."""
    study = run_trace(scenario, seed)
    judged = judged_of(study)
    return replace(judged, marked=scored_flight_of(study, judged))


def scored_flight_of(study: TraceStudy, judged: TraceJudged) -> ScoredFlight:
    """The same flight for the statistics that all campaigns of the loop have in common."""
    d, claims = study.tracing.diagnosis, claims_of(study.tracing.diagnosis)
    right = frozenset(plain_name(name) for name in _true_names(study))
    truth = {name: values for name, values in study.simulated.hidden.items() if not is_curve(name)}
    return ScoredFlight(
        tuple(study.simulated.hidden),
        d.verdict.value,
        outcome_of(d.verdict.value, claims),
        tuple(claim.name for claim in claims),
        study.grade in (Grade.RIGHT, Grade.AMBIGUOUS),
        judged.false,
        stated_by(claims, right),
        parameter_errors(claims, truth),
        over_noise(d.error_before, study.simulated.noise_std),
        over_noise(d.error_after, study.simulated.noise_std),
    )


def _true_names(study: TraceStudy) -> frozenset[str]:
    """Names behind which something true stands: of what is hidden, of what the scenario accepts,
    and of the same faults.
    """
    accepted = {name for names in study.scenario.expect.effects for name in names}
    return frozenset().union(*(same_fault(name) for name in {*accepted, *study.simulated.hidden}))


def judged_of(study: TraceStudy) -> TraceJudged:
    """A tracing study held against its truth: what its scenario accepts as an answer is none that
    is false.
    """
    claims = [claim for claim in study.tracing.diagnosis.effects if claim.claimed]
    accepted = {name for names in study.scenario.expect.effects for name in names}
    hidden = [name for name in study.simulated.hidden if name in accepted] or (
        [*study.scenario.expect.effects[0]] if accepted else []
    )
    true = _true_names(study)
    return TraceJudged(
        study.seed,
        study.tracing.diagnosis.verdict.value,
        study.grade,
        tuple("/".join(_group(claim)) for claim in claims),
        tuple(
            (name, any(same_fault(name) & {*_group(claim)} for claim in claims)) for name in hidden
        ),
        tuple(
            name
            for name in hidden
            if any(claim.name in same_fault(name) and not claim.alternatives for claim in claims)
        ),
        tuple("/".join(_group(claim)) for claim in claims if not true & {*_group(claim)}),
        tuple((row.name, abs(row.sigmas) < SIGMAS) for row in study.derivatives),
    )


def trace_flights(name: str, changes: Sequence[str] = ()) -> LoopFlights:
    """Flights of a tracing scenario by its name or the path of its file."""
    # By its name: a user's own model is made of functions, which cannot be handed over to another
    # process.
    document, short, _ = load_document(name, changes)
    return LoopFlights(
        short,
        partial(_judge_named, name, tuple(changes)),
        TraceJudged,
        {"scenario": document, "files": files_of(document)},
    )


def files_of(document: Mapping[str, Any]) -> dict[str, str]:
    """Users' model files that a scenario names, by the hashes of their bytes."""
    named = [
        value for table in document.values() if isinstance(table, dict) for value in table.values()
    ]
    paths = sorted(
        {
            value
            for value in (*document.values(), *named)
            if isinstance(value, str) and value.endswith(".py")
        }
    )
    return {
        path: sha256(Path(path).read_bytes()).hexdigest() for path in paths if Path(path).is_file()
    }


def _judge_named(name: str, changes: tuple[str, ...], number: int, seed: int) -> TraceJudged:
    return judge_trace(named_scenario(name, changes), seed)


def named_scenario(name: str, changes: tuple[str, ...]) -> TraceScenario:
    """A tracing scenario with changed entries, by its name or the path of its file."""
    return trace_scenario_of(*load_document(name, changes))


def scores_of(judged: Sequence[TraceJudged]) -> Scores:
    """The flights for the statistics that all campaigns of the loop have in common."""
    marked = [flight.marked for flight in judged if flight.marked is not None]
    return Scores(marked, [hidden_label(each) for each in marked])


def verdict_shares(judged: Sequence[TraceJudged]) -> dict[str, Share]:
    """The share of each verdict."""
    return {
        verdict.value: share_of_flights(flight.verdict == verdict.value for flight in judged)
        for verdict in Verdict
    }


def trace_shares(judged: Sequence[TraceJudged]) -> dict[str, Share]:
    """The shares that a campaign is for, by their names in ``campaign.json``."""
    return {
        "expected": share_of_flights(flight.grade is Grade.RIGHT for flight in judged),
        "expected_or_alternative": share_of_flights(
            flight.grade in (Grade.RIGHT, Grade.AMBIGUOUS) for flight in judged
        ),
        "named": share_within_flights([hit for _, hit in flight.named] for flight in judged),
        "named_alone": share_within_flights(
            [name in flight.alone for name, _ in flight.named] for flight in judged
        ),
        "false_claims": share_of_flights(bool(flight.false) for flight in judged),
        "within_two_sigma": share_within_flights(
            [hit for _, hit in flight.inside] for flight in judged
        ),
    }


def _group(claim: Claim) -> tuple[str, ...]:
    return claim.name, *claim.alternatives
