"""Effects and guards on the vehicles that carry them: what the laws of `tests/contracts` are held
against.
"""

from __future__ import annotations

import pytest

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
CASES = [pytest.param(effect, base, id=f"{effect.name} on {base}") for effect, base in OFFERED]
EFFECTS = [pytest.param(effect, id=effect.name) for effect in (*library(), *made())]
HOLDS = pytest.mark.parametrize("hold", list(Hold), ids=lambda hold: hold.value)
OFFERED_GUARDS = [
    (guard, vehicle.name) for vehicle in VEHICLES for guard in catch_all_terms_for(vehicle)
] + guards_of_whole_axes()
FLOWN_GUARDS = [
    each for each in OFFERED_GUARDS if each not in guards_of_whole_axes()
] + first_of_each_kind(guards_of_whole_axes())
GUARDS = [pytest.param(guard, base, id=f"{guard.name} on {base}") for guard, base in FLOWN_GUARDS]
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
