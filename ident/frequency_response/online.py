"""Frequency responses of a stream by recursive Fourier transforms.

Every sample is added to the running transforms of the block that it falls into, times
exp(-i omega t), and is then forgotten (Morelli, "Real-Time Parameter Estimation in the Frequency
Domain", Journal of Guidance, Control, and Dynamics 23(5), 2000; for loops in flight Bosworth and
West, "Real-Time Open-Loop Frequency Response Analysis of Flight Test Data", AIAA 86-9738, 1986).
Four blocks in a row make one Hann window; a straight line is taken off each window. The windows
that are complete are combined as those of a record are, so that a stream of one window length
gives what `estimate_responses` gives, but for the line that is taken off.
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
    unit_rows,
)
from sim.errors import DeclarationError

HALF_LOBE = 1.0  # over the window's length: half of the half width of a Hann window's main lobe
ONE_SIDED = 0.3  # over the window's length: mean distance of power that has come from one side only
WINDOW_MEMORY = 600.0  # s, after which a window is forgotten
_LINE_ROWS = 2  # rows after the signals: their sums, plain and times the time in the block


@dataclass
class _Window:
    """The running transforms of one window length.

    ``blocks`` : the last complete ones, each ``(3, S, F)`` with ``sums`` ``(S, 2)``. ``running``,
    ``part`` : of the block that is not complete. ``taken`` : its samples. ``first`` : number of the
    sample that the oldest block begins with. ``rows``, ``starts`` : of complete windows,
    ``(S, D, F)`` each.
    """

    hop: int
    lines: np.ndarray
    running: np.ndarray
    part: np.ndarray
    taken: int = 0
    first: int = 0
    blocks: list[np.ndarray] = field(default_factory=list)
    sums: list[np.ndarray] = field(default_factory=list)
    rows: list[np.ndarray] = field(default_factory=list)
    starts: list[int] = field(default_factory=list)


@dataclass
class OnlineResponses:
    """A stream on its way into frequency responses; ``take`` changes it.

    Attributes
    ----------
    step : s.
    frequency : Hz, ``(F,)``.
    spectra : window lengths and least coherence.
    outputs, inputs : how many; with ``joint`` as many references follow as there are inputs.
    memory : s.
    samples : taken so far, those left out counted by their place.
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
        """Rows of a block of samples: outputs, inputs, references."""
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
    """Responses of nothing yet.

    Parameters
    ----------
    step : s, between samples.
    frequency : Hz, ``(F,)``, below half of the rate.
    lengths : s, of the Hann windows.
    outputs, inputs : how many signals; ``joint``: with a reference for each input.
    memory : s, after which a window is forgotten.

    Raises
    ------
    DeclarationError : a frequency above 0.45 of the rate.
    """
    if float(np.max(frequency)) * step > 0.45:
        what = f"{float(np.max(frequency)):.4g} Hz is above 0.45 of the rate of {1.0 / step:.4g} Hz"
        raise DeclarationError(what, where="--band", remedy="give a lower one")
    lengths = tuple(sorted(lengths, reverse=True))
    out = OnlineResponses(
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
        zero = np.zeros((3, out.signals, out.frequency.size), dtype=complex)
        lines = unit_rows(step, hop, out.frequency, out.spectra.derivatives)
        out.windows.append(_Window(hop, lines, zero, np.zeros((out.signals, _LINE_ROWS))))
    return out


def take(stream: OnlineResponses, samples: np.ndarray) -> None:
    """Take further samples ``(S, N)``: outputs, inputs, references, at even steps."""
    for window in stream.windows:
        at = 0
        while at < samples.shape[1]:
            count = min(window.hop - window.taken, samples.shape[1] - at)
            _add(stream, window, samples[:, at : at + count])
            at += count
            if window.taken == window.hop:
                _complete(stream, window)
    stream.samples += samples.shape[1]


def interrupt(stream: OnlineResponses, lost: int) -> None:
    """Begin anew after ``lost`` samples that did not come; complete windows stay."""
    stream.samples += lost
    for window in stream.windows:
        window.blocks, window.sums, window.taken = [], [], 0
        window.running = np.zeros_like(window.running)
        window.part = np.zeros_like(window.part)
        window.first = stream.samples


def estimated(stream: OnlineResponses) -> FrequencyResponses | None:
    """Return the responses by the windows that are complete; None while a frequency has none."""
    oldest = stream.samples - round(stream.memory / stream.step)
    rows, numbers, spans = [], [], []
    for number, window in enumerate(stream.windows):
        gone = sum(start < oldest for start in window.starts)
        window.rows, window.starts = window.rows[gone:], window.starts[gone:]
        rows += window.rows
        numbers += [number] * len(window.rows)
        spans += [(start, STEPS_PER_WINDOW * window.hop) for start in window.starts]
    if len(rows) < 2:
        return None
    overlap = overlap_of(np.array(spans) * stream.step, np.zeros(len(rows), dtype=int))
    transforms = np.stack(rows, axis=2)
    segments = Segments(transforms, np.array(numbers), stream.spectra.windows, overlap)
    there = segments.usable(stream.frequency).any(axis=0)
    if not there.any():
        return None
    present = Segments(transforms[..., there], segments.windows, segments.lengths, overlap)
    frequency = stream.frequency[there]
    result = responses_of_segments(
        present, frequency, stream.spectra, stream.outputs, stream.inputs, stream.joint
    )
    return replace(result, usable=_excited_runs(stream, present, result))


def _excited_runs(
    stream: OnlineResponses, segments: Segments, responses: FrequencyResponses
) -> np.ndarray:
    """Return the usable bands ``(m, q, F)`` without frequencies that no excitation has reached yet.

    Before a sweep reaches a frequency, what its transform holds has leaked from where the sweep
    is: coherent, and the response of there. A component that is d/length off the frequency has
    2 pi i d/length times as large a transform under the window's derivative. Where the root mean
    square of d exceeds half of the main lobe, the power lies elsewhere; where its mean is far from
    zero, the sweep has come but not passed, and the response is extrapolated from one side.
    """
    m, q = stream.outputs, stream.inputs
    usable = segments.usable(responses.frequency)
    counts = np.maximum(np.bincount(segments.windows, minlength=len(segments.lengths)), 1)
    share = usable / counts[segments.windows][:, None]
    length = np.array(segments.lengths)[segments.windows][:, None] / (2.0 * math.pi)
    out = np.zeros_like(responses.usable)
    log = np.log(responses.frequency)
    for one in range(q):
        plain, under = segments.transforms[m + q + one if stream.joint else m + one, :2]
        power = np.sum(share * np.abs(plain) ** 2, axis=0)
        away = np.sum(share * np.abs(length * under) ** 2, axis=0)
        aside = np.sum(share * length * (np.conj(plain) * under).imag, axis=0)
        excited = (away <= HALF_LOBE**2 * power) & (np.abs(aside) <= ONE_SIDED * power)
        for output in range(m):
            out[output, one] = longest_run(responses.usable[output, one] & excited, log)
    return out


def _add(stream: OnlineResponses, window: _Window, samples: np.ndarray) -> None:
    """Add samples that lie in one block."""
    count = samples.shape[1]
    index = window.taken + np.arange(count)
    shift = 1.0 / (STEPS_PER_WINDOW * window.hop * stream.step)
    for row, each in enumerate((0.0, -shift, shift)):
        turns = np.exp(-2j * math.pi * stream.step * np.outer(index, stream.frequency + each))
        window.running[row] += samples @ turns.real + 1j * (samples @ turns.imag)
    window.part += np.stack([samples.sum(axis=1), samples @ index], axis=1)
    window.taken += count


def _complete(stream: OnlineResponses, window: _Window) -> None:
    """End a block; with four of them a window."""
    window.blocks.append(window.running)
    window.sums.append(window.part)
    window.running, window.part = np.zeros_like(window.running), np.zeros_like(window.part)
    window.taken = 0
    if len(window.blocks) < STEPS_PER_WINDOW:
        return
    rows = hann_of_blocks(
        np.stack(window.blocks, axis=2),
        stream.step,
        window.hop,
        stream.frequency,
        stream.spectra.derivatives,
    )[:, :, 0]
    rows = rows - np.einsum("sk,kdf->sdf", _straight(window), window.lines)
    start = np.exp(-2j * math.pi * window.first * stream.step * stream.frequency)
    window.rows.append(rows * start)
    window.starts.append(window.first)
    del window.blocks[0], window.sums[0]
    window.first += window.hop


def _straight(window: _Window) -> np.ndarray:
    """Level and slope ``(S, 2)`` of the straight line that fits each signal of a window best, by
    the centred sample numbers that ``lines`` has."""
    hop, size = window.hop, STEPS_PER_WINDOW * window.hop
    plain = sum(part[:, 0] for part in window.sums)
    by_time = sum(part[:, 1] + m * hop * part[:, 0] for m, part in enumerate(window.sums))
    centre = 0.5 * (size - 1)
    spread = size * (size**2 - 1) / 12.0
    return np.stack([plain / size, (by_time - centre * plain) / spread], axis=1)
