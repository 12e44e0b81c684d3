"""The page of effects, by station, one part for each family of instances."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable
from itertools import groupby
from typing import TYPE_CHECKING

from docs._ext.made.markdown import cell, code, paragraph, plain_block, table

if TYPE_CHECKING:
    from sim.declaration.effect import Effect

Families = dict[str, list["Effect"]]


def effects_page() -> str:
    """The library: what each effect is, where it acts, its parameters, and what a record does not tell it from."""  # noqa: E501
    from sim.declaration.effect import Station
    from sim.effects.library import library

    parts = [
        "# Effects\n",
        "Made from the library that `flightid diagnose` searches; `flightid effects NAME` prints one. Data flow from the recorded input over "  # noqa: E501
        "the input path, the dynamics with their disturbances, and the sensor path to the recorded output, and each effect has one station on "  # noqa: E501
        "that way. A name with a part behind a colon is an instance for one channel, input or load; [models](models.md) list those that may act "  # noqa: E501
        "on each. One of your own: [how](../how-to/own-effect.md).\n",
    ]
    families = by_family(library())
    rows = [
        [
            f"[`{name}`](#{name.lower()})",
            each[0].station.value,
            cell(first_sentence(each[0].explanation)),
        ]
        for name, each in families.items()
    ]
    parts.append(table(["effect", "acts on", "in one sentence"], rows))
    for station in Station:
        here = {name: each for name, each in families.items() if each[0].station is station}
        if here:
            parts.append(f"## {station.value.capitalize()}\n")
            parts += [part for name, each in here.items() for part in family_part(name, each)]
    parts += guards_part()
    return "\n".join(parts)


def by_family(effects: Iterable[Effect]) -> Families:
    """Effects by the part of their name before a colon, in their order."""
    found: Families = {}
    for effect in effects:
        found.setdefault(effect.name.partition(":")[0], []).append(effect)
    return found


def family_part(name: str, instances: list[Effect]) -> list[str]:
    """Heading, explanation, equation, parameters and aliases of one family."""
    first = instances[0]
    module = sys.modules[type(first).__module__]
    others = [effect.name for effect in instances if effect.name != name]
    aliases = list(dict.fromkeys(alias for effect in instances for alias in effect.aliases))
    names = list(dict.fromkeys(others))
    return [
        f"### {name}\n",
        paragraph(first.explanation) + "\n",
        plain_block(type(first).__doc__ or "")
        if "Attributes" not in (type(first).__doc__ or "")
        else "",
        parameters_table(instances),
        f"Absent when {', '.join(code(f'{key} = {value:g}') for key, value in first.absent.items())}; {cell(first.regularity.value)}.\n",  # noqa: E501
        f"Instances: {', '.join(map(code, names))}.\n" if names else "",
        f"Hard to tell from: {', '.join(map(code, aliases))}.\n" if aliases else "",
        f"Code: `{module.__name__.replace('.', '/')}.py`.\n",
    ]


def parameters_table(instances: list[Effect]) -> str:
    """Parameters of all instances of a family, each name once."""
    rows: dict[str, list[str]] = {}
    for effect in instances:
        plausible = getattr(getattr(effect, "traits", None), "plausible", {})
        for item in effect.parameters:
            low, high = item.bounds
            bounds = f"{low:g} to {high:g}" if math.isfinite(low) or math.isfinite(high) else ""
            believed = (
                "{:g} to {:g}".format(*plausible[item.name]) if item.name in plausible else ""
            )
            rows.setdefault(
                item.name, [code(item.name), cell(item.unit), f"{item.value:.3g}", bounds, believed]
            )
    return table(["parameter", "unit", "start", "bounds", "believed without asking"], rows.values())


def guards_part() -> list[str]:
    """Generic terms that compete with effects and are never claimed."""
    from sim.effects.library import catch_all_terms_for
    from sim.vehicles.factory import FAMILIES

    guards = {
        guard.name: guard
        for equations, _, _ in FAMILIES.values()
        for guard in catch_all_terms_for(equations)
    }
    families = groupby(
        sorted(guards.values(), key=lambda guard: guard.name),
        key=lambda guard: guard.name.split("(")[0],
    )
    rows = [
        [code(name), cell(first_sentence(next(iter(each)).explanation))] for name, each in families
    ]
    return [
        "## Guards\n",
        "Generic terms that compete like effects and are never claimed: where one wins, something is missing that the library does not name.\n",  # noqa: E501
        table(["guard", "in one sentence"], rows),
    ]


def first_sentence(text: str) -> str:
    return " ".join(text.split()).split(". ")[0].rstrip(".") + "."
