"""A common value of estimates from many flights, with the scatter between flights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, stdtrit

CERTAIN = 0.95  # of an interval that a common value states


@dataclass(frozen=True)
class Pooled:
    """A common value.

    ``value`` with its standard deviation ``sigma``; ``low`` and ``high`` end its 95 % interval. ``scatter``: standard deviation of true values
    between flights. ``q``, ``p_same``: Cochran's statistic, and its p-value where all flights have one value. ``flights``: how many.
    """

    value: float
    sigma: float
    low: float
    high: float
    scatter: float
    q: float
    p_same: float
    flights: int


def pooled(values: np.ndarray, sigmas: np.ndarray) -> Pooled:
    """Pool ``values (n,)`` with standard deviations ``sigmas (n,)``, both finite, sigmas above zero.

    Random effects: ``values_i ~ N(mu, sigmas_i^2 + scatter^2)``; the scatter by restricted maximum likelihood (Viechtbauer, J. Educational and
    Behavioral Statistics 30(3), 2005), the sigma of ``mu`` by Hartung and Knapp (Statistics in Medicine 20, 2001), never below that of
    known scatter (Roever, Knapp and Friede, BMC Medical Research Methodology 15:99, 2015), its interval by Student's t with n - 1 degrees of
    freedom. The test of one value is Cochran's (Biometrics 10, 1954), chi-squared with n - 1.
    """
    values, sigmas = np.asarray(values, dtype=float), np.asarray(sigmas, dtype=float)
    n = len(values)
    if n == 1:
        reach = 1.959964 * float(sigmas[0])
        return Pooled(float(values[0]), float(sigmas[0]), float(values[0]) - reach, float(values[0]) + reach, 0.0, 0.0, 1.0, 1)
    design = np.ones((n, 1))
    scatter = scatter_between(values, sigmas, design)
    weight = 1.0 / (sigmas**2 + scatter**2)
    value = float(weight @ values / weight.sum())
    factor = max(1.0, float(weight @ (values - value) ** 2) / (n - 1))
    sigma = float(np.sqrt(factor / weight.sum()))
    reach = float(stdtrit(n - 1, 0.5 + 0.5 * CERTAIN)) * sigma
    exact = 1.0 / sigmas**2
    q = float(exact @ (values - exact @ values / exact.sum()) ** 2)
    return Pooled(value, sigma, value - reach, value + reach, scatter, q, float(chdtrc(n - 1, q)), n)


def scatter_between(values: np.ndarray, sigmas: np.ndarray, design: np.ndarray) -> float:
    """The standard deviation between flights about ``design (n, c)`` times its coefficients, by restricted likelihood; zero where none shows."""
    from scipy.optimize import minimize_scalar

    if len(values) <= design.shape[1]:
        return 0.0
    largest = float(np.std(values) + np.sqrt(np.mean((values - values.mean()) ** 2 + sigmas**2)))
    if not largest > 0.0:
        return 0.0

    def cost(scatter: float) -> float:
        weight = 1.0 / (sigmas**2 + scatter**2)
        information = design.T @ (weight[:, None] * design)
        left = values - design @ np.linalg.solve(information, design.T @ (weight * values))
        return float(-np.log(weight).sum() + np.linalg.slogdet(information)[1] + weight @ left**2)

    # Of several minima the lowest: a grid brackets it, Brent's method finds it.
    grid = np.concatenate([[0.0], np.geomspace(1e-3, 3.0, 40) * largest])
    at = int(np.argmin([cost(each) for each in grid]))
    if at == 0:
        return 0.0
    low, high = grid[at - 1], grid[min(at + 1, len(grid) - 1)]
    found = minimize_scalar(cost, bounds=(float(low), float(high)), method="bounded", options={"xatol": 1e-6 * largest})
    return float(found.x)
