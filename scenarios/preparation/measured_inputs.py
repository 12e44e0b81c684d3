"""Measured channels as inputs of the equations: trim, load factors, airspeed, pitch attitude.

With V(t) and qbar(t) the coefficients rho V S/(2 m), rho V^2 S c/(2 Iy) and c/(2 V) of the
equations follow the flight. The trim lift, which balances the weight, grows with the pressure as
well: about level flight at the record's beginning alpha_dot gets -(g0/V) (qbar/qbar_0 - 1) and nz
(qbar/qbar_0 - 1), which is the lift coefficient m g0/S (1/qbar_0 - 1/qbar).

Pitch attitude is counted from its mean over the record's beginning, because a phugoid would need
its zero to one thousandth.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from ident.statistics.noise_levels import input_spikes
from scenarios.files.declarations import ColumnChoice
from scenarios.files.measured.columns import RecordFile
from scenarios.files.records import read_with_notes
from scenarios.files.user_models import is_own
from scenarios.preparation.plan import ATTITUDE, DENSITY, LIFT, SPEED
from sim.declaration.effect import Signal
from sim.declaration.model import Model, OfTotals
from sim.effects.disturbance.airspeed import Phugoid
from sim.effects.library import applies
from sim.errors import RecordError, instant
from sim.maths import G0
from sim.record import Channel, Hold, Record

# ---- What a measured record needs before it is fitted: inputs about their trim

REST_SHARE = 0.05  # share of an input's span; smaller motion is rest
SHORTEST_REST = 0.3  # s of rest at the beginning that a trim needs
OFFSET_SHARE = 0.1  # share of an input's span; a median closer to zero needs no trim
# channels in which a motion shows at once
QUICK = ("alpha", "q", "nz", "az", "beta", "p", "r", "ny", "ay")
# Largest change of a channel at rest, share of its scatter over the record.
STILL_SHARE = 0.3


def of_totals(model: Model) -> bool:
    """Return whether the equations describe total motion, not perturbations about a trim."""
    if isinstance(model.equations, OfTotals):
        return model.equations.totals
    return is_own(model) or any(state.name == "airspeed" for state in model.equations.states)


def about_trim(record: Record) -> tuple[Record, dict[str, float]]:
    """Return the record with inputs counted from trim, and the subtracted trims by input.

    The trim is the mean of the input before it first moves. Derivatives do not depend on it, since
    biases and initial states absorb it, but break-out, saturation and other nonlinearities do. An
    input that moves at once, or has a zero trim, is not changed.
    """
    trims: dict[str, float] = {}
    inputs = []
    for channel in record.inputs:
        level = _trim(record, channel.values)
        if level:
            trims[channel.name] = level
            channel = Channel.of(channel.name, channel.unit, channel.values - level)
        inputs.append(channel)
    return (replace(record, inputs=tuple(inputs)), trims) if trims else (record, trims)


def trim_sentence(record: Record, name: str) -> str:
    """Return the sentence if no trim of an input was found although it is not zero; else empty."""
    values, unit = record[name].values, record[name].unit
    middle = float(np.median(values))
    if abs(middle) <= OFFSET_SHARE * float(np.ptp(values)):
        return ""
    shown = f"{np.degrees(middle):.3g} deg" if unit == "rad" else f"{middle:.3g} {unit}"
    taken = (
        f"its zero is taken, though its middle is {shown}: break-out, stops and curves count from "
        "there"
    )
    return (
        f"{record.name}: no rest of the {name} at the beginning tells its trim; {taken}; begin at "
        "rest (--from)"
    )


def _trim(record: Record, values: np.ndarray) -> float:
    """Return the mean of an input before it first leaves the neighbourhood of its beginning; zero
    if it or the aircraft does not rest there.
    """
    time = record.time
    span = float(np.ptp(values))
    if span == 0.0:
        return 0.0
    start = float(np.median(values[: max(1, int(np.searchsorted(time, time[0] + SHORTEST_REST)))]))
    away = np.abs(values - start) > REST_SHARE * span
    until = int(np.argmax(away)) if np.any(away) else len(values)
    if until < 2 or time[until - 1] - time[0] < SHORTEST_REST:
        return 0.0
    # The last sample before the move may already be on its way.
    until = max(2, until - 1)
    # An aircraft that still settles is in trim all the same where the input rests there most of the
    # time, and at the end.
    usual = max(
        abs(float(np.median(some)) - start)
        for some in (values, values[int(np.searchsorted(time, time[-1] - SHORTEST_REST)) :])
    )
    if usual > REST_SHARE * span and any(
        _moves(channel, until) for channel in record.outputs if channel.name in QUICK
    ):
        return 0.0
    resting = values[:until]
    level = float(np.mean(resting))
    scatter = _scatter_of_mean(resting)
    return level if abs(level) > 3.0 * scatter and abs(level) > 1e-6 * span else 0.0


def _scatter_of_mean(values: np.ndarray) -> float:
    """Return the standard deviation of the mean: noise counts sample by sample, a smooth motion, as
    a sum of sines begins with, as one value.

    The share of noise is von Neumann's ratio of the steps' mean square to twice the variance.
    """
    variance = float(np.var(values))
    if variance == 0.0:
        return 0.0
    noise = min(1.0, 0.5 * float(np.mean(np.diff(values) ** 2)) / variance)
    return float(np.sqrt(variance / max(1.0, noise * len(values))))


def _moves(channel: Channel, until: int) -> bool:
    """Return whether a channel moves in its first samples, its noise left out: a maneuver that
    begins with a held step starts with the record.
    """
    first, every = channel.values[:until][channel.valid[:until]], channel.values[channel.valid]
    half = len(first) // 2
    return half > 0 and abs(
        float(np.mean(first[half:]) - np.mean(first[:half]))
    ) > STILL_SHARE * float(np.std(every))


# ---- Load factors from accelerometers

LARGEST_REST_LOAD = 1.5  # largest plausible ratio of a signal at rest to one g
# Load factor -> accelerometer that replaces it, and the sign between them.
ACCELEROMETERS: Mapping[str, tuple[str, float]] = MappingProxyType(
    {"nz": ("az", -1.0), "ny": ("ay", 1.0), "nx": ("ax", 1.0)}
)


def instead_of(outputs: Collection[str]) -> dict[str, str]:
    """Load factor -> accelerometer that is read where the load factor is not recorded, for a model
    with these outputs.
    """
    return {name: channel for name, (channel, _) in ACCELEROMETERS.items() if name in outputs}


def with_load_factors(record: Record, kept: Collection[str] = ()) -> tuple[Record, tuple[str, ...]]:
    """Return the record with accelerometers converted to load factors (g), and sentences on them.

    A recorded load factor has precedence. ``kept``: outputs whose accelerometers stay.

    Raises
    ------
    RecordError : az is that of inverted flight: most likely it is positive up in this file.
    """
    notes = []
    for name, (channel, sign) in ACCELEROMETERS.items():
        if channel not in record.output_names or name in record.output_names or channel in kept:
            continue
        force = record[channel]
        factor = Channel.of(name, "g", np.where(force.valid, sign * force.values / G0, np.nan))
        outputs = tuple(factor if each.name == channel else each for each in record.outputs)
        level = float(np.median(factor.values[factor.valid]))
        if name == "nz" and level < -1.0 / LARGEST_REST_LOAD:
            what = (
                f"the middle of az is {-G0 * level:+.3g} m/s2, but az is positive down: {-G0:.3g} "
                "m/s2 in level flight"
            )
            raise RecordError(
                what,
                where=f"{record.name}, channel az",
                remedy="turn its sign, or hand it over as nz if it is positive up",
            )
        record = replace(record, outputs=outputs)
        notes.append(f"{record.name}: {name} is {'-' if sign < 0.0 else ''}{channel}/{G0:g}")
    return record, tuple(notes)


# ---- Measured airspeed and dynamic pressure as recorded inputs of the equations

SPEED_NAME = "airspeed"
MEASURED = (SPEED_NAME, "dynamic_pressure")
# s, of the weights that smooth a measured speed: the short period is faster, the speed slower
SPEED_SMOOTHING_TIME = 1.0
SPIKE_MEDIANS = 9.0  # medians of the distance from the neighbours' median
TRIM_AVERAGING_TIME = 0.5  # s, over which the trim's pressure is the mean
NOTABLE_DIFFERENCE_SHARE = 0.1  # relative difference from the declared value


@dataclass(frozen=True)
class Flow:
    """Airspeed (m/s) and air density (kg/m3; None: the declared one) along a record, shape
    ``(N,)``.
    """

    speed: np.ndarray
    density: np.ndarray | None


def able(model: Model) -> tuple[str, ...]:
    """Members of ``MEASURED`` that the equations can use; for a user model only those that it
    declares.
    """
    ports = {port.name for port in model.equations.ports}
    if is_own(model) or not {SPEED, LIFT} <= ports or "airspeed" not in model.parameters:
        return ()
    return MEASURED if DENSITY in ports else MEASURED[:1]


def unused_airspeed(
    file: RecordFile,
    model: Model,
    channels: Mapping[str, ColumnChoice] | None,
    start: float | None = None,
    stop: float | None = None,
    rate: float | None = None,
) -> tuple[str, str]:
    """Return a sentence on a recorded airspeed that the equations hold constant, and a doubt where
    its mean is far from the vehicle file's; both without the record's name, empty where there is
    none.

    Parameters
    ----------
    file : the record as opened.
    model : whose parameter ``airspeed`` is a constant, m/s.
    channels : channel map, None: by the names of the columns.
    start, stop : part of the record, s.
    rate : Hz, of rows without a clock.
    """
    outputs = [signal.name for signal in model.equations.outputs]
    if is_own(model) or able(model) or SPEED_NAME in outputs or SPEED_NAME not in model.parameters:
        return "", ""
    try:
        record, _ = read_with_notes(file, (), (SPEED_NAME,), channels, start, stop, rate=rate)
    except RecordError:  # a fault in a column that no equation uses does no harm
        return "", ""
    values = record[SPEED_NAME].with_gaps()
    values = values[np.isfinite(values)]
    if not values.size:
        return "", ""
    name = model.equations.name
    least, most = np.percentile(values, [1.0, 99.0])
    declared = model.parameters[SPEED_NAME].value
    sentence = (
        f"the recorded airspeed, {least:.4g} to {most:.4g} m/s, is not used: the {name} model "
        f"holds the airspeed of the vehicle file, {declared:.4g} m/s"
    )
    usual = float(np.median(values))
    if abs(usual - declared) <= NOTABLE_DIFFERENCE_SHARE * declared:
        return sentence, ""
    return sentence, (
        f"the recorded airspeed, {usual:.4g} m/s, is far from {declared:.4g} m/s in the vehicle "
        f"file, which the {name} model holds: derivatives are in error with it; mend airspeed "
        "there, or check the unit of the column and whether it is a true airspeed"
    )


def without_flow(record: Record) -> Record:
    """The record less its measured airspeed and pressure, which are no outputs of a model."""
    if not any(name in record.output_names for name in MEASURED):
        return record
    return replace(
        record, outputs=tuple(channel for channel in record.outputs if channel.name not in MEASURED)
    )


def with_flow(
    model: Model, records: Sequence[Record], *, weight: bool = True
) -> tuple[Model, list[Record]]:
    """Return the model and the records with the measured flow as further inputs.

    Both are unchanged if no record has a measured flow. A record without one is taken to be at the
    declared speed. With ``weight``, the trim lift follows the pressure; without, each speed has its
    own trim.

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
    wider = with_flow_inputs(model, density=has_density, weight=weight)
    added = wider.equations.inputs[len(model.equations.inputs) :]
    return wider, [
        _carrying(record, flow, model, added) for record, flow in zip(records, flows, strict=True)
    ]


def with_flow_inputs(model: Model, *, density: bool, weight: bool = True) -> Model:
    """Return the model with changes of airspeed, air density and trim lift as further inputs."""
    names = [SPEED, *([DENSITY] if density else []), *([LIFT] if weight else [])]
    ports = {port.name: port for port in model.equations.ports}
    added = tuple(
        Signal(name, ports[name].unit, f"recorded: {ports[name].meaning}") for name in names
    )
    equations: Any = model.equations
    return replace(model, equations=replace(equations, inputs=(*equations.inputs, *added)))


def measured_flow(record: Record, model: Model) -> Flow | None:
    """Smoothed speed and density of a record, without wrong samples and gaps; None if it measures
    neither.
    """
    usable = [name for name in able(model) if name in record.output_names]
    if not usable:
        return None
    result = {name: _smooth(record, record[name]) for name in usable}
    if "airspeed" not in result:
        return Flow(
            np.sqrt(2.0 * result["dynamic_pressure"] / model.parameters["air_density"].value), None
        )
    speed = result["airspeed"]
    return Flow(
        speed, 2.0 * result["dynamic_pressure"] / speed**2 if "dynamic_pressure" in result else None
    )


def flow_sentence(record: Record, model: Model) -> str:
    """Sentence on the measured flow and its difference from the declared one; empty without one."""
    flow = measured_flow(record, model)
    if flow is None:
        return ""
    declared = model.parameters["airspeed"].value
    used = " and ".join(name for name in able(model) if name in record.output_names).replace(
        "_", " "
    )
    speed = "" if "airspeed" in used else "which makes "
    return (
        f"{record.name}: measured {used} used, {speed}{flow.speed.min():.4g} to "
        f"{flow.speed.max():.4g} m/s (declared {declared:.4g} m/s)"
    )


def flow_doubts(records: Sequence[Record], model: Model) -> list[str]:
    """Return sentences on records whose airspeed or density differs from the vehicle file's."""
    flows = [
        (record.name, flow)
        for record in records
        if (flow := measured_flow(record, model)) is not None
    ]
    speeds = {name: float(np.mean(flow.speed)) for name, flow in flows}
    densities = {
        name: float(np.mean(flow.density)) for name, flow in flows if flow.density is not None
    }
    from_pressure = bool(flows) and not any("airspeed" in record.output_names for record in records)
    doubts = []
    if far := _far(speeds, model, "airspeed"):
        what = (
            "the airspeed that the measured dynamic pressure makes with the declared air"
            if from_pressure
            else "the measured airspeed"
        )
        mend = "airspeed or air_density" if from_pressure else "airspeed"
        cause = (
            "unit of the dynamic pressure"
            if from_pressure
            else "unit of the column and whether it is a true airspeed"
        )
        meant = "natural frequency and damping are those at that speed"
        difference = f"{far[0]}: {what}, {far[1]} m/s, is far from {far[2]} m/s in the vehicle file"
        doubts.append(f"{difference}: {meant}; mend {mend} there, or check the {cause}")
    if far := _far(densities, model, "air_density"):
        what = (
            f"the air density that measured pressure and airspeed make, {far[1]} kg/m3, is far "
            f"from {far[2]} kg/m3 in the vehicle file"
        )
        doubts.append(
            f"{far[0]}: {what}; mend air_density there, or check whether the airspeed is a true one"
        )
    return doubts


def _far(means: Mapping[str, float], model: Model, name: str) -> tuple[str, str, str] | None:
    """Return the records whose mean differs from the declared value, with both; None if all agree.

    The limit is ``NOTABLE_DIFFERENCE_SHARE``.
    """
    if not means:
        return None
    declared = model.parameters[name].value
    result = {
        record: mean
        for record, mean in means.items()
        if abs(mean / declared - 1.0) > NOTABLE_DIFFERENCE_SHARE
    }
    if not result:
        return None
    shown = list(
        dict.fromkeys(f"{mean:.3g}" for mean in (min(result.values()), max(result.values())))
    )
    return ", ".join(result), " to ".join(shown), f"{declared:.3g}"


def _carrying(record: Record, flow: Flow | None, model: Model, added: Sequence[Signal]) -> Record:
    flow = flow or Flow(np.full(len(record), model.parameters["airspeed"].value), None)
    rows = flow_rows(flow, model, pressure_at_rest(record.time, flow, model))
    inputs = tuple(
        Channel.of(signal.name, signal.unit, interval_means(rows[signal.name], record.hold))
        for signal in added
    )
    return replace(without_flow(record), inputs=(*record.inputs, *inputs))


def pressure_at_rest(time: np.ndarray, flow: Flow, model: Model) -> float:
    """Return the mean dynamic pressure (Pa) at the record's beginning, in trim.

    For a model without air density, the pressure over the density.
    """
    count = max(1, int(np.searchsorted(time, time[0] + TRIM_AVERAGING_TIME)))
    resting = _pressure(flow, model)[:count]
    return float(np.mean(resting))


def _pressure(flow: Flow, model: Model) -> np.ndarray:
    return np.asarray(0.5 * _density(flow, model) * flow.speed**2)


def _density(flow: Flow, model: Model) -> np.ndarray:
    p = model.parameters
    declared = p["air_density"].value if "air_density" in p else 1.0
    return flow.density if flow.density is not None else np.full(len(flow.speed), declared)


def flow_rows(flow: Flow, model: Model, level: float) -> dict[str, np.ndarray]:
    """Return the inputs of ``with_flow_inputs``, ``(N,)`` each; ``level``: pressure in trim."""
    p, pressure = model.parameters, _pressure(flow, model)
    if "mass" in p and "wing_area" in p:
        lift = p["mass"].value * G0 / p["wing_area"].value * (1.0 / level - 1.0 / pressure)
    else:  # a dimensional lift is a rate of the angle of attack
        lift = -p["gravity"].value / flow.speed * (pressure / level - 1.0)
    air = p["air_density"].value if "air_density" in p else 1.0
    return {
        SPEED: flow.speed - p["airspeed"].value,
        DENSITY: _density(flow, model) - air,
        LIFT: lift,
    }


def interval_means(values: np.ndarray, hold: Hold) -> np.ndarray:
    """Return samples for linear inputs between ``values``; for held inputs, interval means."""
    return (
        values if hold is Hold.LINEAR else np.append(0.5 * (values[:-1] + values[1:]), values[-1])
    )


def _smooth(record: Record, channel: Channel) -> np.ndarray:
    usable = channel.valid.copy()
    usable[usable] = ~_spikes(channel.values[usable])
    time, step = record.time, float(np.median(np.diff(record.time)))
    grid = np.linspace(time[0], time[-1], max(2, 1 + round((time[-1] - time[0]) / step)))
    even = np.interp(grid, time[usable], channel.values[usable])
    half = min(round(0.5 * SPEED_SMOOTHING_TIME / step), len(even) - 1)
    if half > 0:
        # Extrapolate linearly, by the first and the last window.
        before, behind = np.arange(-half, 0), np.arange(1, half + 1)
        ends = _line(even[: 2 * half + 1], before), _line(even[::-1][: 2 * half + 1], -behind)
        weights = np.hanning(2 * half + 3)[1:-1]
        even = np.convolve(
            np.concatenate([ends[0], even, ends[1]]), weights / weights.sum(), mode="valid"
        )
    values = np.interp(time, grid, even)
    if not np.all(values > 0.0):
        at = float(time[int(np.argmax(values <= 0.0))])
        remedy = "leave the column out, or cut the record there with --from and --to"
        raise RecordError(
            f"{channel.name} is not above zero at {instant(at, 6)} s",
            where=f"{record.name}, channel {channel.name}",
            remedy=remedy,
        )
    return np.asarray(values)


def _line(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The straight line through ``values`` at their positions 0, 1, ..., at other positions."""
    slope, level = np.polyfit(np.arange(len(values)), values, 1)
    return np.asarray(level + slope * at)


def _spikes(values: np.ndarray) -> np.ndarray:
    """Return which samples are spikes: far from the median of five samples."""
    if len(values) < 7:
        return np.zeros(len(values), dtype=bool)
    padded = np.concatenate([values[2:0:-1], values, values[-2:-4:-1]])
    away = np.abs(values - np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1))
    return np.asarray(
        away > max(SPIKE_MEDIANS * float(np.median(away)), 1e-3 * float(np.median(np.abs(values))))
    )


# ---- A measured pitch attitude as a recorded input of the equations

PARTLY = "the pitch attitude is not measured in all records: a phugoid keeps its own"
LEAST_SAMPLE_SHARE = 0.5  # share of valid samples that a channel needs


def wants_attitude(model: Model) -> bool:
    """Return whether a phugoid effect can use the attitude, because speed is not recorded."""
    recorded = {signal.name for signal in model.equations.inputs}
    return not is_own(model) and applies(Phugoid(), model.equations) and SPEED not in recorded


def with_attitude(model: Model, records: Sequence[Record]) -> tuple[Model, list[Record], str]:
    """Return the model and records with ``theta`` (rad, from its initial value) as an input.

    If the model cannot use it, or a record lacks it, it is dropped. The third result is a sentence
    if only some records have it, else empty.
    """
    if any(signal.name == ATTITUDE for signal in model.equations.outputs):
        return model, list(records), ""
    without = [without_attitude(record) for record in records]
    has_attitude = [_tells(record) for record in records]
    if not wants_attitude(model) or not all(has_attitude):
        return model, without, PARTLY if wants_attitude(model) and any(has_attitude) else ""
    equations: Any = model.equations
    added = Signal(ATTITUDE, "rad", "recorded: pitch attitude above that at the record's begin")
    wider = replace(model, equations=replace(equations, inputs=(*equations.inputs, added)))
    carried = [
        replace(bare, inputs=(*bare.inputs, _from_begin(record)))
        for bare, record in zip(without, records, strict=True)
    ]
    return wider, carried, "the pitch attitude is measured: a phugoid takes it as it is"


def without_attitude(record: Record) -> Record:
    """The record less its measured attitude, which is no output of a model at constant speed."""
    if ATTITUDE not in record.output_names:
        return record
    return replace(
        record, outputs=tuple(channel for channel in record.outputs if channel.name != ATTITUDE)
    )


def _tells(record: Record) -> bool:
    return (
        ATTITUDE in record.output_names
        and float(np.mean(record[ATTITUDE].valid)) > LEAST_SAMPLE_SHARE
    )


def _from_begin(record: Record) -> Channel:
    """Return the attitude from the mean of its beginning, wrong samples and gaps bridged, as the
    inputs are held.
    """
    time, channel = record.time, record[ATTITUDE]
    # Not despiked as an airspeed: turning points of the attitude are no spikes.
    finite_rows = np.flatnonzero(channel.valid)
    finite_rows = np.delete(finite_rows, input_spikes(channel.values[finite_rows]))
    values = np.interp(time, time[finite_rows], channel.values[finite_rows])
    level = float(
        np.mean(values[: max(1, int(np.searchsorted(time, time[0] + TRIM_AVERAGING_TIME)))])
    )
    return Channel.of(ATTITUDE, "rad", interval_means(values - level, record.hold))
