"""Biases of each record by both methods: unknowns of every fit, and findings where they are beyond chance."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ident.compatibility.estimates import difference_in_sigmas
from ident.compatibility.faults import BIAS, SensorFault
from ident.compatibility.fitting import Fit
from ident.compatibility.instruments import weigher
from ident.compatibility.noise import whitener
from ident.compatibility.result import Quantity, SensorEstimate, SensorFinding
from ident.compatibility.six_degrees.linear import coloured, output_error_gram
from ident.compatibility.six_degrees.unknowns import unknowns_of
from ident.compatibility.trials import p_value
from ident.statistics.information import bounded_inverse


def bias_estimates(found: Fit, r: int) -> tuple[SensorEstimate, ...]:
    """The biases of one record of a fit, the faults of which have their values."""
    s, own = found.signals[r], found.own[r]
    unknowns, n = unknowns_of(s), len(own)
    prior = np.array([item.prior**-2 for item in unknowns] + [0.0] * len(found.faults))
    slopes = np.where(s.valid[:, :, None], found.jacobians[r], 0.0)
    white = weigher(s, found.noise)(slopes)
    left = whitener(s, found.noise)(found.residuals[r][:, :, None])[:, :, 0]
    flat = white.reshape(-1, white.shape[2])
    inverse = bounded_inverse(flat.T @ flat + np.diag(prior))
    scatter = sum(coloured(white[i], left[i]) for i in range(len(left))) + np.diag(prior)
    wide = np.maximum(np.diag(inverse @ scatter @ inverse), np.diag(inverse))
    gram, gradient, spread = output_error_gram(s, found, r, np.concatenate([slopes, found.residuals[r][:, :, None]], axis=2))
    gradient[:n] -= prior[:n] * own
    other = bounded_inverse(gram + np.diag(prior))
    step, other_variance = other @ gradient, np.diag(other @ (spread + np.diag(prior)) @ other)
    out = []
    for i, item in enumerate(unknowns):
        if item.key[1] == BIAS:
            fault = SensorFault(item.key[0], BIAS)
            value, variance = float(own[i]), float(wide[i])
            by_other, its_variance = float(own[i] + step[i]), max(float(other_variance[i]), variance)
            told = 0.0 < variance < fault.plausible**2
            apart = difference_in_sigmas(by_other, its_variance, value, variance) if told else 0.0
            gain = 0.5 * value**2 / variance if variance > 0 else 0.0
            quantities = Quantity(by_other, math.sqrt(its_variance)), Quantity(value, math.sqrt(variance))
            out.append(SensorEstimate(fault.name, fault.channel, BIAS, fault.unit, *quantities, apart, gain, p_value(gain, value, fault), told))
    return tuple(out)


def bias_findings(estimates: Sequence[SensorEstimate], false_alarm: float) -> tuple[SensorFinding, ...]:
    """Biases that are worth a word and beyond chance, the share of false alarms over all of them together."""
    out = []
    for item in estimates:
        worth = SensorFault(item.channel, BIAS).worth
        if item.told and item.p_value * len(estimates) < false_alarm and abs(item.smoother.value) > worth:
            size = item.smoother
            out.append(SensorFinding(item.channel, BIAS, size.value, size.std, item.unit, item.gain, True, (), item.name))
    return tuple(out)
