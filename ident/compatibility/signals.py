"""A record made ready for the kinematics: gaps bridged, relations found, what is not recorded stated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ident.statistics.robust import robust_sigma
from sim.maths import G0
from sim.record import Hold, Record

EDGE = 0.1  # s at both ends of a record that no residual counts: a late channel has nothing to show there
CHANNELS = ("alpha", "q", "nz", "az", "theta", "airspeed", "ax")
SPIKE = 8.0  # robust sigmas
LEAST_SPIKE = 0.03  # of a channel's range


@dataclass(frozen=True, eq=False)
class Signals:
    """Channels of a record over ``time (N,)``, s.

    Attributes
    ----------
    name : the record's. channels : those that a relation uses, ``(N,)`` each, gaps bridged by straight lines.
    outputs : states whose measurement is compared with their reconstruction. valid : ``(m, N)`` samples that count.
    speed : ``(N,)`` m/s, measured or the constant. gravity : m/s2.
    vane_arm : m, known beforehand.
    jumps : ``(N,)`` g, about how far nz may have jumped at the held inputs' switches, summed up; empty without a held input.
    spikes : number of isolated wrong samples set aside, by channel.
    instruments : ``(N, L)``, what the recorded controls have moved (``ident.compatibility.instruments``); none where no control is recorded.
    """

    name: str
    time: np.ndarray
    channels: Mapping[str, np.ndarray]
    outputs: tuple[str, ...]
    valid: np.ndarray
    speed: np.ndarray
    gravity: float
    vane_arm: float
    jumps: np.ndarray
    spikes: Mapping[str, int]
    instruments: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))

    @property
    def steps(self) -> np.ndarray:
        return np.diff(self.time)

    @cached_property
    def instrument_differences(self) -> np.ndarray:
        """``differences`` of the instruments, for each output by itself and where it is measured: ``(N m, m L)``, the same whatever the noise."""
        return np.asfortranarray(differences(self.instruments_by_output))

    @property
    def instruments_by_output(self) -> np.ndarray:
        """Columns ``(m, N, m L)``: the instruments of each output by itself, zero where it is not measured."""
        (m, n), count = self.valid.shape, self.instruments.shape[1]
        wide = np.zeros((m, n, m * count))
        for i in range(m):
            wide[i, :, i * count : (i + 1) * count] = np.where(self.valid[i][:, None], self.instruments, 0.0)
        return wide


def relations(names: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Output of each kinematic relation that these channels close, and the channels that it joins."""
    have, out = set(names), {}
    if {"alpha", "q", "nz"} <= have:
        out["alpha"] = ("alpha", "q", "nz", *(["theta"] if "theta" in have else []))
    if {"theta", "q"} <= have:
        out["theta"] = ("theta", "q")
    if {"airspeed", "ax", "theta", "alpha", "q", "nz"} <= have:
        out["airspeed"] = ("airspeed", "ax", "theta", "alpha", "nz")
    return out


def signals_of(record: Record, channels: tuple[str, ...], airspeed: float | None, gravity: float, vane_arm: float = 0.0) -> Signals:
    """Make a record ready; ``channels`` are those common to all records. az serves as nz = -az/g0 where there is no nz."""
    raw, valid, spikes = {}, {}, {}
    for name in channels:
        values, there = _channel(record, name)
        wrong = isolated(record.time[there], values[there])
        spikes[name] = int(np.count_nonzero(wrong))
        there = there.copy()
        there[np.flatnonzero(there)[wrong]] = False
        raw[name], valid[name] = np.interp(record.time, record.time[there], values[there]), there
    found = relations(channels)
    used = {name for joined in found.values() for name in joined}
    edge = EDGE if record.time[-1] - record.time[0] > 50.0 * EDGE else 0.0
    inside = (record.time >= record.time[0] + edge) & (record.time <= record.time[-1] - edge)
    speed = raw["airspeed"] if "airspeed" in raw else np.full(len(record), airspeed if airspeed is not None else np.inf)
    return Signals(
        record.name,
        record.time,
        {name: raw[name] for name in channels if name in used or (name == "airspeed" and "alpha" in found)},
        tuple(found),
        np.array([valid[name] & inside for name in found]).reshape(len(found), len(record)),
        speed,
        gravity,
        vane_arm,
        _jumps(record, raw) if "alpha" in found else np.zeros(0),
        spikes,
    )


def measured_channels(record: Record) -> tuple[str, ...]:
    """Channels of a record that the kinematics know, az under nz."""
    have = set(record.output_names)
    names = [name for name in ("alpha", "q", "nz", "theta", "airspeed", "ax") if name in have or (name == "nz" and "az" in have)]
    return tuple(name for name in names if np.count_nonzero(_channel(record, name)[1]) > 1)


def _channel(record: Record, name: str) -> tuple[np.ndarray, np.ndarray]:
    if name == "nz" and "nz" not in record.output_names:
        return -record["az"].values / G0, record["az"].valid
    return record[name].values, record[name].valid


def isolated(t: np.ndarray, x: np.ndarray) -> np.ndarray:
    """True at single samples that neither the line before, nor the line behind, nor the neighbours' mean explains: a corner is no spike."""
    out = np.zeros(len(x), dtype=bool)
    if len(x) < 12:
        return out
    left, right = np.full(len(x), np.inf), np.full(len(x), np.inf)
    left[2:] = x[2:] - x[1:-1] - (x[1:-1] - x[:-2]) * (t[2:] - t[1:-1]) / (t[1:-1] - t[:-2])
    right[:-2] = x[:-2] - x[1:-1] - (x[2:] - x[1:-1]) * (t[:-2] - t[1:-1]) / (t[2:] - t[1:-1])
    away = np.full(len(x), np.inf)
    away[1:-1] = x[1:-1] - 0.5 * (x[2:] + x[:-2])
    least = np.min(np.abs([left, right, away]), axis=0)
    large = least > max(SPIKE * robust_sigma(np.where(np.isfinite(away), away, 0.0)), LEAST_SPIKE * float(np.ptp(x)))
    large[:2] = large[-2:] = False
    # A spike spoils what its neighbours are compared with; they are smaller.
    for i in np.flatnonzero(large):
        near = slice(max(i - 2, 0), i + 3)
        out[i] = least[i] == least[near].max()
    return out


def _jumps(record: Record, raw: Mapping[str, np.ndarray]) -> np.ndarray:
    """nz per unit of a held input by regression, times that input: where a load jumps between two samples no one sees when."""
    if record.hold is not Hold.PREVIOUS or not record.inputs:
        return np.zeros(0)
    u = np.array([channel.values - channel.values[0] for channel in record.inputs])
    size = np.abs(u).max(axis=1)
    u = u[size > 0] / size[size > 0, None]
    if not len(u):
        return np.zeros(0)
    columns = np.vstack([u, raw["alpha"] - raw["alpha"].mean(), raw["q"] - raw["q"].mean(), np.ones(len(record))]).T
    sizes, *_ = np.linalg.lstsq(columns / np.maximum(np.abs(columns).max(axis=0), 1e-12), raw["nz"], rcond=None)
    return np.asarray(sizes[: len(u)] @ u)


def differences(columns: np.ndarray) -> np.ndarray:
    """Differences of neighbouring samples of columns ``(m, N, c)``, the first sample itself; all outputs of a sample together: ``(N m, c)``."""
    m, n, c = columns.shape
    flat = np.empty((n, m, c))
    flat[0] = columns[:, 0]
    np.subtract(columns[:, 1:].transpose(1, 0, 2), columns[:, :-1].transpose(1, 0, 2), out=flat[1:])
    return flat.reshape(n * m, c)
