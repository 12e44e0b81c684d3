"""Whether an effect recurs: acts in more than one flight, with one value, and in which."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import chdtrc, expit

CHANCE = 1e-3  # of a false recurrence in a survey, over all candidates. chosen: a page of every morning tells a false one once in three years
SURE = 0.95  # probability from which a flight is said to have the effect, and below 1 - SURE not to have it
SCATTERS = (0.0, 0.03, 0.1, 0.2, 0.4, 0.8)  # of the value, between flights, that are tried
AGREES = 3.84  # twice the log likelihood: theorem, chi-squared with one degree of freedom, one in twenty
ROUNDS, SETTLED = 60, 1e-4  # of log likelihood: far below what decides


@dataclass(frozen=True, eq=False)
class Evidence:
    """What each of n flights says of one effect with k parameters.

    ``gain (n,)``: of the log likelihood by the effect at its best; ``value (n, k)`` there, ``covariance (n, k, k)`` of it.
    """

    gain: np.ndarray
    value: np.ndarray
    covariance: np.ndarray

    def of(self, flights: np.ndarray) -> Evidence:
        """That of some of the flights."""
        return Evidence(self.gain[flights], self.value[flights], self.covariance[flights])


@dataclass(frozen=True, eq=False)
class Recurrence:
    """What all flights say of an effect together.

    ``value (k,)`` with ``covariance (k, k)``: the common one. ``scatter``: between flights, as a share of the value; ``agrees``: none is needed.
    ``share``: of the flights that have it. ``probability (n,)`` that each has it. ``log_likelihood``: gained over no flight having it; ``at_common
    (n,)`` by each flight if it has the common value. ``p_value``: bound on the chance of as much where no flight has it, its strongest left
    out, over all ``candidates``.
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
        return self.probability > SURE

    @property
    def has_not(self) -> np.ndarray:
        return self.probability < 1.0 - SURE

    @property
    def recurs(self) -> bool:
        """Whether it acts in two flights at least, beyond chance."""
        return int(self.has.sum()) >= 2 and self.p_value < CHANCE

    @property
    def belongs(self) -> Literal["aircraft", "some flights", "no flight"]:
        """Whose it is: the aircraft's where no flight excludes it."""
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
    """Judge one effect over the flights of ``evidence``, one of ``candidates`` that might have been.

    A flight has the effect with probability ``share``, its value then ``N(value, scatter^2 value^2)``, or has it not. About its best the
    log likelihood of a flight is quadratic, so that integrated over its own value it gains ``gain - d' (C + T)^-1 d / 2 + ln(|C| / |C +
    T|) / 2`` with ``d`` from its own to the common value. ``share``, ``value`` and scatter maximise the likelihood of all flights (expectation
    maximisation, Dempster, Laird and Rubin, J. Royal Statistical Society B 39, 1977).

    Where no flight has it, twice the gain is bounded by chi-squared with k + 1 degrees of freedom, two more for its start being chosen among the
    flights (``tests/unit/ident/pooling`` counts simulated nulls); times ``candidates`` (Bonferroni). The flight that speaks
    loudest takes no part in this, so that no single flight makes a recurrence.
    """
    n, k = evidence.value.shape
    best = _best(evidence)
    plain = best if best.scatter == 0.0 else _best(evidence, (0.0,))
    agrees = 2.0 * (best.total - plain.total) < AGREES
    best = plain if agrees else best
    own = np.log1p(best.share * np.expm1(np.clip(best.each, -700.0, 700.0)))
    probability = expit(best.each + _logit(np.array(best.share)))
    others = np.delete(np.arange(n), int(np.argmax(own)))
    left = 2.0 * _best(evidence.of(others)).total if n > 1 else 0.0
    p_value = min(1.0, candidates * float(chdtrc(k + 3, max(left, 0.0))))
    added = best.scatter**2 * np.diag(best.value**2)
    weights = probability[:, None, None] * np.linalg.inv(evidence.covariance + added)
    information = weights.sum(axis=0)
    covariance = np.linalg.pinv(information)
    return Recurrence(best.value, covariance, best.scatter, agrees, best.share, probability, best.total, best.each, p_value)


def _best(evidence: Evidence, scatters: tuple[float, ...] = SCATTERS) -> _Mixture:
    """The likeliest common value: from the values of the flights that say most, and their mean, with each scatter."""
    told = np.argsort(-evidence.gain)[:4]
    starts = np.array([*evidence.value[told], np.average(evidence.value, axis=0, weights=np.maximum(evidence.gain, 1e-12))])
    return _maximised(evidence, np.tile(starts, (len(scatters), 1)), np.repeat(scatters, len(starts)))


def _maximised(evidence: Evidence, value: np.ndarray, scatter: np.ndarray) -> _Mixture:
    """The best of c searches at once, from ``value (c, k)`` with ``scatter (c,)``."""
    share, total = np.full(len(value), 0.5), np.full(len(value), -np.inf)
    each, inverse = _at(evidence, value, scatter)
    for _ in range(ROUNDS):
        probability = expit(each + _logit(share)[:, None])
        weights = probability[:, :, None, None] * inverse
        found = np.einsum("cij,cj->ci", np.linalg.pinv(weights.sum(axis=1)), np.einsum("cnij,nj->ci", weights, evidence.value))
        value = np.where(probability.sum(axis=1)[:, None] > 1e-9, found, value)
        share = np.clip(probability.mean(axis=1), 1e-9, 1.0 - 1e-9)
        each, inverse = _at(evidence, value, scatter)
        before, total = total, np.logaddexp(np.log1p(-share)[:, None], np.log(share)[:, None] + each).sum(axis=1)
        if np.all(np.abs(total - before) < SETTLED):
            break
    best = int(np.argmax(total))
    return _Mixture(value[best], float(scatter[best]), float(share[best]), float(total[best]), each[best])


def _at(evidence: Evidence, value: np.ndarray, scatter: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What each flight's log likelihood gains ``(c, n)`` where it has the effect about common values ``(c, k)``, and inverses ``(c, n, k, k)``."""
    added = (scatter[:, None] * value)[:, :, None] ** 2 * np.eye(value.shape[1])
    wide = evidence.covariance + added[:, None]
    inverse = np.linalg.inv(wide)
    away = evidence.value - value[:, None]
    squared = np.einsum("cni,cnij,cnj->cn", away, inverse, away)
    shrunk = np.linalg.slogdet(evidence.covariance)[1] - np.linalg.slogdet(wide)[1]
    return evidence.gain - 0.5 * squared + 0.5 * shrunk, inverse


def _logit(share: np.ndarray) -> np.ndarray:
    return np.asarray(np.log(share) - np.log1p(-share))
