"""Information matrices and confidence intervals.

Information of record and prior. In units of the prior standard deviations, the information of the
record is F = V diag(s^2) V', with s and V the singular values and right singular vectors of its
scaled sensitivities. With the prior, the covariance is C = V diag(1 / (1 + s^2)) V'. Along a
direction with s = 1, record and prior have equal information. The error of the estimate has two
independent parts, from the noise and from a wrong prior mean: C = C F C + C C (the information of
the prior is the unit matrix). Therefore (C C)_ii / C_ii is the share of a posterior variance that
is due to the prior. The sum of s^2 / (1 + s^2) is the effective number of parameters that the
record determines (MacKay, Neural Computation 4, 1992).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# ---- Inverse of an information matrix that may be singular

# Eigenvalues of the scaled information below this share of the largest one are rounding: their
# directions are undetermined.
UNDETERMINED = 1e-14
DIFFERENCED_UNDETERMINED = 1e-9  # the same for sensitivities by finite differences
LEAST_STEP_EIGENVALUE_SHARE = 1e-12  # a step has no part along a direction below this share


def conditional_scale(information: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return the sigma ``(n,)`` of each unknown if all others were known.

    ``size (n,)`` is the order of magnitude of each unknown. Where the data do not depend on an
    unknown, its size is returned, or 1 if this is larger.
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

    Information is scaled to the units of `conditional_scale`, where ``size`` is explained. A
    direction with less than the share ``floor`` of the largest scaled information is undetermined.
    It gets a finite but very large sigma, ``1 / sqrt(floor)`` in these units.
    """
    if not len(information):
        return np.zeros((0, 0)), True
    sigma_products, values, vectors = _spectrum(information, size)
    least = floor * (float(values[-1]) if values[-1] > 0 else 1.0)
    covariance = sigma_products * ((vectors / np.maximum(values, least)) @ vectors.T)
    return covariance, bool(values[0] > least)


def split_covariance(
    information: np.ndarray, size: np.ndarray | float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return the two parts of the covariance of `inverse_information`, ``(n, n)`` each: the part of
    the determined directions, and the part of the undetermined ones.

    Multiply by each part separately and add the results. The second part is up to ``1 /
    UNDETERMINED`` times larger, so that rounding would destroy the first part in a product with the
    sum.
    """
    if not len(information):
        return np.zeros((0, 0)), np.zeros((0, 0))
    sigma_products, values, vectors = _spectrum(information, size)
    least = UNDETERMINED * (float(values[-1]) if values[-1] > 0 else 1.0)
    determined = values > least
    return (
        sigma_products * ((vectors[:, determined] / values[determined]) @ vectors[:, determined].T),
        sigma_products * ((vectors[:, ~determined] / least) @ vectors[:, ~determined].T),
    )


def variance_along(covariance: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the variances ``(k,)`` of the linear combinations ``rows (k, n)`` of unknowns, each
    with its rounding error added.

    Undetermined directions have huge variances and covariances. Except for rounding, these cancel
    in a combination that does not contain the directions. A variance is therefore never smaller
    than its rounding error.
    """
    n = covariance.shape[0]
    sizes = np.abs(rows) @ np.sqrt(np.maximum(np.diag(covariance), 0.0))
    result = np.einsum("ki,ij,kj->k", rows, covariance, rows)
    return np.asarray(np.maximum(result, 0.0) + n * np.finfo(float).eps * sizes**2)


def bounded_inverse(information: np.ndarray) -> np.ndarray:
    """Return the inverse ``(n, n)`` for a step, without the directions that have less than
    ``LEAST_STEP_EIGENVALUE_SHARE`` of the scaled information.
    """
    sigma_products, values, vectors = _spectrum(information, 0.0)
    determined = values > LEAST_STEP_EIGENVALUE_SHARE * max(float(values[-1]), 1e-300)
    return sigma_products * (
        (vectors * np.where(determined, 1.0 / np.where(determined, values, 1.0), 0.0)) @ vectors.T
    )


def _spectrum(
    information: np.ndarray, size: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the products ``(n, n)`` of the sigmas of `conditional_scale`, and the eigenvalues and
    the eigenvectors of the information in units of these sigmas.
    """
    scale = conditional_scale(
        information, np.broadcast_to(np.asarray(size, dtype=float), len(information))
    )
    sigma_products = np.outer(scale, scale)
    values, vectors = np.linalg.eigh(information * sigma_products)
    return sigma_products, values, vectors


# ---- Normal equations


def add_normal_equations(
    information: np.ndarray,
    gradient: np.ndarray,
    at: np.ndarray,
    jacobian: np.ndarray,
    residual: np.ndarray,
    weight: np.ndarray,
) -> None:
    """Add the information and the gradient of one record to those of all records, in place.

    Parameters
    ----------
    information, gradient : ``(n, n)`` and ``(n,)`` of all records; they are changed.
    at : ``(c,)`` positions of the unknowns of the record.
    jacobian : ``(m, N, c)`` derivatives of the fitted outputs.
    residual : ``(m, N)`` measured minus fitted outputs.
    weight : ``(m, N)`` one over the variance of a sample, zero where it is missing. Negative
        weights subtract a record.
    """
    J, w = jacobian.reshape(-1, len(at)), weight.ravel()
    information[at[:, None], at] += J.T @ (w[:, None] * J)
    gradient[at] += J.T @ (w * residual.ravel())


# ---- Information of the record and of the prior

ROUNDING = 1e-10  # singular values below this share of the largest one are rounding


@dataclass(frozen=True, eq=False)
class Determination:
    """Information of a record and of a prior on parameters.

    Attributes
    ----------
    names : names of the n parameters.
    prior_std, posterior_std : ``(n,)`` standard deviations before and after the record.
    prior_share : ``(n,)`` share of each posterior variance that is due to the prior, 0 to 1.
    strengths : ``(n,)`` singular values, the largest first. Along one direction each, they are the
        sigma of the prior over the sigma from the record alone.
    directions : ``(n, n)`` unit vectors in units of prior standard deviations: one column for each
        strength.
    """

    names: tuple[str, ...]
    prior_std: np.ndarray
    posterior_std: np.ndarray
    prior_share: np.ndarray
    strengths: np.ndarray
    directions: np.ndarray

    @property
    def effective(self) -> float:
        """Effective number of parameters that the record determines."""
        return float(np.sum(self.strengths**2 / (1.0 + self.strengths**2)))

    @property
    def determined(self) -> int:
        """Number of directions on which the record has more information than the prior."""
        return int(np.sum(self.strengths > 1.0))

    @property
    def unseen(self) -> int:
        """Number of directions without any influence on the record, except for rounding. Only the
        prior determines them.
        """
        if not len(self.strengths):
            return 0
        return int(np.sum(self.strengths <= ROUNDING * max(float(self.strengths[0]), 1e-300)))

    def composition(self, direction: int, count: int = 4) -> tuple[tuple[str, float], ...]:
        """Return the ``count`` largest components of a direction as pairs (name of parameter,
        component). The sign of the direction is chosen so that the first one is positive.
        """
        vector = self.directions[:, direction]
        order = np.argsort(-np.abs(vector))[:count]
        sign = np.sign(vector[order[0]]) or 1.0
        return tuple((self.names[i], float(sign * vector[i])) for i in order)


def determination(
    names: tuple[str, ...], sensitivities: np.ndarray, prior_std: np.ndarray
) -> Determination:
    """Return the information of a record and of independent priors.

    ``sensitivities (M, n)`` are in units of the noise, and M may be smaller than n. ``prior_std``
    is ``(n,)``.
    """
    prior = np.asarray(prior_std, dtype=float)
    _, singular_values, rows = np.linalg.svd(
        sensitivities * prior, full_matrices=len(sensitivities) < len(names)
    )
    strengths = np.concatenate([singular_values, np.zeros(len(names) - len(singular_values))])
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


# ---- Confidence intervals of a proportion

SHARES_LEVEL = 0.95
# draws of a bootstrap; 50 of them are beyond each end of a 95 % interval
BOOTSTRAP_DRAWS = 2000


def clopper_pearson(
    count: float, trials: float, level: float = SHARES_LEVEL
) -> tuple[float, float]:
    """Return the exact binomial interval of a proportion, from ``count`` successes in independent
    ``trials`` (Clopper and Pearson, Biometrika 26, 1934).

    If the share were at an end, a count at least as extreme would have probability
    ``(1 - level) / 2``. Without a trial the interval is 0 to 1.
    """
    from scipy.special import betaincinv

    if trials == 0:
        return 0.0, 1.0
    tail = 0.5 * (1.0 - level)
    low = 0.0 if count == 0 else float(betaincinv(count, trials - count + 1, tail))
    high = 1.0 if count == trials else float(betaincinv(count + 1, trials - count, 1.0 - tail))
    return low, high


def clustered_share(
    counts: np.ndarray, trials: np.ndarray, rng: np.random.Generator, level: float = SHARES_LEVEL
) -> tuple[float, float]:
    """Return the interval of the proportion ``sum(counts) / sum(trials)`` over N runs. Each run has
    ``counts (N,)`` successes in ``trials (N,)``. The trials of one run may be correlated.

    The ends are percentiles of the share over runs drawn with replacement: a cluster bootstrap
    (Efron and Tibshirani, An Introduction to the Bootstrap, 1993, section 8). The interval of
    Clopper and Pearson, with each run as one trial, is returned where each run has one trial, and
    where all runs have the same share. Runs without a trial are left out.
    """
    with_trials = np.asarray(trials) > 0
    counts, trials = (np.asarray(x, dtype=float)[with_trials] for x in (counts, trials))
    runs, shares = len(trials), counts / trials
    if np.all(trials == 1.0) or np.ptp(shares) == 0.0:
        return clopper_pearson(float(shares.sum()), runs, level)
    samples = (rng.integers(runs, size=runs) for _ in range(BOOTSTRAP_DRAWS))
    resampled = [counts[rows].sum() / trials[rows].sum() for rows in samples]
    low, high = np.quantile(resampled, [0.5 * (1.0 - level), 0.5 * (1.0 + level)])
    return float(low), float(high)


# ---- Intervals from the chi-square distribution


def chi_square_quantile(share: float, degrees: float) -> float:
    """Return the quantile of chi-square with ``degrees`` of freedom at the probability ``share``.

    It does not use scipy.stats, whose import takes a second.
    """
    from scipy.special import gammaincinv

    return 2.0 * float(gammaincinv(0.5 * degrees, share))


def deviation_factors(count: int) -> tuple[float, float]:
    """Return the two factors that turn the standard deviation of ``count`` independent normal
    numbers into the ends of its confidence interval; for one number they are 0 and infinite.
    """
    if count < 2:
        return 0.0, float("inf")
    degrees, tail = count - 1, 0.5 * (1.0 - SHARES_LEVEL)
    low = (degrees / chi_square_quantile(1.0 - tail, degrees)) ** 0.5
    high = (degrees / chi_square_quantile(tail, degrees)) ** 0.5
    return low, high


def mean_square_interval(degrees: float, level: float = SHARES_LEVEL) -> tuple[float, float]:
    """Return the central interval of a mean square of unit expectation: chi-square with ``degrees``
    of freedom, divided by ``degrees``.
    """
    tail = 0.5 * (1.0 - level)
    return chi_square_quantile(tail, degrees) / degrees, chi_square_quantile(
        1.0 - tail, degrees
    ) / degrees


def within_chi_square(squares: np.ndarray, degrees: np.ndarray) -> np.ndarray:
    """Return a mask ``(N,)``: True where one of ``squares (N,)`` is within the central interval of
    chi-square with its ``degrees (N,)`` of freedom.
    """
    from scipy.special import gammainc

    share, tail = gammainc(0.5 * degrees, 0.5 * squares), 0.5 * (1.0 - SHARES_LEVEL)
    return np.asarray((share >= tail) & (share <= 1.0 - tail))


# ---- Scatter between records

# weight of the scatter pooled over all parameters, in degrees of freedom: with 6, two sigmas
# contain the truth in 93 to 98 of 100 simulated flights with two to five records
POOLED_DEGREES = 6.0


def reduced_chi_square(values: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Return chi-squared over its degrees of freedom ``(n,)``, of values about their weighted
    means.

    Parameters
    ----------
    values, sigma : ``(n, records)`` values from single records and their standard deviations; at
        least two records.
    """
    weight = sigma**-2
    mean = np.sum(weight * values, axis=1, keepdims=True) / np.sum(weight, axis=1, keepdims=True)
    return np.sum(((values - mean) / sigma) ** 2, axis=1) / (values.shape[1] - 1)


def weighted_scatter(values: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Return the standard deviation ``(n,)`` of values from single records about their weighted
    means.

    A record that hardly determines a value has little weight. With equal sigmas the result is the
    sample standard deviation.

    Parameters
    ----------
    values, sigma : ``(n, records)`` values from single records and their standard deviations; at
        least two records.
    """
    variance = values.shape[1] / np.sum(sigma**-2, axis=1)
    return np.sqrt(variance * reduced_chi_square(values, sigma))


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

    freedom = values.shape[1] - 1
    by_parameter = reduced_chi_square(values, sigma)
    # the median of chi-squared lies below its mean
    pooled = float(np.median(by_parameter)) * freedom / float(chdtri(freedom, 0.5))
    # at most as many as the other parameters have together
    pooled_degrees = min(POOLED_DEGREES, float(freedom * (len(values) - 1)))
    squared = (freedom * by_parameter + pooled_degrees * pooled) / (freedom + pooled_degrees)
    wider = float(stdtrit(freedom + pooled_degrees, ndtr(2.0))) / 2.0
    return np.maximum(1.0, wider * np.sqrt(squared))
