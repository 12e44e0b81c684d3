"""Levels of flying qualities before and after: an effect that was missing may have been told as a level that the aircraft does not have."""

from __future__ import annotations

from typing import Any

from ident.flying_qualities.mode_levels import ModeLevel, mode_levels
from scenarios.diagnosis.diagnose import Tracing
from scenarios.terminal.flying_qualities import changes, level_sentence, levels_content, levels_heading

LEVEL_HEADINGS = ("before", "after")
Levels = tuple[ModeLevel, ...]


def levels_of(tracing: Tracing) -> tuple[Levels, Levels]:
    """Levels under the declared model and under the one with the effects; empty where a model has no mode that the standard speaks of."""
    d = tracing.diagnosis
    before, after = (mode_levels(some, tracing.flown) if some is not None else () for some in (d.modes_before, d.modes_after))
    return before, after


def levels_title(tracing: Tracing) -> str:
    """Standard, class and category."""
    return levels_heading(tracing.flown)


def level_rows(tracing: Tracing) -> list[tuple[str, ...]]:
    """Mode, level before and after with what keeps it from the next better one."""
    before, after = levels_of(tracing)
    old, new = ({level.mode: _told(level) for level in levels} for levels in (before, after))
    return [(mode, old.get(mode, "-"), new.get(mode, "-")) for mode in {**old, **new}]


def level_changes(tracing: Tracing) -> list[str]:
    """A sentence for each mode whose level the effects change, where these data tell both."""
    return changes(*levels_of(tracing))


def levels_both(tracing: Tracing) -> dict[str, Any]:
    """For ``diagnosis.json``; empty where the model has no mode that the standard speaks of."""
    before, after = levels_of(tracing)
    if not before and not after:
        return {}
    return {"flying_qualities": {"before": levels_content(before, tracing.flown), "after": levels_content(after, tracing.flown)}}


def _told(level: ModeLevel) -> str:
    return level_sentence(level).removeprefix(f"{level.mode} ")
