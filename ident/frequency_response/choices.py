"""What an estimate needs and a record suggests: band, frequencies, rate, window lengths."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ident.frequency_response.estimate import Signals, detrended
from ident.frequency_response.segments import LOWEST
from sim.errors import RecordError

SAMPLES = 5.0  # a period, that are left at the highest frequency
POWER = 0.99  # of the inputs, that lies within a band that is not given
PER_DECADE = 40  # frequencies
_FEWEST = 12  # frequencies of a narrow band
WINDOWS = 4  # lengths, each half of the one before
_SHARE, _MOST = 0.25, 0.5  # of the longest record: the longest window, usually and at most
_CYCLES = 2.5  # periods of the lowest frequency, that the longest window holds where it can


def window_lengths(durations: Sequence[float], low: float | None = None, count: int = WINDOWS) -> tuple[float, ...]:
    """Lengths of windows, s, each half of the one before.

    The longest is a quarter of the longest record. Where that does not hold 2.5 periods of the
    lowest frequency ``low``, Hz, it is longer, at most half of the record.
    """
    whole = max(durations)
    longest = _SHARE * whole
    if low is not None:
        longest = min(max(longest, _CYCLES / low), _MOST * whole)
    return tuple(longest / 2**n for n in range(count))


def input_band(records: Sequence[Signals], low: float) -> tuple[float, float]:
    """From ``low`` to the frequency, Hz, below which the inputs have 99 % of their power, at most a
    fifth of the rate; of several inputs the one that reaches highest counts."""
    step = records[0].step
    size = max(each.inputs.shape[1] for each in records)
    frequency = np.fft.rfftfreq(size, step)
    power = sum(np.abs(np.fft.rfft(detrended(each.inputs), size)) ** 2 for each in records)
    total = np.cumsum(power, axis=1)
    if not np.all(total[:, -1] > 0.0):
        raise RecordError("an input does not move", where="input", remedy="choose another part")
    first = np.argmax(total >= POWER * total[:, -1:], axis=1)
    return low, float(min(max(frequency[first].max(), 4.0 * low), 1.0 / (SAMPLES * step)))


def frequencies(low: float, high: float) -> np.ndarray:
    """Frequencies in Hz from ``low`` to ``high``, evenly spaced in their logarithm."""
    count = max(_FEWEST, round(PER_DECADE * math.log10(high / low)) + 1)
    return np.geomspace(low, high, count)


def lowest_frequency(windows: Sequence[float]) -> float:
    """The lowest frequency, Hz, that the longest window resolves."""
    return LOWEST / max(windows)


def decimated(records: Sequence[Signals], high: float) -> tuple[list[Signals], int]:
    """The records with every n-th sample behind a zero-phase filter, the same for all signals, so
    that five samples a period are left at ``high``, Hz; and n, 1 where nothing is to be left out."""
    step = records[0].step
    factor = math.floor(1.0 / (SAMPLES * high * step) * (1.0 + 1e-9))
    if factor < 2:
        return list(records), 1
    from scipy.signal import resample_poly

    def fewer(rows: np.ndarray) -> np.ndarray:
        return np.asarray(resample_poly(detrended(rows), 1, factor, axis=1)) if len(rows) else rows

    return [Signals(factor * step, fewer(each.inputs), fewer(each.outputs), fewer(each.references)) for each in records], factor
