"""Which effects recur beside those that single flights claim, each of which has to be needed there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from scenarios.survey.candidates import Kept
from scenarios.survey.recurring import Recurring, recurring

NEEDED = 10.0  # twice the log likelihood, of a flight's own effect beside those that recur. chosen, as in a diagnosis
ROUNDS = 4  # of asking flights for their own effects again; far more than it takes


def recurring_beside_own(
    names: Sequence[str], flights: Sequence[str], fits: Sequence[Mapping[str, Any]], kept: Kept
) -> tuple[list[Recurring], list[frozenset[str]], list[Mapping[str, Any]]]:
    """As ``recurring``, where a flight's own effects have to be needed beside what recurs; with the fits that were taken of each flight.

    A flight alone may name one effect for two that recur, and would then say wrong values of both. Its own effects go where without them, with
    whatever it has of what recurs, it is not clearly less likely; then all flights are asked again.
    """
    left = (False,) * len(fits)
    for _ in range(ROUNDS):
        now = [{**each, "sets": each["sets_without"]} if without else each for each, without in zip(fits, left, strict=True)]
        found, sets = recurring(names, flights, now, kept)
        taken = frozenset(each.name for each in found)
        before, left = left, tuple(_needless(each, taken) for each in fits)
        if left == before:
            break
    return found, sets, now


def _needless(fitted: Mapping[str, Any], taken: frozenset[str]) -> bool:
    """Whether a flight's own effects are not needed beside the effects ``taken``, of which it may have any."""

    def most(sets: Mapping[str, Any]) -> float:
        return max((each["log_likelihood"] for key, each in sets.items() if frozenset(filter(None, key.split("+"))) <= taken), default=-np.inf)

    return "sets_without" in fitted and 2.0 * (most(fitted["sets"]) - most(fitted["sets_without"])) < NEEDED
