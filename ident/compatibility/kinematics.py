"""The kinematic relations, integrated over measured inputs.

Body axes, x forward, z down, wings level (Klein and Morelli, Aircraft System Identification, AIAA 2006, ch. 10, without lateral motion):

alpha_dot = q - (g/V) [nz cos(alpha) + (ax/g) sin(alpha) - cos(theta - alpha)],   theta_dot = q,
V_dot = ax cos(alpha) - g nz sin(alpha) - g sin(theta - alpha).

Without theta gravity's turn along the path is unknown and the first becomes, about the mean flight,
alpha_dot = q - (g/V) (nz - n0) + (g/V) (c1 d - c2 d^2/2), d = integral of (g/V)(nz - n0): c1 = -sin(gamma0), c2 = cos(gamma0)
and n0 are free, c2 about 0.5: in records of linear equations gravity does not turn and c2 is zero. Without ax, nz is the load normal to the path.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ident.compatibility.faults import ARM, BIAS, DELAY, DRIFT, LAG, SCALE
from ident.compatibility.signals import Signals
from sim.maths import G0, linear_recurrence

Values = Callable[[str, str], np.ndarray]  # (channel, kind) -> sizes (P, 1); zero where nothing is fitted
_SWEEPS = 5  # alpha stands on the right side under small factors: each sweep gains a factor of ten and more


def reconstructed(s: Signals, value: Values) -> np.ndarray:
    """What the outputs should read if the sensors have these faults: ``(m, P, N)`` for sizes ``(P, 1)``.

    Besides the faults, ``value`` gives ``("start", STATE)``, ``("turn", "1")`` = c1, ``("turn", "2")`` = c2 - 0.5 and ``("jump", "nz")``.
    """
    h = s.steps
    speed = s.speed
    if "airspeed" in s.channels:
        speed = (speed - value("airspeed", BIAS)) / (1.0 + value("airspeed", SCALE))
    over_speed = 1.0 / middle(speed)
    inputs = {name: increments(s, name, value, h) for name in ("q", "nz", "ax") if name in s.channels}
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
            bend = s.gravity * over_speed * h * middle(value("turn", "1") * turn - 0.5 * (0.5 + value("turn", "2")) * turn**2)
            alpha = value("start", "alpha") + summed(inputs["q"] - load + bend)
        states["alpha"] = alpha
    if "airspeed" in s.outputs:
        a, climb = states["alpha"], states["theta"] - states["alpha"]
        push = middle(np.cos(a)) * inputs["ax"] - G0 * middle(np.sin(a)) * inputs["nz"] - s.gravity * h * middle(np.sin(climb))
        states["airspeed"] = value("start", "airspeed") + summed(push)
    out = [_read(s, name, states[name], value, speed) for name in s.outputs]
    width = max(row.shape[0] for row in out)
    return np.array([np.broadcast_to(row, (width, len(s.time))) for row in out])


def _with_theta(
    s: Signals, value: Values, inputs: dict[str, np.ndarray], over_speed: np.ndarray, load: np.ndarray, theta: np.ndarray, h: np.ndarray
) -> np.ndarray:
    alpha = s.channels["alpha"][None]
    for _ in range(_SWEEPS):
        gravity = s.gravity * over_speed * h * middle(np.cos(theta - alpha))
        if "ax" in inputs:
            change = inputs["q"] - load * middle(np.cos(alpha)) - over_speed * inputs["ax"] * middle(np.sin(alpha)) + gravity
        else:
            change = inputs["q"] - load + gravity
        alpha = value("start", "alpha") + summed(change)
    return alpha


def increments(s: Signals, name: str, value: Values, h: np.ndarray) -> np.ndarray:
    """Integral of the true signal over each interval from its faulty reading, cubic between samples: ``(P, N - 1)``."""
    x, t = s.channels[name], s.time
    delay, lag = value(name, DELAY), value(name, LAG)
    # The trapezoid with the correction of its ends: cubic pieces, whose noise is the trapezoid's but for two samples.
    whole = np.concatenate([[0.0], np.cumsum(0.5 * h * (x[1:] + x[:-1]) - h**2 / 12.0 * np.diff(_slopes(x, t)))])
    read = np.diff(_shifted(t, whole, x, delay)) if np.any(delay) else np.diff(whole)[None]
    if np.any(lag):
        read = read + lag * np.diff(_shifted(t, x, _slopes(x, t), delay) if np.any(delay) else x[None])
    wrong = value(name, BIAS) + value(name, DRIFT) * (middle(t) - t[0])
    return np.asarray((read - wrong * h) / (1.0 + value(name, SCALE)))


def samples(s: Signals, name: str, value: Values) -> np.ndarray:
    """The true signal at the samples from its faulty reading: ``(P, N)``."""
    read, t = s.channels[name][None], s.time
    delay, lag = value(name, DELAY), value(name, LAG)
    if np.any(lag):
        read = read + lag * _slopes(read, t)
    if np.any(delay):
        read = _shifted(t, read, _slopes(read, t), delay)
    return np.asarray((read - value(name, BIAS) - value(name, DRIFT) * (t - t[0])) / (1.0 + value(name, SCALE)))


def _read(s: Signals, name: str, state: np.ndarray, value: Values, speed: np.ndarray) -> np.ndarray:
    """What the sensor of a state shows: arm (with the true pitch rate), then as ``shown``."""
    arm = value(name, ARM) + s.vane_arm
    if name == "alpha" and np.any(arm):
        state = state - arm / speed * samples(s, "q", value)
    return shown(s, name, state, value)


def shown(s: Signals, name: str, y: np.ndarray, value: Values) -> np.ndarray:
    """What a sensor makes of a signal ``(P, N)``: lag, delay, scale, bias and drift, in this order."""
    t = s.time
    delay, lag = value(name, DELAY), value(name, LAG)
    if np.any(lag):
        y = _lagged(y, _slopes(y, t), t, lag)
    if np.any(delay):
        y = _shifted(t, y, _slopes(y, t), -delay)
    return np.asarray((1.0 + value(name, SCALE)) * y + value(name, BIAS) + value(name, DRIFT) * (t - t[0]))


def _lagged(y: np.ndarray, dy: np.ndarray, t: np.ndarray, lag: np.ndarray) -> np.ndarray:
    """First-order lag of a signal that runs straight between samples, settled on its first slope; a negative lag is a lead."""
    lag = np.broadcast_to(lag, (max(len(y), len(lag)), 1))
    y, dy = np.broadcast_to(y, (len(lag), y.shape[1])), np.broadcast_to(dy, (len(lag), y.shape[1]))
    out = y - lag * dy
    h = np.diff(t)
    for i in np.flatnonzero(lag[:, 0] > 1e-4):
        tau = float(lag[i, 0])
        decay = np.exp(-h / tau)
        v0, v1 = y[i, :-1], y[i, 1:]
        out[i] = linear_recurrence(decay, v1 - (v1 - v0) * (tau / h * (1.0 - decay)) - v0 * decay, out[i, 0])
    return out


def _shifted(t: np.ndarray, y: np.ndarray, dy: np.ndarray, by: np.ndarray) -> np.ndarray:
    """``y(t + by)`` for ``by (P, 1)`` by cubic pieces with slopes ``dy``, straight beyond the ends: ``(P, N)``."""
    if y.ndim == 1:  # one signal at few different shifts, most of them alike
        each, which = np.unique(by[:, 0], return_inverse=True)
        return np.concatenate([_moved(t, y[None], dy[None], float(shift)) for shift in each])[which.reshape(-1)]
    rows = max(len(y), len(by))
    y, dy, by = np.broadcast_to(y, (rows, len(t))), np.broadcast_to(dy, (rows, len(t))), np.broadcast_to(by, (rows, 1))[:, 0]
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
    """Means of neighbouring samples along the last axis."""
    return np.asarray(0.5 * (x[..., 1:] + x[..., :-1]))


def summed(increments: np.ndarray) -> np.ndarray:
    """Samples ``(P, N)``, the first one zero, from increments ``(P, N - 1)``."""
    increments = np.atleast_2d(increments)
    out = np.zeros((len(increments), increments.shape[1] + 1))
    np.cumsum(increments, axis=1, out=out[:, 1:])
    return out


def _slopes(y: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Slopes by parabolas through three neighbours, at the ends by straight lines."""
    h = np.diff(t)
    steep = np.diff(y, axis=-1) / h
    inner = (steep[..., :-1] * h[1:] + steep[..., 1:] * h[:-1]) / (h[1:] + h[:-1])
    return np.concatenate([steep[..., :1], inner, steep[..., -1:]], axis=-1)
