"""Levenberg-Marquardt method, used by all fits with damped steps.

The cost is minus a log likelihood. A quadratic model approximates it about a point. The unit of
each unknown is its sigma if all others were known, so that the units of data and unknowns have no
influence. Damping is added to the diagonal of the information in these units [1]_.

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
LARGEST_DAMPING = 1e8  # a search ends where no smaller damping lowers the cost
_FIRST_DAMPING = 1e-4  # damping of the first step
# damping of the step whose gain is predicted; it suppresses directions without information
_LEAST_DAMPING = 1e-10


@dataclass(frozen=True, eq=False)
class LocalModel:
    """Quadratic model of the cost about a point.

    Attributes
    ----------
    scale : ``(n,)`` sigma of each unknown if all others were known.
    information, gradient : ``(n, n)`` and ``(n,)`` of the log likelihood, in units of ``scale``.
    movable : ``(n,)`` False where an unknown has no influence or the gradient presses it against a
        bound.
    """

    scale: np.ndarray
    information: np.ndarray
    gradient: np.ndarray
    movable: np.ndarray

    def step(self, damping: float) -> np.ndarray:
        """Return the Levenberg-Marquardt step ``(n,)`` in units of ``scale``, zero where an unknown
        does not move.
        """
        step = np.zeros(len(self.gradient))
        at = np.flatnonzero(self.movable)
        damped = self.information[at[:, None], at] + damping * np.eye(len(at))
        step[at] = np.linalg.solve(damped, self.gradient[at])
        return step

    @property
    def predicted_gain(self) -> float:
        """Gain of log likelihood that the model predicts for the undamped step: half the square of
        its length in sigmas of its direction.

        The step changes no unknown by more than ``sqrt(2 predicted_gain)`` of its sigma.
        """
        return 0.5 * float(self.gradient @ self.step(_LEAST_DAMPING))


def local_model(
    information: np.ndarray,
    gradient: np.ndarray,
    theta: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> LocalModel:
    """Return the quadratic model at ``theta (n,)`` with the bounds ``low`` and ``high``, from the
    ``information (n, n)`` and ``gradient (n,)`` of the log likelihood.
    """
    scale = conditional_scale(information, theta)
    at_bound = ((theta <= low) & (gradient < 0)) | ((theta >= high) & (gradient > 0))
    movable = (np.diag(information) > 0) & ~at_bound
    return LocalModel(scale, information * np.outer(scale, scale), scale * gradient, movable)


def cost_rounding(samples: float) -> float:
    """Return the largest rise of a cost that is no real rise, for a number of samples. It may come
    from rounding of sums, or from the remaining gaps of trajectories.
    """
    return 5e-9 * samples


def _no_shortcut(point: Any, model: LocalModel) -> None:
    """Return None: there is no other step."""
    return None


def _least() -> float:
    """Return the default of the least damping."""
    return LEAST_DAMPING


@dataclass(frozen=True)
class Descent(Generic[P]):
    """The functions of one search. A point is an object of the caller for one set of unknowns.

    Attributes
    ----------
    model : function that returns the quadratic model about a point.
    trial : function that returns the point after a step with a given damping; None where it is no
        better.
    settled : function that returns whether the search may end at a point.
    shortcut : function that returns a better point by a step other than a damped one; None where
        there is none.
    least : function that returns the least damping after an accepted step.
    """

    model: Callable[[P], LocalModel]
    trial: Callable[[P, LocalModel, float], P | None]
    settled: Callable[[P, LocalModel], bool]
    shortcut: Callable[[P, LocalModel], P | None] = _no_shortcut
    least: Callable[[], float] = _least


@dataclass(frozen=True, eq=False)
class Minimum(Generic[P]):
    """Result of a search.

    Attributes
    ----------
    point : the last point.
    model : the quadratic model about it.
    steps : number of accepted and rejected steps.
    stuck : whether the search ended because no damping lowered the cost.
    """

    point: P
    model: LocalModel
    steps: int
    stuck: bool


def minimise(descent: Descent[P], start: P, steps: int) -> Minimum[P]:
    """Return the minimum after at most ``steps`` Levenberg-Marquardt steps from ``start``. The
    damping falls tenfold after an accepted step and rises tenfold after a rejected one.

    Examples
    --------
    The minimum of ``0.5 (x - 3)^2``, by a model with its curvature:

    >>> import numpy as np
    >>> from ident.statistics.minimise import Descent, local_model, minimise
    >>> def model(x):
    ...     return local_model(np.eye(1), 3.0 - x, x, np.array([-9.0]), np.array([9.0]))
    >>> def trial(x, model, damping):
    ...     there = x + model.scale * model.step(damping)
    ...     return there if (there[0] - 3.0) ** 2 <= (x[0] - 3.0) ** 2 else None
    >>> descent = Descent(model, trial, lambda x, m: m.predicted_gain < 1e-12)
    >>> minimum = minimise(descent, np.zeros(1), 20)
    >>> round(float(minimum.point[0]), 6), minimum.stuck
    (3.0, False)
    """
    point, model = start, descent.model(start)
    damping, count, stuck = _FIRST_DAMPING, 0, False
    while count < steps and not stuck and not descent.settled(point, model):
        count += 1
        better = descent.shortcut(point, model)
        if better is None:
            better = descent.trial(point, model, damping)
            if better is None:
                stuck, damping = 10.0 * damping > LARGEST_DAMPING, 10.0 * damping
                continue
            damping = max(damping / 10.0, descent.least())
        point, model = better, descent.model(better)
    return Minimum(point, model, count, stuck)
