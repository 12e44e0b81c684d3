"""Records made ready for the kinematics: bridged gaps, noise of each relation, instruments.

Differences of samples are correlated with their neighbours only, so that one banded Cholesky
factorisation gives the exact likelihood for all columns. The result equals that of a Kalman filter
with the inputs' noise as process noise.

A gust w changes the vane's reading by w/V and the load at once. The residual of the kinematics is
then correlated with nz and the rate of alpha, and a regression on these is biased. The controls are
independent of the gust, so that filtered controls are instruments: regression after projection on
them is unbiased for any response of the aircraft (two-stage least squares; Sargan, Econometrica
26(3), 1958).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np

from ident.statistics.noise_levels import robust_sigma
from sim.maths import G0
from sim.record import Hold, Record

# ---- A record made ready for the kinematics

# s at both ends of a record without residuals: a delayed channel has no data there
IGNORED_ENDS = 0.1
CHANNELS = ("alpha", "q", "nz", "az", "theta", "airspeed", "ax")
SPIKE_SIGMAS = 8.0  # smallest spike, in robust sigmas
LEAST_SPIKE = 0.03  # smallest spike, relative to the channel's range


@dataclass(frozen=True, eq=False)
class KinematicSignals:
    """Channels of a record over ``time (N,)``, s.

    Attributes
    ----------
    name : the record's.
    channels : those that a relation uses, ``(N,)`` each, gaps bridged by straight lines.
    outputs : states whose measurement is compared with their reconstruction.
    valid : ``(m, N)`` samples that count.
    speed : ``(N,)`` m/s, measured or the constant.
    gravity : m/s2.
    vane_arm : m, known beforehand.
    jumps : ``(N,)`` g, about how far nz may have jumped at the held inputs' switches, summed up;
        empty without a held input.
    spikes : number of isolated wrong samples set aside, by channel.
    instruments : ``(N, L)``, what the recorded controls have moved
        (``ident.compatibility.signals``); none where no control is recorded.
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
        return np.diff(self.time)

    @cached_property
    def instrument_differences(self) -> np.ndarray:
        """``differences`` of the instruments, for each output by itself and where it is measured:
        ``(N m, m L)``, the same whatever the noise.
        """
        return np.asfortranarray(differences(self.instruments_by_output))

    @property
    def instruments_by_output(self) -> np.ndarray:
        """Columns ``(m, N, m L)``: the instruments of each output by itself, zero where it is not
        measured.
        """
        (m, n), count = self.valid.shape, self.instruments.shape[1]
        wide = np.zeros((m, n, m * count))
        for i in range(m):
            wide[i, :, i * count : (i + 1) * count] = np.where(
                self.valid[i][:, None], self.instruments, 0.0
            )
        return wide


NO_AIRSPEED = "no airspeed is recorded or given"  # beginning of the note on missing relations


def relations(names: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Output of each kinematic relation that these channels close, and the channels that it
    joins.
    """
    have, out = set(names), {}
    if {"alpha", "q", "nz"} <= have:
        out["alpha"] = ("alpha", "q", "nz", *(["theta"] if "theta" in have else []))
    if {"theta", "q"} <= have:
        out["theta"] = ("theta", "q")
    if {"airspeed", "ax", "theta", "alpha", "q", "nz"} <= have:
        out["airspeed"] = ("airspeed", "ax", "theta", "alpha", "nz")
    return out


def signals_of(
    record: Record,
    channels: tuple[str, ...],
    airspeed: float | None,
    gravity: float,
    vane_arm: float = 0.0,
) -> KinematicSignals:
    """Make a record ready; ``channels`` are those common to all records. az serves as nz = -az/g0
    where there is no nz.
    """
    raw, valid, spikes = {}, {}, {}
    for name in channels:
        values, there = _channel(record, name)
        wrong = isolated(record.time[there], values[there])
        spikes[name] = int(np.count_nonzero(wrong))
        there = there.copy()
        there[np.flatnonzero(there)[wrong]] = False
        raw[name], valid[name] = np.interp(record.time, record.time[there], values[there]), there
    relation_list = relations(channels)
    used = {name for joined in relation_list.values() for name in joined}
    edge = IGNORED_ENDS if record.time[-1] - record.time[0] > 50.0 * IGNORED_ENDS else 0.0
    inside = (record.time >= record.time[0] + edge) & (record.time <= record.time[-1] - edge)
    speed = (
        raw["airspeed"]
        if "airspeed" in raw
        else np.full(len(record), airspeed if airspeed is not None else np.inf)
    )
    return KinematicSignals(
        record.name,
        record.time,
        {
            name: raw[name]
            for name in channels
            if name in used or (name == "airspeed" and "alpha" in relation_list)
        },
        tuple(relation_list),
        np.array([valid[name] & inside for name in relation_list]).reshape(
            len(relation_list), len(record)
        ),
        speed,
        gravity,
        vane_arm,
        _load_jumps(record, raw) if "alpha" in relation_list else np.zeros(0),
        spikes,
    )


def measured_channels(record: Record) -> tuple[str, ...]:
    """Return the channels of a record that the kinematics use, with az as nz."""
    have = set(record.output_names)
    names = [
        name
        for name in ("alpha", "q", "nz", "theta", "airspeed", "ax")
        if name in have or (name == "nz" and "az" in have)
    ]
    return tuple(name for name in names if np.count_nonzero(_channel(record, name)[1]) > 1)


def _channel(record: Record, name: str) -> tuple[np.ndarray, np.ndarray]:
    if name == "nz" and "nz" not in record.output_names:
        return -record["az"].values / G0, record["az"].valid
    return record[name].values, record[name].valid


def isolated(t: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return True at single samples that neither adjacent line, nor the neighbours' mean, explains;
    corners are not spikes.
    """
    out = np.zeros(len(x), dtype=bool)
    if len(x) < 12:
        return out
    left, right = np.full(len(x), np.inf), np.full(len(x), np.inf)
    left[2:] = x[2:] - x[1:-1] - (x[1:-1] - x[:-2]) * (t[2:] - t[1:-1]) / (t[1:-1] - t[:-2])
    right[:-2] = x[:-2] - x[1:-1] - (x[2:] - x[1:-1]) * (t[:-2] - t[1:-1]) / (t[2:] - t[1:-1])
    away = np.full(len(x), np.inf)
    away[1:-1] = x[1:-1] - 0.5 * (x[2:] + x[:-2])
    least = np.min(np.abs([left, right, away]), axis=0)
    large = least > max(
        SPIKE_SIGMAS * robust_sigma(np.where(np.isfinite(away), away, 0.0)),
        LEAST_SPIKE * float(np.ptp(x)),
    )
    large[:2] = large[-2:] = False
    # A spike also disturbs its neighbours' comparison, by less.
    for i in np.flatnonzero(large):
        near = slice(max(i - 2, 0), i + 3)
        out[i] = least[i] == least[near].max()
    return out


def _load_jumps(record: Record, raw: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the regression of nz on a held input, times that input: the part of the load that
    jumps between samples.
    """
    if record.hold is not Hold.PREVIOUS or not record.inputs:
        return np.zeros(0)
    u = np.array([channel.values - channel.values[0] for channel in record.inputs])
    size = np.abs(u).max(axis=1)
    u = u[size > 0] / size[size > 0, None]
    if not len(u):
        return np.zeros(0)
    columns = np.vstack(
        [u, raw["alpha"] - raw["alpha"].mean(), raw["q"] - raw["q"].mean(), np.ones(len(record))]
    ).T
    sizes, *_ = np.linalg.lstsq(
        columns / np.maximum(np.abs(columns).max(axis=0), 1e-12), raw["nz"], rcond=None
    )
    return np.asarray(sizes[: len(u)] @ u)


def differences(columns: np.ndarray) -> np.ndarray:
    """Return the differences of neighbouring samples of columns ``(m, N, c)``, the first sample
    itself; all outputs of a sample together: ``(N m, c)``.
    """
    m, n, c = columns.shape
    flat = np.empty((n, m, c))
    flat[0] = columns[:, 0]
    np.subtract(columns[:, 1:].transpose(1, 0, 2), columns[:, :-1].transpose(1, 0, 2), out=flat[1:])
    return flat.reshape(n * m, c)


# ---- The residual of an integrated relation

_MISSING_VARIANCE_FACTOR = 1e8  # variance of a missing sample, times the noise variance
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
    """``white (m,)``: variance of each output's noise. ``inputs``: names, and ``density (n,)``
    variance of each input's samples.
    """

    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    white: np.ndarray
    density: np.ndarray

    @property
    def logs(self) -> np.ndarray:
        return np.log(np.concatenate([self.white, self.density]))

    def with_logs(self, logs: np.ndarray) -> RelationNoise:
        m = len(self.outputs)
        return RelationNoise(self.outputs, self.inputs, np.exp(logs[:m]), np.exp(logs[m:]))


def walking_inputs(outputs: Sequence[str]) -> tuple[str, ...]:
    """Return the inputs whose noise can be estimated; if alpha alone is integrated, q includes the
    noise of nz.
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


def first_noise(all_signals: Sequence[KinematicSignals]) -> RelationNoise:
    """Return starting values of the noise from third differences, which suppress smooth motion."""
    outputs = all_signals[0].outputs
    inputs = walking_inputs(outputs)
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


def resolution(x: np.ndarray) -> float:
    """Return the variance of rounding in a column: to its least step, or to single precision, the
    best of recorders.

    A value rounded to steps of d has an error of variance d^2/12. A single-precision number of size
    x has steps of 2^-23 x. The least step of a column is its smallest third difference above that;
    without steps this is far below the noise.
    """
    single = 2.0**-23 * float(np.max(np.abs(x), initial=0.0))
    third = np.abs(np.diff(x, 3))
    moved = third[third > 8.0 * single]  # of four rounded values with weights 1, 3, 3, 1
    return max(float(np.min(moved, initial=np.inf)) if moved.size else 0.0, single) ** 2 / 12.0


def floors(all_signals: Sequence[KinematicSignals], names: Sequence[str]) -> np.ndarray:
    """Return the least variance that each of the channels can have, by the finest record."""
    return np.array(
        [max(min(resolution(s.channels[name]) for s in all_signals), 1e-20) for name in names]
    )


def roughness(x: np.ndarray) -> float:
    """Return the variance of a channel's noise as its third differences show it."""
    third = np.diff(x, 3)
    # The median is robust against the few switches of a held input.
    middle = float(np.median(np.abs(third))) / 0.6745 if third.size else 0.0
    return max(middle**2 / 20.0, 1e-10 * float(np.var(x)), resolution(x), 1e-20)


def walk_gains(s: KinematicSignals, noise: RelationNoise) -> np.ndarray:
    """Effect of each input's noise on each output's walk over one second, ``(m, n)``."""
    out = np.zeros((len(noise.outputs), len(noise.inputs)))
    for i, output in enumerate(noise.outputs):
        for j, name in enumerate(noise.inputs):
            if name in _INPUTS[output]:
                out[i, j] = _gain(s, output, name)
    return out


def _gain(s: KinematicSignals, output: str, name: str) -> float:
    speed = float(np.mean(s.speed))
    if name in ("nz", "ny"):
        return s.gravity / speed
    if name in ("az", "ay"):
        return 1.0 / speed
    if name == "theta":
        return speed
    return {"nx": s.gravity}.get(name, -1.0 if (output, name) == ("beta", "r") else 1.0)


@dataclass(frozen=True, eq=False)
class RelationWhitener:
    """Cholesky factor of the differences' covariance; ``log_determinant`` without missing
    samples.
    """

    band: np.ndarray
    log_determinant: float

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        """Return the columns ``(m, N, c)``, zero where a sample is missing, as those of independent
        samples of variance one: ``(m, N, c)``.
        """
        m, n, c = columns.shape
        return np.ascontiguousarray(
            self.of_differences(differences(columns)).reshape(n, m, c).transpose(1, 0, 2)
        )

    def of_differences(self, flat: np.ndarray) -> np.ndarray:
        """Whiten ``differences`` of columns ``(N m, c)``, in their order."""
        from scipy.linalg.lapack import dtbtrs

        # SciPy 1.17's dtbtrs writes beyond its memory for no right-hand side
        if flat.shape[1] == 0:
            return np.empty(flat.shape)
        return np.asarray(dtbtrs(self.band, flat, uplo="L")[0])


def whitener(s: KinematicSignals, noise: RelationNoise) -> RelationWhitener:
    """Return the whitener of one record. Raises numpy.linalg.LinAlgError for variances that are no
    longer positive in rounding.
    """
    from scipy.linalg.lapack import dpbtrf

    m, n = s.valid.shape
    own = np.where(s.valid, noise.white[:, None], _MISSING_VARIANCE_FACTOR * noise.white[:, None])
    gains = walk_gains(s, noise)
    walk = (gains * noise.density) @ gains.T
    band = np.zeros((2 * m, n, m))
    h2 = np.concatenate([[0.0], s.steps**2])
    for lower in range(m):
        for j in range(m - lower):
            band[lower, :, j] = walk[j + lower, j] * h2
    band[0] += own.T
    band[0, 1:] += own.T[:-1]
    band[m, :-1] -= own.T[:-1]
    # The diagonal at distance m runs from (k, i) to (k + 1, i); entries between belong to other
    # channels and are zero.
    factor, fault = dpbtrf(band.reshape(2 * m, n * m)[: m + 1], lower=1)
    if fault:
        raise np.linalg.LinAlgError("the covariance is not positive definite")
    lost = float(np.sum(np.log(own[~s.valid])))
    return RelationWhitener(factor, 2.0 * float(np.sum(np.log(factor[0]))) - lost)


@dataclass(frozen=True, eq=False)
class NoiseEvidence:
    """Data from which variances are estimated: residuals ``(m, N)`` of each record and the
    sensitivities ``(m, N, n)`` to its own unknowns, whose fit has removed some of the noise;
    ``priors (n,)`` information on these.
    """

    signals: tuple[KinematicSignals, ...]
    residuals: tuple[np.ndarray, ...]
    sensitivities: tuple[np.ndarray, ...]
    priors: tuple[np.ndarray, ...]
    begun: RelationNoise

    @cached_property
    def differences(self) -> tuple[np.ndarray, ...]:
        """``differences`` of each record's residual and, after it, its sensitivities: the same
        whatever the noise.
        """
        return tuple(
            np.asfortranarray(differences(np.concatenate([residual[:, :, None], columns], axis=2)))
            for residual, columns in zip(self.residuals, self.sensitivities, strict=True)
        )


def settled_noise(
    evidence: NoiseEvidence, noise: RelationNoise, passes: int
) -> tuple[RelationNoise, float]:
    """Return the variances of greatest restricted likelihood, and minus its logarithm: Newton steps
    on their logarithms, one by one.

    No variance falls below what the column resolves (``floors``).
    """
    cost = noise_cost(evidence, noise)
    least = np.log(floors(evidence.signals, (*noise.outputs, *noise.inputs)))
    for _ in range(passes):
        logs, before = noise.logs, cost
        ahead, behind = np.empty(len(logs)), np.empty(len(logs))
        for i in range(len(logs)):
            up, down = logs.copy(), logs.copy()
            up[i] += 0.2
            down[i] -= 0.2
            ahead[i], behind[i] = (noise_cost(evidence, noise.with_logs(x)) for x in (up, down))
        slope, bend = (ahead - behind) / 0.4, (ahead + behind - 2.0 * cost) / 0.04
        step = np.clip(-slope / np.maximum(bend, 0.4 * np.abs(slope) + 1e-3), -2.5, 2.5)
        for share in (1.0, 0.4, 0.1):
            trial = noise.with_logs(np.clip(logs + share * step, least, 20.0))
            trial_cost = noise_cost(evidence, trial)
            if trial_cost < cost:
                noise, cost = trial, trial_cost
                break
        if before - cost < 5e-3:
            break
    return noise, cost


def noise_cost(evidence: NoiseEvidence, noise: RelationNoise) -> float:
    """Minus the log restricted likelihood (Patterson and Thompson, Biometrika 58(3), 1971), without
    constants; infinite where it fails.

    The inputs' densities have a prior about the roughness of their channels: hardly less, since
    roughness includes all white noise; possibly far more, if a filter has reduced the roughness.
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
        total += (
            0.5 * white.log_determinant
            + 0.5 * float(np.sum(e**2))
            + (0.5 * float(determinant) if sign > 0 else 0.0)
        )
    away = np.log(noise.density / evidence.begun.density)
    return total + 0.5 * float(np.sum(np.where(away < 0, away / 0.5, away / 3.0) ** 2))


def smoothed_walk(s: KinematicSignals, noise: RelationNoise, residual: np.ndarray) -> np.ndarray:
    """Return the most likely random walk ``(m, N)`` from the inputs' noise, given the residuals
    ``(m, N)``.

    The fixed-interval smoother in one solve: the residual less the expected noise of the
    measurement, R S^-1 r.
    """
    from scipy.linalg.lapack import dpbtrs

    m, n = residual.shape
    solved, _ = dpbtrs(whitener(s, noise).band, differences(residual[:, :, None]), lower=1)
    y = solved.reshape(n, m).T
    back = y.copy()
    back[:, :-1] -= y[:, 1:]
    own = np.where(s.valid, noise.white[:, None], _MISSING_VARIANCE_FACTOR * noise.white[:, None])
    return np.asarray(residual - own * back)


# ---- Instruments: filtered controls

# s before the sample, bounds of the intervals of control means (an impulse response in steps)
_INTERVAL_BOUNDS = (0.0, 0.08, 0.16, 0.28, 0.4, 0.55, 0.75, 1.0, 1.3, 1.7, 2.2, 2.8, 3.5, 4.5)
_SAMPLES_PER_INSTRUMENT = 6  # fewest samples per instrument
_ROUNDING_EIGENVALUE_SHARE = 1e-9  # smallest eigenvalue above rounding, relative to the largest

Weigher = Callable[[np.ndarray], np.ndarray]


def instruments_of(record: Record, every: int = 1) -> np.ndarray:
    """Return the columns ``(N, L)``: means of each control over past intervals, its integrals, a
    parabola; none without a moving control.

    ``every``: use only every n-th bound of the intervals.
    """
    t = record.time - record.time[0]
    moved = [
        channel.values - channel.values[0]
        for channel in record.inputs
        if np.ptp(channel.values) > 0
    ]
    if not moved:
        return np.empty((len(t), 0))
    back: tuple[float, ...] = _INTERVAL_BOUNDS[::every]
    while len(moved) * len(back) * _SAMPLES_PER_INSTRUMENT > len(t) and len(back) > 3:
        back = back[::2]
    columns = [np.ones(len(t)), t, t**2]
    for u in moved:
        once = _integral(u, t)
        past = [np.interp(t - ago, t, once) for ago in back]
        columns += [newer - older for newer, older in pairwise(past)]
        columns += [once, _integral(once, t)]
    return np.array([column / max(float(np.abs(column).max()), 1e-300) for column in columns]).T


def instrumented(signals: Sequence[KinematicSignals]) -> bool:
    """Return whether every record has controls, which distinguish a gust from a fault."""
    return all(s.instruments.shape[1] for s in signals)


# many faults are tried under one noise; the records of a check and a few noises stay
@lru_cache(maxsize=24)
def weigher(s: KinematicSignals, noise: RelationNoise) -> Weigher:
    """Return the columns ``(m, N, c)``, zero where a sample is missing, whitened to unit variance;
    with instruments projected onto them.
    """
    white = whitener(s, noise)
    if not s.instruments.shape[1]:
        return white
    m, n = s.valid.shape
    flat = white.of_differences(s.instrument_differences).reshape(n, m, -1)
    part = _projection(_orthonormal(flat.transpose(1, 0, 2).reshape(m * n, -1)))
    return lambda columns: part(white(columns))


@lru_cache(maxsize=24)
def shortened(s: KinematicSignals, noise: RelationNoise) -> Callable[[np.ndarray], np.ndarray]:
    """Columns ``(m, N, c)`` after ``weigher``, as fewer rows ``(K, c)`` with the same products."""
    white = whitener(s, noise)
    if not s.instruments.shape[1]:
        return lambda columns: white.of_differences(differences(columns))
    basis = _orthonormal(white.of_differences(s.instrument_differences))
    return lambda columns: basis.T @ white.of_differences(differences(columns))


def part_of_controls(s: KinematicSignals) -> Weigher:
    """Return the part of the columns ``(m, N, c)`` that the instruments explain; without
    instruments the columns.
    """
    if not s.instruments.shape[1]:
        return lambda columns: columns
    wide = s.instruments_by_output
    return _projection(_orthonormal(wide.reshape(-1, wide.shape[2])))


def _projection(basis: np.ndarray) -> Weigher:
    def part(columns: np.ndarray) -> np.ndarray:
        return np.asarray(
            (basis @ (basis.T @ columns.reshape(-1, columns.shape[2]))).reshape(columns.shape)
        )

    return part


def _orthonormal(flat: np.ndarray) -> np.ndarray:
    """Orthonormal basis ``(m N, r)`` of the columns ``(m N, c)``."""
    gram = flat.T @ flat
    scale = 1.0 / np.sqrt(np.where(np.diag(gram) > 0, np.diag(gram), 1.0))
    values, vectors = np.linalg.eigh(gram * np.outer(scale, scale))
    determined = values > _ROUNDING_EIGENVALUE_SHARE * values[-1]
    return np.asarray(
        flat @ (scale[:, None] * vectors[:, determined] / np.sqrt(values[determined]))
    )


def _integral(u: np.ndarray, t: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(0.5 * np.diff(t) * (u[1:] + u[:-1]))])
