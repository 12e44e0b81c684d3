"""Isolated wrong samples of a measured record, found in the residual of a fit and set aside before the fit is made again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.recording.series import Certainty, Kind, Number, RecordFinding, shown
from ident.tracing.spikes.detection import input_edges, isolated_wrong
from scenarios.preparation.recording import RawLook, Seen
from sim.record import Channel, Record

PLACES = 3  # times that a sentence names


def wild_points(outputs: Sequence[str], simulated: Sequence[np.ndarray], records: Sequence[Record]) -> list[dict[str, np.ndarray]]:
    """Of each record ``(N,)`` by channel: True at its wild points, from what the simulations miss;
    channels without any are left out.

    ``simulated``: ``(m, N)`` of the ``outputs`` of each record. ``records``: with all their
    samples.
    """
    out: list[dict[str, np.ndarray]] = [{} for _ in records]
    if len(simulated) != len(records):
        return out
    for row, name in enumerate(outputs if simulated else ()):
        which = [k for k, record in enumerate(records) if name in record.output_names]
        valid = [records[k][name].valid & np.isfinite(simulated[k][row]) for k in which]
        residuals = [np.where(known, records[k][name].values - simulated[k][row], 0.0) for k, known in zip(which, valid, strict=True)]
        wrong = isolated_wrong(residuals, valid, [input_edges(records[k]) for k in which])
        for k, mask in zip(which, wrong, strict=True):
            if np.any(mask):
                out[k][name] = mask
    return out


def same_points(some: Sequence[dict[str, np.ndarray]], others: Sequence[dict[str, np.ndarray]]) -> bool:
    """Whether two lists of masks name the same samples."""
    pairs = zip(some, others, strict=True)
    return all(a.keys() == b.keys() and all(np.array_equal(a[name], b[name]) for name in a) for a, b in pairs)


def left_out(before: Record, after: Record) -> dict[str, np.ndarray]:
    """The samples by channel, ``(N,)``, that one record has and the same record after it does not;
    channels without any are left out."""
    masks = {channel.name: before[channel.name].valid & ~channel.valid for channel in after.outputs}
    return {name: mask for name, mask in masks.items() if np.any(mask)}


def without(record: Record, masks: dict[str, np.ndarray]) -> Record:
    """A record less some samples of its outputs; itself where there are none."""
    if not masks:
        return record

    def of(channel: Channel) -> Channel:
        mask = masks.get(channel.name)
        return channel if mask is None else Channel.of(channel.name, channel.unit, np.where(mask, np.nan, channel.with_gaps()))

    return replace(record, outputs=tuple(map(of, record.outputs)))


def with_wild_points(look: RawLook, records: Sequence[Record], masks: Sequence[dict[str, np.ndarray]]) -> RawLook:
    """What was seen in the records, with their wild points."""
    seen = [_seen(record, name, mask) for record, some in zip(records, masks, strict=True) for name, mask in some.items()]
    return replace(look, seen=(*look.seen, *seen))


def _seen(record: Record, name: str, mask: np.ndarray) -> Seen:
    times, count = record.time[mask].tolist(), int(np.count_nonzero(mask))
    places = ", ".join(f"{time:.4g} s" for time in times[:PLACES]) + (" and so on" if count > PLACES else "")
    channel = record[name]
    away = np.abs(channel.values - np.median(channel.values[channel.valid]))[mask]
    told = f"has {count} wild point{'s' if count > 1 else ''}, far from the samples around and from the fit ({places})"
    told += f", up to {shown(float(np.max(away)), channel.unit)} from the middle of the channel"
    numbers = {"samples": Number(float(count), "1")}
    finding = RecordFinding(name, Kind.WILD_POINTS, Certainty.COSTS_INFORMATION, told, "", tuple((t, t) for t in times), numbers, mask)
    return Seen(record.name, finding, "set aside", count)
