"""Of sets that are near each other, the one to judge: by the fitted records, and by the others where these take part in choosing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.equivalents import are_equivalent, told_by_declared
from ident.tracing.ranking.choice import Choice
from ident.tracing.ranking.freer_form import in_freer_form
from ident.tracing.ranking.restored_belief import with_belief_restored, without_unbelievable
from ident.tracing.selection.backward import backward_elimination, refined
from ident.tracing.selection.criterion import is_white
from ident.tracing.selection.crossed_pairs import crossed_pairs
from ident.tracing.selection.ledger import Key, Ledger
from ident.tracing.selection.near_aliases import equivalent_sets, guards_for_events, near_aliases
from ident.tracing.validation.held_out import HeldOut, HeldOutData, charged_cost, doubted, predicted_by

Compared = Mapping[Key, tuple[FittedModel, HeldOut]]


def believable_choice(ledger: Ledger, best: FittedModel, held: HeldOutData) -> tuple[Ledger, Choice]:
    """The set to judge among those near a set; with a further effect where only that leaves derivatives that can be believed."""
    ledger, choice = choose_among_near(ledger, best, held)
    if frozenset(choice.best.names) != frozenset(best.names):
        # Beside the one that took another's place an effect may have nothing left to explain.
        ledger, leaner = backward_elimination(ledger, choice.best)
        if leaner is not choice.best:
            ledger, choice = choose_among_near(ledger, leaner, held)
    if not is_white(choice.best, ledger.problem.settings.white):
        return ledger, choice
    ledger, leaner = without_unbelievable(ledger, choice.best)
    if leaner is not choice.best:
        return choose_among_near(ledger, leaner, held)
    ledger, fuller = with_belief_restored(ledger, choice.best)
    return (ledger, choice) if fuller is choice.best else choose_among_near(ledger, fuller, held)


def choose_among_near(ledger: Ledger, best: FittedModel, held: HeldOutData) -> tuple[Ledger, Choice]:
    """Compare the sets of equal size that are near a set, and take the one of lowest criterion over all data that take part.

    Between sets that no data tell apart the declared derivatives choose.
    """
    settings = ledger.problem.settings
    ledger, best = _without_guard(ledger, best)
    ledger, best = _of_fewer(ledger, best)
    explained = is_white(best, settings.white) and not best.guards
    out = predicted_by(best, held, informed=explained)
    if not best.effects or not explained:
        # What training itself does not explain, no held-out record will.
        return ledger, Choice(best, out)
    if held.choosing:
        ledger, best, out = in_freer_form(ledger, best, out, held)
    compared: Compared = {frozenset(best.names): (best, out)}
    # A name rests on what was put in its place, however much the search before it took.
    ledger, alike = near_aliases(ledger.renewed(thresholds.LEFT_FOR_ALIASES), best, settings.near)
    wide = held.choosing and doubted(out)
    near = _near(ledger, best, settings.wide if wide else settings.near, thresholds.RIVALS_WIDE if wide else thresholds.RIVALS_NEAR)
    ledger, compared = _with(ledger, compared, [*near, *alike], held)
    leading, totals = _leading(compared, held)
    if wide and doubted(compared[leading][1]):
        # The fitted record was content with causes that another record does not know.
        ledger, crossed = crossed_pairs(ledger.renewed(thresholds.LEFT_FOR_PAIRS), best)
        crossed = [fitted for fitted in crossed if fitted.criterion - best.criterion < settings.wide]
        ledger, compared = _with(ledger, compared, crossed, held)
        leading, totals = _leading(compared, held)
    asked = {frozenset(best.names)}
    for _ in best.effects:
        # Another than the best may lead now, and has equivalents and near-aliases of its own.
        ledger, alike = equivalent_sets(ledger, compared[leading][0], settings.near)
        if leading not in asked:
            asked.add(leading)
            ledger, further = near_aliases(ledger, compared[leading][0], settings.near)
            alike = [*alike, *further]
        further = [fitted for fitted in alike if frozenset(fitted.names) not in compared]
        if not further:
            break
        ledger, compared = _with(ledger, compared, further, held)
        leading, totals = _leading(compared, held)
    ledger, compared, outdone = _outdone_by_guard(ledger, compared, compared[leading][0], held)
    if outdone is not None:
        return ledger, Choice(*outdone)
    totals = {key: fitted.criterion + charged_cost(fitted, fits, held) for key, (fitted, fits) in compared.items()} | dict(totals)
    misfits = {key: 2.0 * fitted.fit.cost + charged_cost(fitted, fits, held) for key, (fitted, fits) in compared.items()}
    chosen, fits = compared[leading]
    if not held.choosing and chosen is not best:
        fits = predicted_by(chosen, held)
    return ledger, Choice(chosen, fits, totals, misfits)


def _leading(compared: Compared, held: HeldOutData) -> tuple[Key, Mapping[Key, float]]:
    """The set that leads, and the criterion of each over all data that take part.

    By the plain criterion: unevenness of the noise is a bar against chance, no measure of one cause against another.
    """
    models = {key: fitted for key, (fitted, _) in compared.items()}
    totals = told_by_declared({key: fitted.criterion + charged_cost(fitted, fits, held) for key, (fitted, fits) in compared.items()}, models)
    return _likelier_cause(models, totals), totals


def _outdone_by_guard(
    ledger: Ledger, compared: Compared, best: FittedModel, held: HeldOutData
) -> tuple[Ledger, Compared, tuple[FittedModel, HeldOut] | None]:
    """All compared sets, those with a guard in the place of an effect of the best among them, and one that wins where it was not fitted, too.

    On the fitted record alone a guard may have tied; it has to win by as much as anywhere (``thresholds.GUARD_TIE``).
    """
    if not held.choosing:
        return ledger, compared, None
    mine = frozenset(best.names)
    ledger = guards_for_events(ledger, best, ledger.problem.settings.near)
    rivals = [m for key, m in ledger.models.items() if m.guards and len(key) == len(mine) and len(key - mine) == 1 and key not in compared]
    near = [m for m in rivals if m.criterion - best.criterion < ledger.problem.settings.near]
    ledger, compared = _with(ledger, compared, sorted(near, key=lambda m: m.criterion)[: thresholds.GUARDS_COMPARED], held)
    totals = {key: fitted.criterion + charged_cost(fitted, fits, held) for key, (fitted, fits) in compared.items()}
    guards = [key for key in compared if key & ledger.problem.guards]
    first = min(guards, key=lambda key: totals[key], default=mine)
    won = first != mine and totals[first] < totals[mine] - thresholds.GUARD_TIE
    return ledger, compared, compared[first] if won else None


def _with(ledger: Ledger, compared: Compared, sets: Sequence[FittedModel], held: HeldOutData) -> tuple[Ledger, Compared]:
    """Further sets fitted to the end, with what they do on the data that take part."""
    out = dict(compared)
    for fitted in sets:
        ledger, other = refined(ledger, fitted)
        out[frozenset(other.names)] = (other, predicted_by(other, held, informed=True) if held.choosing else HeldOut(None, None))
    return ledger, out


def _likelier_cause(compared: Mapping[Key, FittedModel], totals: Mapping[Key, float]) -> Key:
    """The set of lowest total; one with a likelier cause in the place of a rarer one where the data do not prefer the latter."""
    best = min(totals, key=lambda key: totals[key])
    for effect in compared[best].effects:
        for other in effect.traits.rarer_than:
            likelier = (best - {effect.name}) | {other}
            if likelier in totals and totals[likelier] - totals[best] < thresholds.AMBIGUOUS:
                return likelier
    return best


def _without_guard(ledger: Ledger, best: FittedModel) -> tuple[Ledger, FittedModel]:
    """A set of the library's effects alone, where one of the same size is as good but for noise: a guard must win, not tie."""
    if not best.guards:
        return ledger, best
    rivals = [
        fitted
        for key, fitted in ledger.models.items()
        if len(fitted.effects) == len(best.effects)
        and not key & ledger.problem.guards
        and ledger.scores[key] - ledger.score(best) < thresholds.GUARD_TIE
    ]
    return refined(ledger, min(rivals, key=ledger.score)) if rivals else (ledger, best)


def _of_fewer(ledger: Ledger, best: FittedModel) -> tuple[Ledger, FittedModel]:
    """A set of fewer effects that leaves noise with a lower criterion, if the search passed one: scores depend on the way to a set."""
    least = ledger.problem.settings.white
    fewer = [
        fitted
        for key, fitted in ledger.models.items()
        if len(key) < len(best.effects) and fitted.criterion < best.criterion and not key & ledger.problem.guards and is_white(fitted, least)
    ]
    fewer = [fitted for fitted in fewer if has_process_noise(fitted.system) == has_process_noise(best.system)]
    return refined(ledger, min(fewer, key=lambda fitted: fitted.criterion)) if fewer else (ledger, best)


def _near(ledger: Ledger, best: FittedModel, within: float, most: int) -> list[FittedModel]:
    mine = frozenset(best.names)
    others = [
        fitted
        for key, fitted in ledger.models.items()
        if key != mine
        and len(fitted.effects) == len(best.effects)
        and fitted.criterion - best.criterion < within
        and (not key & ledger.problem.guards or are_equivalent(best, mine - key, key - mine))
    ]
    return sorted(others, key=lambda fitted: fitted.criterion)[:most]
