"""Which effects may recur, from the flights' own diagnoses, and which belong to a flight by nature."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

FEWEST_NAMED = 2  # flights that claim an effect or name it as an alternative, from which it may recur
MOST = 5  # effects that are tried together: 32 sets a flight

Kept = Mapping[str, Mapping[str, Any]]


def candidates(kept: Kept) -> tuple[str, ...]:
    """Effects that may recur, the most often named first: claimed somewhere, and named in two flights at least."""
    claimed: Counter[str] = Counter()
    named: Counter[str] = Counter()
    for flight in kept.values():
        names = {name for each in flight["effects"] for name in (each["name"], *each["alternatives"])}
        named.update(names)
        claimed.update({name for each in flight["effects"] if each["claimed"] for name in (each["name"], *each["alternatives"])})
    # Two flights that name different things may mean one: what is named anywhere beside a recurring name is tried as its rival.
    wanted = [name for name in named if named[name] >= FEWEST_NAMED and claimed[name] and not is_of_flight(name)]
    return tuple(sorted(wanted, key=lambda name: (-claimed[name], -named[name], name))[:MOST])


def is_of_flight(name: str) -> bool:
    """Whether an effect belongs to one flight by its nature: an event, a drift, rough air."""
    from sim.effects.library import library

    traits = {effect.name: effect.traits for effect in library() if hasattr(effect, "traits")}
    mine = traits.get(name)
    return mine is not None and (mine.per_record or bool(mine.onset) or mine.background or bool(mine.wrong_samples_of))


def own_effects(flight: Mapping[str, Any], shared: Sequence[str]) -> dict[str, dict[str, float]]:
    """Effects that a flight claims and that are its own, with their values by full name."""
    rivals = {name for each in flight["effects"] if each["name"] in shared for name in each["alternatives"]}
    mine = [e for e in flight["effects"] if e["claimed"] and e["name"] not in shared and e["name"] not in rivals]
    return {e["name"]: {f"{e['name']}.{local}": q["value"] for local, q in e["parameters"].items()} for e in mine}


def starts_of(kept: Kept, names: Sequence[str]) -> dict[str, float]:
    """Where each effect's parameters begin: the median over the flights that name it."""
    seen: dict[str, list[float]] = {}
    for flight in kept.values():
        for each in flight["effects"]:
            if each["name"] in names:
                for local, q in each["parameters"].items():
                    seen.setdefault(f"{each['name']}.{local}", []).append(q["value"])
    return {name: float(np.median(values)) for name, values in seen.items()}
