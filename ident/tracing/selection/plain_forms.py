"""Back from freer forms to plain ones: a form made freer too soon has bent to what was still missing, or has only led to a better optimum."""

from __future__ import annotations

from ident.tracing.candidate_model.fitted_model import FittedModel, free_names
from ident.tracing.selection.ledger import Ledger, fit


def child_in_plain_form(ledger: Ledger, parent: FittedModel, child: FittedModel) -> tuple[Ledger, FittedModel]:
    """A child, one effect more than its parent, with the plain forms of that one where these have the lower criterion."""
    plain = ledger.plain.get(frozenset(parent.names))
    if plain is None:
        return ledger, child
    effect, values = child.effects[-1], child.values
    added = {name: value for known in (values.shared, values.own[0]) for name, value in known.items() if name in free_names(effect)}
    ledger, again = fit(ledger, (*plain.effects, effect), plain, added, rough=True)
    return ledger, again if again is not None and again.criterion < child.criterion else child


def in_plain_form(ledger: Ledger, fitted: FittedModel) -> tuple[Ledger, FittedModel]:
    """A set with the plain forms of its effects, fitted from its own values, where these have the lower criterion."""
    plain = tuple(ledger.plain_form(effect) for effect in fitted.effects)
    if all(one is other for one, other in zip(plain, fitted.effects, strict=True)):
        return ledger, fitted
    ledger, again = fit(ledger, plain, fitted)
    return ledger, again if again is not None and again.criterion < fitted.criterion else fitted
