"""Refits of a whole-record fit with one parameter held, for profile-likelihood intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ident.statistics import profile
from ident.statistics.information import inverse_information
from ident.statistics.profile import ProfileInterval
from ident.whole_record.fit_problem import FitProblem
from ident.whole_record.gauss_newton import Fit, carried, fit_whole_records
from ident.whole_record.noise_model import NoiseModel

ENOUGH = 1e-3  # of log likelihood, which moves an end by 1/4000 of it
ITERATIONS = 30


def profile_intervals(
    fit: Fit, names: Sequence[str], covariance: np.ndarray, noise_at: Callable[[Fit, np.ndarray], NoiseModel] | None = None
) -> tuple[ProfileInterval, ...]:
    """Intervals of the shared parameters ``names`` of a settled fit.

    Parameters
    ----------
    covariance : ``(s, s)`` of the shared parameters as it is printed; where it is larger than that of white residuals the threshold is too.
    noise_at : the noise model with its unknowns started at a theta; None leaves it as it is.
    """
    inverse, _ = inverse_information(fit.normal_equations()[0], fit.theta)
    layout, begun = fit.layout, noise_at or (lambda at, theta: at.noise_model)
    places = {name: layout.shared.index(name) for name in names}
    refits = partial(_refit, fit, noise_at=begun)
    return profile.profile_intervals(places, fit.theta, fit.cost, (covariance, inverse), (layout.low, layout.high), refits)


def _refit(
    fit: Fit, j: int, along: np.ndarray, noise_at: Callable[[Fit, np.ndarray], NoiseModel]
) -> Callable[[float, Fit | None], tuple[float, Fit] | None]:
    """Cost with unknown ``j`` held at a value; the others begin where the curvature at the maximum puts them."""
    settings = replace(fit.layout.settings, enough=ENOUGH, iterations=ITERATIONS)

    def refit(value: float, begun: Fit | None) -> tuple[float, Fit] | None:
        near = begun or fit
        theta = np.clip(near.theta + along * (value - near.theta[j]), fit.problem.low, fit.problem.high)
        theta[j] = value
        count = len(fit.layout.start)
        low, high = fit.layout.low.copy(), fit.layout.high.copy()
        low[j] = high[j] = value
        layout = replace(fit.layout, settings=settings, start=theta[:count], low=low, high=high)
        found = fit_whole_records(FitProblem(layout, noise_at(near, theta)), carried(near, theta))
        return None if found is None else (found.cost, found)

    return refit
