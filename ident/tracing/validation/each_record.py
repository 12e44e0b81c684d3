"""What each fitted record by itself says of an effect, all else in common: one Gauss-Newton
step.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ident.statistics.intervals import add_normal_equations, inverse_information
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Quantity
from sim.declaration.effect import NoiseEffect, full_name
from sim.declaration.proposal import Traceable


def of_each_record(fitted: FittedModel, effect: Traceable) -> tuple[Mapping[str, Quantity], ...]:
    """An effect's shared parameters as each record has them, by local name.

    Each record gets its own value of them; the derivatives and all other effects stay in common.

    Returns
    -------
    One mapping a record, with sigmas; empty with one record, of process noise, and where the
    effect has no parameter that the records share.
    """
    fit, layout = fitted.fit, fitted.fit.layout
    count, names = len(layout.problems), list(layout.names)
    items = [item for item in effect.parameters if full_name(effect, item.name) in layout.shared]
    if count < 2 or not items or isinstance(effect, NoiseEffect):
        return ()
    at = [names.index(full_name(effect, item.name)) for item in items]
    size, k = len(fit.theta), len(at)
    normal, gradient = np.zeros((size + count * k,) * 2), np.zeros(size + count * k)
    for r, problem in enumerate(layout.problems):
        own = {position: size + r * k + place for place, position in enumerate(at)}
        columns = np.array([own.get(int(c), int(c)) for c in np.arange(size)[layout.columns(r)]])
        weight = np.where(problem.valid, 1.0 / fit.variance[:, None], 0.0)
        add_normal_equations(normal, gradient, columns, fit.jacobians[r], fit.residuals[r], weight)
    kept = np.array([i for i in range(len(normal)) if i not in at])
    start = np.concatenate([fit.theta, np.tile(fit.theta[at], count)])[kept]
    covariance, _ = inverse_information(normal[np.ix_(kept, kept)], start)
    step = covariance @ gradient[kept]
    first = len(kept) - count * k
    found = []
    for r in range(count):
        mine = first + r * k + np.arange(k)
        sigma = np.sqrt(np.maximum(np.diag(covariance)[mine], 1e-300))
        values = start[mine] + step[mine]
        found.append(
            {
                item.name: Quantity(float(value), float(std), item.unit)
                for item, value, std in zip(items, values, sigma, strict=True)
            }
        )
    return tuple(found)
