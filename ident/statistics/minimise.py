"""Levenberg-Marquardt, used by all fits with damped steps.

Minimised is minus a log likelihood. About a point it is a quadratic in units of each unknown's
sigma with the others known, so that neither the units of data nor those of unknowns enter; damping
adds to the diagonal in these units [1]_.

References
----------
.. [1] D. W. Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", J. SIAM
   11(2), 1963.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from ident.statistics.intervals import conditional_scale

P = TypeVar("P")

LEAST_DAMPING = 1e-12  # least damping of a step where the quadratic model is accurate
LARGEST_DAMPING = 1e8  # damping from which no descent is left
_FIRST_DAMPING = 1e-4
_LEAST_DAMPING = 1e-10  # keeps directions without information from following rounding errors


@dataclass(frozen=True, eq=False)
class LocalModel:
    """A quadratic in units of each unknown's sigma with the others known.

    Attributes
    ----------
    scale : ``(n,)`` those sigmas.
    information, gradient : ``(n, n)`` and ``(n,)`` of the log likelihood, in these units.
    moving : ``(n,)`` False where an unknown has no influence or is pressed against a bound.
    """

    scale: np.ndarray
    information: np.ndarray
    gradient: np.ndarray
    moving: np.ndarray

    def step(self, damping: float) -> np.ndarray:
        """Levenberg-Marquardt step ``(n,)`` in sigmas; what does not move stays."""
        out = np.zeros(len(self.gradient))
        at = np.flatnonzero(self.moving)
        out[at] = np.linalg.solve(
            self.information[at[:, None], at] + damping * np.eye(len(at)), self.gradient[at]
        )
        return out

    @property
    def promised(self) -> float:
        """Gain of log likelihood that the undamped step promises: half its squared length in sigmas
        of its own direction.

        No unknown moves by more than ``sqrt(2 promised)`` of its sigma, whatever the units of data
        and unknowns.
        """
        return 0.5 * float(self.gradient @ self.step(_LEAST_DAMPING))


def local_model(
    information: np.ndarray,
    gradient: np.ndarray,
    theta: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> LocalModel:
    """Return the quadratic at ``theta (n,)`` within bounds, from ``information (n, n)`` and
    ``gradient (n,)`` of the log likelihood.
    """
    scale = conditional_scale(information, theta)
    pressed = ((theta <= low) & (gradient < 0)) | ((theta >= high) & (gradient > 0))
    moving = (np.diag(information) > 0) & ~pressed
    return LocalModel(scale, information * np.outer(scale, scale), scale * gradient, moving)


def unresolved(samples: float) -> float:
    """Return the rise of a cost (minus a log likelihood) that equals zero within rounding of its
    sums and the remaining trajectory gaps, by number of samples.
    """
    return 5e-9 * samples


def _no_shortcut(point: Any, model: LocalModel) -> None:
    return None


def _least() -> float:
    return LEAST_DAMPING


@dataclass(frozen=True)
class Descent(Generic[P]):
    """The minimised function, as functions of a point (the caller's data for one set of unknowns).

    Attributes
    ----------
    model : the quadratic about a point.
    trial : the point after a step of the model under a damping; None where it is no better.
    settled : whether the search may end at a point.
    shortcut : a better point found by other means than a damped step; None where there is none.
    least : the least damping after a step that was taken.
    """

    model: Callable[[P], LocalModel]
    trial: Callable[[P, LocalModel, float], P | None]
    settled: Callable[[P, LocalModel], bool]
    shortcut: Callable[[P, LocalModel], P | None] = _no_shortcut
    least: Callable[[], float] = _least


@dataclass(frozen=True, eq=False)
class Minimum(Generic[P]):
    """End of a search: the point, the quadratic about it, the steps tried, and whether no damping
    lowered the cost.
    """

    point: P
    model: LocalModel
    steps: int
    stuck: bool


def minimise(descent: Descent[P], start: P, steps: int) -> Minimum[P]:
    """Levenberg-Marquardt from ``start``, at most ``steps``; damping falls tenfold after a step
    that was taken and rises tenfold after one that was not.

    Examples
    --------
    The least of ``0.5 (x - 3)^2``, by the model of its own curvature:

    >>> import numpy as np
    >>> from ident.statistics.minimise import Descent, local_model, minimise
    >>> def model(x):
    ...     return local_model(np.eye(1), 3.0 - x, x, np.array([-9.0]), np.array([9.0]))
    >>> def trial(x, model, damping):
    ...     there = x + model.scale * model.step(damping)
    ...     return there if (there[0] - 3.0) ** 2 <= (x[0] - 3.0) ** 2 else None
    >>> found = minimise(Descent(model, trial, lambda x, m: m.promised < 1e-12), np.zeros(1), 20)
    >>> round(float(found.point[0]), 6), found.stuck
    (3.0, False)
    """
    point, model = start, descent.model(start)
    damping, done, stuck = _FIRST_DAMPING, 0, False
    while done < steps and not stuck and not descent.settled(point, model):
        done += 1
        better = descent.shortcut(point, model)
        if better is None:
            better = descent.trial(point, model, damping)
            if better is None:
                stuck, damping = 10.0 * damping > LARGEST_DAMPING, 10.0 * damping
                continue
            damping = max(damping / 10.0, descent.least())
        point, model = better, descent.model(better)
    return Minimum(point, model, done, stuck)
