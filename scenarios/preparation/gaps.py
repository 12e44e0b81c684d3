"""Gaps in the time of a record: nothing is known of the inputs there, so the record becomes
several, each with initial states of its own.

A record that is fitted is used as several records. One that is predicted is predicted in parts, and
the parts are put together again, so
that its errors are those of all parts and each of its rows has a prediction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from scenarios.files.formats.cells import LARGEST
from sim.errors import RecordError
from sim.record import Channel, Record

# Of 767 simulated records at 10 to 400 Hz, even or with jitter of a quarter of a step, none is split; of 379 that lost up to a
# tenth of their rows at random one is.
MANY = 5.0  # usual steps, from which a longer one is a gap
LONG = 0.25  # s, which a gap lasts at least: shorter ones are bridged by the input before them
FEWEST = 30  # samples that a part needs to be used


def gaps_of(record: Record) -> np.ndarray:
    """Positions of the samples before a gap, shape ``(G,)``: steps longer than five usual ones and than a quarter of a second."""
    steps = np.diff(record.time)
    return np.flatnonzero(steps > max(MANY * float(np.median(steps)), LONG))


@dataclass(frozen=True, eq=False)
class Parted:
    """A record that is predicted in parts.

    Attributes
    ----------
    name : of the record. time : shape ``(N,)``, s, of all its rows; None where its parts are
        resampled.
    count : number of its parts.
    """

    name: str
    time: np.ndarray | None
    count: int


def parts_of(parted: Sequence[Parted], each: Sequence[Record]) -> list[tuple[Parted, slice]]:
    """Each record with the places of its parts in a list of the parts of all of them, which
    ``each`` is."""
    ends = np.cumsum([0, *(one.count for one in parted)]).tolist()
    assert ends[-1] == len(each)
    return [(one, slice(*span)) for one, span in zip(parted, pairwise(ends), strict=True)]


def put_together(parted: Parted, parts: Sequence[Record], rows: Sequence[Sequence[np.ndarray]]) -> tuple[Record, list[np.ndarray]]:
    """A record of its parts, and each of several predictions ``(m, N)`` of those of the parts.

    Rows outside the parts have no measurement, the inputs before them and, as where a simulation
    fails, the mean of the prediction.

    Parameters
    ----------
    parted : the record. parts : in the order of their times. rows : predictions, each ``(m, n)``
        for each part.
    """
    if len(parts) == 1 and (parted.time is None or len(parts[0]) == parted.time.size):
        return replace(parts[0], name=parted.name), [of_parts[0] for of_parts in rows]
    times = np.concatenate([part.time for part in parts])
    time = times if parted.time is None else parted.time
    places = np.searchsorted(time, times)
    before = np.clip(np.searchsorted(times, time, side="right") - 1, 0, None)
    known = np.zeros(time.size, dtype=bool)
    known[places] = True

    def inputs(channel: Channel) -> Channel:
        return Channel.of(channel.name, channel.unit, np.concatenate([part[channel.name].values for part in parts])[before])

    def outputs(channel: Channel) -> Channel:
        values = [part[channel.name].with_gaps() if channel.name in part.output_names else np.full(len(part), np.nan) for part in parts]
        return Channel.of(channel.name, channel.unit, np.where(known, np.concatenate(values)[before], np.nan))

    every = {channel.name: channel for part in reversed(parts) for channel in part.outputs}
    record = Record(time, tuple(map(inputs, parts[0].inputs)), tuple(map(outputs, every.values())), parts[0].hold, parted.name)
    out = []
    for of_parts in rows:
        all_parts = np.concatenate(of_parts, axis=1)
        out.append(np.where(known, all_parts[:, before], all_parts.mean(axis=1, keepdims=True)))
    return record, out


def split_at_gaps(record: Record, use: str = "used as {count} record{s}") -> tuple[tuple[Record, ...], str]:
    """The parts of a record between its gaps and a sentence on them; the record itself and nothing where it has none.

    ``use`` : what the sentence says is done with the parts.

    Raises RecordError for a time beyond all measure.

    A part of fewer than 30 samples, or without a sample of any output, is left out, unless no part
    has more; a part lacks the outputs of which
    it has no sample; every part is named ``NAME[from-to s]``.
    """
    wrong = np.flatnonzero(np.abs(record.time) > LARGEST)
    if wrong.size:
        what = f"{record.time[wrong[0]]:g} s is no time of a measurement"
        raise RecordError(what, where=record.name, remedy="correct the time stamps, or cut them off with --from and --to")
    after = gaps_of(record)
    if not after.size:
        return (record,), ""
    ends = [0, *(int(position) + 1 for position in after), len(record)]
    seen = [any(np.any(channel.valid[begin:end]) for channel in record.outputs) for begin, end in pairwise(ends)]
    spans = [(begin, end) for (begin, end), some in zip(pairwise(ends), seen, strict=True) if end - begin >= 2 and some]
    kept = [span for span in spans if span[1] - span[0] >= FEWEST] or spans
    parts = tuple(_rows(record, begin, end) for begin, end in kept)
    t = record.time
    shown = [f"{t[position]:.4g} to {t[position + 1]:.4g} s" for position in after[:3]]
    more = f" and {after.size - 3} more" if after.size > 3 else ""
    dropped = len(ends) - 1 - len(kept)
    left = f"; {dropped} part{'s' * (dropped > 1)} of fewer than {FEWEST} samples left out" if dropped else ""
    some = f"the record has {'a gap' if after.size == 1 else f'{after.size} gaps'} ({', '.join(shown)}{more})"
    return parts, f"{some} and is {use.format(count=len(parts), s='s' * (len(parts) > 1))}{left}"


def _rows(record: Record, begin: int, end: int) -> Record:
    # A part of a record lacks the outputs of which it has no sample, as a record would.
    measured = tuple(channel for channel in record.outputs if np.any(channel.valid[begin:end]))
    part = replace(record, outputs=measured).window(float(record.time[begin]), float(record.time[end - 1]))
    return replace(part, name=f"{record.name}[{part.time[0]:.4g}-{part.time[-1]:.4g} s]")
