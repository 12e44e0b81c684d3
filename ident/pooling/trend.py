"""A value that changes with the flight condition: weighted regression with scatter between flights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from ident.pooling.random_effects import scatter_between

FEWEST = 4  # flights: with three, a line has one degree of freedom and its sigma says nothing


@dataclass(frozen=True, eq=False)
class Trend:
    """``value = at_middle + slope * (condition - middle)``.

    ``slope_sigma``, ``at_middle_sigma``: standard deviations. ``covariance (2, 2)`` of both. ``scatter``: standard deviation of the flights about
    the line. ``p_value``: of a slope so large where there is none.
    """

    middle: float
    at_middle: float
    slope: float
    slope_sigma: float
    covariance: np.ndarray
    scatter: float
    p_value: float

    @property
    def at_middle_sigma(self) -> float:
        return float(np.sqrt(self.covariance[0, 0]))

    def band(self, condition: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The line and its standard deviation, ``(k,)`` each, at conditions ``(k,)``."""
        away = np.stack([np.ones_like(condition), condition - self.middle])
        line = self.at_middle + self.slope * (condition - self.middle)
        return line, np.sqrt(np.einsum("ik,ij,jk->k", away, self.covariance, away))


def trend(values: np.ndarray, sigmas: np.ndarray, condition: np.ndarray) -> Trend | None:
    """How ``values (n,)`` with ``sigmas (n,)`` change with a ``condition (n,)``; None with fewer than ``FEWEST`` flights or one condition alone.

    Mixed-effects meta-regression: scatter about the line by restricted maximum likelihood; the covariance by Knapp and Hartung (Statistics in
    Medicine 22, 2003), never below that of known scatter; Student's t with n - 2 degrees of freedom.
    """
    n = len(values)
    spread = float(np.ptp(condition)) if n else 0.0
    if n < FEWEST or spread <= 1e-9 * max(1.0, float(np.max(np.abs(condition)))):
        return None
    middle = float(np.mean(condition))
    size = float(np.std(condition))
    design = np.stack([np.ones(n), (condition - middle) / size], axis=1)
    scatter = scatter_between(values, sigmas, design)
    weight = 1.0 / (sigmas**2 + scatter**2)
    inverse = np.linalg.inv(design.T @ (weight[:, None] * design))
    found = inverse @ (design.T @ (weight * values))
    left = values - design @ found
    inverse *= max(1.0, float(weight @ left**2) / (n - 2))
    sigma = float(np.sqrt(inverse[1, 1]))
    p_value = 2.0 * float(stdtr(n - 2, -abs(found[1]) / sigma))
    units = np.array([1.0, 1.0 / size])
    return Trend(middle, float(found[0]), float(found[1]) / size, sigma / size, inverse * np.outer(units, units), scatter, p_value)
