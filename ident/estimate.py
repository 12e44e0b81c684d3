"""Result of an estimator: parameters with covariance, histories, likelihood, outcome."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

LARGEST_NUMBER = 1e100  # largest number whose squares and sums are finite


class Outcome(Enum):
    """Outcome of an estimation; the value is the sentence to print."""

    CONVERGED = "converged"
    AT_BOUND = "converged; a parameter stands at its bound and has no sigma"
    MAX_ITERATIONS = "stopped at the iteration limit before the estimate settled"
    DIVERGED = "diverged: the state or its covariance left the range of finite numbers"
    INDEFINITE = "the covariance lost its positive definiteness"
    NOT_IDENTIFIABLE = "the record does not determine all parameters"
    DEGENERATE = (
        "degenerate: a noise level ran to its limit, where the likelihood has no true maximum; "
        "values and sigmas mean nothing"
    )

    @property
    def code(self) -> str:
        """Short name for files, e.g. ``"converged"``, ``"not-identifiable"``."""
        return self.name.lower().replace("_", "-")

    @property
    def hint(self) -> str:
        """Advice to the user; empty if none is needed."""
        return _HINTS.get(self.name, "")


_HINTS = {
    "AT_BOUND": (
        "it is held there, and sigmas are those of the others: widen [bounds] where the bound is a "
        "guess, or look for what the model lacks"
    ),
    "MAX_ITERATIONS": (
        "begin nearer: take the values of --method equation-error into the vehicle file, or a "
        "shorter part with --from and --to"
    ),
    "DIVERGED": (
        "begin nearer: take the values of --method equation-error into the vehicle file, or a "
        "shorter part with --from and --to"
    ),
    "INDEFINITE": (
        "use --method output-error, which has no covariance to lose, and works on a record "
        "without noise"
    ),
    "NOT_IDENTIFIABLE": "excite in flight what is not determined, or hold that parameter",
    "DEGENERATE": (
        "compare with --method output-error and equation-error, and look whether a channel is "
        "computed, filtered or stuck"
    ),
}


@dataclass(frozen=True, eq=False, repr=False)
class FilterHistory:
    """History of a filter (N samples, n states and free parameters, m outputs).

    Attributes
    ----------
    time : ``(N,)`` s.
    names : the ``n`` states, then free parameters.
    mean, std : after each update, ``(n, N)``.
    innovation, innovation_std : measured minus predicted and its standard deviation, ``(m, N)``;
        zero and one where the sample is missing.
    valid : ``(m, N)`` samples used.
    log_likelihood : ``(N,)`` of each sample given its past.
    nis, degrees : ``(N,)`` normalised innovation squared and the number of channels in it.
    predicted_mean, predicted_covariance, covariance, transition : ``(n, N)`` and ``(N, n, n)``, for
        smoothers; ``transition[k]`` leads from sample ``k - 1`` to ``k``.
    sensitivity, innovation_covariance : ``(N, m, n)`` and ``(N, m, m)``, for smoothers; rows of
        missing samples are zero in the first, and of the unit matrix in the second.
    """

    time: np.ndarray
    names: tuple[str, ...]
    mean: np.ndarray
    std: np.ndarray
    innovation: np.ndarray
    innovation_std: np.ndarray
    valid: np.ndarray
    log_likelihood: np.ndarray
    nis: np.ndarray
    degrees: np.ndarray
    predicted_mean: np.ndarray
    predicted_covariance: np.ndarray
    covariance: np.ndarray
    transition: np.ndarray
    sensitivity: np.ndarray
    innovation_covariance: np.ndarray

    def __repr__(self) -> str:
        return (
            f"<FilterHistory: {len(self.names)} states and parameters over {self.time.size} "
            "samples>"
        )


@dataclass(frozen=True, eq=False, repr=False)
class Estimate:
    """Parameters estimated from one or several records.

    Attributes
    ----------
    method : ``"ekf"``, ``"output-error"``, ...
    names, units : of the free parameters, length ``n``.
    values, covariance : ``(n,)`` and ``(n, n)``; finite whatever the outcome.
    outcome : how the estimation ended.
    log_likelihood : total; of the innovations for a filter, of the residuals for a whole-record
        fit.
    output_names, noise_std : outputs used and the measurement noise assumed or estimated.
    fitted : estimator's output at the samples of each record, ``(m, N)`` each; of a filter its
        prediction from the past, held at the last finite sample if it failed.
    history : of a filter; None for whole-record methods.
    iterations : passes over the data.
    message : what else is to be said about the outcome; usually empty.
    """

    method: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    outcome: Outcome
    log_likelihood: float
    output_names: tuple[str, ...]
    noise_std: np.ndarray
    fitted: tuple[np.ndarray, ...]
    history: FilterHistory | None = None
    iterations: int = 1
    message: str = ""

    def __repr__(self) -> str:
        return (
            f"<Estimate by {self.method}, {self.outcome.code}: "
            f"{', '.join(self.names[:12])}{', ...' if len(self.names) > 12 else ''}>"
        )

    @property
    def std(self) -> np.ndarray:
        """Standard deviations, ``(n,)``."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> np.ndarray:
        """Correlation matrix, ``(n, n)``."""
        std = self.std
        return self.covariance / np.outer(std, std)

    def value(self, name: str) -> float:
        return float(self.values[self.names.index(name)])

    def sigma(self, name: str) -> float:
        return float(self.std[self.names.index(name)])

    def only(self, names: Collection[str]) -> Estimate:
        """Return the estimate of the parameters ``names`` only."""
        at = [i for i, name in enumerate(self.names) if name in names]
        kept, units = tuple(self.names[i] for i in at), tuple(self.units[i] for i in at)
        return replace(
            self,
            names=kept,
            units=units,
            values=self.values[at],
            covariance=self.covariance[np.ix_(at, at)],
        )

    def as_dict(self) -> dict[str, float]:
        """Return the values by name, for ``Model.with_values``."""
        return {name: float(value) for name, value in zip(self.names, self.values, strict=True)}


@contextmanager
def quiet_numerics() -> Iterator[None]:
    """Suppress warnings of overflow and ill condition; the caller tests the result with
    ``ident.filters.problem.breakdown``.
    """
    from scipy.linalg import LinAlgWarning

    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", LinAlgWarning)
        yield


@contextmanager
def counted_numerics() -> Iterator[None]:
    """Suppress the NumPy warnings of a computation that discards overflows itself.

    A caller that counts them by ``np.errstate(call=...)`` still does.
    """
    with np.errstate(all="ignore" if np.geterrcall() is None else "call", under="ignore"):
        yield
