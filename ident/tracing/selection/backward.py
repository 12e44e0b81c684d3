"""Backward elimination: each effect of a set has to show that it is still needed; and the freer forms of curves."""

from __future__ import annotations

from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Step
from ident.tracing.selection.criterion import gain, is_coloured_throughout, is_white
from ident.tracing.selection.event_times import in_freer_form
from ident.tracing.selection.expansion import expand
from ident.tracing.selection.ledger import Ledger, fit
from ident.tracing.selection.plain_forms import in_plain_form
from sim.declaration.proposal import Refinable, Traceable


def backward_elimination(ledger: Ledger, fitted: FittedModel) -> tuple[Ledger, FittedModel]:
    """Drop each effect whose removal costs less than an addition has to bring; try to extend once more after a drop."""
    accept = ledger.problem.settings.accept
    ledger, best = smaller_as_good(ledger, fitted)
    while len(best.effects) > 1:
        smaller = []
        for effect in best.effects:
            ledger, without = fitted_without(ledger, best, effect)
            if without is not None and (loss := gain(without, best, accept)) < accept:
                smaller.append((loss, without, effect.name))
        if not smaller:
            break
        loss, without, name = min(smaller, key=lambda item: item[0])
        ledger = _dropped(ledger, best, without, name, loss)
        ledger, children = expand(ledger, without, len(without.effects) + 1)
        best = min((without, *children), key=ledger.score)
    return ledger, best


def smaller_as_good(ledger: Ledger, fitted: FittedModel) -> tuple[Ledger, FittedModel]:
    """The best of a set and of those one effect smaller than any that fits nearly as well: a search does not come to all of them on its way up.

    What stands alone for two others may promise less than each of them at the declared model (a late surface where both of its sensors are
    late), and is met beside one of them first.
    """
    accept, best = ledger.problem.settings.accept, fitted
    if len(fitted.effects) < 2:
        return ledger, fitted
    near = [other for other in ledger.models.values() if len(other.effects) > 1 and 2.0 * (other.fit.cost - fitted.fit.cost) < accept]
    for other in sorted(near, key=ledger.score):
        for effect in other.effects:
            if ledger.exhausted or frozenset(other.names) - {effect.name} in ledger.models:
                continue
            ledger, without = fitted_without(ledger, other, effect)
            if without is None or (loss := gain(without, other, accept)) >= accept:
                continue
            ledger = _dropped(ledger, other, without, effect.name, loss)
            best = min((best, ledger.known(without)), key=ledger.score)
    return ledger, best


def without_needless_background(ledger: Ledger, fitted: FittedModel) -> tuple[Ledger, FittedModel]:
    """The set less the background effects whose removal costs less than an addition has to bring: what came later explains them."""
    best, accept = fitted, ledger.problem.settings.accept
    for effect in fitted.background if len(fitted.effects) > 1 else ():
        ledger, without = fitted_without(ledger, best, effect)
        if without is None or (loss := gain(without, best, accept)) >= accept:
            continue
        ledger, best = _dropped(ledger, best, without, effect.name, loss), without
    return ledger, best


def _dropped(ledger: Ledger, fitted: FittedModel, without: FittedModel, name: str, loss: float) -> Ledger:
    """With the set less the effect ``name``, which brings ``loss``, and the step that says so."""
    ledger = ledger.kept(without, ledger.score(fitted) + loss)
    sentence = f"{name} is no longer needed (it brings {loss:.1f})"
    return ledger.told(Step(without.names, ledger.score(without), without.fit.log_likelihood, sentence))


def fitted_without(ledger: Ledger, fitted: FittedModel, effect: Traceable, *, rough: bool = False) -> tuple[Ledger, FittedModel | None]:
    """A set without one of its effects, the better of two fits: the one that is kept, and one from the set's own values.

    The one kept from the way up may stand in a worse optimum.
    """
    rest = tuple(other for other in fitted.effects if other.name != effect.name)
    ledger, again = fit(ledger, rest, fitted, rough=rough)
    both = [known for known in (again, ledger.models.get(frozenset(other.name for other in rest))) if known is not None]
    return ledger, min(both, key=lambda known: known.fit.cost, default=None)


def refined(ledger: Ledger, fitted: FittedModel) -> tuple[Ledger, FittedModel]:
    """The same set fitted to the end, in its freer form where that brings enough; as it is where no channel is anywhere near noise.

    The declared model alone has been fitted to the end before the search.
    """
    if not fitted.effects or is_coloured_throughout(fitted, thresholds.GROSSLY_COLOURED):
        return ledger, fitted
    ledger, again = fit(ledger, fitted.effects, fitted)
    best = again if again is not None and again.fit.cost <= fitted.fit.cost + 1e-6 else fitted
    ledger, plain = in_plain_form(ledger, best)
    ledger = ledger.replaced(plain, ledger.score(fitted) - (fitted.criterion - plain.criterion))
    return freer_form(ledger, plain, least=0.0)


def freer_form(ledger: Ledger, fitted: FittedModel, least: float = thresholds.COLOURED) -> tuple[Ledger, FittedModel]:
    """The set with an effect in its freer form, of the same name, where that brings as much as an addition has to.

    Tried before anything is added to a set whose residual is not white (whose whiteness has a p-value below ``least``,
    always where that is zero): what a plain form leaves would be taken for a further effect.
    """
    if ledger.exhausted or (least > 0.0 and is_white(fitted, least)):
        return ledger, fitted
    best, score, accept = fitted, ledger.score(fitted), ledger.problem.settings.accept
    for position, effect in enumerate(fitted.effects):
        if not isinstance(effect, Refinable):
            continue
        ledger, finer = in_freer_form(ledger, best, position)
        if finer is not None and (brought := gain(best, finer, accept)) > accept:
            score -= brought
            ledger = ledger.told(Step(finer.names, score, finer.fit.log_likelihood, f"a freer form of {effect.name} brings {brought:.1f}"))
            best = finer
    if best is not fitted:
        ledger, plain = in_plain_form(ledger, best)
        score, best = score - (best.criterion - plain.criterion), plain
    if best is not fitted and not is_white(best):
        ledger = ledger.made_freer(fitted)
    return ledger.replaced(best, score), best
