"""Gauss-Newton: the log likelihood about a point as a quadratic, from which come steps and the test of convergence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.statistics.information import conditional_scale

_UNDAMPED = 1e-10  # keeps a direction without information from moving: it would follow rounding


@dataclass(frozen=True, eq=False)
class LocalModel:
    """A quadratic in units of each unknown's sigma with the others known.

    Attributes
    ----------
    scale : ``(n,)`` those sigmas. information, gradient : ``(n, n)`` and ``(n,)`` of the log likelihood, in these units.
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
        out[at] = np.linalg.solve(self.information[at[:, None], at] + damping * np.eye(len(at)), self.gradient[at])
        return out

    @property
    def promised(self) -> float:
        """Gain of log likelihood that the undamped step promises: half its squared length in sigmas of its own direction.

        No unknown moves by more than ``sqrt(2 promised)`` of its sigma, whatever the units of data and unknowns.
        """
        return 0.5 * float(self.gradient @ self.step(_UNDAMPED))


def local_model(information: np.ndarray, gradient: np.ndarray, theta: np.ndarray, low: np.ndarray, high: np.ndarray) -> LocalModel:
    """The quadratic at ``theta (n,)`` within bounds, from ``information (n, n)`` and ``gradient (n,)`` of the log likelihood."""
    scale = conditional_scale(information, theta)
    pressed = ((theta <= low) & (gradient < 0)) | ((theta >= high) & (gradient > 0))
    moving = (np.diag(information) > 0) & ~pressed
    return LocalModel(scale, information * np.outer(scale, scale), scale * gradient, moving)


def add_normal_equations(
    information: np.ndarray, gradient: np.ndarray, at: np.ndarray, jacobian: np.ndarray, residual: np.ndarray, weight: np.ndarray
) -> None:
    """Add to ``information (n, n)`` and ``gradient (n,)``, in place, what one record says of the unknowns at the positions ``at (c,)``.

    ``jacobian (m, N, c)`` of the fitted outputs, ``residual (m, N)`` measured minus fitted, ``weight (m, N)`` one over the variance of a
    sample, zero where it is missing; negative weights take a record away again.
    """
    J, w = jacobian.reshape(-1, len(at)), weight.ravel()
    information[at[:, None], at] += J.T @ (w[:, None] * J)
    gradient[at] += J.T @ (w * residual.ravel())


def unresolved(samples: float) -> float:
    """Rise of a cost (minus a log likelihood) that is not told from none: its sums' rounding and what trajectory gaps leave, by samples."""
    return 5e-9 * samples
