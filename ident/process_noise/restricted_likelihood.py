"""Restricted likelihood (REML): noise levels freed of most of the bias that estimating everything else from the same data brings.

Maximum likelihood takes for process noise what initial states, biases and derivatives could as well have explained, and finds noise
too small: the fewer correlation lengths a record holds, the more. The adjusted profile likelihood adds -0.5 ln det I, I the
information on those unknowns (Cox and Reid, J. Royal Statistical Society B 49(1), 1987); one step towards its maximum.

Sigmas of everything else are computed with these noise levels, which are estimates themselves: `Levels.spread` is what that makes of
the variances (Giesbrecht and Burns, Biometrics 41(2), 1985; Kenward and Roger, Biometrics 53(3), 1997).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.process_noise.innovations_model import ProcessNoise
from ident.statistics.information import inverse_information
from ident.whole_record.gauss_newton import Fit

_STEP = 0.02  # of a level, for differences
_MOST = 0.7  # change of a level's logarithm


@dataclass(frozen=True, eq=False)
class Levels:
    """All unknowns ``theta (n,)`` with the noise's own adjusted, and the ``factor (n,)`` by which they changed.

    ``spread (n,)`` : variance of the logarithm of each unknown's variance, through the noise levels that set it; zero for these.
    """

    theta: np.ndarray
    factor: np.ndarray
    spread: np.ndarray


def restricted_levels(fit: Fit, covariance: np.ndarray) -> Levels:
    """Noise levels adjusted. ``covariance (n, n)`` is the fit's; a level at its bound stays. Sigmas of noise levels go with the levels."""
    noise_model, theta, low, high = fit.noise_model, fit.theta, fit.problem.low, fit.problem.high
    assert isinstance(noise_model, ProcessNoise)
    setting = noise_model.setting_noise(fit.layout, theta)
    inside = (theta[setting] > low[setting]) & (theta[setting] < high[setting])
    moved, others = setting[inside], np.setdiff1d(np.arange(len(theta)), setting)
    base, variance = _determined(fit, theta, others)
    slope, moves = np.zeros(len(moved)), np.zeros((len(moved), len(others)))
    for i, position in enumerate(moved):
        stretched = theta.copy()
        stretched[position] *= 1.0 + _STEP
        determinant, other = _determined(fit, stretched, others)
        slope[i] = 0.5 * (determinant - base) / (_STEP * theta[position])
        moves[i] = np.log(other / variance) / (_STEP * theta[position])
    among = covariance[np.ix_(moved, moved)]
    change = np.clip(-among @ slope / theta[moved], -_MOST, _MOST)
    factor, spread = np.ones(len(theta)), np.zeros(len(theta))
    if np.all(np.isfinite(change)):
        factor[moved] = np.exp(change)
    if np.all(np.isfinite(moves)):
        spread[others] = np.maximum(np.einsum("ij,ik,kj->j", moves, among, moves), 0.0)
    adjusted = np.clip(theta * factor, low, high)
    factor[moved] = adjusted[moved] / theta[moved]
    return Levels(adjusted, factor, spread)


def _determined(fit: Fit, theta: np.ndarray, positions: np.ndarray) -> tuple[float, np.ndarray]:
    """Log determinant of the information on the unknowns at ``positions`` with the noise of ``theta``, and the diagonal of its inverse.

    About the fit's trajectories; not a number where the noise has no likelihood.
    """
    layout, n = fit.layout, len(theta)
    residuals = [np.where(problem.valid, problem.z - line.y, 0.0) for problem, line in zip(layout.problems, fit.lines, strict=True)]
    weighted = fit.noise_model.weight_residuals(layout, theta, fit.lines, residuals, fit.counts)
    if weighted is None:
        return float("nan"), np.full(len(positions), np.nan)
    information = np.zeros((n, n))
    for r, jacobian in enumerate(weighted.jacobians):
        at = layout.columns(r)
        J = jacobian.reshape(-1, len(at))
        information[np.ix_(at, at)] += J.T @ J
    part = information[np.ix_(positions, positions)]
    seen = np.flatnonzero(np.diag(part) > 0)
    size = np.sqrt(np.diag(part)[seen])
    determinant = float(np.linalg.slogdet(part[np.ix_(seen, seen)] / np.outer(size, size))[1] + 2.0 * np.log(size).sum())
    return determinant, np.diag(inverse_information(part)[0])
