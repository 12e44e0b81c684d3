"""Records as Fourier transforms at the harmonics of their own length, in a band.

At these frequencies, w_k = 2 pi k / (N dt), transforms of white noise are independent of each other, constant biases leave nothing, and
the beginning and the end of a motion enter through one vector, x(0) - x(N dt). Transforms are divided by sqrt(N): their noise has the
variance of a sample's, whatever the record.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.declaration.model import System
from sim.errors import RecordError
from sim.record import Hold, Record

EVEN = 0.01  # of the interval, by which a sample may be off
FILLED = 0.05  # of a channel's samples, that may be missing and are bridged
POWER = 0.95  # of every input's power that the usual band holds
_REMEDY = "resample with --rate, cut with --from and --to, or use output-error"


@dataclass(frozen=True, eq=False)
class TransformedRecord:
    """A record's transforms.

    Attributes
    ----------
    omega : ``(f,)`` rad/s. ahead : ``(f,)`` exp(j omega dt). bins : ``(f,)`` harmonics that these are.
    outputs : ``(m, f)`` complex, zero where a channel was not recorded; ``known (m,)``.
    inputs : ``(r, N)`` samples, of which a delay may shift any. filled : samples of the outputs that were bridged.
    """

    record: Record
    step: float
    hold: Hold
    bins: np.ndarray
    omega: np.ndarray
    ahead: np.ndarray
    outputs: np.ndarray
    known: np.ndarray
    inputs: np.ndarray
    filled: int

    def shifted(self, i: int, late: int) -> np.ndarray:
        """Transform ``(f,)`` of input ``i`` as it was ``late`` samples before: exp(-j omega late dt) times its own, and its end terms.

        Before its first sample it had that value; what came after the last one is taken up by the vector of the ends.
        """
        count = self.inputs.shape[1]
        at = np.clip(np.arange(count) - late, 0, count - 1)
        return np.asarray(np.fft.rfft(self.inputs[i, at])[self.bins] / np.sqrt(count))


def usual_band(records: Sequence[Record], inputs: Sequence[str], fewest: int) -> tuple[float, float]:
    """From the first harmonic to where 95 % of every input's power lies, Hz, and as far as ``fewest`` harmonics of all records need."""
    high, steps, spans = 0.0, [], []
    for record in records:
        step = step_of(record)
        rows = record.input_array(tuple(inputs))
        power = np.abs(np.fft.rfft(rows - rows.mean(axis=1, keepdims=True))) ** 2
        for row in power:
            if row[1:].sum() > 0.0:
                share = np.cumsum(row[1:]) / row[1:].sum()
                high = max(high, (1 + int(np.searchsorted(share, POWER))) / (len(record) * step))
        steps.append(step)
        spans.append(len(record) * step)
    low = 1.0 / max(spans)
    return low, min(max(high, (fewest + 1) / sum(spans)), 0.5 / max(steps))


def transformed(record: Record, system: System, band: tuple[float, float]) -> TransformedRecord:
    """The record's harmonics within a band, Hz.

    Raises
    ------
    RecordError : uneven samples, too many missing ones, or no harmonic within the band.
    """
    step, count = step_of(record), len(record)
    rows, valid = record.output_array(system.output_names)
    known = np.asarray(valid.any(axis=1))
    filled = 0
    for i in np.flatnonzero(known & ~valid.all(axis=1)):
        lost = int(np.count_nonzero(~valid[i]))
        if lost > FILLED * count:
            what = f"{lost} of {count} samples of {system.output_names[i]} are missing: a Fourier transform needs them"
            raise RecordError(what, where=record.name, remedy=_REMEDY)
        rows[i] = np.interp(record.time, record.time[valid[i]], rows[i][valid[i]])
        filled += lost
    harmonics = np.arange(1, (count + 1) // 2)
    frequency = harmonics / (count * step)
    bins = harmonics[(frequency >= band[0] * (1.0 - 1e-9)) & (frequency <= band[1] * (1.0 + 1e-9))]
    if bins.size == 0:
        what = f"no harmonic of {count * step:.4g} s lies between {band[0]:.4g} and {band[1]:.4g} Hz"
        raise RecordError(what, where=record.name, remedy="widen --band")
    omega = 2.0 * np.pi * bins / (count * step)
    outputs = np.where(known[:, None], np.fft.rfft(np.where(known[:, None], rows, 0.0))[:, bins] / np.sqrt(count), 0.0)
    inputs = record.input_array(system.input_names)
    return TransformedRecord(record, step, record.hold, bins, omega, np.exp(1j * omega * step), outputs, known, inputs, filled)


def step_of(record: Record) -> float:
    """The sampling interval, s. Raises RecordError where samples are uneven."""
    steps = np.diff(record.time)
    step = float(np.median(steps))
    if not np.all(np.abs(steps - step) <= EVEN * step):
        raise RecordError("its samples are uneven: a Fourier transform needs even ones", where=record.name, remedy=_REMEDY)
    return float((record.time[-1] - record.time[0]) / (len(record) - 1))
