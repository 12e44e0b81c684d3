"""Result of a compatibility check, trials of one more sensor fault, and channels to which delays
refer.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ident.compatibility.fitting import (
    KinematicFit,
    difference_in_sigmas,
    fit,
    instrumented,
    least_misfit,
    output_error,
    positions,
    prior_information,
    projected_whitener,
    smoother_sigmas,
    whitened,
)
from ident.compatibility.kinematics import BIAS, DELAY, LAG, SensorFault, linearised, unknowns_of
from ident.compatibility.signals import KinematicSignals, smoothed_walk
from ident.statistics.intervals import bounded_inverse
from sim.maths import G0

# ---- Result of a check


@dataclass(frozen=True)
class CompatibilitySettings:
    """Settings of a check.

    Attributes
    ----------
    airspeed : m/s, for records without airspeed. If it is None too, the relation of alpha is
        omitted.
    gravity : m/s2.
    vane_arm : known arm of the vane, m; an estimated arm is in addition to it.
    chord : m, for the prior of sensor positions; zero where it is not known.
    false_alarm : probability that any fault is accepted in records of correct sensors.
    max_faults : largest number of accepted faults.
    """

    airspeed: float | None = None
    gravity: float = G0
    vane_arm: float = 0.0
    chord: float = 0.0
    false_alarm: float = 0.01
    max_faults: int = 3


@dataclass(frozen=True)
class FaultQuantity:
    """A value and its standard deviation."""

    value: float
    std: float

    @classmethod
    def of(cls, fault: SensorFault, size: float, variance: float) -> FaultQuantity:
        """Return the parameter of the effect of a fault, and its standard deviation. The parameter
        is the size of the fault plus `SensorFault.offset`.
        """
        return cls(size + fault.offset, math.sqrt(max(variance, 0.0)))


@dataclass(frozen=True)
class SensorEstimate:
    """Estimate of one fault by both methods.

    Attributes
    ----------
    name, channel, kind, unit : name, channel, kind and unit of the fault.
    output_error, smoother : estimates by the two methods.
    difference : output error minus smoother, in standard deviations of the difference.
    gain : increase of the log likelihood under coloured residuals.
    p_value : p-value of this gain; one-sided if only one sign of the fault is possible.
    determined : whether the standard deviation is below a plausible size.
    """

    name: str
    channel: str
    kind: str
    unit: str
    output_error: FaultQuantity
    smoother: FaultQuantity
    difference: float
    gain: float
    p_value: float
    determined: bool

    @classmethod
    def of(cls, fault: SensorFault, *estimates: Any) -> SensorEstimate:
        """Return the estimate of a fault. ``estimates`` are the attributes from ``output_error`` to
        ``determined``, in order.
        """
        return cls(fault.name, fault.channel, fault.kind, fault.unit, *estimates)

    @property
    def agrees(self) -> bool:
        """Whether the two methods agree within three standard deviations."""
        return abs(self.difference) <= 3.0


@dataclass(frozen=True)
class SensorFinding:
    """One fault tested under coloured residuals, in addition to the accepted ones.

    Attributes
    ----------
    value, std : parameter of the effect and its standard deviation. The parameter of a scale error
        is the scale factor, which is 1 without the error.
    gain : gain of log likelihood.
    supported : whether the fault is accepted, or may be confused with an accepted one.
    group : names of the faults that it may be confused with.
    name : name of the effect.
    replicates : whether single records agree on the fault; True for one record.
    lost : loss of log likelihood if the fault replaces an accepted one, zero for the best fault of
        a group; None for a fault that was not tried as a replacement.
    probabilities : name -> probability of the fault and of each fault in its group, from
        likelihoods and priors.
    instead_of : name of the accepted fault that it replaced in the trial; empty for an accepted
        fault and for one that was tried in addition to all accepted ones.
    """

    channel: str
    kind: str
    value: float
    std: float
    unit: str
    gain: float
    supported: bool
    group: tuple[str, ...]
    name: str = ""
    replicates: bool = True
    lost: float | None = None
    probabilities: Mapping[str, float] = field(default_factory=dict)
    instead_of: str = ""

    @classmethod
    def of(
        cls, fault: SensorFault, quantity: FaultQuantity, gain: float, **other_attributes: Any
    ) -> SensorFinding:
        """Return the finding of a fault; ``other_attributes`` are the other attributes by name."""
        value, std, unit = quantity.value, quantity.std, fault.unit
        return cls(
            fault.channel, fault.kind, value, std, unit, gain, name=fault.name, **other_attributes
        )


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Measured outputs of one record, and their reconstruction from other channels.

    Attributes
    ----------
    record : name of the record.
    time : ``(N,)``, s.
    measured : output -> ``(N,)`` measurement, in SI units.
    recorded : output -> ``(N,)`` reconstruction by integration of the measured inputs.
    integrated : output -> ``(N,)`` the same after correction for the accepted faults.
    smoothed : output -> ``(N,)`` reconstruction by a smoother, which also uses the measured output.
    used : output -> ``(N,)`` mask, False where a sample is missing or excluded.
    """

    record: str
    time: np.ndarray
    measured: Mapping[str, np.ndarray]
    recorded: Mapping[str, np.ndarray]
    integrated: Mapping[str, np.ndarray]
    smoothed: Mapping[str, np.ndarray]
    used: Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class CheckResult:
    """Result of a check of one record, or of several together.

    Attributes
    ----------
    records : names of the records.
    estimates : estimates of all faults except biases.
    biases : estimates of the biases, for one record only.
    findings : accepted faults first.
    noise_std : channel -> standard deviation of its noise, in its unit. The integral of the noise
        of an input is a random walk, from which this deviation is estimated.
    """

    records: tuple[str, ...]
    estimates: tuple[SensorEstimate, ...]
    biases: tuple[SensorEstimate, ...]
    findings: tuple[SensorFinding, ...]
    noise_std: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Compatibility:
    """Result of ``compatibility``.

    Attributes
    ----------
    channels : the channels that were checked.
    relations : output -> channels of its relation.
    joint : result of all records together, with common sensor faults.
    single : result of each record alone; empty where it was not requested.
    reconstructions : one for each record.
    unobservable : sentences on faults that the records do not determine, and on channels that
        cannot be checked.
    notes : sentences on changes of the channels and on missing relations.
    """

    channels: tuple[str, ...]
    relations: Mapping[str, tuple[str, ...]]
    joint: CheckResult
    single: tuple[CheckResult, ...]
    reconstructions: tuple[Reconstruction, ...]
    unobservable: tuple[str, ...]
    notes: tuple[str, ...] = field(default=())

    @property
    def findings(self) -> tuple[SensorFinding, ...]:
        """Findings of all records together, accepted ones first."""
        return self.joint.findings


def reconstructions_of(base: KinematicFit, final: KinematicFit) -> tuple[Reconstruction, ...]:
    """Return the reconstruction of each record. ``base`` is the fit without faults, and ``final``
    the fit with the accepted faults.
    """
    reconstructions = []
    for s, without_faults, y, residual in zip(
        final.signals, base.outputs, final.outputs, final.residuals, strict=True
    ):
        smooth = y + smoothed_walk(s, final.noise, residual)
        measured = {name: s.channels[name] for name in s.outputs}
        values_by_kind = (without_faults, y, smooth, s.valid)
        by_output = [dict(zip(s.outputs, values, strict=True)) for values in values_by_kind]
        reconstructions.append(Reconstruction(s.name, s.time, measured, *by_output))
    return tuple(reconstructions)


# ---- Trial of one fault in addition to others

# a fault whose first-order gain of log likelihood is larger is fitted with all iterations
LEAST_PROJECTED_GAIN = 2.5
CONTRADICTION_P_VALUE = 1e-3  # records contradict each other where the p-value is smaller
LEAST_FAULT_SIGMAS = 3.0  # smallest weighted mean of single records, in sigmas


@dataclass(frozen=True, eq=False)
class FaultTrial:
    """A fault that was fitted in addition to others.

    Attributes
    ----------
    fit : fit with the fault as the last one of its faults.
    size : estimated size.
    white_variance, variance : variance of the size, computed for white and for coloured residuals.
    gain, p_value : gain of log likelihood under coloured residuals, and its p-value.
    """

    fault: SensorFault
    fit: KinematicFit
    size: float
    white_variance: float
    variance: float
    gain: float
    p_value: float

    @property
    def determined(self) -> bool:
        """Whether the standard deviation is below a plausible size."""
        return 0.0 < self.variance < self.fault.plausible**2

    @property
    def quantity(self) -> FaultQuantity:
        """Parameter of the effect (see `FaultQuantity.of`) and its standard deviation."""
        return FaultQuantity.of(self.fault, self.size, self.variance)


def try_faults(base: KinematicFit, faults: Sequence[SensorFault]) -> list[FaultTrial]:
    """Return the trial of each fault in addition to the faults of ``base``.

    Each fault is first fitted in one linearised step. A fault with a notable gain or size is then
    fitted with all iterations.
    """
    trials = []
    for fault, linearised_fit in zip(faults, linearised_fits(base, faults), strict=True):
        trial = _trial(base, fault, linearised_fit)
        if trial.gain > LEAST_PROJECTED_GAIN or abs(trial.size) > 0.5 * fault.plausible:
            trial = _trial(base, fault, fit(base.signals, (*base.faults, fault), base))
        trials.append(trial)
    return trials


def _trial(base: KinematicFit, fault: SensorFault, kinematic_fit: KinematicFit) -> FaultTrial:
    """Return the trial of the last fault of a fit, against the fit ``base`` without it."""
    sigmas = smoother_sigmas(kinematic_fit)
    white_variance = float(sigmas.covariance[-1, -1])
    variance_ratio = float(sigmas.widening[-1])
    # Gusts change the residuals as faults do. With recorded controls, only the part of the
    # residuals that is correlated with the controls is compared.
    cost_without, cost_with = base.cost, kinematic_fit.cost
    if instrumented(base.signals):
        whiteners = [projected_whitener(s, kinematic_fit.noise) for s in kinematic_fit.signals]
        cost_without, cost_with = (
            least_misfit(base, whiteners),
            least_misfit(kinematic_fit, whiteners),
        )
    gain = max(cost_without - cost_with, 0.0) / variance_ratio
    return FaultTrial(
        fault,
        kinematic_fit,
        float(kinematic_fit.sizes[-1]),
        white_variance,
        white_variance * variance_ratio,
        gain,
        p_value(gain, kinematic_fit.sizes[-1], fault),
    )


def p_value(gain: float, size: float, fault: SensorFault) -> float:
    """Return the probability that the gain of log likelihood is larger although the fault is
    absent.
    """
    from scipy.special import chdtrc

    two_sided = float(chdtrc(1.0, 2.0 * gain))
    if not fault.one_sided:
        return two_sided
    return 0.5 * two_sided if size > 0 else 1.0 - 0.5 * two_sided


def sensor_estimate(trial: FaultTrial) -> SensorEstimate:
    """Return the estimate of a fault by the smoother of its trial and by output error."""
    values, covariance = output_error(trial.fit)
    variance_ratio = trial.variance / trial.white_variance if trial.white_variance > 0 else 1.0
    output_error_variance = float(covariance[-1, -1]) * variance_ratio
    difference = difference_in_sigmas(
        float(values[-1]), output_error_variance, trial.size, trial.variance
    )
    return SensorEstimate.of(
        trial.fault,
        FaultQuantity.of(trial.fault, float(values[-1]), output_error_variance),
        trial.quantity,
        difference if trial.determined else 0.0,
        trial.gain,
        trial.p_value,
        trial.determined,
    )


def bias_estimates(base: KinematicFit) -> tuple[SensorEstimate, ...]:
    """Return the estimates of the biases, which every fit of a single record contains."""
    sigmas, (values, covariance) = smoother_sigmas(base), output_error(base)
    estimates = []
    for i, item in enumerate(unknowns_of(base.signals[0])):
        if item.key[1] != BIAS:
            continue
        fault = SensorFault(item.key[0], BIAS)
        variance_ratio, value = float(sigmas.widening[i]), float(base.unknown_values[0][i])
        output_error_value, output_error_variance = (
            float(values[i]),
            float(covariance[i, i]) * variance_ratio,
        )
        variance = float(sigmas.covariance[i, i]) * variance_ratio
        quantities = [
            FaultQuantity.of(fault, *pair)
            for pair in ((output_error_value, output_error_variance), (value, variance))
        ]
        difference = difference_in_sigmas(
            output_error_value, output_error_variance, value, variance
        )
        estimates.append(SensorEstimate.of(fault, *quantities, difference, 0.0, 1.0, True))
    return tuple(estimates)


def refitted_with_faults(
    base: KinematicFit, faults: Sequence[SensorFault], sizes: np.ndarray
) -> KinematicFit:
    """Return ``base``, the fit of one record without faults, refitted with the ``faults`` of the
    joint fit. Their ``sizes (k,)`` are the starting values. Without faults the result is ``base``.
    """
    return fit(base.signals, faults, base, sizes) if faults else base


def records_agree(bases: Sequence[KinematicFit], current: KinematicFit, trial: FaultTrial) -> bool:
    """Return whether single records agree on the size of a fault, and the weighted mean of their
    sizes is significant and has the sign of the size in the joint trial.

    The fault is tried in each record in addition to the faults of ``current``. ``bases`` are the
    fits of each record without faults.
    """
    from scipy.special import chdtrc

    if len(bases) < 2:
        return True
    single_trials = [
        try_faults(refitted_with_faults(base, current.faults, current.sizes), [trial.fault])[0]
        for base in bases
    ]
    sizes = np.array([t.size for t in single_trials if t.determined])
    weights = np.array([1.0 / t.variance for t in single_trials if t.determined])
    if len(sizes) < 2:
        return False
    mean = float(np.sum(weights * sizes) / np.sum(weights))
    weighted_scatter = float(np.sum(weights * (sizes - mean) ** 2))
    agree = float(chdtrc(len(sizes) - 1.0, weighted_scatter)) > CONTRADICTION_P_VALUE
    return agree and mean * math.copysign(1.0, trial.size) > LEAST_FAULT_SIGMAS / math.sqrt(
        float(np.sum(weights))
    )


def linearised_fits(base: KinematicFit, faults: Sequence[SensorFault]) -> list[KinematicFit]:
    """Return for each fault the fit with this fault and those of ``base``, by one linearised step
    with the noise variances of ``base``.
    """
    whitened_residuals, rows_of_records, slopes = whitened(base), positions(base), []
    information = np.diag(prior_information(base))
    gradient = np.zeros(
        sum(len(unknown_values) for unknown_values in base.unknown_values) + len(base.faults)
    )
    for s, unknown_values, (e, jacobian), rows in zip(
        base.signals, base.unknown_values, whitened_residuals, rows_of_records, strict=True
    ):
        J = jacobian.reshape(-1, jacobian.shape[2])
        information[np.ix_(rows, rows)] += J.T @ J
        gradient[rows] += J.T @ e.ravel()
        sizes = np.append(base.sizes, np.zeros(len(faults)))
        slopes.append(
            linearised(s, unknowns_of(s), (*base.faults, *faults), unknown_values, sizes)[1][
                :, :, len(unknown_values) + len(base.faults) :
            ]
        )
    total = sum(len(unknown_values) for unknown_values in base.unknown_values)
    gradient[:total] -= prior_information(base)[:total] * np.concatenate(base.unknown_values)
    whitened_slopes = [
        projected_whitener(s, base.noise)(np.where(s.valid[:, :, None], slope, 0.0))
        for s, slope in zip(base.signals, slopes, strict=True)
    ]
    return [
        _linearised_fit(
            base,
            fault,
            j,
            whitened_residuals,
            rows_of_records,
            slopes,
            whitened_slopes,
            information,
            gradient,
        )
        for j, fault in enumerate(faults)
    ]


def _linearised_fit(
    base: KinematicFit,
    fault: SensorFault,
    index: int,
    whitened_residuals: Sequence[tuple[np.ndarray, np.ndarray]],
    rows_of_records: Sequence[np.ndarray],
    slopes: Sequence[np.ndarray],
    whitened_slopes: Sequence[np.ndarray],
    information: np.ndarray,
    gradient: np.ndarray,
) -> KinematicFit:
    """Return the linearised fit with ``fault``, the one at ``index`` in `linearised_fits`.

    Parameters
    ----------
    whitened_residuals, rows_of_records : results of `whitened` and `positions` for ``base``.
    slopes, whitened_slopes : for each record, ``(m, N, F)`` derivatives of the outputs with respect
        to the F faults.
    information, gradient : matrix and right-hand side of the normal equations of ``base``.
    """
    n = len(gradient)
    extended, extended_gradient = np.zeros((n + 1, n + 1)), np.append(gradient, 0.0)
    extended[:n, :n] = information
    for (e, jacobian), rows, slope in zip(
        whitened_residuals, rows_of_records, whitened_slopes, strict=True
    ):
        column = slope[:, :, index].ravel()
        extended[n, n] += column @ column
        extended[rows, n] += jacobian.reshape(-1, jacobian.shape[2]).T @ column
        extended_gradient[n] += column @ e.ravel()
    extended[n, :n] = extended[:n, n]
    step = bounded_inverse(extended) @ extended_gradient
    step[n] = float(np.clip(step[n], -fault.largest, fault.largest))
    unknown_values, residuals, jacobians, outputs = [], [], [], []
    for r, (s, rows, slope) in enumerate(zip(base.signals, rows_of_records, slopes, strict=True)):
        jacobian = np.concatenate([base.jacobians[r], slope[:, :, index : index + 1]], axis=2)
        change = jacobian @ np.append(step[rows], step[n])
        unknown_values.append(base.unknown_values[r] + step[rows[: len(base.unknown_values[r])]])
        residuals.append(np.where(s.valid, base.residuals[r] - change, 0.0))
        jacobians.append(jacobian)
        outputs.append(base.outputs[r] + change)
    total = sum(len(o) for o in unknown_values)
    sizes = np.append(base.sizes + step[total:n], step[n])
    cost = base.cost - 0.5 * max(float(extended_gradient @ step), 0.0)
    return KinematicFit(
        base.signals,
        (*base.faults, fault),
        sizes,
        tuple(unknown_values),
        base.noise,
        cost,
        tuple(residuals),
        tuple(jacobians),
        tuple(outputs),
    )


# ---- Time references: channels without a delay

# channels that change fast enough to show a delay of a fraction of a second (airspeed is too slow)
_FAST_CHANNELS = ("alpha", "q", "nz", "theta")


def time_references(signals: Sequence[KinematicSignals]) -> tuple[str, ...]:
    """Return the channels that may serve as time reference. At least one of them must have no
    delay, since the kinematics determine only differences of delays.

    Without recorded controls, nz is not among them: a gust changes the load factor before the
    flight path, so that alpha and q would seem delayed.
    """
    return tuple(
        name
        for name in _FAST_CHANNELS
        if name in signals[0].channels and (name != "nz" or instrumented(signals))
    )


def delayed_channels(faults: Iterable[SensorFault]) -> set[str]:
    """Return the fast channels (``_FAST_CHANNELS``) that these faults delay."""
    return {
        fault.channel
        for fault in faults
        if fault.kind in (DELAY, LAG) and fault.channel in _FAST_CHANNELS
    }


def leaves_time_reference(faults: Sequence[SensorFault], references: Sequence[str]) -> bool:
    """Return whether at least one of the channels ``references`` has no delay if these faults act.

    Without ``references`` the result is True.
    """
    # An accelerometer ahead of the centre of gravity has the same effect as a lag of q.
    delayed = delayed_channels(faults) | {"q" for fault in faults if fault.rare}
    return not references or not set(references) <= delayed


def reference_sentence(faults: Sequence[SensorFault], references: Sequence[str]) -> str:
    """Return a sentence that names those of the channels ``references`` that have no delay, to
    which the estimated delays refer. It is empty if no fault is a delay.
    """
    delayed = delayed_channels(faults)
    on_time = [name for name in references if name not in delayed]
    if not delayed or not on_time:
        return ""
    if len(on_time) == 1:
        reference = f"delays are relative to {on_time[0]}, the channel with the smallest delay"
    else:
        reference = (
            f"delays are relative to {', '.join(on_time[:-1])} and {on_time[-1]}, which agree"
        )
    return f"{reference}: a delay common to all channels cannot be detected from kinematics"
