"""Cross-validated effects: what can be claimed although what remains is not noise, the usual good outcome on measured data.

Against white noise everything is significant where filters, a noisy input and a dozen small causes colour the residual. What a
cause does there, and chance does not: it lowers the error on records that were not fitted, on each of them, and comes out alike
from each record by itself.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel, belongs_to_record, is_event, local_names
from ident.tracing.replication.by_record import Flight
from ident.tracing.replication.comparison import CrossValidatedEffect, CrossValidation, outdone
from ident.tracing.replication.first_again import first_again
from ident.tracing.replication.known_motion import motion_that_stands
from ident.tracing.replication.lone_event import event_that_stands
from ident.tracing.replication.one_round import Tried, weigh_all
from ident.tracing.replication.pair_instead import pair_instead
from sim.declaration.effect import NoiseEffect, Regularity
from sim.declaration.proposal import Traceable


def cross_validate(
    flight: Flight, candidates: Sequence[Traceable], base: FittedModel, fitted_records: int = 0, known: Collection[FittedModel] = ()
) -> tuple[list[CrossValidatedEffect], list[CrossValidation]]:
    """Effects that replicate and lower the error on records that were not fitted, one after the other, and all that was tried.

    Parameters
    ----------
    flight : at least two records. candidates : library and guards; process noise is left out.
    base : the declared model, with what any record may have, fitted to the training records; for its effects and starting values.
    fitted_records : so many of the flight's records, the first ones, are those that are fitted in the end: an event of another is no claim.
    known : ``base`` with one effect more, as a search fitted it: what an effect brings in full, where its projection sees little of it.

    Each is first fitted to all records; those that might matter are fitted to all but one, and alone to each. Two that hide each other, or
    that a third replaces, are looked for as a pair; nothing stands where one effect on which the records differ predicts better than all of them
    (``comparison.outdone``). An event, which need not replicate, is looked for beside them. What ``base`` has is claimed
    with the rest where it stands by itself.
    """
    found: list[CrossValidatedEffect] = []
    usable = [c for c in candidates if not (isinstance(c, NoiseEffect) or is_event(c) or c.traits.background or _is_of_single_samples(c))]
    motion, compared = motion_that_stands(flight, usable, base)
    instead = motion is not None and motion.best.effect.name not in base.names
    first = motion.best.fitted if motion is not None and instead else _at_base(flight, base)
    steps: list[Tried] = []
    while first is not None and len(found) < thresholds.DEEPEST:
        step = weigh_all(flight, usable, found[-1].best.fitted if found else first, None if found or instead else (base, known))
        if step is None:
            break
        steps.append(step)
        compared += step.results
        if step.chosen is None:
            break
        found.append(step.chosen)
    if steps:
        pair, results = pair_instead(flight, usable, steps[0], found)
        compared += results
        found = pair or found
        found, results = first_again(flight, usable, steps[0], found)
        compared += results
        found = [] if found and outdone(_others(steps[0].results, found), found[-1].best) else found
    everything = found[-1].best.fitted if found else first
    event, results = event_that_stands(flight, candidates, everything, fitted_records) if everything is not None else (None, [])
    return [item for item in (motion, *found, event) if item is not None], [*compared, *results]


def weighed_again(
    flight: Flight, candidates: Sequence[Traceable], base: FittedModel, validated: Sequence[CrossValidatedEffect], fitted_records: int
) -> tuple[list[CrossValidatedEffect], list[CrossValidation]]:
    """Cross-validated effects weighed again on other samples of the same records, each with its alternatives beside what was in the model before it;
    an event, which a few samples may make, among all events. And all that was tried. Arguments: ``cross_validate``.
    """
    found: list[CrossValidatedEffect] = []
    compared: list[CrossValidation] = []
    everything = range(len(flight.records))
    fitted = _at_base(flight, base)
    for item in validated:
        members = [member.effect for member in (item.best, *item.others)]
        if any(effect.name in base.names for effect in members):
            motion, results = motion_that_stands(flight, members, base)
            found += [motion] if motion is not None else []
            compared += results
            continue
        if is_event(item.best.effect):
            event, results = event_that_stands(flight, candidates, fitted, fitted_records) if fitted is not None else (None, [])
            found += [event] if event is not None else []
            compared += results
            continue
        before = flight.fit(item.best.fitted.effects[:-1], everything, item.best.fitted.values)
        again = weigh_all(flight, members, before) if before is not None else None
        compared += again.results if again is not None else []
        if again is None or again.chosen is None:
            # What comes after it was weighed beside it.
            return found, compared
        found.append(again.chosen)
        fitted = again.chosen.best.fitted
    return found, compared


def _others(results: Sequence[CrossValidation], found: Sequence[CrossValidatedEffect]) -> list[CrossValidation]:
    """Of all that was tried what is neither in a set nor among its alternatives, under any form."""
    names = {member.effect.name for item in found for member in (item.best, *item.others)}
    return [item for item in results if item.effect.name not in names]


def _is_of_single_samples(candidate: Traceable) -> bool:
    """Whether an effect belongs to a record and acts on chosen samples of it, as spikes and a held channel do: nothing slow that could persist."""
    return belongs_to_record(candidate) and (bool(candidate.traits.wrong_samples_of) or candidate.regularity is not Regularity.REGULAR)


def _at_base(flight: Flight, base: FittedModel) -> FittedModel | None:
    """The set of ``base`` fitted to all records of the flight, from where it was fitted to some of them."""
    everything = range(len(flight.records))
    if [problem.record for problem in base.fit.layout.problems] == list(flight.records):
        return flight.fit(base.effects, everything, base.values)
    # What records share is known, and of what belongs to each the middle of those that were fitted.
    own = [name for effect in base.effects for name in local_names(effect)]
    middle = {name: float(np.mean([values[name] for values in base.values.own])) for name in own if name in base.values.own[0]}
    return flight.fit(base.effects, everything, None, {**base.values.shared, **middle})
