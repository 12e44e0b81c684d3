"""Plain least squares of chosen columns, which ends every selection of terms alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

Problem = Mapping[str, np.ndarray]


def answer_of(problem: Problem, chosen: Sequence[Sequence[int]]) -> dict[str, np.ndarray]:
    """Factors of all columns and their sigmas, coefficient by coefficient; zero what is not chosen.

    Parameters
    ----------
    problem : ``columns (N, k)``, ``coefficients (m, N)``, ``noise (1,)``. chosen : positions of the
        columns of each coefficient.
    """
    columns, rows = problem["columns"], problem["coefficients"]
    values = np.zeros((len(rows), columns.shape[1]))
    sigma = np.full(values.shape, float(problem["noise"][0]) / np.sqrt(len(columns)))
    for i, (row, at) in enumerate(zip(rows, chosen, strict=True)):
        part = columns[:, list(at)]
        values[i, list(at)] = np.linalg.solve(part.T @ part, part.T @ row)
        spread = np.linalg.inv(part.T @ part)
        sigma[i, list(at)] = float(problem["noise"][0]) * np.sqrt(np.diag(spread))
    return {"estimate": values.ravel(), "estimate_std": sigma.ravel()}
