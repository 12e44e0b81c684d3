"""A series of papers, from a first seed on: examined as tasks, and the line that is written of each."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

from scenarios.tasks.manner import Manner
from scenarios.terminal.progress import progress_bar
from scenarios.trials.calibration import as_line
from scenarios.trials.papers.examination import examine
from scenarios.trials.papers.paper import Mark
from scenarios.trials.repeated import Flown, LoopFlights, fly_all


def examined(first: int, count: int, manner: Manner) -> Flown:
    """Marks of the papers ``first`` to ``first + count - 1``, of those that had ended where it was stopped."""
    with progress_bar(True) as tell:
        return fly_all(LoopFlights("papers", partial(_paper, first), Mark, {"first": first}), count, first, manner, tell)


def _paper(first: int, number: int, seed: int) -> Mark:
    """A paper has its own small seed, by which documents name it, and takes none that is spawned."""
    return examine(first + number)


def line_of(mark: Mark) -> Mapping[str, Any]:
    """What one line of the file holds; a number that is not finite is left out."""
    paper = mark.paper
    return {
        **{"seed": paper.seed, "model": paper.model, "aircraft": paper.aircraft, "rate": paper.rate, "channels": paper.channels},
        **{"group": paper.group, "hidden": paper.hidden, "values": mark.values, "verdict": mark.verdict},
        "claims": [[{"name": named.name, "hidden": named.hidden} for named in claim] for claim in mark.claims],
        "statements": [as_line(statement) for statement in mark.statements],
        **{"right": mark.right, "wrong": mark.wrong, "said": mark.said},
        "held_out_error": mark.held_out if math.isfinite(mark.held_out) else -1.0,
        "errors_in_sigmas": {name: error for name, error in mark.errors.items() if math.isfinite(error)},
        "seconds": mark.seconds,
    }
