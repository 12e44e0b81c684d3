"""What the form of a curve, a mode or a gust is worth for the derivatives: the same cause in its
freer form may move them.
"""

from __future__ import annotations

import numpy as np

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.candidate_model.problem import TraceProblem
from sim.declaration.proposal import Refinable


def form_spread(problem: TraceProblem, fitted: FittedModel) -> dict[str, float]:
    """By how much the declared parameters move, beyond chance, where every effect of a set takes
    its freer form; empty where none has one.

    A derivative is a slope at trim, and the plain form of a curve is not the truth's: its sigma
    knows of noise alone. The move is taken beyond what the freer form's larger sigma explains:
    sqrt(max(0, move^2 - (sigma_freer^2 - sigma_plain^2))).
    """
    freer = tuple(
        effect.finer() if isinstance(effect, Refinable) else effect for effect in fitted.effects
    )
    if freer == fitted.effects or has_process_noise(fitted.system):
        return {}
    other = problem.fit(freer, fitted)
    if other is None or other.fit.cost > fitted.fit.cost:
        return {}
    plain, free = fitted.estimate, other.estimate
    spread = {}
    for name in plain.names:
        if name in problem.model.parameters and name in free.names:
            chance = max(0.0, free.sigma(name) ** 2 - plain.sigma(name) ** 2)
            spread[name] = float(
                np.sqrt(max(0.0, (free.value(name) - plain.value(name)) ** 2 - chance))
            )
    return {name: value for name, value in spread.items() if np.isfinite(value)}
