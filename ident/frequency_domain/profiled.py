"""Refits of a fit in the frequency domain with one parameter held, for profile-likelihood intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ident.frequency_domain.fit import FrequencyFit, fit_transforms
from ident.statistics import intervals
from ident.statistics.information import inverse_information
from ident.statistics.intervals import ProfileInterval


def profile_intervals(fit: FrequencyFit, names: Sequence[str], covariance: np.ndarray) -> tuple[ProfileInterval, ...]:
    """Intervals of the parameters ``names``; ``covariance (q, q)`` as it is printed, by which the threshold grows with the noise's colour."""
    inverse, _ = inverse_information(fit.normal_equations[0], fit.theta)
    problem = fit.problem
    places = {name: problem.names.index(name) for name in names}
    return intervals.profile_intervals(places, fit.theta, fit.cost, (covariance, inverse), (problem.low, problem.high), partial(_refit, fit))


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
