"""Inputs that run ahead of the aircraft by part of a sample were read as held although they move
between samples: they are read again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ident.tracing.diagnosis import Diagnosis, Verdict
from scenarios.preparation.declared_model import BETTER, held_by_computer
from scenarios.preparation.plan import BY_HAND
from sim.declaration.model import Model
from sim.declaration.proposal import Traceable
from sim.record import Hold, Record

CHOOSE = "--hold linear or --hold previous says which"
TIMES = ("delay", "time_constant")  # parameters by which an output or an input is late
STRENGTH = (
    Verdict.CONSISTENT,
    Verdict.TRACED,
    Verdict.AMBIGUOUS,
    Verdict.PARTIAL,
    Verdict.UNEXPLAINED,
)
READ_AGAIN = (
    "held ones would run ahead of the aircraft by a part of a sample; --hold previous holds them"
)


def moves_between_samples(
    diagnosis: Diagnosis, candidates: Sequence[Traceable], records: Sequence[Record]
) -> bool:
    """Whether something that was found says no more than how held inputs are to be read between
    their samples.

    A held input stands half an interval behind the one that moves on: a time of that kind below one
    interval is no fault of a recorder. Where it is but an alternative of what was found, its size
    is not asked.
    """
    if any(record.hold is not Hold.PREVIOUS for record in records):
        return False
    interval = max(float(np.median(np.diff(record.time))) for record in records)
    times = {
        effect.name: effect.traits.within_interval
        for effect in candidates
        if effect.traits.within_interval
    }
    named = any(
        found.name in times and found.parameters[times[found.name]].value < interval
        for found in diagnosis.effects
    )
    return named or any(times.keys() & {*found.alternatives} for found in diagnosis.effects)


def tells_times(diagnosis: Diagnosis, records: Sequence[Record]) -> bool:
    """Whether times were found that held inputs would shift by half an interval, and an input
    passes through several samples as it moves.
    """
    if any(record.hold is not Hold.PREVIOUS or held_by_computer(record) for record in records):
        return False
    return any(name in TIMES for found in diagnosis.effects for name in found.parameters)


def no_worse(again: Diagnosis, first: Diagnosis) -> bool:
    """Whether the second reading of the inputs explains at least as much as the first."""
    return STRENGTH.index(again.verdict) <= STRENGTH.index(first.verdict)


def better(again: Diagnosis, first: Diagnosis) -> bool:
    """Whether the second reading explains as much with a clearly lower criterion."""
    return no_worse(again, first) and _lowered(again, first) > BETTER


def rise(
    diagnosis: Diagnosis, model: Model, held: Sequence[Record], linear: Sequence[Record]
) -> float:
    """By how much twice the log likelihood of what was found rises where inputs move linearly;
    minus infinity where it cannot be fitted so.
    """
    from ident.tracing.candidate_model.fitted_model import FitData, Start, fit_set

    found = diagnosis.trained_after
    if found is None:
        return -math.inf
    costs = []
    for records in (held, linear):
        masks = [record.output_array(found.outputs)[1] for record in records]
        data = FitData(records, masks, model, found.outputs)
        fitted = fit_set(data, found.effects, found.settings, Start(added=found.shared))
        costs.append(math.inf if fitted is None else fitted.fit.cost)
    return 2.0 * (costs[0] - costs[1]) if math.isfinite(costs[1]) else -math.inf


def left_open(again: Diagnosis, first: Diagnosis) -> tuple[str, ...]:
    """What the second reading would change by more than a sigma, where it explains the records as
    well; nothing where it does not.
    """
    named = [found.name for found in first.effects]
    if (
        again.verdict is not first.verdict
        or [found.name for found in again.effects] != named
        or abs(_lowered(again, first)) > BETTER
    ):
        return ()
    own = [
        (f"{one.name}.{name}", one.parameters[name], q)
        for one, other in zip(first.effects, again.effects, strict=True)
        for name, q in other.parameters.items()
    ]
    pairs = [
        *own,
        *((name, first.after[name], q) for name, q in again.after.items() if name in first.after),
    ]
    moved = [
        f"{name} {q.value:.4g} for {was.value:.4g}"
        for name, was, q in pairs
        if abs(q.value - was.value) > max(q.std, was.std)
    ]
    if not moved:
        return ()
    return (
        "inputs were read as held; moving linearly between samples they explain the records as "
        f"well, with {', '.join(moved)}: {CHOOSE}",
    )


def _lowered(again: Diagnosis, first: Diagnosis) -> float:
    """By how much the second reading lowers the criterion: noise levels, and ln N for each number
    of the effects.
    """
    counts = {
        name: sum(
            int(np.count_nonzero(one.record[name].valid))
            for one in first.fitted
            if name in one.channels
        )
        for name in first.residual_std
    }
    lower = sum(
        2.0 * count * np.log(first.residual_std[name] / again.residual_std[name])
        for name, count in counts.items()
        if name in again.residual_std
    )
    fewer = sum(len(found.parameters) for found in first.effects) - sum(
        len(found.parameters) for found in again.effects
    )
    return float(lower + fewer * np.log(max(sum(counts.values()), 2)))


def read_again(notes: Sequence[str]) -> tuple[str, ...]:
    """The sentences on a second reading, which no one chose by hand."""
    return tuple(note.replace(BY_HAND, READ_AGAIN) for note in notes)
