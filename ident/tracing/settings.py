"""What a caller of the tracing loop may set, each number with its reason; the others are in ``thresholds``."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TraceSettings:
    """Settings of the loop.

    Attributes
    ----------
    max_step : longest integration sub-step, s.
    accept : an addition must lower the criterion (twice the cost, plus ``k ln N``, plus ``event`` for each event) by this
        much: on simulated nulls the best of all candidates stays far below it.
    event : what a position searched over the record costs, in units of twice the log likelihood.
    beam : sets kept from one round to the next. depth : most effects in a set.
    tried : names fitted in full at each set. starts : starting points of each.
    budget : most work of a search, in small fits: a residual that defies the library must not take for ever.
    near : sets within this of the best are compared with it, also on data that were not fitted where these take part in choosing; within
        ``wide`` where those data doubt the best.
    white : smallest p-value of a residual test that still counts as noise, after so many tests.
    effort : what these settings are called, one of ``EFFORTS``.
    """

    max_step: float = 0.01
    accept: float = 10.0
    event: float = 9.0
    beam: int = 2
    depth: int = 3
    tried: int = 6
    starts: int = 2
    budget: float = 140.0
    near: float = 15.0
    wide: float = 60.0
    white: float = 1e-4
    effort: str = "normal"


NORMAL = TraceSettings()
# Chosen: of three causes, with turbulence in the place of the third, only sets of four show the third; more means or a wider beam do not.
# 12 names and 3 starts a set double the time and find no more.
THOROUGH = TraceSettings(beam=3, depth=4, budget=10.0 * NORMAL.budget, effort="thorough")
EFFORTS = {settings.effort: settings for settings in (NORMAL, THOROUGH)}
