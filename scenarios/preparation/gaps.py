"""Gaps in the time of a record: nothing is known of the inputs there, so the record becomes several, each with initial states of its own."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from scenarios.files.formats.cells import LARGEST
from sim.errors import RecordError
from sim.record import Record

# Of 767 simulated records at 10 to 400 Hz, even or with jitter of a quarter of a step, none is split; of 379 that lost up to a
# tenth of their rows at random one is.
MANY = 5.0  # usual steps, from which a longer one is a gap
LONG = 0.25  # s, which a gap lasts at least: shorter ones are bridged by the input before them
FEWEST = 30  # samples that a part needs to be used


def gaps_of(record: Record) -> np.ndarray:
    """Positions of the samples before a gap, shape ``(G,)``: steps longer than five usual ones and than a quarter of a second."""
    steps = np.diff(record.time)
    return np.flatnonzero(steps > max(MANY * float(np.median(steps)), LONG))


def split_at_gaps(record: Record) -> tuple[tuple[Record, ...], str]:
    """The parts of a record between its gaps and a sentence on them; the record itself and nothing where it has none.

    Raises RecordError for a time beyond all measure.

    A part of fewer than 30 samples is left out, unless no part has more; every part is named ``NAME[from-to s]``.
    """
    wrong = np.flatnonzero(np.abs(record.time) > LARGEST)
    if wrong.size:
        what = f"{record.time[wrong[0]]:g} s is no time of a measurement"
        raise RecordError(what, where=record.name, remedy="correct the time stamps, or cut them off with --from and --to")
    after = gaps_of(record)
    if not after.size:
        return (record,), ""
    ends = [0, *(int(position) + 1 for position in after), len(record)]
    spans = [(begin, end) for begin, end in pairwise(ends) if end - begin >= 2]
    kept = [span for span in spans if span[1] - span[0] >= FEWEST] or spans
    parts = tuple(_rows(record, begin, end) for begin, end in kept)
    t = record.time
    shown = [f"{t[position]:.4g} to {t[position + 1]:.4g} s" for position in after[:3]]
    more = f" and {after.size - 3} more" if after.size > 3 else ""
    dropped = len(ends) - 1 - len(kept)
    left = f"; {dropped} part{'s' * (dropped > 1)} of fewer than {FEWEST} samples left out" if dropped else ""
    some = f"the record has {'a gap' if after.size == 1 else f'{after.size} gaps'} ({', '.join(shown)}{more})"
    return parts, f"{some} and is used as {len(parts)} record{'s' * (len(parts) > 1)}{left}"


def _rows(record: Record, begin: int, end: int) -> Record:
    part = record.window(float(record.time[begin]), float(record.time[end - 1]))
    return replace(part, name=f"{record.name}[{part.time[0]:.4g}-{part.time[-1]:.4g} s]")
