"""Biases of each record by both methods: unknowns of every fit, and findings where they are beyond chance."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ident.compatibility.estimates import difference_in_sigmas
from ident.compatibility.faults import BIAS, SensorFault
from ident.compatibility.fitting import Fit
from ident.compatibility.grouping import chance_of
from ident.compatibility.instruments import weigher
from ident.compatibility.noise import whitener
from ident.compatibility.result import Quantity, SensorEstimate, SensorFinding
from ident.compatibility.six_degrees.linear import Linear, coloured, output_error_gram
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


def bias_findings(lines: Linear, r: int, estimates: Sequence[SensorEstimate], false_alarm: float) -> tuple[SensorFinding, ...]:
    """Biases of record r that are worth a word and beyond chance, the share of false alarms over all of them together; each with the faults
    that would do as well in its place."""
    out = []
    for item in estimates:
        fault, size = SensorFault(item.channel, BIAS), item.smoother
        # Beyond what is worth a word too: the earth turns and is round, and gravity lessens with height.
        excess = max(abs(size.value) - fault.worth, 0.0)
        p = p_value(0.5 * (excess / size.std) ** 2, excess, fault)
        if item.told and item.agrees and p * len(estimates) < false_alarm:
            group = instead_of(lines, r, item.channel, false_alarm)
            out.append(SensorFinding(item.channel, BIAS, size.value, size.std, item.unit, item.gain, True, group, item.name))
    return tuple(out)


def instead_of(lines: Linear, r: int, channel: str, false_alarm: float) -> tuple[str, ...]:
    """Faults beside those that stand which leave no more than chance of what record r has for the bias of a channel, that bias being zero."""
    information, gradient = lines.whole[r]
    own, faults = lines.found.own[r], lines.faults
    n, b = len(own), [item.key for item in unknowns_of(lines.found.signals[r])].index((channel, BIAS))
    members = [n + faults.index(fault) for fault in lines.found.faults]
    best, _, _ = _least([*range(n), *members], information, gradient)
    # The bias held at zero: a step of minus its value.
    rest, held = [*(i for i in range(n) if i != b), *members], gradient + information[:, b] * own[b]
    spent = gradient[b] * own[b] + 0.5 * information[b, b] * own[b] ** 2
    losses = []
    for j, fault in enumerate(faults):
        if n + j not in members and information[n + j, n + j] > 0:
            gain, size, variance = _least([*rest, n + j], information, held)
            possible = fault.worth < abs(size) < fault.largest and (size > 0 or not fault.one_sided)
            if possible and variance < fault.plausible**2:
                losses.append((best - gain + spent, fault.name))
    chance = chance_of(false_alarm, len(faults))
    return tuple(name for loss, name in sorted(losses) if loss <= chance)


def _least(free: Sequence[int], information: np.ndarray, gradient: np.ndarray) -> tuple[float, float, float]:
    """Gain of least squares over some unknowns, and value and variance of the last of them."""
    inverse = bounded_inverse(information[np.ix_(free, free)])
    values = inverse @ gradient[list(free)]
    return 0.5 * float(values @ gradient[list(free)]), float(values[-1]), float(inverse[-1, -1])
