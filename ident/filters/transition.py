"""Fundamental matrix and discrete process noise over one step, from F and a spectral density.

Eq. 8 of the simulated-flight-data paper (Taylor series of exp(F T)) and its eq. 13,
Q_k = integral over the step of Phi(tau) Q Phi(tau)^T, solved in closed form for each choice.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

RowTransition = Callable[[np.ndarray, float], tuple[np.ndarray, np.ndarray | None]]


class Transition(Protocol):
    """Maps ``F (..., n, n)``, the diagonal of the spectral density ``(n,)`` and the step (s) to ``Phi``, ``Q_k``.

    ``of_rows`` serves batches in which F ``(..., r, n)`` stands for a matrix whose rows below the first r are zero: it prepares
    what stays the same, and returns a function of F and the step that gives the first r rows of ``Phi - I`` and of ``Q_k``,
    of the latter only the first r columns where those beyond are zero, None without noise. Below them Phi is the identity
    and Q_k is diag(density) dt.
    """

    def __call__(self, F: np.ndarray, density: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]: ...
    def of_rows(self, r: int, density: np.ndarray) -> RowTransition: ...


@dataclass(frozen=True)
class Taylor:
    """Series with ``terms`` terms: 2 gives I + F T, 3 adds F^2 T^2 / 2, and so on."""

    terms: int = 2

    def __call__(self, F: np.ndarray, density: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
        powers = [np.broadcast_to(np.eye(F.shape[-1]), F.shape)]
        for k in range(1, self.terms):
            powers.append(powers[-1] @ F / k)
        Phi = sum(power * dt**k for k, power in enumerate(powers))
        noise = np.zeros_like(F)
        if np.any(density):
            Q = np.diag(density)
            for i, left in enumerate(powers):
                for j, right in enumerate(powers):
                    noise = noise + left @ Q @ np.swapaxes(right, -1, -2) * (dt ** (i + j + 1) / (i + j + 1))
        return np.asarray(Phi), noise

    def of_rows(self, r: int, density: np.ndarray) -> RowTransition:
        terms, noise_of = self.terms, noise_of_series(r, density, self.terms)

        def rows(F: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray | None]:
            if terms < 2:
                return np.zeros_like(F), noise_of([], F, dt)
            A, powers = F[..., :r], [F * dt]
            for k in range(2, terms):
                powers.append(A @ powers[-1] * (dt / k))
            return sum(powers[1:], powers[0]), noise_of(powers, F, dt)

        return rows


def noise_of_series(r: int, density: np.ndarray, terms: int) -> Callable[[list[np.ndarray], np.ndarray, float], np.ndarray | None]:
    """Prepare the first r rows of Q_k for ``Phi = I + M_1 + ... `` of so many terms, M_k = F^k dt^k / k!, F zero below its first r rows.

    The function takes the same rows of the M_k ``(..., r, n)``, an array of their shape and the step, and gives None where nothing drives.
    """
    driven = np.flatnonzero(density)
    walking, width, walks = driven >= r, driven.size, bool(np.any(driven >= r))
    # One driven entry, the usual case, is a slice, which is cheaper than an index array.
    chosen = slice(driven[0], driven[0] + 1) if width == 1 else driven
    identity = np.eye(r, len(density))[:, driven]
    # With M_0 = I, Q_k = sum over i, j of M_i Q M_j^T dt / (i + j + 1).
    order = np.arange(terms)
    share = np.kron(1.0 / (order[:, None] + order + 1.0), np.diag(density[driven]))

    def noise_of(powers: list[np.ndarray], like: np.ndarray, dt: float) -> np.ndarray | None:
        if width == 0:
            return None
        columns = np.empty((*like.shape[:-1], terms * width))
        columns[..., :width] = identity
        for k, M in enumerate(powers, start=1):
            columns[..., k * width : (k + 1) * width] = M[..., chosen]
        weighed = columns @ (share * dt)
        own = weighed @ np.swapaxes(columns, -1, -2)
        if not walks:
            return np.asarray(own)
        noise = np.zeros((*like.shape[:-1], len(density)))
        noise[..., :r], noise[..., driven[walking]] = own, weighed[..., :width][..., walking]
        return noise

    return noise_of


@dataclass(frozen=True)
class Exponential:
    """Matrix exponential; the noise integral by Van Loan's block exponential (IEEE TAC 23(3), 1978)."""

    def __call__(self, F: np.ndarray, density: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
        from scipy.linalg import expm

        n = F.shape[-1]
        if not np.any(density):
            return expm(F * dt), np.zeros_like(F)
        block = np.zeros((*F.shape[:-2], 2 * n, 2 * n))
        block[..., :n, :n] = -F
        block[..., :n, n:] = np.diag(density)
        block[..., n:, n:] = np.swapaxes(F, -1, -2)
        both = expm(block * dt)
        Phi = np.swapaxes(both[..., n:, n:], -1, -2)
        noise = Phi @ both[..., :n, n:]
        return Phi, 0.5 * (noise + np.swapaxes(noise, -1, -2))

    def of_rows(self, r: int, density: np.ndarray) -> RowTransition:
        def rows(F: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray | None]:
            n = F.shape[-1]
            whole = np.zeros((*F.shape[:-2], n, n))
            whole[..., :r, :] = F
            Phi, noise = self(whole, density, dt)
            return Phi[..., :r, :] - np.eye(r, n), noise[..., :r, :] if np.any(density) else None

        return rows


def log_gaussian(y: np.ndarray, S: np.ndarray) -> tuple[float, float]:
    """Log density of an innovation ``y (m,)`` with covariance ``S (m, m)``, and its normalised square.

    Raises
    ------
    numpy.linalg.LinAlgError : ``S`` is not positive definite.
    """
    from scipy.linalg.lapack import dposv

    root, weighed, trouble = dposv(S, y)
    if trouble:
        raise np.linalg.LinAlgError("the covariance of an innovation is not positive definite")
    squared = float(y @ weighed.ravel())
    return -0.5 * (squared + len(y) * math.log(2.0 * math.pi)) - sum(map(math.log, root.diagonal().tolist())), squared
