"""How a whole-record fit weighs its residuals: white noise whose variances are concentrated out, by default.

A NoiseModel turns residuals and sensitivities into those of independent samples; it may have unknowns of its own, which stand
behind all others in theta. See `ident.process_noise.innovations_model` for the other one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from ident.process_noise.innovations_model import Filter
    from ident.whole_record.layout import FitLayout
    from ident.whole_record.linearise import Linearisation


@dataclass(frozen=True, eq=False)
class Weighed:
    """Residuals and sensitivities of each record as those of independent samples.

    Attributes
    ----------
    residuals, jacobians : ``(m, N)`` and ``(m, N, c)`` a record; residuals are zero where a sample is missing.
    variance : ``(m,)`` of the residuals.
    cost : minus the log likelihood, without 0.5 (1 + ln 2 pi) a sample.
    filters : what made the residuals independent, one a record; empty where they were taken as they are.
    """

    residuals: tuple[np.ndarray, ...]
    jacobians: tuple[np.ndarray, ...]
    variance: np.ndarray
    cost: float
    filters: tuple[Filter, ...] = ()


class NoiseModel(Protocol):
    """The model of what is random in the data.

    ``names``, ``start``, ``low``, ``high`` describe its own unknowns. ``weigh`` returns None where its likelihood is not finite.
    ``further`` gives gradient ``(n,)`` and expected information ``(n, n)`` of the log likelihood beyond those that the residuals
    have through the jacobians; None where there is nothing.
    ``reach`` bounds one step of a fit from ``theta``: lowest and highest values of all unknowns, ``(n,)`` each.
    ``whiten`` makes columns ``(m, N, c)`` in the outputs' units, of record ``r``, those of independent samples of variance one.
    """

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def start(self) -> np.ndarray: ...
    @property
    def low(self) -> np.ndarray: ...
    @property
    def high(self) -> np.ndarray: ...
    def weigh(
        self, layout: FitLayout, theta: np.ndarray, lines: Sequence[Linearisation], residuals: Sequence[np.ndarray], counts: np.ndarray
    ) -> Weighed | None: ...
    def further(
        self, layout: FitLayout, theta: np.ndarray, lines: Sequence[Linearisation], weighed: Weighed
    ) -> tuple[np.ndarray, np.ndarray] | None: ...
    def reach(self, layout: FitLayout, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]: ...
    def whiten(self, layout: FitLayout, weighed: Weighed, r: int, columns: np.ndarray) -> np.ndarray: ...


@dataclass(frozen=True)
class White:
    """Independent Gaussian noise on each output, its variance concentrated out: the mean square of the residual."""

    names: tuple[str, ...] = ()

    @property
    def start(self) -> np.ndarray:
        return np.zeros(0)

    low = high = start

    def weigh(
        self, layout: FitLayout, theta: np.ndarray, lines: Sequence[Linearisation], residuals: Sequence[np.ndarray], counts: np.ndarray
    ) -> Weighed | None:
        """Residuals and sensitivities as they are."""
        squares = np.sum([(residual**2).sum(axis=1) for residual in residuals], axis=0)
        found = squares / np.maximum(counts, 1)
        variance = np.where(layout.used, np.maximum(found, layout.smallest), 1.0)
        # A variance held at its least is no unknown: without its squares the cost would not have the gradient that is followed.
        held = np.where(found < layout.smallest, squares / variance - counts, 0.0)
        cost = 0.5 * float(np.sum(np.where(layout.used, counts * np.log(variance) + held, 0.0)))
        return Weighed(tuple(residuals), tuple(line.jacobian for line in lines), variance, cost)

    def further(self, layout: FitLayout, theta: np.ndarray, lines: Sequence[Linearisation], weighed: Weighed) -> tuple[np.ndarray, np.ndarray] | None:
        """Nothing: the variances are concentrated out."""
        return None

    def reach(self, layout: FitLayout, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The bounds of the layout."""
        return layout.low, layout.high

    def whiten(self, layout: FitLayout, weighed: Weighed, r: int, columns: np.ndarray) -> np.ndarray:
        """Columns over the standard deviation, zero where a sample is missing."""
        weight = np.where(layout.problems[r].valid, 1.0 / np.sqrt(weighed.variance)[:, None], 0.0)
        return weight[:, :, None] * columns


WHITE = White()
