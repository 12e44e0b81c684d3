"""What is random in the data of a whole-record fit: by default white noise whose variances are concentrated out.

A NoiseModel turns residuals and sensitivities into those of independent samples. It may have unknowns of its own, which stand
behind those of the layout in theta. `ident.process_noise.innovations_model` is the one with a Kalman filter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ident.whole_record.linearise import Linearisation
from ident.whole_record.record_problem import RecordProblem
from sim.declaration.model import System


class LaidOut(Protocol):
    """What a noise model reads of a layout; `ident.whole_record.layout.FitLayout` has it."""

    @property
    def system(self) -> System: ...
    @property
    def problems(self) -> tuple[RecordProblem, ...]: ...
    @property
    def order(self) -> tuple[int, ...]: ...
    @property
    def low(self) -> np.ndarray: ...
    @property
    def high(self) -> np.ndarray: ...
    @property
    def used(self) -> np.ndarray: ...
    @property
    def smallest(self) -> np.ndarray: ...
    def columns(self, r: int) -> np.ndarray: ...
    def split(self, theta: np.ndarray, r: int) -> tuple[np.ndarray, np.ndarray]: ...


class ResidualFilter(Protocol):
    """What makes the residuals of one record independent."""

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Columns ``(m, N, c)`` in the outputs' units as those of independent samples of variance one, zero where a sample is missing."""
        ...


@dataclass(frozen=True, eq=False)
class WeightedResiduals:
    """Residuals and sensitivities of each record as those of independent samples.

    Attributes
    ----------
    residuals, jacobians : ``(m, N)`` and ``(m, N, c)`` a record; residuals are zero where a sample is missing.
    variance : ``(m,)`` of the residuals.
    cost : minus the log likelihood, without 0.5 (1 + ln 2 pi) a sample.
    filters : one a record, for further columns.
    """

    residuals: tuple[np.ndarray, ...]
    jacobians: tuple[np.ndarray, ...]
    variance: np.ndarray
    cost: float
    filters: tuple[ResidualFilter, ...]


class NoiseModel(Protocol):
    """The model of what is random in the data.

    ``names``, ``start``, ``low``, ``high`` describe its own unknowns. ``weight_residuals`` returns None where its likelihood is not
    finite. ``covariance_terms`` are gradient ``(n,)`` and expected information ``(n, n)`` of the log likelihood through the dependence
    of the residuals' covariance on the unknowns; None where there is none.
    ``step_bounds`` of one step of a fit from ``theta``: lowest and highest values of all unknowns, ``(n,)`` each.
    """

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def start(self) -> np.ndarray: ...
    @property
    def low(self) -> np.ndarray: ...
    @property
    def high(self) -> np.ndarray: ...
    def weight_residuals(
        self, layout: LaidOut, theta: np.ndarray, lines: Sequence[Linearisation], residuals: Sequence[np.ndarray], counts: np.ndarray
    ) -> WeightedResiduals | None: ...
    def covariance_terms(
        self, layout: LaidOut, theta: np.ndarray, lines: Sequence[Linearisation], weighted: WeightedResiduals
    ) -> tuple[np.ndarray, np.ndarray] | None: ...
    def step_bounds(self, layout: LaidOut, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]: ...


@dataclass(frozen=True, eq=False)
class Standardised:
    """Division by each output's standard deviation: ``valid (m, N)``, ``variance (m,)``."""

    valid: np.ndarray
    variance: np.ndarray

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Columns over the standard deviation, zero where a sample is missing."""
        weight = np.where(self.valid, 1.0 / np.sqrt(self.variance)[:, None], 0.0)
        return weight[:, :, None] * columns


@dataclass(frozen=True)
class White:
    """Independent Gaussian noise on each output, its variance concentrated out: the mean square of the residual."""

    names: tuple[str, ...] = ()

    @property
    def start(self) -> np.ndarray:
        return np.zeros(0)

    low = high = start

    def weight_residuals(
        self, layout: LaidOut, theta: np.ndarray, lines: Sequence[Linearisation], residuals: Sequence[np.ndarray], counts: np.ndarray
    ) -> WeightedResiduals | None:
        """Residuals and sensitivities as they are."""
        squares = np.sum([(residual**2).sum(axis=1) for residual in residuals], axis=0)
        found = squares / np.maximum(counts, 1)
        variance = np.where(layout.used, np.maximum(found, layout.smallest), 1.0)
        # A variance held at its least is no unknown: without its squares the cost would not have the gradient that is followed.
        held = np.where(found < layout.smallest, squares / variance - counts, 0.0)
        cost = 0.5 * float(np.sum(np.where(layout.used, counts * np.log(variance) + held, 0.0)))
        filters = tuple(Standardised(problem.valid, variance) for problem in layout.problems)
        return WeightedResiduals(tuple(residuals), tuple(line.jacobian for line in lines), variance, cost, filters)

    def covariance_terms(
        self, layout: LaidOut, theta: np.ndarray, lines: Sequence[Linearisation], weighted: WeightedResiduals
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """None: the variances are concentrated out."""
        return None

    def step_bounds(self, layout: LaidOut, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The bounds of the layout."""
        return layout.low, layout.high


WHITE = White()
