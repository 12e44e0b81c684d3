"""What a derivative and an effect that has ruined it come to at rest, which the records know where neither is known alone.

A mode that is at rest bends by the control and the angle of attack: Cm_de + moment keeps its value whatever the two of them are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Quantity
from ident.whole_record.output_error import fit_covariance
from sim.declaration.effect import full_name


def static_total(fitted: FittedModel, derivative: str, covariance: np.ndarray) -> tuple[str, Quantity] | None:
    """A derivative with what the set's effects add to it at rest: the sum in words and its value; None where no effect adds anything.

    The sigma is that of the sum, to first order, from the covariance ``(n, n)`` of all unknowns.
    """
    names, theta = fitted.fit.layout.names, fitted.fit.theta
    if derivative not in names:
        return None
    slope, value, words = np.zeros(len(theta)), float(theta[names.index(derivative)]), [derivative]
    slope[names.index(derivative)] = 1.0
    for effect in fitted.effects:
        factors = [full_name(effect, local) for local in effect.traits.static_parts.get(derivative, ())]
        if not factors or not all(name in names for name in factors):
            continue
        values = [float(theta[names.index(name)]) for name in factors]
        value += float(np.prod(values))
        for i, name in enumerate(factors):
            slope[names.index(name)] += float(np.prod(values[:i] + values[i + 1 :]))
        words.append(f"{' '.join(effect.traits.static_parts[derivative])} of {effect.name}")
    if len(words) == 1:
        return None
    unit = fitted.declared.parameters[derivative].unit
    return " + ".join(words), Quantity(value, float(np.sqrt(max(slope @ covariance @ slope, 1e-300))), unit)


def told_totals(fitted: FittedModel, derivatives: Sequence[str]) -> str:
    """The same of several derivatives in words, empty where there is nothing to say."""
    if not derivatives:
        return ""
    covariance, _ = fit_covariance(fitted.fit)
    totals = [total for name in derivatives if (total := static_total(fitted, name, covariance)) is not None]
    return "; ".join(f"{words} keep {q.value:.3g} +- {q.std:.2g}" for words, q in totals)
