"""All that an random case may hide, by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from exam.random_cases.case import Kind
from exam.random_cases.effects import EFFECTS
from exam.random_cases.falling_body import FALLING
from exam.random_cases.foreign import FOREIGN
from exam.random_cases.recorder import RECORDER

KINDS: Mapping[str, Kind] = {**EFFECTS, **FALLING, **FOREIGN, **RECORDER}


def drawable(group: str, model: str, channels: Sequence[str]) -> list[str]:
    """Names of a group's kinds that can be hidden in a model's record of these channels and be seen
    there, in their order.
    """
    return [
        name
        for name, kind in KINDS.items()
        if kind.group == group and model in kind.models and set(kind.channels) <= set(channels)
    ]


def families(names: Sequence[str]) -> dict[str, list[str]]:
    """Names by what stands before the colon: one fault on several channels is one family."""
    found: dict[str, list[str]] = {}
    for name in names:
        found.setdefault(name.partition(":")[0], []).append(name)
    return found
