"""Cross-validated effects: what can be claimed although what remains is not noise, the usual good outcome on measured data.

Against white noise everything is significant where filters, a noisy input and a dozen small causes colour the residual. What a
cause does there, and chance does not: it lowers the error on records that were not fitted, on each of them, and comes out alike
from each record by itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.statistics.coloured_covariance import effective_share
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel, belongs_to_record, is_event, local_names
from ident.tracing.equivalents import guard_is_likelier
from ident.tracing.replication.by_record import Flight, own_quantities
from ident.tracing.replication.comparison import CrossValidatedEffect, CrossValidation, choose
from ident.tracing.replication.error_reduction import reduction
from ident.tracing.replication.known_motion import motion_that_stands
from ident.tracing.replication.lone_event import event_that_stands
from ident.tracing.replication.weighing import fitted_change, left_out, weigh
from ident.tracing.screening.context import search_context
from ident.tracing.screening.pairs import likely_pairs
from ident.tracing.screening.score_test import Finding, screen
from ident.tracing.selection.expansion import only_beside_another
from ident.whole_record.gauss_newton import Fit
from sim.declaration.effect import NoiseEffect, Regularity
from sim.declaration.proposal import Traceable


def cross_validate(
    flight: Flight, candidates: Sequence[Traceable], base: FittedModel, fitted_records: int = 0
) -> tuple[list[CrossValidatedEffect], list[CrossValidation]]:
    """Effects that replicate and lower the error on records that were not fitted, one after the other, and all that was tried.

    Parameters
    ----------
    flight : at least two records. candidates : library and guards; process noise is left out.
    base : the declared model, with what any record may have, fitted to the training records; for its effects and starting values.
    fitted_records : so many of the flight's records, the first ones, are those that are fitted in the end: an event of another is no claim.

    Each is first fitted to all records; those that might matter are fitted to all but one, and alone to each. Two that hide each other, or
    that a third replaces, are looked for as a pair. An event, which need not replicate, is looked for beside them. What ``base`` has is claimed
    with the rest where it stands by itself.
    """
    found: list[CrossValidatedEffect] = []
    usable = [c for c in candidates if not (isinstance(c, NoiseEffect) or is_event(c) or c.traits.background or _is_of_single_samples(c))]
    known, compared = motion_that_stands(flight, usable, base)
    first = flight.fit(base.effects, range(len(flight.records)), None, _begun(base))
    steps: list[_Step] = []
    while first is not None and len(found) < thresholds.DEEPEST:
        step = _weigh_all(flight, usable, found[-1].best.fitted if found else first)
        if step is None:
            break
        steps.append(step)
        compared += step.results
        if step.chosen is None:
            break
        found.append(step.chosen)
    if steps:
        pair, results = _pair_instead(flight, usable, steps[0], found)
        compared += results
        found = pair or found
    everything = found[-1].best.fitted if found else first
    event, results = event_that_stands(flight, candidates, everything, fitted_records) if everything is not None else (None, [])
    return [item for item in (known, *found, event) if item is not None], [*compared, *results]


def with_events_again(
    flight: Flight, candidates: Sequence[Traceable], base: FittedModel, validated: Sequence[CrossValidatedEffect], fitted_records: int
) -> tuple[list[CrossValidatedEffect], list[CrossValidation]]:
    """Cross-validated effects with their event, which a few samples may make, looked for anew; and what was tried. Arguments: ``cross_validate``."""
    steady = [item for item in validated if not is_event(item.best.effect)]
    if len(steady) == len(validated):
        return steady, []
    added = [item.best.effect for item in steady if item.best.effect.name not in base.names]
    starts = {name: value for item in steady for name, value in item.best.fitted.values.shared.items()}
    everything = flight.fit((*base.effects, *added), range(len(flight.records)), None, {**_begun(base), **starts})
    event, results = event_that_stands(flight, candidates, everything, fitted_records) if everything is not None else (None, [])
    return [*steady, *([event] if event is not None else [])], results


@dataclass(frozen=True, eq=False)
class _Step:
    """All that was tried at a fitted model, and what was chosen; ``before`` the fitted model's own predictions by record."""

    fitted: FittedModel
    before: Mapping[int, Fit]
    findings: Sequence[Finding]
    results: Sequence[CrossValidation]
    chosen: CrossValidatedEffect | None


def _is_of_single_samples(candidate: Traceable) -> bool:
    """Whether an effect belongs to a record and acts on chosen samples of it, as spikes and a held channel do: nothing slow that could persist."""
    return belongs_to_record(candidate) and (bool(candidate.traits.wrong_samples_of) or candidate.regularity is not Regularity.REGULAR)


def _begun(base: FittedModel) -> dict[str, float]:
    """Starting values for all records: what they share, and of what belongs to each the middle of those that were fitted."""
    own = [name for effect in base.effects for name in local_names(effect)]
    middle = {name: float(np.mean([values[name] for values in base.values.own])) for name in own if name in base.values.own[0]}
    return {**base.values.shared, **middle}


def _weigh_all(flight: Flight, candidates: Sequence[Traceable], fitted: FittedModel) -> _Step | None:
    before = left_out(flight, fitted)
    if before is None:
        return None
    findings = _promising(fitted, [candidate for candidate in candidates if not only_beside_another(candidate)])
    guards = [finding for finding in findings if finding.effect.traits.guard]
    tried = [finding for finding in findings if finding not in guards][: thresholds.CANDIDATES_FITTED] + guards[: thresholds.GUARDS_FITTED]
    results = [item for item in (weigh(flight, fitted, finding, before) for finding in tried) if item is not None]
    chosen = choose(results, flight.witness)

    def fit(effect: Traceable, start: Mapping[str, float]) -> FittedModel | None:
        return flight.fit((*fitted.effects, effect), range(len(flight.records)), fitted.values, start)

    if chosen is not None and guard_is_likelier(fitted, chosen.best.effect, chosen.best.fitted, candidates, fit):
        chosen = None
    return _Step(fitted, before, findings, results, chosen)


def _pair_instead(
    flight: Flight, candidates: Sequence[Traceable], first: _Step, found: Sequence[CrossValidatedEffect]
) -> tuple[list[CrossValidatedEffect] | None, list[CrossValidation]]:
    """Two effects, each cross-validated with the other in the model, that together do clearly better than what was found one after the other."""
    names = [item.best.effect.name for item in found]
    pairs = likely_pairs(first.findings, names, float(first.fitted.fit.counts.sum()))
    children = [child for each in pairs if (child := _fit_pair(flight, first.fitted, each)) is not None]
    best = min(children, key=lambda child: child.fit.cost, default=None)
    reached = -fitted_change(first.fitted, found[-1].best.fitted) if found else 0.0
    fall = -fitted_change(first.fitted, best) if best is not None else 0.0
    if best is None or fall <= reached:
        return None, []
    # What a witness speaks for need not be better by as much.
    pair = best.effects[len(first.fitted.effects) :]
    vouched = all(flight.witness(effect.name, own_quantities(best, effect)) > 0 for effect in pair)
    if not vouched and fall < reached + (thresholds.NO_PREFERENCE if len(found) > 1 else thresholds.HALF_OF_IT * thresholds.WORTH):
        return None, []
    validated: list[CrossValidatedEffect] = []
    compared: list[CrossValidation] = []
    one = pair[0]
    for _ in range(2):
        # The second may be another than the pair's, where that does better; the first has to come out again with it in the model.
        alone = flight.fit((*first.fitted.effects, one), range(len(flight.records)), best.values)
        step = _weigh_all(flight, candidates, alone) if alone is not None else None
        compared += step.results if step is not None else []
        if step is None or step.chosen is None:
            return None, compared
        validated.append(step.chosen)
        one = step.chosen.best.effect
    if pair[0].name not in {item.effect.name for item in (validated[1].best, *validated[1].others)}:
        return None, compared
    last = found[-1].best.predictions if found else first.before
    common = sorted(last.keys() & validated[-1].best.predictions.keys())
    lowered = reduction([last[r] for r in common], [validated[-1].best.predictions[r] for r in common])
    least = 0.0 if vouched else thresholds.NO_PREFERENCE if len(found) > 1 else thresholds.WORTH
    return (validated[::-1] if lowered.total < -max(least, thresholds.BEYOND_ITS_SCATTER * lowered.scatter) else None), compared


def _fit_pair(flight: Flight, fitted: FittedModel, pair: tuple[Finding, Finding]) -> FittedModel | None:
    effects = (*fitted.effects, *(finding.effect for finding in pair))
    return flight.fit(effects, range(len(flight.records)), fitted.values, {**pair[0].starts[0], **pair[1].starts[0]})


def _promising(fitted: FittedModel, candidates: Sequence[Traceable]) -> list[Finding]:
    """The candidates whose projected gain, in effective samples, pays for their parameters; the largest first."""
    share = _effective(fitted)
    twins = {twin for effect in fitted.effects for twin in (*effect.traits.twins, *effect.traits.never_beside)}
    samples = share * float(fitted.fit.counts.sum())
    findings = [finding for finding in screen(fitted, candidates, search_context(fitted)) if finding.effect.name not in twins]
    most = findings[0].gain if findings else 0.0
    return [
        finding
        for finding in findings
        if finding.gain > thresholds.HOPELESS_IN_REPLICATION * most and 2.0 * share * finding.gain > finding.parameters * np.log(max(samples, np.e))
    ]


def _effective(fitted: FittedModel) -> float:
    return effective_share(fitted.fit.residuals, [problem.valid for problem in fitted.fit.layout.problems])
