"""Parameters of a linear model fitted to several frequency responses at once.

Cost, Cramer-Rao bounds and insensitivities: Tischler and Remple, "Aircraft and Rotorcraft System
Identification", 2nd edition, AIAA 2012, chapters 12 and 13. With the Hessian H of the sum of the
costs, the bound of a parameter is 2 sqrt((H^-1)_ii) and its insensitivity 1/sqrt(H_ii). The cost is
no likelihood; the deviations beside them are those of the minimiser under the errors of the
responses, correlated between neighbouring frequencies as the windows are.
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

Responses = Callable[[Mapping[str, float]], Sequence[np.ndarray]]
SPREAD = (1.0, 0.7, 1.4)  # factors of the starting values from which the search begins
_FURTHEST = 1e6


@dataclass(frozen=True, eq=False)
class ModelFit:
    """A linear model fitted to responses.

    Attributes
    ----------
    names, values, start : of the free parameters, ``(q,)``.
    covariance : ``(q, q)``, under the errors of the responses.
    cramer_rao, insensitivity : ``(q,)``, Tischler's.
    fixed : values that were held.
    costs : of each response; ``cost`` their mean.
    responses : of the fitted model at the targets' frequencies.
    converged : the search ended.
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
        """Standard deviations ``(q,)``."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    @property
    def cost(self) -> float:
        """Mean of the costs."""
        return float(np.mean(self.costs))

    @property
    def as_dict(self) -> dict[str, float]:
        """All parameters, free and fixed."""
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
    responses : from all parameters the complex responses at the targets' frequencies, in their
        order.
    start : of the free parameters; each is searched for from itself, 0.7 and 1.4 times itself.
    fixed : values that are held.
    low : least values of some.

    Raises
    ------
    ModelError : nothing is free, fewer numbers than parameters, no finite response at the start.
    """
    from scipy.optimize import least_squares

    names = tuple(start)
    count = 2 * sum(target.omega.size for target in targets)
    if not names or count <= len(names):
        what = f"{len(names)} free parameters for {count} numbers"
        raise ModelError(what, where="fit", remedy="free a parameter, or fit more responses")

    def of(p: np.ndarray) -> Sequence[np.ndarray]:
        return responses({**fixed, **dict(zip(names, p.tolist(), strict=True))})

    def residuals(p: np.ndarray) -> np.ndarray:
        try:
            with np.errstate(all="ignore"):
                ratios = [
                    np.log(model / target.response)
                    for model, target in zip(of(p), targets, strict=True)
                ]
        except (ModelError, ArithmeticError, np.linalg.LinAlgError):
            return np.full(count, _FURTHEST)
        return weighted_errors(targets, ratios)

    begin = np.array([start[name] for name in names])
    bounds = np.array([(low or {}).get(name, -np.inf) for name in names])
    best, least, ended = begin, math.inf, False
    for factor in SPREAD:
        p = np.maximum(factor * begin, np.where(np.isfinite(bounds), bounds + 1e-6, -np.inf))
        scale = np.maximum(np.abs(p), 1e-2)
        solution = least_squares(residuals, p, bounds=(bounds, np.inf), x_scale=scale, max_nfev=200)
        if solution.cost < least * (1.0 - 1e-6):
            best, least, ended = solution.x, float(solution.cost), solution.status > 0
    if least >= 0.5 * _FURTHEST**2:
        what = "the model has no finite responses at its starting values"
        raise ModelError(what, where="fit", remedy="check them in the vehicle file")
    slopes = _slopes(residuals, best)
    hessian = 2.0 * slopes.T @ slopes
    inverse = _inverse(hessian)
    gains = 2.0 * inverse @ slopes.T
    return ModelFit(
        names,
        best,
        begin,
        gains @ weighted_noise(targets) @ gains.T,
        2.0 * np.sqrt(np.maximum(np.diag(inverse), 0.0)),
        1.0 / np.sqrt(np.maximum(np.diag(hessian), 1e-300)),
        dict(fixed),
        tuple(
            mismatch_cost(target.response, model, target.coherence)
            for target, model in zip(targets, of(best), strict=True)
        ),
        tuple(np.asarray(each) for each in of(best)),
        ended,
    )


def _slopes(residuals: Callable[[np.ndarray], np.ndarray], p: np.ndarray) -> np.ndarray:
    """Return the derivatives ``(R, q)`` of the residuals by central differences."""
    columns = []
    for k, value in enumerate(p):
        step = 1e-5 * max(abs(value), 1e-2)
        ends = []
        for sign in (1.0, -1.0):
            moved = p.copy()
            moved[k] += sign * step
            ends.append(residuals(moved))
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    return np.array(columns).T


def _inverse(matrix: np.ndarray) -> np.ndarray:
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix / np.outer(scale, scale)
    return np.asarray(np.linalg.pinv(scaled, rcond=1e-12, hermitian=True) / np.outer(scale, scale))
