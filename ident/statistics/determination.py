"""What a record determines and what only the prior does: information with and without the prior, direction by direction.

In units of the prior standard deviations the record's information is F = V diag(s^2) V', s and V the singular values and right vectors of
its scaled sensitivities. With the prior the covariance is C = V diag(1 / (1 + s^2)) V': along a direction with s = 1 record and prior say
equally much. The error of the estimate has two independent parts, noise and a wrong prior mean: C = C F C + C C, so that
(C C)_ii / C_ii is the share of a posterior variance that the prior is answerable for. The sum of s^2 / (1 + s^2) counts the numbers that
the record settles (effective number of parameters; MacKay, Neural Computation 4, 1992).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ROUNDING = 1e-10  # of the largest singular value: a direction below it has no influence that arithmetic could tell


@dataclass(frozen=True, eq=False)
class Determination:
    """What a record and a prior say of parameters.

    Attributes
    ----------
    names : of the parameters, ``n``. prior_std, posterior_std : ``(n,)`` before and after the record.
    prior_share : ``(n,)`` of each posterior variance that comes from the prior, 0 to 1.
    strengths : ``(n,)`` singular values, largest first: how many times better than the prior the record knows a direction.
    directions : ``(n, n)`` unit vectors in prior standard deviations, a column for each strength.
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
        """Directions without any influence on the record, to rounding: whatever its noise, only the prior speaks of them."""
        return int(np.sum(self.strengths <= ROUNDING * max(float(self.strengths[0]), 1e-300))) if len(self.strengths) else 0

    def composition(self, direction: int, most: int = 4) -> tuple[tuple[str, float], ...]:
        """The parameters that make most of a direction with their parts, the largest first and positive."""
        vector = self.directions[:, direction]
        order = np.argsort(-np.abs(vector))[:most]
        sign = np.sign(vector[order[0]]) or 1.0
        return tuple((self.names[i], float(sign * vector[i])) for i in order)


def determination(names: tuple[str, ...], sensitivities: np.ndarray, prior_std: np.ndarray) -> Determination:
    """What sensitivities ``(M, n)`` in units of the noise and independent priors ``(n,)`` determine; ``M >= n`` is not needed."""
    prior = np.asarray(prior_std, dtype=float)
    _, found, rows = np.linalg.svd(sensitivities * prior, full_matrices=len(sensitivities) < len(names))
    strengths = np.concatenate([found, np.zeros(len(names) - len(found))])
    directions = rows.T
    variance = 1.0 / (1.0 + strengths**2)
    posterior = directions**2 @ variance
    return Determination(names, prior, prior * np.sqrt(posterior), directions**2 @ variance**2 / posterior, strengths, directions)
