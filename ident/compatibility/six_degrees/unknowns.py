"""Unknowns of each record in six degrees of freedom, the faults that its sensors may have, and what they read for values of both, with slopes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.compatibility.faults import ARM, BELOW, BIAS, BOOM, DELAY, DRIFT, LAG, PACKAGE, RIGHT, SCALE, SensorFault
from ident.compatibility.kinematics import Values
from ident.compatibility.signals import Signals
from ident.compatibility.six_degrees.channels import HEIGHTS, load_on
from ident.compatibility.six_degrees.kinematics import reconstructed
from ident.compatibility.unknowns import Unknown, difference_step

_LEVEL = 0.15  # rad: an angle that is not recorded, of which the record's constant is fitted
_SPEED = 0.015  # share by which an airspeed that is not recorded may be off
_LOOSE = 5.0  # of the size that is worth a word: the standard deviation of a bias before the record is seen
_WITHOUT_BIAS = ("psi", *HEIGHTS)  # where it is another start


def unknowns_of(s: Signals) -> tuple[Unknown, ...]:
    """Starts; a bias of every channel whose bias has a trace at all, and of the wind's climb, each under a loose prior; constants for what
    is not recorded."""
    out = [Unknown(("start", name), 1e-3) for name in s.outputs]
    for name in s.channels:
        if name not in _WITHOUT_BIAS:
            size = SensorFault(name, BIAS).plausible
            out.append(Unknown((name, BIAS), 0.02 * size, _LOOSE * size))
    if any(name in s.outputs for name in HEIGHTS):
        out.append(Unknown(("wind", BIAS), 1e-2, SensorFault("wind", BIAS).plausible))
    turns, flows = {"alpha", "phi", "psi", "beta"} & set(s.outputs), {"beta"} & set(s.outputs)
    if "theta" not in s.channels and turns:
        out.append(Unknown(("level", "theta"), 1e-3, _LEVEL))
    if "alpha" not in s.channels and flows:
        out.append(Unknown(("level", "alpha"), 1e-3, _LEVEL))
    if "airspeed" not in s.channels and {"alpha", "beta"} & set(s.outputs):
        out.append(Unknown(("airspeed", SCALE), 1e-3, _SPEED))
    return tuple(out)


def start_of(s: Signals, unknowns: Sequence[Unknown]) -> np.ndarray:
    """First values: states as they are first measured, all else zero."""
    out = np.zeros(len(unknowns))
    for i, item in enumerate(unknowns):
        if item.key[0] == "start":
            row = s.outputs.index(item.key[1])
            out[i] = float(np.median(s.channels[item.key[1]][np.flatnonzero(s.valid[row])[:5]])) if np.any(s.valid[row]) else 0.0
    return out


def faults_of(s: Signals, chord: float = 0.0) -> tuple[SensorFault, ...]:
    """All faults that the sensors of a record may have, of an aircraft of that chord (m); biases are unknowns of each record."""
    channels = tuple(s.channels)
    out = [SensorFault(name, kind) for name in channels for kind in (SCALE, DELAY, LAG, DRIFT)]
    felt: dict[str, list[str]] = {"alpha": [ARM, RIGHT], "beta": [ARM, BELOW]}
    loads = {axis: load_on(axis, channels) for axis in "xyz"}
    for axis, kinds in (("x", [RIGHT, BELOW]), ("y", [ARM, BELOW]), ("z", [ARM, RIGHT])):
        if (name := loads[axis]) is not None:
            felt[name] = kinds
    if sum(name is not None for name in loads.values()) > 1:
        felt[PACKAGE] = [ARM, RIGHT, BELOW]
    if {"alpha", "beta"} <= set(channels):
        felt[BOOM] = [ARM]
    rates = {BOOM: {ARM: "qr"}, "alpha": {ARM: "q", RIGHT: "p"}, "beta": {ARM: "r", BELOW: "p"}, PACKAGE: {ARM: "qr", RIGHT: "pr", BELOW: "pq"}}
    rates |= dict(zip((loads[axis] or "" for axis in "xyz"), ({RIGHT: "r", BELOW: "q"}, {ARM: "r", BELOW: "p"}, {ARM: "q", RIGHT: "p"}), strict=True))
    for name, kinds in felt.items():
        if name in channels or name in (PACKAGE, BOOM):
            out += [SensorFault(name, kind, chord) for kind in kinds if any(rate in channels for rate in rates[name][kind])]
    return tuple(out)


def values_of(unknowns: Sequence[Unknown], faults: Sequence[SensorFault], own: np.ndarray, sizes: np.ndarray) -> Values:
    """The table of the kinematics for rows of values: ``own (P, n)``, ``sizes (P, k)``."""
    table = {item.key: own[:, i : i + 1] for i, item in enumerate(unknowns)}
    for j, fault in enumerate(faults):
        key = (fault.channel, fault.kind)
        table[key] = table[key] + sizes[:, j : j + 1] if key in table else sizes[:, j : j + 1]
    # A size that no row has costs nothing.
    table = {key: rows[:1] if np.all(rows == rows[0]) else rows for key, rows in table.items()}
    none = np.zeros((1, 1))
    return lambda channel, kind: table.get((channel, kind), none)


def evaluate(s: Signals, unknowns: Sequence[Unknown], faults: Sequence[SensorFault], own: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Outputs for rows of values: ``own (P, n)``, ``sizes (P, k)`` to ``(m, P, N)``."""
    found = reconstructed(s, values_of(unknowns, faults, own, sizes))
    return np.broadcast_to(found, (len(s.outputs), len(own), len(s.time)))


def linearised(
    s: Signals, unknowns: Sequence[Unknown], faults: Sequence[SensorFault], own: np.ndarray, sizes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs ``(m, N)`` and their slopes ``(m, N, n + k)``: one-sided differences for a record's own, central ones for faults.

    Rows are gone through channel by channel, so that what a channel does not touch is computed once for all its rows.
    """
    n, k = len(unknowns), len(faults)
    step = np.array([item.step for item in unknowns] + [difference_step(fault) for fault in faults])
    centre = np.concatenate([own, sizes])
    y = evaluate(s, unknowns, faults, own[None], sizes[None])[:, 0]
    slope = np.empty((len(s.outputs), len(s.time), n + k))
    sides = [item.key[0] if item.key[0] != "start" else "" for item in unknowns] + [fault.channel for fault in faults]
    for channel in dict.fromkeys(sides):
        at = np.array([i for i, side in enumerate(sides) if side == channel])
        moved = np.repeat(centre[None], 2 * len(at), axis=0)
        moved[np.arange(len(at)), at] += step[at]
        behind = at >= n
        moved[len(at) + np.flatnonzero(behind), at[behind]] -= step[at[behind]]
        both = evaluate(s, unknowns, faults, moved[:, :n], moved[:, n:])
        width = np.where(behind, 2.0, 1.0) * step[at]
        slope[:, :, at] = ((both[:, : len(at)] - both[:, len(at) :]) / width[:, None]).transpose(0, 2, 1)
    return y, slope
