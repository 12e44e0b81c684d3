"""Signals of records with lateral channels or a height, for the kinematics of six degrees of
freedom.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ident.compatibility.signals import (
    IGNORED_ENDS,
    LEAST_RECORD_ENDS,
    KinematicSignals,
    isolated_spikes,
)
from sim.errors import RecordError
from sim.maths import G0
from sim.record import Record

HEIGHTS = ("height", "altitude")
AXES: Mapping[str, tuple[str, ...]] = {"x": ("ax", "nx"), "y": ("ay", "ny"), "z": ("nz", "az")}
_LONGITUDINAL = ("alpha", "q", "nz", "az", "theta", "airspeed", "ax", "nx")
CHANNELS = (*_LONGITUDINAL, "beta", "p", "r", "ay", "ny", "phi", "psi", *HEIGHTS)
WINGS_LEVEL_NOTE = "no bank angle is recorded: the wings are taken as level"
# outputs that have no relation in longitudinal motion
BEYOND_LONGITUDINAL = ("beta", "phi", "psi", *HEIGHTS)
WRAPPED = ("phi", "psi")  # angles that may jump by a turn
_INCREMENTAL_LOAD = 0.5  # g: a smaller mean load does not include the weight
_STEEPEST_PITCH = 1.4  # rad: at steeper pitch Euler angles are not usable


def usable_channels(record: Record) -> tuple[str, ...]:
    """Return the channels of a record that the kinematics use, with one accelerometer for each axis
    and one height.
    """
    have = [
        name
        for name in CHANNELS
        if name in record.output_names and np.count_nonzero(record[name].valid) > 1
    ]
    for alternatives in (*AXES.values(), HEIGHTS):
        for name in [name for name in alternatives if name in have][1:]:
            have.remove(name)
    return tuple(have)


def load_on(axis: str, names: Sequence[str]) -> str | None:
    """Return the channel of the accelerometer along an axis (x, y, z); None without one."""
    return next((name for name in AXES[axis] if name in names), None)


def relations(names: Sequence[str], *, speed: bool) -> dict[str, tuple[str, ...]]:
    """Return output -> channels of its relation, for each relation whose required channels are all
    among ``names``. The required channels come first.

    ``speed`` : whether an airspeed is recorded or given.
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
        output: (*required, *(name for name in optional if name in have))
        for output, (required, optional, possible) in needs.items()
        if possible and set(required) <= have
    }


def prepared_signals(
    record: Record, channels: Sequence[str], airspeed: float | None, gravity: float, vane_arm: float
) -> tuple[KinematicSignals, tuple[str, ...]]:
    """Return the signals of a record, and sentences on changes made to them.

    Angles that wrap around are unwrapped. The weight is added to a vertical load recorded as an
    increment.

    Parameters
    ----------
    channels : the channels common to all records.
    airspeed : m/s, where none is recorded; None without.
    gravity : m/s2.
    vane_arm : m.

    Raises
    ------
    RecordError : if the pitch attitude comes near the vertical.
    """
    bridged, valid, spikes, notes = {}, {}, {}, []
    for name in channels:
        values, mask = record[name].values.copy(), record[name].valid.copy()
        if name in WRAPPED:
            values[mask] = np.unwrap(values[mask])
        wrong = isolated_spikes(record.time[mask], values[mask])
        spikes[name] = int(np.count_nonzero(wrong))
        mask[np.flatnonzero(mask)[wrong]] = False
        if name == "theta" and np.any(np.abs(values[mask]) > _STEEPEST_PITCH):
            where = f"{record.name}, channel theta"
            raise RecordError(
                "an attitude near the vertical, where bank and heading mean nothing",
                where=where,
                remedy="cut the record there",
            )
        bridged[name] = np.interp(record.time, record.time[mask], values[mask])
        valid[name] = mask
    if (z := load_on("z", channels)) is not None:
        weight = 1.0 if z == "nz" else -G0
        if float(np.median(bridged[z])) / weight < _INCREMENTAL_LOAD:
            bridged[z] = bridged[z] + weight
            notes.append(f"{z} of {record.name} does not include the weight, which is added")
    relation_list = relations(channels, speed=airspeed is not None or "airspeed" in channels)
    used = {name for joined in relation_list.values() for name in joined}
    long_enough = record.time[-1] - record.time[0] > LEAST_RECORD_ENDS * IGNORED_ENDS
    edge = IGNORED_ENDS if long_enough else 0.0
    inside = (record.time >= record.time[0] + edge) & (record.time <= record.time[-1] - edge)
    if "airspeed" in bridged:
        speed = bridged["airspeed"]
    else:
        speed = np.full(len(record), np.inf if airspeed is None else airspeed)
    measured = np.array([valid[name] & inside for name in relation_list]).reshape(
        len(relation_list), len(record)
    )
    used_channels = {name: bridged[name] for name in channels if name in used}
    return KinematicSignals(
        record.name,
        record.time,
        used_channels,
        tuple(relation_list),
        measured,
        speed,
        gravity,
        vane_arm,
        np.zeros(0),
        spikes,
    ), tuple(notes)
