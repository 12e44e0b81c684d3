"""What can be claimed where the search explains nothing: effects that replicate, rough air, or hints; and what is not claimed after all."""

from __future__ import annotations

from dataclasses import replace

from ident.tracing import thresholds
from ident.tracing.belief.together import is_open_form
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.candidate_model.problem import TraceProblem
from ident.tracing.compared_sets import weighed
from ident.tracing.diagnosis import Caution, Concern, Requirement, Verdict
from ident.tracing.found import Found
from ident.tracing.name_probability import likely_requirement, unlikely
from ident.tracing.ranking.choice import Choice
from ident.tracing.ranking.near_sets import believable_choice
from ident.tracing.replication.partial import Partial, as_partial, cross_validated
from ident.tracing.replication.rough_air import process_noise_that_stands
from ident.tracing.selection.backward import without_needless_background
from ident.tracing.selection.forward import extended, hopeless
from ident.tracing.selection.ledger import Ledger
from ident.tracing.validation.held_out import HeldOut, HeldOutData, predicted_by
from ident.tracing.validation.improvement import contradicted, hardly_better, no_better
from ident.tracing.verdict import Judgement, claims_of, judge, not_noise, residual_tests

# Of a set that leaves noise and may not be claimed.
WITHDRAWN = frozenset({Concern.UNDETERMINED, Concern.ROWS_MISSING, Concern.DERIVATIVES, Concern.ONE_CAUSE, Concern.CONTRADICTED})


def what_replicates(found: Found, judgement: Judgement) -> tuple[Ledger, Judgement]:
    """Where the search explains nothing: hints at most, unless effects are cross-validated."""
    ledger, partial = found.ledger, found.partial
    hints = [replace(claim, claimed=False) for claim in judgement.claims]
    if no_better(found.held.declared, judgement.out):
        # What does not help on data that were not fitted is not even a hint.
        judgement = replace(judgement, not_met=no_help(found.held, judgement))
        hints = [replace(spike, claimed=False) for spike in found.spikes]
        judgement = replace(judgement, best=found.root, out=found.held.declared)
    judgement = replace(judgement, claims=tuple(hints))
    if any(caution.concern in WITHDRAWN for caution in judgement.cautions):
        # What is left is noise: there is nothing more to find, only nothing that may be claimed.
        return ledger, judgement
    if not found.asked:
        ledger, partial = replicating(ledger, found.base, found.held)
    ledger, partial = likely_part(ledger, found, partial)
    # What replicates on the whole and yet predicts the data held out no better is left unsaid.
    # Nor is a force claimed whose form one curve leaves open.
    standing = None if partial is None or is_open_form(partial.fitted) or predicts_no_better(found.held, partial) else partial
    if standing is not None and not standing.events_alone:
        return judged_again(ledger, found, standing)
    # Rough air is made of events: one of them is claimed where the rest is quiet.
    ledger, rough = in_rough_air(ledger, found, judgement)
    if standing is None or rough.verdict is Verdict.PARTIAL:
        return ledger, rough
    return judged_again(ledger, found, standing)


def no_help(held: HeldOutData, judgement: Judgement) -> tuple[Requirement, ...]:
    """The requirement on data that were not fitted that a set of effects does not meet, so that it is no hint."""
    names = tuple(claim.name for claim in judgement.claims if claim.name in judgement.best.names)
    before, after = held.declared.frozen, judgement.out.frozen
    if before is None or after is None or not names:
        return ()
    asked = f"the rise of the log likelihood of data that were not fitted by {' and '.join(names)}"
    return (Requirement(asked, before.cost - after.cost, 0.0, at_least=True, effects=names),)


def likely_part(ledger: Ledger, found: Found, partial: Partial | None) -> tuple[Ledger, Partial | None]:
    """What replicates, up to the first effect that is, with its alternatives, less than twice as likely as something that is not named.

    What was found beside that one rests on it; what came before does not.
    """
    if partial is None:
        return ledger, None
    names, chosen = unlikely(partial.claims, ledger.problem.twins), partial.validated.chosen
    before = next((place for place, item in enumerate(chosen) if item.best.effect.name in names), 0)
    if not before:
        return ledger, partial
    return as_partial(ledger, found.base, found.held, replace(partial.validated, chosen=chosen[:before]))


def replicating(ledger: Ledger, base: FittedModel, held: HeldOutData) -> tuple[Ledger, Partial | None]:
    """Effects that replicate; where data that were not fitted take part in choosing, none that predict these no better."""
    return helpful(held, *cross_validated(ledger, base, held))


def helpful(held: HeldOutData, ledger: Ledger, partial: Partial | None) -> tuple[Ledger, Partial | None]:
    """What replicates; None where data that were not fitted take part in choosing, and it predicts these no better."""
    return ledger, None if partial is None or (held.choosing and predicts_no_better(held, partial)) else partial


def predicts_no_better(held: HeldOutData, partial: Partial) -> bool:
    """Whether data that were not fitted are predicted no better with what replicates; of events alone, which need not be there, worse.

    Where they take part in choosing they are half of the evidence, and a record that hardly moves is none. What is fitted to them lowers
    their error by all that it brings, noise or not, so that half of that says nothing.
    """
    if partial.events_alone:
        return no_better(held.declared, partial.out)
    weak = not (held.choosing or partial.learnt_there)
    if weak and shown_strongly(partial):
        return contradicted(held.declared, partial.out)
    return hardly_better(held.declared, partial.out, weak=weak)


def shown_strongly(partial: Partial) -> bool:
    """Whether three records or more, each predicted by the others, show every effect of the set by twice what is worth a claim."""
    chosen = [item.best.reduction for item in partial.validated.chosen if item.best.effect.name in partial.fitted.names]
    strong = [one for one in chosen if one.total <= -thresholds.STRONGLY * thresholds.WORTH and len(one.by_record) >= thresholds.FEWEST_RECORDS]
    return bool(chosen) and len(strong) == len(chosen)


def judged_again(ledger: Ledger, found: Found, partial: Partial) -> tuple[Ledger, Judgement]:
    """The verdict on effects that replicate: with a further one, they may leave noise after all."""
    problem, held = ledger.problem, found.held
    if not hopeless(ledger, partial.fitted):
        ledger, further = extended(ledger, found.root, partial.fitted)
        ledger, further = without_needless_background(ledger, further)
        ledger, choice = believable_choice(ledger, further, held)
        choice = weighed(ledger, choice, held)
        again = judge(problem, found.root, choice, found.spikes, held)
        if again.verdict in (Verdict.TRACED, Verdict.AMBIGUOUS):
            return ledger, again
    tests = residual_tests(partial.fitted, HeldOut(None, None), held)
    claims, cautions = (*partial.claims, *(replace(spike, claimed=False) for spike in found.spikes)), not_noise(tests.all, problem.settings.white)
    return ledger, Judgement(Verdict.PARTIAL, partial.fitted, partial.out, claims, tests, tuple(cautions))


def without_unlikely(problem: TraceProblem, judgement: Judgement) -> Judgement:
    """Unexplained where a claim is, with its alternatives, not likely enough beside something that is not named; all are hints then."""
    names = unlikely(judgement.claims, problem.twins)
    if not names:
        return judgement
    told = f"what fits best is {' and '.join(names)}, but something that is not named is nearly as likely, or more"
    hints = tuple(replace(claim, claimed=False) for claim in judgement.claims)
    asked = likely_requirement(judgement.claims, problem.twins)
    cautions = (Caution(Concern.UNLIKELY, told, requirement=asked), *judgement.cautions)
    return replace(judgement, verdict=Verdict.UNEXPLAINED, claims=hints, cautions=cautions)


def in_rough_air(ledger: Ledger, found: Found, judgement: Judgement) -> tuple[Ledger, Judgement]:
    """Process noise claimed where it stands by one-step predictions; else the judgement as it is."""
    ledger, rough = process_noise_that_stands(ledger, found.base, found.held)
    if rough is None and found.base is not found.root:
        # A slow gust looks like a phugoid to a search that knows no gusts.
        ledger, rough = process_noise_that_stands(ledger, found.root, found.held)
    if rough is None:
        return ledger, judgement
    fitted, noise = rough.fitted, rough.fitted.effects[-1].name
    spikes = tuple(replace(spike, claimed=False) for spike in found.spikes)
    named = claims_of(ledger.problem, Choice(fitted, HeldOut(None, None)))
    claims = (*(replace(claim, one_step_gains=rough.gains) if claim.name == noise else claim for claim in named), *spikes)
    tests = residual_tests(fitted, HeldOut(None, None), found.held)
    left = tuple(not_noise(tests.all, ledger.problem.settings.white))
    return ledger, Judgement(Verdict.PARTIAL, fitted, predicted_by(fitted, found.held, informed=False), claims, tests, left)
