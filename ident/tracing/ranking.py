"""Of sets that are near each other, the one to judge: by the fitted records, and by the others where these take part in choosing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Step
from ident.tracing.equivalents import are_equivalent, told_by_declared
from ident.tracing.restored_belief import with_belief_restored, without_unbelievable
from ident.tracing.screening.context import search_context
from ident.tracing.selection.backward import backward_elimination, refined
from ident.tracing.selection.criterion import is_white
from ident.tracing.selection.crossed_pairs import crossed_pairs
from ident.tracing.selection.ledger import Key, Ledger, fit
from ident.tracing.selection.near_aliases import equivalent_sets, guards_for_events, near_aliases
from ident.tracing.validation.held_out import HeldOut, HeldOutData, charged_cost, doubted, predicted_by
from ident.tracing.weighed import ComparedSet
from sim.declaration.effect import full_name
from sim.declaration.proposal import Refinable, Traceable, fitted_to

Compared = Mapping[Key, tuple[FittedModel, HeldOut]]


@dataclass(frozen=True, eq=False)
class Choice:
    """The set that is judged and what it does on data that were not fitted.

    ``totals`` : criterion, ``misfits`` : twice the cost, of each set that was compared, by the names of its effects; with the cost of the
    data that were not fitted where these take part. Empty where nothing was compared. ``sets`` : the same for the probability of names, with
    others that the search passed. ``uneven`` : its process noise stands for what goes with the motion, ``behind_gaps`` for what missing rows
    leave. ``idle`` : names that predict nothing.
    """

    best: FittedModel
    out: HeldOut
    totals: Mapping[Key, float] = field(default_factory=dict)
    misfits: Mapping[Key, float] = field(default_factory=dict)
    sets: tuple[ComparedSet, ...] = ()
    uneven: bool = False
    behind_gaps: bool = False
    idle: tuple[str, ...] = ()


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
        ledger, best, out = _in_freer_form(ledger, best, out, held)
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


def alternatives_of(choice: Choice, guards: frozenset[str]) -> dict[str, tuple[str, ...]]:
    """For each effect of a set the names that could stand in its place, two at most, the nearest first.

    They explain the data as well, however many parameters they need for it: that they are dearer is a reason to name the other,
    not to deny them.
    """
    mine = frozenset(choice.best.names)
    reference = choice.misfits.get(mine)
    found: dict[str, list[tuple[float, str]]] = {}
    if reference is None:
        return {}
    for key, misfit in choice.misfits.items():
        gone, come = mine - key, key - mine
        if len(gone) == len(come) == 1 and misfit - reference < thresholds.ALTERNATIVE and not come & guards:
            found.setdefault(next(iter(gone)), []).append((misfit - reference, next(iter(come))))
    return {name: tuple(other for _, other in sorted(entries)[: thresholds.ALTERNATIVES_NAMED]) for name, entries in found.items()}


def is_ambiguous(choice: Choice, guards: frozenset[str]) -> bool:
    """Whether a set of one other effect explains all data that take part as well as the one chosen."""
    mine = frozenset(choice.best.names)
    reference = choice.totals.get(mine, 0.0)
    return any(
        total - reference < thresholds.AMBIGUOUS
        and len(key) == len(mine)
        and len(key - mine) == 1
        and not key & guards
        and not _one_sensor(choice.best, mine - key, key - mine)
        for key, total in choice.totals.items()
        if key != mine
    )


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


def _in_freer_form(ledger: Ledger, best: FittedModel, out: HeldOut, held: HeldOutData) -> tuple[Ledger, FittedModel, HeldOut]:
    """The same causes in their freer forms, where data that were not fitted ask for it: other levels of input show more of a curve."""
    if not doubted(out):
        return ledger, best, out
    effects = tuple(_freer(ledger, best, effect) for effect in best.effects)
    if all(one is other for one, other in zip(effects, best.effects, strict=True)):
        return ledger, best, out
    known = {*best.values.shared, *best.values.own[0]}
    absent = {full_name(effect, local): value for effect in effects for local, value in effect.absent.items()}
    ledger, finer = fit(ledger, effects, best, {name: value for name, value in absent.items() if name not in known})
    if finer is None:
        return ledger, best, out
    other = predicted_by(finer, held)
    if other.informed is None or out.informed is None or other.informed.cost >= out.informed.cost or doubted(other):
        return ledger, best, out
    score = ledger.score(best)
    ledger = ledger.replaced(finer, score)
    sentence = "freer forms, for what the records that were not fitted show of them"
    return ledger.told(Step(finer.names, score, finer.fit.log_likelihood, sentence)), finer, other


def _freer(ledger: Ledger, best: FittedModel, effect: Traceable) -> Traceable:
    """The freer form of an effect; of one that has none the form of its name that has, over the ranges flown; else itself."""
    if isinstance(effect, Refinable):
        return effect.finer()
    others = [other for other in ledger.problem.candidates if other.name == effect.name and isinstance(other, Refinable)]
    return fitted_to(others[0], search_context(best, ledger.problem.predicted)) if others else effect


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


def _one_sensor(best: FittedModel, gone: Key, come: Key) -> bool:
    """Whether two names are the lag and the delay of one sensor: one late sensor, described twice, under the same derivatives."""
    if are_equivalent(best, gone, come):
        return False
    return any(come.intersection(effect.traits.twins) for effect in best.effects if effect.name in gone)
