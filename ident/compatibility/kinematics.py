"""Longitudinal kinematics: sensor faults, the relations between channels, and their unknowns.

Body axes, x forward, z down, wings level (Klein and Morelli, Aircraft System Identification, AIAA
2006, ch. 10, without lateral motion):

alpha_dot = q - (g/V) [nz cos(alpha) + (ax/g) sin(alpha) - cos(theta - alpha)],   theta_dot = q,
V_dot = ax cos(alpha) - g nz sin(alpha) - g sin(theta - alpha).

Without theta gravity's turn along the path is unknown and the first becomes, about the mean flight,
alpha_dot = q - (g/V) (nz - n0) + (g/V) (c1 d - c2 d^2/2), d = integral of (g/V)(nz - n0): c1 =
-sin(gamma0), c2 = cos(gamma0) and n0 are free, c2 about 0.5: in records of linear equations gravity
does not turn and c2 is zero. Without ax, nz is the load normal to the path.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ident.compatibility.signals import KinematicSignals
from sim.maths import G0, linear_recurrence

# ---- Sensor faults, by the names of their effects

BIAS, SCALE, DELAY, LAG, DRIFT, ARM = "bias", "scale", "delay", "lag", "drift", "arm"
RIGHT = "arm-right"  # position of a sensor along the right wing, as ARM along the fuselage
BELOW = "arm-below"  # position of a sensor downward
ARMS = (ARM, RIGHT, BELOW)
VANES = ("alpha", "beta")
BOOM = "boom"  # both vanes, on one boom
PACKAGE = "accelerometers"  # all of them, on one base
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
_NOTABLE_BIASES = {  # smallest biases to be told, in the unit of the channel
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
    """One fault of one channel; ``size`` zero is a correct sensor.

    bias: added, channel's unit. scale: the reading is (1 + size) times the true value. delay, lag:
    s, the reading is late. drift: channel's unit/s from the record's begin. arm: m, the vane
    (alpha, beta) or the accelerometer (nz, all others in six degrees of freedom) ahead of the
    centre of gravity; arm-right, arm-below: m, to the right of it and below.
    """

    channel: str
    kind: str
    chord: float = field(default=0.0, compare=False)  # m, zero where it is not known

    @property
    def spread(self) -> float:
        """Standard deviation of the sizes on aircraft; infinite if unknown.

        A vane on a boom metres ahead is common: 5 m, or three chords of a large aircraft. An
        accelerometer is mounted within about half a chord of the centre of gravity: 1 m, or a
        quarter of a chord, so that half a chord is two of these. A delay or lag, confusable with an
        arm, has its common size.
        """
        if self.kind in (DELAY, LAG):
            return self.plausible
        if self.kind not in ARMS:
            return float("inf")
        return (
            max(5.0, 3.0 * self.chord)
            if self.channel in (*VANES, BOOM)
            else max(1.0, 0.25 * self.chord)
        )

    def surprise(self, size: float | np.ndarray, variance: float | np.ndarray) -> np.ndarray:
        """Return the log likelihood lost by the prior ``spread``, for an estimate with its
        variance.
        """
        return np.asarray(0.5 * np.square(size) / (self.spread**2 + variance))

    @property
    def name(self) -> str:
        """The effect's name; ``bias:CH`` for a bias, which is no effect."""
        if self.kind in ARMS:
            sensor = "vane-offset" if self.channel in (*VANES, BOOM) else "accelerometer-offset"
            of = (
                ""
                if self.channel == PACKAGE or (self.channel, self.kind) == ("alpha", ARM)
                else f":{self.channel}"
            )
            return f"{sensor}{self.kind.removeprefix(ARM)}{of}"
        return f"bias:{self.channel}" if self.kind == BIAS else f"sensor-{self.kind}:{self.channel}"

    @property
    def unit(self) -> str:
        """Unit of its size."""
        own = {SCALE: "1", DELAY: "s", LAG: "s"} | dict.fromkeys(ARMS, "m")
        return own.get(self.kind) or (
            f"{UNITS[self.channel]}/s" if self.kind == DRIFT else UNITS[self.channel]
        )

    @property
    def plausible(self) -> float:
        """A common size: the unit of observability."""
        own = {SCALE: 0.1, DELAY: 0.05, LAG: 0.05} | dict.fromkeys(ARMS, 5.0)
        return own.get(self.kind) or (
            0.05 * _NOTABLE_BIASES[self.channel]
            if self.kind == DRIFT
            else _NOTABLE_BIASES[self.channel]
        )

    @property
    def smallest_finding(self) -> float:
        """Smallest size that counts as a finding; smaller ones come from interpolation and airspeed
        errors.
        """
        return 0.1 * self.plausible

    @property
    def largest(self) -> float:
        """The largest size that is searched, either sign."""
        own = {SCALE: 0.6, DELAY: 0.5, LAG: 0.5} | dict.fromkeys(ARMS, 60.0)
        return own.get(self.kind, 1e6)

    @property
    def one_sided(self) -> bool:
        """Whether only a positive size is possible: no delay is negative, no vane is behind."""
        return self.kind in (DELAY, LAG) or (self.kind == ARM and self.channel in (*VANES, BOOM))

    @property
    def rare(self) -> bool:
        """Whether a more common fault has the same effect: an accelerometer ahead equals a lag of q
        or r, one behind an arm of the vane.
        """
        return self.kind == ARM and self.channel in ("nz", "az", "ny", "ay")

    @property
    def offset(self) -> float:
        """Added to the size for the effect's own parameter: 1 for a scale, which is a factor."""
        return 1.0 if self.kind == SCALE else 0.0


def faults_of(
    channels: Sequence[str], *, drifts: bool, biases: bool = False, chord: float = 0.0
) -> tuple[SensorFault, ...]:
    """Return all faults of these channels, in their order."""
    kinds = (*([BIAS] if biases else []), SCALE, DELAY, LAG, *([DRIFT] if drifts else []))
    out = [SensorFault(channel, kind) for channel in channels for kind in kinds]
    if {"alpha", "q"} <= set(channels):
        out += [
            SensorFault(channel, ARM, chord) for channel in ("alpha", "nz") if channel in channels
        ]
    return tuple(out)


# ---- The kinematic relations, integrated over measured inputs

# (channel, kind) -> sizes (P, 1); zero where nothing is fitted
Values = Callable[[str, str], np.ndarray]
# alpha on the right-hand side has small factors: each sweep gains a factor of ten or more
_FIXED_POINT_SWEEPS = 5


def reconstructed(s: KinematicSignals, value: Values) -> np.ndarray:
    """Return the outputs ``(m, P, N)`` that sensors with these faults should read, for sizes ``(P,
    1)``.

    Besides the faults, ``value`` gives ``("start", STATE)``, ``("turn", "1")`` = c1, ``("turn",
    "2")`` = c2 - 0.5 and ``("jump", "nz")``.
    """
    h = s.steps
    speed = s.speed
    if "airspeed" in s.channels:
        speed = (speed - value("airspeed", BIAS)) / (1.0 + value("airspeed", SCALE))
    over_speed = 1.0 / middle(speed)
    inputs = {
        name: increments(s, name, value, h) for name in ("q", "nz", "ax") if name in s.channels
    }
    if "nz" in inputs and np.any(value("nz", ARM)):
        # An accelerometer ahead feels the pitch acceleration too: nz + (arm/g0) q_dot.
        inputs["nz"] = inputs["nz"] - value("nz", ARM) / G0 * np.diff(samples(s, "q", value))
    states: dict[str, np.ndarray] = {}
    if "theta" in s.outputs or "theta" in s.channels:
        states["theta"] = value("start", "theta") + summed(inputs["q"])
    if "alpha" in s.outputs:
        load = G0 * over_speed * inputs["nz"]
        if s.jumps.size:
            load = load + value("jump", "nz") * G0 * over_speed * h * 0.5 * np.diff(s.jumps)
        if "theta" in s.channels:
            alpha = _with_theta(s, value, inputs, over_speed, load, states["theta"], h)
        else:
            turn = summed(load)
            bend = (
                s.gravity
                * over_speed
                * h
                * middle(value("turn", "1") * turn - 0.5 * (0.5 + value("turn", "2")) * turn**2)
            )
            alpha = value("start", "alpha") + summed(inputs["q"] - load + bend)
        states["alpha"] = alpha
    if "airspeed" in s.outputs:
        a, climb = states["alpha"], states["theta"] - states["alpha"]
        push = (
            middle(np.cos(a)) * inputs["ax"]
            - G0 * middle(np.sin(a)) * inputs["nz"]
            - s.gravity * h * middle(np.sin(climb))
        )
        states["airspeed"] = value("start", "airspeed") + summed(push)
    out = [_read(s, name, states[name], value, speed) for name in s.outputs]
    width = max(row.shape[0] for row in out)
    return np.array([np.broadcast_to(row, (width, len(s.time))) for row in out])


def _with_theta(
    s: KinematicSignals,
    value: Values,
    inputs: dict[str, np.ndarray],
    over_speed: np.ndarray,
    load: np.ndarray,
    theta: np.ndarray,
    h: np.ndarray,
) -> np.ndarray:
    alpha = s.channels["alpha"][None]
    for _ in range(_FIXED_POINT_SWEEPS):
        gravity = s.gravity * over_speed * h * middle(np.cos(theta - alpha))
        if "ax" in inputs:
            change = (
                inputs["q"]
                - load * middle(np.cos(alpha))
                - over_speed * inputs["ax"] * middle(np.sin(alpha))
                + gravity
            )
        else:
            change = inputs["q"] - load + gravity
        alpha = value("start", "alpha") + summed(change)
    return alpha


def increments(s: KinematicSignals, name: str, value: Values, h: np.ndarray) -> np.ndarray:
    """Return the integral of the true signal over each interval from its faulty reading, cubic
    between samples: ``(P, N - 1)``.
    """
    x, t = s.channels[name], s.time
    delay, lag = value(name, DELAY), value(name, LAG)
    # The trapezoid with the correction of its ends: cubic pieces, whose noise is the trapezoid's
    # but for two samples.
    whole = np.concatenate(
        [[0.0], np.cumsum(0.5 * h * (x[1:] + x[:-1]) - h**2 / 12.0 * np.diff(_slopes(x, t)))]
    )
    read = np.diff(_shifted(t, whole, x, delay)) if np.any(delay) else np.diff(whole)[None]
    if np.any(lag):
        read = read + lag * np.diff(
            _shifted(t, x, _slopes(x, t), delay) if np.any(delay) else x[None]
        )
    wrong = value(name, BIAS) + value(name, DRIFT) * (middle(t) - t[0])
    return np.asarray((read - wrong * h) / (1.0 + value(name, SCALE)))


def samples(s: KinematicSignals, name: str, value: Values) -> np.ndarray:
    """Return the true signal at the samples from its faulty reading: ``(P, N)``."""
    read, t = s.channels[name][None], s.time
    delay, lag = value(name, DELAY), value(name, LAG)
    if np.any(lag):
        read = read + lag * _slopes(read, t)
    if np.any(delay):
        read = _shifted(t, read, _slopes(read, t), delay)
    return np.asarray(
        (read - value(name, BIAS) - value(name, DRIFT) * (t - t[0])) / (1.0 + value(name, SCALE))
    )


def _read(
    s: KinematicSignals, name: str, state: np.ndarray, value: Values, speed: np.ndarray
) -> np.ndarray:
    """Return the reading of a state's sensor: arm (with the true pitch rate), then the faults of
    ``shown``.
    """
    arm = value(name, ARM) + s.vane_arm
    if name == "alpha" and np.any(arm):
        state = state - arm / speed * samples(s, "q", value)
    return shown(s, name, state, value)


def shown(s: KinematicSignals, name: str, y: np.ndarray, value: Values) -> np.ndarray:
    """Return the reading of a sensor of a signal ``(P, N)``: lag, delay, scale, bias and drift, in
    this order.
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
    """First-order lag of a signal that runs straight between samples, settled on its first slope; a
    negative lag is a lead.
    """
    lag = np.broadcast_to(lag, (max(len(y), len(lag)), 1))
    y, dy = np.broadcast_to(y, (len(lag), y.shape[1])), np.broadcast_to(dy, (len(lag), y.shape[1]))
    out = y - lag * dy
    h = np.diff(t)
    for i in np.flatnonzero(lag[:, 0] > 1e-4):
        tau = float(lag[i, 0])
        decay = np.exp(-h / tau)
        v0, v1 = y[i, :-1], y[i, 1:]
        out[i] = linear_recurrence(
            decay, v1 - (v1 - v0) * (tau / h * (1.0 - decay)) - v0 * decay, out[i, 0]
        )
    return out


def _shifted(t: np.ndarray, y: np.ndarray, dy: np.ndarray, by: np.ndarray) -> np.ndarray:
    """``y(t + by)`` for ``by (P, 1)`` by cubic pieces with slopes ``dy``, straight beyond the ends:
    ``(P, N)``.
    """
    if y.ndim == 1:  # one signal at few different shifts, most of them alike
        each, which = np.unique(by[:, 0], return_inverse=True)
        return np.concatenate([_moved(t, y[None], dy[None], float(shift)) for shift in each])[
            which.reshape(-1)
        ]
    rows = max(len(y), len(by))
    y, dy, by = (
        np.broadcast_to(y, (rows, len(t))),
        np.broadcast_to(dy, (rows, len(t))),
        np.broadcast_to(by, (rows, 1))[:, 0],
    )
    out = np.empty((rows, len(t)))
    for shift in np.unique(by):
        chosen = by == shift
        out[chosen] = _moved(t, y[chosen], dy[chosen], float(shift))
    return out


def _moved(t: np.ndarray, y: np.ndarray, dy: np.ndarray, by: float) -> np.ndarray:
    """``y(t + by)`` of rows ``(P, N)``, all by the same time."""
    at = t + by
    k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
    h = t[k + 1] - t[k]
    u = np.clip((at - t[k]) / h, 0.0, 1.0)
    # Weights of both values and both slopes, beyond an end only of the last slope there.
    w1 = u * u * (3.0 - 2.0 * u)
    m0 = h * u * (1.0 - u) ** 2 + np.where(at < t[0], at - t[0], 0.0)
    m1 = h * u * u * (u - 1.0) + np.where(at > t[-1], at - t[-1], 0.0)
    return np.asarray((1.0 - w1) * y[:, k] + w1 * y[:, k + 1] + m0 * dy[:, k] + m1 * dy[:, k + 1])


def middle(x: np.ndarray) -> np.ndarray:
    """Return the means of neighbouring samples along the last axis."""
    return np.asarray(0.5 * (x[..., 1:] + x[..., :-1]))


def summed(increments: np.ndarray) -> np.ndarray:
    """Return the samples ``(P, N)``, the first one zero, from increments ``(P, N - 1)``."""
    increments = np.atleast_2d(increments)
    out = np.zeros((len(increments), increments.shape[1] + 1))
    np.cumsum(increments, axis=1, out=out[:, 1:])
    return out


def _slopes(y: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return the slopes by parabolas through three neighbours, at the ends by straight lines."""
    h = np.diff(t)
    steep = np.diff(y, axis=-1) / h
    inner = (steep[..., :-1] * h[1:] + steep[..., 1:] * h[:-1]) / (h[1:] + h[:-1])
    return np.concatenate([steep[..., :1], inner, steep[..., -1:]], axis=-1)


# ---- Unknowns of each record

Key = tuple[str, str]
# relative uncertainty of an unrecorded airspeed; it acts like a scale of the load
AIRSPEED_UNCERTAINTY = 0.015


@dataclass(frozen=True)
class Unknown:
    """A quantity of one record that every fit leaves free: its key, the size of a step to
    differentiate, and a prior sigma (infinite: none).
    """

    key: Key
    step: float
    prior: float = float("inf")


def unknowns_of(s: KinematicSignals) -> tuple[Unknown, ...]:
    """Starts of the states; biases that the relations need; without theta two numbers for gravity's
    turn; without an airspeed how far the given one is off; where nz jumps with an input, by how
    much its integral may be off.
    """
    out = [Unknown(("start", name), 1e-3) for name in s.outputs]
    if "theta" in s.outputs:
        out.append(Unknown(("q", BIAS), 1e-4))
    if "alpha" in s.outputs:
        out.append(Unknown(("nz", BIAS), 1e-3))
        if "airspeed" not in s.channels:
            out.append(Unknown(("nz", SCALE), 1e-3, AIRSPEED_UNCERTAINTY))
        if "theta" not in s.channels:
            out += [Unknown(("turn", "1"), 1e-3, 0.2), Unknown(("turn", "2"), 1e-2, 0.5)]
        if s.jumps.size:
            out.append(Unknown(("jump", "nz"), 1e-2, 1.0))
    if "airspeed" in s.outputs:
        out.append(Unknown(("ax", BIAS), 1e-3))
    return tuple(out)


def start_of(s: KinematicSignals, unknowns: Sequence[Unknown]) -> np.ndarray:
    """Return the first values: states as they are first measured, nz incremental or total,
    whichever is nearer.
    """
    out = np.zeros(len(unknowns))
    for i, item in enumerate(unknowns):
        channel, kind = item.key
        if channel == "start":
            row = s.outputs.index(kind)
            out[i] = (
                float(np.median(s.channels[kind][np.flatnonzero(s.valid[row])[:5]]))
                if np.any(s.valid[row])
                else 0.0
            )
        elif item.key == ("nz", BIAS):
            level = float(np.mean(s.channels["nz"]))
            out[i] = level if "theta" not in s.channels else (0.0 if level > 0.5 else -1.0)
    return out


def evaluate(
    s: KinematicSignals,
    unknowns: Sequence[Unknown],
    faults: Sequence[SensorFault],
    own: np.ndarray,
    sizes: np.ndarray,
) -> np.ndarray:
    """Outputs for rows of values: ``own (P, n)``, ``sizes (P, k)`` to ``(m, P, N)``."""
    table = {item.key: own[:, i : i + 1] for i, item in enumerate(unknowns)}
    for j, fault in enumerate(faults):
        key = (fault.channel, fault.kind)
        table[key] = table[key] + sizes[:, j : j + 1] if key in table else sizes[:, j : j + 1]
    none = np.zeros((1, 1))
    return reconstructed(s, lambda channel, kind: table.get((channel, kind), none))


def difference_step(fault: SensorFault) -> float:
    """Return the step of a central difference; lags and delays need several samples."""
    return 0.004 if fault.kind in (DELAY, LAG) else 1e-3 * fault.plausible


def linearised(
    s: KinematicSignals,
    unknowns: Sequence[Unknown],
    faults: Sequence[SensorFault],
    own: np.ndarray,
    sizes: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs ``(m, N)`` and their slopes ``(m, N, n + k)`` in one call: one-sided differences for
    a record's own, central ones for faults.
    """
    n, k = len(unknowns), len(faults)
    step = np.array([item.step for item in unknowns] + [difference_step(fault) for fault in faults])
    centre = np.concatenate([own, sizes])
    points = np.concatenate([centre[None], centre + np.diag(step), (centre - np.diag(step))[n:]])
    y = np.broadcast_to(
        evaluate(s, unknowns, faults, points[:, :n], points[:, n:]),
        (len(s.outputs), n + 2 * k + 1, len(s.time)),
    )
    slope = np.empty((len(s.outputs), n + k, len(s.time)))
    slope[:, :n] = (y[:, 1 : n + 1] - y[:, :1]) / step[:n, None]
    slope[:, n:] = (y[:, n + 1 : n + k + 1] - y[:, n + k + 1 :]) / (2.0 * step[n:, None])
    return y[:, 0], slope.transpose(0, 2, 1)
