"""Motion that any real record has, whatever else is missing: where it is significant it belongs to the model of every candidate."""

from __future__ import annotations

from ident.process_noise.innovations_model import has_process_noise
from ident.statistics.coloured_covariance import effective_share
from ident.tracing.candidate_model.fitted_model import FittedModel, free_names, local_names
from ident.tracing.candidate_model.quantities import implausible, quantities
from ident.tracing.diagnosis import Candidate, Step
from ident.tracing.screening.context import search_context
from ident.tracing.selection.criterion import gain, price
from ident.tracing.selection.ledger import Ledger, fit
from sim.declaration.effect import full_name
from sim.declaration.proposal import SearchContext, Traceable, fitted_to


def with_background(ledger: Ledger, fitted: FittedModel, number: int) -> tuple[Ledger, FittedModel]:
    """A fitted model with the background effects that it lacks and the records show; itself where they show none.

    Offered ahead of round ``number``, before any candidate: a drift, a jump or an unmeasured load imitates slow motion, and what any
    aircraft does comes before what may be wrong with this one. It has to bring what any addition has to.
    """
    for candidate in ledger.problem.candidates:
        if not candidate.traits.background or candidate.name in fitted.names or has_process_noise(fitted.system) or ledger.exhausted:
            continue
        context = search_context(fitted, ledger.problem.predicted)
        effect = fitted_to(candidate, context)
        ledger, child = _from_the_middle(ledger, fitted, effect, context)
        if child is None:
            continue
        ledger = ledger.told(evidence=[_evidence(number, fitted, effect, child)])
        brought = gain(fitted, child, ledger.problem.settings.accept)
        if brought <= ledger.problem.settings.accept or _by_colour_alone(fitted, child, ledger.problem.settings.accept):
            continue
        ledger, rival = _rival(ledger, fitted, effect, brought, number, context)
        if rival is not None:
            fitted = rival
            continue
        ledger = ledger.kept(child, ledger.score(fitted) - brought)
        sentence = f"{effect.name}, which any record may have, lowers the criterion by {brought:.1f} and belongs to the model from here on"
        ledger = ledger.told(Step(child.names, ledger.score(child), child.fit.log_likelihood, sentence))
        fitted = ledger.known(child)
    return ledger, fitted


def _by_colour_alone(fitted: FittedModel, child: FittedModel, accept: float) -> bool:
    """Whether the gain would not do if only so many samples counted as what is left of the residual makes independent.

    Where small causes colour the residual of every record, anything slow brings something; where it is the cause, it leaves noise.
    """
    share = effective_share(child.fit.residuals, [problem.valid for problem in child.fit.layout.problems])
    return 2.0 * share * (fitted.fit.cost - child.fit.cost) - price(fitted, child) <= accept


def with_known_background(ledger: Ledger, fitted: FittedModel) -> FittedModel:
    """The fitted model with the background effects that the search found it to have; itself where there are none."""
    known = [other for other in ledger.models.values() if other.foreground == fitted.foreground and len(other.effects) > len(fitted.effects)]
    return min(known, key=ledger.score, default=fitted)


def _rival(
    ledger: Ledger, fitted: FittedModel, effect: Traceable, brought: float, number: int, context: SearchContext
) -> tuple[Ledger, FittedModel | None]:
    """The fitted model with one of the aliases of a background effect, where that brings clearly more; None where none does.

    The background effect would imitate it, and beside that it no longer shows.
    """
    best, most, accept = None, brought + ledger.problem.settings.accept, ledger.problem.settings.accept
    for candidate in ledger.problem.candidates:
        if candidate.name not in effect.aliases or candidate.name in fitted.names:
            continue
        other = fitted_to(candidate, context)
        ledger, child = _from_the_middle(ledger, fitted, other, context)
        if child is None or (more := gain(fitted, child, accept)) <= most:
            continue
        ledger = ledger.told(evidence=[_evidence(number, fitted, other, child)])
        ledger = ledger.kept(child, ledger.score(fitted) - more)
        sentence = f"{other.name}, in the place of {effect.name}, lowers the criterion by {more:.1f} and belongs to the model from here on"
        ledger = ledger.told(Step(child.names, ledger.score(child), child.fit.log_likelihood, sentence))
        best, most = ledger.known(child), more
    return ledger, best


def _from_the_middle(ledger: Ledger, fitted: FittedModel, effect: Traceable, context: SearchContext) -> tuple[Ledger, FittedModel | None]:
    """The effect added to a fitted model, from the middle of its probes, and from the others where no cost is finite there.

    Its motion is nearly linear in what belongs to a record, so that one start reaches all; where nothing shows it, no start does better.
    """
    probes = sorted(effect.probes(context), key=lambda probe: sum(abs(value) for value in probe.values.values()))
    for probe in probes:
        start = {full_name(effect, local): value for local, value in probe.values.items()}
        ledger, child = fit(ledger, (*fitted.effects, effect), fitted, start, rough=True)
        if child is not None:
            return ledger, child
    return ledger, None


def _evidence(number: int, fitted: FittedModel, effect: Traceable, child: FittedModel) -> Candidate:
    from scipy.special import chdtrc

    found, brought = quantities(child, effect), fitted.fit.cost - child.fit.cost
    # Chance has all of them to itself, those too that are known beforehand and that the search does not charge.
    own, records = len(local_names(effect)), len(fitted.fit.layout.problems)
    parameters = len(free_names(effect)) + own * (records - 1)
    p_value = float(chdtrc(parameters, max(2.0 * brought, 0.0)))
    return Candidate(number, fitted.names, effect.name, float(brought), p_value, True, not implausible(effect, found, slack=0.0), found, None, ())
