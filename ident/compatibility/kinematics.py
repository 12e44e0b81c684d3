"""Longitudinal kinematics: sensor faults, the relations between channels, and their unknowns.

Body axes, x forward, z down, wings level (Klein and Morelli, Aircraft System Identification, AIAA
2006, ch. 10, without lateral motion):

alpha_dot = q - (g/V) [nz cos(alpha) + (ax/g) sin(alpha) - cos(theta - alpha)],   theta_dot = q,
V_dot = ax cos(alpha) - g nz sin(alpha) - g sin(theta - alpha).

Without theta, the direction of gravity along the flight path is unknown. The first equation then
becomes, about the mean flight,

alpha_dot = q - (g/V) (nz - n0) + (g/V) (c1 d - c2 d^2/2)

with d the integral of (g/V) (nz - n0), c1 = -sin(gamma0), c2 = cos(gamma0), and gamma0 the mean
angle of the flight path. The constants n0, c1 and c2 are fitted. The prior of c2 has the mean 0.5:
c2 is near 1 in level flight, and 0 in records of linear equations of motion, where gravity does not
turn. Without ax, nz is taken as the load normal to the path.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ident.compatibility.signals import KinematicSignals
from sim.maths import G0, linear_recurrence

# ---- Sensor faults and the names of their effects

BIAS, SCALE, DELAY, LAG, DRIFT, ARM = "bias", "scale", "delay", "lag", "drift", "arm"
RIGHT = "arm-right"  # arm to the right; ARM is the arm ahead
BELOW = "arm-below"  # arm downward
ARMS = (ARM, RIGHT, BELOW)
VANES = ("alpha", "beta")
BOOM = "boom"  # both vanes on one boom
PACKAGE = "accelerometers"  # all accelerometers on one base
UNITS = {
    "alpha": "rad",
    "q": "rad/s",
    "nz": "g",
    "theta": "rad",
    "airspeed": "m/s",
    "ax": "m/s2",
    "beta": "rad",
    "phi": "rad",
    "psi": "rad",
    "p": "rad/s",
    "r": "rad/s",
    "ny": "g",
    "nx": "g",
    "ay": "m/s2",
    "az": "m/s2",
    "height": "m",
    "altitude": "m",
    "wind": "m/s",
}
_NOTABLE_BIASES = {  # common biases, in the unit of the channel
    "alpha": 0.02,
    "q": 0.005,
    "nz": 0.05,
    "theta": 0.02,
    "airspeed": 3.0,
    "ax": 0.3,
    "beta": 0.02,
    "phi": 0.02,
    "psi": 0.02,
    "p": 0.005,
    "r": 0.005,
    "ny": 0.03,
    "nx": 0.03,
    "ay": 0.3,
    "az": 0.5,
    "height": 10.0,
    "altitude": 10.0,
    "wind": 3.0,
}


@dataclass(frozen=True)
class SensorFault:
    """One kind of fault of one channel. A correct sensor has a fault of size zero.

    The sizes of the kinds are

    - bias: addition to the reading, in the unit of the channel
    - scale: the reading is (1 + size) times the true value
    - delay, lag: time in s by which the reading is late
    - drift: growth of a bias from the begin of the record, in the unit of the channel per s
    - arm, arm-right, arm-below: m, distance of a vane or an accelerometer ahead of the centre of
      gravity, to the right of it and below it

    Attributes
    ----------
    channel : name of the channel, or ``BOOM`` or ``PACKAGE``.
    kind : one of the kinds above.
    chord : mean aerodynamic chord, m; zero where it is not known.
    """

    channel: str
    kind: str
    chord: float = field(default=0.0, compare=False)

    @property
    def spread(self) -> float:
        """Standard deviation of the sizes among aircraft; infinite where it is unknown.

        Many vanes are on a boom, some metres ahead: the arm has 5 m, or three chords of a large
        aircraft. An accelerometer is within about half a chord of the centre of gravity: its arm
        has 1 m, or a quarter of a chord. A delay or lag may be confused with an arm, and its
        standard deviation is its plausible size.
        """
        if self.kind in (DELAY, LAG):
            return self.plausible
        if self.kind not in ARMS:
            return float("inf")
        if self.channel in (*VANES, BOOM):
            return max(5.0, 3.0 * self.chord)
        return max(1.0, 0.25 * self.chord)

    def prior_loss(self, size: float | np.ndarray, variance: float | np.ndarray) -> np.ndarray:
        """Return the loss of log likelihood by the prior, with its standard deviation ``spread``,
        for an estimated size with its variance.
        """
        return np.asarray(0.5 * np.square(size) / (self.spread**2 + variance))

    @property
    def name(self) -> str:
        """Name of the effect in the library. A bias, which is no effect, is ``bias:CHANNEL``."""
        if self.kind == BIAS:
            return f"bias:{self.channel}"
        if self.kind not in ARMS:
            return f"sensor-{self.kind}:{self.channel}"
        sensor = "vane-offset" if self.channel in (*VANES, BOOM) else "accelerometer-offset"
        needs_no_channel = self.channel == PACKAGE or (self.channel, self.kind) == ("alpha", ARM)
        suffix = "" if needs_no_channel else f":{self.channel}"
        return f"{sensor}{self.kind.removeprefix(ARM)}{suffix}"

    @property
    def unit(self) -> str:
        """Unit of the size."""
        of_kind = {SCALE: "1", DELAY: "s", LAG: "s"} | dict.fromkeys(ARMS, "m")
        if self.kind in of_kind:
            return of_kind[self.kind]
        return f"{UNITS[self.channel]}/s" if self.kind == DRIFT else UNITS[self.channel]

    @property
    def plausible(self) -> float:
        """A common size. A fault is observable if its sigma is smaller."""
        of_kind = {SCALE: 0.1, DELAY: 0.05, LAG: 0.05} | dict.fromkeys(ARMS, 5.0)
        if self.kind in of_kind:
            return of_kind[self.kind]
        bias = _NOTABLE_BIASES[self.channel]
        return 0.05 * bias if self.kind == DRIFT else bias  # a drift reaches a bias in 20 s

    @property
    def smallest_finding(self) -> float:
        """Smallest size that counts as a finding. Errors of interpolation and of the airspeed can
        look like smaller faults.
        """
        return 0.1 * self.plausible

    @property
    def largest(self) -> float:
        """Bound of the absolute size."""
        of_kind = {SCALE: 0.6, DELAY: 0.5, LAG: 0.5} | dict.fromkeys(ARMS, 60.0)
        return of_kind.get(self.kind, 1e6)

    @property
    def one_sided(self) -> bool:
        """Whether only a positive size is possible: no delay is negative, and no vane is behind the
        centre of gravity.
        """
        return self.kind in (DELAY, LAG) or (self.kind == ARM and self.channel in (*VANES, BOOM))

    @property
    def rare(self) -> bool:
        """Whether a more common fault has the same effect. An accelerometer ahead of the centre of
        gravity has the effect of a lag of q or r, and one behind it that of an arm of the vane.
        """
        return self.kind == ARM and self.channel in ("nz", "az", "ny", "ay")

    @property
    def offset(self) -> float:
        """Parameter of the effect minus the size: 1 for a scale, whose parameter is the factor
        1 + size, else 0.
        """
        return 1.0 if self.kind == SCALE else 0.0


def faults_of(
    channels: Sequence[str], *, drifts: bool, biases: bool = False, chord: float = 0.0
) -> tuple[SensorFault, ...]:
    """Return all faults of these channels, with drifts and biases where wanted. ``chord`` in m."""
    kinds = (*([BIAS] if biases else []), SCALE, DELAY, LAG, *([DRIFT] if drifts else []))
    faults = [SensorFault(channel, kind) for channel in channels for kind in kinds]
    if {"alpha", "q"} <= set(channels):
        faults += [
            SensorFault(channel, ARM, chord) for channel in ("alpha", "nz") if channel in channels
        ]
    return tuple(faults)


# ---- The kinematic relations, integrated over measured inputs

# function of channel and kind that returns the size in each of P sets, (P, 1), or zero (1, 1) for a
# fault that is not fitted
Values = Callable[[str, str], np.ndarray]
# sweeps that solve for alpha, which is on both sides of its relation; each sweep reduces the error
# by a factor of ten or more
_FIXED_POINT_SWEEPS = 5
_SHORTEST_LAG = 1e-4  # s: a shorter lag acts to first order only


def reconstructed_outputs(s: KinematicSignals, value: Values) -> np.ndarray:
    """Return the outputs ``(m, P, N)`` that sensors with P sets of faults should read.

    ``value`` gives the sizes of the faults. It also gives the initial states ``("start", STATE)``,
    ``("turn", "1")`` = c1, ``("turn", "2")`` = c2 - 0.5, and ``("jump", "nz")``, the error of the
    integral of an nz that jumps between two samples, as a share of half a sampling interval.
    """
    h = s.steps
    speed = s.speed
    if "airspeed" in s.channels:
        speed = (speed - value("airspeed", BIAS)) / (1.0 + value("airspeed", SCALE))
    inverse_speed = 1.0 / midpoints(speed)
    inputs = {
        name: true_increments(s, name, value, h) for name in ("q", "nz", "ax") if name in s.channels
    }
    if "nz" in inputs and np.any(value("nz", ARM)):
        # Ahead of the centre of gravity an accelerometer measures nz + (arm/g0) q_dot.
        inputs["nz"] = inputs["nz"] - value("nz", ARM) / G0 * np.diff(true_samples(s, "q", value))
    states: dict[str, np.ndarray] = {}
    if "theta" in s.outputs or "theta" in s.channels:
        states["theta"] = value("start", "theta") + cumulative(inputs["q"])
    if "alpha" in s.outputs:
        load = G0 * inverse_speed * inputs["nz"]
        if s.jumps.size:
            load = load + value("jump", "nz") * G0 * inverse_speed * h * 0.5 * np.diff(s.jumps)
        if "theta" in s.channels:
            alpha = _alpha_with_theta(s, value, inputs, inverse_speed, load, states["theta"], h)
        else:
            turn = cumulative(load)
            gravity = (
                s.gravity
                * inverse_speed
                * h
                * midpoints(value("turn", "1") * turn - 0.5 * (0.5 + value("turn", "2")) * turn**2)
            )
            alpha = value("start", "alpha") + cumulative(inputs["q"] - load + gravity)
        states["alpha"] = alpha
    if "airspeed" in s.outputs:
        a, climb = states["alpha"], states["theta"] - states["alpha"]
        change = (
            midpoints(np.cos(a)) * inputs["ax"]
            - G0 * midpoints(np.sin(a)) * inputs["nz"]
            - s.gravity * h * midpoints(np.sin(climb))
        )
        states["airspeed"] = value("start", "airspeed") + cumulative(change)
    vane_arm = value("alpha", ARM) + s.vane_arm
    if "alpha" in s.outputs and np.any(vane_arm):
        states["alpha"] = states["alpha"] - vane_arm / speed * true_samples(s, "q", value)
    readings = [sensor_reading(s, name, states[name], value) for name in s.outputs]
    width = max(row.shape[0] for row in readings)
    return np.array([np.broadcast_to(row, (width, len(s.time))) for row in readings])


def _alpha_with_theta(
    s: KinematicSignals,
    value: Values,
    inputs: dict[str, np.ndarray],
    inverse_speed: np.ndarray,
    load: np.ndarray,
    theta: np.ndarray,
    h: np.ndarray,
) -> np.ndarray:
    """Return alpha ``(P, N)`` where theta is recorded, by fixed-point sweeps."""
    alpha = s.channels["alpha"][None]
    for _ in range(_FIXED_POINT_SWEEPS):
        gravity = s.gravity * inverse_speed * h * midpoints(np.cos(theta - alpha))
        if "ax" in inputs:
            change = (
                inputs["q"]
                - load * midpoints(np.cos(alpha))
                - inverse_speed * inputs["ax"] * midpoints(np.sin(alpha))
                + gravity
            )
        else:
            change = inputs["q"] - load + gravity
        alpha = value("start", "alpha") + cumulative(change)
    return alpha


def true_increments(s: KinematicSignals, name: str, value: Values, h: np.ndarray) -> np.ndarray:
    """Return the integral ``(P, N - 1)`` of the true signal over each interval of length ``h
    (N - 1,)``, s, from its faulty reading, which is taken as cubic between samples.
    """
    x, t = s.channels[name], s.time
    delay, lag = value(name, DELAY), value(name, LAG)
    # The trapezoidal rule with end correction integrates cubic pieces exactly. Corrections cancel
    # between equal intervals, so that only noise at both ends acts otherwise than without them.
    integral = np.concatenate(
        [[0.0], np.cumsum(0.5 * h * (x[1:] + x[:-1]) - h**2 / 12.0 * np.diff(_slopes(x, t)))]
    )
    change = np.diff(_shifted(t, integral, x, delay)) if np.any(delay) else np.diff(integral)[None]
    if np.any(lag):
        change = change + lag * np.diff(
            _shifted(t, x, _slopes(x, t), delay) if np.any(delay) else x[None]
        )
    error = value(name, BIAS) + value(name, DRIFT) * (midpoints(t) - t[0])
    return np.asarray((change - error * h) / (1.0 + value(name, SCALE)))


def true_samples(s: KinematicSignals, name: str, value: Values) -> np.ndarray:
    """Return the true signal ``(P, N)`` at the samples, from its faulty reading."""
    signal, t = s.channels[name][None], s.time
    delay, lag = value(name, DELAY), value(name, LAG)
    if np.any(lag):
        signal = signal + lag * _slopes(signal, t)
    if np.any(delay):
        signal = _shifted(t, signal, _slopes(signal, t), delay)
    return np.asarray(
        (signal - value(name, BIAS) - value(name, DRIFT) * (t - t[0])) / (1.0 + value(name, SCALE))
    )


def sensor_reading(s: KinematicSignals, name: str, y: np.ndarray, value: Values) -> np.ndarray:
    """Return the reading ``(P, N)`` of a sensor whose true signal is ``y (P, N)``. Lag, delay,
    scale, bias and drift act in this order.
    """
    t = s.time
    delay, lag = value(name, DELAY), value(name, LAG)
    if np.any(lag):
        y = _lagged(y, _slopes(y, t), t, lag)
    if np.any(delay):
        y = _shifted(t, y, _slopes(y, t), -delay)
    return np.asarray(
        (1.0 + value(name, SCALE)) * y + value(name, BIAS) + value(name, DRIFT) * (t - t[0])
    )


def _lagged(y: np.ndarray, dy: np.ndarray, t: np.ndarray, lag: np.ndarray) -> np.ndarray:
    """Return a signal ``y (P, N)``, linear between samples, after first-order lags ``(P, 1)``, s.

    ``dy (P, N)`` are the slopes of y. The response starts in the steady state of a ramp with the
    first slope. A negative lag is a lead.
    """
    lag = np.broadcast_to(lag, (max(len(y), len(lag)), 1))
    y, dy = np.broadcast_to(y, (len(lag), y.shape[1])), np.broadcast_to(dy, (len(lag), y.shape[1]))
    lagged = y - lag * dy
    h = np.diff(t)
    for i in np.flatnonzero(lag[:, 0] > _SHORTEST_LAG):
        tau = float(lag[i, 0])
        decay = np.exp(-h / tau)
        v0, v1 = y[i, :-1], y[i, 1:]
        lagged[i] = linear_recurrence(
            decay, v1 - (v1 - v0) * (tau / h * (1.0 - decay)) - v0 * decay, lagged[i, 0]
        )
    return lagged


def _shifted(t: np.ndarray, y: np.ndarray, dy: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Return y(t + by), ``(P, N)``: cubic with slopes ``dy``, linear beyond the ends."""
    if y.ndim == 1:  # one signal for all P shifts, most of which are equal
        shifts, which = np.unique(by[:, 0], return_inverse=True)
        rows = [_shifted_by_one_time(t, y[None], dy[None], float(shift)) for shift in shifts]
        return np.concatenate(rows)[which.reshape(-1)]
    count = max(len(y), len(by))
    y, dy = np.broadcast_to(y, (count, len(t))), np.broadcast_to(dy, (count, len(t)))
    by = np.broadcast_to(by, (count, 1))[:, 0]
    shifted = np.empty((count, len(t)))
    for shift in np.unique(by):
        equal = by == shift
        shifted[equal] = _shifted_by_one_time(t, y[equal], dy[equal], float(shift))
    return shifted


def _shifted_by_one_time(t: np.ndarray, y: np.ndarray, dy: np.ndarray, by: float) -> np.ndarray:
    """Return y(t + by) for rows ``y (P, N)`` and one time ``by``, s, as `_shifted` does."""
    at = t + by
    k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
    h = t[k + 1] - t[k]
    u = np.clip((at - t[k]) / h, 0.0, 1.0)
    # Hermite weights of the values and slopes at both ends of an interval. Beyond the record only
    # the value and the slope at its end count.
    w1 = u * u * (3.0 - 2.0 * u)
    m0 = h * u * (1.0 - u) ** 2 + np.where(at < t[0], at - t[0], 0.0)
    m1 = h * u * u * (u - 1.0) + np.where(at > t[-1], at - t[-1], 0.0)
    return np.asarray((1.0 - w1) * y[:, k] + w1 * y[:, k + 1] + m0 * dy[:, k] + m1 * dy[:, k + 1])


def midpoints(x: np.ndarray) -> np.ndarray:
    """Return the means of successive samples along the last axis."""
    return np.asarray(0.5 * (x[..., 1:] + x[..., :-1]))


def cumulative(increments: np.ndarray) -> np.ndarray:
    """Return the cumulative sum ``(P, N)``, with a first zero, of increments ``(P, N - 1)``."""
    increments = np.atleast_2d(increments)
    total = np.zeros((len(increments), increments.shape[1] + 1))
    np.cumsum(increments, axis=1, out=total[:, 1:])
    return total


def _slopes(y: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return the slopes of ``y``, by parabolas through three samples; lines at the ends."""
    h = np.diff(t)
    secants = np.diff(y, axis=-1) / h
    inner = (secants[..., :-1] * h[1:] + secants[..., 1:] * h[:-1]) / (h[1:] + h[:-1])
    return np.concatenate([secants[..., :1], inner, secants[..., -1:]], axis=-1)


# ---- Unknowns of each record

Key = tuple[str, str]
# relative sigma of an airspeed that is declared and not recorded; its error acts like a scale of nz
AIRSPEED_UNCERTAINTY = 0.015
FIRST_SAMPLES = 5  # valid samples whose median is an initial state


@dataclass(frozen=True)
class Unknown:
    """An unknown of one record in every fit.

    Attributes
    ----------
    key : the arguments with which `Values` returns it.
    step : step of its finite difference.
    prior : sigma of its prior about zero; infinite without one.
    """

    key: Key
    step: float
    prior: float = float("inf")


def unknowns_of(s: KinematicSignals) -> tuple[Unknown, ...]:
    """Return the unknowns of a record.

    They are the initial states and the biases of the inputs. Further unknowns are c1 and c2 where
    theta is not recorded, the error of the declared airspeed where none is recorded, and the error
    of the integral of nz where nz jumps with a held input.
    """
    unknowns = [Unknown(("start", name), 1e-3) for name in s.outputs]
    if "theta" in s.outputs:
        unknowns.append(Unknown(("q", BIAS), 1e-4))
    if "alpha" in s.outputs:
        unknowns.append(Unknown(("nz", BIAS), 1e-3))
        if "airspeed" not in s.channels:
            unknowns.append(Unknown(("nz", SCALE), 1e-3, AIRSPEED_UNCERTAINTY))
        if "theta" not in s.channels:
            unknowns += [Unknown(("turn", "1"), 1e-3, 0.2), Unknown(("turn", "2"), 1e-2, 0.5)]
        if s.jumps.size:
            unknowns.append(Unknown(("jump", "nz"), 1e-2, 1.0))
    if "airspeed" in s.outputs:
        unknowns.append(Unknown(("ax", BIAS), 1e-3))
    return tuple(unknowns)


def start_of(s: KinematicSignals, unknowns: Sequence[Unknown]) -> np.ndarray:
    """Return the starting values of the unknowns: zero except for initial states and the bias of
    nz.

    An initial state starts at the median of the first valid samples. The bias of nz starts at 0 for
    a total load and at -1 g for an incremental load, or at the mean of nz where theta is missing.
    """
    start = np.zeros(len(unknowns))
    for i, item in enumerate(unknowns):
        channel, kind = item.key
        if channel == "start":
            start[i] = initial_state(s, kind)
        elif item.key == ("nz", BIAS):
            level = float(np.mean(s.channels["nz"]))
            if "theta" not in s.channels:
                start[i] = level
            else:
                start[i] = 0.0 if level > 0.5 else -1.0
    return start


def initial_state(s: KinematicSignals, name: str) -> float:
    """Return the median of the first valid samples of an output."""
    first = np.flatnonzero(s.valid[s.outputs.index(name)])[:FIRST_SAMPLES]
    return float(np.median(s.channels[name][first])) if first.size else 0.0


def columns_of(
    unknowns: Sequence[Unknown],
    faults: Sequence[SensorFault],
    unknown_values: np.ndarray,
    sizes: np.ndarray,
) -> dict[Key, np.ndarray]:
    """Return the key of each unknown and fault -> its values ``(P, 1)``. The arguments are those of
    `evaluate`.
    """
    table = {item.key: unknown_values[:, i : i + 1] for i, item in enumerate(unknowns)}
    for j, fault in enumerate(faults):
        key = (fault.channel, fault.kind)
        table[key] = table[key] + sizes[:, j : j + 1] if key in table else sizes[:, j : j + 1]
    return table


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
    table, none = columns_of(unknowns, faults, unknown_values, sizes), np.zeros((1, 1))
    return reconstructed_outputs(s, lambda channel, kind: table.get((channel, kind), none))


def difference_step(fault: SensorFault) -> float:
    """Return the step of a central difference in the size of a fault."""
    return 0.004 if fault.kind in (DELAY, LAG) else 1e-3 * fault.plausible


def linearised(
    s: KinematicSignals,
    unknowns: Sequence[Unknown],
    faults: Sequence[SensorFault],
    unknown_values: np.ndarray,
    sizes: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the outputs ``(m, N)`` and their derivatives ``(m, N, n + k)``: forward differences
    for the unknowns of the record, central ones for the faults.
    """
    n, k = len(unknowns), len(faults)
    step = np.array([item.step for item in unknowns] + [difference_step(fault) for fault in faults])
    centre = np.concatenate([unknown_values, sizes])
    points = np.concatenate([centre[None], centre + np.diag(step), (centre - np.diag(step))[n:]])
    y = np.broadcast_to(
        evaluate(s, unknowns, faults, points[:, :n], points[:, n:]),
        (len(s.outputs), n + 2 * k + 1, len(s.time)),
    )
    slope = np.empty((len(s.outputs), n + k, len(s.time)))
    slope[:, :n] = (y[:, 1 : n + 1] - y[:, :1]) / step[:n, None]
    slope[:, n:] = (y[:, n + 1 : n + k + 1] - y[:, n + k + 1 :]) / (2.0 * step[n:, None])
    return y[:, 0], slope.transpose(0, 2, 1)
