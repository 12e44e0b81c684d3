"""Windowed Fourier transforms of records at any frequencies, and weighted regression of one signal
on others.

y_r = sum over k of z_rk b_k + e_r,   r a segment, E[e_r conj(e_s)] = S c_rs

with c the inner products of the windows. With the weights A, the estimate is b = (L* A z)^-1 L* A y
and its covariance S (L* A z)^-1 L* A c A L (z* A L)^-1. The instruments L are z itself in least
squares. With instrumental variables, they are transforms of a signal without the noise (Soderstrom
and Stoica, "Instrumental Variable Methods for System Identification", Springer 1983).

A segment is a part of a record under one window. Transforms under the first and second derivative
of the window are kept too. They describe the effect of the window on a response that changes with
frequency: with ``y(t) = integral of h(s) x(t - s)`` and the Taylor series of ``w(t) = w((t - s) +
s)``,

    Y_w = H X_w + H_1 X_w' + H_2 X_w'' + ...,   H_n = integral of s^n / n! h(s) exp(-i omega s).

Segments under Hann windows are those of Welch ("The Use of Fast Fourier Transform for the
Estimation of Power Spectra", IEEE Trans. Audio Electroacoustics 15(2), 1967). Sine tapers are those
of Riedel and Sidorenko ("Minimum Bias Multiple Taper Spectral Estimation", IEEE Trans. Signal
Processing 43(1), 1995).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.sparse import csr_array

# ---- Weighted regression of the segments of a signal on those of others, at each frequency

_SMALLEST = np.finfo(float).tiny


@dataclass(frozen=True, eq=False)
class Regression:
    """Regression of one output on K signals at F frequencies.

    Attributes
    ----------
    coefficients : complex ``(F, K)``.
    covariance : ``(F, K, K)`` of the real parts, and of the imaginary parts: half of E[|error|^2].
    noise : ``(F,)`` noise spectrum S.
    degrees : ``(F,)`` real degrees of freedom of the noise spectrum.
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
    """Return the regression of the segments of an output on those of K signals.

    Parameters
    ----------
    output : complex ``(R, F)`` transforms of R segments.
    regressors : complex ``(K, R, F)``.
    weights : ``(R, F)``, not negative.
    overlap : ``(R, R)`` inner products of the windows.
    instruments : complex ``(K, R, F)``; None takes the regressors.
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
    correlated = _times_overlap(gain, overlap)
    spread = correlated @ np.conj(np.swapaxes(gain, 1, 2))
    # expected weighted squares of the errors (1 - z gain) times noise, over S
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
    """Return the number of averages ``(F,)``: that of independent segments whose mean has the
    variance of the weighted mean. It is Welch's formula for overlapping segments, for any weights
    and window lengths.
    """
    total = weights.T @ overlap.diagonal()
    squares = np.einsum("rf,rf->f", weights, overlap.multiply(overlap) @ weights)
    return np.asarray(total**2 / np.maximum(squares, _SMALLEST))


def _times_overlap(rows: np.ndarray, overlap: csr_array) -> np.ndarray:
    """Return ``rows (F, K, R)`` times the overlap, which is real and symmetric."""
    flat = rows.reshape(-1, rows.shape[2]).T
    return np.asarray((overlap @ flat).T.reshape(rows.shape))


def spectral_matrix(signals: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the weighted mean spectral matrices E[x_i conj(x_j)], ``(F, S, S)``, of ``signals (S,
    R, F)``.
    """
    x = np.moveaxis(signals, 2, 0)
    share = weights / np.maximum(weights.sum(axis=0), _SMALLEST)
    return np.asarray((x * share.T[:, None, :]) @ np.conj(np.swapaxes(x, 1, 2)))


def coherences(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the multiple coherence ``(F,)`` of the last signal with the others, and the partial
    coherences ``(S - 1, F)``.

    With the inverse P of the spectral matrix, they are 1 - 1/(S_yy P_yy) and |P_iy|^2/(P_ii P_yy)
    (Bendat and Piersol, "Random Data", 4th edition, chapter 7).
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


# ---- Windowed Fourier transforms of the segments of records, at any frequencies

STEPS_PER_WINDOW = 4  # steps in the length of a window: successive windows overlap by 3/4
# fewest periods in the longest window, whose main lobe then does not reach zero frequency
LEAST_PERIODS_IN_LONGEST_WINDOW = 2.0
LEAST_PERIODS_IN_SHORTER_WINDOW = 6.0  # fewest periods in any other window
_SAMPLES_PER_WINDOW_STEP = 8  # samples in a step that give the inner products of windows


@dataclass(frozen=True, eq=False)
class Segments:
    """Transforms of S signals in R segments.

    Attributes
    ----------
    transforms : complex ``(S, D, R, F)``: signal, derivative of the window, segment, frequency. The
        phase counts from the first sample of the record. The windows have unit energy.
    windows : ``(R,)`` number of the window length of each segment.
    lengths : the window lengths, s.
    overlap : sparse ``(R, R)`` inner products of the windows: the correlation of white noise in two
        segments.
    """

    transforms: np.ndarray
    windows: np.ndarray
    lengths: tuple[float, ...]
    overlap: csr_array

    def usable(
        self, frequency: np.ndarray, shorter: float = LEAST_PERIODS_IN_SHORTER_WINDOW
    ) -> np.ndarray:
        """Return whether the window of a segment is long enough for a ``frequency (F,)``, Hz: bool
        ``(R, F)``.

        The longest window must hold ``LEAST_PERIODS_IN_LONGEST_WINDOW`` periods. Any other one must
        hold ``shorter`` periods, so that the bias of a regression with derivatives is small.
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
    records : ``(S, N)`` signals of each record, in the same order.
    step : sampling interval, s.
    lengths : of the windows, s. A record has no segments of a longer window.
    frequency : ``(F,)``, Hz.
    derivatives : number of derivatives of the window, up to 2.
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
    """Return the transforms of whole records under orthogonal sine tapers. The arguments are those
    of `hann_segments`, with a number of ``tapers`` in place of windows.
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
    """Return the sums over n of ``rows[..., n] exp(turns n)``, ``(..., F)``, in blocks."""
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
    """Return the transforms ``(S, D, count, F)`` under Hann windows of ``STEPS_PER_WINDOW * hop``
    samples.

    A Hann window is a constant minus a cosine. Each transform is therefore a sum of three
    transforms without a window, and each of these is the sum of the transforms of four blocks.
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
    """Return the transforms ``(S, D, B - 3, F)`` under Hann windows of four successive blocks, with
    times from the first sample of each window.

    Parameters
    ----------
    parts : complex ``(3, S, B, F)`` transforms of B blocks, with times from their first samples: at
        the frequencies, and at those lower and higher by one over the window length.
    step : sampling interval, s.
    hop : samples of a block.
    derivatives : number of derivatives of the window, up to 2.
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


def transforms_of_line(
    step: float, hop: int, frequency: np.ndarray, derivatives: int
) -> np.ndarray:
    """Return the transforms ``(2, D, F)`` of a constant one and of the centred sample numbers under
    a Hann window of four blocks.
    """
    size = STEPS_PER_WINDOW * hop
    line = np.stack([np.ones(size), np.arange(size) - 0.5 * (size - 1)])
    return _hann_rows(line, step, hop, 1, frequency, derivatives)[:, :, 0]


def overlap_of(spans: np.ndarray, owner: np.ndarray) -> csr_array:
    """Return the inner products ``(R, R)`` of Hann windows of unit energy, from their starts and
    lengths, ``spans (R, 2)``, s, and the record of each, ``owner (R,)``.

    Do not change the result in place: it is cached.
    """
    spans, owner = np.ascontiguousarray(spans, float), np.ascontiguousarray(owner, np.int64)
    return _overlap(spans.tobytes(), owner.tobytes())


@lru_cache(4)
def _overlap(span_bytes: bytes, owner_bytes: bytes) -> csr_array:
    """Return the inner products of `overlap_of`, from its arguments as bytes."""
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
        # Samples of each window are compared with all windows that are as long or longer.
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
