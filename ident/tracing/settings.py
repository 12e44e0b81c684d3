"""What a caller of the tracing loop may set, each number with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TraceSettings:
    """Settings of the loop.

    Attributes
    ----------
    max_step : longest integration sub-step, s.
    depth : most effects in a set.
    budget : fits of one search: a residual that defies the library must not take for ever.
    effort : what these settings are called, one of ``EFFORTS``.
    """

    max_step: float = 0.01
    depth: int = 3
    budget: int = 40
    effort: str = "normal"


NORMAL = TraceSettings()
THOROUGH = TraceSettings(depth=4, budget=10 * NORMAL.budget, effort="thorough")
EFFORTS = {settings.effort: settings for settings in (NORMAL, THOROUGH)}
