"""Effects that no record tells apart, since other values of the derivatives make up for the difference: the declared derivatives choose."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ident.statistics.information import inverse_information
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Quantity
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import screen
from ident.tracing.selection.expansion import only_beside_another
from ident.tracing.selection.ledger import Key
from sim.declaration.proposal import Traceable


def are_equivalent(fitted: FittedModel, gone: Key, come: Key) -> bool:
    """Whether a set and that with the names ``come`` in the place of ``gone`` explain any record alike."""
    return len(gone) == len(come) == 1 and any(come.issubset(effect.traits.equivalents) for effect in fitted.effects if effect.name in gone)


def same_by_value(effect: Traceable, found: Mapping[str, Quantity]) -> tuple[str, ...]:
    """Names of effects that an effect with these values is, too: under either the equations are the same."""
    known = ((found[local], other) for local, other in effect.traits.same_as.items() if local in found)
    return tuple(name for q, (name, least) in known if abs(q.value) > max(least, thresholds.CLEARLY_OFF_ABSENCE * q.std))


def told_by_declared(totals: Mapping[Key, float], models: Mapping[Key, FittedModel]) -> dict[Key, float]:
    """Criteria of sets, where the best has equivalents with what the declared derivatives say between it and them.

    ``totals`` holds all sets in ``models``. The set whose derivatives lie nearer to the declared ones has the total that the best had, the
    others lie above it by twice the logarithm of the odds; all other sets keep theirs.
    """
    best = min(totals, key=lambda key: totals[key])
    alike = [key for key in totals if key == best or (np.isfinite(totals[key]) and are_equivalent(models[best], best - key, key - best))]
    if len(alike) == 1 or not np.isfinite(totals[best]):
        return dict(totals)
    said = {key: totals[key] + misfit_to_declared(models[key]) for key in alike}
    least = min(said.values())
    return {**totals, **{key: totals[best] + value - least for key, value in said.items()}}


def guard_is_likelier(
    base: FittedModel,
    effect: Traceable,
    fitted: FittedModel,
    candidates: Sequence[Traceable],
    fit: Callable[[Traceable, Mapping[str, float]], FittedModel | None],
) -> bool:
    """Whether a guard that no record tells from an effect added to ``base`` explains the records with derivatives nearer to the declared ones.

    ``fitted`` is the base with the effect; ``fit`` adds another in its place, from starting values.
    """
    rivals = [candidate for candidate in candidates if only_beside_another(candidate) and candidate.name in effect.traits.equivalents]
    for finding in screen(base, rivals, search_context(base)) if rivals else ():
        other = fit(finding.effect, finding.starts[0])
        if other is not None and 2.0 * (other.fit.cost - fitted.fit.cost) < misfit_to_declared(fitted) - misfit_to_declared(other):
            return True
    return False


def misfit_to_declared(fitted: FittedModel) -> float:
    """d' (C + P)^-1 d of the free derivatives: d their distance from the declared values, C their covariance, P what these are believed to.

    The square of a distance in sigmas, ``thresholds.DECLARED_DERIVATIVES`` of each value being one. A value of zero says nothing.
    """
    layout, theta = fitted.fit.layout, fitted.fit.theta
    declared = {item.name: item.value for item in fitted.declared.parameters if item.free and item.value != 0.0}
    at = [i for i, name in enumerate(layout.shared) if name in declared]
    covariance, _ = inverse_information(fitted.fit.normal_equations()[0], theta)
    start = np.array([declared[layout.shared[i]] for i in at])
    believed = np.diag((thresholds.DECLARED_DERIVATIVES * start) ** 2)
    distance = theta[at] - start
    return float(distance @ np.linalg.solve(covariance[np.ix_(at, at)] + believed, distance))
