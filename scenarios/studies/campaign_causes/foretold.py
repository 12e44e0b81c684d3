"""Errors that are foretold without computing a run again: by the priors of a method, and by the colour of the noise."""

from __future__ import annotations

import numpy as np

from ident.statistics.residual_spectrum import filtered_product
from scenarios.studies.campaign_causes.residuals import Residuals
from scenarios.studies.campaign_statistics.bound import Bound


def foretold_by_prior(bound: Bound, at: int) -> tuple[float, float]:
    """Root mean square error in stated sigmas that the priors alone give a linear estimator, and the prior's share of the stated variance."""
    stated = float(bound.stated[at])
    return float(np.hypot(bound.scatter[at], bound.pull[at])) / stated, float(bound.prior_share[at])


def foretold_by_colour(bound: Bound, residuals: Residuals) -> np.ndarray | None:
    """By what each stated sigma ``(n,)`` is to be multiplied where noise has the runs' autocorrelation; None without sensitivities.

    The sandwich of Morelli and Klein (J. Guidance 20(1), 1997) with slopes at the reference and the mean correlation of the runs.
    """
    if bound.slopes is None:
        return None
    n, (m, count) = len(bound.names), residuals.valid.shape
    slopes = np.zeros((m * count, n))
    slopes[residuals.valid.ravel()] = bound.slopes[: int(residuals.valid.sum())]
    lags = residuals.lags.shape[1]
    taper = 1.0 - np.arange(lags) / lags
    coloured = np.zeros((n, n))
    for part, found in zip(slopes.reshape(m, count, n), residuals.lags, strict=True):
        coloured += filtered_product(part, found / found[0] * taper)
    white = bound.slopes.T @ bound.slopes
    variance = bound.stated**2 + np.diag(bound.gain @ (coloured - white) @ bound.gain.T)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)) / bound.stated)
