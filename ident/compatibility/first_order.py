"""A fault added to a fit to first order: one linear solve, which tells the many that do not matter from the few worth a fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.compatibility.faults import SensorFault
from ident.compatibility.fitting import Fit, positions, prior_information, whitened
from ident.compatibility.instruments import weigher
from ident.compatibility.unknowns import linearised, unknowns_of
from ident.statistics.information import bounded_inverse


def one_step(base: Fit, faults: Sequence[SensorFault]) -> list[Fit]:
    """For each fault the fit in which it is added to ``base``, to first order and with the noise of ``base``: one linear solve each."""
    white, at, slopes = whitened(base), positions(base), []
    information, gradient = np.diag(prior_information(base)), np.zeros(sum(len(own) for own in base.own) + len(base.faults))
    for s, own, (e, jacobian), where in zip(base.signals, base.own, white, at, strict=True):
        J = jacobian.reshape(-1, jacobian.shape[2])
        information[np.ix_(where, where)] += J.T @ J
        gradient[where] += J.T @ e.ravel()
        sizes = np.append(base.sizes, np.zeros(len(faults)))
        slopes.append(linearised(s, unknowns_of(s), (*base.faults, *faults), own, sizes)[1][:, :, len(own) + len(base.faults) :])
    total = sum(len(own) for own in base.own)
    gradient[:total] -= prior_information(base)[:total] * np.concatenate(base.own)
    added = [weigher(s, base.noise)(np.where(s.valid[:, :, None], slope, 0.0)) for s, slope in zip(base.signals, slopes, strict=True)]
    return [_with_step(base, fault, j, white, at, slopes, added, information, gradient) for j, fault in enumerate(faults)]


def _with_step(
    base: Fit,
    fault: SensorFault,
    j: int,
    white: Sequence[tuple[np.ndarray, np.ndarray]],
    at: Sequence[np.ndarray],
    slopes: Sequence[np.ndarray],
    added: Sequence[np.ndarray],
    information: np.ndarray,
    gradient: np.ndarray,
) -> Fit:
    n = len(gradient)
    whole, right = np.zeros((n + 1, n + 1)), np.append(gradient, 0.0)
    whole[:n, :n] = information
    for (e, jacobian), where, columns in zip(white, at, added, strict=True):
        column = columns[:, :, j].ravel()
        whole[n, n] += column @ column
        whole[where, n] += jacobian.reshape(-1, jacobian.shape[2]).T @ column
        right[n] += column @ e.ravel()
    whole[n, :n] = whole[:n, n]
    step = bounded_inverse(whole) @ right
    step[n] = float(np.clip(step[n], -fault.largest, fault.largest))
    own, residuals, jacobians, outputs = [], [], [], []
    for r, (s, where, slope) in enumerate(zip(base.signals, at, slopes, strict=True)):
        jacobian = np.concatenate([base.jacobians[r], slope[:, :, j : j + 1]], axis=2)
        change = jacobian @ np.append(step[where], step[n])
        own.append(base.own[r] + step[where[: len(base.own[r])]])
        residuals.append(np.where(s.valid, base.residuals[r] - change, 0.0))
        jacobians.append(jacobian)
        outputs.append(base.outputs[r] + change)
    total = sum(len(o) for o in own)
    sizes = np.append(base.sizes + step[total:n], step[n])
    cost = base.cost - 0.5 * max(float(right @ step), 0.0)
    return Fit(base.signals, (*base.faults, fault), sizes, tuple(own), base.noise, cost, tuple(residuals), tuple(jacobians), tuple(outputs))
