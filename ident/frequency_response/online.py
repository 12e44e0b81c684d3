"""Frequency responses of a stream of samples by recursive Fourier transforms.

Each sample, times exp(-i omega t), is added to the transforms of its block and is not stored
(Morelli, "Real-Time Parameter Estimation in the Frequency Domain", Journal of Guidance, Control,
and Dynamics 23(5), 2000; for loops in flight Bosworth and West, "Real-Time Open-Loop Frequency
Response Analysis of Flight Test Data", AIAA 86-9738, 1986). Four adjacent blocks make one Hann
window. A straight line is removed from each window. Complete windows are averaged in the
same way as the windows of a stored record. With one window length, a stream gives the same
responses as `estimate_responses`, except for the removal of the lines.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.frequency_response.estimate import (
    FrequencyResponses,
    Spectra,
    longest_run,
    responses_of_segments,
)
from ident.frequency_response.segments import (
    STEPS_PER_WINDOW,
    Segments,
    hann_of_blocks,
    overlap_of,
    transforms_of_line,
)
from sim.errors import DeclarationError

# Limits on the distance between a frequency and the input power around it, in bins (1/length of the
# window).
LARGEST_RMS_DISTANCE = 1.0  # The main lobe of a Hann window reaches 2 bins to each side.
LARGEST_MEAN_DISTANCE = 0.3
WINDOW_MEMORY = 600.0  # s, age after which a window is discarded
_HIGHEST_FREQUENCY_SHARE = 0.45  # highest frequency, relative to the sample rate
_LINE_SUMS = 2  # sums of a block that give its regression line: sum of x_n, and sum of n x_n


@dataclass
class _Window:
    """Transforms of S signals at F frequencies with one window length.

    Attributes
    ----------
    hop : samples of a block, a quarter of a window.
    lines : ``(2, D, F)`` transforms of a constant and of a straight line over a window.
    block : ``(3, S, F)`` transforms of the current, incomplete block: at the frequencies, one bin
        below and one bin above them.
    block_sums : ``(S, 2)`` sum of x_n and sum of n x_n over its samples so far, where n counts them
        from 0.
    block_samples : number of its samples so far.
    first : index of the first sample of the oldest block.
    blocks : the last complete blocks, ``(3, S, F)`` each.
    sums : their sums, ``(S, 2)`` each.
    rows : ``(S, D, F)`` transforms of each complete stretch of four blocks with D weightings: the
        Hann window and its D - 1 derivatives.
    starts : index of the first sample of each complete stretch.
    """

    hop: int
    lines: np.ndarray
    block: np.ndarray
    block_sums: np.ndarray
    block_samples: int = 0
    first: int = 0
    blocks: list[np.ndarray] = field(default_factory=list)
    sums: list[np.ndarray] = field(default_factory=list)
    rows: list[np.ndarray] = field(default_factory=list)
    starts: list[int] = field(default_factory=list)


@dataclass
class OnlineResponses:
    """Transforms of a stream of samples. `add_samples` adds samples to it.

    Attributes
    ----------
    step : sampling interval, s.
    frequency : ``(F,)``, Hz.
    spectra : window lengths and least coherence.
    outputs, inputs : numbers of output and input signals.
    joint : whether there is a reference signal for each input.
    memory : age, s, after which a window is discarded.
    samples : number of samples so far, lost ones included.
    windows : transforms with each window length, the longest first.
    """

    step: float
    frequency: np.ndarray
    spectra: Spectra
    outputs: int
    inputs: int
    joint: bool
    memory: float = WINDOW_MEMORY
    samples: int = 0
    windows: list[_Window] = field(default_factory=list)

    @property
    def signals(self) -> int:
        """Number S of signals: outputs, inputs, references."""
        return self.outputs + self.inputs * (2 if self.joint else 1)


def online_responses(
    step: float,
    frequency: np.ndarray,
    lengths: Sequence[float],
    *,
    outputs: int = 1,
    inputs: int = 1,
    joint: bool = False,
    least_coherence: float = 0.6,
    memory: float = WINDOW_MEMORY,
) -> OnlineResponses:
    """Return the transforms of a stream without samples.

    Parameters
    ----------
    step : sampling interval, s.
    frequency : ``(F,)``, Hz.
    lengths : lengths of the Hann windows, s.
    outputs, inputs : numbers of output and input signals.
    joint : whether there is a reference signal for each input.
    least_coherence : smallest coherence of a usable response.
    memory : age, s, after which a window is discarded.

    Raises
    ------
    DeclarationError : if a frequency is above 0.45 of the sample rate.
    """
    if float(np.max(frequency)) * step > _HIGHEST_FREQUENCY_SHARE:
        what = f"{float(np.max(frequency)):.4g} Hz is above 0.45 of the rate of {1.0 / step:.4g} Hz"
        raise DeclarationError(what, where="--band", remedy="give a lower one")
    lengths = tuple(sorted(lengths, reverse=True))
    stream = OnlineResponses(
        step,
        np.asarray(frequency),
        Spectra(lengths, least_coherence=least_coherence),
        outputs,
        inputs,
        joint,
        memory,
    )
    for length in lengths:
        hop = max(2, round(length / (STEPS_PER_WINDOW * step)))
        block = np.zeros((3, stream.signals, stream.frequency.size), dtype=complex)
        lines = transforms_of_line(step, hop, stream.frequency, stream.spectra.derivatives)
        stream.windows.append(_Window(hop, lines, block, np.zeros((stream.signals, _LINE_SUMS))))
    return stream


def add_samples(stream: OnlineResponses, samples: np.ndarray) -> None:
    """Add further samples ``(S, N)`` to the stream: outputs, inputs, references, at even steps."""
    n = samples.shape[1]
    for window in stream.windows:
        begin = 0
        while begin < n:
            count = min(window.hop - window.block_samples, n - begin)
            _add(stream, window, samples[:, begin : begin + count])
            begin += count
            if window.block_samples == window.hop:
                _complete_block(stream, window)
    stream.samples += n


def interrupt(stream: OnlineResponses, lost: int) -> None:
    """Begin new windows after a gap of ``lost`` samples; complete windows stay."""
    stream.samples += lost
    for window in stream.windows:
        window.blocks, window.sums = [], []
        _clear_block(window)
        window.first = stream.samples


def estimated(stream: OnlineResponses) -> FrequencyResponses | None:
    """Return the responses from the complete windows, at the frequencies that have a usable window;
    None if there are none. Windows older than the memory are removed from the stream.
    """
    oldest = stream.samples - round(stream.memory / stream.step)
    rows, numbers, spans = [], [], []
    for number, window in enumerate(stream.windows):
        outdated = sum(start < oldest for start in window.starts)
        window.rows, window.starts = window.rows[outdated:], window.starts[outdated:]
        rows += window.rows
        numbers += [number] * len(window.rows)
        spans += [(start, STEPS_PER_WINDOW * window.hop) for start in window.starts]
    if len(rows) < 2:
        return None
    overlap = overlap_of(np.array(spans) * stream.step, np.zeros(len(rows), dtype=int))
    transforms = np.stack(rows, axis=2)
    segments = Segments(transforms, np.array(numbers), stream.spectra.windows, overlap)
    usable = segments.usable(stream.frequency).any(axis=0)
    if not usable.any():
        return None
    segments = Segments(transforms[..., usable], segments.windows, segments.lengths, overlap)
    result = responses_of_segments(
        segments,
        stream.frequency[usable],
        stream.spectra,
        stream.outputs,
        stream.inputs,
        stream.joint,
    )
    return replace(result, usable=_excited_bands(stream, segments, result))


def _excited_bands(
    stream: OnlineResponses, segments: Segments, responses: FrequencyResponses
) -> np.ndarray:
    """Return the usable bands ``(m, q, F)`` without frequencies that a sweep has not yet passed.

    Before a sweep reaches a frequency, the transform there is leakage from the present frequency of
    the sweep: coherent, but with the response at the sweep's frequency instead of its own. How far
    the power is from the frequency, d bins, follows from the transform with the derivative of the
    window: a component d bins away has there 2 pi i d/length times its transform with the window.
    The excitation has not reached a frequency if the rms of d exceeds ``LARGEST_RMS_DISTANCE``. It
    has not passed a frequency if the mean of d exceeds ``LARGEST_MEAN_DISTANCE``.
    """
    m, q = stream.outputs, stream.inputs
    usable = segments.usable(responses.frequency)
    counts = np.maximum(np.bincount(segments.windows, minlength=len(segments.lengths)), 1)
    share = usable / counts[segments.windows][:, None]
    scale = np.array(segments.lengths)[segments.windows][:, None] / (2.0 * math.pi)
    bands = np.zeros_like(responses.usable)
    log_frequency = np.log(responses.frequency)
    for j in range(q):
        excitation = m + q + j if stream.joint else m + j  # the reference, or the input
        transform, by_derivative = segments.transforms[excitation, :2]
        power = np.sum(share * np.abs(transform) ** 2, axis=0)
        square_distance = np.sum(share * np.abs(scale * by_derivative) ** 2, axis=0)
        distance = np.sum(share * scale * (np.conj(transform) * by_derivative).imag, axis=0)
        reached = square_distance <= LARGEST_RMS_DISTANCE**2 * power
        passed = np.abs(distance) <= LARGEST_MEAN_DISTANCE * power
        for i in range(m):
            usable_here = responses.usable[i, j] & reached & passed
            bands[i, j] = longest_run(usable_here, log_frequency)
    return bands


def _add(stream: OnlineResponses, window: _Window, samples: np.ndarray) -> None:
    """Add samples ``(S, n)`` of one block."""
    count = samples.shape[1]
    number = window.block_samples + np.arange(count)
    bin_width = 1.0 / (STEPS_PER_WINDOW * window.hop * stream.step)  # Hz
    for row, shift in enumerate((0.0, -bin_width, bin_width)):
        frequency = stream.frequency + shift
        harmonics = np.exp(-2j * math.pi * stream.step * np.outer(number, frequency))
        window.block[row] += samples @ harmonics.real + 1j * (samples @ harmonics.imag)
    window.block_sums += np.stack([samples.sum(axis=1), samples @ number], axis=1)
    window.block_samples += count


def _clear_block(window: _Window) -> None:
    """Begin a new block."""
    window.block = np.zeros_like(window.block)
    window.block_sums = np.zeros_like(window.block_sums)
    window.block_samples = 0


def _complete_block(stream: OnlineResponses, window: _Window) -> None:
    """End a block, and the window if this is its fourth block."""
    window.blocks.append(window.block)
    window.sums.append(window.block_sums)
    _clear_block(window)
    if len(window.blocks) < STEPS_PER_WINDOW:
        return
    rows = hann_of_blocks(
        np.stack(window.blocks, axis=2),
        stream.step,
        window.hop,
        stream.frequency,
        stream.spectra.derivatives,
    )[:, :, 0]
    rows = rows - np.einsum("sk,kdf->sdf", _straight_line(window), window.lines)
    phase = np.exp(-2j * math.pi * window.first * stream.step * stream.frequency)
    window.rows.append(rows * phase)
    window.starts.append(window.first)
    del window.blocks[0], window.sums[0]
    window.first += window.hop


def _straight_line(window: _Window) -> np.ndarray:
    """Return level and slope ``(S, 2)`` of the regression line of each signal over a window. The
    slope is per sample, and the level that at the middle of the window.
    """
    hop, size = window.hop, STEPS_PER_WINDOW * window.hop
    total = sum(sums[:, 0] for sums in window.sums)
    # sum of n x_n, where n counts the samples of the window from 0
    moment = sum(sums[:, 1] + m * hop * sums[:, 0] for m, sums in enumerate(window.sums))
    middle = 0.5 * (size - 1)
    number_squares = size * (size**2 - 1) / 12.0
    return np.stack([total / size, (moment - middle * total) / number_squares], axis=1)
