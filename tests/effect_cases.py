"""Effects and guards on the vehicles that carry them: what the laws of `tests/contracts` are held
against.
"""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from _pytest.mark.structures import ParameterSet

from sim.declaration.effect import Effect, full_name
from sim.declaration.model import Model
from sim.effects.library import catch_all_terms_for, library
from sim.record import Hold
from tests.offered import (
    VEHICLES,
    first_of_each_kind,
    guards_of_whole_axes,
    held_to_all_laws,
    made,
    representatives,
)

OFFERED = [
    (effect, vehicle.name) for vehicle in VEHICLES for effect in held_to_all_laws(vehicle)
] + representatives()


def cases_of(offered: Sequence[tuple[Effect, str]]) -> list[ParameterSet]:
    """A case of each effect on each vehicle; those beyond the first of a kind of effect are long
    ones.
    """
    first = {type(effect): place for place, (effect, _) in reversed([*enumerate(offered)])}
    return [
        pytest.param(
            effect,
            base,
            id=f"{effect.name} on {base}",
            marks=() if first[type(effect)] == place else pytest.mark.long,
        )
        for place, (effect, base) in enumerate(offered)
    ]


CASES = cases_of(OFFERED)
EFFECTS = [pytest.param(effect, id=effect.name) for effect in (*library(), *made())]
HOLDS = pytest.mark.parametrize("hold", list(Hold), ids=lambda hold: hold.value)
OFFERED_GUARDS = [
    (guard, vehicle.name) for vehicle in VEHICLES for guard in catch_all_terms_for(vehicle)
] + guards_of_whole_axes()
FLOWN_GUARDS = [
    each for each in OFFERED_GUARDS if each not in guards_of_whole_axes()
] + first_of_each_kind(guards_of_whole_axes())
GUARDS = cases_of(FLOWN_GUARDS)
every_case = pytest.mark.parametrize(("effect", "base"), CASES + GUARDS)
every_effect = pytest.mark.parametrize("effect", EFFECTS)


def typical(model: Model, effect: Effect) -> Model:
    """The model with the effect at its starting values, nudged off the edges of cells and
    samples.
    """
    nudged = {full_name(effect, item.name): item.value * 1.0137 for item in effect.parameters}
    return model.with_effects(effect).with_values(nudged)


def absent(model: Model, effect: Effect) -> Model:
    """The model with the effect present, at the values at which it vanishes."""
    return typical(model, effect).with_values(
        {full_name(effect, local): value for local, value in effect.absent.items()}
    )
