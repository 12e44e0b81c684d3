"""Estimates of many flights together: common values, trends, outlying flights, recurring
effects.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import chdtrc, expit, ndtr, stdtr, stdtrit

# ---- A flight's estimates, given a value that it shares with other flights


def conditioned(
    estimate: np.ndarray,
    covariance: np.ndarray,
    at: np.ndarray,
    value: np.ndarray,
    value_covariance: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """``estimate (n,)`` and ``covariance (n, n)`` of one flight, given what others know of its
    entries ``at (k,)``.

    ``value (k,)`` with ``value_covariance (k, k)`` is independent of this flight. The product of
    two Gaussians: over all flights it is the joint fit with the entries shared, as far as each
    likelihood is quadratic.
    """
    gain = covariance[:, at] @ np.linalg.inv(covariance[np.ix_(at, at)] + value_covariance)
    moved = estimate + gain @ (value - estimate[at])
    left = covariance - gain @ covariance[at, :]
    return moved, 0.5 * (left + left.T)


def without_one(
    value: np.ndarray, covariance: np.ndarray, own: np.ndarray, own_covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return a pooled ``value (k,)`` with ``covariance (k, k)`` without one of the flights in it;
    None if it was the only one.
    """
    information = np.linalg.inv(covariance) - np.linalg.inv(own_covariance)
    if np.linalg.eigvalsh(0.5 * (information + information.T))[0] <= 1e-9 * np.trace(
        np.linalg.inv(covariance)
    ):
        return None
    left = np.linalg.inv(information)
    return left @ (np.linalg.solve(covariance, value) - np.linalg.solve(own_covariance, own)), left


# ---- Multiple tests: false discovery rate


def adjusted_p_values(p_values: np.ndarray) -> np.ndarray:
    """Return ``p_values (n,)`` adjusted for their number: the smallest rate of false discoveries
    ``(n,)`` at which each hypothesis is rejected.

    Benjamini and Hochberg, J. Royal Statistical Society B 57(1), 1995: of those below a level, the
    expected share of false rejections is at most that level where the tests are independent or
    positively dependent.
    """
    p = np.asarray(p_values, dtype=float)
    n = len(p)
    if n == 0:
        return np.zeros(0)
    order = np.argsort(p, kind="stable")
    raised = p[order] * n / np.arange(1, n + 1)
    least = np.minimum.accumulate(raised[::-1])[::-1]
    out = np.empty(n)
    out[order] = np.minimum(least, 1.0)
    return out


# ---- A common value of estimates from many flights, with the scatter between flights

POOLED_CONFIDENCE = 0.95  # confidence of the interval of a common value


@dataclass(frozen=True)
class Pooled:
    """A common value.

    ``value`` with its standard deviation ``sigma``; ``low`` and ``high`` end its 95 % interval.
    ``scatter``: standard deviation of true values between flights. ``q``, ``p_same``: Cochran's
    statistic, and its p-value where all flights have one value. ``flights``: how many.
    """

    value: float
    sigma: float
    low: float
    high: float
    scatter: float
    q: float
    p_same: float
    flights: int


def pooled(values: np.ndarray, sigmas: np.ndarray) -> Pooled:
    """Pool ``values (n,)`` with standard deviations ``sigmas (n,)``, both finite, sigmas above
    zero.

    Random effects: ``values_i ~ N(mu, sigmas_i^2 + scatter^2)``; the scatter by restricted maximum
    likelihood (Viechtbauer, J. Educational and Behavioral Statistics 30(3), 2005), the sigma of
    ``mu`` by Hartung and Knapp (Statistics in Medicine 20, 2001), never below that of known scatter
    (Roever, Knapp and Friede, BMC Medical Research Methodology 15:99, 2015), its interval by
    Student's t with n - 1 degrees of freedom. The test of one value is Cochran's (Biometrics 10,
    1954), chi-squared with n - 1.
    """
    values, sigmas = np.asarray(values, dtype=float), np.asarray(sigmas, dtype=float)
    n = len(values)
    if n == 1:
        reach = 1.959964 * float(sigmas[0])
        return Pooled(
            float(values[0]),
            float(sigmas[0]),
            float(values[0]) - reach,
            float(values[0]) + reach,
            0.0,
            0.0,
            1.0,
            1,
        )
    design = np.ones((n, 1))
    scatter = scatter_between(values, sigmas, design)
    weight = 1.0 / (sigmas**2 + scatter**2)
    value = float(weight @ values / weight.sum())
    factor = max(1.0, float(weight @ (values - value) ** 2) / (n - 1))
    sigma = float(np.sqrt(factor / weight.sum()))
    reach = float(stdtrit(n - 1, 0.5 + 0.5 * POOLED_CONFIDENCE)) * sigma
    exact = 1.0 / sigmas**2
    q = float(exact @ (values - exact @ values / exact.sum()) ** 2)
    return Pooled(
        value, sigma, value - reach, value + reach, scatter, q, float(chdtrc(n - 1, q)), n
    )


def scatter_between(values: np.ndarray, sigmas: np.ndarray, design: np.ndarray) -> float:
    """Return the standard deviation between flights about ``design (n, c)`` times its coefficients,
    by restricted likelihood; zero where none shows.
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
        left = values - design @ np.linalg.solve(information, design.T @ (weight * values))
        return float(-np.log(weight).sum() + np.linalg.slogdet(information)[1] + weight @ left**2)

    # Of several minima the lowest: a grid brackets it, Brent's method finds it.
    grid = np.concatenate([[0.0], np.geomspace(1e-3, 3.0, 40) * largest])
    at = int(np.argmin([cost(each) for each in grid]))
    if at == 0:
        return 0.0
    low, high = grid[at - 1], grid[min(at + 1, len(grid) - 1)]
    solution = minimize_scalar(
        cost, bounds=(float(low), float(high)), method="bounded", options={"xatol": 1e-6 * largest}
    )
    return float(solution.x)


# ---- Flights whose value lies beyond the scatter of the others

NORMAL_QUARTILE = 0.6745  # upper quartile of a Gaussian, standard deviations
FALSE_DISCOVERY_RATE = 0.01  # rate of false discoveries among reported flights
FEWEST_FLIGHTS = 5  # flights: with fewer, the median is no measure of the others


def outlying_flights(residuals: np.ndarray, sigmas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return by how many standard deviations each flight is off ``(n,)``, and which flights are
    outliers ``(n,)``, from residuals ``(n,)`` about a common value.

    Residuals are taken from their median; the scatter between flights is what their median absolute
    deviation shows beyond ``sigmas (n,)``, so that the flights sought do not hide themselves
    (Rousseeuw and Croux, J. American Statistical Association 88, 1993). False ones are controlled
    over all flights.
    """
    n = len(residuals)
    if n < FEWEST_FLIGHTS:
        return np.zeros(n), np.zeros(n, dtype=bool)
    off = residuals - np.median(residuals)
    spread = float(np.median(np.abs(off))) / NORMAL_QUARTILE
    between = max(0.0, spread**2 - float(np.median(sigmas)) ** 2)
    far = off / np.sqrt(sigmas**2 + between)
    p_values = 2.0 * ndtr(-np.abs(far))
    return far, adjusted_p_values(p_values) < FALSE_DISCOVERY_RATE


# ---- A value that changes with the flight condition

# with three flights a line has one degree of freedom and no usable sigma
FEWEST_FLIGHTS_OF_TREND = 4


@dataclass(frozen=True, eq=False)
class Trend:
    """``value = at_middle + slope * (condition - middle)``.

    ``slope_sigma``: its standard deviation. ``covariance (2, 2)`` of value at the middle and slope.
    ``scatter``: standard deviation of the flights about the line. ``p_value``: of a slope so large
    where there is none.
    """

    middle: float
    at_middle: float
    slope: float
    slope_sigma: float
    covariance: np.ndarray
    scatter: float
    p_value: float

    def band(self, condition: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the line and its standard deviation, ``(k,)`` each, at conditions ``(k,)``."""
        away = np.stack([np.ones_like(condition), condition - self.middle])
        line = self.at_middle + self.slope * (condition - self.middle)
        return line, np.sqrt(np.einsum("ik,ij,jk->k", away, self.covariance, away))


def trend(values: np.ndarray, sigmas: np.ndarray, condition: np.ndarray) -> Trend | None:
    """Fit the change of ``values (n,)`` with ``sigmas (n,)`` over a ``condition (n,)``; None with
    fewer than ``FEWEST_FLIGHTS_OF_TREND`` flights or one condition alone.

    Mixed-effects meta-regression: scatter about the line by restricted maximum likelihood; the
    covariance by Knapp and Hartung (Statistics in Medicine 22, 2003), never below that of known
    scatter; Student's t with n - 2 degrees of freedom.
    """
    n = len(values)
    spread = float(np.ptp(condition)) if n else 0.0
    if n < FEWEST_FLIGHTS_OF_TREND or spread <= 1e-9 * max(1.0, float(np.max(np.abs(condition)))):
        return None
    middle = float(np.mean(condition))
    size = float(np.std(condition))
    design = np.stack([np.ones(n), (condition - middle) / size], axis=1)
    scatter = scatter_between(values, sigmas, design)
    weight = 1.0 / (sigmas**2 + scatter**2)
    inverse = np.linalg.inv(design.T @ (weight[:, None] * design))
    result = inverse @ (design.T @ (weight * values))
    left = values - design @ result
    inverse *= max(1.0, float(weight @ left**2) / (n - 2))
    sigma = float(np.sqrt(inverse[1, 1]))
    p_value = 2.0 * float(stdtr(n - 2, -abs(result[1]) / sigma))
    units = np.array([1.0, 1.0 / size])
    return Trend(
        middle,
        float(result[0]),
        float(result[1]) / size,
        sigma / size,
        inverse * np.outer(units, units),
        scatter,
        p_value,
    )


# ---- Recurring effects: in more than one flight with a common value

# probability of a false recurrence in a survey, over all candidates; chosen: once in three years of
# daily surveys
FALSE_RECURRENCE_PROBABILITY = 1e-3
# smallest probability that a flight has the effect; below 1 - MEMBERSHIP_PROBABILITY it has not
MEMBERSHIP_PROBABILITY = 0.95
# trial values of the scatter between flights, relative to the value
SCATTERS = (0.0, 0.03, 0.1, 0.2, 0.4, 0.8)
# largest loss of twice the log likelihood by one common value: chi-squared with one degree of
# freedom, exceeded by chance once in twenty (Wilks)
COMMON_VALUE_CHI_SQUARE = 3.84
MOST_ITERATIONS = 60
SETTLED_LOG_LIKELIHOOD = 1e-4  # change of log likelihood below which iterations end


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence of each of n flights for one effect with k parameters.

    ``gain (n,)`` of the log likelihood by the effect at its best values ``value (n, k)``, with
    ``covariance (n, k, k)``.
    """

    gain: np.ndarray
    value: np.ndarray
    covariance: np.ndarray

    def of(self, flights: np.ndarray) -> Evidence:
        """Return the evidence of some of the flights."""
        return Evidence(self.gain[flights], self.value[flights], self.covariance[flights])


@dataclass(frozen=True, eq=False)
class Recurrence:
    """Joint result of all flights for one effect.

    ``value (k,)`` with ``covariance (k, k)``: the common one. ``scatter``: between flights, as a
    share of the value; ``agrees``: none is needed. ``share``: of the flights that have it.
    ``probability (n,)`` that each has it. ``log_likelihood``: gained over no flight having it;
    ``at_common (n,)`` by each flight if it has the common value. ``p_value``: bound on the
    probability of such a gain, without that of the strongest flight, if no flight has any of the
    ``candidates``.
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
        return self.probability > MEMBERSHIP_PROBABILITY

    @property
    def has_not(self) -> np.ndarray:
        return self.probability < 1.0 - MEMBERSHIP_PROBABILITY

    @property
    def recurs(self) -> bool:
        """Whether it acts in two flights at least, beyond chance."""
        return int(self.has.sum()) >= 2 and self.p_value < FALSE_RECURRENCE_PROBABILITY

    @property
    def belongs(self) -> Literal["aircraft", "some flights", "no flight"]:
        """Whether the effect is the aircraft's: no flight excludes it."""
        if not self.recurs:
            return "no flight"
        return "some flights" if np.any(self.has_not) else "aircraft"


@dataclass(frozen=True, eq=False)
class _Mixture:
    value: np.ndarray
    scatter: float
    share: float
    total: float
    each: np.ndarray


def recurrence(evidence: Evidence, candidates: int = 1) -> Recurrence:
    """Judge one effect over the flights of ``evidence``, one of ``candidates`` that might have
    been.

    A flight has the effect with probability ``share``, its value then ``N(value, scatter^2
    value^2)``, or has it not. About its best the log likelihood of a flight is quadratic, so that
    integrated over its own value it gains ``gain - d' (C + T)^-1 d / 2 + ln(|C| / |C + T|) / 2``
    with ``d`` from its own to the common value. ``share``, ``value`` and scatter maximise the
    likelihood of all flights (expectation maximisation, Dempster, Laird and Rubin, J. Royal
    Statistical Society B 39, 1977).

    Where no flight has it, twice the gain is bounded by chi-squared with k + 1 degrees of freedom,
    two more for its start being chosen among the flights (``tests/unit/ident/pooling`` counts
    simulated nulls); times ``candidates`` (Bonferroni). The flight with the largest gain is left
    out, so that no single flight makes a recurrence.
    """
    n, k = evidence.value.shape
    best = _most_likely(evidence)
    without_scatter = best if best.scatter == 0.0 else _most_likely(evidence, (0.0,))
    agrees = 2.0 * (best.total - without_scatter.total) < COMMON_VALUE_CHI_SQUARE
    best = without_scatter if agrees else best
    own = np.log1p(best.share * np.expm1(np.clip(best.each, -700.0, 700.0)))
    probability = expit(best.each + _logit(np.array(best.share)))
    others = np.delete(np.arange(n), int(np.argmax(own)))
    left = 2.0 * _most_likely(evidence.of(others)).total if n > 1 else 0.0
    p_value = min(1.0, candidates * float(chdtrc(k + 3, max(left, 0.0))))
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
        best.each,
        p_value,
    )


def _most_likely(evidence: Evidence, scatters: tuple[float, ...] = SCATTERS) -> _Mixture:
    """Return the most likely common value: started from the values of the flights with most
    evidence, and their mean, with each scatter.
    """
    largest = np.argsort(-evidence.gain)[:4]
    starts = np.array(
        [
            *evidence.value[largest],
            np.average(evidence.value, axis=0, weights=np.maximum(evidence.gain, 1e-12)),
        ]
    )
    return _maximised(
        evidence, np.tile(starts, (len(scatters), 1)), np.repeat(scatters, len(starts))
    )


def _maximised(evidence: Evidence, value: np.ndarray, scatter: np.ndarray) -> _Mixture:
    """Return the best of c searches at once, from ``value (c, k)`` with ``scatter (c,)``."""
    share, total = np.full(len(value), 0.5), np.full(len(value), -np.inf)
    each, inverse = _gains_at(evidence, value, scatter)
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
        each, inverse = _gains_at(evidence, value, scatter)
        before, total = (
            total,
            np.logaddexp(np.log1p(-share)[:, None], np.log(share)[:, None] + each).sum(axis=1),
        )
        if np.all(np.abs(total - before) < SETTLED_LOG_LIKELIHOOD):
            break
    best = int(np.argmax(total))
    return _Mixture(
        value[best], float(scatter[best]), float(share[best]), float(total[best]), each[best]
    )


def _gains_at(
    evidence: Evidence, value: np.ndarray, scatter: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the gain of each flight's log likelihood ``(c, n)`` with the effect about common
    values ``(c, k)``, and inverses ``(c, n, k, k)``.
    """
    added = (scatter[:, None] * value)[:, :, None] ** 2 * np.eye(value.shape[1])
    wide = evidence.covariance + added[:, None]
    inverse = np.linalg.inv(wide)
    away = evidence.value - value[:, None]
    squared = np.einsum("cni,cnij,cnj->cn", away, inverse, away)
    shrunk = np.linalg.slogdet(evidence.covariance)[1] - np.linalg.slogdet(wide)[1]
    return evidence.gain - 0.5 * squared + 0.5 * shrunk, inverse


def _logit(share: np.ndarray) -> np.ndarray:
    return np.asarray(np.log(share) - np.log1p(-share))
