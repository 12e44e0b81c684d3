"""What the channels of one motion have to do with each other, without aerodynamics: how well a reading of the columns fits.

Over a lag h of about half the motion's rhythm, alpha(t + h) - alpha(t) = int (q - (g/V) (nz - nz_0)) dt and theta(t + h) - theta(t) = int q dt.
Without nz the lift is a multiple of alpha (Z alpha, Z > 0); without alpha a change of nz is one of alpha (k > 0). A difference over a lag
forgets biases and drifts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ident.recording.finding import Expectations
from sim.maths import G0
from sim.record import Record

JOINED = ("alpha", "q", "nz", "theta")
SLOWEST, FASTEST = 20.0, 400.0  # m/s, where the airspeed is not known
STIFFEST = 10.0  # 1/s: no aircraft's lift damps its angle of attack faster
FEWEST = 40  # rows
LONGEST = 3000  # rows that a comparison looks at
HALF = 0.5  # autocorrelation at which a lag is half a rhythm
FLOOR = 1e-30
SPARSE = 2  # rows of a lag for a row between two samples of a channel: with fewer, straight lines between them are not the motion
SHIFTS = (0.0, 0.05, 0.1, 0.2)  # s: delays and lags of sensors
LATE = 0.3  # s: delays, lags, and arms over the airspeed, which are effects of their own


@dataclass(frozen=True, eq=False)
class Columns:
    """Channels as arrays on one time base, gaps bridged and lone wrong samples taken out, ``(N,)`` each; ``control`` is held between samples."""

    time: np.ndarray
    outputs: Mapping[str, np.ndarray]
    control: np.ndarray | None
    control_name: str
    gravity_over_speed: float | None

    def times(self, factors: Mapping[str, float]) -> Columns:
        """The same with some channels multiplied; ``control`` and ``time`` are names, too."""
        outputs = {name: values * factors.get(name, 1.0) for name, values in self.outputs.items()}
        control = None if self.control is None else self.control * factors.get(self.control_name, 1.0)
        return replace(self, time=self.time * factors.get("time", 1.0), outputs=outputs, control=control)

    def exchanged(self, first: str, second: str) -> Columns:
        """The same with two channels in each other's place."""
        held = dict(self.outputs)
        if self.control is not None and self.control_name in (first, second):
            other = second if first == self.control_name else first
            control, held[other] = held[other], self.control
            return replace(self, outputs=held, control=control)
        held[first], held[second] = held[second], held[first]
        return replace(self, outputs=held)


def columns_of(record: Record, expected: Expectations) -> Columns | None:
    """The channels that one motion joins; None where they are fewer than two or too short. ``az`` stands for nz as -az/g0."""
    if len(record) < FEWEST:
        return None
    rows = slice(0, LONGEST)
    outputs = {name: _bridged(record, name)[rows] for name in JOINED if name in record.output_names}
    if "nz" not in outputs and "az" in record.output_names:
        outputs["nz"] = -_bridged(record, "az")[rows] / G0
    if len(outputs) < 1:
        return None
    control = record.inputs[0] if record.inputs else None
    known = [np.flatnonzero(record[name].valid) for name in (*JOINED, "az") if name in record.output_names]
    sparse = max(int(np.median(np.diff(rows))) if len(rows) > 1 else len(record) for rows in known)
    over = expected.gravity / expected.airspeed if expected.airspeed else _from_record(record, expected.gravity)
    values = control.values[rows] if control is not None else None
    columns = Columns(record.time[rows], outputs, values, control.name if control is not None else "", over)
    return columns if sparse * SPARSE <= lag_of(columns) else None


def disagreement(columns: Columns) -> dict[str, float]:
    """For each relation the share of its power that it does not explain: 0 where it holds, 1 where its sides are unrelated, up to 2."""
    lag = lag_of(columns)
    sides = relations(columns, lag)
    along = change(columns.outputs["q"], lag) if sides else np.zeros(0)
    return {name: _share(left, right, along - np.mean(along)) for name, (left, right) in sides.items()}


def relations(columns: Columns, lag: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Both sides of every relation that the columns allow, about their means, shape ``(N - lag,)``."""
    y = columns.outputs
    moved = {name: change(values, lag) for name, values in y.items()}
    sums = {name: change(integral(columns.time, values - np.mean(values)), lag) for name, values in y.items()}
    out = {}
    if "q" in y and "alpha" in y:
        if "nz" in y:
            over = columns.gravity_over_speed
            factor = over if over is not None else float(np.clip(_slope(sums["nz"], sums["q"] - moved["alpha"]), 9.8 / FASTEST, 9.8 / SLOWEST))
            out["alpha"] = (moved["alpha"], sums["q"] - factor * sums["nz"])
        else:
            steep = float(np.clip(_slope(sums["alpha"], sums["q"] - moved["alpha"]), 0.0, STIFFEST))
            out["alpha"] = (moved["alpha"], sums["q"] - steep * sums["alpha"])
    elif "q" in y and "nz" in y and columns.gravity_over_speed is not None:
        rate = sums["q"] - columns.gravity_over_speed * sums["nz"]
        out["nz"] = (moved["nz"], max(_slope(rate, moved["nz"]), 0.0) * rate)
    if "q" in y and "theta" in y:
        out["theta"] = (moved["theta"], sums["q"])
    return {name: (left - np.mean(left), right - np.mean(right)) for name, (left, right) in out.items()}


def unexplained_lift(columns: Columns) -> tuple[float, float] | None:
    """Share of the load's change that lift leaves, and the number of independent stretches it is seen in; None without alpha or nz.

    nz - nz_0 = a alpha + b delta with a >= |b|: lift rises with the angle of attack, and a surface, which is a part of the wing's or
    the tail's area, makes less of it per radian than the whole aircraft. Integrals over a lag are compared, since they average the
    noise of both sides. Either side may be late by up to ``SHIFTS``.
    """
    y = columns.outputs
    if not {"alpha", "nz"} <= set(y):
        return None
    lag, step = lag_of(columns), float(np.median(np.diff(columns.time)))
    control = np.zeros(len(columns.time)) if columns.control is None else columns.control
    load, flow, surface = (change(integral(columns.time, values - np.mean(values)), lag) for values in (y["nz"], y["alpha"], control))
    shifts = sorted({min(round(late / step), len(load) // 4) for late in SHIFTS})
    pairs = [(load[: len(load) - k], flow[k:], surface[: len(load) - k]) for k in shifts]
    pairs += [(load[k:], flow[: len(load) - k], surface[: len(load) - k]) for k in shifts]
    return min(_share_of_lift(*each) for each in pairs), len(load) / lag


def _share_of_lift(load: np.ndarray, flow: np.ndarray, surface: np.ndarray) -> float:
    """What the best lift leaves of a load: of sums and differences of both angles with factors that are not negative."""
    load, flow, surface = (values - np.mean(values) for values in (load, flow, surface))
    power = float(load @ load)
    if power <= FLOOR:
        return 0.0
    both = np.stack([flow + surface, flow - surface])
    gram, right = both @ both.T, both @ load
    single = [right[i] ** 2 / gram[i, i] if right[i] > 0.0 and gram[i, i] > FLOOR else 0.0 for i in range(2)]
    explained = max(single)
    if np.linalg.det(gram) > FLOOR * max(gram[0, 0] * gram[1, 1], FLOOR):
        factors = np.linalg.solve(gram, right)
        explained = float(factors @ right) if np.all(factors > 0.0) else explained
    return max(1.0 - explained / power, FLOOR)


def lag_of(columns: Columns) -> int:
    """Rows over which the motion changes most of what it changes at once: where its autocorrelation has halved."""
    name = next((name for name in ("q", "alpha", "nz", "theta") if name in columns.outputs), None)
    if name is None:
        return 1
    values = columns.outputs[name] - np.mean(columns.outputs[name])
    most = max(3, min(len(values) // 8, 300))
    first = float(values[:-1] @ values[1:]) / (len(values) - 1)
    return next((lag for lag in range(2, most) if float(values[:-lag] @ values[lag:]) / (len(values) - lag) < HALF * first), most - 1)


def _share(left: np.ndarray, right: np.ndarray, along: np.ndarray) -> float:
    """What is left, over the power of both sides, once a late or an offset sensor (a multiple of the change of ``along``) is allowed for."""
    power = float(left @ left + right @ right)
    if power <= FLOOR:
        return 0.0
    off = left - right
    off = off - float(np.clip(_slope(along, off), -LATE, LATE)) * along
    return float(off @ off) / power


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    x, y = x - np.mean(x), y - np.mean(y)
    power = float(x @ x)
    return float(x @ y) / power if power > FLOOR else 0.0


def change(values: np.ndarray, lag: int) -> np.ndarray:
    return np.asarray(values[lag:] - values[:-lag])


def integral(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))])


def _bridged(record: Record, name: str) -> np.ndarray:
    channel = record[name]
    values = np.interp(record.time, record.time[channel.valid], channel.values[channel.valid])
    before, here, after = values[:-2], values[1:-1], values[2:]
    middle = np.maximum(np.minimum(before, here), np.minimum(np.maximum(before, here), after))
    return np.concatenate([values[:1], middle, values[-1:]])


def _from_record(record: Record, gravity: float) -> float | None:
    if "airspeed" not in record.output_names:
        return None
    speed = float(np.median(record["airspeed"].values[record["airspeed"].valid]))
    return gravity / speed if speed > SLOWEST else None
