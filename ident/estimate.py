"""Result of an estimator: parameters with covariance, history, likelihood and outcome."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

LARGEST_NUMBER = 1e100  # largest number whose squares and sums are finite


class Outcome(Enum):
    """Outcome of an estimation. The value of each member is the sentence that reports print."""

    CONVERGED = "converged"
    AT_BOUND = "converged; a parameter is at its bound and has no sigma"
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


_BETTER_START = (
    "start nearer to the solution: copy the values of --method equation-error into the vehicle "
    "file, or fit a shorter part of the record with --from and --to"
)
_HINTS = {
    "AT_BOUND": (
        "it is held at the bound, and the other sigmas do not include its error: widen [bounds] "
        "if the bound is a guess, or look for an effect that the model lacks"
    ),
    "MAX_ITERATIONS": _BETTER_START,
    "DIVERGED": _BETTER_START,
    "INDEFINITE": (
        "use --method output-error, which needs no state covariance, and works on a record "
        "without noise"
    ),
    "NOT_IDENTIFIABLE": "fly a maneuver that excites the undetermined parameters, or fix them",
    "DEGENERATE": (
        "compare with --method output-error and equation-error, and check whether a channel is "
        "computed from others, filtered or constant"
    ),
}


@dataclass(frozen=True, eq=False, repr=False)
class FilterHistory:
    """History of a filter (N samples, n states and free parameters, m outputs).

    Attributes
    ----------
    time : ``(N,)`` s.
    names : names of the n states, then of the free parameters.
    mean, std : ``(n, N)`` estimates and standard deviations after each update.
    innovation, innovation_std : ``(m, N)`` measured minus predicted output, and its standard
        deviation. Where a sample is missing, the innovation is zero and the deviation one.
    valid : ``(m, N)`` False where a sample is missing.
    log_likelihood : ``(N,)`` log likelihood of each sample given the samples before.
    nis, degrees : ``(N,)`` normalised innovation squared, and its degrees of freedom: the number of
        channels with a valid sample.
    predicted_mean, predicted_covariance : ``(n, N)`` and ``(N, n, n)`` estimates and their
        covariance before each update.
    covariance : ``(N, n, n)`` covariance of the estimates after each update.
    transition : ``(N, n, n)`` fundamental matrix from sample k - 1 to sample k.
    sensitivity : ``(N, m, n)`` Jacobian of the outputs; rows of missing samples are zero.
    innovation_covariance : ``(N, m, m)``; the rows of missing samples are those of the identity
        matrix.
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
    method : name of the method, for example ``"ekf"`` or ``"output-error"``.
    names, units : names and units of the n free parameters.
    values, covariance : ``(n,)`` and ``(n, n)``; finite for every outcome.
    outcome : how the estimation ended.
    log_likelihood : log likelihood of all data: from the innovations of a filter, or from the
        residuals of a whole-record fit.
    output_names, noise_std : names of the m outputs, and ``(m,)`` standard deviations of their
        noise, assumed or estimated.
    fitted : ``(m, N)`` fitted outputs of each record. A filter's fitted outputs are its one-step
        predictions. After a breakdown of the filter, the last finite prediction is repeated.
    history : history of a filter; None for whole-record methods.
    iterations : number of passes over the data.
    message : further remark on the outcome; usually empty.
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
        """Return the value of a parameter."""
        return float(self.values[self.names.index(name)])

    def sigma(self, name: str) -> float:
        """Return the standard deviation of a parameter."""
        return float(self.std[self.names.index(name)])

    def only(self, names: Collection[str]) -> Estimate:
        """Return this estimate without the parameters that are not in ``names``."""
        positions = [i for i, name in enumerate(self.names) if name in names]
        return replace(
            self,
            names=tuple(self.names[i] for i in positions),
            units=tuple(self.units[i] for i in positions),
            values=self.values[positions],
            covariance=self.covariance[np.ix_(positions, positions)],
        )

    def as_dict(self) -> dict[str, float]:
        """Return name -> value of the parameters, as ``Model.with_values`` takes them."""
        return {name: float(value) for name, value in zip(self.names, self.values, strict=True)}


@contextmanager
def quiet_numerics() -> Iterator[None]:
    """Suppress warnings of overflow and of ill-conditioned matrices inside a ``with`` block. The
    caller must then test the result with ``ident.filters.problem.breakdown``.
    """
    from scipy.linalg import LinAlgWarning

    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", LinAlgWarning)
        yield


@contextmanager
def overflow_tolerated() -> Iterator[None]:
    """Suppress the NumPy warnings inside a ``with`` block whose code handles overflows itself.

    An enclosing ``np.errstate(call=...)``, which counts overflows, still receives them.
    """
    with np.errstate(all="ignore" if np.geterrcall() is None else "call", under="ignore"):
        yield
