"""Refits of a fit in the frequency domain with one parameter held, for profile-likelihood intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ident.frequency_domain.fit import FrequencyFit, fit_transforms
from ident.statistics.information import inverse_information
from ident.statistics.profile import ProfileInterval, profile_interval


def profile_intervals(fit: FrequencyFit, names: Sequence[str], covariance: np.ndarray) -> tuple[ProfileInterval, ...]:
    """Intervals of the parameters ``names``; ``covariance (q, q)`` as it is printed, by which the threshold grows with the noise's colour."""
    inverse, _ = inverse_information(fit.normal_equations[0], fit.theta)
    out = []
    for name in names:
        j = fit.problem.names.index(name)
        sigma, white = (float(np.sqrt(max(each[j, j], 1e-300))) for each in (covariance, inverse))
        bounds = float(fit.problem.low[j]), float(fit.problem.high[j])
        refit = _refit(fit, j, inverse[:, j] / inverse[j, j])
        out.append(profile_interval(name, float(fit.theta[j]), sigma, fit.cost, refit, bounds, max((sigma / white) ** 2, 1.0)))
    return tuple(out)


def _refit(fit: FrequencyFit, j: int, along: np.ndarray) -> Callable[[float, FrequencyFit | None], tuple[float, FrequencyFit] | None]:
    """Cost with parameter ``j`` held at a value; the others begin where the curvature at the maximum puts them."""

    def refit(value: float, begun: FrequencyFit | None) -> tuple[float, FrequencyFit] | None:
        near = begun or fit
        theta = near.theta + along * (value - near.theta[j])
        low, high = fit.problem.low.copy(), fit.problem.high.copy()
        low[j] = high[j] = value
        # Priors stay about the fit's own start: only the bounds differ.
        found = fit_transforms(replace(fit.problem, low=low, high=high), replace(near, theta=theta))
        return None if found is None else (found.cost, found)

    return refit
