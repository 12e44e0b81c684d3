"""When events begin and how long they last: local optima of a fit, and how it gets out of them."""

from __future__ import annotations

from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel, is_event
from ident.tracing.selection.criterion import is_white
from ident.tracing.selection.ledger import Ledger, fit
from sim.declaration.effect import full_name
from sim.declaration.proposal import Edged, Refinable, Traceable


def placed_better(ledger: Ledger, child: FittedModel, effect: Traceable) -> tuple[Ledger, FittedModel]:
    """An event moved a little to both sides: its time has local optima where the motion has died out.

    One with edges that an output feels in single samples is moved with wide edges first, which are then made narrow.
    """
    at = _value(child, effect, effect.traits.onset)
    if at is None:
        return ledger, child
    name = full_name(effect, effect.traits.onset)
    if isinstance(effect, Edged):
        return _with_wide_edges(ledger, child, effect, name, at)
    for shift in thresholds.EVENT_SHIFTS:
        ledger, moved = fit(ledger, child.effects, child, {name: at + shift}, rough=True)
        if moved is not None and moved.fit.cost < child.fit.cost - thresholds.BETTER_PLACE:
            child = moved
    return ledger, child


def in_freer_form(ledger: Ledger, fitted: FittedModel, position: int) -> tuple[Ledger, FittedModel | None]:
    """The set with the effect at ``position`` in its freer form; None where it has none, or the fit found no finite cost.

    A plain course of the wrong form lies beyond the ends of what it stands for. Where that of an event leaves more than noise, its ends are
    moved inwards and outwards from those of the plain one.
    """
    effect = fitted.effects[position]
    if not isinstance(effect, Refinable):
        return ledger, None
    finer = effect.finer()
    effects = (*fitted.effects[:position], finer, *fitted.effects[position + 1 :])
    ledger, best = fit(ledger.knows_plain(effect, finer), effects, fitted)
    begin, lasts = (_value(fitted, effect, name) for name in (effect.traits.onset, effect.traits.lasts))
    if best is None or begin is None or lasts is None or is_white(best):
        return ledger, best
    for ahead, behind in thresholds.ENDS_MOVED:
        moved = {effect.traits.onset: begin + ahead * lasts, effect.traits.lasts: (1.0 - ahead - behind) * lasts}
        ledger, again = fit(ledger, effects, fitted, {full_name(effect, name): value for name, value in moved.items()})
        if again is not None and again.fit.cost < best.fit.cost - thresholds.BETTER_PLACE:
            best = again
    return ledger, best


def _with_wide_edges(ledger: Ledger, child: FittedModel, effect: Traceable, name: str, at: float) -> tuple[Ledger, FittedModel]:
    assert isinstance(effect, Edged)
    best: FittedModel | None = None
    wide, *narrower = (effect.blunted(times) for times in thresholds.EDGES_WIDENED)
    for shift in (0.0, *thresholds.EVENT_SHIFTS):
        ledger, moved = fit(ledger, _in_place(child, wide), child, {name: at + shift}, rough=True)
        if moved is not None and (best is None or moved.fit.cost < best.fit.cost):
            best = moved
    for form in (*narrower, effect):
        if best is not None:
            ledger, best = fit(ledger, _in_place(child, form), best, rough=True)
    return ledger, best if best is not None and best.fit.cost < child.fit.cost - thresholds.BETTER_PLACE else child


def _in_place(fitted: FittedModel, effect: Traceable) -> tuple[Traceable, ...]:
    """The effects of a set with one in the place of that of its name."""
    return tuple(effect if other.name == effect.name else other for other in fitted.effects)


def _value(fitted: FittedModel, effect: Traceable, local: str) -> float | None:
    """An event's own parameter in the first record; None where it is no event or has none."""
    if not local or not is_event(effect):
        return None
    name, values = full_name(effect, local), fitted.values
    return values.own[0].get(name, values.shared.get(name))
