"""A short period written for itself, with a recorder whose faults are put in afterwards; shares
nothing with the simulator.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ident.recording.series import Expectations
from sim.record import Channel, Record

UNITS = {
    "elevator": "rad",
    "alpha": "rad",
    "q": "rad/s",
    "nz": "g",
    "theta": "rad",
    "airspeed": "m/s",
    "altitude": "m",
}
G0 = 9.80665
FINE = 10  # steps of the simulation between two rows


@dataclass(frozen=True)
class Aircraft:
    """Dimensional derivatives: Z_alpha, M_alpha, M_q, M_delta, and the lift of the elevator;
    airspeed, m/s.
    """

    lift: float = 1.1
    stiffness: float = -6.0
    damping: float = -1.8
    power: float = -7.0
    elevator_lift: float = 0.08
    airspeed: float = 110.0

    @property
    def expected(self) -> Expectations:
        return Expectations(self.airspeed, G0, 0.8 * self.power, True)


SIGMAS = {"alpha": 0.0015, "q": 0.003, "nz": 0.015, "theta": 0.001, "airspeed": 0.3}


def drawn(rng: np.random.Generator) -> Aircraft:
    """An aircraft between a light trainer and a transport."""
    frequency, damping = rng.uniform(1.2, 4.5), rng.uniform(0.3, 0.8)
    lift = rng.uniform(0.5, 1.3) * damping * frequency
    rate = -(2.0 * damping * frequency - lift)
    return Aircraft(
        lift,
        -(frequency**2) - lift * -rate,
        rate,
        -rng.uniform(3.0, 15.0),
        rng.uniform(0.0, 0.15),
        rng.uniform(50.0, 230.0),
    )


def maneuver(kind: str, time: np.ndarray, size: float, unit: float) -> np.ndarray:
    """An elevator, rad: ``3211``, ``doublets``, ``sweep``, ``steps`` or ``rest``."""
    if kind == "3211":
        edges, signs = np.cumsum([1.0, 3.0 * unit, 2.0 * unit, unit, unit]), (1.0, -1.0, 1.0, -1.0)
        first = sum(
            sign * ((time >= a) & (time < b))
            for sign, a, b in zip(signs, edges[:-1], edges[1:], strict=True)
        )
        return np.asarray(size * first)
    if kind == "doublets":
        phase = np.mod(time - 1.0, 9.0 * unit + 1.5)
        return size * np.where(
            time < 1.0,
            0.0,
            np.where(phase < 1.5 * unit, 1.0, np.where(phase < 3.0 * unit, -1.0, 0.0)),
        )
    if kind == "sweep":
        return (
            size
            * np.sin(2.0 * math.pi * (0.15 * time + 0.5 * 0.9 * time**2 / time[-1]))
            * (time > 0.5)
        )
    if kind == "steps":
        return size * np.sign(np.sin(2.0 * math.pi * time / (8.0 * unit))) * (time > 1.0)
    return np.zeros(len(time))


def flight(
    rng: np.random.Generator | None = None,
    aircraft: Aircraft | None = None,
    kind: str = "3211",
    rate: float = 50.0,
    duration: float = 16.0,
    size: float = 0.03,
    outputs: tuple[str, ...] = ("alpha", "q", "nz"),
    noise: float = 1.0,
    offsets: dict[str, float] | None = None,
    gust: float = 0.0,
) -> Record:
    """A record of a maneuver; nz about 1. ``noise`` multiplies ``SIGMAS``; ``offsets`` by channel;
    ``gust``: its angle's standard deviation, rad.
    """
    aircraft = aircraft or Aircraft()
    time = np.arange(round(duration * rate) + 1) / rate
    elevator = maneuver(kind, time, size, min(1.0, 1.6 / math.sqrt(-aircraft.stiffness)))
    states = _flown(aircraft, elevator, 1.0 / rate, _gusts(rng, len(time), rate, gust))
    columns = {"elevator": elevator, **states, "airspeed": np.full(len(time), aircraft.airspeed)}
    channels = []
    for name in outputs:
        values = columns[name] + (offsets or {}).get(name, 0.0)
        if rng is not None:
            values = values + noise * SIGMAS[name] * rng.standard_normal(len(time))
        channels.append(Channel.of(name, UNITS[name], values))
    return Record(
        time, (Channel.of("elevator", "rad", elevator),), tuple(channels), name="flight.csv"
    )


@dataclass(frozen=True)
class Controller:
    """elevator = angle alpha + rate q + attitude theta + the stick behind a filter, through an
    actuator of 0.05 s.

    ``inertial``: the angle is that of the aircraft's own motion, which a gust moves late, not that
    of the vane.
    """

    angle: float = 0.8
    rate: float = 0.3
    attitude: float = 0.0
    filter: float = 0.4
    inertial: bool = True


def controlled(
    rng: np.random.Generator,
    aircraft: Aircraft,
    law: Controller,
    kind: str = "3211",
    rate: float = 50.0,
    duration: float = 16.0,
    size: float = 0.03,
    noise: float = 1.0,
    gust: float = 0.0,
    vane: tuple[float, float] = (1.0, 0.0),
) -> Record:
    """A record of an aircraft that a controller flies: the stick moves as ``kind`` says; ``vane``
    has a scale and a lag, s.
    """
    count, h = round(duration * rate) + 1, 1.0 / rate / FINE
    time = np.arange(count) / rate
    alpha = q = theta = deflection = stick = felt = 0.0
    rows = []
    commands, gusts = (
        maneuver(kind, time, size, 1.0).tolist(),
        _gusts(rng, count, rate, gust).tolist(),
    )
    for command, w in zip(commands, gusts, strict=True):
        load = 1.0 + aircraft.airspeed / G0 * (
            aircraft.lift * (alpha + w) + aircraft.elevator_lift * deflection
        )
        rows.append((felt if vane[1] else alpha + w, q, load, deflection))
        for _ in range(FINE):
            flow = alpha + w
            stick += h * (command - stick) / law.filter
            asked = (
                law.angle * (alpha if law.inertial else flow)
                + law.rate * q
                + law.attitude * theta
                + stick
            )
            deflection += h * (asked - deflection) / 0.05
            turning = aircraft.stiffness * flow + aircraft.damping * q + aircraft.power * deflection
            alpha, q, theta = (
                alpha + h * (q - aircraft.lift * flow - aircraft.elevator_lift * deflection),
                q + h * turning,
                theta + h * q,
            )
            felt += h * (alpha + w - felt) / max(vane[1], h)
    columns = dict(zip(("alpha", "q", "nz", "elevator"), np.array(rows).T, strict=True))
    columns["alpha"] = vane[0] * columns["alpha"]
    outputs = [
        Channel.of(n, UNITS[n], columns[n] + noise * SIGMAS[n] * rng.standard_normal(count))
        for n in ("alpha", "q", "nz")
    ]
    return Record(
        time,
        (Channel.of("elevator", "rad", columns["elevator"]),),
        tuple(outputs),
        name="controlled.csv",
    )


def _gusts(rng: np.random.Generator | None, count: int, rate: float, gust: float) -> np.ndarray:
    out = np.zeros(count)
    if rng is None or gust == 0.0:
        return out
    keep = math.exp(-1.0 / rate)
    for k in range(1, count):
        out[k] = keep * out[k - 1] + gust * math.sqrt(1.0 - keep**2) * rng.standard_normal()
    return out


def _flown(
    a: Aircraft, elevator: np.ndarray, step: float, gusts: np.ndarray
) -> dict[str, np.ndarray]:
    """Heun's method in small steps, the elevator held; the vane reads the gust."""
    alpha = q = theta = 0.0
    h, rows = step / FINE, []
    for de, gust in zip(elevator.tolist(), gusts.tolist(), strict=True):
        rows.append(
            (
                alpha + gust,
                q,
                1.0 + a.airspeed / G0 * (a.lift * (alpha + gust) + a.elevator_lift * de),
                theta,
            )
        )
        for _ in range(FINE):
            da, dq = (
                q - a.lift * (alpha + gust) - a.elevator_lift * de,
                a.stiffness * (alpha + gust) + a.damping * q + a.power * de,
            )
            a2, q2 = alpha + h * da, q + h * dq
            da2, dq2 = (
                q2 - a.lift * (a2 + gust) - a.elevator_lift * de,
                a.stiffness * (a2 + gust) + a.damping * q2 + a.power * de,
            )
            theta += 0.5 * h * (q + q2)
            alpha, q = alpha + 0.5 * h * (da + da2), q + 0.5 * h * (dq + dq2)
    columns = np.array(rows).T
    return dict(zip(("alpha", "q", "nz", "theta"), columns, strict=True))


def fall(
    rng: np.random.Generator | None = None,
    rate: float = 10.0,
    duration: float = 30.0,
    sigma: float = 6.0,
) -> Record:
    """The height of a body that falls through thickening air."""
    time = np.arange(round(duration * rate) + 1) / rate
    height, speed, out = 12_000.0, -300.0, []
    for _ in time:
        out.append(height)
        for _ in range(FINE):
            drag = 0.5 * 1.225 * math.exp(-height / 7160.0) * speed**2 / 1200.0
            speed += (drag - 9.8) / rate / FINE
            height += speed / rate / FINE
    values = np.array(out)
    if rng is not None:
        values = values + sigma * rng.standard_normal(len(time))
    return Record(time, (), (Channel.of("altitude", "m", values),), name="fall.csv")


def altered(record: Record, **changes: Callable[[np.ndarray], np.ndarray]) -> Record:
    """The record with functions of some channels' values in their place (NaN a missing sample),
    ``time`` among them.
    """

    def of(channel: Channel) -> Channel:
        return (
            Channel.of(channel.name, channel.unit, changes[channel.name](channel.with_gaps()))
            if channel.name in changes
            else channel
        )

    time = changes["time"](record.time) if "time" in changes else record.time
    return replace(
        record,
        time=time,
        inputs=tuple(map(of, record.inputs)),
        outputs=tuple(map(of, record.outputs)),
    )


def exchanged(record: Record, first: str, second: str) -> Record:
    """The record with two channels' values under each other's names."""
    a, b = record[first].values, record[second].values
    return altered(record, **{first: lambda _: b, second: lambda _: a})


def rounded(record: Record, **bits: float) -> Record:
    """Channels on the grid of a converter with these least bits."""
    return altered(
        record, **{name: lambda v, bit=bit: bit * np.round(v / bit) for name, bit in bits.items()}
    )
