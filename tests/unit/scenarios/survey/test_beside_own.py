"""Effects that single flights claim: they stay where they are needed beside what recurs, and go
where a flight named one thing for two.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from scenarios.survey.recurring import recurring_with_other_effects
from tests.unit.scenarios.survey.made_up import Flown, flown, kept

SHARED = ("delay", "arm")
COUNT = 10


def with_own(flight: Flown, own: np.ndarray) -> dict[str, Any]:
    """A flight's fits with an effect of its own beside every set, and without it."""
    without = flight.fits()
    beside = Flown(flight.y, np.column_stack([flight.design, own]), flight.effects).fits()
    return {**without, "sets": beside["sets"], "sets_without": without["sets"], "own": ["lag"]}


def fleet(seed: int) -> tuple[list[Flown], np.random.Generator]:
    rng = np.random.default_rng(seed)
    flights = []
    for _ in range(COUNT):
        effects = {name: rng.standard_normal((60, 1)) for name in SHARED}
        flights.append(flown(rng, effects, {"delay": [1.0], "arm": [0.8]}))
    return flights, rng


def test_one_name_for_two_effects_goes() -> None:
    """A flight's own effect that looks like both shared ones at once takes from either, and would
    spoil what all flights say.
    """
    flights, rng = fleet(1)
    fits = [each.fits() for each in flights]
    both = (
        flights[3].effects["delay"]
        + 0.8 * flights[3].effects["arm"]
        + 0.1 * rng.standard_normal((60, 1))
    )
    plain, _, _ = recurring_with_other_effects(
        SHARED, tuple(kept([{}] * COUNT)), fits, kept([{}] * COUNT)
    )
    spoilt = [*fits[:3], with_own(flights[3], both), *fits[4:]]
    claims: list[dict[str, list[str]]] = [{}, {}, {}, {"lag": []}, *([{}] * (COUNT - 4))]
    found, sets, taken = recurring_with_other_effects(
        SHARED, tuple(kept(claims)), spoilt, kept(claims)
    )
    assert taken[3]["sets"] is spoilt[3]["sets_without"]
    assert sets == [frozenset(SHARED)] * COUNT
    for each, same in zip(found, plain, strict=True):
        assert each.recurrence.value == pytest.approx(same.recurrence.value)


def test_an_effect_that_acts_in_one_flight_stays() -> None:
    flights, rng = fleet(2)
    gust = rng.standard_normal((60, 1))
    gusty = Flown(flights[3].y + 1.5 * gust[:, 0], flights[3].design, flights[3].effects)
    fits = [each.fits() for each in flights]
    fits[3] = with_own(gusty, gust)
    claims: list[dict[str, list[str]]] = [{}, {}, {}, {"lag": []}, *([{}] * (COUNT - 4))]
    found, _, taken = recurring_with_other_effects(SHARED, tuple(kept(claims)), fits, kept(claims))
    assert taken[3]["sets"] is fits[3]["sets"]
    for each, true in zip(sorted(found, key=lambda each: each.name), (0.8, 1.0), strict=True):
        assert abs(each.recurrence.value[0] - true) < 4.0 * np.sqrt(
            each.recurrence.covariance[0, 0]
        )
