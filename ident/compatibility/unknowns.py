"""Unknowns of each record, and what the sensors should read for values of them and of sensor faults, with slopes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.compatibility.faults import BIAS, DELAY, LAG, SCALE, SensorFault
from ident.compatibility.kinematics import reconstructed
from ident.compatibility.signals import Signals

Key = tuple[str, str]
_SPEED = 0.015  # share by which an airspeed that is not recorded may be off: it divides the load as a scale does


@dataclass(frozen=True)
class Unknown:
    """A quantity of one record that every fit leaves free: its key, the size of a step to differentiate, and a prior sigma (infinite: none)."""

    key: Key
    step: float
    prior: float = float("inf")


def unknowns_of(s: Signals) -> tuple[Unknown, ...]:
    """Starts of the states; biases that the relations need; without theta two numbers for gravity's turn; without an airspeed how far
    the given one is off; where nz jumps with an input, by how much its integral may be off.
    """
    out = [Unknown(("start", name), 1e-3) for name in s.outputs]
    if "theta" in s.outputs:
        out.append(Unknown(("q", BIAS), 1e-4))
    if "alpha" in s.outputs:
        out.append(Unknown(("nz", BIAS), 1e-3))
        if "airspeed" not in s.channels:
            out.append(Unknown(("nz", SCALE), 1e-3, _SPEED))
        if "theta" not in s.channels:
            out += [Unknown(("turn", "1"), 1e-3, 0.2), Unknown(("turn", "2"), 1e-2, 0.5)]
        if s.jumps.size:
            out.append(Unknown(("jump", "nz"), 1e-2, 1.0))
    if "airspeed" in s.outputs:
        out.append(Unknown(("ax", BIAS), 1e-3))
    return tuple(out)


def start_of(s: Signals, unknowns: Sequence[Unknown]) -> np.ndarray:
    """First values: states as they are first measured, nz incremental or total, whichever is nearer."""
    out = np.zeros(len(unknowns))
    for i, item in enumerate(unknowns):
        channel, kind = item.key
        if channel == "start":
            row = s.outputs.index(kind)
            out[i] = float(np.median(s.channels[kind][np.flatnonzero(s.valid[row])[:5]])) if np.any(s.valid[row]) else 0.0
        elif item.key == ("nz", BIAS):
            level = float(np.mean(s.channels["nz"]))
            out[i] = level if "theta" not in s.channels else (0.0 if level > 0.5 else -1.0)
    return out


def evaluate(s: Signals, unknowns: Sequence[Unknown], faults: Sequence[SensorFault], own: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Outputs for rows of values: ``own (P, n)``, ``sizes (P, k)`` to ``(m, P, N)``."""
    table = {item.key: own[:, i : i + 1] for i, item in enumerate(unknowns)}
    for j, fault in enumerate(faults):
        key = (fault.channel, fault.kind)
        table[key] = table[key] + sizes[:, j : j + 1] if key in table else sizes[:, j : j + 1]
    none = np.zeros((1, 1))
    return reconstructed(s, lambda channel, kind: table.get((channel, kind), none))


def difference_step(fault: SensorFault) -> float:
    """Step of a central difference; a lag's and a delay's are felt over several samples."""
    return 0.004 if fault.kind in (DELAY, LAG) else 1e-3 * fault.plausible


def linearised(
    s: Signals, unknowns: Sequence[Unknown], faults: Sequence[SensorFault], own: np.ndarray, sizes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs ``(m, N)`` and their slopes ``(m, N, n + k)`` in one call: one-sided differences for a record's own, central ones for faults."""
    n, k = len(unknowns), len(faults)
    step = np.array([item.step for item in unknowns] + [difference_step(fault) for fault in faults])
    centre = np.concatenate([own, sizes])
    points = np.concatenate([centre[None], centre + np.diag(step), (centre - np.diag(step))[n:]])
    y = np.broadcast_to(evaluate(s, unknowns, faults, points[:, :n], points[:, n:]), (len(s.outputs), n + 2 * k + 1, len(s.time)))
    slope = np.empty((len(s.outputs), n + k, len(s.time)))
    slope[:, :n] = (y[:, 1 : n + 1] - y[:, :1]) / step[:n, None]
    slope[:, n:] = (y[:, n + 1 : n + k + 1] - y[:, n + k + 1 :]) / (2.0 * step[n:, None])
    return y[:, 0], slope.transpose(0, 2, 1)
