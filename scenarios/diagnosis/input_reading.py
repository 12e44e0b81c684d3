"""Inputs that run ahead of the aircraft by part of a sample were read as held although they move
between samples: they are read again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

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


@dataclass(frozen=True)
class Refit:
    """What was found, fitted again with inputs that move linearly between samples.

    ``rise`` : by how much twice the log likelihood rises; minus infinity where nothing fits.
    ``values`` : parameters of the effects and of the declared model, by full name.
    """

    rise: float
    values: Mapping[str, float]


def refitted(
    diagnosis: Diagnosis, model: Model, held: Sequence[Record], linear: Sequence[Record]
) -> Refit:
    """Fit what was found to both readings of the inputs."""
    from ident.tracing.candidate_model.fitted_model import FitData, Start, fit_set

    found = diagnosis.trained_after
    if found is None:
        return Refit(-math.inf, {})
    fits = []
    for records in (held, linear):
        masks = [record.output_array(found.outputs)[1] for record in records]
        data = FitData(records, masks, model, found.outputs)
        fits.append(fit_set(data, found.effects, found.settings, Start(added=found.shared)))
    first, second = fits
    if first is None or second is None or not math.isfinite(second.fit.cost):
        return Refit(-math.inf, {})
    return Refit(2.0 * (first.fit.cost - second.fit.cost), second.values.shared)


def left_open(again: Refit, first: Diagnosis) -> tuple[str, ...]:
    """What the second reading would change by more than a sigma, where it explains the records as
    well; nothing where it does not.
    """
    if abs(again.rise) > BETTER:
        return ()
    own = {
        f"{found.name}.{name}": q for found in first.effects for name, q in found.parameters.items()
    }
    moved = [
        f"{name} {again.values[name]:.4g} for {was.value:.4g}"
        for name, was in {**own, **first.after}.items()
        if name in again.values and abs(again.values[name] - was.value) > was.std
    ]
    if not moved:
        return ()
    return (
        "inputs were read as held; moving linearly between samples they explain the records as "
        f"well, with {', '.join(moved)}: {CHOOSE}",
    )


def read_again(notes: Sequence[str]) -> tuple[str, ...]:
    """The sentences on a second reading, which no one chose by hand."""
    return tuple(note.replace(BY_HAND, READ_AGAIN) for note in notes)
