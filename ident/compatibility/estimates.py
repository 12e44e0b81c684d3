"""Both methods side by side: output error over measured inputs, and the smoother that knows their noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ident.compatibility.fitting import Fit, positions, prior_information, whitened
from ident.compatibility.instruments import part_of_controls
from ident.compatibility.noise import walk_gains
from ident.compatibility.unknowns import linearised, unknowns_of
from ident.statistics.coloured_covariance import corrected_covariance
from ident.statistics.information import OPEN, bounded_inverse, inverse_information

_PASSES = 4


@dataclass(frozen=True, eq=False)
class Sigmas:
    """Of a smoother fit: covariance of all unknowns under its noise, and by how much the colour of what is left widens each variance."""

    covariance: np.ndarray
    widening: np.ndarray


def smoother_sigmas(found: Fit) -> Sigmas:
    """Covariance of a fit, corrected for innovations that are not white (``ident.statistics.coloured_covariance``)."""
    white, at = whitened(found), positions(found)
    information = np.diag(prior_information(found))
    for (_, jacobian), where in zip(white, at, strict=True):
        J = jacobian.reshape(-1, jacobian.shape[2])
        information[np.ix_(where, where)] += J.T @ J
    inverse, _ = inverse_information(information, floor=OPEN)
    parts = [(where, jacobian, e, s.valid) for (e, jacobian), where, s in zip(white, at, found.signals, strict=True)]
    corrected = corrected_covariance(inverse, parts, np.ones(len(found.noise.outputs)))
    own, wide = np.diag(inverse), np.diag(corrected)
    return Sigmas(inverse, np.maximum(np.divide(wide, own, out=np.ones_like(wide), where=own > 0), 1.0))


def output_error(found: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Values of all unknowns by output error, begun at a smoother fit, and their covariance with the inputs' noise accounted for.

    Residuals are weighed by their own mean square, as if they were white; the covariance is that which such weights give under the
    noise of outputs and inputs of the smoother fit.
    """
    own, sizes, at, prior = [o.copy() for o in found.own], found.sizes.copy(), positions(found), prior_information(found)
    unknowns = [unknowns_of(s) for s in found.signals]
    largest = np.array([fault.largest for fault in found.faults])
    total = len(prior) - len(sizes)
    lines = list(zip(found.outputs, found.jacobians, strict=True))
    parts = [part_of_controls(s) for s in found.signals]
    for turn in range(_PASSES):
        if turn:
            lines = [linearised(s, u, found.faults, o, sizes) for s, u, o in zip(found.signals, unknowns, own, strict=True)]
        measured = [np.array([s.channels[name] for name in s.outputs]) for s in found.signals]
        residuals = [np.where(s.valid, z - y, 0.0) for s, z, (y, _) in zip(found.signals, measured, lines, strict=True)]
        counts = np.sum([s.valid.sum(axis=1) for s in found.signals], axis=0)
        variance = np.maximum(np.sum([(e**2).sum(axis=1) for e in residuals], axis=0) / np.maximum(counts, 1), 1e-30)
        information, gradient = np.diag(prior), np.zeros(len(prior))
        columns = []
        for s, part, e, (_, slope), where in zip(found.signals, parts, residuals, lines, at, strict=True):
            J = part(np.where(s.valid[:, :, None], slope, 0.0)) / variance[:, None, None]
            columns.append(J)
            information[np.ix_(where, where)] += np.einsum("mnc,mnd->cd", J, slope)
            gradient[where] += np.einsum("mnc,mn->c", J, e)
        gradient[:total] -= prior[:total] * np.concatenate(own)
        inverse = bounded_inverse(information)
        step = inverse @ gradient
        place = 0
        for r in range(len(own)):
            own[r] = own[r] + step[place : place + len(own[r])]
            place += len(own[r])
        sizes = np.clip(sizes + step[place:], -largest, largest)
        if np.all(np.abs(step) <= 0.1 * np.sqrt(np.maximum(np.diag(inverse), 1e-300))):
            break
    spread = np.diag(prior)
    for s, J, where in zip(found.signals, columns, at, strict=True):
        spread[np.ix_(where, where)] += np.einsum("mnc,m,mnd->cd", J, found.noise.white, J)
        ahead = np.cumsum(J[:, ::-1], axis=1)[:, ::-1][:, 1:]
        walk = np.einsum("mi,mnc->inc", walk_gains(s, found.noise), ahead) * s.steps[None, :, None]
        spread[np.ix_(where, where)] += np.einsum("inc,i,ind->cd", walk, found.noise.density, walk)
    inverse, _ = inverse_information(information, floor=OPEN)
    return np.concatenate([*own, sizes]), _sandwich(inverse, spread)


def _sandwich(inverse: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """inverse spread inverse' as a product of a matrix with its transpose: rounding makes no variance negative."""
    scale = np.sqrt(np.maximum(np.diag(spread), 1e-300))
    values, vectors = np.linalg.eigh(spread / np.outer(scale, scale))
    half = inverse @ (scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))
    return np.asarray(half @ half.T)


def difference_in_sigmas(one: float, var_one: float, other: float, var_other: float) -> float:
    """``one - other`` over its standard deviation where ``other`` is efficient: the variances subtract (Hausman, Econometrica 46(6), 1978)."""
    # Where both are all but equal, what the linear theory leaves out is more than their difference.
    variance = max(var_one - var_other, 0.2 * max(var_one, var_other))
    return (one - other) / math.sqrt(variance) if variance > 0 else 0.0
