"""What a vehicle file lays down about its parameters, in a diagnosis: said, and no sigma where a
bound has taken its place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from ident.tracing.diagnosis import Diagnosis, Quantity
from scenarios.files.user_models import Constraints, constraint_sentences, side_at
from sim.declaration.model import Model


def said_of(constraints: Constraints, model: Model) -> tuple[str, ...]:
    """A sentence each on what is held, tied and bounded."""
    items = model.parameters
    return constraint_sentences(
        constraints,
        {item.name: item.value for item in items},
        {item.name: item.unit for item in items},
    )


def at_bounds(diagnosis: Diagnosis, constraints: Constraints) -> tuple[Diagnosis, tuple[str, ...]]:
    """The diagnosis with a sigma of zero, which is printed as a bound, for each parameter that
    ended at one; a sentence on each.
    """
    before, after = (
        _pressed(side, constraints.bounds) for side in (diagnosis.before, diagnosis.after)
    )
    told = []
    for name in dict.fromkeys([*before, *after]):
        sides = [
            word
            for word, names in (("with the declared model", before), ("with what was found", after))
            if name in names
        ]
        value = (diagnosis.before if name in before else diagnosis.after)[name].value
        told.append(f"{name} is at its bound {value:g}, {' and '.join(sides)}: it has no sigma")
    if not told:
        return diagnosis, ()
    return replace(
        diagnosis, before=_held(diagnosis.before, before), after=_held(diagnosis.after, after)
    ), tuple(told)


def _pressed(
    values: Mapping[str, Quantity], bounds: Mapping[str, tuple[float, float]]
) -> list[str]:
    return [
        name
        for name, pair in bounds.items()
        if name in values and side_at(values[name].value, pair)
    ]


def _held(values: Mapping[str, Quantity], names: list[str]) -> dict[str, Quantity]:
    return {
        name: replace(each, std=0.0) if name in names else each for name, each in values.items()
    }
