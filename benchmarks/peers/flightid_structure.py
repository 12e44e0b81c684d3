"""flightid's stepwise regression."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.peers.least_squares import answer_of
from benchmarks.peers.short_period import Problem
from ident.structure.products import products_of
from ident.structure.selection import stepwise
from sim.aerodynamics import Factor, Term


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    columns, maneuver = problem["columns"], problem["maneuver"]
    terms = [Term(), *(Term((Factor(f"x{i}"),)) for i in range(1, columns.shape[1]))]
    parts = [maneuver == number for number in range(int(maneuver[-1]) + 1)]

    def work() -> dict[str, np.ndarray]:
        blocks = [columns[at] for at in parts]
        chosen = []
        for row in problem["coefficients"]:
            products = products_of(blocks, [row[at] for at in parts], terms)
            chosen.append(stepwise(products)[0])
        return answer_of(problem, chosen)

    return work
