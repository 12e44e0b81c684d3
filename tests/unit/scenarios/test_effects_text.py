"""Every effect that a search may use is the same one when it is read back."""

from __future__ import annotations

import json
from typing import Any

import pytest

from scenarios.stored_study import effect_content, effect_of
from sim.declaration.proposal import Refinable
from sim.effects.library import catch_all_terms_for, effects_for
from sim.errors import DeclarationError
from sim.vehicles.factory import FAMILIES

EFFECTS = [
    effect
    for equations, _, _ in FAMILIES.values()
    for effect in (*effects_for(equations), *catch_all_terms_for(equations))
]


def there_and_back(effect: Any) -> Any:
    return effect_of(json.loads(json.dumps(effect_content(effect))), (), "model.json")


def test_an_effect_is_made_again_as_it_was() -> None:
    tried = [
        each
        for effect in EFFECTS
        for each in ((effect, effect.finer()) if isinstance(effect, Refinable) else (effect,))
    ]
    assert len({effect.name for effect in tried}) > 60
    for effect in tried:
        again = there_and_back(effect)
        assert again == effect and (again.name, again.parameters) == (
            effect.name,
            effect.parameters,
        )


def test_a_users_effect_is_looked_for_in_the_users_file() -> None:
    own: Any = type("Own", (), {"name": "vane-upwash", "__module__": "my_effects"})()
    kept = effect_content(own)
    assert kept == {"name": "vane-upwash", "own": True}
    assert effect_of(kept, [own], "model.json") is own
    with pytest.raises(DeclarationError, match=r"vane-upwash is an effect of a file .* --effects"):
        effect_of(kept, (), "model.json")


@pytest.mark.parametrize(
    "of", ["os:system", "sim.effects.library:library", "sim.effects.nowhere:Effect"]
)
def test_nothing_but_an_effect_of_the_library_is_made(of: str) -> None:
    with pytest.raises(DeclarationError, match="run the study again"):
        effect_of({"name": "x", "class": of, "fields": {}}, (), "model.json")
