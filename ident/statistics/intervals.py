"""Information matrices and confidence intervals.

Information: inverses, normal equations, directions that data and priors determine. In units of the
prior standard deviations the record's information is F = V diag(s^2) V', s and V the singular
values and right vectors of its scaled sensitivities. With the prior the covariance is C = V diag(1
/ (1 + s^2)) V': along a direction with s = 1 record and prior have equal information. The error of
the estimate has two independent parts, noise and a wrong prior mean: C = C F C + C C, so that (C
C)_ii / C_ii is the share of a posterior variance due to the prior. The sum of s^2 / (1 + s^2) is
the number of parameters determined by the record (effective number of parameters; MacKay, Neural
Computation 4, 1992).

Intervals: profile likelihood, shares, chi-square. A sigma is the curvature at the maximum; where
the likelihood is no parabola (a quotient, a delay, a lag that hardly shows) the interval of 2 (ln
L_max - ln L) = 4 corresponds to two sigmas. Venzon and Moolgavkar, Applied Statistics 37(1), 1988;
Raue et al., Bioinformatics 25(15), 2009. The signed root of that drop is nearly a straight line
along the parameter, so a secant finds the end in a few refits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

# ---- Inverse of an information matrix that need not be regular

# share of the largest eigenvalue of the scaled information below which a direction is not
# determined: rounding
UNDETERMINED = 1e-14
# the same for sensitivities of limited precision: differences of simulated kinematics
DIFFERENCED_UNDETERMINED = 1e-9
LEAST_STEP_EIGENVALUE_SHARE = 1e-12  # share below which a step does not follow a direction at all


def conditional_scale(information: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Sigma of each unknown with the others known, ``(n,)``; its ``size`` (at least 1) where it has
    no influence at all.
    """
    diagonal = np.diag(information)
    return np.where(
        diagonal > 0,
        1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)),
        np.maximum(np.abs(size), 1.0),
    )


def inverse_information(
    information: np.ndarray, size: np.ndarray | float = 0.0, floor: float = UNDETERMINED
) -> tuple[np.ndarray, bool]:
    """Return the covariance ``(n, n)`` and whether every direction is determined.

    A direction that holds less than ``floor`` of the scaled information keeps a finite, very large
    sigma: ``1 / sqrt(floor)`` in units of ``conditional_scale``. ``size`` of the unknowns: see
    there. Without unknowns, all is determined.
    """
    if not len(information):
        return np.zeros((0, 0)), True
    square, values, vectors = _spectrum(information, size)
    least = floor * (float(values[-1]) if values[-1] > 0 else 1.0)
    return square * ((vectors / np.maximum(values, least)) @ vectors.T), bool(values[0] > least)


def determined_and_open(
    information: np.ndarray, size: np.ndarray | float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return the covariance of ``inverse_information`` as a sum, ``(n, n)`` each: of the directions
    that are determined, and of the others.

    A product with the sum would lose the first part to rounding: the second is larger by up to ``1
    / UNDETERMINED``.
    """
    if not len(information):
        return np.zeros((0, 0)), np.zeros((0, 0))
    square, values, vectors = _spectrum(information, size)
    least = UNDETERMINED * (float(values[-1]) if values[-1] > 0 else 1.0)
    determined = values > least
    return (
        square * ((vectors[:, determined] / values[determined]) @ vectors[:, determined].T),
        square * ((vectors[:, ~determined] / least) @ vectors[:, ~determined].T),
    )


def variance_along(covariance: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the variances ``(k,)`` of the linear combinations ``rows (k, n)`` of unknowns, each
    with its rounding error.

    Where directions are open, huge covariances cancel in a combination that does not contain them.
    The sum then holds no more than its rounding error, which is the variance reported: it is never
    zero, and never smaller than what the arithmetic resolves.
    """
    n = covariance.shape[0]
    sizes = np.abs(rows) @ np.sqrt(np.maximum(np.diag(covariance), 0.0))
    result = np.einsum("ki,ij,kj->k", rows, covariance, rows)
    return np.asarray(np.maximum(result, 0.0) + n * np.finfo(float).eps * sizes**2)


def bounded_inverse(information: np.ndarray) -> np.ndarray:
    """Return the inverse ``(n, n)`` for a step, without the directions that hold less than
    LEAST_STEP_EIGENVALUE_SHARE of the scaled information.
    """
    square, values, vectors = _spectrum(information, 0.0)
    determined = values > LEAST_STEP_EIGENVALUE_SHARE * max(float(values[-1]), 1e-300)
    return square * (
        (vectors * np.where(determined, 1.0 / np.where(determined, values, 1.0), 0.0)) @ vectors.T
    )


def _spectrum(
    information: np.ndarray, size: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the products of the conditional sigmas ``(n, n)``, and eigenvalues and eigenvectors of
    the information in their units.
    """
    scale = conditional_scale(
        information, np.broadcast_to(np.asarray(size, dtype=float), len(information))
    )
    square = np.outer(scale, scale)
    values, vectors = np.linalg.eigh(information * square)
    return square, values, vectors


# ---- Normal equations


def add_normal_equations(
    information: np.ndarray,
    gradient: np.ndarray,
    at: np.ndarray,
    jacobian: np.ndarray,
    residual: np.ndarray,
    weight: np.ndarray,
) -> None:
    """Add to ``information (n, n)`` and ``gradient (n,)``, in place, the information of one record
    on the unknowns at positions ``at (c,)``.

    ``jacobian (m, N, c)`` of the fitted outputs, ``residual (m, N)`` measured minus fitted,
    ``weight (m, N)`` one over the variance of a sample, zero where it is missing; negative weights
    remove a record.
    """
    J, w = jacobian.reshape(-1, len(at)), weight.ravel()
    information[at[:, None], at] += J.T @ (w[:, None] * J)
    gradient[at] += J.T @ (w * residual.ravel())


# ---- Information of the record and of the prior

ROUNDING = 1e-10  # singular values below this share of the largest are rounding


@dataclass(frozen=True, eq=False)
class Determination:
    """Information of a record and of a prior on parameters.

    Attributes
    ----------
    names : of the parameters, ``n``.
    prior_std, posterior_std : ``(n,)`` before and after the record.
    prior_share : ``(n,)`` of each posterior variance that comes from the prior, 0 to 1.
    strengths : ``(n,)`` singular values, largest first: how many times better than the prior the
        record knows a direction.
    directions : ``(n, n)`` unit vectors in prior standard deviations, a column for each strength.
    """

    names: tuple[str, ...]
    prior_std: np.ndarray
    posterior_std: np.ndarray
    prior_share: np.ndarray
    strengths: np.ndarray
    directions: np.ndarray

    @property
    def effective(self) -> float:
        """Number of parameters that the record determines."""
        return float(np.sum(self.strengths**2 / (1.0 + self.strengths**2)))

    @property
    def determined(self) -> int:
        """Directions of which the record knows more than the prior."""
        return int(np.sum(self.strengths > 1.0))

    @property
    def unseen(self) -> int:
        """Directions without any influence on the record, to rounding: only the prior determines
        them.
        """
        return (
            int(np.sum(self.strengths <= ROUNDING * max(float(self.strengths[0]), 1e-300)))
            if len(self.strengths)
            else 0
        )

    def composition(self, direction: int, most: int = 4) -> tuple[tuple[str, float], ...]:
        """Return the parameters that make most of a direction with their parts, the largest first
        and positive.
        """
        vector = self.directions[:, direction]
        order = np.argsort(-np.abs(vector))[:most]
        sign = np.sign(vector[order[0]]) or 1.0
        return tuple((self.names[i], float(sign * vector[i])) for i in order)


def determination(
    names: tuple[str, ...], sensitivities: np.ndarray, prior_std: np.ndarray
) -> Determination:
    """Return the directions that sensitivities ``(M, n)`` in units of the noise and independent
    priors ``(n,)`` determine; ``M >= n`` is not needed.
    """
    prior = np.asarray(prior_std, dtype=float)
    _, result, rows = np.linalg.svd(
        sensitivities * prior, full_matrices=len(sensitivities) < len(names)
    )
    strengths = np.concatenate([result, np.zeros(len(names) - len(result))])
    directions = rows.T
    variance = 1.0 / (1.0 + strengths**2)
    posterior = directions**2 @ variance
    return Determination(
        names,
        prior,
        prior * np.sqrt(posterior),
        directions**2 @ variance**2 / posterior,
        strengths,
        directions,
    )


# ---- Profile-likelihood intervals

# drop of twice the log likelihood at two sigmas of a parabola; 95.4 %
TWICE_LOG_LIKELIHOOD_DROP = 4.0
LEVEL = math.erf(math.sqrt(TWICE_LOG_LIKELIHOOD_DROP / 2.0))
ENDPOINT_TOLERANCE = 0.02  # tolerance of the root at an end: a hundredth of the interval
# largest distance of an end, in two sigmas (or in the value, if smaller): farther out simulations
# fail first
LARGEST_REACH = 16.0
LARGEST_STEP_GROWTH = 4.0  # largest growth of a step outwards
MOST_REFITS = 14  # refits of a side
SKEWED_RATIO = 1.25  # ratio of the two sides from which an interval counts as skewed
SIDE_DIFFERENCE_SHARE = 0.25  # share by which sides may differ from two sigmas

State = TypeVar("State")
# Minus the log likelihood with the parameter held at a value, all others at their best, and where
# those are; None where there is none.
Refit = Callable[[float, State | None], tuple[float, State] | None]


@dataclass(frozen=True)
class ProfileInterval:
    """Interval where the likelihood drops by the equivalent of two sigmas; an end is None if it
    never does.

    ``low_bound`` and ``high_bound``: the end is a bound of the parameter. ``better``: gain of a
    refit over the estimate, which then is no maximum.
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
        """Whether value +- two sigmas gives the same interval."""
        if self.low is None or self.high is None or self.low_bound or self.high_bound:
            return False
        below, above = self.value - self.low, self.high - self.value
        symmetric = all(
            abs(side / (2.0 * self.sigma) - 1.0) <= SIDE_DIFFERENCE_SHARE for side in (below, above)
        )
        return symmetric and 1.0 / SKEWED_RATIO <= above / max(below, 1e-300) <= SKEWED_RATIO


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
    """Return the intervals of several parameters of a fit at ``theta (n,)`` with minus the log
    likelihood ``cost``.

    Parameters
    ----------
    names : with their places in ``theta``.
    bounds : lowest and highest ``theta``.
    covariances : as printed, and of white residuals, ``(n, n)`` or more; where the first is larger
        the threshold is too.
    refit_along : the refits of the parameter at a place, and how the others go with it by the
        curvature at the maximum, ``(n,)``.
    """
    printed, white = covariances
    out = []
    for name, j in names.items():
        sigma, sharp = (float(np.sqrt(max(each[j, j], 1e-300))) for each in (printed, white))
        refit = refit_along(j, white[:, j] / white[j, j])
        limits = (float(bounds[0][j]), float(bounds[1][j]))
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
    """Return both ends of a parameter's interval.

    Parameters
    ----------
    value, sigma : estimate and its standard deviation.
    cost : minus the log likelihood there.
    refit : see ``Refit``; handed the state of the refit before it on the same side, None first.
    inflation : variance of the estimate over that which the likelihood's curvature gives: the drop
        is as many times ``TWICE_LOG_LIKELIHOOD_DROP``, since a likelihood that takes coloured
        residuals for white is too sharp by that.
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
    """Return the end of one side (None: open), whether it is the bound, and by how much a refit was
    likelier.
    """
    size = min(sigma, abs(side.value)) or sigma
    inside, r_inside, outside, r_outside = 0.0, 0.0, math.inf, math.inf
    farthest = abs(bound - side.value)
    step = min(goal * size, farthest)
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
            if step >= LARGEST_REACH * goal * max(
                size, sigma if sigma < LARGEST_REACH * size else size
            ):
                return None, False, side.better
        step = _next(inside, r_inside, outside, r_outside, goal, farthest)
    # If values beyond cannot be computed, the side stays open.
    return (None if math.isinf(r_outside) else side.value + sign * outside), False, side.better


def _next(
    inside: float, r_inside: float, outside: float, r_outside: float, goal: float, farthest: float
) -> float:
    """Return the point at which the straight line through the known points reaches the goal; the
    midpoint if one end has no number.
    """
    if math.isinf(outside):
        reached = (
            inside * goal / r_inside
            if r_inside > goal / LARGEST_STEP_GROWTH
            else LARGEST_STEP_GROWTH * inside
        )
        return min(1.02 * reached, LARGEST_STEP_GROWTH * inside, farthest)
    if math.isinf(r_outside):
        return 0.5 * (inside + outside)
    share = (goal - r_inside) / (r_outside - r_inside)
    return inside + (outside - inside) * min(max(share, 0.1), 0.9)


# ---- Confidence intervals of a share

SHARES_LEVEL = 0.95
# draws of a bootstrap: the ends of a 95 % interval depend on the 50 outermost
BOOTSTRAP_DRAWS = 2000


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
    samples = (rng.integers(runs, size=runs) for _ in range(BOOTSTRAP_DRAWS))
    resampled = [counts[rows].sum() / of[rows].sum() for rows in samples]
    low, high = np.quantile(resampled, [0.5 * (1.0 - level), 0.5 * (1.0 + level)])
    return float(low), float(high)


# ---- Intervals that rest on chi-square


def quantile(share: float, degrees: float) -> float:
    """Return the value below which chi-square with ``degrees`` of freedom lies with the probability
    ``share``; without the second of scipy.stats.
    """
    from scipy.special import gammaincinv

    return 2.0 * float(gammaincinv(0.5 * degrees, share))


def deviation_factors(count: int) -> tuple[float, float]:
    """Return the factors that turn a standard deviation of ``count`` independent normal numbers
    into the ends of its interval; infinite for one number.
    """
    if count < 2:
        return 0.0, float("inf")
    degrees, tail = count - 1, 0.5 * (1.0 - SHARES_LEVEL)
    return (degrees / quantile(1.0 - tail, degrees)) ** 0.5, (
        degrees / quantile(tail, degrees)
    ) ** 0.5


def mean_square_interval(degrees: float, level: float = SHARES_LEVEL) -> tuple[float, float]:
    """Return the interval of a chi-square sum of squares with ``degrees`` of freedom, divided by
    ``degrees``: about one.
    """
    tail = 0.5 * (1.0 - level)
    return quantile(tail, degrees) / degrees, quantile(1.0 - tail, degrees) / degrees


def inside(squares: np.ndarray, degrees: np.ndarray) -> np.ndarray:
    """Return which of ``squares (N,)`` lie within the central chi-square interval with their
    ``degrees (N,)``.
    """
    from scipy.special import gammainc

    share, tail = gammainc(0.5 * degrees, 0.5 * squares), 0.5 * (1.0 - SHARES_LEVEL)
    return np.asarray((share >= tail) & (share <= 1.0 - tail))


# ---- Scatter between records

# degrees of freedom from the other derivatives: two sigmas hold 93 to 98 of 100 simulated flights
# with two to five records
BORROWED = 6.0


def scatter_factors(values: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Return factors on the sigmas of means, for the scatter of values between records.

    The factor is the root of chi-squared over its degrees of freedom [1]_, from each row and from
    the median of all rows [2]_. It is multiplied by the width of Student's t relative to a Gaussian
    at two sigmas, and is at least one.

    Parameters
    ----------
    values, sigma : ``(n, records)`` estimates of ``n`` parameters from single records, and their
        standard deviations.

    Returns
    -------
    Factors ``(n,)``, at least one.

    References
    ----------
    .. [1] R. T. Birge, "The calculation of errors by the method of least squares", Physical Review
       40, 1932.
    .. [2] G. K. Smyth, "Linear models and empirical Bayes methods for assessing differential
       expression in microarray experiments", Stat. Appl. Genet. Mol. Biol. 3(1), 2004.
    """
    from scipy.special import chdtri, ndtr, stdtrit

    weight = sigma**-2
    mean = np.sum(weight * values, axis=1, keepdims=True) / np.sum(weight, axis=1, keepdims=True)
    freedom = values.shape[1] - 1
    own = np.sum(((values - mean) / sigma) ** 2, axis=1) / freedom
    # the median of chi-squared lies below its mean
    shared = float(np.median(own)) * freedom / float(chdtri(freedom, 0.5))
    borrowed = min(BORROWED, float(freedom * (len(values) - 1)))  # no more degrees exist
    squared = (freedom * own + borrowed * shared) / (freedom + borrowed)
    wider = float(stdtrit(freedom + borrowed, ndtr(2.0))) / 2.0
    return np.maximum(1.0, wider * np.sqrt(squared))
