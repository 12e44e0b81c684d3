"""Attitude of an aircraft by Euler angles or by a quaternion: states, rates, and angles.

Euler angles phi, theta and psi turn the Earth's axes by yaw, then pitch, then roll [1]_. Their
rates are not defined at theta = +-90 deg. The quaternion (e0, e1, e2, e3) has rates everywhere,

    2 e0' = -(e1 p + e2 q + e3 r),      2 e1' = e0 p + e2 r - e3 q,
    2 e2' = e0 q + e3 p - e1 r,         2 e3' = e0 r + e1 q - e2 p .

The rates keep its norm, and all angles are computed from the normalised quaternion. The initial e0
therefore has no effect, and a fit holds it. A fit also holds the initial e3, because the initial
heading is a state of its own, ``psi_start``, with a rate of zero. A model has this state only if it
has a heading.

References
----------
.. [1] B. L. Stevens, F. L. Lewis and E. N. Johnson, Aircraft Control and Simulation, 3rd ed.,
   Wiley, 2016, section 1.4.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Protocol

from sim.maths import arctan, cos, real, sin, sqrt, where

EULER, QUATERNION = "euler", "quaternion"
Vector = tuple[Any, Any, Any]
_ZERO_GUARD = 1e-300  # added to a divisor that may be zero


class Attitude(Protocol):
    """A representation of the attitude.

    Attributes
    ----------
    states : state -> unit, without the heading.
    headed : state -> unit of the further states that the heading needs.
    held : states whose initial value has no effect, so that a fit holds it.
    """

    states: Mapping[str, str]
    headed: Mapping[str, str]
    held: tuple[str, ...]

    def motion(self, s: Any) -> tuple[Vector, Mapping[str, Any]]:
        """Return the unit vector downward in body axes, and the rates of the states by name,
        including those of the heading.
        """

    def angles(self, s: Any, headed: bool) -> Mapping[str, Any]:
        """Return phi and theta and, if ``headed``, psi, rad."""

    def to_body(self, s: Any, north: Any, east: Any, down: Any) -> Vector:
        """Return the components in body axes of a vector in the axes of the Earth."""

    def at_start(self, phi: float, theta: float, psi: float) -> Mapping[str, float]:
        """Return the values of the states at an attitude, rad."""


class EulerAngles:
    """phi, theta and psi as states."""

    states: Mapping[str, str] = MappingProxyType({"phi": "rad", "theta": "rad"})
    headed: Mapping[str, str] = MappingProxyType({"psi": "rad"})
    held: tuple[str, ...] = ()

    def motion(self, s: Any) -> tuple[Vector, Mapping[str, Any]]:
        sin_phi, cos_phi = sin(s.phi), cos(s.phi)
        sin_theta, cos_theta = sin(s.theta), cos(s.theta)
        psi_dot = (s.q * sin_phi + s.r * cos_phi) / cos_theta
        return (-sin_theta, sin_phi * cos_theta, cos_phi * cos_theta), {
            "phi": s.p + sin_theta * psi_dot,
            "theta": s.q * cos_phi - s.r * sin_phi,
            "psi": psi_dot,
        }

    def angles(self, s: Any, headed: bool) -> Mapping[str, Any]:
        return {name: getattr(s, name) for name in ("phi", "theta", *(("psi",) if headed else ()))}

    def to_body(self, s: Any, north: Any, east: Any, down: Any) -> Vector:
        a, b = sin(s.phi), cos(s.phi)
        c, d = sin(s.theta), cos(s.theta)
        e, f = sin(s.psi), cos(s.psi)
        return (
            d * f * north + d * e * east - c * down,
            (a * c * f - b * e) * north + (a * c * e + b * f) * east + a * d * down,
            (b * c * f + a * e) * north + (b * c * e - a * f) * east + b * d * down,
        )

    def at_start(self, phi: float, theta: float, psi: float) -> Mapping[str, float]:
        return {"phi": phi, "theta": theta, "psi": psi}


class Quaternion:
    """A quaternion of any norm as states; see the module."""

    states: Mapping[str, str] = MappingProxyType(dict.fromkeys(("e0", "e1", "e2", "e3"), "1"))
    headed: Mapping[str, str] = MappingProxyType({"psi_start": "rad"})
    held: tuple[str, ...] = ("e0", "e3")

    def _down(self, s: Any) -> Vector:
        e0, e1, e2, e3 = _unit(s)
        return (
            2.0 * (e1 * e3 - e0 * e2),
            2.0 * (e2 * e3 + e0 * e1),
            e0 * e0 - e1 * e1 - e2 * e2 + e3 * e3,
        )

    def motion(self, s: Any) -> tuple[Vector, Mapping[str, Any]]:
        p, q, r = s.p, s.q, s.r
        return self._down(s), {
            "e0": -0.5 * (s.e1 * p + s.e2 * q + s.e3 * r),
            "e1": 0.5 * (s.e0 * p + s.e2 * r - s.e3 * q),
            "e2": 0.5 * (s.e0 * q + s.e3 * p - s.e1 * r),
            "e3": 0.5 * (s.e0 * r + s.e1 * q - s.e2 * p),
            "psi_start": 0.0 * p,
        }

    def angles(self, s: Any, headed: bool) -> Mapping[str, Any]:
        x, y, z = self._down(s)
        across = sqrt(y * y + z * z)
        result = {"phi": _angle(y, z), "theta": -2.0 * arctan(x / (1.0 + across))}
        if headed:
            result["psi"] = _wrapped(_angle(*self._course(s)) + s.psi_start)
        return result

    def to_body(self, s: Any, north: Any, east: Any, down: Any) -> Vector:
        e0, e1, e2, e3 = _unit(s)
        c, d = cos(s.psi_start), sin(s.psi_start)
        north, east = c * north + d * east, c * east - d * north
        x, y, z = self._down(s)
        return (
            (e0 * e0 + e1 * e1 - e2 * e2 - e3 * e3) * north
            + 2.0 * (e1 * e2 + e0 * e3) * east
            + x * down,
            2.0 * (e1 * e2 - e0 * e3) * north
            + (e0 * e0 - e1 * e1 + e2 * e2 - e3 * e3) * east
            + y * down,
            2.0 * (e1 * e3 + e0 * e2) * north + 2.0 * (e2 * e3 - e0 * e1) * east + z * down,
        )

    def at_start(self, phi: float, theta: float, psi: float) -> Mapping[str, float]:
        """Return a quaternion with e3 = 0 for phi and theta, and the initial heading."""
        # The quaternion of the rotation about an axis in the x-y plane that turns z downward.
        x = -math.sin(theta)
        y, z = math.sin(phi) * math.cos(theta), math.cos(phi) * math.cos(theta)
        e0 = math.sqrt(max(0.5 * (1.0 + z), 1e-12))
        state = {"e0": e0, "e1": 0.5 * y / e0, "e2": -0.5 * x / e0, "e3": 0.0}
        seen = _Values(**state)
        return {**state, "psi_start": psi - float(_angle(*self._course(seen)))}

    @staticmethod
    def _course(s: Any) -> tuple[Any, Any]:
        """East and north components of the nose direction, relative to the initial heading."""
        e0, e1, e2, e3 = _unit(s)
        return 2.0 * (e1 * e2 + e0 * e3), e0 * e0 + e1 * e1 - e2 * e2 - e3 * e3


class _Values:
    """Values as attributes, as signals have them."""

    def __init__(self, **values: float) -> None:
        self.__dict__.update(values)


def _unit(s: Any) -> tuple[Any, Any, Any, Any]:
    """Return the normalised quaternion."""
    norm = sqrt(s.e0 * s.e0 + s.e1 * s.e1 + s.e2 * s.e2 + s.e3 * s.e3)
    return s.e0 / norm, s.e1 / norm, s.e2 / norm, s.e3 / norm


def _angle(y: Any, x: Any) -> Any:
    """Return the angle of the direction (x, y), -pi to pi, by functions that keep complex steps."""
    size = sqrt(x * x + y * y)
    # Of the two formulas of the tangent of half the angle, each is exact on one side of the y axis.
    ahead, off = real(x) >= 0.0, where(real(y) >= 0.0, y + _ZERO_GUARD, y - _ZERO_GUARD)
    return 2.0 * arctan(where(ahead, y, size - x) / where(ahead, size + x, off))


def _wrapped(angle: Any) -> Any:
    """Wrap an angle within three times pi to between -pi and pi."""
    turn = 2.0 * math.pi
    below = where(real(angle) > math.pi, angle - turn, angle)
    return where(real(angle) < -math.pi, angle + turn, below)


ATTITUDES: Mapping[str, Attitude] = MappingProxyType(
    {EULER: EulerAngles(), QUATERNION: Quaternion()}
)


def angular_accelerations(s: Any, c: Mapping[str, Any], L: Any, M: Any, N: Any) -> dict[str, Any]:
    """Return the angular accelerations of a body that is symmetric to its x-z plane.

    They follow from Euler's equations.

    Parameters
    ----------
    s : signals p, q, r, rad/s.
    c : roll_inertia, pitch_inertia, yaw_inertia, cross_inertia, kg m2.
    L, M, N : moments about the centre of gravity in body axes, N m.

    Returns
    -------
    ``p``, ``q``, ``r`` : their rates, rad/s2.
    """
    Ix, Iy, Iz, Ixz = (
        c[name] for name in ("roll_inertia", "pitch_inertia", "yaw_inertia", "cross_inertia")
    )
    P, Q, R = s.p, s.q, s.r
    bound = Ix * Iz - Ixz * Ixz
    sum_ = Ix - Iy + Iz
    roll = Ixz * sum_ * P * Q - (Iz * (Iz - Iy) + Ixz * Ixz) * Q * R + Iz * L + Ixz * N
    yaw = (Ix * (Ix - Iy) + Ixz * Ixz) * P * Q - Ixz * sum_ * Q * R + Ixz * L + Ix * N
    pitch = (Iz - Ix) * P * R - Ixz * (P * P - R * R) + M
    return {"p": roll / bound, "q": pitch / Iy, "r": yaw / bound}
