"""From evidence to a verdict; an honest `unexplained` beats a wrong name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.process_noise.filter_error import noise_levels, predictive_log_likelihood
from ident.process_noise.innovations_model import has_process_noise
from ident.statistics.residuals import ResidualTest
from ident.tracing.candidate_model.fitted_model import FittedModel, belongs_to_record, free_names
from ident.tracing.candidate_model.quantities import implausible, quantities
from ident.tracing.diagnosis import Claim, Step, Verdict
from ident.tracing.selection.backward import refined
from ident.tracing.selection.criterion import is_white
from ident.tracing.selection.near_aliases import near_aliases
from ident.tracing.selection.search import Search
from ident.tracing.settings import TraceSettings
from ident.tracing.validation.held_out import HeldOut, doubted, held_out
from sim.declaration.proposal import Refinable, Traceable
from sim.record import Record

TIE = 12.0  # difference of scores below which a guard does not stand against the library
AMBIGUOUS = 3.0  # difference of twice the log likelihood, training and held out together, below which two names are equal
ALTERNATIVE = 10.0  # the same, below which the other is named beside


def best_by_held_out(
    search: Search, best: FittedModel, validation: Sequence[Record], masks: Sequence[np.ndarray] | None
) -> tuple[FittedModel, HeldOut]:
    """Of the sets of equal size that are near, the one that the held-out records prefer; and its fits there."""
    best = _without_guard(search, best)
    hopeless = not is_white(best, search.settings.white) or bool(best.guards)
    out = held_out(best, validation, masks, informed=not hopeless) if validation else HeldOut(None, None)
    if not best.effects or hopeless:
        # What training itself does not explain, no held-out record will.
        return best, out
    best, out = _in_freer_form(search, best, out, validation, masks)
    # By the plain criterion: unevenness of the noise is a bar against chance, no measure of one cause against another.
    total = {frozenset(best.names): best.criterion + _held_out_cost(out)}
    misfit = {frozenset(best.names): 2.0 * best.fit.cost + _held_out_cost(out)}
    fitted_models, outs = {frozenset(best.names): best}, {frozenset(best.names): out}
    alike = near_aliases(search, best, search.settings.near)
    rivals = [*_near(search, best, search.settings.near, 3), *alike]
    if doubted(out):
        rivals = [*_near(search, best, search.settings.wide, 6), *alike]
    for fitted in rivals:
        other = refined(search, fitted)
        fits = held_out(other, validation, masks) if validation else HeldOut(None, None)
        key = frozenset(other.names)
        fitted_models[key], outs[key], total[key] = other, fits, other.criterion + _held_out_cost(fits)
        misfit[key] = 2.0 * other.fit.cost + _held_out_cost(fits)
    chosen = min(total, key=lambda key: total[key])
    search.totals, search.misfits = total, misfit
    return fitted_models[chosen], outs[chosen]


def _without_guard(search: Search, best: FittedModel) -> FittedModel:
    """A set of the library's effects alone, where one of the same size is as good but for noise: a guard must win, not tie."""
    if not best.guards:
        return best
    rivals = [
        fitted
        for key, fitted in search.fitted_models.items()
        if len(fitted.effects) == len(best.effects) and not key & search.guards and search.scores[key] - search.score(best) < TIE
    ]
    return refined(search, min(rivals, key=search.score)) if rivals else best


def _in_freer_form(
    search: Search, best: FittedModel, out: HeldOut, validation: Sequence[Record], masks: Sequence[np.ndarray] | None
) -> tuple[FittedModel, HeldOut]:
    """The same causes in their freer forms, where held-out data ask for it: other levels of input show more of a curve."""
    if not doubted(out) or not any(isinstance(effect, Refinable) for effect in best.effects):
        return best, out
    effects = tuple(effect.finer() if isinstance(effect, Refinable) else effect for effect in best.effects)
    finer = search.fit(effects, best)
    if finer is None:
        return best, out
    other = held_out(finer, validation, masks)
    if other.informed is None or out.informed is None or other.informed.cost >= out.informed.cost or doubted(other):
        return best, out
    search.keep(finer, search.score(best))
    search.fitted_models[frozenset(best.names)] = finer
    search.steps.append(Step(finer.names, search.score(finer), finer.fit.log_likelihood, "freer forms, for what the held-out data show of them"))
    return finer, other


def alternatives_of(search: Search, best: FittedModel) -> dict[str, tuple[str, ...]]:
    """For each effect of a set the names that could stand in its place, two at most, the nearest first.

    They explain the data as well, however many parameters they need for it: that they are dearer is a reason to name the other,
    not to deny them.
    """
    mine = frozenset(best.names)
    reference = search.misfits.get(mine)
    found: dict[str, list[tuple[float, str]]] = {}
    if reference is None:
        return {}
    for key, misfit in search.misfits.items():
        gone, come = mine - key, key - mine
        if len(gone) == len(come) == 1 and misfit - reference < ALTERNATIVE and not come & search.guards:
            found.setdefault(next(iter(gone)), []).append((misfit - reference, next(iter(come))))
    return {name: tuple(other for _, other in sorted(entries)[:2]) for name, entries in found.items()}


def judge(
    search: Search,
    root: FittedModel,
    best: FittedModel,
    effects: Sequence[Claim],
    tests: Sequence[ResidualTest],
    before: HeldOut,
    after: HeldOut,
    settings: TraceSettings,
) -> tuple[Verdict, list[str]]:
    """The verdict, and in words what speaks against more."""
    warnings = not_noise(tests, settings.white)
    if not effects and not best.effects:
        if warnings and all("held out" in test.channel for test in tests if test.p_value < settings.white):
            warnings.append(
                "the declared model explains the fitted records but not the held-out ones: fit them together, they show what the first do not"
            )
        return (Verdict.UNEXPLAINED if warnings else Verdict.CONSISTENT), warnings
    guards = best.guards
    if guards:
        return Verdict.UNEXPLAINED, [f"what is missing behaves like {', '.join(guards)}, which is no effect of the library", *warnings]
    if warnings:
        return Verdict.UNEXPLAINED, warnings
    odd = [f"{effect.name} with {', '.join(names)} beyond belief" for effect in best.effects if (names := _beyond_belief(best, effect))]
    if odd:
        return Verdict.UNEXPLAINED, [f"what fits best is {' and '.join(odd)}: the cause is another"]
    if best.effects and not _improved(search, root, best, before, after):
        return Verdict.UNEXPLAINED, ["the effects found do not lower the error on data that were not fitted"]
    if _ambiguous(search, best):
        return Verdict.AMBIGUOUS, warnings
    return Verdict.TRACED, warnings


def _beyond_belief(fitted: FittedModel, effect: Traceable) -> list[str]:
    return implausible(effect, quantities(fitted, effect))


def not_noise(tests: Sequence[ResidualTest], least: float) -> list[str]:
    """What is left, in words: one line for each test whose p-value is below ``least``."""
    return [f"{test.channel}: {test.sentence} (p = {test.p_value:.1e})" for test in tests if test.p_value < least]


def _near(search: Search, best: FittedModel, within: float, most: int) -> list[FittedModel]:
    others = [
        fitted
        for key, fitted in search.fitted_models.items()
        if key != frozenset(best.names)
        and len(fitted.effects) == len(best.effects)
        and fitted.criterion - best.criterion < within
        and not key & search.guards
    ]
    return sorted(others, key=lambda fitted: fitted.criterion)[:most]


def _held_out_cost(out: HeldOut) -> float:
    return 2.0 * out.informed.cost if out.informed is not None else 0.0


def _ambiguous(search: Search, best: FittedModel) -> bool:
    mine = frozenset(best.names)
    reference = search.totals.get(mine, 0.0)
    return any(
        total - reference < AMBIGUOUS
        and len(key) == len(mine)
        and len(key - mine) == 1
        and not key & search.guards
        and not _one_sensor(best, mine - key, key - mine)
        for key, total in search.totals.items()
        if key != mine
    )


def _one_sensor(best: FittedModel, gone: frozenset[str], come: frozenset[str]) -> bool:
    """Whether two names are the lag and the delay of one sensor: one late sensor, described twice."""
    return any(come.intersection(effect.traits.twins) for effect in best.effects if effect.name in gone)


def _improved(search: Search, root: FittedModel, best: FittedModel, before: HeldOut, after: HeldOut) -> bool:
    """Whether held-out data speak for the effects; True where there are none, not where they cannot be simulated.

    For deterministic effects the error of a free simulation, over all channels, which must not get worse by more than its
    scatter. With process noise a free simulation cannot improve: then one-step predictions, by their likelihood.
    """
    if before.frozen is None or after.frozen is None:
        return not search.beside and before.frozen is None and after.frozen is None
    if not has_process_noise(best.system):
        gain = before.frozen.cost - after.frozen.cost
        return gain > -float(np.sqrt(2.0 * len(after.frozen.theta)))
    records = [problem.record for problem in before.frozen.layout.problems]
    settings = best.fit.layout.settings
    masks = [problem.valid for problem in (after.informed or before.frozen).layout.problems]
    plain = predictive_log_likelihood(records, root.system, root.values.shared, noise_levels(root.fit), settings, masks=masks)
    local = [name for effect in best.effects if belongs_to_record(effect) for name in free_names(effect)]
    found = predictive_log_likelihood(records, best.system, best.values.shared, noise_levels(best.fit), settings, local=local, masks=masks)
    return found > plain
