"""Cross-validated effects: what can be claimed although what remains is not noise, the usual good outcome on measured data.

Against white noise everything is significant where filters, a noisy input and a dozen small causes colour the residual. What a
cause does there, and chance does not: it lowers the error on records that were not fitted, on each of them, and comes out alike
from each record by itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.statistics.coloured_covariance import effective_share
from ident.statistics.normal_equations import add_normal_equations
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel, belongs_to_record, is_event, local_names
from ident.tracing.candidate_model.quantities import implausible
from ident.tracing.equivalents import guard_is_likelier
from ident.tracing.replication.by_record import Flight, Replication, distance_from_absence, own_quantities, replicate
from ident.tracing.replication.coloured_null import coloured_gain
from ident.tracing.replication.comparison import CrossValidatedEffect, CrossValidation, choose
from ident.tracing.replication.error_reduction import Reduction, reduction
from ident.tracing.screening.context import search_context
from ident.tracing.screening.pairs import likely_pairs
from ident.tracing.screening.score_test import Finding, screen
from ident.tracing.selection.expansion import near_absence, only_beside_another
from ident.tracing.validation.held_out import held_out
from ident.whole_record.gauss_newton import Fit
from sim.declaration.effect import NoiseEffect
from sim.declaration.proposal import Curve, Traceable


def cross_validate(flight: Flight, candidates: Sequence[Traceable], base: FittedModel) -> tuple[list[CrossValidatedEffect], list[CrossValidation]]:
    """Effects that replicate and lower the error on records that were not fitted, one after the other, and all that was tried.

    Parameters
    ----------
    flight : at least two records. candidates : library and guards; events and process noise are left out, since they need not replicate.
    base : the declared model, with what any record may have, fitted to the training records; for its effects and starting values.

    Each is first fitted to all records; those that might matter are fitted to all but one, and alone to each. Two that hide each other, or
    that a third replaces, are looked for as a pair.
    """
    found: list[CrossValidatedEffect] = []
    compared: list[CrossValidation] = []
    usable = [c for c in candidates if not (isinstance(c, NoiseEffect) or belongs_to_record(c) or is_event(c) or c.traits.background)]
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
    return found, compared


@dataclass(frozen=True, eq=False)
class _Step:
    """All that was tried at a fitted model, and what was chosen; ``before`` the fitted model's own predictions by record."""

    fitted: FittedModel
    before: Mapping[int, Fit]
    findings: Sequence[Finding]
    results: Sequence[CrossValidation]
    chosen: CrossValidatedEffect | None


def _begun(base: FittedModel) -> dict[str, float]:
    """Starting values for all records: what they share, and of what belongs to each the middle of those that were fitted."""
    own = [name for effect in base.effects for name in local_names(effect)]
    middle = {name: float(np.mean([values[name] for values in base.values.own])) for name in own if name in base.values.own[0]}
    return {**base.values.shared, **middle}


def _weigh_all(flight: Flight, candidates: Sequence[Traceable], fitted: FittedModel) -> _Step | None:
    before = _left_out(flight, fitted)
    if before is None:
        return None
    findings = _promising(fitted, [candidate for candidate in candidates if not only_beside_another(candidate)])
    guards = [finding for finding in findings if finding.effect.traits.guard]
    tried = [finding for finding in findings if finding not in guards][: thresholds.CANDIDATES_FITTED] + guards[: thresholds.GUARDS_FITTED]
    results = [item for item in (_weigh(flight, fitted, finding, before) for finding in tried) if item is not None]
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
    reached = -_fitted_change(first.fitted, found[-1].best.fitted) if found else 0.0
    fall = -_fitted_change(first.fitted, best) if best is not None else 0.0
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
    twins = {twin for effect in fitted.effects for twin in effect.traits.twins}
    samples = share * float(fitted.fit.counts.sum())
    findings = [finding for finding in screen(fitted, candidates, search_context(fitted)) if finding.effect.name not in twins]
    most = findings[0].gain if findings else 0.0
    return [
        finding
        for finding in findings
        if finding.gain > thresholds.HOPELESS_IN_REPLICATION * most and 2.0 * share * finding.gain > finding.parameters * np.log(max(samples, np.e))
    ]


def _left_out(flight: Flight, fitted: FittedModel, which: Sequence[int] | None = None) -> dict[int, Fit] | None:
    """Each record, or ``which``, predicted by the set fitted to the others, only its own initial state and biases free; None where one fails."""
    fits = {}
    for r in range(len(flight.records)) if which is None else which:
        record = flight.records[r]
        trained: FittedModel | None = without_record(fitted, r)
        if len(flight.records) <= thresholds.WHOLE_REFIT_UP_TO:
            others = [other for other in range(len(flight.records)) if other != r]
            trained = flight.fit(fitted.effects, others, fitted.values)
        frozen = held_out(trained, [record], [flight.masks[r]], informed=False).frozen if trained is not None else None
        if frozen is None:
            return None
        fits[r] = frozen
    return fits


def within_reach(fitted: FittedModel, effect: Traceable) -> list[int]:
    """Records that fly where the others do, too: beyond their range a curve fitted to the others is not known."""
    count = len(fitted.fit.layout.problems)
    if not isinstance(effect, Curve):
        return list(range(count))
    inside = []
    for r in range(count):
        others = effect.fitted_to(search_context(fitted, which=[other for other in range(count) if other != r]))
        beyond = max(others.low - effect.low, effect.high - others.high)
        if beyond <= thresholds.BEYOND_RANGE * (effect.high - effect.low):
            inside.append(r)
    return inside


def without_record(fitted: FittedModel, r: int) -> FittedModel:
    """The set as fitted to all records but one: a Gauss-Newton step from the fit of all of them, which is near where there are many."""
    fit, layout = fitted.fit, fitted.fit.layout
    normal, gradient = (part.copy() for part in fit.normal_equations())
    problem = layout.problems[r]
    weight = np.where(problem.valid, -1.0 / fit.variance[:, None], 0.0)
    add_normal_equations(normal, gradient, layout.columns(r), fit.jacobians[r], fit.residuals[r], weight)
    scale = np.sqrt(np.maximum(np.diag(normal), 0.0))
    moving = np.flatnonzero(scale > 1e-9 * np.sqrt(np.maximum(np.diag(fit.normal_equations()[0]), 1e-300)))
    inside = normal[np.ix_(moving, moving)] / np.outer(scale[moving], scale[moving])
    step = np.zeros(len(fit.theta))
    step[moving] = np.linalg.lstsq(inside, gradient[moving] / scale[moving], rcond=1e-10)[0] / scale[moving]
    return replace(fitted, fit=replace(fit, theta=np.clip(fit.theta + step, fit.problem.low, fit.problem.high)))


def _weigh(flight: Flight, fitted: FittedModel, finding: Finding, before: Mapping[int, Fit]) -> CrossValidation | None:
    effects = (*fitted.effects, finding.effect)
    everything = range(len(flight.records))
    tries = [flight.fit(effects, everything, fitted.values, start) for start in finding.starts[:2]]
    child = min((t for t in tries if t is not None), key=lambda t: t.fit.cost, default=None)
    if child is None or child.fit.cost > fitted.fit.cost:
        child = flight.fit(effects, everything, fitted.values, near_absence(finding.effect, finding.starts[0]))
    if child is None:
        return None
    if _fitted_change(fitted, child) > -thresholds.HALF_OF_IT * thresholds.WORTH:
        return None
    asked = within_reach(fitted, finding.effect)
    after = _left_out(flight, child, asked) if asked else None
    if after is None:
        return None
    pairs = [before[r] for r in asked], [after[r] for r in asked]
    lowered, gain = reduction(*pairs), coloured_gain(*pairs)
    if lowered.total > -thresholds.WORTH:
        why = "it does not lower the error on records left out enough"
        return CrossValidation(finding.effect, finding, child, lowered, Replication((), False), gain, False, why, after)
    copies = replicate(flight, child, finding.effect)
    stands, why = _judged(lowered, copies)
    if stands and distance_from_absence(child, finding.effect) < thresholds.CLEARLY_OFF_ABSENCE:
        stands, why = False, "its parameters are not determined"
    if stands and gain < flight.settings.accept:
        stands, why = False, "a colour of the residual does as well"
    if stands and implausible(finding.effect, own_quantities(child, finding.effect)):
        stands, why = False, "its parameters are beyond belief"
    return CrossValidation(finding.effect, finding, child, lowered, copies, gain, stands, why, after)


def _fitted_change(fitted: FittedModel, child: FittedModel) -> float:
    """Mean over the channels of ln(rms after / rms before) on the fitted records: what is not there will not be on others."""
    used = fitted.fit.layout.used & child.fit.layout.used
    return float(np.mean(0.5 * np.log(child.fit.variance[used] / fitted.fit.variance[used]))) if np.any(used) else 0.0


def _judged(lowered: Reduction, copies: Replication) -> tuple[bool, str]:
    """Whether it passes, and why not."""
    if lowered.total > -thresholds.BEYOND_ITS_SCATTER * lowered.scatter:
        return False, "the fall of the error on records left out is within its scatter"
    if np.any(lowered.by_channel > max(thresholds.CHANNEL_WORSE, -0.5 * lowered.total) + thresholds.BEYOND_ITS_SCATTER * lowered.channel_scatter):
        return False, "one channel gets worse"
    # A short record, or one that hardly moves what the effect needs, says little by its sign: it speaks against beyond its own scatter only.
    if any(total > thresholds.BEYOND_ITS_SCATTER * scatter for total, scatter in zip(lowered.by_record, lowered.record_scatter, strict=True)):
        return False, "it makes a record worse"
    if 2 * sum(total < 0.0 for total in lowered.by_record) <= len(lowered.by_record):
        return False, "it helps on too few records"
    if not copies.agrees:
        return False, "the records give different values"
    return True, "cross-validated"


def _effective(fitted: FittedModel) -> float:
    return effective_share(fitted.fit.residuals, [problem.valid for problem in fitted.fit.layout.problems])
