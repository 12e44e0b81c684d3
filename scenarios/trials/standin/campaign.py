"""Many flights of one stand-in: how often what dominates is named, how often something false is, and whether intervals hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ident.tracing.diagnosis import Claim, Quantity
from scenarios.studies.runs.identity import plain
from scenarios.trials.repeated import LoopFlights
from scenarios.trials.scoring import Share, share_of_flights, share_within_flights
from scenarios.trials.standin.declaration import StandIn
from scenarios.trials.standin.pseudo_true import PseudoTrue, pseudo_true
from scenarios.trials.standin.study import Naming, Progress, StandInStudy, run_standin
from sim.errors import FlightidError

BLOCK = 1.0  # s, of held-out error: longer than what residuals remember
SIGMAS = 2.0
SPREAD = 1_000_003  # between the seeds of flights and those of their pseudo-true values


@dataclass(frozen=True)
class Judged:
    """One flight: what was hidden and how it was named, what was claimed falsely, whether the held-out error grew by more than its scatter.

    ``claimed`` : claims and hints (these in parentheses) with their alternatives. ``errors`` by derivative: estimate minus pseudo-true over
    the reported sigma; ``bias``: pseudo-true minus nominal, a share of it; both empty where pseudo-true values were not asked for or could
    not be fitted.
    """

    seed: int
    verdict: str
    claimed: tuple[str, ...]
    named: tuple[tuple[str, Naming], ...]
    false: tuple[str, ...]
    small: tuple[str, ...]
    worse: bool
    errors: Mapping[str, float]
    bias: Mapping[str, float]


def judge_flight(standin: StandIn, seed: int, progress: Progress = lambda stage, share: None) -> Judged:
    """Fly and diagnose one flight, and hold it against the truth and, with ``draws`` above zero, against pseudo-true values."""
    study = run_standin(standin, seed, progress)
    limit = reference(study) if standin.draws else None
    found = claimed_model(study)
    errors = {name: (found[name].value - limit.values[name]) / found[name].std for name in found} if limit else {}
    bias = {row.name: limit.bias(row.name) for row in study.derivatives} if limit else {}
    d = study.tracing.diagnosis
    return Judged(seed, d.verdict.value, tuple(map(_said, d.effects)), study.named, study.false, study.small, worsened(study), errors, bias)


def _said(claim: Claim) -> str:
    group = "/".join((claim.name, *claim.alternatives))
    return group if claim.claimed else f"({group})"


def claimed_model(study: StandInStudy) -> dict[str, Quantity]:
    """Derivatives of the declared model with what was claimed: those before where nothing was, since hints are no claims."""
    claimed = any(claim.claimed for claim in study.tracing.diagnosis.effects)
    return {row.name: row.after if claimed else row.before for row in study.derivatives}


def reference(study: StandInStudy) -> PseudoTrue | None:
    """Pseudo-true values of the declared model with what was claimed; None where it cannot be fitted."""
    claims = {c.name: {k: q.value for k, q in c.parameters.items()} for c in study.tracing.diagnosis.effects if c.claimed}
    rng = np.random.default_rng((SPREAD, study.seed))
    try:
        found = {name: quantity.value for name, quantity in claimed_model(study).items()}
        return pseudo_true(study.flight.drawn, claims, study.standin.draws, rng, len(study.tracing.records), found)
    except (FlightidError, np.linalg.LinAlgError):
        return None


def worsened(study: StandInStudy) -> bool:
    """Whether the held-out error, all channels at their own scale, is larger after than before by more than two sigmas of its blocks."""
    changes: list[float] = []
    for p in study.tracing.diagnosis.predictions:
        z, valid = p.record.output_array(p.channels)
        before, after = (np.where(valid, z - y, 0.0) for y in (p.before, p.after))
        scale = np.mean(before**2, axis=1, keepdims=True) + 1e-300
        change = np.mean((after**2 - before**2) / scale, axis=0)
        size = max(1, round(BLOCK / float(np.median(np.diff(p.record.time)))))
        changes += [float(np.mean(change[at : at + size])) for at in range(0, len(change) - size + 1, size)]
    return bool(np.mean(changes) > SIGMAS * np.std(changes, ddof=1) / np.sqrt(len(changes)))


def standin_flights(standin: StandIn) -> LoopFlights:
    """Flights of a stand-in, each diagnosed and judged."""
    return LoopFlights(standin.name, partial(_judge, standin), Judged, {"standin": plain(standin)})


def _judge(standin: StandIn, number: int, seed: int) -> Judged:
    return judge_flight(standin, seed)


def shares(judged: Sequence[Judged]) -> dict[str, Share]:
    """The shares that a campaign is for, by their names in ``campaign.json``."""
    return {
        "named": share_within_flights([how is not Naming.MISSED for _, how in flight.named] for flight in judged),
        "named_alone": share_within_flights([how is Naming.ALONE for _, how in flight.named] for flight in judged),
        "false_claims": share_of_flights(bool(flight.false) for flight in judged),
        "small_claims": share_of_flights(bool(flight.small) for flight in judged),
        "held_out_worse": share_of_flights(flight.worse for flight in judged),
        "within_two_sigma": share_within_flights([abs(value) < SIGMAS for value in flight.errors.values()] for flight in judged),
    }


def by_effect(judged: Sequence[Judged]) -> dict[str, tuple[int, int, int]]:
    """Hidden effect -> flights, named alone, named in a group."""
    rows: dict[str, tuple[int, int, int]] = {}
    for name, how in sorted((pair for flight in judged for pair in flight.named), key=lambda pair: pair[0]):
        count, alone, grouped = rows.get(name, (0, 0, 0))
        rows[name] = (count + 1, alone + (how is Naming.ALONE), grouped + (how is Naming.IN_GROUP))
    return rows


def by_derivative(judged: Sequence[Judged]) -> dict[str, tuple[Share, float, float]]:
    """Derivative -> within two sigmas of the pseudo-true value; of its bias against the nominal one the median and the median size."""
    names = list(dict.fromkeys(name for flight in judged for name in flight.errors))
    out = {}
    for name in names:
        bias = np.array([flight.bias[name] for flight in judged if name in flight.bias])
        inside = share_of_flights(abs(flight.errors[name]) < SIGMAS for flight in judged if name in flight.errors)
        out[name] = (inside, float(np.median(bias)), float(np.median(np.abs(bias))))
    return out
