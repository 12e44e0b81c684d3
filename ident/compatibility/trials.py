"""Result of a check of the kinematics, and the trial of one fault in addition to others."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ident.compatibility.fitting import (
    KinematicFit,
    difference_in_sigmas,
    fit,
    least_misfit,
    output_error,
    positions,
    prior_information,
    smoother_sigmas,
    whitened,
)
from ident.compatibility.instruments import instrumented, weigher
from ident.compatibility.kinematics import BIAS, SensorFault, linearised, unknowns_of
from ident.statistics.intervals import bounded_inverse
from sim.maths import G0

# ---- Result of a check


@dataclass(frozen=True)
class CompatibilitySettings:
    """Settings of a check.

    ``airspeed`` (m/s) is used if none is recorded; None omits the relation of alpha then.
    ``gravity`` in m/s2. ``vane_arm`` (m) is the known arm; findings add to it. ``chord`` (m) scales
    usual sensor positions; zero if unknown. ``false_alarm`` : share of sound sets of records with
    any accepted fault. ``most`` : largest number of accepted faults.
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


@dataclass(frozen=True)
class SensorEstimate:
    """One fault alone, by both methods; the other sensors are assumed correct.

    ``difference``: output error less smoother, in standard deviations of that difference.
    ``determined``: whether the standard deviation is below the size that is common in practice.
    ``gain``: increase of the log likelihood under coloured residuals; ``p_value`` of that gain,
    one-sided if only one sign is possible.
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

    @property
    def agrees(self) -> bool:
        """Whether the two methods agree within three standard deviations."""
        return abs(self.difference) <= 3.0


@dataclass(frozen=True)
class SensorFinding:
    """One fault tested under coloured residuals, in addition to the accepted ones.

    ``kind``: scale, delay, lag, drift or arm; ``name`` the effect's name. ``value`` is the effect's
    own parameter: a scale is a factor. ``gain`` of the log likelihood. ``stands``: accepted, itself
    or one of its ``group`` (names). ``replicates``: single records agree; True for one record.
    ``lost``: log likelihood lost with it in place of the nearest accepted fault, zero for the best
    of a group; None without an accepted fault or if it was refused. ``probabilities`` of the fault
    and its group by name, from likelihoods and priors of sensor positions.
    """

    channel: str
    kind: str
    value: float
    std: float
    unit: str
    gain: float
    stands: bool
    group: tuple[str, ...]
    name: str = ""
    replicates: bool = True
    lost: float | None = None
    probabilities: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """One record: by output, the measurement, its reconstruction from other channels, and the
    residual. ``(N,)`` each, SI.

    ``recorded`` is integrated from the measured inputs, ``integrated`` from them without the
    accepted faults, ``smoothed`` also uses the output; ``used`` is False where a sample is missing
    or set aside.
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
    """A check of one record, or of several together (``records``: their names).

    ``biases``: of one record only. ``noise_std`` by channel, unit of the channel: of the outputs,
    and of the inputs by the walk of their integral.
    """

    records: tuple[str, ...]
    estimates: tuple[SensorEstimate, ...]
    biases: tuple[SensorEstimate, ...]
    findings: tuple[SensorFinding, ...]
    noise_std: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Compatibility:
    """The result of ``compatibility``.

    Attributes
    ----------
    channels : all that were looked at.
    relations : by output, the channels that its relation joins.
    joint : all records together, sensor faults in common; ``single``: each by itself, empty where
        that was not asked.
    cannot_tell : sentences, from the information of the records.
    notes : what else there is to say.
    """

    channels: tuple[str, ...]
    relations: Mapping[str, tuple[str, ...]]
    joint: CheckResult
    single: tuple[CheckResult, ...]
    reconstructions: tuple[Reconstruction, ...]
    cannot_tell: tuple[str, ...]
    notes: tuple[str, ...] = field(default=())

    @property
    def findings(self) -> tuple[SensorFinding, ...]:
        """Findings of all records together, accepted ones first."""
        return self.joint.findings


# ---- Trial of one fault in addition to others

LEAST_PROJECTED_GAIN = 2.5  # smallest first-order gain of a fault that is fitted completely
CONTRADICTION_P_VALUE = 1e-3  # p-value below which the records contradict each other
LEAST_FAULT_SIGMAS = 3.0


@dataclass(frozen=True, eq=False)
class FaultTrial:
    """A fault fitted beside others: the fit, its variance (white and coloured residuals), gain and
    p-value.
    """

    fault: SensorFault
    fit: KinematicFit
    size: float
    white: float
    variance: float
    gain: float
    p_value: float

    @property
    def determined(self) -> bool:
        return 0.0 < self.variance < self.fault.plausible**2


def tried(base: KinematicFit, faults: Sequence[SensorFault]) -> list[FaultTrial]:
    """Each fault added to those of ``base``: linearised, and fitted in full if it may matter."""
    out = []
    for fault, quick in zip(faults, one_step(base, faults), strict=True):
        first = _trial(base, fault, quick)
        worth = first.gain > LEAST_PROJECTED_GAIN or abs(first.size) > 0.5 * fault.plausible
        out.append(
            _trial(base, fault, fit(base.signals, (*base.faults, fault), base)) if worth else first
        )
    return out


def _trial(base: KinematicFit, fault: SensorFault, kinematic_fit: KinematicFit) -> FaultTrial:
    sigmas = smoother_sigmas(kinematic_fit)
    white = float(sigmas.covariance[-1, -1])
    widening = float(sigmas.widening[-1])
    # A likelihood includes gusts: with recorded controls, only the part of the residual that they
    # explain counts.
    before, after = base.cost, kinematic_fit.cost
    if instrumented(base.signals):
        whiteners = [weigher(s, kinematic_fit.noise) for s in kinematic_fit.signals]
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
    """Return the probability of such a gain of log likelihood without the fault."""
    from scipy.special import chdtrc

    if fault.one_sided:
        return (
            0.5 * float(chdtrc(1.0, 2.0 * gain))
            if size > 0
            else 1.0 - 0.5 * float(chdtrc(1.0, 2.0 * gain))
        )
    return float(chdtrc(1.0, 2.0 * gain))


def estimate_of(trial: FaultTrial) -> SensorEstimate:
    """Return a fault by both methods."""
    values, covariance = output_error(trial.fit)
    widening = trial.variance / trial.white if trial.white > 0 else 1.0
    own = float(covariance[-1, -1]) * widening
    difference = difference_in_sigmas(float(values[-1]), own, trial.size, trial.variance)
    fault = trial.fault
    return SensorEstimate(
        fault.name,
        fault.channel,
        fault.kind,
        fault.unit,
        FaultQuantity(float(values[-1]) + fault.offset, math.sqrt(max(own, 0.0))),
        FaultQuantity(trial.size + fault.offset, math.sqrt(max(trial.variance, 0.0))),
        difference if trial.determined else 0.0,
        trial.gain,
        trial.p_value,
        trial.determined,
    )


def bias_estimates(base: KinematicFit) -> tuple[SensorEstimate, ...]:
    """Return the biases that are free in every fit of one record."""
    sigmas, (values, covariance) = smoother_sigmas(base), output_error(base)
    out = []
    for i, item in enumerate(unknowns_of(base.signals[0])):
        if item.key[1] != BIAS:
            continue
        fault = SensorFault(item.key[0], BIAS)
        wide = float(sigmas.widening[i])
        one, other = float(covariance[i, i]) * wide, float(sigmas.covariance[i, i]) * wide
        value = float(base.own[0][i])
        out.append(
            SensorEstimate(
                fault.name,
                fault.channel,
                BIAS,
                fault.unit,
                FaultQuantity(float(values[i]), math.sqrt(one)),
                FaultQuantity(value, math.sqrt(other)),
                difference_in_sigmas(float(values[i]), one, value, other),
                0.0,
                1.0,
                True,
            )
        )
    return tuple(out)


def with_more_faults(
    base: KinematicFit, faults: Sequence[SensorFault], sizes: np.ndarray
) -> KinematicFit:
    """Fit one record with the faults of all records."""
    return fit(base.signals, faults, base, sizes) if faults else base


def replicates(bases: Sequence[KinematicFit], current: KinematicFit, trial: FaultTrial) -> bool:
    """Return whether the records agree on a fault one by one, beside the accepted ones, and
    together require it with the common sign.
    """
    from scipy.special import chdtrc

    if len(bases) < 2:
        return True
    alone = [
        tried(with_more_faults(base, current.faults, current.sizes), [trial.fault])[0]
        for base in bases
    ]
    v = np.array([t.size for t in alone if t.determined])
    w = np.array([1.0 / t.variance for t in alone if t.determined])
    if len(v) < 2:
        return False
    mean = float(np.sum(w * v) / np.sum(w))
    agree = float(chdtrc(len(v) - 1.0, float(np.sum(w * (v - mean) ** 2)))) > CONTRADICTION_P_VALUE
    return agree and mean * math.copysign(1.0, trial.size) > LEAST_FAULT_SIGMAS / math.sqrt(
        float(np.sum(w))
    )


def one_step(base: KinematicFit, faults: Sequence[SensorFault]) -> list[KinematicFit]:
    """Return, for each fault, the linearised fit with it added to ``base``, with the noise of
    ``base``.
    """
    white, at, slopes = whitened(base), positions(base), []
    information = np.diag(prior_information(base))
    gradient = np.zeros(sum(len(own) for own in base.own) + len(base.faults))
    for s, own, (e, jacobian), where in zip(base.signals, base.own, white, at, strict=True):
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
        weigher(s, base.noise)(np.where(s.valid[:, :, None], slope, 0.0))
        for s, slope in zip(base.signals, slopes, strict=True)
    ]
    return [
        _with_step(base, fault, j, white, at, slopes, added, information, gradient)
        for j, fault in enumerate(faults)
    ]


def _with_step(
    base: KinematicFit,
    fault: SensorFault,
    j: int,
    white: Sequence[tuple[np.ndarray, np.ndarray]],
    at: Sequence[np.ndarray],
    slopes: Sequence[np.ndarray],
    added: Sequence[np.ndarray],
    information: np.ndarray,
    gradient: np.ndarray,
) -> KinematicFit:
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
