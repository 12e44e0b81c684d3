"""Rows that are missing: gaps in time, told where an input moves across them."""

from __future__ import annotations

import numpy as np

from ident.recording.finding import Certainty, Finding, Kind, Number
from sim.record import Record

EVEN = 0.05  # of the usual step, within which nine tenths of an even record's steps lie
MISSING, UNEVEN = 1.6, 4.0  # usual steps, from which rows are missing of an even record, and of an uneven one
MOVES = 0.05  # of an input's span
MOST = 1e15  # rows that are counted: a time that is wrong by more has no number of them


def missing_rows(record: Record) -> list[Finding]:
    """Gaps in time: a warning where an input moves across them, since what it did inside is not known; else a note."""
    steps = np.diff(record.time)
    usual = float(np.median(steps))
    even = float(np.mean(np.abs(steps - usual) < EVEN * usual)) > 0.9
    least = MISSING * usual if even else max(UNEVEN * usual, 2.0 * float(np.percentile(steps, 98.0)))
    gaps = np.flatnonzero(steps > least)
    if not gaps.size:
        return []
    moving = np.zeros(len(gaps), dtype=bool)
    for channel in record.inputs:
        span = float(np.ptp(channel.values))
        if span > 0.0:
            lowest, highest = _range_about(channel.values, gaps)
            moving |= highest - lowest > MOVES * span
    out = []
    for some, certainty, word in ((gaps[moving], Certainty.LIKELY, "while an input moves"), (gaps[~moving], Certainty.NOTED, "")):
        if some.size:
            out.append(_finding(record, some, usual, certainty, word))
    return out


def _finding(record: Record, gaps: np.ndarray, usual: float, certainty: Certainty, word: str) -> Finding:
    steps = np.diff(record.time)
    times = tuple((float(record.time[gap]), float(record.time[gap + 1])) for gap in gaps)
    rows = int(np.sum(np.round(np.minimum(steps[gaps], MOST * usual) / usual) - 1))
    places = ", ".join(f"{begin:.4g} to {end:.4g} s" for begin, end in times[:3])
    told = f"misses about {rows} row(s) {word + ' ' if word else ''}({places}{' and so on' if len(times) > 3 else ''})"
    likely = certainty is Certainty.LIKELY
    told += ": what the input did there is taken from the row before" if likely else ""
    if record.inputs and not likely:
        told += ": a simulation goes through with the inputs of the row before"
    remedy = "give the parts before and after as segments, --from and --to in pairs" if likely else ""
    numbers = {"rows": Number(float(rows), "1"), "longest": Number(float(np.max(steps[gaps])), "s")}
    return Finding("time", Kind.ROWS_MISSING, certainty, told, remedy, times, numbers)


def _range_about(values: np.ndarray, gaps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest of the two samples on either side of each gap."""
    at = np.clip(gaps[:, None] + np.arange(-1, 3)[None, :], 0, len(values) - 1)
    return np.min(values[at], axis=1), np.max(values[at], axis=1)
