"""Events at a time: an edge that rises over a short fixed width, so that everything is smooth in the time."""

from __future__ import annotations

import math
from typing import Any

from sim.maths.elementary import clip, once_for_alike

WIDTH = 0.01  # s, one usual sub-step
SLOW_WIDTH = 0.1  # s, for bodies that are tracked over minutes


def risen(time: Any, at: Any, width: float) -> Any:
    """0 before the event at time ``at``, 1 after it, a straight ramp of ``width`` s centred on it between.

    Integrated in sub-steps of which ``width`` is a whole multiple, its area does not depend on how ``at`` lies between them.
    """
    return once_for_alike(lambda at: clip((time - at) / width + 0.5, 0.0, 1.0), at)


def edge_width(interval: float, usual: float = WIDTH) -> float:
    """The whole fraction of a sampling interval that is nearest below ``usual``: the sub-step of a fit that steps by at most that."""
    return interval / max(1, math.ceil(interval / usual - 1e-6)) if interval > 0 else usual
