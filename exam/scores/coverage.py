"""How often the intervals of effects' parameters hold the truth, at one, two and three sigmas."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from exam.scores.rates import ALL, Scores
from exam.scoring import Share, share_within_flights

SIGMAS = (1, 2, 3)
NORMAL = tuple(100.0 * math.erf(k / math.sqrt(2.0)) for k in SIGMAS)  # % of a normal distribution


def coverage_of(scores: Scores) -> dict[str, tuple[Share, ...]]:
    """By label, and of all flights: the share of parameters of effects named right that are within
    one, two and three sigmas of the truth.

    Parameters of one flight are correlated: intervals count flights. Labels without a parameter are
    left out.
    """
    groups = {
        label: [each.errors.values() for each in group if each.errors]
        for label, group in scores.groups.items()
    }
    groups = {label: errors for label, errors in groups.items() if errors}
    if len(groups) > 1:
        groups[ALL] = [errors for group in groups.values() for errors in group]
    return {label: shares_of(errors) for label, errors in groups.items()}


def shares_of(errors: Sequence[Iterable[float]]) -> tuple[Share, ...]:
    """Of errors in sigmas, flight by flight, the shares within one, two and three."""
    flights = [[abs(value) for value in each] for each in errors]
    return tuple(
        share_within_flights([value < k for value in flight] for flight in flights) for k in SIGMAS
    )
