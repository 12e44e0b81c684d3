"""Information matrices: inverses, normal equations, directions that data and priors determine.

In units of the prior standard deviations the record's information is F = V diag(s^2) V', s and V
the singular values and right vectors of its scaled sensitivities. With the prior the covariance is
C = V diag(1 / (1 + s^2)) V': along a direction with s = 1 record and prior say equally much. The
error of the estimate has two independent parts, noise and a wrong prior mean: C = C F C + C C, so
that (C C)_ii / C_ii is the share of a posterior variance that the prior is answerable for. The sum
of s^2 / (1 + s^2) counts the numbers that the record settles (effective number of parameters;
MacKay, Neural Computation 4, 1992).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# ---- Inverse of an information matrix that need not be regular

# share of the largest eigenvalue of the scaled information below which a direction is not
# determined: rounding
UNDETERMINED = 1e-14
# the same where the sensitivities themselves are good to some digits only: differences of simulated
# kinematics
OPEN = 1e-9
FOLLOWED = 1e-12  # share below which a step does not follow a direction at all


def conditional_scale(information: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Sigma of each unknown with the others known, ``(n,)``; its ``size`` (at least 1) where it has
    no influence at all.
    """
    diagonal = np.diag(information)
    return np.where(
        diagonal > 0,
        1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)),
        np.maximum(np.abs(size), 1.0),
    )


def inverse_information(
    information: np.ndarray, size: np.ndarray | float = 0.0, floor: float = UNDETERMINED
) -> tuple[np.ndarray, bool]:
    """Covariance ``(n, n)`` and whether every direction is determined.

    A direction that holds less than ``floor`` of the scaled information keeps a finite, very large
    sigma: ``1 / sqrt(floor)`` in units of ``conditional_scale``. ``size`` of the unknowns: see
    there. Of no unknown at all nothing is open.
    """
    if not len(information):
        return np.zeros((0, 0)), True
    square, values, vectors = _spectrum(information, size)
    least = floor * (float(values[-1]) if values[-1] > 0 else 1.0)
    return square * ((vectors / np.maximum(values, least)) @ vectors.T), bool(values[0] > least)


def determined_and_open(
    information: np.ndarray, size: np.ndarray | float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """The covariance of ``inverse_information`` as a sum, ``(n, n)`` each: of the directions that
    are determined, and of the others.

    A product with the sum would lose the first part to rounding: the second is larger by up to ``1
    / UNDETERMINED``.
    """
    if not len(information):
        return np.zeros((0, 0)), np.zeros((0, 0))
    square, values, vectors = _spectrum(information, size)
    least = UNDETERMINED * (float(values[-1]) if values[-1] > 0 else 1.0)
    known = values > least
    return (
        square * ((vectors[:, known] / values[known]) @ vectors[:, known].T),
        square * ((vectors[:, ~known] / least) @ vectors[:, ~known].T),
    )


def variance_along(covariance: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Variances ``(k,)`` of the linear combinations ``rows (k, n)`` of unknowns, each with what
    rounding may have taken from it.

    Where directions are open, huge covariances cancel in a combination that does not contain them.
    The sum then holds no more than its rounding error, which is the variance reported: it is never
    zero, and never smaller than what the arithmetic resolves.
    """
    n = covariance.shape[0]
    sizes = np.abs(rows) @ np.sqrt(np.maximum(np.diag(covariance), 0.0))
    found = np.einsum("ki,ij,kj->k", rows, covariance, rows)
    return np.asarray(np.maximum(found, 0.0) + n * np.finfo(float).eps * sizes**2)


def bounded_inverse(information: np.ndarray) -> np.ndarray:
    """Inverse ``(n, n)`` for a step, without the directions that hold less than FOLLOWED of the
    scaled information.
    """
    square, values, vectors = _spectrum(information, 0.0)
    told = values > FOLLOWED * max(float(values[-1]), 1e-300)
    return square * ((vectors * np.where(told, 1.0 / np.where(told, values, 1.0), 0.0)) @ vectors.T)


def _spectrum(
    information: np.ndarray, size: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Products of the conditional sigmas ``(n, n)``, and eigenvalues and eigenvectors of the
    information in their units.
    """
    scale = conditional_scale(
        information, np.broadcast_to(np.asarray(size, dtype=float), len(information))
    )
    square = np.outer(scale, scale)
    values, vectors = np.linalg.eigh(information * square)
    return square, values, vectors


# ---- Gauss-Newton

_UNDAMPED = 1e-10  # keeps a direction without information from moving: it would follow rounding


@dataclass(frozen=True, eq=False)
class LocalModel:
    """A quadratic in units of each unknown's sigma with the others known.

    Attributes
    ----------
    scale : ``(n,)`` those sigmas. information, gradient : ``(n, n)`` and ``(n,)`` of the log
    likelihood, in these units. moving : ``(n,)`` False where an unknown has no influence or is
    pressed against a bound.
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
        return 0.5 * float(self.gradient @ self.step(_UNDAMPED))


def local_model(
    information: np.ndarray,
    gradient: np.ndarray,
    theta: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> LocalModel:
    """The quadratic at ``theta (n,)`` within bounds, from ``information (n, n)`` and ``gradient
    (n,)`` of the log likelihood.
    """
    scale = conditional_scale(information, theta)
    pressed = ((theta <= low) & (gradient < 0)) | ((theta >= high) & (gradient > 0))
    moving = (np.diag(information) > 0) & ~pressed
    return LocalModel(scale, information * np.outer(scale, scale), scale * gradient, moving)


def add_normal_equations(
    information: np.ndarray,
    gradient: np.ndarray,
    at: np.ndarray,
    jacobian: np.ndarray,
    residual: np.ndarray,
    weight: np.ndarray,
) -> None:
    """Add to ``information (n, n)`` and ``gradient (n,)``, in place, what one record says of the
    unknowns at the positions ``at (c,)``.

    ``jacobian (m, N, c)`` of the fitted outputs, ``residual (m, N)`` measured minus fitted,
    ``weight (m, N)`` one over the variance of a sample, zero where it is missing; negative weights
    take a record away again.
    """
    J, w = jacobian.reshape(-1, len(at)), weight.ravel()
    information[at[:, None], at] += J.T @ (w[:, None] * J)
    gradient[at] += J.T @ (w * residual.ravel())


def unresolved(samples: float) -> float:
    """Rise of a cost (minus a log likelihood) that is not told from none: its sums' rounding and
    what trajectory gaps leave, by samples.
    """
    return 5e-9 * samples


# ---- What a record determines and what only the prior does

# of the largest singular value: a direction below it has no influence that arithmetic could tell
ROUNDING = 1e-10


@dataclass(frozen=True, eq=False)
class Determination:
    """What a record and a prior say of parameters.

    Attributes
    ----------
    names : of the parameters, ``n``. prior_std, posterior_std : ``(n,)`` before and after the
    record. prior_share : ``(n,)`` of each posterior variance that comes from the prior, 0 to 1.
    strengths : ``(n,)`` singular values, largest first: how many times better than the prior the
    record knows a direction. directions : ``(n, n)`` unit vectors in prior standard deviations, a
    column for each strength.
    """

    names: tuple[str, ...]
    prior_std: np.ndarray
    posterior_std: np.ndarray
    prior_share: np.ndarray
    strengths: np.ndarray
    directions: np.ndarray

    @property
    def effective(self) -> float:
        """How many numbers the record settles."""
        return float(np.sum(self.strengths**2 / (1.0 + self.strengths**2)))

    @property
    def determined(self) -> int:
        """Directions of which the record knows more than the prior."""
        return int(np.sum(self.strengths > 1.0))

    @property
    def unseen(self) -> int:
        """Directions without any influence on the record, to rounding: whatever its noise, only the
        prior speaks of them.
        """
        return (
            int(np.sum(self.strengths <= ROUNDING * max(float(self.strengths[0]), 1e-300)))
            if len(self.strengths)
            else 0
        )

    def composition(self, direction: int, most: int = 4) -> tuple[tuple[str, float], ...]:
        """The parameters that make most of a direction with their parts, the largest first and
        positive.
        """
        vector = self.directions[:, direction]
        order = np.argsort(-np.abs(vector))[:most]
        sign = np.sign(vector[order[0]]) or 1.0
        return tuple((self.names[i], float(sign * vector[i])) for i in order)


def determination(
    names: tuple[str, ...], sensitivities: np.ndarray, prior_std: np.ndarray
) -> Determination:
    """What sensitivities ``(M, n)`` in units of the noise and independent priors ``(n,)``
    determine; ``M >= n`` is not needed.
    """
    prior = np.asarray(prior_std, dtype=float)
    _, found, rows = np.linalg.svd(
        sensitivities * prior, full_matrices=len(sensitivities) < len(names)
    )
    strengths = np.concatenate([found, np.zeros(len(names) - len(found))])
    directions = rows.T
    variance = 1.0 / (1.0 + strengths**2)
    posterior = directions**2 @ variance
    return Determination(
        names,
        prior,
        prior * np.sqrt(posterior),
        directions**2 @ variance**2 / posterior,
        strengths,
        directions,
    )
