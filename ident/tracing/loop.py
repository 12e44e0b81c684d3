"""Tracing loop: fit the declared model, search for missing effects, decide, report on held-out
data.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.process_noise.filter_error import noise_levels
from ident.process_noise.innovations_model import has_process_noise
from ident.statistics.residuals import WHITENESS_P_VALUE
from ident.tracing.between_records import (
    RecordScatter,
    parameters_by_record,
    scatter_between_records,
    widened_by_scatter,
)
from ident.tracing.decision import (
    Decision,
    decide,
    search_white_noise,
)
from ident.tracing.diagnosis import (
    TIMES,
    Caution,
    Claim,
    Concern,
    Data,
    Diagnosis,
    Requirement,
    Step,
    TraceSettings,
    Verdict,
)
from ident.tracing.fitted_model import FittedModel, quantities, records_of
from ident.tracing.held_out import HeldOut, HeldOutData, fit_held_out, predicted_by
from ident.tracing.names import CLAIM_LEVEL, Named
from ident.tracing.predictive import PredictiveGain, frozen_gain, predictive_gains
from ident.tracing.problem import TraceProblem, no_progress
from ident.tracing.result import (
    After,
    Before,
    ForSimulation,
    Judgement,
    ResidualTests,
    not_noise,
    reported,
    residual_tests,
)
from ident.tracing.search import Search
from ident.tracing.whiteness import FITTED, HELD_OUT, noise_bursts
from ident.tracing.wrong_samples import (
    cleaned_inputs,
    held_out_masks,
    measured_masks,
    mended_inputs,
    spike_claims,
    spike_masks,
)
from ident.whole_record.output_error import failed_fit
from sim.declaration.effect import NoiseEffect
from sim.declaration.model import Model
from sim.declaration.proposal import Traceable
from sim.errors import ModelError, time_span
from sim.record import LARGEST_MEASURED, Record, refuse_beyond_measure

# ---- The declared model fitted to the records

# lower bound of a noise level, as a share of the noise at high frequencies: logged signals are
# filtered
LEAST_NOISE = 0.3


@dataclass(frozen=True, eq=False)
class Declared:
    """The declared model as fitted.

    Attributes
    ----------
    problem : the problem with inputs mended and provisional spikes masked.
    fitted : the fit.
    spikes : claims of wrong samples in recorded inputs.
    steps : log of what was mended.
    """

    problem: TraceProblem
    fitted: FittedModel
    spikes: tuple[Claim, ...]
    steps: tuple[Step, ...] = ()


def fit_declared(problem: TraceProblem) -> Declared:
    """Return the declared model fitted, recorded inputs mended and provisional spikes masked.

    Raises
    ------
    ModelError : no finite cost, or a failed fit (``ident.whole_record.output_error``).
    RecordError : an angle or rate in the fit that no aircraft can have.
    """
    for record in problem.records:
        measured = [name for name in problem.outputs if name in record.output_names]
        angles = [name for name in measured if record[name].unit in ("rad", "rad/s")]
        refuse_beyond_measure(record, angles, LARGEST_MEASURED)
    problem.progress("fitting the declared model", 0.0)
    declared_fit = problem.fit((), None)
    if declared_fit is None:
        raise ModelError(
            "the declared model has no finite cost on these records",
            where=problem.records[0].name,
            remedy="check units and starting values",
        )
    values = {item.name: item.value for item in problem.model.parameters if item.free}
    why, remedy = failed_fit(declared_fit.fit, values)
    if why:  # a second attempt from where the first one ended
        declared_fit = problem.fit((), declared_fit) or declared_fit
        why, remedy = failed_fit(declared_fit.fit, values)
    if why:
        names = ", ".join(dict.fromkeys(record.name for record in problem.records))
        what = f"the fit of the declared model has failed: {why}"
        raise ModelError(what, where=names, remedy=remedy)
    problem, declared_fit, spikes, steps = cleaned_inputs(problem, declared_fit)
    least = {name: LEAST_NOISE * std for name, std in measured_noise(declared_fit).items()}
    problem = replace(problem, least_noise=least)
    masked = problem.with_masks(spike_masks(problem, declared_fit))
    refit = masked.fit((), declared_fit)
    if refit is None:
        return Declared(problem, declared_fit, tuple(spikes), tuple(steps))
    return Declared(masked, refit, tuple(spikes), tuple(steps))


def measured_noise(fitted: FittedModel) -> dict[str, float]:
    """Return the standard deviation of each output's noise, from third differences of its residual.

    Motion hardly affects third differences; the median is robust against single wrong samples.
    """
    found: dict[str, float] = {}
    layout = fitted.fit.layout
    for i, name in enumerate(fitted.system.output_names):
        sizes = [
            float(np.median(np.abs(np.diff(residual[i][problem.valid[i]], 3))))
            for problem, residual in zip(layout.problems, fitted.fit.residuals, strict=True)
            if np.count_nonzero(problem.valid[i]) > 4
        ]
        if sizes:
            found[name] = float(np.mean(sizes)) / (0.6745 * math.sqrt(20.0))
    return found


def held_out_data(declared: Declared, validation: Sequence[Record]) -> HeldOutData:
    """Return the held-out records with mended inputs, their masks and the declared model's fit."""
    if not validation:
        return HeldOutData()
    problem = declared.problem
    records = [mended_inputs(problem, record, declared.spikes) for record in validation]
    first = fit_held_out(declared.fitted, records, None, informed=False)
    masks = held_out_masks(first, records, problem.outputs)
    return HeldOutData(
        records, masks, fit_held_out(declared.fitted, records, masks, informed=False)
    )


# ---- The tracing loop

FROZEN_WORSE = (
    "with its values as fitted, the model predicts the held-out data no better; with values that "
    "the fit leaves open what remains there is noise: fit these data as well before you predict "
    "with the model"
)
NEGLIGIBLE_RATIO = 1.1  # largest error on held-out data, over the noise, of a negligible misfit
MOST_ALTERNATIVES = 2  # most alternatives named: fixed by


def diagnose(
    records: Sequence[Record],
    model: Model,
    candidates: Sequence[Traceable],
    guards: Sequence[Traceable],
    validation: Sequence[Record],
    settings: TraceSettings | None = None,
    progress: Callable[[str, float], None] = no_progress,
    *,
    discrepancy: Traceable | None = None,
    kinematics: Callable[[], Sequence[tuple[str, ...]]] | None = None,
    reread: Callable[[], Data] | None = None,
) -> Diagnosis:
    """Return the diagnosis of records: the effects that a declared model lacks.

    Parameters
    ----------
    records : the data to fit. model : the declared model, with its biases.
    candidates : effects that may be claimed. guards : catch-all terms, which mean ``unexplained``.
    validation : held-out data; without any, errors are those of the fit.
    progress : called with the current task and its share of the work.
    discrepancy : term for errors of the forces, used if no set leaves noise.
    kinematics : returns the effects with kinematic evidence, for each the names that this evidence
        cannot distinguish, the likeliest first; called if the declared model is not the most
        probable.
    reread : returns the data with the other interpolation of inputs, called if a delay or lag is
        found; the likelier one is used. None where the interpolation is known.

    Raises
    ------
    ModelError : a record without any output of the model, or a model that cannot be fitted at all.
    """
    outputs = [
        signal.name
        for signal in model.equations.outputs
        if any(signal.name in record.output_names for record in records)
    ]
    masks, offered = measured_masks(records, outputs), (*candidates, *guards)
    settings = settings or TraceSettings()
    problem = TraceProblem(records, masks, model, offered, outputs, settings, validation, progress)
    problem, declared, search = _searched(problem, discrepancy, reread)
    records, validation = problem.records, problem.predicted
    held = held_out_data(declared, validation)
    problem, declared_fit = declared.problem, declared.fitted
    masks, spikes = spike_claims(problem, search.best().fitted)
    if any(not np.array_equal(a, b) for a, b in zip(masks, problem.masks, strict=True)):
        problem = problem.with_masks(masks)
        declared_fit = problem.fit((), declared_fit) or declared_fit
        search = search.rerun_in(problem, "wrong samples left out")
    groups = kinematics() if kinematics is not None and search.best().names else ()
    if groups:
        search = search.with_kinematics(groups)
    decision, out, gain = _decide_and_predict(search, discrepancy, held)
    problem = search.problem
    judgement = _judgement(problem, decision, out, gain, held, (*declared.spikes, *spikes))
    before, after = _scatter(problem, declared_fit, judgement, held)
    diagnosis = reported(
        problem,
        Before(declared_fit, residual_tests(declared_fit, HeldOut(None, None)).all, before),
        After(judgement, _for_simulation(problem, judgement, held), after, decision.fits),
        held,
        validation,
    )
    return replace(
        diagnosis,
        one_step=gain.one_step,
        steps=(*declared.steps, *decision.steps),
        candidates=decision.candidates,
        sets=decision.sets,
        stopped=decision.stopped,
    )


def _searched(
    problem: TraceProblem, discrepancy: Traceable | None, reread: Callable[[], Data] | None
) -> tuple[TraceProblem, Declared, Search]:
    """Return the problem with the records as read, its declared model as fitted, and the search
    under white noise.

    If a delay or lag was found, the likelier interpolation of the inputs is used (``reread``).
    """
    declared = fit_declared(problem)
    search = search_white_noise(declared.problem, discrepancy)
    times = [item.name for each in search.best().fitted.effects for item in each.parameters]
    if reread is None or not set(times) & set(TIMES):
        return problem, declared, search
    records, predicted = reread()
    masks = measured_masks(records, problem.outputs)
    other = replace(problem, records=records, masks=masks, predicted=predicted)
    refit = fit_declared(other)
    reread_search = search.refitted(refit.problem, "inputs between samples read the other way")
    if reread_search.best().weight <= search.best().weight:
        return problem, declared, search
    # The interpolation hardly changes a scan: sets scanned before are not scanned again.
    reread_search.expanded |= search.expanded
    return other, refit, reread_search.run()


def _scatter(
    problem: TraceProblem, declared_fit: FittedModel, judgement: Judgement, held: HeldOutData
) -> tuple[RecordScatter, RecordScatter]:
    """Return the scatter of the derivatives between records: of the declared model, and of the
    accepted set. Both are empty if the residual is noise.
    """
    if judgement.verdict not in (Verdict.UNEXPLAINED, Verdict.PARTIAL):
        return RecordScatter(), RecordScatter()
    after = scatter_between_records(problem, judgement.best, held)
    same = judgement.best.names == declared_fit.names
    return (after if same else scatter_between_records(problem, declared_fit, held)), after


def _for_simulation(
    problem: TraceProblem, judgement: Judgement, held: HeldOutData
) -> ForSimulation:
    """Return the model with the effects found, fitted again without random loads that are not
    claimed.

    Derivatives estimated together with random loads do not minimise the errors of a simulation, as
    those of the declared model do: errors before and after would not be comparable.
    """
    best = judgement.best
    claimed = {claim.name for claim in judgement.claims if claim.claimed}
    kept = tuple(
        effect
        for effect in best.effects
        if effect.name in claimed or not isinstance(effect, NoiseEffect)
    )
    unchanged = ForSimulation(replace(best.trained, effects=kept), best.fit, judgement.out.frozen)
    if len(kept) == len(best.effects) or judgement.verdict is Verdict.UNEXPLAINED:
        return unchanged
    refitted = problem.fit(kept, best)
    if refitted is None or not held.records:
        return (
            unchanged if refitted is None else ForSimulation(refitted.trained, refitted.fit, None)
        )
    frozen = fit_held_out(refitted, held.records, held.masks, informed=False).frozen
    return unchanged if frozen is None else ForSimulation(refitted.trained, refitted.fit, frozen)


@dataclass(eq=False)
class _HeldOutCheck:
    """Converged fits of sets, and their predictions of held-out data.

    Attributes
    ----------
    problem : the problem of the fits. held : the held-out data.
    stored : converged fit and predictions of each set, by the names of effects and parameters.
    """

    problem: TraceProblem
    held: HeldOutData
    stored: dict[frozenset[str], tuple[FittedModel, HeldOut]] = field(default_factory=dict)

    def converged(self, fitted: FittedModel) -> tuple[FittedModel, HeldOut]:
        """Return the converged fit of a set, and its fits to the held-out data."""
        key = frozenset((*fitted.names, *fitted.system.parameters.names))
        if key not in self.stored:
            best = self.problem.fit(fitted.effects, fitted) or fitted
            self.stored[key] = best, predicted_by(best, self.held)
        return self.stored[key]

    def leaves_noise(self, fitted: FittedModel) -> bool:
        """Return whether the residual of a set is noise, on fitted and held-out data."""
        self.problem.progress("judging on data that were not fitted", 0.9)
        return not not_noise(residual_tests(*self.converged(fitted)).all, WHITENESS_P_VALUE)

    def predicts_well(self, fitted: FittedModel) -> bool:
        """Return whether the residual on held-out data is hardly larger than the noise of
        the fit.
        """
        best, out = self.converged(fitted)
        if out.informed is None:
            return not self.held.records
        levels, found = noise_levels(best.fit), noise_levels(out.informed)
        return all(std <= NEGLIGIBLE_RATIO * levels[name] for name, std in found.items())


def _decide_and_predict(
    search: Search, discrepancy: Traceable | None, held: HeldOutData
) -> tuple[Decision, HeldOut, PredictiveGain]:
    """Return the decision, with the converged fit of its set, the predictions of held-out data, and
    the gains of the claimed effects there.

    Held-out data may contradict all claims. If the set without them leaves noise, nothing is
    missing.
    """
    check = _HeldOutCheck(search.problem, held)
    decision = decide(search, discrepancy, check.leaves_noise, check.predicts_well)
    best, out = check.converged(decision.best)
    decision, gain = replace(decision, best=best), PredictiveGain()
    if decision.named:
        gain = predictive_gains(decision.reference, best, held, out)
    if gain.contradicts and check.leaves_noise(decision.reference):
        why = _reason_of_no_improvement(_no_improvement(gain))
        hints = [replace(each, reason=why, within=best) for each in decision.named]
        smaller, out = check.converged(decision.reference)
        decision = replace(
            decision,
            verdict=Verdict.CONSISTENT,
            best=smaller,
            named=(),
            hints=(*decision.hints, *hints),
        )
        gain = PredictiveGain()
    return decision, out, gain


def _judgement(
    problem: TraceProblem,
    decision: Decision,
    out: HeldOut,
    gain: PredictiveGain,
    held: HeldOutData,
    spikes: Sequence[Claim],
) -> Judgement:
    """Return the judgement of a decision: its verdict with residual tests, claims and cautions."""
    best = decision.best
    tests = residual_tests(best, out)
    failed_tests = not_noise(tests.all, WHITENESS_P_VALUE)
    verdict = decision.verdict
    guards = problem.guards
    claims = [_claim(best, each, gain.values, guards, claimed=True) for each in decision.named]
    claims += [
        _claim(each.within or best, each, (), guards, claimed=False) for each in decision.hints
    ]
    claims = [claim for claim in claims if claim.name not in problem.guards]
    cautions = _catch_all_cautions(problem, decision)
    if decision.named and failed_tests:
        verdict = Verdict.PARTIAL
    cautions += failed_tests
    cautions += _burst_cautions(best, out, tests)
    if gain.contradicts:
        verdict = Verdict.UNEXPLAINED
        no_improvement = _no_improvement(gain)
        why = (_reason_of_no_improvement(no_improvement),)
        claims = [replace(claim, claimed=False, reasons=why, probability={}) for claim in claims]
        cautions.append(no_improvement)
    elif decision.named and not has_process_noise(best.system) and frozen_gain(held, out) <= 0.0:
        cautions.append(Caution(Concern.NO_IMPROVEMENT, FROZEN_WORSE))
    if verdict is Verdict.CONSISTENT and spikes:
        verdict = Verdict.TRACED
    return Judgement(verdict, best, out, (*spikes, *claims), tests, tuple(cautions))


def _catch_all_cautions(problem: TraceProblem, decision: Decision) -> list[Caution]:
    """Return a caution if catch-all terms are among the hints: the cause is not in the library."""
    guards = sorted(problem.guards & {each.name for each in decision.hints})
    if not guards:
        return []
    what = f"what is missing behaves like {', '.join(guards)}, which is no effect of the library"
    terms = [each for each in problem.candidates if each.name in guards]
    equal = sorted({name for each in terms for name in each.traits.equivalents})
    if equal:
        what += f" ({' and '.join(equal)} fit these data equally well)"
    most = max(each.probability for each in decision.hints if each.name in guards)
    quantity = f"the probability of {' and '.join(guards)}, outside the library,"
    requirement = Requirement(quantity, most, 1.0 - CLAIM_LEVEL, at_least=False)
    return [Caution(Concern.GUARD, what, requirement=requirement)]


def _burst_cautions(best: FittedModel, out: HeldOut, tests: ResidualTests) -> list[Caution]:
    """Return a caution for each interval in which white noise is louder than elsewhere."""
    bursts = noise_bursts(best.fit, FITTED, tests.all)
    if out.informed is not None:
        bursts += noise_bursts(out.informed, HELD_OUT, tests.all)
    return [
        Caution(
            Concern.NOISE_BURST,
            f"{burst.channel}: the noise is {burst.ratio:.1f} times as large from "
            f"{time_span(burst.begin, burst.end)} as elsewhere; look at the column there, since "
            "such samples count for too much",
        )
        for burst in bursts
    ]


def _no_improvement(gain: PredictiveGain) -> Caution:
    """Return the caution that held-out data contradict the effects."""
    quantity = "the rise of the log likelihood of data that were not fitted"
    total = gain.total
    requirement = (
        Requirement(quantity, total, gain.least, at_least=True) if np.isfinite(total) else None
    )
    what = "the effects found do not lower the error on data that were not fitted"
    return Caution(Concern.NO_IMPROVEMENT, what, requirement=requirement)


def _reason_of_no_improvement(caution: Caution) -> str:
    """Return the sentence of the caution, with its number if it has one."""
    return caution.requirement.sentence if caution.requirement else caution.sentence


def _claim(
    best: FittedModel,
    named: Named,
    gains: Sequence[float],
    guards: Collection[str],
    *,
    claimed: bool,
) -> Claim:
    """Return a claim, or a hint, with its numbers and its likely alternatives."""
    (effect,) = [each for each in best.effects if each.name == named.name]
    likely = sorted(named.alternatives.items(), key=lambda item: -item[1])
    # General forms and equivalent effects differ in their priors only.
    equal = set(named.alternatives) if effect.traits.general else set(effect.traits.equivalents)
    alternatives = [name for name, share in likely if share > 1.0 - CLAIM_LEVEL or name in equal]
    others = [name for name in alternatives if name not in guards][:MOST_ALTERNATIVES]
    probability = {
        named.name: named.probability,
        **{name: named.alternatives[name] for name in others},
    }
    random = isinstance(effect, NoiseEffect)
    by_record = parameters_by_record(best, effect) if claimed and named.spread is not None else ()
    return Claim(
        named.name,
        widened_by_scatter(quantities(best, effect), by_record),
        tuple(others),
        claimed,
        records_of(best, effect),
        effect.explanation,
        probability=probability if claimed else {},
        by_record=by_record,
        spread=named.spread,
        one_step_gains=tuple(gains) if random else (),
        reasons=() if claimed else (named.reason,) if named.reason else (),
    )
