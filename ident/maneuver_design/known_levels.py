"""Noise whose standard deviations are known: what a flight that has not been flown is weighed by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.whole_record.layout import LaidOut, Standardised, WeightedResiduals
from ident.whole_record.linearise import Linearisation


@dataclass(frozen=True, eq=False)
class KnownLevels:
    """Independent Gaussian noise of known ``variance (m,)``: the cost is half the sum of the weighted squares.

    Where the data have no noise at all, the estimated variances of ``White`` would be nothing.
    """

    variance: np.ndarray
    names: tuple[str, ...] = ()

    @property
    def start(self) -> np.ndarray:
        return np.zeros(0)

    low = high = start

    def weight_residuals(
        self, layout: LaidOut, theta: np.ndarray, lines: Sequence[Linearisation], residuals: Sequence[np.ndarray], counts: np.ndarray
    ) -> WeightedResiduals:
        """Residuals and sensitivities as they are; the cost is that of residuals over the known levels."""
        cost = 0.5 * float(sum(np.sum(residual**2 / self.variance[:, None]) for residual in residuals))
        filters = tuple(Standardised(problem.valid, self.variance) for problem in layout.problems)
        return WeightedResiduals(tuple(residuals), tuple(line.jacobian for line in lines), self.variance, cost, filters)

    def covariance_terms(
        self, layout: LaidOut, theta: np.ndarray, lines: Sequence[Linearisation], weighted: WeightedResiduals
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """None: the variances are known."""
        return None

    def step_bounds(self, layout: LaidOut, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The bounds of the layout."""
        return layout.low, layout.high
