"""Kinematics of six degrees of freedom: channels, relations, unknowns.

Body axes, x forward, y to the right, z down; flat earth and constant wind (Klein and
Morelli, Aircraft System Identification, AIAA 2006, ch. 10; Jategaonkar, Flight Vehicle System
Identification, AIAA 2006, ch. 10):

    phi_dot = p + tan(theta) (q sin(phi) + r cos(phi))
    theta_dot = q cos(phi) - r sin(phi)
    psi_dot = (q sin(phi) + r cos(phi)) / cos(theta)
    V alpha_dot cos(beta) = V [q cos(beta) - sin(beta) (p cos(alpha) + r sin(alpha))]
        + Z cos(alpha) - X sin(alpha)
    V beta_dot = V [p sin(alpha) - r cos(alpha)]
        - X cos(alpha) sin(beta) + Y cos(beta) - Z sin(alpha) sin(beta)
    V_dot = X cos(alpha) cos(beta) + Y sin(beta) + Z sin(alpha) cos(beta)
    h_dot = V [cos(alpha) cos(beta) sin(theta) - sin(beta) sin(phi) cos(theta)
        - sin(alpha) cos(beta) cos(phi) cos(theta)] + w
    X = ax - g sin(theta), Y = ay + g cos(theta) sin(phi), Z = az + g cos(theta) cos(phi)

with w the vertical wind. A channel that is not recorded is replaced:

- theta and alpha by a fitted constant of the record
- phi and beta by zero
- p by the change of phi
- q by the rate that keeps theta constant
- r, in the equation of phi, by that of a coordinated turn: phi_dot = p + psi_dot sin(theta) with
  psi_dot = g tan(phi)/V
- ax by the acceleration that keeps the airspeed constant

ay and az are replaced by zero, together with the terms of gravity along their axes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.compatibility.kinematics import (
    AIRSPEED_UNCERTAINTY,
    ARM,
    BELOW,
    BIAS,
    BOOM,
    DELAY,
    DRIFT,
    LAG,
    PACKAGE,
    RIGHT,
    SCALE,
    SensorFault,
    Unknown,
    Values,
    columns_of,
    cumulative,
    difference_step,
    initial_state,
    midpoints,
    sensor_reading,
    true_increments,
    true_samples,
)
from ident.compatibility.signals import KinematicSignals, bridged_channels, joined_signals
from sim.errors import RecordError
from sim.maths import G0
from sim.record import Record

# ---- Signals of a record, and the relations between its channels

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
    usable = [
        name
        for name in CHANNELS
        if name in record.output_names and np.count_nonzero(record[name].valid) > 1
    ]
    for alternatives in (*AXES.values(), HEIGHTS):
        for name in [name for name in alternatives if name in usable][1:]:
            usable.remove(name)
    return tuple(usable)


def load_on(axis: str, names: Sequence[str]) -> str | None:
    """Return the channel of the accelerometer along an axis (x, y, z); None without one."""
    return next((name for name in AXES[axis] if name in names), None)


def relations(names: Sequence[str], *, speed: bool) -> dict[str, tuple[str, ...]]:
    """Return, for each output that ``names`` suffice to reconstruct, output -> channels in its
    relation. The channels that the relation requires come first, and then the optional ones.

    ``speed`` : whether an airspeed is recorded or given.
    """
    recorded = set(names)
    x, y, z = (load_on(axis, names) or "" for axis in "xyz")
    height = next((name for name in HEIGHTS if name in recorded), "")
    conditions = {
        "alpha": (("alpha", "q", z), ("theta", "phi", x, "beta", "p", "r", "airspeed"), speed),
        "theta": (("theta", "q"), ("phi", "r"), "phi" not in recorded or "r" in recorded),
        "airspeed": (("airspeed", x, "theta", "alpha", z), ("beta", y, "phi"), True),
        "beta": (("beta", "r", y, "phi"), ("p", "alpha", "theta", x, z, "airspeed"), speed),
        "phi": (("phi", "p"), ("r", "q", "theta"), True),
        "psi": (("psi", "r", "phi"), ("q", "theta"), True),
        height: ((height, "theta", "alpha"), ("airspeed", "phi", "beta"), speed),
    }
    return {
        output: (*required, *(name for name in optional if name in recorded))
        for output, (required, optional, possible) in conditions.items()
        if possible and set(required) <= recorded
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
    airspeed : m/s, for a record without airspeed; None if it is not known.
    gravity : m/s2.
    vane_arm : m.

    Raises
    ------
    RecordError : if the pitch attitude comes near the vertical.
    """
    bridged, notes = bridged_channels(record, channels, _unwrapped), []
    pitch = bridged.values["theta"][bridged.valid["theta"]] if "theta" in channels else np.zeros(0)
    if np.any(np.abs(pitch) > _STEEPEST_PITCH):
        raise RecordError(
            "an attitude near the vertical, where bank and heading are not defined",
            where=f"{record.name}, channel theta",
            remedy="cut the record there",
        )
    if (z := load_on("z", channels)) is not None:
        weight = 1.0 if z == "nz" else -G0
        if float(np.median(bridged.values[z])) / weight < _INCREMENTAL_LOAD:
            bridged.values[z] = bridged.values[z] + weight
            notes.append(f"{z} of {record.name} does not include the weight, which is added")
    output_relations = relations(channels, speed=airspeed is not None or "airspeed" in channels)
    used = {name for joined in output_relations.values() for name in joined}
    signals = joined_signals(
        record, bridged, output_relations, used, airspeed, gravity, vane_arm, np.zeros(0)
    )
    return signals, tuple(notes)


def _unwrapped(record: Record, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the values ``(N,)`` of a channel, angles unwrapped, and the mask of valid ones."""
    values, mask = record[name].values.copy(), record[name].valid
    if name in WRAPPED:
        values[mask] = np.unwrap(values[mask])
    return values, mask


# ---- The kinematic relations of six degrees of freedom

# factors on load factors that make them specific forces along the body axes, m/s2
_SPECIFIC_FORCE_PER_LOAD = {"nx": G0, "ny": G0, "nz": -G0}


@dataclass(frozen=True, eq=False)
class _CorrectedMotion:
    """Measured motion corrected for P sets of faults.

    Attributes
    ----------
    phi, theta, alpha, beta : ``(P, N)`` angles at the samples, rad.
    speed : ``(P, N)`` airspeed at the samples, m/s.
    rate_integrals : rate -> its integral ``(P, N - 1)`` over each interval, rad.
    force_integrals : axis -> integral ``(P, N - 1)`` of the specific force over each interval, m/s.
    """

    phi: np.ndarray
    theta: np.ndarray
    alpha: np.ndarray
    beta: np.ndarray
    speed: np.ndarray
    rate_integrals: dict[str, np.ndarray]
    force_integrals: dict[str, np.ndarray]


def reconstructed_outputs(s: KinematicSignals, value: Values) -> np.ndarray:
    """Return the expected readings ``(m, P, N)`` of the outputs for P sets of faults and unknowns.

    The function ``value(channel, kind)`` returns the sizes ``(P, 1)`` of a fault. It also returns
    the initial states as ``("start", STATE)``, the constants that replace unrecorded angles as
    ``("level", "theta")`` and ``("level", "alpha")``, and the vertical wind, m/s upward, as
    ``("wind", "bias")``.
    """
    rates = {name: true_samples(s, name, value) for name in ("p", "q", "r") if name in s.channels}
    motion = _motion(s, value, rates)
    readings = []
    for name in s.outputs:
        state = value("start", name) + cumulative(
            _OUTPUT_INCREMENTS.get(name, _height_increments)(s, motion, value)
        )
        readings.append(
            sensor_reading(
                s, name, _transferred_flow_angle(s, name, state, value, rates, motion.speed), value
            )
        )
    set_count = max(reading.shape[0] for reading in readings)
    return np.array([np.broadcast_to(reading, (set_count, len(s.time))) for reading in readings])


def _motion(s: KinematicSignals, value: Values, rates: dict[str, np.ndarray]) -> _CorrectedMotion:
    """Return the motion corrected for faults. ``rates`` are the corrected rates at the samples,
    rad/s.
    """
    steps, zeros = s.steps, np.zeros((1, len(s.time)))
    if "airspeed" in s.channels:
        speed = true_samples(s, "airspeed", value)
    else:
        speed = s.speed[None] / (1.0 + value("airspeed", SCALE))
    angles = {}
    for name in ("phi", "theta", "alpha", "beta"):
        if name in s.channels:
            angles[name] = _transferred_flow_angle(
                s, name, true_samples(s, name, value), value, rates, speed, to_cg=True
            )
        else:
            angles[name] = zeros + value("level", name)
    rate_integrals = {name: true_increments(s, name, value, steps) for name in rates}
    if "p" not in rate_integrals and "phi" in s.channels:
        rate_integrals["p"] = np.diff(angles["phi"])
    force_integrals = {}
    for axis in "xyz":
        if (channel := load_on(axis, tuple(s.channels))) is not None:
            force_integrals[axis] = _SPECIFIC_FORCE_PER_LOAD.get(channel, 1.0) * true_increments(
                s, channel, value, steps
            ) - _lever_arm_integral(s, axis, channel, value, rates)
    return _CorrectedMotion(
        angles["phi"],
        angles["theta"],
        angles["alpha"],
        angles["beta"],
        speed,
        rate_integrals,
        force_integrals,
    )


def _transferred_flow_angle(
    s: KinematicSignals,
    name: str,
    angle: np.ndarray,
    value: Values,
    rates: dict[str, np.ndarray],
    speed: np.ndarray,
    *,
    to_cg: bool = False,
) -> np.ndarray:
    """Return a flow angle ``(P, N)`` transferred from the centre of gravity to its vane, or from
    the vane to the centre of gravity if ``to_cg``. Angles other than alpha and beta are returned
    unchanged.
    """
    arm = value(name, ARM) + value(BOOM, ARM) + (s.vane_arm if name == "alpha" else 0.0)
    terms = {
        "alpha": (("q", -arm), ("p", value(name, RIGHT))),
        "beta": (("r", arm), ("p", -value(name, BELOW))),
    }.get(name, ())
    for rate, distance in terms:
        if rate in rates and np.any(distance):
            angle = angle + (-distance if to_cg else distance) / speed * rates[rate]
    return angle


def _lever_arm_integral(
    s: KinematicSignals, axis: str, channel: str, value: Values, rates: dict[str, np.ndarray]
) -> np.ndarray:
    """Return the integral ``(P, N - 1)``, m/s, of the specific force due to a sensor's arm."""
    x, y, z = (value(channel, kind) + value(PACKAGE, kind) for kind in (ARM, RIGHT, BELOW))
    if not (np.any(x) or np.any(y) or np.any(z)):
        return np.zeros((1, 1))
    steps, zeros = s.steps, np.zeros((1, len(s.time)))
    p, q, r = (rates.get(name, zeros) for name in ("p", "q", "r"))

    def integral(product: np.ndarray) -> np.ndarray:
        return steps * midpoints(product)

    if axis == "x":
        force = (
            -x * integral(q * q + r * r)
            + y * (integral(p * q) - np.diff(r))
            + z * (integral(p * r) + np.diff(q))
        )
    elif axis == "y":
        force = (
            x * (integral(p * q) + np.diff(r))
            - y * integral(p * p + r * r)
            + z * (integral(q * r) - np.diff(p))
        )
    else:
        force = (
            x * (integral(p * r) - np.diff(q))
            + y * (integral(q * r) + np.diff(p))
            - z * integral(p * p + q * q)
        )
    return np.asarray(force)


def _theta_increments(s: KinematicSignals, motion: _CorrectedMotion, value: Values) -> np.ndarray:
    q, r = motion.rate_integrals["q"], motion.rate_integrals.get("r")
    if r is None or "phi" not in s.channels:
        return q
    return q * midpoints(np.cos(motion.phi)) - r * midpoints(np.sin(motion.phi))


def _phi_increments(s: KinematicSignals, motion: _CorrectedMotion, value: Values) -> np.ndarray:
    p, q, r = (
        motion.rate_integrals["p"],
        motion.rate_integrals.get("q"),
        motion.rate_integrals.get("r"),
    )
    tan_theta = np.tan(motion.theta)
    if r is None:
        return p + s.gravity * s.steps * midpoints(
            np.sin(motion.theta) * np.tan(motion.phi) / motion.speed
        )
    if q is None:
        return p + r * midpoints(tan_theta / np.cos(motion.phi))
    return (
        p
        + q * midpoints(tan_theta * np.sin(motion.phi))
        + r * midpoints(tan_theta * np.cos(motion.phi))
    )


def _psi_increments(s: KinematicSignals, motion: _CorrectedMotion, value: Values) -> np.ndarray:
    q, r, cos_theta = (
        motion.rate_integrals.get("q"),
        motion.rate_integrals["r"],
        np.cos(motion.theta),
    )
    if q is None:
        return r * midpoints(1.0 / (np.cos(motion.phi) * cos_theta))
    return q * midpoints(np.sin(motion.phi) / cos_theta) + r * midpoints(
        np.cos(motion.phi) / cos_theta
    )


def _acceleration_integral(
    s: KinematicSignals, motion: _CorrectedMotion, axis_weights: tuple[tuple[str, np.ndarray], ...]
) -> np.ndarray:
    """Return the integral ``(P, N - 1)`` over each interval of a weighted sum of accelerations
    along body axes. An acceleration is the specific force plus gravity. ``axis_weights`` has pairs
    of an axis and its weights ``(P, N)`` at the samples.
    """
    gravity_direction = {
        "x": -np.sin(motion.theta),
        "y": np.cos(motion.theta) * np.sin(motion.phi),
        "z": np.cos(motion.theta) * np.cos(motion.phi),
    }
    total = np.zeros((1, 1))
    for axis, weight in axis_weights:
        if axis in motion.force_integrals:
            total = (
                total
                + motion.force_integrals[axis] * midpoints(weight)
                + s.gravity * s.steps * midpoints(gravity_direction[axis] * weight)
            )
    return total


def _alpha_increments(s: KinematicSignals, motion: _CorrectedMotion, value: Values) -> np.ndarray:
    cos_alpha, sin_alpha = np.cos(motion.alpha), np.sin(motion.alpha)
    inverse_speed = 1.0 / (motion.speed * np.cos(motion.beta))
    axis_weights: tuple[tuple[str, np.ndarray], ...] = (("z", inverse_speed / cos_alpha),)
    if "x" in motion.force_integrals:
        axis_weights = (("z", cos_alpha * inverse_speed), ("x", -sin_alpha * inverse_speed))
    change = motion.rate_integrals["q"] + _acceleration_integral(s, motion, axis_weights)
    if "beta" in s.channels:
        tan_beta = np.tan(motion.beta)
        for rate, coefficient in (("p", cos_alpha), ("r", sin_alpha)):
            if rate in motion.rate_integrals:
                change = change - motion.rate_integrals[rate] * midpoints(tan_beta * coefficient)
    return np.asarray(change)


def _beta_increments(s: KinematicSignals, motion: _CorrectedMotion, value: Values) -> np.ndarray:
    cos_alpha, sin_alpha = np.cos(motion.alpha), np.sin(motion.alpha)
    sin_beta, inverse_speed = np.sin(motion.beta), 1.0 / motion.speed
    change = _acceleration_integral(
        s,
        motion,
        (
            ("y", np.cos(motion.beta) * inverse_speed),
            ("x", -cos_alpha * sin_beta * inverse_speed),
            ("z", -sin_alpha * sin_beta * inverse_speed),
        ),
    )
    change = change - motion.rate_integrals["r"] * midpoints(cos_alpha)
    p = motion.rate_integrals.get("p")
    return change if p is None else change + p * midpoints(sin_alpha)


def _airspeed_increments(
    s: KinematicSignals, motion: _CorrectedMotion, value: Values
) -> np.ndarray:
    cos_beta = np.cos(motion.beta)
    return _acceleration_integral(
        s,
        motion,
        (
            ("x", np.cos(motion.alpha) * cos_beta),
            ("y", np.sin(motion.beta)),
            ("z", np.sin(motion.alpha) * cos_beta),
        ),
    )


def _height_increments(s: KinematicSignals, motion: _CorrectedMotion, value: Values) -> np.ndarray:
    cos_beta, cos_theta = np.cos(motion.beta), np.cos(motion.theta)
    rise = (
        np.cos(motion.alpha) * cos_beta * np.sin(motion.theta)
        - np.sin(motion.beta) * np.sin(motion.phi) * cos_theta
        - np.sin(motion.alpha) * cos_beta * np.cos(motion.phi) * cos_theta
    )
    return np.asarray(s.steps * (midpoints(motion.speed * rise) + value("wind", BIAS)))


# Function of each output that returns its increments ``(P, N - 1)`` over the intervals.
# `_height_increments` is used for all outputs that are not listed.
_OUTPUT_INCREMENTS: dict[
    str, Callable[[KinematicSignals, _CorrectedMotion, Values], np.ndarray]
] = {
    "theta": _theta_increments,
    "phi": _phi_increments,
    "psi": _psi_increments,
    "alpha": _alpha_increments,
    "beta": _beta_increments,
    "airspeed": _airspeed_increments,
}


# ---- Unknowns of each record in six degrees of freedom

# prior sigma (rad) of an angle that is not recorded and is a fitted constant of the record
_UNRECORDED_ANGLE_STD = 0.15
_BIAS_PRIOR_FACTOR = 5.0  # prior standard deviation of a bias, relative to a notable one
_WITHOUT_BIAS = ("psi", *HEIGHTS)  # a bias of these acts like another initial state


def unknowns_of(s: KinematicSignals) -> tuple[Unknown, ...]:
    """Return the unknowns of a record: the initial states, biases of channels and the vertical wind
    with wide priors, constants for angles that are not recorded, and the scale of a given airspeed.
    """
    unknowns = [Unknown(("start", name), 1e-3) for name in s.outputs]
    for name in s.channels:
        if name not in _WITHOUT_BIAS:
            size = SensorFault(name, BIAS).plausible
            unknowns.append(Unknown((name, BIAS), 0.02 * size, _BIAS_PRIOR_FACTOR * size))
    if any(name in s.outputs for name in HEIGHTS):
        unknowns.append(Unknown(("wind", BIAS), 1e-2, SensorFault("wind", BIAS).plausible))
    uses_theta = {"alpha", "phi", "psi", "beta"} & set(s.outputs)
    if "theta" not in s.channels and uses_theta:
        unknowns.append(Unknown(("level", "theta"), 1e-3, _UNRECORDED_ANGLE_STD))
    if "alpha" not in s.channels and "beta" in s.outputs:
        unknowns.append(Unknown(("level", "alpha"), 1e-3, _UNRECORDED_ANGLE_STD))
    if "airspeed" not in s.channels and {"alpha", "beta"} & set(s.outputs):
        unknowns.append(Unknown(("airspeed", SCALE), 1e-3, AIRSPEED_UNCERTAINTY))
    return tuple(unknowns)


def start_of(s: KinematicSignals, unknowns: Sequence[Unknown]) -> np.ndarray:
    """Return the starting values of the unknowns: for an initial state the median of its first
    valid samples, and zero for all others.
    """
    keys = [item.key for item in unknowns]
    return np.array([initial_state(s, name) if kind == "start" else 0.0 for kind, name in keys])


def faults_of(s: KinematicSignals, chord: float = 0.0) -> tuple[SensorFault, ...]:
    """Return all possible faults of the sensors of a record except biases, which are unknowns of
    each record. ``chord`` in m.
    """
    channels = tuple(s.channels)
    faults = [SensorFault(name, kind) for name in channels for kind in (SCALE, DELAY, LAG, DRIFT)]
    arm_kinds: dict[str, list[str]] = {"alpha": [ARM, RIGHT], "beta": [ARM, BELOW]}
    loads = {axis: load_on(axis, channels) for axis in "xyz"}
    for axis, kinds in (("x", [RIGHT, BELOW]), ("y", [ARM, BELOW]), ("z", [ARM, RIGHT])):
        if (name := loads[axis]) is not None:
            arm_kinds[name] = kinds
    if sum(name is not None for name in loads.values()) > 1:
        arm_kinds[PACKAGE] = [ARM, RIGHT, BELOW]
    if {"alpha", "beta"} <= set(channels):
        arm_kinds[BOOM] = [ARM]
    # rates on which the effect of each arm depends; at least one must be recorded
    rates_of_arm = {
        BOOM: {ARM: "qr"},
        "alpha": {ARM: "q", RIGHT: "p"},
        "beta": {ARM: "r", BELOW: "p"},
        PACKAGE: {ARM: "qr", RIGHT: "pr", BELOW: "pq"},
    }
    rates_of_arm |= dict(
        zip(
            (loads[axis] or "" for axis in "xyz"),
            ({RIGHT: "r", BELOW: "q"}, {ARM: "r", BELOW: "p"}, {ARM: "q", RIGHT: "p"}),
            strict=True,
        )
    )
    for name, kinds in arm_kinds.items():
        if name in channels or name in (PACKAGE, BOOM):
            faults += [
                SensorFault(name, kind, chord)
                for kind in kinds
                if any(rate in channels for rate in rates_of_arm[name][kind])
            ]
    return tuple(faults)


def values_of(
    unknowns: Sequence[Unknown],
    faults: Sequence[SensorFault],
    unknown_values: np.ndarray,
    sizes: np.ndarray,
) -> Values:
    """Return the function ``value(channel, kind)``, which returns the P values of one unknown or
    fault: a column of ``unknown_values (P, n)`` or of ``sizes (P, k)``, and zero for any other.
    """
    table = columns_of(unknowns, faults, unknown_values, sizes)
    # A column of equal values is shortened to one row, so that its effect is computed only once.
    table = {key: rows[:1] if np.all(rows == rows[0]) else rows for key, rows in table.items()}
    zero = np.zeros((1, 1))
    return lambda channel, kind: table.get((channel, kind), zero)


def evaluate(
    s: KinematicSignals,
    unknowns: Sequence[Unknown],
    faults: Sequence[SensorFault],
    unknown_values: np.ndarray,
    sizes: np.ndarray,
) -> np.ndarray:
    """Return the outputs ``(m, P, N)`` for P sets of values: ``unknown_values (P, n)`` of the
    record, and ``sizes (P, k)`` of the faults.
    """
    result = reconstructed_outputs(s, values_of(unknowns, faults, unknown_values, sizes))
    return np.broadcast_to(result, (len(s.outputs), len(unknown_values), len(s.time)))


def linearised(
    s: KinematicSignals,
    unknowns: Sequence[Unknown],
    faults: Sequence[SensorFault],
    unknown_values: np.ndarray,
    sizes: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the outputs ``(m, N)`` and their derivatives ``(m, N, n + k)``: forward differences
    for the unknowns of the record, central ones for the faults.

    All unknowns and faults of one channel are varied in one call: quantities that do not depend on
    this channel are then computed only once.
    """
    n, k = len(unknowns), len(faults)
    step = np.array([item.step for item in unknowns] + [difference_step(fault) for fault in faults])
    centre = np.concatenate([unknown_values, sizes])
    y = evaluate(s, unknowns, faults, unknown_values[None], sizes[None])[:, 0]
    slope = np.empty((len(s.outputs), len(s.time), n + k))
    channel_of_column = [item.key[0] if item.key[0] != "start" else "" for item in unknowns] + [
        fault.channel for fault in faults
    ]
    for channel in dict.fromkeys(channel_of_column):
        columns = np.array([i for i, name in enumerate(channel_of_column) if name == channel])
        varied = np.repeat(centre[None], 2 * len(columns), axis=0)
        varied[np.arange(len(columns)), columns] += step[columns]
        central = columns >= n
        varied[len(columns) + np.flatnonzero(central), columns[central]] -= step[columns[central]]
        outputs = evaluate(s, unknowns, faults, varied[:, :n], varied[:, n:])
        difference = np.where(central, 2.0, 1.0) * step[columns]
        slope[:, :, columns] = (
            (outputs[:, : len(columns)] - outputs[:, len(columns) :]) / difference[:, None]
        ).transpose(0, 2, 1)
    return y, slope
