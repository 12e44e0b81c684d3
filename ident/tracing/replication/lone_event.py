"""Can an event be claimed where what remains is not noise? It happens once, so that it cannot replicate.

Its numbers on a record that was left out are learnt from that record and paid for, and so is the search for its place. What tells an event
from a model that is wrong throughout is that it stands alone: the same search on the other records finds nothing like it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel, Values, free_names, local_names
from ident.tracing.candidate_model.quantities import sigmas_from_absence
from ident.tracing.replication.by_record import Flight, Replication, by_record, recordings
from ident.tracing.replication.coloured_null import coloured_gain, explained_share
from ident.tracing.replication.comparison import CrossValidatedEffect, CrossValidation
from ident.tracing.replication.error_reduction import reduction
from ident.tracing.replication.weighing import left_out, trained_without, within_reach
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import Finding, screen
from ident.tracing.selection.expansion import near_absence
from ident.tracing.validation.held_out import with_event
from ident.tracing.weighed import ComparedSet
from ident.whole_record.gauss_newton import Fit
from sim.declaration.proposal import Traceable


def event_that_stands(
    flight: Flight, candidates: Sequence[Traceable], fitted: FittedModel, most: int
) -> tuple[CrossValidatedEffect | None, list[CrossValidation]]:
    """An event of one of the first ``most`` records that stands beside what is in a set fitted to all records, and all that was tried."""
    before = left_out(flight, fitted)
    # One that passes: what changes for good takes in whatever is wrong with the model in the rest of a record.
    events = [item for item in candidates if item.traits.lasts and not item.traits.guard and item.name not in fitted.names]
    found = screen(fitted, events, search_context(fitted)) if before is not None else []
    best = found[0].gain if found else 0.0
    usable = [item for item in found if item.gain > max(flight.settings.accept, thresholds.RIVAL * best)][: thresholds.EVENTS_FITTED]
    if before is None or not usable or recordings(flight.records) < thresholds.FEWEST_RECORDS:
        return None, []
    trained = [trained_without(flight, fitted, r) for r in range(len(flight.records))]
    shown = [(finding, gains) for finding in usable if (gains := _gains(flight, finding, before, trained))]
    shown.sort(key=lambda item: -max(gain for gain, _ in item[1].values()))
    results: list[CrossValidation] = []
    for finding, gains in shown:
        item = _weighed(flight, fitted, finding, before, gains, most)
        results += [item] if item is not None else []
        if results and not results[0].stands:
            # One that brings most and does not stand alone says that none does.
            return None, results
    if not results:
        return None, []
    ordered = sorted(results, key=lambda item: -item.gain)
    first, standing = ordered[0], [item for item in ordered if item.stands]
    alike = [item for item in standing[1:] if 2.0 * (first.gain - item.gain) < thresholds.ALTERNATIVE]
    sets = tuple(ComparedSet((item.effect.name,), 2.0 * (first.gain - item.gain)) for item in standing)
    return CrossValidatedEffect(first, tuple(alike), sets), results


def _gains(flight: Flight, finding: Finding, before: Mapping[int, Fit], trained: Sequence[FittedModel | None]) -> dict[int, tuple[float, Fit]]:
    """What an event brings on each record left out, its price paid, with the fit there; those on which none comes out are left out."""
    gains: dict[int, tuple[float, Fit]] = {}
    for r, model in enumerate(trained):
        fit = with_event(model, flight.records[r], flight.masks[r], finding.effect) if model is not None else None
        if fit is not None:
            price = 0.5 * (len(free_names(finding.effect)) * np.log(float(fit.counts.sum())) + flight.settings.event)
            gains[r] = float(coloured_gain([before[r]], [fit]) - price), fit
    return gains


def _weighed(
    flight: Flight, fitted: FittedModel, finding: Finding, before: Mapping[int, Fit], gains: Mapping[int, tuple[float, Fit]], most: int
) -> CrossValidation | None:
    """An event by what it brings on each record left out: it stands where one shows it and no other anything like it."""
    where = max(gains, key=lambda r: gains[r][0])
    gain, after = gains[where]
    rest = max((value for r, (value, _) in gains.items() if r != where), default=0.0)
    child = flight.beside(fitted, finding.effect, _begun(fitted, finding, where, after))
    if child is None:
        return None
    stands, why = _alone(gain, rest, where, most, thresholds.LONE_EVENT)
    if stands and explained_share([before[where]], [after]) < thresholds.EVENT_EXPLAINS:
        stands, why = False, "it explains little of what its record leaves"
    if stands and any(where not in within_reach(fitted, effect) for effect in fitted.effects):
        stands, why = False, "its record flies beyond where a curve is known: the curve goes on some way or other"
    if stands and sigmas_from_absence(finding.effect, by_record(child, finding.effect)[where]) < thresholds.CLEARLY_OFF_ABSENCE:
        stands, why = False, "its parameters are not determined"
    return CrossValidation(
        finding.effect, finding, child, reduction([before[where]], [after]), Replication((), stands), gain, stands, why, {where: after}
    )


def _begun(fitted: FittedModel, finding: Finding, where: int, found: Fit) -> Values:
    """Values of a fitted model, with the event as it was ``found`` in record ``where`` and hardly there in the others."""
    names, values = local_names(finding.effect), fitted.values
    here = {name: float(found.theta[found.layout.names.index(name)]) for name in names}
    elsewhere = {**here, **{name: value for name, value in near_absence(finding.effect, here).items() if name in names}}
    own = tuple({**mine, **(here if r == where else elsewhere)} for r, mine in enumerate(values.own))
    return Values(values.shared, own, values.states)


def _alone(gain: float, rest: float, where: int, most: int, least: float) -> tuple[bool, str]:
    """Whether an event that brings ``gain`` on record ``where``, and at most ``rest`` on any other, stands; and why not."""
    if where >= most:
        return False, "it happens in a record that is not fitted"
    if gain < least:
        return False, "a colour of the residual does as well"
    if gain < thresholds.STANDS_ALONE * rest:
        return False, "other records show as much: it is no event"
    return True, "one-step predictions find it in one record, and nothing like it in the others"
