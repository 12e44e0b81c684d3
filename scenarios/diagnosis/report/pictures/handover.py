"""What the figures of a diagnosis show, as bytes for another process: a line of JSON, then arrays
in NumPy's own format.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ident.tracing.diagnosis import Candidate, FittedRecord, Prediction, Quantity
from scenarios.plots.display import NamedEffects, Pictured, Replicated
from scenarios.plots.formats import USUAL, Formats
from sim.record import Channel, Hold, Record


def packed(pictured: Pictured, folder: Path, formats: Formats = USUAL) -> bytes:
    """Everything the figures need as one line of JSON, in which arrays are numbers, and the arrays
    behind it.
    """
    arrays: list[np.ndarray] = []

    def kept(array: np.ndarray) -> int:
        arrays.append(np.asarray(array))
        return len(arrays) - 1

    def channels(some: tuple[Channel, ...]) -> list[Any]:
        return [[c.name, c.unit, kept(c.values), kept(c.valid)] for c in some]

    def record(r: Record) -> dict[str, Any]:
        return {
            "time": kept(r.time),
            "inputs": channels(r.inputs),
            "outputs": channels(r.outputs),
            "hold": r.hold.value,
            "name": r.name,
        }

    head = {
        "folder": str(folder),
        "formats": formats,
        "fitted": [
            [record(f.record), f.channels, kept(f.before), kept(f.after), kept(f.used)]
            for f in pictured.fitted
        ],
        "predictions": [
            [record(p.record), p.channels, kept(p.before), kept(p.after)]
            for p in pictured.predictions
        ],
        "candidates": [_candidate(c) for c in pictured.candidates],
        "before": _quantities(pictured.before),
        "after": _quantities(pictured.after),
        "noise": dict(pictured.noise),
        "standing": asdict(pictured.standing),
        "data": pictured.data,
        "kind": pictured.kind,
        "replicated": [
            [
                r.name,
                r.records,
                [_quantities(each) for each in r.by_record],
                _quantities(r.together),
            ]
            for r in pictured.replicated
        ],
    }
    stream = io.BytesIO()
    stream.write(json.dumps(head).encode() + b"\n")
    for array in arrays:
        np.save(stream, array, allow_pickle=False)
    return stream.getvalue()


def unpacked(content: bytes) -> tuple[Pictured, Path, Formats]:
    """What ``packed`` was given."""
    stream = io.BytesIO(content)
    head = json.loads(stream.readline())
    arrays: list[np.ndarray] = []
    while stream.tell() < len(content):
        arrays.append(np.load(stream, allow_pickle=False))

    def channels(some: list[Any]) -> tuple[Channel, ...]:
        return tuple(
            Channel(name, unit, arrays[values], arrays[valid]) for name, unit, values, valid in some
        )

    def record(r: dict[str, Any]) -> Record:
        return Record(
            arrays[r["time"]],
            channels(r["inputs"]),
            channels(r["outputs"]),
            Hold(r["hold"]),
            r["name"],
        )

    pictured = Pictured(
        tuple(
            FittedRecord(record(r), tuple(names), arrays[b], arrays[a], arrays[u])
            for r, names, b, a, u in head["fitted"]
        ),
        tuple(
            Prediction(record(r), tuple(names), arrays[b], arrays[a])
            for r, names, b, a in head["predictions"]
        ),
        tuple(_read_candidate(some) for some in head["candidates"]),
        _read_quantities(head["before"]),
        _read_quantities(head["after"]),
        head["noise"],
        _read_standing(head["standing"]),
        head["kind"],
        tuple(
            Replicated(
                name,
                tuple(records),
                tuple(_read_quantities(each) for each in by_record),
                _read_quantities(together),
            )
            for name, records, by_record, together in head["replicated"]
        ),
        head["data"],
    )
    return pictured, Path(head["folder"]), tuple(head["formats"])


def _candidate(c: Candidate) -> list[Any]:
    return [c.round, list(c.within), c.name, c.gain, c.weight, c.fitted, list(c.collinear_with)]


def _read_candidate(some: list[Any]) -> Candidate:
    number, within, name, gain, weight, fitted, like = some
    return Candidate(number, tuple(within), name, gain, weight, fitted, {}, tuple(like))


def _read_standing(some: Mapping[str, Any]) -> NamedEffects:
    alternatives = {name: tuple(names) for name, names in some["alternatives"].items()}
    return NamedEffects(
        tuple(some["claimed"]), alternatives, tuple(some["hints"]), some["noise_left"]
    )


def _quantities(some: Mapping[str, Quantity]) -> dict[str, list[Any]]:
    return {name: [q.value, q.std, q.unit] for name, q in some.items()}


def _read_quantities(some: Mapping[str, list[Any]]) -> dict[str, Quantity]:
    return {name: Quantity(*parts) for name, parts in some.items()}
