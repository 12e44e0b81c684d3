"""Signals of a record for the kinematics, with bridged gaps, and the noise of each relation.

A relation integrates noisy inputs, so that its residual is a random walk plus the noise of the
output. Differences of the residual between successive samples are correlated with their neighbours
only, so that a banded Cholesky factorisation gives the exact likelihood. It equals the likelihood
of a Kalman filter with the noise of the inputs as process noise.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ident.statistics.noise_levels import robust_sigma
from sim.maths import G0
from sim.record import Hold, Record

# ---- Signals of a record

# time (s) at both ends of a record without residuals: a delayed channel has no data there
IGNORED_ENDS = 0.1
LEAST_RECORD_ENDS = 50.0  # a shorter record, in units of IGNORED_ENDS, is used as a whole
CHANNELS = ("alpha", "q", "nz", "az", "theta", "airspeed", "ax")
SPIKE_SIGMAS = 8.0  # smallest spike, in robust sigmas
LEAST_SPIKE = 0.03  # smallest spike, relative to the range of the channel
_FEWEST_SPIKE_SAMPLES = 12  # a shorter column is not searched for spikes


@dataclass(frozen=True, eq=False)
class KinematicSignals:
    """Channels of a record over ``time (N,)``, s.

    Attributes
    ----------
    name : name of the record.
    channels : ``(N,)`` each, the channels that a relation uses; straight lines bridge gaps.
    outputs : the m states whose measurement is compared with their reconstruction.
    valid : ``(m, N)`` True where a sample of an output is used.
    speed : ``(N,)`` airspeed, m/s: measured, or a given constant.
    gravity : m/s2.
    vane_arm : known arm of the vane, m.
    jumps : ``(N,)`` part of nz (g) that jumps with the held inputs; empty without a held input.
    spikes : channel -> number of isolated wrong samples, which are not used.
    instruments : ``(N, L)`` filtered controls; L is 0 where no control is recorded.
    """

    name: str
    time: np.ndarray
    channels: Mapping[str, np.ndarray]
    outputs: tuple[str, ...]
    valid: np.ndarray
    speed: np.ndarray
    gravity: float
    vane_arm: float
    jumps: np.ndarray
    spikes: Mapping[str, int]
    instruments: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))

    @property
    def steps(self) -> np.ndarray:
        """Sampling intervals ``(N - 1,)``, s."""
        return np.diff(self.time)

    @cached_property
    def instrument_differences(self) -> np.ndarray:
        """`differences` ``(N m, m L)`` of `instruments_by_output`, the same for any noise."""
        return np.asfortranarray(differences(self.instruments_by_output))

    @property
    def instruments_by_output(self) -> np.ndarray:
        """Columns ``(m, N, m L)``: L instruments for each output, which are zero at the other
        outputs and where the output is not valid.
        """
        (m, n), count = self.valid.shape, self.instruments.shape[1]
        wide = np.zeros((m, n, m * count))
        for i in range(m):
            wide[i, :, i * count : (i + 1) * count] = np.where(
                self.valid[i][:, None], self.instruments, 0.0
            )
        return wide


# beginning of the note that relations cannot be used
NO_AIRSPEED = "no airspeed is recorded or given"


def relations(names: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Return output -> channels of its relation, for each kinematic relation whose channels are all
    among ``names``.
    """
    have, channels_by_output = set(names), {}
    if {"alpha", "q", "nz"} <= have:
        channels_by_output["alpha"] = ("alpha", "q", "nz", *(["theta"] if "theta" in have else []))
    if {"theta", "q"} <= have:
        channels_by_output["theta"] = ("theta", "q")
    if {"airspeed", "ax", "theta", "alpha", "q", "nz"} <= have:
        channels_by_output["airspeed"] = ("airspeed", "ax", "theta", "alpha", "nz")
    return channels_by_output


def signals_of(
    record: Record,
    channels: tuple[str, ...],
    airspeed: float | None,
    gravity: float,
    vane_arm: float = 0.0,
) -> KinematicSignals:
    """Return the signals of a record.

    Parameters
    ----------
    channels : the channels common to all records. Where a record has no nz, az gives nz = -az/g0.
    airspeed : m/s, where none is recorded; None without.
    gravity : m/s2.
    vane_arm : m.
    """
    bridged = bridged_channels(record, channels, _channel)
    related = relations(channels)
    used = {name for joined in related.values() for name in joined}
    used |= {"airspeed"} if "alpha" in related else set()
    jumps = _load_jumps(record, bridged.values) if "alpha" in related else np.zeros(0)
    return joined_signals(record, bridged, related, used, airspeed, gravity, vane_arm, jumps)


class BridgedChannels(NamedTuple):
    """Channels of a record by name: ``values (N,)`` with straight lines across gaps, the mask
    ``valid (N,)`` of samples that are used, and the number of isolated ``spikes``, which are not.
    """

    values: dict[str, np.ndarray]
    valid: dict[str, np.ndarray]
    spikes: dict[str, int]


def bridged_channels(
    record: Record,
    channels: Sequence[str],
    read: Callable[[Record, str], tuple[np.ndarray, np.ndarray]],
) -> BridgedChannels:
    """Return the ``channels`` of a record without isolated spikes. ``read`` returns the values
    ``(N,)`` of a channel and the mask of valid ones.
    """
    bridged = BridgedChannels({}, {}, {})
    for name in channels:
        values, mask = read(record, name)
        wrong = isolated_spikes(record.time[mask], values[mask])
        bridged.spikes[name] = int(np.count_nonzero(wrong))
        mask = mask.copy()
        mask[np.flatnonzero(mask)[wrong]] = False
        bridged.values[name] = np.interp(record.time, record.time[mask], values[mask])
        bridged.valid[name] = mask
    return bridged


def joined_signals(
    record: Record,
    bridged: BridgedChannels,
    related: Mapping[str, tuple[str, ...]],
    used: Collection[str],
    airspeed: float | None,
    gravity: float,
    vane_arm: float,
    jumps: np.ndarray,
) -> KinematicSignals:
    """Return the signals of a record from its bridged channels, of which those in ``used`` are
    kept, and its relations ``related``. The other arguments are those of `signals_of`, and the
    ``jumps`` of `KinematicSignals`.
    """
    t, values = record.time, bridged.values
    edge = IGNORED_ENDS if t[-1] - t[0] > LEAST_RECORD_ENDS * IGNORED_ENDS else 0.0
    inside = (t >= t[0] + edge) & (t <= t[-1] - edge)
    given_speed = np.full(len(record), np.inf if airspeed is None else airspeed)
    return KinematicSignals(
        record.name,
        t,
        {name: row for name, row in values.items() if name in used},
        tuple(related),
        np.array([bridged.valid[name] & inside for name in related]).reshape(-1, len(record)),
        values.get("airspeed", given_speed),
        gravity,
        vane_arm,
        jumps,
        bridged.spikes,
    )


def measured_channels(record: Record) -> tuple[str, ...]:
    """Return the channels of a record that the kinematics use; az is listed as nz."""
    have = set(record.output_names)
    names = [
        name
        for name in ("alpha", "q", "nz", "theta", "airspeed", "ax")
        if name in have or (name == "nz" and "az" in have)
    ]
    return tuple(name for name in names if np.count_nonzero(_channel(record, name)[1]) > 1)


def _channel(record: Record, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the values ``(N,)`` of a channel and its mask; az gives an unrecorded nz."""
    if name == "nz" and "nz" not in record.output_names:
        return -record["az"].values / G0, record["az"].valid
    return record[name].values, record[name].valid


def isolated_spikes(t: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return a mask ``(N,)``, True where a sample of ``x (N,)`` at times ``t (N,)`` is a spike.

    A spike is a single sample far from the lines through its two neighbours on each side, and from
    the mean of its neighbours. A corner of a signal is no spike: it is on one of the lines.
    """
    spikes = np.zeros(len(x), dtype=bool)
    if len(x) < _FEWEST_SPIKE_SAMPLES:
        return spikes
    left, right = np.full(len(x), np.inf), np.full(len(x), np.inf)
    left[2:] = x[2:] - x[1:-1] - (x[1:-1] - x[:-2]) * (t[2:] - t[1:-1]) / (t[1:-1] - t[:-2])
    right[:-2] = x[:-2] - x[1:-1] - (x[2:] - x[1:-1]) * (t[:-2] - t[1:-1]) / (t[2:] - t[1:-1])
    middle = np.full(len(x), np.inf)
    middle[1:-1] = x[1:-1] - 0.5 * (x[2:] + x[:-2])
    least = np.min(np.abs([left, right, middle]), axis=0)
    large = least > max(
        SPIKE_SIGMAS * robust_sigma(np.where(np.isfinite(middle), middle, 0.0)),
        LEAST_SPIKE * float(np.ptp(x)),
    )
    large[:2] = large[-2:] = False
    # A spike also moves its neighbours away from their lines, but by less.
    for i in np.flatnonzero(large):
        near = slice(max(i - 2, 0), i + 3)
        spikes[i] = least[i] == least[near].max()
    return spikes


def spike_notes(signals: Sequence[KinematicSignals]) -> list[str]:
    """Return sentences on isolated wrong samples, which the check does not use."""
    return [
        f"{count} isolated wrong sample{'s' * (count > 1)} of {name} in {s.name} set aside"
        for s in signals
        for name, count in s.spikes.items()
        if count
    ]


def _load_jumps(record: Record, bridged: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the part ``(N,)`` of nz that jumps between samples with the held inputs, by a
    regression of nz on the inputs, alpha and q; empty without a held input.
    """
    if record.hold is not Hold.PREVIOUS or not record.inputs:
        return np.zeros(0)
    u = np.array([channel.values - channel.values[0] for channel in record.inputs])
    size = np.abs(u).max(axis=1)
    u = u[size > 0] / size[size > 0, None]
    if not len(u):
        return np.zeros(0)
    columns = np.vstack(
        [
            u,
            bridged["alpha"] - bridged["alpha"].mean(),
            bridged["q"] - bridged["q"].mean(),
            np.ones(len(record)),
        ]
    ).T
    sizes, *_ = np.linalg.lstsq(
        columns / np.maximum(np.abs(columns).max(axis=0), 1e-12), bridged["nz"], rcond=None
    )
    return np.asarray(sizes[: len(u)] @ u)


def differences(columns: np.ndarray) -> np.ndarray:
    """Return the first sample of ``columns (m, N, c)``, then the differences of successive samples,
    as ``(N m, c)``. The m outputs of one sample are in successive rows.
    """
    m, n, c = columns.shape
    flat = np.empty((n, m, c))
    flat[0] = columns[:, 0]
    np.subtract(columns[:, 1:].transpose(1, 0, 2), columns[:, :-1].transpose(1, 0, 2), out=flat[1:])
    return flat.reshape(n * m, c)


# ---- The residual of an integrated relation

_NEGLIGIBLE_GAIN = 5e-3  # smallest gain of log likelihood by a step of the noise variances
_HIGHEST_LOG_VARIANCE = 20.0  # upper bound of the logarithm of a variance
# standard deviations of the prior of the logarithm of a density, below and above its mean
_LOWER_LOG_STD, _UPPER_LOG_STD = 0.5, 3.0
_MISSING_VARIANCE_FACTOR = 1e8  # variance of a missing sample, times the noise variance
# channels that the relation of an output integrates, and whose noise therefore makes a random walk
_INPUTS = {
    "alpha": ("q", "nz", "az"),
    "theta": ("q",),
    "airspeed": ("ax", "nx"),
    "phi": ("p",),
    "psi": ("r",),
    "beta": ("r", "ny", "ay"),
    "height": ("theta",),
    "altitude": ("theta",),
}


@dataclass(frozen=True, eq=False)
class RelationNoise:
    """Noise of the relations.

    Attributes
    ----------
    outputs, inputs : names of the m outputs and of the n integrated inputs.
    white : ``(m,)`` noise variance of the outputs.
    density : ``(n,)`` noise variance of the samples of the inputs.
    """

    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    white: np.ndarray
    density: np.ndarray

    @property
    def logs(self) -> np.ndarray:
        """Logarithms ``(m + n,)`` of all variances."""
        return np.log(np.concatenate([self.white, self.density]))

    def with_logs(self, logs: np.ndarray) -> RelationNoise:
        """Return the noise with variances of these logarithms ``(m + n,)``."""
        m = len(self.outputs)
        return RelationNoise(self.outputs, self.inputs, np.exp(logs[:m]), np.exp(logs[m:]))


def inputs_with_estimated_noise(outputs: Sequence[str]) -> tuple[str, ...]:
    """Return the inputs whose noise can be estimated. Where alpha is the only output, the noise of
    q also represents that of nz: the residual shows only their sum.
    """
    if tuple(outputs) == ("alpha",):
        return ("q",)
    return tuple(
        dict.fromkeys(
            name for output in outputs for name in _INPUTS[output] if name in ("q", "nz", "ax")
        )
    )


def inputs_of(output: str) -> tuple[str, ...]:
    """Return the inputs whose noise causes a random walk in an output."""
    return _INPUTS[output]


def noise_from_roughness(all_signals: Sequence[KinematicSignals]) -> RelationNoise:
    """Return starting values of the noise from third differences, which suppress smooth motion."""
    outputs = all_signals[0].outputs
    inputs = inputs_with_estimated_noise(outputs)
    rough = {
        name: float(np.mean([roughness(s.channels[name]) for s in all_signals]))
        for name in {*outputs, *inputs, *(["nz"] if "nz" in inputs else [])}
    }
    return RelationNoise(
        outputs,
        inputs,
        np.array([rough[name] for name in outputs]),
        np.array([rough[name] for name in inputs]),
    )


def rounding_variance(x: np.ndarray) -> float:
    """Return the variance of the rounding of a column ``x (N,)``.

    A value rounded to steps of d has an error of variance d^2/12. No recorder is better than single
    precision, whose steps are 2^-23 x at a value x. In a coarser column, the step is the smallest
    third difference that exceeds the rounding of single precision. In a column without steps this
    difference is far below the noise.
    """
    single_precision = 2.0**-23 * float(np.max(np.abs(x), initial=0.0))
    third = np.abs(np.diff(x, 3))
    steps = third[third > 8.0 * single_precision]  # 8 is the sum of the weights 1, 3, 3, 1
    step = float(np.min(steps)) if steps.size else 0.0
    return max(step, single_precision) ** 2 / 12.0


def rounding_variances(all_signals: Sequence[KinematicSignals], names: Sequence[str]) -> np.ndarray:
    """Return the variance of the rounding of each channel, ``(n,)``, from the record with the
    finest steps.
    """
    return np.array(
        [
            max(min(rounding_variance(s.channels[name]) for s in all_signals), 1e-20)
            for name in names
        ]
    )


def roughness(x: np.ndarray) -> float:
    """Return the noise variance of a column ``x (N,)``, from its third differences."""
    third = np.diff(x, 3)
    # The median is robust against the few steps of a held input. 0.6745 is the median absolute
    # value of a standard normal variable, and 20 the sum of the squared weights 1, 3, 3, 1.
    middle = float(np.median(np.abs(third))) / 0.6745 if third.size else 0.0
    return max(middle**2 / 20.0, 1e-10 * float(np.var(x)), rounding_variance(x), 1e-20)


def walk_gains(s: KinematicSignals, noise: RelationNoise) -> np.ndarray:
    """Return the rate ``(m, n)`` of each output, per second, for a unit of each input."""
    gains = np.zeros((len(noise.outputs), len(noise.inputs)))
    for i, output in enumerate(noise.outputs):
        for j, name in enumerate(noise.inputs):
            if name in _INPUTS[output]:
                gains[i, j] = _gain(s, output, name)
    return gains


def _gain(s: KinematicSignals, output: str, name: str) -> float:
    """Return the rate of an output for a unit of an input ``name``."""
    speed = float(np.mean(s.speed))
    if name in ("nz", "ny"):
        return s.gravity / speed
    if name in ("az", "ay"):
        return 1.0 / speed
    if name == "theta":
        return speed
    if name == "nx":
        return s.gravity
    return -1.0 if (output, name) == ("beta", "r") else 1.0


@dataclass(frozen=True, eq=False)
class RelationWhitener:
    """Whitening by the Cholesky factor of the covariance of differences.

    Attributes
    ----------
    band : the factor in the band storage of LAPACK.
    log_determinant : logarithm of the determinant of the covariance, without missing samples.
    """

    band: np.ndarray
    log_determinant: float

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        """Return ``columns (m, N, c)``, zero where a sample is missing, whitened to unit
        variance.
        """
        m, n, c = columns.shape
        return np.ascontiguousarray(
            self.of_differences(differences(columns)).reshape(n, m, c).transpose(1, 0, 2)
        )

    def of_differences(self, flat: np.ndarray) -> np.ndarray:
        """Return ``differences`` of columns, ``flat (N m, c)``, whitened."""
        from scipy.linalg.lapack import dtbtrs

        # without a right-hand side, dtbtrs of SciPy 1.17 writes beyond its memory
        if flat.shape[1] == 0:
            return np.empty(flat.shape)
        return np.asarray(dtbtrs(self.band, flat, uplo="L")[0])


def whitener(s: KinematicSignals, noise: RelationNoise) -> RelationWhitener:
    """Return the whitener of one record.

    Raises
    ------
    numpy.linalg.LinAlgError : where rounding makes the covariance indefinite.
    """
    from scipy.linalg.lapack import dpbtrf

    m, n = s.valid.shape
    white = np.where(s.valid, noise.white[:, None], _MISSING_VARIANCE_FACTOR * noise.white[:, None])
    gains = walk_gains(s, noise)
    walk = (gains * noise.density) @ gains.T
    band = np.zeros((2 * m, n, m))
    h2 = np.concatenate([[0.0], s.steps**2])
    for lower in range(m):
        for j in range(m - lower):
            band[lower, :, j] = walk[j + lower, j] * h2
    band[0] += white.T
    band[0, 1:] += white.T[:-1]
    band[m, :-1] -= white.T[:-1]
    # The diagonal at distance m runs from (k, i) to (k + 1, i); entries between belong to other
    # channels and are zero.
    factor, fault = dpbtrf(band.reshape(2 * m, n * m)[: m + 1], lower=1)
    if fault:
        raise np.linalg.LinAlgError("the covariance is not positive definite")
    lost = float(np.sum(np.log(white[~s.valid])))
    return RelationWhitener(factor, 2.0 * float(np.sum(np.log(factor[0]))) - lost)


@dataclass(frozen=True, eq=False)
class NoiseEvidence:
    """Data from which noise variances are estimated.

    Attributes
    ----------
    signals : of each record.
    residuals : ``(m, N)`` of each record.
    sensitivities : ``(m, N, n)`` of each record, derivatives with respect to its n unknowns, whose
        fit has removed a part of the noise.
    priors : ``(n,)`` of each record, one over the prior variances of these unknowns.
    prior_noise : noise about which the densities have a prior.
    """

    signals: tuple[KinematicSignals, ...]
    residuals: tuple[np.ndarray, ...]
    sensitivities: tuple[np.ndarray, ...]
    priors: tuple[np.ndarray, ...]
    prior_noise: RelationNoise

    @cached_property
    def differences(self) -> tuple[np.ndarray, ...]:
        """``differences`` of the residual and sensitivities of each record, ``(N m, 1 + n)``; they
        do not depend on the noise.
        """
        return tuple(
            np.asfortranarray(differences(np.concatenate([residual[:, :, None], columns], axis=2)))
            for residual, columns in zip(self.residuals, self.sensitivities, strict=True)
        )


def estimated_noise(
    evidence: NoiseEvidence, noise: RelationNoise, passes: int
) -> tuple[RelationNoise, float]:
    """Return the noise of greatest restricted likelihood, and minus the log likelihood, after at
    most ``passes`` Newton steps on the logarithms of the variances.

    Mixed second derivatives are neglected. No variance is below that of rounding
    (`rounding_variances`).
    """
    cost = noise_cost(evidence, noise)
    least = np.log(rounding_variances(evidence.signals, (*noise.outputs, *noise.inputs)))
    for _ in range(passes):
        logs, before = noise.logs, cost
        above, below = np.empty(len(logs)), np.empty(len(logs))
        for i in range(len(logs)):
            up, down = logs.copy(), logs.copy()
            up[i] += 0.2
            down[i] -= 0.2
            above[i], below[i] = (noise_cost(evidence, noise.with_logs(x)) for x in (up, down))
        slope, curvature = (above - below) / 0.4, (above + below - 2.0 * cost) / 0.04
        least_curvature = 0.4 * np.abs(slope) + 1e-3
        step = np.clip(-slope / np.maximum(curvature, least_curvature), -2.5, 2.5)
        for share in (1.0, 0.4, 0.1):
            trial = noise.with_logs(np.clip(logs + share * step, least, _HIGHEST_LOG_VARIANCE))
            trial_cost = noise_cost(evidence, trial)
            if trial_cost < cost:
                noise, cost = trial, trial_cost
                break
        if before - cost < _NEGLIGIBLE_GAIN:
            break
    return noise, cost


def noise_cost(evidence: NoiseEvidence, noise: RelationNoise) -> float:
    """Return minus the log restricted likelihood (Patterson and Thompson, Biometrika 58(3), 1971)
    without constants; infinite where the covariance is not positive definite.

    The density of an input has a prior about the noise in the third differences of its channel. The
    density is hardly smaller, since the differences include all white noise. It may be far larger
    where a filter has smoothed the channel.
    """
    total = 0.0
    for s, flat, prior in zip(evidence.signals, evidence.differences, evidence.priors, strict=True):
        try:
            white = whitener(s, noise)
            columns = white.of_differences(flat)
            e, J = columns[:, 0], columns[:, 1:]
            sign, determinant = np.linalg.slogdet(J.T @ J + np.diag(prior))
        except np.linalg.LinAlgError:
            return float("inf")
        total += 0.5 * white.log_determinant + 0.5 * float(np.sum(e**2))
        total += 0.5 * float(determinant) if sign > 0 else 0.0
    log_ratio = np.log(noise.density / evidence.prior_noise.density)
    std = np.where(log_ratio < 0, _LOWER_LOG_STD, _UPPER_LOG_STD)
    return total + 0.5 * float(np.sum((log_ratio / std) ** 2))


def smoothed_walk(s: KinematicSignals, noise: RelationNoise, residual: np.ndarray) -> np.ndarray:
    """Return the most likely random walk ``(m, N)`` that the noise of the inputs causes, given the
    ``residual (m, N)``.

    One solution of linear equations replaces a fixed-interval smoother: the walk is the residual r
    minus the expected measurement noise R S^-1 r, with R the covariance of that noise and S the
    covariance of r.
    """
    from scipy.linalg.lapack import dpbtrs

    m, n = residual.shape
    solved, _ = dpbtrs(whitener(s, noise).band, differences(residual[:, :, None]), lower=1)
    y = solved.reshape(n, m).T
    back = y.copy()
    back[:, :-1] -= y[:, 1:]
    white = np.where(s.valid, noise.white[:, None], _MISSING_VARIANCE_FACTOR * noise.white[:, None])
    return np.asarray(residual - white * back)
