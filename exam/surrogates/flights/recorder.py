"""The filter of the recorder on an input."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from exam.hidden_terms.anti_alias_filter import AntiAliasFilter
from exam.surrogates.flights.drawing import Drawn
from exam.surrogates.flights.maneuvers import Table
from sim.propagation import make_grid


@dataclass(frozen=True)
class _Corner:
    corner: float


def recorded(drawn: Drawn, name: str, time: np.ndarray, step: float, maneuver: Table) -> np.ndarray:
    """Return an input at ``time (N,)``, s, behind its filter, without zero and noise; ``step`` is
    that of the filter's grid, s.
    """
    if not drawn.corners:
        return maneuver(time)
    grid = make_grid(time, step)
    begin, end = maneuver(grid.edges), maneuver.before(grid.edges[1:])
    filtered, _ = AntiAliasFilter(name).act(grid.steps, begin, end, _Corner(drawn.corners[name]))
    return np.asarray(filtered)[grid.sample]
