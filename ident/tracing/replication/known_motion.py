"""Can what any record may have (a phugoid) be claimed for itself where what remains is not noise?

It is in the model of every candidate anyway. Said by name it has to pass what any other has to, and what is slow as well and belongs
to each record (an even change of speed, a drift of a sensor) is tried in its place.
"""

from __future__ import annotations

from collections.abc import Sequence

from ident.tracing.candidate_model.fitted_model import FittedModel, belongs_to_record
from ident.tracing.replication.by_record import Flight
from ident.tracing.replication.comparison import CrossValidatedEffect, CrossValidation, choose
from ident.tracing.replication.weighing import left_out, weigh
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import screen
from sim.declaration.proposal import Traceable


def motion_that_stands(
    flight: Flight, candidates: Sequence[Traceable], base: FittedModel
) -> tuple[CrossValidatedEffect | None, list[CrossValidation]]:
    """What any record may have, cross-validated at the declared model alone, and all that was tried; None where ``base`` has it not or it fails.

    Where it fails and what its equations allow in its place (an even change of speed) stands, that is claimed instead.

    ``candidates`` : those that could stand in its place are taken from them.
    """
    known = base.effects
    if not known:
        return None, []
    plain = flight.fit((), range(len(flight.records)), None, {n: v for n, v in base.values.shared.items() if n in flight.model.parameters})
    before = left_out(flight, plain) if plain is not None else None
    if plain is None or before is None:
        return None, []
    # A drift of the derivatives is what a speed that changes does: no guard against it.
    rivals = [c for c in candidates if belongs_to_record(c) and c.name not in base.names and not c.traits.guard]
    findings = screen(plain, [*known, *rivals], search_context(plain))
    results = [item for item in (weigh(flight, plain, finding, before) for finding in findings) if item is not None]
    best = choose(results, flight.witness)
    if best is None:
        return None, results
    members = (best.best, *best.others)
    # Where others do as well it comes first: any record has it.
    first = next((item for item in members if item.stands and item.effect.name in base.names), None)
    believed = any(item.stands for item in results if item.effect.name in base.names)
    if first is None and not believed and best.best.effect.name in {alias for effect in known for alias in effect.aliases}:
        first = best.best
    return (None if first is None else CrossValidatedEffect(first, tuple(item for item in members if item is not first), best.sets)), results
