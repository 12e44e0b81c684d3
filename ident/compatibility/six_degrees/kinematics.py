"""The kinematic relations of six degrees of freedom, each integrated over what is measured of its right side.

Body axes, x forward, y to the right, z down; flat earth, wind that does not change (Klein and Morelli, Aircraft System Identification, AIAA
2006, ch. 10; Jategaonkar, Flight Vehicle System Identification, AIAA 2006, ch. 10):

phi_dot = p + tan(theta) (q sin(phi) + r cos(phi)),  theta_dot = q cos(phi) - r sin(phi),  psi_dot = (q sin(phi) + r cos(phi))/cos(theta),
V alpha_dot cos(beta) = V [q cos(beta) - sin(beta) (p cos(alpha) + r sin(alpha))] + Z cos(alpha) - X sin(alpha),
V beta_dot = V [p sin(alpha) - r cos(alpha)] - X cos(alpha) sin(beta) + Y cos(beta) - Z sin(alpha) sin(beta),
V_dot = X cos(alpha) cos(beta) + Y sin(beta) + Z sin(alpha) cos(beta),
h_dot = V [cos(alpha) cos(beta) sin(theta) - sin(beta) sin(phi) cos(theta) - sin(alpha) cos(beta) cos(phi) cos(theta)] + w,
X = ax - g sin(theta), Y = ay + g cos(theta) sin(phi), Z = az + g cos(theta) cos(phi); w is the wind's climb.

What is not recorded is taken as follows. theta, alpha: constants of the record, fitted. phi, beta: zero. p: the change of phi. r in
phi_dot = p + psi_dot sin(theta): a coordinated turn, psi_dot = g tan(phi)/V. q: what holds theta. ax: what holds the airspeed. A load's
other terms without it: none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ident.compatibility.faults import ARM, BELOW, BIAS, BOOM, PACKAGE, RIGHT, SCALE
from ident.compatibility.kinematics import Values, increments, middle, samples, shown, summed
from ident.compatibility.signals import Signals
from ident.compatibility.six_degrees.channels import load_on
from sim.maths import G0

_TO_BODY = {"nx": G0, "ny": G0, "nz": -G0}


@dataclass(frozen=True, eq=False)
class _Motion:
    """What is measured, less the faults: samples ``(P, N)`` of angles and speed, and increments ``(P, N - 1)`` of rates and loads."""

    phi: np.ndarray
    theta: np.ndarray
    alpha: np.ndarray
    beta: np.ndarray
    speed: np.ndarray
    turned: dict[str, np.ndarray]
    pushed: dict[str, np.ndarray]


def reconstructed(s: Signals, value: Values) -> np.ndarray:
    """What the outputs should read if the sensors have these faults: ``(m, P, N)`` for sizes ``(P, 1)``.

    Besides the faults, ``value`` gives ``("start", STATE)``, ``("level", "theta")`` and ``("level", "alpha")`` where these are not recorded,
    and ``("wind", "bias")``, m/s upward.
    """
    rates = {name: samples(s, name, value) for name in ("p", "q", "r") if name in s.channels}
    motion = _motion(s, value, rates)
    out = []
    for name in s.outputs:
        state = value("start", name) + summed(_CHANGES.get(name, _height)(s, motion, value))
        out.append(shown(s, name, _at_vane(s, name, state, value, rates, motion.speed), value))
    width = max(row.shape[0] for row in out)
    return np.array([np.broadcast_to(row, (width, len(s.time))) for row in out])


def _motion(s: Signals, value: Values, rates: dict[str, np.ndarray]) -> _Motion:
    h, none = s.steps, np.zeros((1, len(s.time)))
    speed = samples(s, "airspeed", value) if "airspeed" in s.channels else s.speed[None] / (1.0 + value("airspeed", SCALE))
    angles = {}
    for name in ("phi", "theta", "alpha", "beta"):
        if name in s.channels:
            angles[name] = _at_vane(s, name, samples(s, name, value), value, rates, speed, back=True)
        else:
            angles[name] = none + value("level", name)
    turned = {name: increments(s, name, value, h) for name in rates}
    if "p" not in turned and "phi" in s.channels:
        turned["p"] = np.diff(angles["phi"])
    pushed = {}
    for axis in "xyz":
        if (channel := load_on(axis, tuple(s.channels))) is not None:
            pushed[axis] = _TO_BODY.get(channel, 1.0) * increments(s, channel, value, h) - _lever(s, axis, channel, value, rates)
    return _Motion(angles["phi"], angles["theta"], angles["alpha"], angles["beta"], speed, turned, pushed)


def _at_vane(
    s: Signals, name: str, angle: np.ndarray, value: Values, rates: dict[str, np.ndarray], speed: np.ndarray, *, back: bool = False
) -> np.ndarray:
    """A flow angle where its vane is, from that at the centre of gravity; ``back``: the other way."""
    ahead = value(name, ARM) + value(BOOM, ARM) + (s.vane_arm if name == "alpha" else 0.0)
    terms = {"alpha": (("q", -ahead), ("p", value(name, RIGHT))), "beta": (("r", ahead), ("p", -value(name, BELOW)))}.get(name, ())
    for rate, arm in terms:
        if rate in rates and np.any(arm):
            angle = angle + (-arm if back else arm) / speed * rates[rate]
    return angle


def _lever(s: Signals, axis: str, channel: str, value: Values, rates: dict[str, np.ndarray]) -> np.ndarray:
    """Integral over each interval of what an accelerometer away from the centre of gravity feels more: ``(P, N - 1)``, m/s."""
    x, y, z = (value(channel, kind) + value(PACKAGE, kind) for kind in (ARM, RIGHT, BELOW))
    if not (np.any(x) or np.any(y) or np.any(z)):
        return np.zeros((1, 1))
    h, none = s.steps, np.zeros((1, len(s.time)))
    p, q, r = (rates.get(name, none) for name in ("p", "q", "r"))

    def whole(product: np.ndarray) -> np.ndarray:
        return h * middle(product)

    if axis == "x":
        felt = -x * whole(q * q + r * r) + y * (whole(p * q) - np.diff(r)) + z * (whole(p * r) + np.diff(q))
    elif axis == "y":
        felt = x * (whole(p * q) + np.diff(r)) - y * whole(p * p + r * r) + z * (whole(q * r) - np.diff(p))
    else:
        felt = x * (whole(p * r) - np.diff(q)) + y * (whole(q * r) + np.diff(p)) - z * whole(p * p + q * q)
    return np.asarray(felt)


def _theta(s: Signals, m: _Motion, value: Values) -> np.ndarray:
    q = m.turned["q"]
    return np.asarray(q * middle(np.cos(m.phi)) - m.turned["r"] * middle(np.sin(m.phi)) if "r" in m.turned and "phi" in s.channels else q)


def _phi(s: Signals, m: _Motion, value: Values) -> np.ndarray:
    tan = np.tan(m.theta)
    if "r" not in m.turned:
        return np.asarray(m.turned["p"] + s.gravity * s.steps * middle(np.sin(m.theta) * np.tan(m.phi) / m.speed))
    if "q" not in m.turned:
        return np.asarray(m.turned["p"] + m.turned["r"] * middle(tan / np.cos(m.phi)))
    return np.asarray(m.turned["p"] + m.turned["q"] * middle(tan * np.sin(m.phi)) + m.turned["r"] * middle(tan * np.cos(m.phi)))


def _psi(s: Signals, m: _Motion, value: Values) -> np.ndarray:
    if "q" not in m.turned:
        return np.asarray(m.turned["r"] * middle(1.0 / (np.cos(m.phi) * np.cos(m.theta))))
    return np.asarray(m.turned["q"] * middle(np.sin(m.phi) / np.cos(m.theta)) + m.turned["r"] * middle(np.cos(m.phi) / np.cos(m.theta)))


def _forces(s: Signals, m: _Motion, axes: tuple[tuple[str, np.ndarray], ...]) -> np.ndarray:
    """Sum over axes of load and weight times a coefficient at the samples, integrated over each interval."""
    weight = {"x": -np.sin(m.theta), "y": np.cos(m.theta) * np.sin(m.phi), "z": np.cos(m.theta) * np.cos(m.phi)}
    total = np.zeros((1, 1))
    for axis, coefficient in axes:
        if axis in m.pushed:
            total = total + m.pushed[axis] * middle(coefficient) + s.gravity * s.steps * middle(weight[axis] * coefficient)
    return total


def _alpha(s: Signals, m: _Motion, value: Values) -> np.ndarray:
    cos, sin = np.cos(m.alpha), np.sin(m.alpha)
    over = 1.0 / (m.speed * np.cos(m.beta))
    axes = (("z", cos * over), ("x", -sin * over)) if "x" in m.pushed else (("z", over / cos),)
    change = m.turned["q"] + _forces(s, m, axes)
    if "beta" in s.channels:
        slip = np.tan(m.beta)
        for rate, part in (("p", cos), ("r", sin)):
            if rate in m.turned:
                change = change - m.turned[rate] * middle(slip * part)
    return np.asarray(change)


def _beta(s: Signals, m: _Motion, value: Values) -> np.ndarray:
    cos, sin = np.cos(m.alpha), np.sin(m.alpha)
    slip, over = np.sin(m.beta), 1.0 / m.speed
    change = _forces(s, m, (("y", np.cos(m.beta) * over), ("x", -cos * slip * over), ("z", -sin * slip * over)))
    change = change - m.turned["r"] * middle(cos)
    return np.asarray(change + m.turned["p"] * middle(sin) if "p" in m.turned else change)


def _airspeed(s: Signals, m: _Motion, value: Values) -> np.ndarray:
    cos = np.cos(m.beta)
    return _forces(s, m, (("x", np.cos(m.alpha) * cos), ("y", np.sin(m.beta)), ("z", np.sin(m.alpha) * cos)))


def _height(s: Signals, m: _Motion, value: Values) -> np.ndarray:
    cos, level = np.cos(m.beta), np.cos(m.theta)
    rise = np.cos(m.alpha) * cos * np.sin(m.theta) - np.sin(m.beta) * np.sin(m.phi) * level - np.sin(m.alpha) * cos * np.cos(m.phi) * level
    return np.asarray(s.steps * (middle(m.speed * rise) + value("wind", BIAS)))


_CHANGES: dict[str, Callable[[Signals, _Motion, Values], np.ndarray]] = {
    **{"theta": _theta, "phi": _phi, "psi": _psi, "alpha": _alpha, "beta": _beta, "airspeed": _airspeed},
}
