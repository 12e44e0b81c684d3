"""Windowed Fourier transforms of records at any frequencies, weighted regression of one on others,
and the multitaper estimate of a response.

y_r = sum over k of z_rk b_k + e_r,   r a segment, E[e_r conj(e_s)] = S c_rs

with c the inner products of the windows. The estimate is b = (L* A z)^-1 L* A y; the instruments L
are z itself (least squares) or the transforms of a signal that the noise does not reach
(instrumental variables; Soderstrom and Stoica, "Instrumental Variable Methods for System
Identification", Springer 1983). Its covariance is S (L* A z)^-1 L* A c A L (z* A L)^-1.

A segment is a stretch of a record under one window. Its transform is kept together with the
transforms under the first and second derivative of the window. These describe what the window does
to a response that changes with frequency: with ``y(t) = integral of h(s) x(t - s)`` and the Taylor
series of ``w(t) = w((t - s) + s)``,

    Y_w = H X_w + H_1 X_w' + H_2 X_w'' + ...,   H_n = integral of s^n / n! h(s) exp(-i omega s).

Hann windows are Welch's segments ("The Use of Fast Fourier Transform for the Estimation of Power
Spectra", IEEE Trans. Audio Electroacoustics 15(2), 1967). Sine tapers: Riedel and Sidorenko,
"Minimum Bias Multiple Taper Spectral Estimation", IEEE Trans. Signal Processing 43(1), 1995.

The multitaper estimate and a low-order model fitted to it check the delay and damping that a filter
found, as NASA TM-101722 did: no filter, no state, no process noise, only ratios of spectra. Gain
and phase are weighed as MIL-F-8785C matches equivalent systems.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.sparse import csr_array

from sim.declaration.model import System
from sim.errors import ModelError, RecordError
from sim.maths import complex_step_jacobian
from sim.record import Hold, Record

# ---- Weighted regression of one signal's segments on others', at every frequency by itself

_SMALLEST = np.finfo(float).tiny


@dataclass(frozen=True, eq=False)
class Regression:
    """Complex coefficients of one output, from ``regress``.

    Attributes
    ----------
    coefficients : complex ``(F, K)``.
    covariance : ``(F, K, K)``, of the real and of the imaginary part of each: half of E[|error|^2].
    noise : ``(F,)``, the noise spectrum S.
    degrees : ``(F,)``, real degrees of freedom of it.
    """

    coefficients: np.ndarray
    covariance: np.ndarray
    noise: np.ndarray
    degrees: np.ndarray


def regress(
    output: np.ndarray,
    regressors: np.ndarray,
    weights: np.ndarray,
    overlap: csr_array,
    instruments: np.ndarray | None = None,
) -> Regression:
    """Regress the segments of an output on those of the inputs.

    Parameters
    ----------
    output : complex ``(R, F)``.
    regressors, instruments : complex ``(K, R, F)``.
    weights : ``(R, F)``, not negative.
    overlap : ``(R, R)``.
    """
    z = np.moveaxis(regressors, 2, 0)  # (F, K, R)
    left = z if instruments is None else np.moveaxis(instruments, 2, 0)
    weighted = np.conj(left) * weights.T[:, None, :]
    normal = weighted @ np.swapaxes(z, 1, 2)
    scale = np.sqrt(np.maximum(np.abs(np.einsum("fkk->fk", normal)), _SMALLEST))
    normal = normal / (scale[:, :, None] * scale[:, None, :])
    inverse = np.linalg.pinv(normal, rcond=1e-12) / (scale[:, :, None] * scale[:, None, :])
    gain = inverse @ weighted  # (F, K, R): coefficients are gain @ output
    y = output.T[:, :, None]
    coefficients = (gain @ y)[:, :, 0]
    errors = output.T - np.einsum("fkr,fk->fr", z, coefficients)
    correlated = _times(gain, overlap)
    spread = correlated @ np.conj(np.swapaxes(gain, 1, 2))
    # E of the weighted squares of e = (1 - z gain) noise, over S.
    fitted = np.conj(z) * weights.T[:, None, :]
    power = fitted @ np.swapaxes(z, 1, 2)
    crossed = np.einsum("fkr,fkr->f", correlated, np.conj(fitted)).real
    lowered = 2.0 * crossed - np.einsum("fkl,flk->f", power, spread).real
    expected = weights.T @ overlap.diagonal()
    remaining = np.maximum(expected - lowered, 1e-6 * np.maximum(expected, _SMALLEST))
    noise = np.einsum("rf,fr->f", weights, np.abs(errors) ** 2)
    spectrum = noise / remaining
    averages = effective_averages(weights, overlap)
    degrees = np.maximum(2.0 * averages * remaining / np.maximum(expected, _SMALLEST), 1e-3)
    return Regression(coefficients, 0.5 * spectrum[:, None, None] * spread, spectrum, degrees)


def effective_averages(weights: np.ndarray, overlap: csr_array) -> np.ndarray:
    """Number of independent segments whose mean has the variance of the weighted one, ``(F,)``.

    Welch's formula for segments that overlap, for any weights and window lengths.
    """
    total = weights.T @ overlap.diagonal()
    squares = np.einsum("rf,rf->f", weights, overlap.multiply(overlap) @ weights)
    return np.asarray(total**2 / np.maximum(squares, _SMALLEST))


def _times(rows: np.ndarray, overlap: csr_array) -> np.ndarray:
    """``rows @ overlap`` of ``(F, K, R)``; the overlap is real and symmetric."""
    flat = rows.reshape(-1, rows.shape[2]).T
    return np.asarray((overlap @ flat).T.reshape(rows.shape))


def spectral_matrix(signals: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted mean spectral matrices ``(F, S, S)`` of signals ``(S, R, F)``: E[x_i conj(x_j)]."""
    x = np.moveaxis(signals, 2, 0)
    share = weights / np.maximum(weights.sum(axis=0), _SMALLEST)
    return np.asarray((x * share.T[:, None, :]) @ np.conj(np.swapaxes(x, 1, 2)))


def coherences(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Multiple coherence ``(F,)`` of the last signal with the others, and partial ones ``(S-1,
    F)``.

    Bendat and Piersol, "Random Data", 4th edition, chapter 7: by the inverse P of the spectral
    matrix, 1 - 1/(S_yy P_yy) and |P_iy|^2/(P_ii P_yy).
    """
    scale = np.sqrt(np.maximum(np.einsum("fss->fs", matrix).real, _SMALLEST))
    scaled = matrix / (scale[:, :, None] * scale[:, None, :])
    size = matrix.shape[1]
    inverse = np.linalg.inv(scaled + 1e-13 * np.eye(size))
    last = inverse[:, -1, -1].real
    multiple = 1.0 - 1.0 / np.maximum(last, 1.0)
    partial = np.abs(inverse[:, :-1, -1]) ** 2 / (
        np.einsum("fss->fs", inverse).real[:, :-1] * last[:, None]
    )
    return np.clip(multiple, 0.0, 1.0), np.clip(partial.T, 0.0, 1.0)


# ---- Windowed Fourier transforms of records at any frequencies, one row a segment

STEPS_PER_WINDOW = 4  # a window is four steps long: successive windows share three quarters
# periods that a window must hold: its main lobe then stays clear of zero frequency
LEAST_PERIODS_IN_LONGEST_WINDOW = 2.0
LEAST_PERIODS_IN_SHORTER_WINDOW = 6.0  # periods, where a longer window is there
_SAMPLES_PER_WINDOW_STEP = 8  # samples of a window in a step, for inner products of windows


@dataclass(frozen=True, eq=False)
class Segments:
    """Transforms of several signals, a row for each segment.

    Attributes
    ----------
    transforms : complex ``(S, D, R, F)``: signal, derivative of the window, segment, frequency; the
        phase counts from the first sample of the record. The windows have unit energy.
    windows : ``(R,)``, number of the window length of each row.
    lengths : s, the window lengths.
    overlap : sparse ``(R, R)``, inner products of the windows: the correlation of white noise in
        two rows.
    """

    transforms: np.ndarray
    windows: np.ndarray
    lengths: tuple[float, ...]
    overlap: csr_array

    def usable(
        self, frequency: np.ndarray, shorter: float = LEAST_PERIODS_IN_SHORTER_WINDOW
    ) -> np.ndarray:
        """Return whether the window of a row is long enough for a frequency in Hz, bool ``(R, F)``.

        The longest window is used down to ``LEAST_PERIODS_IN_LONGEST_WINDOW`` periods, shorter ones
        down to ``shorter`` periods, where the bias left by the derivatives is small.
        """
        lengths = np.array(self.lengths)[self.windows]
        least = np.where(
            lengths < lengths.max() * (1.0 - 1e-9), shorter, LEAST_PERIODS_IN_LONGEST_WINDOW
        )
        return np.asarray(frequency * lengths[:, None] >= least[:, None] * (1.0 - 1e-9))


def hann_segments(
    records: Sequence[np.ndarray],
    step: float,
    lengths: Sequence[float],
    frequency: np.ndarray,
    derivatives: int = 2,
) -> Segments:
    """Return the transforms of overlapping segments under Hann windows of several lengths.

    Parameters
    ----------
    records : each ``(S, N)``: the same signals in the same order.
    step : s, between samples.
    lengths : s, of the windows; a record that is shorter than one has no segment of it.
    frequency : Hz, ``(F,)``.
    derivatives : of the window, up to 2.
    """
    blocks, windows, starts, owners = [], [], [], []
    for number, length in enumerate(lengths):
        hop = max(2, round(length / (STEPS_PER_WINDOW * step)))
        for owner, signals in enumerate(records):
            count = signals.shape[1] // hop - STEPS_PER_WINDOW + 1
            if count < 1:
                continue
            blocks.append(_hann_rows(signals, step, hop, count, frequency, derivatives))
            windows.append(np.full(count, number))
            starts.append(
                np.column_stack([hop * np.arange(count), np.full(count, STEPS_PER_WINDOW * hop)])
            )
            owners.append(np.full(count, owner))
    overlap = overlap_of(np.concatenate(starts) * step, np.concatenate(owners))
    transforms = np.concatenate(blocks, axis=2)
    return Segments(transforms, np.concatenate(windows), tuple(lengths), overlap)


def sine_segments(
    records: Sequence[np.ndarray],
    step: float,
    tapers: int,
    frequency: np.ndarray,
    derivatives: int = 2,
) -> Segments:
    """Return the transforms of whole records under orthogonal sine tapers, arguments as in
    ``hann_segments``.
    """
    blocks = []
    for signals in records:
        count = signals.shape[1]
        phase = math.pi * np.arange(1, count + 1) / (count + 1)
        orders = np.arange(1, tapers + 1)[:, None]
        rate = orders * math.pi / ((count + 1) * step)
        size = math.sqrt(2.0 / (count + 1))
        shapes = (np.sin(orders * phase), np.cos(orders * phase), -np.sin(orders * phase))
        turns = -2j * math.pi * frequency * step
        rows = np.stack(
            [
                _transformed(signals[:, None, :] * (size * rate**n * shapes[n]), turns)
                for n in range(derivatives + 1)
            ],
            axis=1,
        )
        blocks.append(rows)
    transforms = np.concatenate(blocks, axis=2)
    shortest = min(signals.shape[1] for signals in records) * step
    count = transforms.shape[2]
    return Segments(transforms, np.zeros(count, dtype=int), (shortest,), csr_array(np.eye(count)))


def _transformed(rows: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Sums of ``rows[..., n] exp(turns n)``, by blocks whose exponentials are made once."""
    count = rows.shape[-1]
    size = max(1, math.isqrt(count))
    whole = -(-count // size)
    padded = np.zeros((*rows.shape[:-1], whole * size))
    padded[..., :count] = rows
    inner = np.exp(np.arange(size)[:, None] * turns)
    outer = np.exp(size * np.arange(whole)[:, None] * turns)
    parts = padded.reshape(*rows.shape[:-1], whole, size)
    return np.einsum("...bf,bf->...f", _product(parts, inner), outer)


def _product(real: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """Return a real array times a complex matrix, as two real products."""
    return real @ factors.real + 1j * (real @ factors.imag)


def _hann_rows(
    signals: np.ndarray, step: float, hop: int, count: int, frequency: np.ndarray, derivatives: int
) -> np.ndarray:
    """Transforms ``(S, D, count, F)`` under Hann windows of ``STEPS_PER_WINDOW * hop`` samples.

    A Hann window is a constant and one cosine, so each transform is a sum of three transforms
    without a window, each the sum of those of four blocks that do not overlap.
    """
    shift = 1.0 / (STEPS_PER_WINDOW * hop * step)
    blocks = signals[:, : hop * (count + STEPS_PER_WINDOW - 1)].reshape(len(signals), -1, hop)
    parts = [
        _product(blocks, np.exp(-2j * math.pi * step * np.outer(np.arange(hop), each)))
        for each in (frequency, frequency - shift, frequency + shift)
    ]
    rows = hann_of_blocks(np.stack(parts), step, hop, frequency, derivatives)
    start = np.exp(-2j * math.pi * np.outer(hop * np.arange(count) * step, frequency))
    return rows * start


def hann_of_blocks(
    parts: np.ndarray, step: float, hop: int, frequency: np.ndarray, derivatives: int
) -> np.ndarray:
    """Return the transforms ``(S, D, B - 3, F)`` under Hann windows of four successive blocks;
    times count from the first sample of each window.

    Parameters
    ----------
    parts : complex ``(3, S, B, F)``, transforms of the blocks from their own first samples, at the
        frequencies, and at those lower and higher by one over the window's length.
    step : s.
    hop : samples of a block.
    derivatives : of the window, up to 2.
    """
    size = STEPS_PER_WINDOW * hop
    length, count = size * step, parts.shape[2] - STEPS_PER_WINDOW + 1
    shift = 1.0 / length
    unwindowed = []
    for block, each in zip(parts, (frequency, frequency - shift, frequency + shift), strict=True):
        block_delays = np.exp(
            -2j * math.pi * step * hop * np.outer(np.arange(STEPS_PER_WINDOW), each)
        )
        unwindowed.append(
            sum(block[:, m : m + count] * block_delays[m] for m in range(STEPS_PER_WINDOW))
        )
    middle, below, above = unwindowed
    energy = 1.0 / math.sqrt(0.375 * size)
    rows = [energy * (0.5 * middle - 0.25 * (below + above))]
    if derivatives > 0:
        rows.append(energy * (math.pi / (2j * length)) * (below - above))
    if derivatives > 1:
        rows.append(energy * (math.pi / length) ** 2 * (below + above))
    return np.stack(rows, axis=1)


def unit_rows(step: float, hop: int, frequency: np.ndarray, derivatives: int) -> np.ndarray:
    """Return the transforms ``(2, D, F)`` of a constant one and of the centred sample numbers under
    a Hann window of four blocks.
    """
    size = STEPS_PER_WINDOW * hop
    line = np.stack([np.ones(size), np.arange(size) - 0.5 * (size - 1)])
    return _hann_rows(line, step, hop, 1, frequency, derivatives)[:, :, 0]


def overlap_of(spans: np.ndarray, owner: np.ndarray) -> csr_array:
    """Inner products ``(R, R)`` of unit Hann windows from their starts and lengths, s.

    Do not change the result: windows at the same places share one array.
    """
    spans, owner = np.ascontiguousarray(spans, float), np.ascontiguousarray(owner, np.int64)
    return _overlap(spans.tobytes(), owner.tobytes())


@lru_cache(4)
def _overlap(span_bytes: bytes, owner_bytes: bytes) -> csr_array:
    spans = np.frombuffer(span_bytes).reshape(-1, 2)
    owner = np.frombuffer(owner_bytes, np.int64)
    start, length = spans[:, 0], spans[:, 1]
    grid = np.arange(STEPS_PER_WINDOW * _SAMPLES_PER_WINDOW_STEP) / (
        STEPS_PER_WINDOW * _SAMPLES_PER_WINDOW_STEP
    )
    shape = 0.5 - 0.5 * np.cos(2.0 * math.pi * grid)
    places, partners, products = [], [], []
    # Rows of one record and one length follow each other by their starts.
    edges = np.flatnonzero(np.any(np.diff(np.column_stack([owner, length]), axis=0), axis=1)) + 1
    groups = list(zip([0, *edges.tolist()], [*edges.tolist(), len(spans)], strict=True))
    for row in range(len(spans)):
        # The shorter window's samples meet every longer or equal window.
        near = []
        for first, last in groups:
            if owner[first] != owner[row] or length[first] < length[row]:
                continue
            ends = (start[row] - length[first], start[row] + length[row])
            begin, end = np.searchsorted(start[first:last], ends)
            near.append(np.arange(first + begin, first + end))
        others = np.concatenate(near)
        at = start[row] + length[row] * grid
        inside = (at - start[others][:, None]) / length[others][:, None]
        known = (inside > 0.0) & (inside < 1.0)
        values = np.where(known, 0.5 - 0.5 * np.cos(2.0 * math.pi * inside), 0.0)
        scale = np.sqrt(length[row] / length[others]) / (0.375 * grid.size)
        result = values @ shape * scale
        longer = length[others] > length[row]
        places += [np.full(others.size, row), others[longer]]
        partners += [others, np.full(np.count_nonzero(longer), row)]
        products += [result, result[longer]]
    where = (np.concatenate(places), np.concatenate(partners))
    return csr_array((np.concatenate(products), where), shape=(len(spans), len(spans)))


LOWEST_OMEGA = 0.35  # rad/s, lowest frequency at which short period, lag and delay show
HIGHEST_OMEGA = 14.0  # rad/s, highest such frequency
_DECIBELS_PER_NEPER = 20.0 / math.log(10.0)  # dB per unit of the natural logarithm of a gain
# square root of the weight 0.01745 of an error of 1 deg, per rad
_PHASE_WEIGHT_ROOT = math.sqrt(0.01745) * 180.0 / math.pi
_PADDING_FACTOR = 4
_LONGEST_ALIGNED_LAG = 1.0  # s, the longest lag by which an output is aligned with the input


@dataclass(frozen=True, eq=False)
class SingleInputResponse:
    """Response of outputs to one input.

    Attributes
    ----------
    omega : ``(n,)`` rad/s.
    outputs : names of the m rows.
    response : complex ``(m, n)``, output per input as it acts between samples (the hold is taken
        out).
    coherence : ``(m, n)``, 0 to 1: share of the output that follows the input linearly.
    bandwidth : half width of the smoothing, rad/s; neighbours closer than twice this are not
        independent.
    """

    omega: np.ndarray
    outputs: tuple[str, ...]
    response: np.ndarray
    coherence: np.ndarray
    bandwidth: float


def estimate_response(
    record: Record, low: float = LOWEST_OMEGA, high: float = HIGHEST_OMEGA, tapers: int = 5
) -> SingleInputResponse:
    """Estimate the response of all outputs to ``stick`` from cross spectra, averaged over tapers.

    Averaging over the bandwidth of the tapers flattens a response whose phase changes quickly with
    frequency; a low-order fit reads that as damping. So each output is first aligned with the input
    by its lag, which is restored afterwards. The remaining bias falls with fewer tapers and longer
    records.

    Parameters
    ----------
    record : evenly sampled, without missing samples; means are removed.
    low, high : range of frequencies kept, rad/s.
    tapers : more give less scatter and a coherence that means more, and smear over (tapers + 1) pi
        / duration.

    Raises
    ------
    RecordError : uneven sampling, missing samples, an input without motion, no frequency in the
        range.
    ModelError : fewer than two tapers (the coherence of one is always 1).
    """
    if tapers < 2:
        raise ModelError(f"{tapers} tapers", where="estimate_response", remedy="use two or more")
    names = record.output_names
    steps, count = np.diff(record.time), len(record)
    step = float(steps.mean())
    if np.max(np.abs(steps - step)) > 1e-3 * step:
        raise RecordError(
            "sampling is uneven", where=record.name, remedy="resample it evenly first"
        )
    y, valid = record.output_array(names)
    if not valid.all():
        raise RecordError(
            "a sample is missing", where=record.name, remedy="choose a window without gaps"
        )
    u = record["stick"].values
    if not np.ptp(u) > 0:
        raise RecordError(
            "it does not move",
            where=f"{record.name}, channel stick",
            remedy="choose a window with a maneuver",
        )
    omega = 2.0 * math.pi * np.fft.rfftfreq(_PADDING_FACTOR * count, step)
    omega = omega[(omega >= low) & (omega <= high)]
    if not omega.size:
        what = f"no frequency between {low:g} and {high:g} rad/s"
        raise RecordError(what, where=record.name, remedy="give a longer record")
    u, y = u - u.mean(), y - y.mean(axis=1, keepdims=True)
    lags = [_lag(u, row, round(_LONGEST_ALIGNED_LAG / step)) for row in y]
    aligned = [
        np.concatenate([row[lag:], np.full(lag, row[-1])]) for row, lag in zip(y, lags, strict=True)
    ]
    hertz = omega / (2.0 * math.pi)
    rows = sine_segments([np.array([u, *aligned])], step, tapers, hertz, derivatives=0).transforms[
        :, 0
    ]
    shifts = np.exp(-1j * omega * step * np.array(lags)[:, None])
    U, Y = rows[0], rows[1:] * shifts[:, None, :]
    Suu, Syy = (np.abs(U) ** 2).mean(axis=0), (np.abs(Y) ** 2).mean(axis=1)
    Syu = (Y * np.conj(U)).mean(axis=1)
    coherence = np.abs(Syu) ** 2 / np.maximum(Suu * Syy, np.finfo(float).tiny)
    zero_order_hold = (1.0 - np.exp(-1j * omega * step)) / (1j * omega * step)
    hold_response = (
        zero_order_hold if record.hold is Hold.PREVIOUS else np.abs(zero_order_hold) ** 2
    )
    return SingleInputResponse(
        omega, names, Syu / Suu / hold_response, coherence, (tapers + 1) * math.pi / (count * step)
    )


def _lag(u: np.ndarray, y: np.ndarray, latest: int) -> int:
    """Lag of the output behind the input in samples, at most ``latest``: the largest absolute
    cross-correlation.
    """
    sums = [abs(float(u[: len(u) - k] @ y[k:])) for k in range(min(latest, len(u) - 1) + 1)]
    return int(np.argmax(sums))


@dataclass(frozen=True, eq=False)
class ResponseFit:
    """A model fitted to a frequency response.

    ``values``: parameters by name. ``mismatch``: weighted mean of (error in dB)^2 + 0.01745 (error
    in deg)^2. ``converged``: whether the search ended at a minimum.
    """

    values: Mapping[str, float]
    mismatch: float
    converged: bool


def model_response(
    system: System,
    values: Mapping[str, float],
    omega: np.ndarray,
    outputs: Sequence[str],
) -> np.ndarray:
    """Return the response ``(m, n)`` of a System, linearised at rest, to its first input.

    The parameter ``delay`` (s), if the System has one, delays this input.
    """
    p = system.parameters.with_values(values).values().tolist()
    x0, u0 = [0.0] * len(system.states), [0.0] * len(system.inputs)
    A = complex_step_jacobian(lambda x: system.f(0.0, x, u0, p), x0)
    B = complex_step_jacobian(lambda u: system.f(0.0, x0, u, p), u0)[:, :1]
    C = complex_step_jacobian(lambda x: system.h(0.0, x, u0, p), x0)
    D = complex_step_jacobian(lambda u: system.h(0.0, x0, u, p), u0)[:, :1]
    rows = [system.output_names.index(name) for name in outputs]
    s = 1j * np.asarray(omega)
    inside = np.linalg.solve(s[:, None, None] * np.eye(len(A)) - A, B.astype(complex)[None])
    held_delay = system.parameters["delay"].value if "delay" in system.parameters else 0.0
    delay_factor = np.exp(-s * values.get("delay", held_delay))
    return ((C[rows] @ inside + D[rows])[:, :, 0] * delay_factor[:, None]).T


def fit_response(response: SingleInputResponse, system: System, free: Sequence[str]) -> ResponseFit:
    """Fit a model's named parameters to an estimated response, starting from the System's values.

    Each frequency w counts by its coherence c as c / (1 - c), limited at c = 0.99, the inverse
    variance of gain and phase, and as 1/w, which gives each octave the same weight, as the usual
    matching at logarithmically spaced frequencies does. The fit uses all outputs that the response
    and the System have in common.
    """
    from scipy.optimize import least_squares

    names = tuple(name for name in response.outputs if name in system.output_names)
    rows = [response.outputs.index(name) for name in names]
    c = np.minimum(response.coherence[rows], 0.99)
    power = c / (1.0 - c) / response.omega
    weight = np.sqrt(power / power.mean())
    start = system.parameters.values(free)
    bounds = np.array([system.parameters[name].bounds for name in free]).T

    def errors(p: np.ndarray) -> np.ndarray:
        result = model_response(
            system, dict(zip(free, p.tolist(), strict=True)), response.omega, names
        )
        ratio = np.log(result / response.response[rows])
        return np.concatenate(
            [
                (_DECIBELS_PER_NEPER * weight * ratio.real).ravel(),
                (_PHASE_WEIGHT_ROOT * weight * ratio.imag).ravel(),
            ]
        )

    solution = least_squares(
        errors,
        start,
        bounds=(bounds[0], bounds[1]),
        x_scale=np.maximum(np.abs(start), 1e-3),
        max_nfev=500,
    )
    return ResponseFit(
        dict(zip(free, solution.x.tolist(), strict=True)),
        float(2.0 * solution.cost / weight.size),
        solution.status > 0,
    )
