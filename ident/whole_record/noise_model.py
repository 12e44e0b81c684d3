"""Noise models of whole-record fits: what is random in the data.

A NoiseModel whitens residuals and sensitivities, and gives the cost. `White` is the noise model of
output error. The noise model of filter error has a Kalman filter, see
`ident.process_noise.innovations_model`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ident.whole_record.linearise import Linearisation
from ident.whole_record.record_problem import RecordProblem
from sim.declaration.model import System


class LayoutView(Protocol):
    """The attributes of a layout that a noise model reads; `FitLayout` has them."""

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
    """Whitening filter of one record."""

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Return ``columns (m, N, c)``, given in the units of the outputs, whitened to unit
        variance; zero where a sample is missing.
        """
        ...


@dataclass(frozen=True, eq=False)
class WeightedResiduals:
    """Whitened residuals and sensitivities of each record.

    Attributes
    ----------
    residuals : ``(m, N)`` of each record, zero where a sample is missing.
    jacobians : ``(m, N, c)`` of each record, derivatives of the fitted outputs.
    variance : ``(m,)`` variance of the residuals.
    cost : minus the log likelihood, without its constant 0.5 (1 + ln 2 pi) for each sample.
    filters : the whitening filter of each record, for further columns.
    """

    residuals: tuple[np.ndarray, ...]
    jacobians: tuple[np.ndarray, ...]
    variance: np.ndarray
    cost: float
    filters: tuple[ResidualFilter, ...]


class NoiseModel(Protocol):
    """Model of the random part of the data.

    Attributes
    ----------
    names, start, low, high : names, starting values and bounds of the unknowns of the noise model.

    Methods
    -------
    weight_residuals : return the whitened residuals at ``theta (n,)``; None where the likelihood is
        not finite. ``linearisations`` and ``residuals (m, N)`` are those of each record, and
        ``counts (m,)`` the numbers of valid samples of each output.
    covariance_terms : return the parts of the gradient ``(n,)`` and of the expected information
        ``(n, n)`` of the log likelihood that are due to changes of the covariance of the residuals
        by the unknowns; None where no unknown changes it.
    step_bounds : return the lowest and the highest values of all unknowns, ``(n,)`` each, that one
        step from ``theta`` may reach.
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
        self,
        layout: LayoutView,
        theta: np.ndarray,
        linearisations: Sequence[Linearisation],
        residuals: Sequence[np.ndarray],
        counts: np.ndarray,
    ) -> WeightedResiduals | None: ...
    def covariance_terms(
        self,
        layout: LayoutView,
        theta: np.ndarray,
        linearisations: Sequence[Linearisation],
        weighted: WeightedResiduals,
    ) -> tuple[np.ndarray, np.ndarray] | None: ...
    def step_bounds(
        self, layout: LayoutView, theta: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]: ...


@dataclass(frozen=True, eq=False)
class Standardised:
    """Whitening of one record with white noise: division by the standard deviation of each output.

    Attributes
    ----------
    valid : ``(m, N)`` False where a sample is missing.
    variance : ``(m,)`` noise variance of each output.
    """

    valid: np.ndarray
    variance: np.ndarray

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Return ``columns (m, N, c)`` over the standard deviation of each output, zero where a
        sample is missing.
        """
        weight = np.where(self.valid, 1.0 / np.sqrt(self.variance)[:, None], 0.0)
        return weight[:, :, None] * columns


class WithoutUnknowns:
    """A noise model without unknowns: its variances are known or concentrated out."""

    names: tuple[str, ...] = ()

    @property
    def start(self) -> np.ndarray:
        return np.zeros(0)

    low = high = start

    def covariance_terms(
        self,
        layout: LayoutView,
        theta: np.ndarray,
        linearisations: Sequence[Linearisation],
        weighted: WeightedResiduals,
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return None: no unknown changes the covariance of the residuals."""
        return None

    def step_bounds(self, layout: LayoutView, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds of the layout: a step may reach them at once."""
        return layout.low, layout.high


@dataclass(frozen=True)
class White(WithoutUnknowns):
    """Noise model with white Gaussian noise on each output. The noise variance is concentrated out:
    it is the mean square of the residual.
    """

    def weight_residuals(
        self,
        layout: LayoutView,
        theta: np.ndarray,
        linearisations: Sequence[Linearisation],
        residuals: Sequence[np.ndarray],
        counts: np.ndarray,
    ) -> WeightedResiduals | None:
        """Return the residuals and sensitivities unchanged, with the variances and the cost."""
        squares = np.sum([(residual**2).sum(axis=1) for residual in residuals], axis=0)
        mean_square = squares / np.maximum(counts, 1)
        variance = np.where(layout.used, np.maximum(mean_square, layout.smallest), 1.0)
        # A variance at its lower bound is not the mean square: the cost needs the squares.
        at_bound = np.where(mean_square < layout.smallest, squares / variance - counts, 0.0)
        terms = np.where(layout.used, counts * np.log(variance) + at_bound, 0.0)
        cost = 0.5 * float(np.sum(terms))
        filters = tuple(Standardised(problem.valid, variance) for problem in layout.problems)
        return WeightedResiduals(
            tuple(residuals),
            tuple(linearisation.jacobian for linearisation in linearisations),
            variance,
            cost,
            filters,
        )


WHITE = White()
