"""An effect's parameters in a fitted model: values with corrected sigmas, and the records they act
on.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ident.statistics.intervals import inverse_information
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Quantity
from sim.declaration.effect import full_name
from sim.declaration.proposal import Traceable

OFF_ABSENCE = 4.0  # sigmas, beyond which an effect acts in a record: one in 16,000 by chance


def quantities(fitted: FittedModel, effect: Traceable) -> dict[str, Quantity]:
    """An effect's free parameters in a fitted model, by local name; of the record in which it
    stands out most where each has its own.
    """
    return max(
        _quantities_by_record(fitted, effect), key=lambda found: sigmas_from_absence(effect, found)
    )


def records_of(fitted: FittedModel, effect: Traceable) -> tuple[int, ...]:
    """Numbers, from 0, of the records that an effect with parameters of its own for each acts on;
    empty where it acts on all.
    """
    each = _quantities_by_record(fitted, effect)
    seen = tuple(
        r for r, found in enumerate(each) if sigmas_from_absence(effect, found) > OFF_ABSENCE
    )
    return seen if 0 < len(seen) < len(each) else ()


def _quantities_by_record(fitted: FittedModel, effect: Traceable) -> list[dict[str, Quantity]]:
    """The same for every record; alike where the parameters are shared."""
    normal, _ = fitted.fit.normal_equations()
    covariance, _ = inverse_information(normal, fitted.fit.theta)
    return quantities_with(fitted, effect, covariance)


def quantities_with(
    fitted: FittedModel, effect: Traceable, covariance: np.ndarray
) -> list[dict[str, Quantity]]:
    """An effect's parameters in each record of a fitted model, with sigmas from a covariance ``(n,
    n)`` of all unknowns.
    """
    places = {name: i for i, name in enumerate(fitted.fit.layout.names)}
    out: list[dict[str, Quantity]] = []
    for r in range(len(fitted.fit.layout.problems)):
        found = {}
        for item in effect.parameters:
            full = full_name(effect, item.name)
            at = places.get(full, places.get(f"{full}, record {r + 1}"))
            if at is not None:
                found[item.name] = Quantity(
                    float(fitted.fit.theta[at]),
                    float(np.sqrt(max(covariance[at, at], 1e-300))),
                    item.unit,
                )
        out.append(found)
    return out


def sigmas_from_absence(effect: Traceable, found: Mapping[str, Quantity]) -> float:
    """By how many standard deviations an effect's parameters differ from its absence, at most;
    infinite where none could.
    """
    known = [
        abs(found[local].value - value) / found[local].std
        for local, value in effect.absent.items()
        if local in found
    ]
    return max(known, default=np.inf)
