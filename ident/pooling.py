"""Estimates of many flights together: common values, trends, outlying flights, recurring
effects.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import chdtrc, expit, ndtr, stdtr, stdtrit

# ---- Estimates of one flight, given values that it shares with other flights


def condition_on_shared_value(
    estimate: np.ndarray,
    covariance: np.ndarray,
    at: np.ndarray,
    value: np.ndarray,
    value_covariance: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the estimate ``(n,)`` and covariance ``(n, n)`` of one flight, given the values of k
    parameters that other flights have determined.

    The result is the product of two Gaussians. Over all flights it equals the joint fit with these
    parameters shared, provided that each likelihood is quadratic.

    Parameters
    ----------
    estimate, covariance : ``(n,)`` and ``(n, n)`` of the flight alone.
    at : ``(k,)`` positions of the shared parameters.
    value, value_covariance : ``(k,)`` and ``(k, k)`` of these from other flights, independent of
        this flight.
    """
    gain = covariance[:, at] @ np.linalg.inv(covariance[np.ix_(at, at)] + value_covariance)
    conditional = estimate + gain @ (value - estimate[at])
    remaining = covariance - gain @ covariance[at, :]
    return conditional, 0.5 * (remaining + remaining.T)


def pooled_without_flight(
    value: np.ndarray,
    covariance: np.ndarray,
    flight_value: np.ndarray,
    flight_covariance: np.ndarray,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return a pooled value ``(k,)`` and its covariance ``(k, k)`` with one flight taken out; None
    if it was the only flight.

    Parameters
    ----------
    value, covariance : ``(k,)`` and ``(k, k)`` pooled value of all flights.
    flight_value, flight_covariance : ``(k,)`` and ``(k, k)`` of the flight to take out.
    """
    information = np.linalg.inv(covariance) - np.linalg.inv(flight_covariance)
    rounding = 1e-9 * np.trace(np.linalg.inv(covariance))
    if np.linalg.eigvalsh(0.5 * (information + information.T))[0] <= rounding:
        return None
    remaining = np.linalg.inv(information)
    weighted, own = (
        np.linalg.solve(covariance, value),
        np.linalg.solve(flight_covariance, flight_value),
    )
    return remaining @ (weighted - own), remaining


# ---- Multiple tests: false discovery rate


def adjusted_p_values(p_values: np.ndarray) -> np.ndarray:
    """Return ``p_values (n,)`` adjusted for their number: for each hypothesis, the smallest rate of
    false discoveries at which it is rejected.

    By Benjamini and Hochberg, J. Royal Statistical Society B 57(1), 1995: of the hypotheses with an
    adjusted p-value below a level, the expected share of false rejections is at most that level,
    where the tests are independent or positively dependent.
    """
    p = np.asarray(p_values, dtype=float)
    n = len(p)
    if n == 0:
        return np.zeros(0)
    order = np.argsort(p, kind="stable")
    raised = p[order] * n / np.arange(1, n + 1)
    least = np.minimum.accumulate(raised[::-1])[::-1]
    adjusted = np.empty(n)
    adjusted[order] = np.minimum(least, 1.0)
    return adjusted


# ---- Common value of the estimates from many flights, with the scatter between flights

POOLED_CONFIDENCE = 0.95  # confidence of the interval of a common value
NORMAL_95 = 1.959964  # half-width of the 95 % interval of a Gaussian, standard deviations


@dataclass(frozen=True)
class PooledValue:
    """Common value of the estimates from several flights.

    Attributes
    ----------
    value, sigma : common value and its standard deviation.
    low, high : ends of its 95 % interval.
    scatter : standard deviation of the true values between flights.
    q, p_same : Cochran's statistic, and its p-value if all flights have one value.
    flights : number of flights.
    """

    value: float
    sigma: float
    low: float
    high: float
    scatter: float
    q: float
    p_same: float
    flights: int


def pool_values(values: np.ndarray, sigmas: np.ndarray) -> PooledValue:
    """Return the common value of ``values (n,)`` with standard deviations ``sigmas (n,)``. All are
    finite, and sigmas above zero.

    The model is that of random effects: ``values_i ~ N(mu, sigmas_i^2 + scatter^2)``. The scatter
    follows from restricted maximum likelihood (Viechtbauer, J. Educational and Behavioral
    Statistics 30(3), 2005), and the sigma of ``mu`` from Hartung and Knapp (Statistics in Medicine
    20, 2001). This sigma is never smaller than for a known scatter (Roever, Knapp and Friede, BMC
    Medical Research Methodology 15:99, 2015). The interval has Student's t with n - 1 degrees of
    freedom. The test of one value is Cochran's (Biometrics 10, 1954), chi-squared with n - 1
    degrees of freedom.
    """
    values, sigmas = np.asarray(values, dtype=float), np.asarray(sigmas, dtype=float)
    n = len(values)
    if n == 1:
        value, sigma = float(values[0]), float(sigmas[0])
        reach = NORMAL_95 * sigma
        return PooledValue(value, sigma, value - reach, value + reach, 0.0, 0.0, 1.0, 1)
    design = np.ones((n, 1))
    scatter = scatter_between_flights(values, sigmas, design)
    weight = 1.0 / (sigmas**2 + scatter**2)
    value = float(weight @ values / weight.sum())
    factor = max(1.0, float(weight @ (values - value) ** 2) / (n - 1))
    sigma = float(np.sqrt(factor / weight.sum()))
    reach = float(stdtrit(n - 1, 0.5 + 0.5 * POOLED_CONFIDENCE)) * sigma
    exact = 1.0 / sigmas**2
    q = float(exact @ (values - exact @ values / exact.sum()) ** 2)
    return PooledValue(
        value, sigma, value - reach, value + reach, scatter, q, float(chdtrc(n - 1, q)), n
    )


def scatter_between_flights(values: np.ndarray, sigmas: np.ndarray, design: np.ndarray) -> float:
    """Return the standard deviation of the true values between flights, by restricted likelihood;
    zero where the scatter of the estimates is no larger than their sigmas explain.

    ``values (n,)`` with ``sigmas (n,)`` scatter about ``design (n, c)`` times c fitted
    coefficients.
    """
    from scipy.optimize import minimize_scalar

    if len(values) <= design.shape[1]:
        return 0.0
    largest = float(np.std(values) + np.sqrt(np.mean((values - values.mean()) ** 2 + sigmas**2)))
    if not largest > 0.0:
        return 0.0

    def cost(scatter: float) -> float:
        weight = 1.0 / (sigmas**2 + scatter**2)
        information = design.T @ (weight[:, None] * design)
        residual = values - design @ np.linalg.solve(information, design.T @ (weight * values))
        return float(
            -np.log(weight).sum() + np.linalg.slogdet(information)[1] + weight @ residual**2
        )

    # There may be several minima: a grid brackets the lowest, and Brent's method finds it.
    grid = np.concatenate([[0.0], np.geomspace(1e-3, 3.0, 40) * largest])
    lowest = int(np.argmin([cost(trial) for trial in grid]))
    if lowest == 0:
        return 0.0
    low, high = grid[lowest - 1], grid[min(lowest + 1, len(grid) - 1)]
    solution = minimize_scalar(
        cost, bounds=(float(low), float(high)), method="bounded", options={"xatol": 1e-6 * largest}
    )
    return float(solution.x)


# ---- Flights whose value is outside the scatter of the others

NORMAL_QUARTILE = 0.6745  # upper quartile of a Gaussian, standard deviations
FALSE_DISCOVERY_RATE = 0.01  # rate of false discoveries among reported flights
FEWEST_FLIGHTS = 5  # with fewer flights, the median does not represent the others


def outlying_flights(residuals: np.ndarray, sigmas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the deviation of each flight in standard deviations ``(n,)``, and a mask ``(n,)`` that
    is True for outliers, from ``residuals (n,)`` about a common value.

    Deviations are taken from the median of the residuals. The scatter between flights is the excess
    of their median absolute deviation over ``sigmas (n,)``, so that outliers do not mask themselves
    (Rousseeuw and Croux, J. American Statistical Association 88, 1993). The rate of false
    discoveries over all flights is controlled.
    """
    n = len(residuals)
    if n < FEWEST_FLIGHTS:
        return np.zeros(n), np.zeros(n, dtype=bool)
    deviation = residuals - np.median(residuals)
    spread = float(np.median(np.abs(deviation))) / NORMAL_QUARTILE
    between = max(0.0, spread**2 - float(np.median(sigmas)) ** 2)
    normalised = deviation / np.sqrt(sigmas**2 + between)
    p_values = 2.0 * ndtr(-np.abs(normalised))
    return normalised, adjusted_p_values(p_values) < FALSE_DISCOVERY_RATE


# ---- Trend of a value with the flight condition

# a line through three flights has one degree of freedom and no usable sigma
FEWEST_FLIGHTS_OF_TREND = 4


@dataclass(frozen=True, eq=False)
class Trend:
    """Trend ``value = at_middle + slope * (condition - middle)``.

    Attributes
    ----------
    middle : condition in the middle of the flights.
    at_middle, slope : coefficients of the line.
    slope_sigma : standard deviation of the slope.
    covariance : ``(2, 2)`` of the value at the middle and the slope.
    scatter : standard deviation of the true values of the flights about the line.
    p_value : probability of a slope at least as large if there is no trend.
    """

    middle: float
    at_middle: float
    slope: float
    slope_sigma: float
    covariance: np.ndarray
    scatter: float
    p_value: float

    def band(self, condition: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the line and its standard deviation, ``(k,)`` each, at ``condition (k,)``."""
        regressors = np.stack([np.ones_like(condition), condition - self.middle])
        line = self.at_middle + self.slope * (condition - self.middle)
        return line, np.sqrt(np.einsum("ik,ij,jk->k", regressors, self.covariance, regressors))


def fit_trend(values: np.ndarray, sigmas: np.ndarray, condition: np.ndarray) -> Trend | None:
    """Return the trend of ``values (n,)`` with standard deviations ``sigmas (n,)`` over a
    ``condition (n,)``; None with fewer than ``FEWEST_FLIGHTS_OF_TREND`` flights or with a single
    condition.

    The model is a mixed-effects meta-regression. The scatter about the line follows from restricted
    maximum likelihood, and the covariance from Knapp and Hartung (Statistics in Medicine 22, 2003).
    This covariance is never smaller than for a known scatter. The test has Student's t with n - 2
    degrees of freedom.
    """
    n = len(values)
    spread = float(np.ptp(condition)) if n else 0.0
    if n < FEWEST_FLIGHTS_OF_TREND or spread <= 1e-9 * max(1.0, float(np.max(np.abs(condition)))):
        return None
    middle = float(np.mean(condition))
    size = float(np.std(condition))
    design = np.stack([np.ones(n), (condition - middle) / size], axis=1)
    scatter = scatter_between_flights(values, sigmas, design)
    weight = 1.0 / (sigmas**2 + scatter**2)
    inverse = np.linalg.inv(design.T @ (weight[:, None] * design))
    coefficients = inverse @ (design.T @ (weight * values))
    residual = values - design @ coefficients
    inverse *= max(1.0, float(weight @ residual**2) / (n - 2))
    sigma = float(np.sqrt(inverse[1, 1]))
    p_value = 2.0 * float(stdtr(n - 2, -abs(coefficients[1]) / sigma))
    units = np.array([1.0, 1.0 / size])
    return Trend(
        middle,
        float(coefficients[0]),
        float(coefficients[1]) / size,
        sigma / size,
        inverse * np.outer(units, units),
        scatter,
        p_value,
    )


# ---- Recurring effects: effects that act in several flights with a common value

# probability of a false recurrence in a survey, over all candidates: once in three years of daily
# surveys
FALSE_RECURRENCE_PROBABILITY = 1e-3
# a flight has the effect where its probability is larger, and has not where the probability is
# below 1 - MEMBERSHIP_PROBABILITY
MEMBERSHIP_PROBABILITY = 0.95
# trial values of the scatter between flights, relative to the value
SCATTERS = (0.0, 0.03, 0.1, 0.2, 0.4, 0.8)
# largest loss of twice the log likelihood by one common value: chi-squared with one degree of
# freedom, exceeded by chance once in twenty (Wilks)
COMMON_VALUE_CHI_SQUARE = 3.84
MOST_ITERATIONS = 60  # largest number of iterations of expectation maximisation
SETTLED_LOG_LIKELIHOOD = 1e-4  # change of log likelihood below which iterations end


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence of each of n flights for one effect with k parameters.

    Attributes
    ----------
    gain : ``(n,)`` gain of the log likelihood of a flight by the effect at its best values.
    value : ``(n, k)`` these values.
    covariance : ``(n, k, k)`` of the values.
    """

    gain: np.ndarray
    value: np.ndarray
    covariance: np.ndarray

    def select(self, flights: np.ndarray) -> Evidence:
        """Return the evidence of the flights at the positions ``flights``."""
        return Evidence(self.gain[flights], self.value[flights], self.covariance[flights])


@dataclass(frozen=True, eq=False)
class Recurrence:
    """Joint result of all flights for one effect.

    Attributes
    ----------
    value, covariance : ``(k,)`` and ``(k, k)`` common values of the parameters.
    scatter : standard deviation between flights, relative to the value.
    agrees : whether one value explains all flights without scatter.
    share : share of the flights that have the effect.
    probability : ``(n,)`` probability that each flight has the effect.
    log_likelihood : gain of the log likelihood of all flights.
    at_common : ``(n,)`` gain of the log likelihood of each flight by the effect at the common
        value.
    p_value : upper bound of the probability of such a gain, without the strongest flight, if no
        flight has any of the candidates.
    """

    value: np.ndarray
    covariance: np.ndarray
    scatter: float
    agrees: bool
    share: float
    probability: np.ndarray
    log_likelihood: float
    at_common: np.ndarray
    p_value: float

    @property
    def has(self) -> np.ndarray:
        """Mask ``(n,)`` of the flights that have the effect."""
        return self.probability > MEMBERSHIP_PROBABILITY

    @property
    def has_not(self) -> np.ndarray:
        """Mask ``(n,)`` of the flights that do not have the effect."""
        return self.probability < 1.0 - MEMBERSHIP_PROBABILITY

    @property
    def recurs(self) -> bool:
        """Whether the effect acts in at least two flights, and chance does not explain it."""
        return int(self.has.sum()) >= 2 and self.p_value < FALSE_RECURRENCE_PROBABILITY

    @property
    def belongs(self) -> Literal["aircraft", "some flights", "no flight"]:
        """Where the effect acts: in the aircraft where no flight excludes it, else in some
        flights, or in none.
        """
        if not self.recurs:
            return "no flight"
        return "some flights" if np.any(self.has_not) else "aircraft"


@dataclass(frozen=True, eq=False)
class _MixtureFit:
    """Maximum of the likelihood of the flights for one effect.

    Attributes
    ----------
    value : ``(k,)`` common value.
    scatter : relative scatter between flights.
    share : share of the flights that have the effect.
    total : gain of the log likelihood of all flights.
    flight_gains : ``(n,)`` gain of each flight if it has the effect.
    """

    value: np.ndarray
    scatter: float
    share: float
    total: float
    flight_gains: np.ndarray


def recurrence(evidence: Evidence, candidates: int = 1) -> Recurrence:
    """Return whether and with what value one effect recurs over the flights of ``evidence``.
    ``candidates`` is the number of effects that are tested.

    A flight has the effect with the probability ``share``. Its value is then distributed as
    ``N(value, scatter^2 value^2)``. The log likelihood of a flight is quadratic about its best
    values. Integrated over these values it gains ``gain - d' (C + T)^-1 d / 2 + ln(|C| / |C + T|) /
    2``, with ``d`` the difference between the value of the flight and the common value, C its
    covariance and T that of the scatter. ``share``, ``value`` and ``scatter`` maximise the
    likelihood of all flights (expectation maximisation, Dempster, Laird and Rubin, J. Royal
    Statistical Society B 39, 1977).

    If no flight has the effect, twice the gain is bounded by chi-squared with k + 3 degrees of
    freedom: k + 1, and two more since the start is chosen among the flights. The bound is tested on
    simulated flights without the effect. It is multiplied by ``candidates`` (Bonferroni). The
    flight with the largest gain is left out, so that no single flight makes a recurrence.
    """
    n, k = evidence.value.shape
    best = _most_likely(evidence)
    without_scatter = best if best.scatter == 0.0 else _most_likely(evidence, (0.0,))
    agrees = 2.0 * (best.total - without_scatter.total) < COMMON_VALUE_CHI_SQUARE
    best = without_scatter if agrees else best
    gain_of_flight = np.log1p(best.share * np.expm1(np.clip(best.flight_gains, -700.0, 700.0)))
    probability = expit(best.flight_gains + _logit(np.array(best.share)))
    others = np.delete(np.arange(n), int(np.argmax(gain_of_flight)))
    statistic = 2.0 * _most_likely(evidence.select(others)).total if n > 1 else 0.0
    p_value = min(1.0, candidates * float(chdtrc(k + 3, max(statistic, 0.0))))
    added = best.scatter**2 * np.diag(best.value**2)
    weights = probability[:, None, None] * np.linalg.inv(evidence.covariance + added)
    information = weights.sum(axis=0)
    covariance = np.linalg.pinv(information)
    return Recurrence(
        best.value,
        covariance,
        best.scatter,
        agrees,
        best.share,
        probability,
        best.total,
        best.flight_gains,
        p_value,
    )


def _most_likely(evidence: Evidence, scatters: tuple[float, ...] = SCATTERS) -> _MixtureFit:
    """Return the most likely common value. Searches start from the values of the flights with the
    largest gain, and from their mean, with each of ``scatters``.
    """
    largest = np.argsort(-evidence.gain)[:4]
    weights = np.maximum(evidence.gain, 1e-12)
    mean = np.average(evidence.value, axis=0, weights=weights)
    starts = np.array([*evidence.value[largest], mean])
    return _maximise_from_starts(
        evidence, np.tile(starts, (len(scatters), 1)), np.repeat(scatters, len(starts))
    )


def _maximise_from_starts(
    evidence: Evidence, value: np.ndarray, scatter: np.ndarray
) -> _MixtureFit:
    """Return the best result of c searches at once, from ``value (c, k)`` with ``scatter (c,)``."""
    share, total = np.full(len(value), 0.5), np.full(len(value), -np.inf)
    each, inverse = _gains_about(evidence, value, scatter)
    for _ in range(MOST_ITERATIONS):
        probability = expit(each + _logit(share)[:, None])
        weights = probability[:, :, None, None] * inverse
        result = np.einsum(
            "cij,cj->ci",
            np.linalg.pinv(weights.sum(axis=1)),
            np.einsum("cnij,nj->ci", weights, evidence.value),
        )
        value = np.where(probability.sum(axis=1)[:, None] > 1e-9, result, value)
        share = np.clip(probability.mean(axis=1), 1e-9, 1.0 - 1e-9)
        each, inverse = _gains_about(evidence, value, scatter)
        before, odds = total, np.log(share)[:, None] + each
        total = np.logaddexp(np.log1p(-share)[:, None], odds).sum(axis=1)
        if np.all(np.abs(total - before) < SETTLED_LOG_LIKELIHOOD):
            break
    best = int(np.argmax(total))
    return _MixtureFit(
        value[best], float(scatter[best]), float(share[best]), float(total[best]), each[best]
    )


def _gains_about(
    evidence: Evidence, value: np.ndarray, scatter: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the gain ``(c, n)`` of the log likelihood of each flight by the effect about the
    common values ``value (c, k)`` with ``scatter (c,)``, and the inverses ``(c, n, k, k)`` of the
    covariances of the flights with the scatter added.
    """
    added = (scatter[:, None] * value)[:, :, None] ** 2 * np.eye(value.shape[1])
    wide = evidence.covariance + added[:, None]
    inverse = np.linalg.inv(wide)
    difference = evidence.value - value[:, None]
    squared = np.einsum("cni,cnij,cnj->cn", difference, inverse, difference)
    shrunk = np.linalg.slogdet(evidence.covariance)[1] - np.linalg.slogdet(wide)[1]
    return evidence.gain - 0.5 * squared + 0.5 * shrunk, inverse


def _logit(share: np.ndarray) -> np.ndarray:
    """Return the logarithm of the odds of a probability."""
    return np.asarray(np.log(share) - np.log1p(-share))
