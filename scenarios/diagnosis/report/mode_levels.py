"""Levels of flying qualities before and after: an effect that was missing may have been told as a
level that the aircraft does not have.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ident.flying_qualities.levels import ModeLevel, mode_levels
from scenarios.diagnosis.report.declared_only import nothing_stands, shown_table
from scenarios.diagnosis.tracing import Tracing
from scenarios.report.document import MISSING, Cell, Column, Table, table
from scenarios.report.summary import (
    changes,
    level_text,
    levels_content,
    levels_heading,
    limit_text,
)

Levels = tuple[ModeLevel, ...]


def levels_of(tracing: Tracing) -> tuple[Levels, Levels]:
    """Levels under the declared model and under the one with the effects; empty where a model has
    no mode that the standard speaks of.
    """
    d = tracing.diagnosis
    before, after = (
        mode_levels(some, tracing.flown) if some is not None else ()
        for some in (d.modes_before, d.modes_after)
    )
    return before, after


def levels_title(tracing: Tracing) -> str:
    """Standard, class and category."""
    return levels_heading(tracing.flown)


def levels_table(tracing: Tracing, caption: str) -> Table:
    """Mode, level before and after, and the limit that the last of these models misses."""
    before, after = levels_of(tracing)
    old, new = ({level.mode: level for level in levels} for levels in (before, after))
    last = old if nothing_stands(tracing.diagnosis) else new
    modes = list({**old, **new})

    def levels(some: Mapping[str, ModeLevel]) -> list[Cell]:
        return [level_text(some[mode]) if mode in some else MISSING for mode in modes]

    whole = table(
        caption,
        (Column("mode"), modes),
        (Column("before"), levels(old)),
        (Column("after"), levels(new)),
        (Column("remarks"), [_missed(last.get(mode)) for mode in modes]),
    )
    return shown_table(tracing.diagnosis, whole)


def level_changes(tracing: Tracing) -> list[str]:
    """A sentence for each mode whose level the effects change, where these data tell both."""
    return changes(*levels_of(tracing))


def levels_both(tracing: Tracing) -> dict[str, Any]:
    """For ``diagnosis.json``; empty where the model has no mode that the standard speaks of."""
    before, after = levels_of(tracing)
    if not before and not after:
        return {}
    return {
        "flying_qualities": {
            "before": levels_content(before, tracing.flown),
            "after": levels_content(after, tracing.flown),
        }
    }


def _missed(level: ModeLevel | None) -> str:
    return limit_text(level) if level is not None else ""
