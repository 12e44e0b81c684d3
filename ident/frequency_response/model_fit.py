"""Parameters of a linear model fitted to several frequency responses at once, and the envelopes of
added dynamics that pilots do not notice.

Cost, Cramer-Rao bounds and insensitivities are those of Tischler and Remple, "Aircraft and
Rotorcraft System Identification", 2nd edition, AIAA 2012, chapters 12 and 13. With the Hessian H of
the sum of the costs, the bound of a parameter is 2 sqrt((H^-1)_ii) and its insensitivity is
1/sqrt(H_ii). Since the cost is no likelihood, standard deviations are computed separately: the
errors of the responses, which are correlated between neighbouring frequencies, are propagated to
the estimate.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.frequency_response.transfer_function import (
    ResponseTarget,
    mismatch_cost,
    weighted_errors,
    weighted_noise,
)
from sim.errors import ModelError

# ---- Fit of a linear model

Responses = Callable[[Mapping[str, float]], Sequence[np.ndarray]]
SPREAD = (1.0, 0.7, 1.4)  # factors of the starting values: one search begins from each
_LARGEST_ERROR = 1e6  # weighted error where the model has no response
_MOST_EVALUATIONS = 200  # most evaluations of one search
_LEAST_IMPROVEMENT = 1e-6  # smallest relative decrease of the cost by a later search
_RELATIVE_STEP, _SMALLEST_SCALE = 1e-5, 1e-2  # of differences with respect to a parameter


@dataclass(frozen=True, eq=False)
class ModelFit:
    """A linear model fitted to frequency responses.

    Attributes
    ----------
    names : names of the q free parameters.
    values : ``(q,)`` estimates.
    start : ``(q,)`` starting values.
    covariance : ``(q, q)`` covariance of the estimates from the errors of the responses.
    cramer_rao, insensitivity : ``(q,)`` Tischler's measures.
    fixed : fixed parameter -> value.
    costs : Tischler's cost of each response.
    responses : ``(F,)`` each, responses of the fitted model at the frequencies of the targets.
    converged : whether the search ended at a minimum.
    """

    names: tuple[str, ...]
    values: np.ndarray
    start: np.ndarray
    covariance: np.ndarray
    cramer_rao: np.ndarray
    insensitivity: np.ndarray
    fixed: Mapping[str, float]
    costs: tuple[float, ...]
    responses: tuple[np.ndarray, ...]
    converged: bool

    @property
    def std(self) -> np.ndarray:
        """Standard deviations ``(q,)`` of the estimates."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    @property
    def cost(self) -> float:
        """Mean cost of the responses."""
        return float(np.mean(self.costs))

    @property
    def as_dict(self) -> dict[str, float]:
        """Parameter -> value, of all parameters, free and fixed."""
        return {**self.fixed, **dict(zip(self.names, self.values.tolist(), strict=True))}


def fit_model(
    targets: Sequence[ResponseTarget],
    responses: Responses,
    start: Mapping[str, float],
    fixed: Mapping[str, float],
    low: Mapping[str, float] | None = None,
) -> ModelFit:
    """Fit the free parameters of a model to all targets together.

    Parameters
    ----------
    targets : measured responses.
    responses : function that returns the complex responses of the model, in the order and at the
        frequencies of the targets, for given values of all parameters.
    start : free parameter -> starting value. Searches begin from all starting values times each
        factor of ``SPREAD``.
    fixed : fixed parameter -> value.
    low : parameter -> lower bound.

    Raises
    ------
    ModelError : if no parameter is free, if there are fewer numbers than parameters, or if the
        model has no finite response at the starting values.
    """
    names = tuple(start)
    count = 2 * sum(target.omega.size for target in targets)
    if not names or count <= len(names):
        what = f"{len(names)} free parameters for {count} numbers"
        raise ModelError(what, where="fit", remedy="free a parameter, or fit more responses")

    def model_responses(p: np.ndarray) -> Sequence[np.ndarray]:
        return responses({**fixed, **dict(zip(names, p.tolist(), strict=True))})

    def residuals(p: np.ndarray) -> np.ndarray:
        try:
            with np.errstate(all="ignore"):
                log_ratios = [
                    np.log(model / target.response)
                    for model, target in zip(model_responses(p), targets, strict=True)
                ]
        except (ModelError, ArithmeticError, np.linalg.LinAlgError):
            return np.full(count, _LARGEST_ERROR)
        return weighted_errors(targets, log_ratios)

    starting_values = np.array([start[name] for name in names])
    lowest = np.array([(low or {}).get(name, -np.inf) for name in names])
    best, least, converged = _minimum(residuals, starting_values, lowest)
    if least >= 0.5 * _LARGEST_ERROR**2:
        what = "the model has no finite responses at its starting values"
        raise ModelError(what, where="fit", remedy="check them in the vehicle file")
    slopes = _slopes(residuals, best)
    hessian = 2.0 * slopes.T @ slopes
    inverse = _inverse(hessian)
    gains = 2.0 * inverse @ slopes.T
    fitted_responses = model_responses(best)
    return ModelFit(
        names,
        best,
        starting_values,
        gains @ weighted_noise(targets) @ gains.T,
        2.0 * np.sqrt(np.maximum(np.diag(inverse), 0.0)),
        1.0 / np.sqrt(np.maximum(np.diag(hessian), 1e-300)),
        dict(fixed),
        tuple(
            mismatch_cost(target.response, model, target.coherence)
            for target, model in zip(targets, fitted_responses, strict=True)
        ),
        tuple(np.asarray(response) for response in fitted_responses),
        converged,
    )


def _minimum(
    residuals: Callable[[np.ndarray], np.ndarray], starting_values: np.ndarray, lowest: np.ndarray
) -> tuple[np.ndarray, float, bool]:
    """Return the parameters of least cost by searches from the starting values times each factor of
    ``SPREAD``, half of their sum of squared residuals, and whether the search converged.

    ``lowest (q,)`` are lower bounds.
    """
    from scipy.optimize import least_squares

    lowest_start = np.where(np.isfinite(lowest), lowest + 1e-6, -np.inf)
    best, least, converged = starting_values, math.inf, False
    for factor in SPREAD:
        p = np.maximum(factor * starting_values, lowest_start)
        scale, most = np.maximum(np.abs(p), _SMALLEST_SCALE), _MOST_EVALUATIONS
        solution = least_squares(
            residuals, p, bounds=(lowest, np.inf), x_scale=scale, max_nfev=most
        )
        if solution.cost < least * (1.0 - _LEAST_IMPROVEMENT):
            best, least, converged = solution.x, float(solution.cost), solution.status > 0
    return best, least, converged


def _slopes(residuals: Callable[[np.ndarray], np.ndarray], p: np.ndarray) -> np.ndarray:
    """Return the derivatives ``(R, q)`` of the residuals by central differences."""
    columns = []
    for k, value in enumerate(p):
        step = _RELATIVE_STEP * max(abs(value), _SMALLEST_SCALE)
        above, below = p.copy(), p.copy()
        above[k] += step
        below[k] -= step
        columns.append((residuals(above) - residuals(below)) / (2.0 * step))
    return np.array(columns).T


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Return the pseudo-inverse ``(q, q)`` of a symmetric matrix, scaled to a unit diagonal."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix / np.outer(scale, scale)
    return np.asarray(np.linalg.pinv(scaled, rcond=1e-12, hermitian=True) / np.outer(scale, scale))


# ---- Envelopes of added dynamics that pilots do not notice


@dataclass(frozen=True, eq=False)
class Envelopes:
    """Envelopes of maximum unnoticeable added dynamics, ``(F,)`` each, in dB and deg."""

    low_gain: np.ndarray
    high_gain: np.ndarray
    low_phase: np.ndarray
    high_phase: np.ndarray


PILOT_BAND = (0.1, 10.0)  # rad/s, frequencies of a pilot's control, at which the envelopes apply
# Numerator and denominator in s, highest power first, of the lower and upper curve, by Hodgkinson
# and Wood (McDonnell Douglas), as in MIL-STD-1797A. Some prints also have short delays in the phase
# curves, which widen the envelope by up to 4 deg at 10 rad/s.
_GAINS = (([0.0955, 9.92, 2.15], [1.0, 11.60, 4.95]), ([3.16, 31.61, 22.79], [1.0, 27.14, 1.84]))
_PHASES = (
    ([475.32, 184100.0, 29460.0], [1.0, 11.66, 0.0389]),
    ([68.89, 1100.12, -275.22], [1.0, 39.94, 9.99]),
)


def unnoticeable_envelopes(omega: np.ndarray) -> Envelopes:
    """Return the envelopes of added dynamics that pilots do not notice, at ``omega``, rad/s.

    Wood and Hodgkinson, "Definition of Acceptable Levels of Mismatch for Equivalent Systems of
    Augmented CTOL Aircraft", MDC A6792, McDonnell Douglas 1980; MIL-STD-1797A.
    """
    s = 1j * np.asarray(omega)

    def curve(numerator: list[float], denominator: list[float]) -> np.ndarray:
        return np.asarray(np.polyval(numerator, s) / np.polyval(denominator, s))

    gains = [20.0 * np.log10(np.abs(curve(*polynomials))) for polynomials in _GAINS]
    phases = [np.degrees(np.angle(curve(*polynomials))) for polynomials in _PHASES]
    return Envelopes(gains[0], gains[1], phases[0], phases[1])
