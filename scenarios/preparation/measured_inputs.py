"""Measured channels as inputs of the equations: trim, load factors, airspeed, pitch attitude.

With a measured airspeed V(t) and dynamic pressure qbar(t) the coefficients rho V S/(2 m),
rho V^2 S c/(2 Iy) and c/(2 V) of the equations vary over the record. The trim lift, which balances
the weight, grows with the pressure as well. About level flight at the beginning of the record,
-(g0/V) (qbar/qbar_0 - 1) adds to alpha_dot and (qbar/qbar_0 - 1) to nz. Both follow from a lift
coefficient of m g0/S (1/qbar_0 - 1/qbar).

Pitch attitude is counted from its mean at the beginning of the record: a phugoid effect would need
the zero of a measured attitude to one thousandth.
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

# ---- Inputs counted from their trim

REST_SHARE = 0.05  # an input that moves by a smaller share of its range is at rest
SHORTEST_REST = 0.3  # s; a trim needs a longer rest at the beginning
OFFSET_SHARE = 0.1  # an input whose median is a smaller share of its range needs no trim
# Channels that respond to a control without delay.
FAST_OUTPUTS = ("alpha", "q", "nz", "az", "beta", "p", "r", "ny", "ay")
# A channel that changes by a smaller share of its scatter over the record is at rest.
STILL_SHARE = 0.3


def of_totals(model: Model) -> bool:
    """Return whether the equations describe total motion, not perturbations about a trim."""
    if isinstance(model.equations, OfTotals):
        return model.equations.totals
    return is_own(model) or any(state.name == "airspeed" for state in model.equations.states)


def about_trim(record: Record) -> tuple[Record, dict[str, float]]:
    """Return the record with inputs counted from trim, and the subtracted trims by input.

    The trim is the mean of the input before it first moves. An input that moves at once, or has a
    zero trim, is not changed. Derivatives do not depend on the trim: biases and initial states
    absorb it. Break-out, saturation and other nonlinearities do depend on it.
    """
    trims: dict[str, float] = {}
    inputs = []
    for channel in record.inputs:
        trim = _trim(record, channel.values)
        if trim:
            trims[channel.name] = trim
            channel = Channel.of(channel.name, channel.unit, channel.values - trim)
        inputs.append(channel)
    return (replace(record, inputs=tuple(inputs)), trims) if trims else (record, trims)


def lacks_trim(control: Channel) -> bool:
    """Return whether an input is not about zero: it has a trim that is still to be subtracted."""
    return abs(float(np.median(control.values))) > OFFSET_SHARE * float(np.ptp(control.values))


def trim_sentence(record: Record, name: str) -> str:
    """Return a sentence if no trim of an input was found although it is not about zero."""
    if not lacks_trim(record[name]):
        return ""
    unit, middle = record[name].unit, float(np.median(record[name].values))
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
    """Return the trim of an input: its mean before it first moves away from its beginning.

    Zero if the input or the aircraft is not at rest there. ``values``: shape ``(N,)``.
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
    # The motion may already begin in the last sample before it is seen.
    until = max(2, until - 1)
    # An input that is at its beginning most of the time and at the end is at trim there, even if
    # the aircraft still moves. Any other input needs an aircraft at rest.
    end = values[int(np.searchsorted(time, time[-1] - SHORTEST_REST)) :]
    distance = max(abs(float(np.median(part)) - start) for part in (values, end))
    if distance > REST_SHARE * span and any(
        _moves(channel, until) for channel in record.outputs if channel.name in FAST_OUTPUTS
    ):
        return 0.0
    resting = values[:until]
    trim = float(np.mean(resting))
    is_significant = abs(trim) > 3.0 * _scatter_of_mean(resting) and abs(trim) > 1e-6 * span
    return trim if is_significant else 0.0


def _scatter_of_mean(values: np.ndarray) -> float:
    """Return the standard deviation of the mean of an input, which may begin to move smoothly.

    Each sample of noise is an independent value; a smooth motion counts as a single value. The
    share of noise in the variance is von Neumann's ratio: the mean square of the steps over twice
    the variance.
    """
    variance = float(np.var(values))
    if variance == 0.0:
        return 0.0
    noise = min(1.0, 0.5 * float(np.mean(np.diff(values) ** 2)) / variance)
    return float(np.sqrt(variance / max(1.0, noise * len(values))))


def _moves(channel: Channel, until: int) -> bool:
    """Return whether a channel moves in its first ``until`` samples: the means of their halves
    differ. It does if the record begins within a maneuver.
    """
    first = channel.values[:until][channel.valid[:until]]
    half = len(first) // 2
    if half == 0:
        return False
    change = abs(float(np.mean(first[half:]) - np.mean(first[:half])))
    return change > STILL_SHARE * float(np.std(channel.values[channel.valid]))


# ---- Load factors from accelerometers

LARGEST_REST_LOAD = 1.5  # g; a median load factor below minus its inverse is a wrong sign of az
# Load factor -> accelerometer that replaces it, and the sign between them.
ACCELEROMETERS: Mapping[str, tuple[str, float]] = MappingProxyType(
    {"nz": ("az", -1.0), "ny": ("ay", 1.0), "nx": ("ax", 1.0)}
)


def accelerometers_for(outputs: Collection[str]) -> dict[str, str]:
    """Return the accelerometer that replaces each load factor of a model, if it is not recorded.

    ``outputs``: the outputs of the model.
    """
    return {name: channel for name, (channel, _) in ACCELEROMETERS.items() if name in outputs}


def with_load_factors(record: Record, kept: Collection[str] = ()) -> tuple[Record, tuple[str, ...]]:
    """Return the record with accelerometers converted to load factors (g), and sentences on them.

    A recorded load factor has precedence. ``kept``: accelerometers that are not converted.

    Raises
    ------
    RecordError : az has the sign of inverted flight; most likely it is positive up in this file.
    """
    notes = []
    for name, (channel, sign) in ACCELEROMETERS.items():
        if channel not in record.output_names or name in record.output_names or channel in kept:
            continue
        force = record[channel]
        factor = Channel.of(name, "g", np.where(force.valid, sign * force.values / G0, np.nan))
        outputs = tuple(factor if output.name == channel else output for output in record.outputs)
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
# Length of the smoothing window of a measured speed, s: longer than a short period, shorter than
# the changes of the airspeed.
SPEED_SMOOTHING_TIME = 1.0
# A sample is a spike if it is farther from the median of its neighbours than this many times the
# median of that distance.
SPIKE_MEDIANS = 9.0
TRIM_AVERAGING_TIME = 0.5  # s; trim values are means over this time at the beginning
NOTABLE_DIFFERENCE_SHARE = 0.1  # a larger relative difference from a declared value is reported


@dataclass(frozen=True)
class Flow:
    """Measured flow along a record.

    Attributes
    ----------
    speed : airspeed, shape ``(N,)``, m/s.
    density : air density, shape ``(N,)``, kg/m3; None: the declared constant.
    """

    speed: np.ndarray
    density: np.ndarray | None


def usable_flow_channels(model: Model) -> tuple[str, ...]:
    """Return the channels of ``MEASURED`` that the equations can use; none for a user model."""
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
    """Return sentences on a recorded airspeed that the equations do not use.

    Parameters
    ----------
    file : the open record file.
    model : a model in which the airspeed is a constant parameter, m/s.
    channels : channel map; None: the names of the columns decide.
    start, stop : begin and end of the part that is read, s.
    rate : Hz; sample rate of a file without a clock.

    Returns
    -------
    A note that the recorded airspeed is not used, and a doubt if its median is far from the value
    in the vehicle file. Both are empty if they do not apply, and do not name the record.
    """
    outputs = [signal.name for signal in model.equations.outputs]
    if (
        is_own(model)
        or usable_flow_channels(model)
        or SPEED_NAME in outputs
        or SPEED_NAME not in model.parameters
    ):
        return "", ""
    try:
        record, _ = read_with_notes(file, (), (SPEED_NAME,), channels, start, stop, rate=rate)
    except RecordError:  # no equation uses the column, so its faults do not matter
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


def _without_outputs(record: Record, names: Collection[str]) -> Record:
    kept = tuple(channel for channel in record.outputs if channel.name not in names)
    return replace(record, outputs=kept) if len(kept) < len(record.outputs) else record


def with_flow(
    model: Model, records: Sequence[Record], *, trim_lift: bool = True
) -> tuple[Model, list[Record]]:
    """Return the model and the records with the measured flow as further inputs.

    Both are unchanged if no record has a measured flow. If only some records have one, the others
    are taken to be at the declared speed.

    ``trim_lift``: whether the trim lift follows the pressure. If not, each speed has its own trim.

    Raises
    ------
    RecordError : an airspeed or a pressure is not above zero.
    """
    if any(signal.name in MEASURED for signal in model.equations.outputs):
        return model, list(records)
    flows = [measured_flow(record, model) for record in records]
    if all(flow is None for flow in flows):
        return model, [_without_outputs(record, MEASURED) for record in records]
    has_density = any(flow is not None and flow.density is not None for flow in flows)
    wider = with_flow_inputs(model, density=has_density, trim_lift=trim_lift)
    added = wider.equations.inputs[len(model.equations.inputs) :]
    return wider, [
        _with_flow_channels(record, flow, model, added)
        for record, flow in zip(records, flows, strict=True)
    ]


def with_flow_inputs(model: Model, *, density: bool, trim_lift: bool = True) -> Model:
    """Return the model with changes of airspeed, air density and trim lift as further inputs."""
    names = [SPEED, *([DENSITY] if density else []), *([LIFT] if trim_lift else [])]
    ports = {port.name: port for port in model.equations.ports}
    added = tuple(
        Signal(name, ports[name].unit, f"recorded: {ports[name].meaning}") for name in names
    )
    equations: Any = model.equations
    return replace(model, equations=replace(equations, inputs=(*equations.inputs, *added)))


def measured_flow(record: Record, model: Model) -> Flow | None:
    """Return the smoothed flow of a record, with spikes and gaps bridged; None if the record has no
    channel that the model can use.
    """
    usable = [name for name in usable_flow_channels(model) if name in record.output_names]
    if not usable:
        return None
    smooth = {name: _smooth(record, record[name]) for name in usable}
    speed, pressure = smooth.get("airspeed"), smooth.get("dynamic_pressure")
    if speed is None:
        assert pressure is not None
        return Flow(np.sqrt(2.0 * pressure / model.parameters["air_density"].value), None)
    return Flow(speed, None if pressure is None else 2.0 * pressure / speed**2)


def flow_sentence(record: Record, model: Model) -> str:
    """Return a sentence on the measured flow beside the declared airspeed; empty without a flow."""
    flow = measured_flow(record, model)
    if flow is None:
        return ""
    declared = model.parameters["airspeed"].value
    used = " and ".join(
        name for name in usable_flow_channels(model) if name in record.output_names
    ).replace("_", " ")
    derived = "" if "airspeed" in used else "which makes "
    return (
        f"{record.name}: measured {used} used, {derived}{flow.speed.min():.4g} to "
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
    if far := _notable_difference(speeds, model, "airspeed"):
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
    if far := _notable_difference(densities, model, "air_density"):
        what = (
            f"the air density that measured pressure and airspeed make, {far[1]} kg/m3, is far "
            f"from {far[2]} kg/m3 in the vehicle file"
        )
        doubts.append(
            f"{far[0]}: {what}; mend air_density there, or check whether the airspeed is a true one"
        )
    return doubts


def _notable_difference(
    means: Mapping[str, float], model: Model, name: str
) -> tuple[str, str, str] | None:
    """Return the records whose mean differs notably from the declared value; None if all agree.

    Returns texts: names of these records, range of their means, declared value.
    """
    if not means:
        return None
    declared = model.parameters[name].value
    differing = {
        record: mean
        for record, mean in means.items()
        if abs(mean / declared - 1.0) > NOTABLE_DIFFERENCE_SHARE
    }
    if not differing:
        return None
    ends = (min(differing.values()), max(differing.values()))
    mean_range = " to ".join(dict.fromkeys(f"{mean:.3g}" for mean in ends))
    return ", ".join(differing), mean_range, f"{declared:.3g}"


def _with_flow_channels(
    record: Record, flow: Flow | None, model: Model, added: Sequence[Signal]
) -> Record:
    """Return a record with the inputs ``added``, computed from its flow (None: declared speed)."""
    flow = flow or Flow(np.full(len(record), model.parameters["airspeed"].value), None)
    rows = flow_rows(flow, model, pressure_at_rest(record.time, flow, model))
    inputs = tuple(
        Channel.of(signal.name, signal.unit, interval_means(rows[signal.name], record.hold))
        for signal in added
    )
    return replace(_without_outputs(record, MEASURED), inputs=(*record.inputs, *inputs))


def pressure_at_rest(time: np.ndarray, flow: Flow, model: Model) -> float:
    """Return the mean dynamic pressure at the beginning of a record, in trim, Pa.

    For a model without air density the result is pressure over density, m2/s2.
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
    """Return the values of the inputs of ``with_flow_inputs``, each of shape ``(N,)``.

    ``level``: dynamic pressure in trim, from ``pressure_at_rest``.
    """
    p, pressure = model.parameters, _pressure(flow, model)
    if "mass" in p and "wing_area" in p:
        lift = p["mass"].value * G0 / p["wing_area"].value * (1.0 / level - 1.0 / pressure)
    else:  # dimensional equations: the lift is a rate of the angle of attack, rad/s
        lift = -p["gravity"].value / flow.speed * (pressure / level - 1.0)
    air = p["air_density"].value if "air_density" in p else 1.0
    return {
        SPEED: flow.speed - p["airspeed"].value,
        DENSITY: _density(flow, model) - air,
        LIFT: lift,
    }


def interval_means(values: np.ndarray, hold: Hold) -> np.ndarray:
    """Return the samples of an input that follows ``values`` under a hold, shape ``(N,)``.

    A linear input has the values themselves, a held input the mean of each interval.
    """
    if hold is Hold.LINEAR:
        return values
    return np.append(0.5 * (values[:-1] + values[1:]), values[-1])


def _smooth(record: Record, channel: Channel) -> np.ndarray:
    """Return a channel without spikes and gaps, smoothed over ``SPEED_SMOOTHING_TIME``.

    Raises RecordError if a value is not above zero.
    """
    usable = channel.valid.copy()
    usable[usable] = ~_spikes(channel.values[usable])
    time, step = record.time, float(np.median(np.diff(record.time)))
    grid = np.linspace(time[0], time[-1], max(2, 1 + round((time[-1] - time[0]) / step)))
    even = np.interp(grid, time[usable], channel.values[usable])
    half = min(round(0.5 * SPEED_SMOOTHING_TIME / step), len(even) - 1)
    if half > 0:
        # Lines through the first and the last window extend the signal beyond its ends.
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
    """Return the line through ``values``, which are at 0, 1, 2 ..., at the positions ``at``."""
    slope, intercept = np.polyfit(np.arange(len(values)), values, 1)
    return np.asarray(intercept + slope * at)


def _spikes(values: np.ndarray) -> np.ndarray:
    """Return which samples are spikes: far from the median of five samples about them."""
    if len(values) < 7:
        return np.zeros(len(values), dtype=bool)
    padded = np.concatenate([values[2:0:-1], values, values[-2:-4:-1]])
    medians = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1)
    distance = np.abs(values - medians)
    smallest = 1e-3 * float(np.median(np.abs(values)))  # a part in 1000 is no spike
    return np.asarray(distance > max(SPIKE_MEDIANS * float(np.median(distance)), smallest))


# ---- A measured pitch attitude as a recorded input of the equations

PARTLY = "the pitch attitude is not measured in all records: a phugoid keeps its own"
LEAST_SAMPLE_SHARE = 0.5  # a channel with a smaller share of valid samples is not used


def wants_attitude(model: Model) -> bool:
    """Return whether a phugoid effect can use a measured attitude: the airspeed is not recorded."""
    recorded = {signal.name for signal in model.equations.inputs}
    return not is_own(model) and applies(Phugoid(), model.equations) and SPEED not in recorded


def with_attitude(model: Model, records: Sequence[Record]) -> tuple[Model, list[Record], str]:
    """Return the model and the records with the pitch attitude as an input, and a sentence on it.

    The input is the attitude, rad, minus its mean at the beginning. If the model cannot use the
    attitude, or a record does not have it, it is dropped from all records.
    """
    if any(signal.name == ATTITUDE for signal in model.equations.outputs):
        return model, list(records), ""
    without = [_without_outputs(record, (ATTITUDE,)) for record in records]
    has_attitude = [_has_attitude(record) for record in records]
    if not wants_attitude(model):
        return model, without, ""
    if not all(has_attitude):
        return model, without, PARTLY if any(has_attitude) else ""
    equations: Any = model.equations
    added = Signal(ATTITUDE, "rad", "recorded: pitch attitude above that at the record's begin")
    wider_model = replace(model, equations=replace(equations, inputs=(*equations.inputs, added)))
    with_input = [
        replace(bare, inputs=(*bare.inputs, _from_begin(record)))
        for bare, record in zip(without, records, strict=True)
    ]
    return wider_model, with_input, "the pitch attitude is measured: a phugoid takes it as it is"


def _has_attitude(record: Record) -> bool:
    return (
        ATTITUDE in record.output_names
        and float(np.mean(record[ATTITUDE].valid)) > LEAST_SAMPLE_SHARE
    )


def _from_begin(record: Record) -> Channel:
    """Return the attitude minus its mean at the beginning as an input with the hold of the record.

    Wrong samples and gaps are bridged linearly.
    """
    time, channel = record.time, record[ATTITUDE]
    # The test for spikes of an airspeed would take turning points of the attitude for spikes.
    finite_rows = np.flatnonzero(channel.valid)
    finite_rows = np.delete(finite_rows, input_spikes(channel.values[finite_rows]))
    values = np.interp(time, time[finite_rows], channel.values[finite_rows])
    level = float(
        np.mean(values[: max(1, int(np.searchsorted(time, time[0] + TRIM_AVERAGING_TIME)))])
    )
    return Channel.of(ATTITUDE, "rad", interval_means(values - level, record.hold))
