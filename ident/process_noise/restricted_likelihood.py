"""Restricted likelihood (REML): noise levels freed of most of the bias that estimating everything else from the same data brings.

Maximum likelihood takes for process noise what initial states, biases and derivatives could as well have explained, and finds noise
too small: the fewer correlation lengths a record holds, the more. The adjusted profile likelihood adds -0.5 ln det I, I the
information on those unknowns (Cox and Reid, J. Royal Statistical Society B 49(1), 1987); one step towards its maximum.
"""

from __future__ import annotations

import numpy as np

from ident.process_noise.innovations_model import ProcessNoise
from ident.whole_record.gauss_newton import Fit

_STEP = 0.02  # of a level, for differences
_MOST = 0.7  # change of a level's logarithm


def restricted_levels(fit: Fit, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All unknowns ``(n,)`` with the noise's own adjusted, and the factors ``(n,)`` by which they changed.

    ``covariance (n, n)`` is the fit's; a level at its bound stays. Sigmas of noise levels go with the levels.
    """
    noise_model, theta, low, high = fit.noise_model, fit.theta, fit.problem.low, fit.problem.high
    assert isinstance(noise_model, ProcessNoise)
    setting = noise_model.setting_noise(fit.layout, theta)
    inside = (theta[setting] > low[setting]) & (theta[setting] < high[setting])
    moved, others = setting[inside], np.setdiff1d(np.arange(len(theta)), setting)
    base = _log_determinant(fit, theta, others)
    slope = np.zeros(len(moved))
    for i, position in enumerate(moved):
        stretched = theta.copy()
        stretched[position] *= 1.0 + _STEP
        slope[i] = 0.5 * (_log_determinant(fit, stretched, others) - base) / (_STEP * theta[position])
    change = np.clip(-covariance[np.ix_(moved, moved)] @ slope / theta[moved], -_MOST, _MOST)
    factor = np.ones(len(theta))
    if np.all(np.isfinite(change)):
        factor[moved] = np.exp(change)
    adjusted = np.clip(theta * factor, low, high)
    factor[moved] = adjusted[moved] / theta[moved]
    return adjusted, factor


def _log_determinant(fit: Fit, theta: np.ndarray, positions: np.ndarray) -> float:
    """Of the information on the unknowns at ``positions`` with the noise of ``theta``, about the fit's trajectories."""
    layout, n = fit.layout, len(theta)
    residuals = [np.where(problem.valid, problem.z - line.y, 0.0) for problem, line in zip(layout.problems, fit.lines, strict=True)]
    weighted = fit.noise_model.weight_residuals(layout, theta, fit.lines, residuals, fit.counts)
    if weighted is None:
        return float("nan")
    information = np.zeros((n, n))
    for r, jacobian in enumerate(weighted.jacobians):
        at = layout.columns(r)
        J = jacobian.reshape(-1, len(at))
        information[np.ix_(at, at)] += J.T @ J
    part = information[np.ix_(positions, positions)]
    seen = np.flatnonzero(np.diag(part) > 0)
    size = np.sqrt(np.diag(part)[seen])
    return float(np.linalg.slogdet(part[np.ix_(seen, seen)] / np.outer(size, size))[1] + 2.0 * np.log(size).sum())
