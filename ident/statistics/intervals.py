"""Confidence intervals: profile likelihood, shares, chi-square.

A sigma is the curvature at the maximum; where the likelihood is no parabola (a quotient, a delay, a
lag that hardly shows) the interval of 2 (ln L_max - ln L) = 4 is what two sigmas stand for. Venzon
and Moolgavkar, Applied Statistics 37(1), 1988; Raue et al., Bioinformatics 25(15), 2009. The signed
root of that drop is nearly a straight line along the parameter, so a secant finds the end in a few
refits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

# ---- Profile-likelihood intervals

DROP = 4.0  # of twice the log likelihood: what two sigmas are where it is a parabola; 95.4 %
LEVEL = math.erf(math.sqrt(DROP / 2.0))
CLOSE = 0.02  # of the root, to which an end is found: a hundredth of the interval
# times two sigmas (or the value itself, where that is less), beyond which a side is open: farther
# out simulations fail first
REACH = 16.0
GROWTH = 4.0  # of a step outwards at most
TRIES = 14  # refits of a side
# ratio of the sides, and share by which they differ from two sigmas, from which a sigma does not
# tell the interval
SKEWED, OTHER = 1.25, 0.25

State = TypeVar("State")
# Minus the log likelihood with the parameter held at a value, all others at their best, and where
# those are; None where there is none.
Refit = Callable[[float, State | None], tuple[float, State] | None]


@dataclass(frozen=True)
class ProfileInterval:
    """Where the likelihood has dropped by what two sigmas stand for; None where it never does.

    ``low_bound`` and ``high_bound``: the end is a bound of the parameter, not the likelihood's.
    ``better``: by how much a refit was likelier than the estimate, which then is no maximum.
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
        """Whether value +- two sigmas says the same."""
        if self.low is None or self.high is None or self.low_bound or self.high_bound:
            return False
        below, above = self.value - self.low, self.high - self.value
        told = all(abs(side / (2.0 * self.sigma) - 1.0) <= OTHER for side in (below, above))
        return told and 1.0 / SKEWED <= above / max(below, 1e-300) <= SKEWED


@dataclass
class _Side(Generic[State]):
    """One side of a profile while its end is looked for: roots of the drop at values, and the state
    of the last refit.
    """

    refit: Refit[State]
    value: float
    cost: float
    state: State | None = None
    better: float = 0.0

    def root(self, at: float) -> float:
        """Square root of twice the drop, over that of the inflated threshold's unit; infinite where
        there is no refit.
        """
        found = self.refit(at, self.state)
        if found is None or not math.isfinite(found[0]):
            return math.inf
        cost, self.state = found
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
    """Intervals of several parameters of a fit at ``theta (n,)`` with minus the log likelihood
    ``cost``.

    Parameters
    ----------
    names : with their places in ``theta``. bounds : lowest and highest ``theta``.
    covariances : as printed, and of white residuals, ``(n, n)`` or more; where the first is larger
    the threshold is too. refit_along : the refits of the parameter at a place, and how the others
    go with it by the curvature at the maximum, ``(n,)``.
    """
    printed, white = covariances
    out = []
    for name, j in names.items():
        sigma, sharp = (float(np.sqrt(max(each[j, j], 1e-300))) for each in (printed, white))
        refit, limits = (
            refit_along(j, white[:, j] / white[j, j]),
            (float(bounds[0][j]), float(bounds[1][j])),
        )
        out.append(
            profile_interval(
                name, float(theta[j]), sigma, cost, refit, limits, max((sigma / sharp) ** 2, 1.0)
            )
        )
    return tuple(out)


def profile_interval(
    name: str,
    value: float,
    sigma: float,
    cost: float,
    refit: Refit[State],
    bounds: tuple[float, float],
    inflation: float = 1.0,
) -> ProfileInterval:
    """Both ends of a parameter's interval.

    Parameters
    ----------
    value, sigma : estimate and its standard deviation. cost : minus the log likelihood there.
    refit : see ``Refit``; handed the state of the refit before it on the same side, None first.
    inflation : variance of the estimate over that which the likelihood's curvature gives: the drop
    is as many times ``DROP``, since a
        likelihood that takes coloured residuals for white is too sharp by that.
    """
    sigma = sigma if math.isfinite(sigma) and sigma > 0.0 else abs(value) or 1.0
    ends = [
        _end(_Side(refit, value, cost), sigma, sign, bounds[sign > 0], math.sqrt(DROP * inflation))
        for sign in (-1.0, 1.0)
    ]
    (low, low_bound, down), (high, high_bound, up) = ends
    return ProfileInterval(name, value, sigma, low, high, low_bound, high_bound, max(down, up))


def _end(
    side: _Side[State], sigma: float, sign: float, bound: float, goal: float
) -> tuple[float | None, bool, float]:
    """The end of one side (None: open), whether it is the bound, and by how much a refit was
    likelier.
    """
    size = min(sigma, abs(side.value)) or sigma
    inside, r_inside, outside, r_outside = 0.0, 0.0, math.inf, math.inf
    farthest = abs(bound - side.value)
    step = min(goal * size, farthest)
    for _ in range(TRIES):
        r = side.root(side.value + sign * step)
        if abs(r - goal) <= CLOSE * goal:
            return side.value + sign * min(step * goal / r, farthest), False, side.better
        if r > goal:
            outside, r_outside = step, r
        else:
            inside, r_inside = step, r
            if step >= farthest:
                return bound, True, side.better
            if step >= REACH * goal * max(size, sigma if sigma < REACH * size else size):
                return None, False, side.better
        step = _next(inside, r_inside, outside, r_outside, goal, farthest)
    # Where the only way out leads to values that cannot be computed, the likelihood has not said
    # no.
    return (None if math.isinf(r_outside) else side.value + sign * outside), False, side.better


def _next(
    inside: float, r_inside: float, outside: float, r_outside: float, goal: float, farthest: float
) -> float:
    """Where the straight line through what is known reaches the goal; half way where one end has no
    number.
    """
    if math.isinf(outside):
        reached = inside * goal / r_inside if r_inside > goal / GROWTH else GROWTH * inside
        return min(1.02 * reached, GROWTH * inside, farthest)
    if math.isinf(r_outside):
        return 0.5 * (inside + outside)
    share = (goal - r_inside) / (r_outside - r_inside)
    return inside + (outside - inside) * min(max(share, 0.1), 0.9)


# ---- Confidence intervals of a share

SHARES_LEVEL = 0.95
DRAWS = 2000  # of a bootstrap: the ends of a 95 % interval rest on its 50 outermost


def clopper_pearson(count: float, of: float, level: float = SHARES_LEVEL) -> tuple[float, float]:
    """Exact binomial interval of a share seen ``count`` times in ``of`` independent trials (Clopper
    and Pearson, Biometrika 26, 1934).

    Both ends are the shares at which so few, or so many, would be seen with half of ``1 - level``.
    Without a trial it is 0 to 1.
    """
    from scipy.special import betaincinv

    if of == 0:
        return 0.0, 1.0
    tail = 0.5 * (1.0 - level)
    low = 0.0 if count == 0 else float(betaincinv(count, of - count + 1, tail))
    high = 1.0 if count == of else float(betaincinv(count + 1, of - count, 1.0 - tail))
    return low, high


def clustered_share(
    counts: np.ndarray, of: np.ndarray, rng: np.random.Generator, level: float = SHARES_LEVEL
) -> tuple[float, float]:
    """Interval of the share ``sum(counts) / sum(of)`` over runs ``(N,)``, each with ``counts`` hits
    in ``of`` trials that may be correlated.

    Percentiles of the share over runs drawn with replacement, a run always whole (cluster
    bootstrap; Efron and Tibshirani, An Introduction to the Bootstrap, 1993, section 8). Where each
    run has one trial the trials are independent, and where all runs have the same share there is
    nothing to resample: then the interval of Clopper and Pearson, a run as one trial. Runs without
    a trial are left out.
    """
    some = np.asarray(of) > 0
    counts, of = np.asarray(counts, dtype=float)[some], np.asarray(of, dtype=float)[some]
    runs, shares = len(of), counts / of
    if np.all(of == 1.0) or np.ptp(shares) == 0.0:
        return clopper_pearson(float(shares.sum()), runs, level)
    drawn = (rng.integers(runs, size=runs) for _ in range(DRAWS))
    resampled = [counts[rows].sum() / of[rows].sum() for rows in drawn]
    low, high = np.quantile(resampled, [0.5 * (1.0 - level), 0.5 * (1.0 + level)])
    return float(low), float(high)


# ---- Intervals that rest on chi-square


def quantile(share: float, degrees: float) -> float:
    """The value below which chi-square with ``degrees`` of freedom lies with the probability
    ``share``; without the second of scipy.stats.
    """
    from scipy.special import gammaincinv

    return 2.0 * float(gammaincinv(0.5 * degrees, share))


def deviation_factors(count: int, level: float = SHARES_LEVEL) -> tuple[float, float]:
    """By what a standard deviation of ``count`` independent normal numbers is multiplied to give
    the ends of its interval; infinite of one number.
    """
    if count < 2:
        return 0.0, float("inf")
    degrees, tail = count - 1, 0.5 * (1.0 - level)
    return (degrees / quantile(1.0 - tail, degrees)) ** 0.5, (
        degrees / quantile(tail, degrees)
    ) ** 0.5


def mean_square_interval(degrees: float, level: float = SHARES_LEVEL) -> tuple[float, float]:
    """Where a sum of squares of chi-square with ``degrees`` of freedom lies, over ``degrees``:
    about one.
    """
    tail = 0.5 * (1.0 - level)
    return quantile(tail, degrees) / degrees, quantile(1.0 - tail, degrees) / degrees


def inside(squares: np.ndarray, degrees: np.ndarray, level: float = SHARES_LEVEL) -> np.ndarray:
    """Which of ``squares (N,)`` lie within the interval of chi-square with their ``degrees (N,)``,
    half of the rest to either side.
    """
    from scipy.special import gammainc

    share, tail = gammainc(0.5 * degrees, 0.5 * squares), 0.5 * (1.0 - level)
    return np.asarray((share >= tail) & (share <= 1.0 - tail))
