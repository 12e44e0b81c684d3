"""Forward selection as a user with SciPy would write it: the term that lowers the squared error
most, while its partial F ratio is above 20.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import lstsq

from benchmarks.peers.least_squares import answer_of
from benchmarks.peers.short_period import Problem

F_IN = 20.0


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    columns = problem["columns"]

    def error(row: np.ndarray, at: list[int]) -> float:
        values = lstsq(columns[:, at], row)[0]
        return float(np.sum((row - columns[:, at] @ values) ** 2))

    def forward(row: np.ndarray) -> list[int]:
        chosen = [0]
        best = error(row, chosen)
        while len(chosen) < columns.shape[1]:
            left = [i for i in range(columns.shape[1]) if i not in chosen]
            errors = [error(row, [*chosen, i]) for i in left]
            least = min(errors)
            if (best - least) / (least / (len(row) - len(chosen) - 1)) < F_IN:
                break
            chosen.append(left[errors.index(least)])
            best = least
        return chosen

    return lambda: answer_of(problem, [forward(row) for row in problem["coefficients"]])
