"""Measured airspeed and dynamic pressure as recorded inputs of the equations, through the ports on which a change of speed acts.

With V(t) and qbar(t) the coefficients rho V S/(2 m), rho V^2 S c/(2 Iy) and c/(2 V) of the equations follow the flight. The lift that carries
the weight grows with the pressure as well: about level flight at the record's beginning alpha_dot gets -(g0/V) (qbar/qbar_0 - 1)
and nz (qbar/qbar_0 - 1), which is the lift coefficient m g0/S (1/qbar_0 - 1/qbar).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from scenarios.files.own_models import is_own
from scenarios.preparation.plan import DENSITY, LIFT, SPEED
from sim.declaration.effect import Signal
from sim.declaration.model import Model
from sim.errors import RecordError
from sim.maths import G0
from sim.record import Channel, Hold, Record

MEASURED = ("airspeed", "dynamic_pressure")
WINDOW = 1.0  # s, of the weights that smooth a measured speed: the short period is faster, the speed slower
DESPIKED = 9.0  # medians of the distance from the neighbours' median
BEGINNING = 0.5  # s, over which the trim's pressure is the mean
APART = 0.1  # of the declared airspeed or density, from which a word is due


@dataclass(frozen=True)
class Flow:
    """Airspeed (m/s) and air density (kg/m3; None: the declared one) along a record, shape ``(N,)``."""

    speed: np.ndarray
    density: np.ndarray | None


def able(model: Model) -> tuple[str, ...]:
    """Which of ``MEASURED`` the model's equations can use; none that a user's own does not declare itself."""
    ports = {port.name for port in model.equations.ports}
    if is_own(model) or not {SPEED, LIFT} <= ports or "airspeed" not in model.parameters:
        return ()
    return MEASURED if DENSITY in ports else MEASURED[:1]


def without_flow(record: Record) -> Record:
    """The record less its measured airspeed and pressure, which are no outputs of a model."""
    if not any(name in record.output_names for name in MEASURED):
        return record
    return replace(record, outputs=tuple(channel for channel in record.outputs if channel.name not in MEASURED))


def with_flow(model: Model, records: Sequence[Record], *, weight: bool = True) -> tuple[Model, list[Record]]:
    """The model with the measured flow as further inputs, and the records that carry them; unchanged where no record measures one.

    A record without flies at the declared speed. With ``weight`` the lift that carries the weight follows the pressure;
    without, perturbations are about a trim at every speed.

    Raises
    ------
    RecordError : an airspeed or a pressure that is not above zero.
    """
    if any(signal.name in MEASURED for signal in model.equations.outputs):
        return model, list(records)
    flows = [measured_flow(record, model) for record in records]
    if all(flow is None for flow in flows):
        return model, [without_flow(record) for record in records]
    has_density = any(flow is not None and flow.density is not None for flow in flows)
    names = [SPEED, *([DENSITY] if has_density else []), *([LIFT] if weight else [])]
    ports = {port.name: port for port in model.equations.ports}
    added = tuple(Signal(name, ports[name].unit, f"recorded: {ports[name].meaning}") for name in names)
    equations: Any = model.equations
    wider = replace(model, equations=replace(equations, inputs=(*equations.inputs, *added)))
    return wider, [_carrying(record, flow, model, added) for record, flow in zip(records, flows, strict=True)]


def measured_flow(record: Record, model: Model) -> Flow | None:
    """Speed and density from what the record measures, wrong samples and gaps bridged, smoothed; None where it measures nothing."""
    usable = [name for name in able(model) if name in record.output_names]
    if not usable:
        return None
    found = {name: _smooth(record, record[name]) for name in usable}
    if "airspeed" not in found:
        return Flow(np.sqrt(2.0 * found["dynamic_pressure"] / model.parameters["air_density"].value), None)
    speed = found["airspeed"]
    return Flow(speed, 2.0 * found["dynamic_pressure"] / speed**2 if "dynamic_pressure" in found else None)


def flow_sentence(record: Record, model: Model) -> str:
    """What the measured flow is and how far from the declared one; empty where none is measured."""
    flow = measured_flow(record, model)
    if flow is None:
        return ""
    declared = model.parameters["airspeed"].value
    used = " and ".join(name for name in able(model) if name in record.output_names).replace("_", " ")
    speed = "" if "airspeed" in used else "which makes "
    return f"{record.name}: measured {used} used, {speed}{flow.speed.min():.4g} to {flow.speed.max():.4g} m/s (declared {declared:.4g} m/s)"


def flow_doubts(records: Sequence[Record], model: Model) -> list[str]:
    """Where measured airspeed or air density are far from those of the vehicle file: what, in which records, and how to mend it."""
    flows = [(record.name, flow) for record in records if (flow := measured_flow(record, model)) is not None]
    speeds = {name: float(np.mean(flow.speed)) for name, flow in flows}
    densities = {name: float(np.mean(flow.density)) for name, flow in flows if flow.density is not None}
    from_pressure = bool(flows) and not any("airspeed" in record.output_names for record in records)
    told = []
    if far := _far(speeds, model, "airspeed"):
        what = "the airspeed that the measured dynamic pressure makes with the declared air" if from_pressure else "the measured airspeed"
        mend = "airspeed or air_density" if from_pressure else "airspeed"
        cause = "unit of the dynamic pressure" if from_pressure else "unit of the column and whether it is a true airspeed"
        meant = "natural frequency and damping are those at that speed"
        apart = f"{far[0]}: {what}, {far[1]} m/s, is far from {far[2]} m/s in the vehicle file"
        told.append(f"{apart}: {meant}; mend {mend} there, or check the {cause}")
    if far := _far(densities, model, "air_density"):
        what = f"the air density that measured pressure and airspeed make, {far[1]} kg/m3, is far from {far[2]} kg/m3 in the vehicle file"
        told.append(f"{far[0]}: {what}; mend air_density there, or check whether the airspeed is a true one")
    return told


def _far(means: Mapping[str, float], model: Model, name: str) -> tuple[str, str, str] | None:
    """Records whose mean is more than ``APART`` off the declared value, their means, and the declared one; None where all are near."""
    if not means:
        return None
    declared = model.parameters[name].value
    found = {record: mean for record, mean in means.items() if abs(mean / declared - 1.0) > APART}
    if not found:
        return None
    shown = list(dict.fromkeys(f"{mean:.3g}" for mean in (min(found.values()), max(found.values()))))
    return ", ".join(found), " to ".join(shown), f"{declared:.3g}"


def _carrying(record: Record, flow: Flow | None, model: Model, added: Sequence[Signal]) -> Record:
    p, n = model.parameters, len(record)
    speed0 = p["airspeed"].value
    flow = flow or Flow(np.full(n, speed0), None)
    air = p["air_density"].value if "air_density" in p else 1.0
    density = flow.density if flow.density is not None else np.full(n, air)
    pressure = 0.5 * density * flow.speed**2
    resting = pressure[: max(1, int(np.searchsorted(record.time, record.time[0] + BEGINNING)))]
    level = float(np.mean(resting))
    if "mass" in p and "wing_area" in p:
        lift = p["mass"].value * G0 / p["wing_area"].value * (1.0 / level - 1.0 / pressure)
    else:  # a dimensional lift is a rate of the angle of attack
        lift = -p["gravity"].value / flow.speed * (pressure / level - 1.0)
    rows = {SPEED: flow.speed - speed0, DENSITY: density - air, LIFT: lift}
    inputs = tuple(Channel.of(signal.name, signal.unit, held(rows[signal.name], record.hold)) for signal in added)
    return replace(without_flow(record), inputs=(*record.inputs, *inputs))


def held(values: np.ndarray, hold: Hold) -> np.ndarray:
    """Samples that stand for straight lines between ``values``: where inputs are held, the mean over each interval."""
    return values if hold is Hold.LINEAR else np.append(0.5 * (values[:-1] + values[1:]), values[-1])


def _smooth(record: Record, channel: Channel) -> np.ndarray:
    known = channel.valid.copy()
    known[known] = ~_spikes(channel.values[known])
    time, step = record.time, float(np.median(np.diff(record.time)))
    grid = np.linspace(time[0], time[-1], max(2, 1 + round((time[-1] - time[0]) / step)))
    even = np.interp(grid, time[known], channel.values[known])
    half = min(round(0.5 * WINDOW / step), len(even) - 1)
    if half > 0:
        # Beyond its ends the signal goes on as the line through its first and its last window does.
        before, behind = np.arange(-half, 0), np.arange(1, half + 1)
        ends = _line(even[: 2 * half + 1], before), _line(even[::-1][: 2 * half + 1], -behind)
        weights = np.hanning(2 * half + 3)[1:-1]
        even = np.convolve(np.concatenate([ends[0], even, ends[1]]), weights / weights.sum(), mode="valid")
    values = np.interp(time, grid, even)
    if not np.all(values > 0.0):
        at = float(time[int(np.argmax(values <= 0.0))])
        remedy = "leave the column out, or cut the record there with --from and --to"
        raise RecordError(f"{channel.name} is not above zero at {at:g} s", where=f"{record.name}, channel {channel.name}", remedy=remedy)
    return np.asarray(values)


def _line(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The straight line through ``values`` at their positions 0, 1, ..., at other positions."""
    slope, level = np.polyfit(np.arange(len(values)), values, 1)
    return np.asarray(level + slope * at)


def _spikes(values: np.ndarray) -> np.ndarray:
    """Samples that a median over their four neighbours and themselves does not explain."""
    if len(values) < 7:
        return np.zeros(len(values), dtype=bool)
    padded = np.concatenate([values[2:0:-1], values, values[-2:-4:-1]])
    away = np.abs(values - np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1))
    return np.asarray(away > max(DESPIKED * float(np.median(away)), 1e-3 * float(np.median(np.abs(values)))))
