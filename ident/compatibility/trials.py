"""Result of a check of the kinematics, the trial of one fault in addition to others, and time
references.
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
    airspeed : m/s, used where none is recorded; without both, the relation of alpha is omitted.
    gravity : m/s2.
    vane_arm : known arm of the vane, m; an estimated arm is in addition to it.
    chord : m, for the prior of sensor positions; zero where it is not known.
    false_alarm : probability that any fault is accepted in records of correct sensors.
    most : largest number of accepted faults.
    """

    airspeed: float | None = None
    gravity: float = G0
    vane_arm: float = 0.0
    chord: float = 0.0
    false_alarm: float = 0.01
    most: int = 3


@dataclass(frozen=True)
class FaultQuantity:
    """A value and its standard deviation."""

    value: float
    std: float

    @classmethod
    def of(cls, fault: SensorFault, size: float, variance: float) -> FaultQuantity:
        """Return the parameter of the effect: the size plus `SensorFault.offset`, and its sigma."""
        return cls(size + fault.offset, math.sqrt(max(variance, 0.0)))


@dataclass(frozen=True)
class SensorEstimate:
    """Estimate of one fault by both methods.

    Attributes
    ----------
    name, channel, kind, unit : those of the fault.
    output_error, smoother : estimates by the two methods.
    difference : output error minus smoother, in standard deviations of the difference.
    gain : increase of the log likelihood under coloured residuals.
    p_value : of this gain, one-sided where only one sign is possible.
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
        """Return the estimate of a fault. ``estimates`` are the attributes from ``output_error``
        on.
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
    value, std : parameter of the effect and its standard deviation; that of a scale is a factor.
    gain : gain of log likelihood.
    supported : whether the fault is accepted, or may be confused with an accepted one.
    group : names of the faults that it may be confused with.
    name : name of the effect.
    replicates : whether single records agree on the fault; True for one record.
    lost : loss of log likelihood if the fault replaces an accepted one, zero for the best fault of
        a group; None for a fault that was not tried as a replacement.
    probabilities : of the fault and its group by name, from likelihoods and priors.
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
        cls, fault: SensorFault, quantity: FaultQuantity, gain: float, **further: Any
    ) -> SensorFinding:
        """Return the finding of a fault; ``further`` are the other attributes by name."""
        value, std, unit = quantity.value, quantity.std, fault.unit
        return cls(fault.channel, fault.kind, value, std, unit, gain, name=fault.name, **further)


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Measured outputs of one record, and their reconstruction from other channels.

    Attributes
    ----------
    record : name of the record.
    time : ``(N,)``, s.
    measured : output -> ``(N,)`` measurement, in SI units.
    recorded : output -> reconstruction by integration of the measured inputs.
    integrated : the same, corrected for the accepted faults.
    smoothed : the same, by a smoother that also uses the output.
    used : output -> False where a sample is missing or does not count.
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
    estimates : of all faults but biases.
    biases : estimates of the biases, for one record only.
    findings : accepted faults first.
    noise_std : channel -> noise in its unit; that of an input is from the random walk of its
        integral.
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

# a fault is fitted completely where its first-order gain of log likelihood is larger
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
    white_variance, variance : variance of the size for white and for coloured residuals.
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
        """Parameter of the effect, which is the size plus `SensorFault.offset`, and its sigma."""
        return FaultQuantity.of(self.fault, self.size, self.variance)


def try_faults(base: KinematicFit, faults: Sequence[SensorFault]) -> list[FaultTrial]:
    """Return the trial of each fault in addition to those of ``base``. Trials are linearised, but a
    fault with a notable gain or size is fitted completely.
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
    white = float(sigmas.covariance[-1, -1])
    widening = float(sigmas.widening[-1])
    # Gusts reduce the likelihood too. With recorded controls, only the part of the residual that
    # the controls explain is compared.
    before, after = base.cost, kinematic_fit.cost
    if instrumented(base.signals):
        whiteners = [projected_whitener(s, kinematic_fit.noise) for s in kinematic_fit.signals]
        before, after = least_misfit(base, whiteners), least_misfit(kinematic_fit, whiteners)
    gain = max(before - after, 0.0) / widening
    return FaultTrial(
        fault,
        kinematic_fit,
        float(kinematic_fit.sizes[-1]),
        white,
        white * widening,
        gain,
        p_value(gain, kinematic_fit.sizes[-1], fault),
    )


def p_value(gain: float, size: float, fault: SensorFault) -> float:
    """Return the probability of a larger gain of log likelihood without the fault."""
    from scipy.special import chdtrc

    two_sided = float(chdtrc(1.0, 2.0 * gain))
    if not fault.one_sided:
        return two_sided
    return 0.5 * two_sided if size > 0 else 1.0 - 0.5 * two_sided


def estimate_of(trial: FaultTrial) -> SensorEstimate:
    """Return the estimate of a tried fault by both methods."""
    values, covariance = output_error(trial.fit)
    widening = trial.variance / trial.white_variance if trial.white_variance > 0 else 1.0
    other_variance = float(covariance[-1, -1]) * widening
    difference = difference_in_sigmas(float(values[-1]), other_variance, trial.size, trial.variance)
    return SensorEstimate.of(
        trial.fault,
        FaultQuantity.of(trial.fault, float(values[-1]), other_variance),
        trial.quantity,
        difference if trial.determined else 0.0,
        trial.gain,
        trial.p_value,
        trial.determined,
    )


def bias_estimates(base: KinematicFit) -> tuple[SensorEstimate, ...]:
    """Return the estimates of the biases that are unknowns in every fit of one record."""
    sigmas, (values, covariance) = smoother_sigmas(base), output_error(base)
    estimates = []
    for i, item in enumerate(unknowns_of(base.signals[0])):
        if item.key[1] != BIAS:
            continue
        fault = SensorFault(item.key[0], BIAS)
        widening, value = float(sigmas.widening[i]), float(base.own[0][i])
        other_value, other_variance = float(values[i]), float(covariance[i, i]) * widening
        variance = float(sigmas.covariance[i, i]) * widening
        quantities = [
            FaultQuantity.of(fault, *pair)
            for pair in ((other_value, other_variance), (value, variance))
        ]
        difference = difference_in_sigmas(other_value, other_variance, value, variance)
        estimates.append(SensorEstimate.of(fault, *quantities, difference, 0.0, 1.0, True))
    return tuple(estimates)


def with_more_faults(
    base: KinematicFit, faults: Sequence[SensorFault], sizes: np.ndarray
) -> KinematicFit:
    """Return the fit of one record with the ``faults`` of the joint fit, whose ``sizes (k,)`` are
    the starting values. Without faults the result is ``base``.
    """
    return fit(base.signals, faults, base, sizes) if faults else base


def records_agree(bases: Sequence[KinematicFit], current: KinematicFit, trial: FaultTrial) -> bool:
    """Return whether single records agree on the size of a fault, and their weighted mean is
    significant with the sign of the trial.

    The fault is tried in each record in addition to the faults of ``current``. ``bases`` are the
    fits of each record without faults.
    """
    from scipy.special import chdtrc

    if len(bases) < 2:
        return True
    single_trials = [
        try_faults(with_more_faults(base, current.faults, current.sizes), [trial.fault])[0]
        for base in bases
    ]
    sizes = np.array([t.size for t in single_trials if t.determined])
    weights = np.array([1.0 / t.variance for t in single_trials if t.determined])
    if len(sizes) < 2:
        return False
    mean = float(np.sum(weights * sizes) / np.sum(weights))
    scatter = float(np.sum(weights * (sizes - mean) ** 2))
    agree = float(chdtrc(len(sizes) - 1.0, scatter)) > CONTRADICTION_P_VALUE
    return agree and mean * math.copysign(1.0, trial.size) > LEAST_FAULT_SIGMAS / math.sqrt(
        float(np.sum(weights))
    )


def linearised_fits(base: KinematicFit, faults: Sequence[SensorFault]) -> list[KinematicFit]:
    """Return for each fault the linearised fit with this fault and those of ``base``, under the
    noise of ``base``.
    """
    white, places, slopes = whitened(base), positions(base), []
    information = np.diag(prior_information(base))
    gradient = np.zeros(sum(len(own) for own in base.own) + len(base.faults))
    for s, own, (e, jacobian), where in zip(base.signals, base.own, white, places, strict=True):
        J = jacobian.reshape(-1, jacobian.shape[2])
        information[np.ix_(where, where)] += J.T @ J
        gradient[where] += J.T @ e.ravel()
        sizes = np.append(base.sizes, np.zeros(len(faults)))
        slopes.append(
            linearised(s, unknowns_of(s), (*base.faults, *faults), own, sizes)[1][
                :, :, len(own) + len(base.faults) :
            ]
        )
    total = sum(len(own) for own in base.own)
    gradient[:total] -= prior_information(base)[:total] * np.concatenate(base.own)
    added = [
        projected_whitener(s, base.noise)(np.where(s.valid[:, :, None], slope, 0.0))
        for s, slope in zip(base.signals, slopes, strict=True)
    ]
    return [
        _linearised_fit(base, fault, j, white, places, slopes, added, information, gradient)
        for j, fault in enumerate(faults)
    ]


def _linearised_fit(
    base: KinematicFit,
    fault: SensorFault,
    j: int,
    white: Sequence[tuple[np.ndarray, np.ndarray]],
    places: Sequence[np.ndarray],
    slopes: Sequence[np.ndarray],
    added: Sequence[np.ndarray],
    information: np.ndarray,
    gradient: np.ndarray,
) -> KinematicFit:
    """Return the linearised fit with the fault at position ``j`` of `linearised_fits`.

    Parameters
    ----------
    white, places : results of `whitened` and `positions` for ``base``.
    slopes, added : ``(m, N, F)`` of each record, derivatives with respect to the F faults, plain
        and whitened.
    information, gradient : normal equations of ``base``.
    """
    n = len(gradient)
    extended, extended_gradient = np.zeros((n + 1, n + 1)), np.append(gradient, 0.0)
    extended[:n, :n] = information
    for (e, jacobian), where, columns in zip(white, places, added, strict=True):
        column = columns[:, :, j].ravel()
        extended[n, n] += column @ column
        extended[where, n] += jacobian.reshape(-1, jacobian.shape[2]).T @ column
        extended_gradient[n] += column @ e.ravel()
    extended[n, :n] = extended[:n, n]
    step = bounded_inverse(extended) @ extended_gradient
    step[n] = float(np.clip(step[n], -fault.largest, fault.largest))
    own, residuals, jacobians, outputs = [], [], [], []
    for r, (s, where, slope) in enumerate(zip(base.signals, places, slopes, strict=True)):
        jacobian = np.concatenate([base.jacobians[r], slope[:, :, j : j + 1]], axis=2)
        change = jacobian @ np.append(step[where], step[n])
        own.append(base.own[r] + step[where[: len(base.own[r])]])
        residuals.append(np.where(s.valid, base.residuals[r] - change, 0.0))
        jacobians.append(jacobian)
        outputs.append(base.outputs[r] + change)
    total = sum(len(o) for o in own)
    sizes = np.append(base.sizes + step[total:n], step[n])
    cost = base.cost - 0.5 * max(float(extended_gradient @ step), 0.0)
    return KinematicFit(
        base.signals,
        (*base.faults, fault),
        sizes,
        tuple(own),
        base.noise,
        cost,
        tuple(residuals),
        tuple(jacobians),
        tuple(outputs),
    )


# ---- Time references: channels without a delay

# channels that change fast enough to show a delay of a fraction of a second; airspeed does not
_TIMED = ("alpha", "q", "nz", "theta")


def time_references(signals: Sequence[KinematicSignals]) -> tuple[str, ...]:
    """Return the channels of which at least one must have no delay: it is the time reference.

    Without recorded controls the load is not among them. A gust changes the load before the flight
    path, so that alpha and q would seem late.
    """
    return tuple(
        name
        for name in _TIMED
        if name in signals[0].channels and (name != "nz" or instrumented(signals))
    )


def delayed_channels(faults: Iterable[SensorFault]) -> set[str]:
    """Return the fast channels (``_TIMED``) that these faults delay."""
    return {
        fault.channel for fault in faults if fault.kind in (DELAY, LAG) and fault.channel in _TIMED
    }


def leaves_time_reference(faults: Sequence[SensorFault], timed: Sequence[str]) -> bool:
    """Return whether these faults leave one of the channels ``timed`` without a delay. The
    kinematics determine only differences of delays.
    """
    # An accelerometer ahead of the centre of gravity has the same effect as a lag of q.
    delayed = delayed_channels(faults) | {"q" for fault in faults if fault.rare}
    return not timed or not set(timed) <= delayed


def reference_sentence(faults: Sequence[SensorFault], timed: Sequence[str]) -> str:
    """Return a sentence that names the channels in ``timed`` to which the delays of these faults
    refer; empty where none of them is delayed.
    """
    delayed = delayed_channels(faults)
    on_time = [name for name in timed if name not in delayed]
    if not delayed or not on_time:
        return ""
    if len(on_time) == 1:
        first = f"times count from {on_time[0]}, the channel that is least late"
    else:
        first = f"times count from {', '.join(on_time[:-1])} and {on_time[-1]}, which agree"
    return f"{first}: a delay common to all channels cannot be detected from kinematics"
