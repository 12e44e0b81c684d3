"""Records with lateral channels or a height made ready for the kinematics: which relations their channels close, and what each joins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ident.compatibility.signals import EDGE, Signals, isolated
from sim.errors import RecordError
from sim.maths import G0
from sim.record import Record

HEIGHTS = ("height", "altitude")
AXES: Mapping[str, tuple[str, ...]] = {"x": ("ax", "nx"), "y": ("ay", "ny"), "z": ("nz", "az")}
CHANNELS = ("alpha", "q", "nz", "az", "theta", "airspeed", "ax", "nx", "beta", "p", "r", "ay", "ny", "phi", "psi", *HEIGHTS)
BEYOND = ("beta", "phi", "psi", *HEIGHTS)  # outputs that the longitudinal relations do not have
WRAPPED = ("phi", "psi")
_INCREMENTAL = 0.5  # g: a mean load below is one without the weight
_STEEPEST = 1.4  # rad: nearer to the vertical Euler angles are no measurement


def recorded(record: Record) -> tuple[str, ...]:
    """Channels of a record that the kinematics know, of an acceleration one for each axis, of a height one."""
    have = [name for name in CHANNELS if name in record.output_names and np.count_nonzero(record[name].valid) > 1]
    for several in (*AXES.values(), HEIGHTS):
        for name in [name for name in several if name in have][1:]:
            have.remove(name)
    return tuple(have)


def load_on(axis: str, names: Sequence[str]) -> str | None:
    """Channel of the accelerometer along an axis (x, y, z), None where there is none."""
    return next((name for name in AXES[axis] if name in names), None)


def relations(names: Sequence[str], *, speed: bool) -> dict[str, tuple[str, ...]]:
    """Output of each relation that these channels close, and the channels that it joins; ``speed``: an airspeed is recorded or given.

    What a relation needs comes first, then what it takes along where it is there.
    """
    have = set(names)
    x, y, z = (load_on(axis, names) or "" for axis in "xyz")
    height = next((name for name in HEIGHTS if name in have), "")
    needs = {
        "alpha": (("alpha", "q", z), ("theta", "phi", x, "beta", "p", "r", "airspeed"), speed),
        "theta": (("theta", "q"), ("phi", "r"), "phi" not in have or "r" in have),
        "airspeed": (("airspeed", x, "theta", "alpha", z), ("beta", y, "phi"), True),
        "beta": (("beta", "r", y, "phi"), ("p", "alpha", "theta", x, z, "airspeed"), speed),
        "phi": (("phi", "p"), ("r", "q", "theta"), True),
        "psi": (("psi", "r", "phi"), ("q", "theta"), True),
        height: ((height, "theta", "alpha"), ("airspeed", "phi", "beta"), speed),
    }
    return {
        output: (*needed, *(name for name in along if name in have))
        for output, (needed, along, closed) in needs.items()
        if closed and set(needed) <= have
    }


def ready(record: Record, channels: Sequence[str], airspeed: float | None, gravity: float, vane_arm: float) -> tuple[Signals, tuple[str, ...]]:
    """Signals of a record for its ``channels``, those common to all records; and sentences on what was done to them.

    Angles that wrap around are unwrapped; a vertical load without the weight gets it.

    Raises
    ------
    RecordError : an attitude near the vertical.
    """
    raw, valid, spikes, notes = {}, {}, {}, []
    for name in channels:
        values, there = record[name].values.copy(), record[name].valid.copy()
        if name in WRAPPED:
            values[there] = np.unwrap(values[there])
        wrong = isolated(record.time[there], values[there])
        spikes[name] = int(np.count_nonzero(wrong))
        there[np.flatnonzero(there)[wrong]] = False
        if name == "theta" and np.any(np.abs(values[there]) > _STEEPEST):
            where = f"{record.name}, channel theta"
            raise RecordError("an attitude near the vertical, where bank and heading mean nothing", where=where, remedy="cut the record there")
        raw[name], valid[name] = np.interp(record.time, record.time[there], values[there]), there
    if (z := load_on("z", channels)) is not None:
        weight = 1.0 if z == "nz" else -G0
        if float(np.median(raw[z])) / weight < _INCREMENTAL:
            raw[z] = raw[z] + weight
            notes.append(f"{z} of {record.name} is without the weight, which is added")
    found = relations(channels, speed=airspeed is not None or "airspeed" in channels)
    used = {name for joined in found.values() for name in joined}
    edge = EDGE if record.time[-1] - record.time[0] > 50.0 * EDGE else 0.0
    inside = (record.time >= record.time[0] + edge) & (record.time <= record.time[-1] - edge)
    speed = raw["airspeed"] if "airspeed" in raw else np.full(len(record), airspeed if airspeed is not None else np.inf)
    measured = np.array([valid[name] & inside for name in found]).reshape(len(found), len(record))
    kept = {name: raw[name] for name in channels if name in used}
    return Signals(record.name, record.time, kept, tuple(found), measured, speed, gravity, vane_arm, np.zeros(0), spikes), tuple(notes)
