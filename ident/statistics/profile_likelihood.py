"""Profile-likelihood intervals of parameters.

A sigma follows from the curvature of the likelihood at its maximum.
Where the log likelihood is no parabola (a quotient, a delay, a lag with little effect), the
interval in which 2 (ln L_max - ln L) < 4 corresponds to two sigmas (Venzon and Moolgavkar, Applied
Statistics 37(1), 1988; Raue et al., Bioinformatics 25(15), 2009). The signed root of this drop is
nearly linear in the parameter, so that a secant finds an end in a few refits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

# drop of twice the log likelihood at two sigmas of a parabola, for a probability of 95.4 %
TWICE_LOG_LIKELIHOOD_DROP = 4.0
LEVEL = math.erf(math.sqrt(TWICE_LOG_LIKELIHOOD_DROP / 2.0))
ENDPOINT_TOLERANCE = 0.02  # relative tolerance of the root at an end
# Largest distance of an end in units of two sigmas: simulations farther away fail. Where sigma is
# at least this multiple of the value, the unit is twice the value.
LARGEST_REACH = 16.0
LARGEST_STEP_GROWTH = 4.0  # largest growth of a step outwards
MOST_REFITS = 14  # largest number of refits on one side
SKEWED_RATIO = 1.25  # an interval with a larger ratio of its sides is skewed
SIDE_DIFFERENCE_SHARE = 0.25  # largest relative difference of a side from two sigmas

State = TypeVar("State")
# function that fixes the parameter at a value and fits all others: it returns minus the log
# likelihood and the state of the fit, or None where there is no fit
Refit = Callable[[float, State | None], tuple[float, State] | None]


@dataclass(frozen=True)
class ProfileInterval:
    """Profile-likelihood interval of a parameter: at its ends, the likelihood has dropped as much
    as a Gaussian at two sigmas.

    Attributes
    ----------
    name : name of the parameter.
    value, sigma : estimate and its standard deviation.
    low, high : ends; None where the likelihood does not drop so far.
    low_bound, high_bound : whether an end is a bound of the parameter.
    better : gain of log likelihood by a refit; where it is positive, the estimate is no maximum.
    """

    name: str
    value: float
    sigma: float
    low: float | None
    high: float | None
    low_bound: bool = False
    high_bound: bool = False
    better: float = 0.0

    @property
    def agrees(self) -> bool:
        """Whether the interval is nearly the value plus and minus two sigmas."""
        if self.low is None or self.high is None or self.low_bound or self.high_bound:
            return False
        below, above = self.value - self.low, self.high - self.value
        symmetric = all(
            abs(side / (2.0 * self.sigma) - 1.0) <= SIDE_DIFFERENCE_SHARE for side in (below, above)
        )
        return symmetric and 1.0 / SKEWED_RATIO <= above / max(below, 1e-300) <= SKEWED_RATIO


@dataclass
class _Side(Generic[State]):
    """One side of a profile during the search for its end.

    Attributes
    ----------
    refit : see `Refit`.
    value, cost : estimate, and minus the log likelihood there.
    state : state of the last refit.
    better : largest gain of log likelihood by a refit.
    """

    refit: Refit[State]
    value: float
    cost: float
    state: State | None = None
    better: float = 0.0

    def root(self, at: float) -> float:
        """Return the square root of twice the drop of the log likelihood at a value; infinite where
        there is no refit.
        """
        result = self.refit(at, self.state)
        if result is None or not math.isfinite(result[0]):
            return math.inf
        cost, self.state = result
        self.better = max(self.better, self.cost - cost)
        return math.sqrt(max(2.0 * (cost - self.cost), 0.0))


def profile_intervals(
    names: Mapping[str, int],
    theta: np.ndarray,
    cost: float,
    covariances: tuple[np.ndarray, np.ndarray],
    bounds: tuple[np.ndarray, np.ndarray],
    refit_along: Callable[[int, np.ndarray], Refit[State]],
) -> tuple[ProfileInterval, ...]:
    """Return the intervals of several parameters of a fit.

    Parameters
    ----------
    names : parameter -> its position in ``theta``.
    theta : ``(n,)`` estimate.
    cost : minus the log likelihood there.
    covariances : the reported covariance, and the covariance for white residuals, of which the
        first n rows and columns are used. The threshold grows with their ratio.
    bounds : lowest and highest ``theta``, ``(n,)`` each.
    refit_along : ``refit_along(j, d)`` returns the `Refit` of unknown ``j``. Its first guess
        follows ``d (n,)``, the derivative of theta with respect to theta_j along the ridge of the
        likelihood.
    """
    reported, white = covariances
    intervals = []
    for name, j in names.items():
        sigma = float(np.sqrt(max(reported[j, j], 1e-300)))
        white_sigma = float(np.sqrt(max(white[j, j], 1e-300)))
        refit = refit_along(j, white[:, j] / white[j, j])
        limits = (float(bounds[0][j]), float(bounds[1][j]))
        inflation = max((sigma / white_sigma) ** 2, 1.0)
        intervals.append(
            profile_interval(name, float(theta[j]), sigma, cost, refit, limits, inflation)
        )
    return tuple(intervals)


def profile_interval(
    name: str,
    value: float,
    sigma: float,
    cost: float,
    refit: Refit[State],
    bounds: tuple[float, float],
    inflation: float = 1.0,
) -> ProfileInterval:
    """Return the interval of a parameter.

    Parameters
    ----------
    value, sigma : estimate and its standard deviation.
    cost : minus the log likelihood there.
    refit : see `Refit`. Its second argument is the state of the refit before on the same side, or
        None.
    bounds : lowest and highest value.
    inflation : factor on the threshold ``TWICE_LOG_LIKELIHOOD_DROP``: the variance of the estimate
        over that by the curvature of the likelihood. A likelihood for white residuals is too sharp
        where they are coloured.
    """
    sigma = sigma if math.isfinite(sigma) and sigma > 0.0 else abs(value) or 1.0
    ends = [
        _end(
            _Side(refit, value, cost),
            sigma,
            sign,
            bounds[sign > 0],
            math.sqrt(TWICE_LOG_LIKELIHOOD_DROP * inflation),
        )
        for sign in (-1.0, 1.0)
    ]
    (low, low_bound, down), (high, high_bound, up) = ends
    return ProfileInterval(name, value, sigma, low, high, low_bound, high_bound, max(down, up))


def _end(
    side: _Side[State], sigma: float, sign: float, bound: float, goal: float
) -> tuple[float | None, bool, float]:
    """Return the end of one side (None where it is open), whether the end is the bound, and the
    largest gain of log likelihood by a refit.

    ``goal`` is the square root of the drop of twice the log likelihood at the end.
    """
    unit = min(sigma, abs(side.value)) or sigma
    inside, r_inside, outside, r_outside = 0.0, 0.0, math.inf, math.inf
    farthest = abs(bound - side.value)
    step = min(goal * unit, farthest)
    for _ in range(MOST_REFITS):
        r = side.root(side.value + sign * step)
        if abs(r - goal) <= ENDPOINT_TOLERANCE * goal:
            return side.value + sign * min(step * goal / r, farthest), False, side.better
        if r > goal:
            outside, r_outside = step, r
        else:
            inside, r_inside = step, r
            if step >= farthest:
                return bound, True, side.better
            reach = LARGEST_REACH * (sigma if sigma < LARGEST_REACH * unit else unit)
            if step >= goal * reach:
                return None, False, side.better
        step = _next_step(inside, r_inside, outside, r_outside, goal, farthest)
    # Where no refit succeeds farther away, the side is open.
    return (None if math.isinf(r_outside) else side.value + sign * outside), False, side.better


def _next_step(
    inside: float, r_inside: float, outside: float, r_outside: float, goal: float, farthest: float
) -> float:
    """Return the next step of the search for an end.

    At ``inside`` the root is below the ``goal``, and at ``outside`` above. The next step is where a
    straight line through both reaches the goal. It is the midpoint where ``outside`` has no refit,
    and a longer step where there is no ``outside`` yet.
    """
    if math.isinf(outside):
        reached = LARGEST_STEP_GROWTH * inside
        if r_inside > goal / LARGEST_STEP_GROWTH:
            reached = inside * goal / r_inside
        return min(1.02 * reached, LARGEST_STEP_GROWTH * inside, farthest)
    if math.isinf(r_outside):
        return 0.5 * (inside + outside)
    share = (goal - r_inside) / (r_outside - r_inside)
    return inside + (outside - inside) * min(max(share, 0.1), 0.9)
