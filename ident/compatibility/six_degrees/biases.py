"""Biases of the sensors in each record, in six degrees of freedom."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ident.compatibility.fault_sets import largest_chance_loss
from ident.compatibility.fitting import KinematicFit, difference_in_sigmas
from ident.compatibility.instruments import projected_whitener
from ident.compatibility.kinematics import BIAS, SensorFault
from ident.compatibility.signals import whitener
from ident.compatibility.six_degrees.fitting import (
    FaultLinearisation,
    gradient_covariance,
    output_error_gram,
)
from ident.compatibility.six_degrees.kinematics import unknowns_of
from ident.compatibility.trials import FaultQuantity, SensorEstimate, SensorFinding, p_value
from ident.statistics.intervals import bounded_inverse


def bias_estimates(kinematic_fit: KinematicFit, r: int) -> tuple[SensorEstimate, ...]:
    """Return the biases of record ``r`` by output error and by the smoother. Output error starts
    at the smoother fit and does one step.
    """
    s, own = kinematic_fit.signals[r], kinematic_fit.own[r]
    unknowns, n = unknowns_of(s), len(own)
    prior = np.array([item.prior**-2 for item in unknowns] + [0.0] * len(kinematic_fit.faults))
    slopes = np.where(s.valid[:, :, None], kinematic_fit.jacobians[r], 0.0)
    white = projected_whitener(s, kinematic_fit.noise)(slopes)
    innovations = whitener(s, kinematic_fit.noise)(kinematic_fit.residuals[r][:, :, None])[:, :, 0]
    flat = white.reshape(-1, white.shape[2])
    inverse = bounded_inverse(flat.T @ flat + np.diag(prior))
    scatter = np.diag(prior) + sum(
        gradient_covariance(columns, e) for columns, e in zip(white, innovations, strict=True)
    )
    variances = np.maximum(np.diag(inverse @ scatter @ inverse), np.diag(inverse))
    gram, gradient, output_error_scatter = output_error_gram(
        s,
        kinematic_fit,
        r,
        np.concatenate([slopes, kinematic_fit.residuals[r][:, :, None]], axis=2),
    )
    gradient[:n] -= prior[:n] * own
    output_error_inverse = bounded_inverse(gram + np.diag(prior))
    step = output_error_inverse @ gradient
    output_error_variances = np.diag(
        output_error_inverse @ (output_error_scatter + np.diag(prior)) @ output_error_inverse
    )
    estimates = []
    for i, item in enumerate(unknowns):
        if item.key[1] == BIAS:
            fault = SensorFault(item.key[0], BIAS)
            value, variance = float(own[i]), float(variances[i])
            output_error_value = float(own[i] + step[i])
            output_error_variance = max(float(output_error_variances[i]), variance)
            determined = 0.0 < variance < fault.plausible**2
            difference = 0.0
            if determined:
                difference = difference_in_sigmas(
                    output_error_value, output_error_variance, value, variance
                )
            gain = 0.5 * value**2 / variance if variance > 0 else 0.0
            quantities = (
                FaultQuantity(output_error_value, math.sqrt(output_error_variance)),
                FaultQuantity(value, math.sqrt(variance)),
            )
            estimates.append(
                SensorEstimate(
                    fault.name,
                    fault.channel,
                    BIAS,
                    fault.unit,
                    *quantities,
                    difference,
                    gain,
                    p_value(gain, value, fault),
                    determined,
                )
            )
    return tuple(estimates)


def bias_findings(
    linear: FaultLinearisation, r: int, estimates: Sequence[SensorEstimate], false_alarm: float
) -> tuple[SensorFinding, ...]:
    """Return the biases of record ``r`` that are large and significant, each with the faults that
    explain the record equally well. ``false_alarm`` is the probability of any false finding.
    """
    findings = []
    for item in estimates:
        fault, size = SensorFault(item.channel, BIAS), item.smoother
        # Only the excess over the smallest finding counts: the rotation and curvature of the earth
        # and the decrease of gravity with height cause smaller biases.
        excess = max(abs(size.value) - fault.smallest_finding, 0.0)
        p = p_value(0.5 * (excess / size.std) ** 2, excess, fault)
        if item.determined and item.agrees and p * len(estimates) < false_alarm:
            group = faults_instead_of_bias(linear, r, item.channel, false_alarm)
            findings.append(
                SensorFinding(
                    item.channel,
                    BIAS,
                    size.value,
                    size.std,
                    item.unit,
                    item.gain,
                    True,
                    group,
                    item.name,
                )
            )
    return tuple(findings)


def faults_instead_of_bias(
    linear: FaultLinearisation, r: int, channel: str, false_alarm: float
) -> tuple[str, ...]:
    """Return the names of the faults that explain record ``r``, in addition to the accepted ones,
    as well as the bias of a channel does.
    """
    information, gradient = linear.full_equations[r]
    own, faults = linear.fit.own[r], linear.faults
    n = len(own)
    b = [item.key for item in unknowns_of(linear.fit.signals[r])].index((channel, BIAS))
    members = [n + faults.index(fault) for fault in linear.fit.faults]
    gain_with_bias, _, _ = _gain_value_variance([*range(n), *members], information, gradient)
    # The bias is set to zero by a step of minus its value.
    others = [*(i for i in range(n) if i != b), *members]
    gradient_without = gradient + information[:, b] * own[b]
    loss_without = gradient[b] * own[b] + 0.5 * information[b, b] * own[b] ** 2
    losses = []
    for j, fault in enumerate(faults):
        if n + j not in members and information[n + j, n + j] > 0:
            gain, size, variance = _gain_value_variance(
                [*others, n + j], information, gradient_without
            )
            notable = fault.smallest_finding < abs(size) < fault.largest
            possible_sign = size > 0 or not fault.one_sided
            if notable and possible_sign and variance < fault.plausible**2:
                losses.append((gain_with_bias - gain + loss_without, fault.name))
    chance_loss = largest_chance_loss(false_alarm, len(faults))
    return tuple(name for loss, name in sorted(losses) if loss <= chance_loss)


def _gain_value_variance(
    free: Sequence[int], information: np.ndarray, gradient: np.ndarray
) -> tuple[float, float, float]:
    """Return the gain of log likelihood by the unknowns ``free``, and the value and variance of the
    last of them.
    """
    inverse = bounded_inverse(information[np.ix_(free, free)])
    values = inverse @ gradient[list(free)]
    return 0.5 * float(values @ gradient[list(free)]), float(values[-1]), float(inverse[-1, -1])
