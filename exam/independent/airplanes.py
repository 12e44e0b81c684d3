"""Three airplanes with published nonlinear aerodynamics: Beaver, generic transport, F-4.

Beaver: polynomials that were identified from flights of the de Havilland Canada DHC-2 between 30
and 55 m/s (Tjee and Mulder, Stability and Control Derivatives of the De Havilland DHC-2 "Beaver"
Aircraft, report LR-556, Delft University of Technology, 1988, tables 2 and 3). As in the model of
Rauw's FDC toolbox, the term in the rate of sideslip is left out.

Generic transport and F-4: the global polynomials of Grauer and Morelli (Generic Global Aerodynamic
Model for Aircraft, Journal of Aircraft 52(1), 2015), fitted to the nonlinear tables of NASA's
sub-scale airliner and of the F-4. Masses of the F-4 are those of Heffley and Jewell (NASA CR-2144,
1972).

The numbers were taken from public transcriptions of these reports. Controls have one sign
convention: an elevator trailing edge down increases lift and pitches down, a right aileron trailing
edge down rolls left, and a rudder trailing edge left pushes right and yaws left.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

Six = tuple[float, float, float, float, float, float]
Aerodynamics = Callable[..., Six]


@dataclass(frozen=True)
class Airplane:
    """An airplane in a level flight condition, SI.

    ``coefficients`` returns CX, CY, CZ, Cl, Cm, Cn along body axes (x forward, y right, z down) for
    alpha, beta (rad, relative to the air), p b/2V, q c/2V, r b/2V, elevator, aileron, rudder (rad)
    and the pressure rise of the propeller. The pressure rise is zero for an airplane whose thrust
    is a separate force, at ``thrust_arm`` m below the centre of gravity. ``inertia`` is Ixx, Iyy,
    Izz, Ixz. ``servo`` has the natural frequency (rad/s) and the damping ratio of the surfaces'
    servos.
    """

    name: str
    mass: float
    inertia: tuple[float, float, float, float]
    area: float
    span: float
    chord: float
    airspeed: float
    density: float
    coefficients: Aerodynamics
    propeller: bool = False
    thrust_arm: float = 0.0
    servo: tuple[float, float] = (30.0, 0.7)


def beaver(
    a: float, b: float, p: float, q: float, r: float, de: float, da: float, dr: float, rise: float
) -> Six:
    """Return the body-axis coefficients of the DHC-2, whose pitch rate is made non-dimensional with
    c/V.
    """
    q = 2.0 * q
    along = (
        -0.03554
        + (0.00292 + (5.459 - 5.162 * a) * a) * a
        - 0.6748 * q
        + 0.03412 * dr
        + 0.1161 * rise
        + 0.1453 * rise**2 * a
    )
    side = (
        -0.002226 - 0.7678 * b - 0.124 * p + 0.3666 * r - 0.02956 * da + (0.1158 + 0.5238 * a) * dr
    )
    down = (
        -0.05504
        + (-5.578 + 3.442 * a * a) * a
        - 2.988 * q
        - (0.398 + 15.93 * b * b) * de
        - 0.1563 * rise
    )
    roll = (
        0.000591
        - 0.0618 * b
        - 0.5045 * p
        + 0.1695 * r
        - (0.09917 + 0.08269 * a) * da
        + 0.006934 * dr
        - 0.01406 * a * a * rise
    )
    pitch = (
        0.09448
        + (-0.6028 - 2.14 * a) * a
        - 15.56 * q
        - 1.921 * de
        + 0.6921 * b * b
        - 0.3118 * r
        - 0.07895 * rise
    )
    yaw = (
        -0.003117
        + (0.006719 + 0.1373 * b * b) * b
        - 0.1585 * p
        - 0.1112 * r
        - 0.003872 * da
        - 0.08265 * dr
        + 0.1595 * q
        - 0.003026 * rise**3
    )
    return along, side, down, roll, pitch, yaw


def _body(a: float, lift: float, drag: float) -> tuple[float, float]:
    """Return the coefficients along body x and z from lift and drag."""
    return lift * math.sin(a) - drag * math.cos(a), -lift * math.cos(a) - drag * math.sin(a)


def generic_transport(
    a: float, b: float, p: float, q: float, r: float, de: float, da: float, dr: float, rise: float
) -> Six:
    """Return the body-axis coefficients of NASA's sub-scale generic transport."""
    lift = (
        0.016
        + (5.343 + (0.506 + (-36.30 + 46.13 * a) * a) * a) * a
        + (30.78 + 12.03 * a) * q
        + 0.396 * de
    )
    drag = 0.019 + (-0.078 + (3.420 + (1.819 - 6.563 * a) * a) * a) * a
    drag += (-27.42 + (288.2 + 355.3 * a) * a) * a * q + (0.293 - 0.040 * a) * a * de
    along, down = _body(a, lift, drag)
    side = -1.003 * b + 0.033 * p + 0.952 * r - 0.009 * da + 0.253 * dr
    roll = -0.109 * b - 0.366 * p + 0.061 * r - 0.079 * da + 0.021 * dr
    pitch = (
        0.182
        + (-1.782 + 0.803 * a**3) * a
        + (-44.34 + (374.0 + (-1748.0 + 1949.0 * a) * a) * a) * q
    )
    pitch -= (1.785 + (2.439 - 0.038 * a) * a * a) * de
    yaw = (
        (0.183 + (0.184 * abs(b) - 0.377 * b * b)) * b
        - 0.022 * p
        - 0.405 * r
        + 0.009 * da
        - 0.129 * dr
    )
    return along, side, down, roll, pitch, yaw


def phantom(
    a: float, b: float, p: float, q: float, r: float, de: float, da: float, dr: float, rise: float
) -> Six:
    """Return the body-axis coefficients of the F-4."""
    lift = (
        0.105
        + (1.519 + (9.90 + (-12.71 - 12.91 * a) * a) * a) * a
        + (6.727 + 33.25 * a) * q
        + 0.265 * de
    )
    drag = 0.031 + (0.280 + (-1.818 + (22.27 - 29.81 * a) * a) * a) * a
    drag += (-11.98 + (209.4 - 284.7 * a) * a) * a * q + 0.515 * a * a * de
    along, down = _body(a, lift, drag)
    side = -0.688 * b + 0.129 * p + 0.670 * r + 0.089 * dr
    roll = -0.034 * b - 0.236 * p + 0.025 * r - 0.035 * da + 0.013 * dr
    pitch = (
        -0.013 + (-0.254 - 0.448 * a**3) * a + (-2.916 + (-3.955 + (-24.0 + 55.32 * a) * a) * a) * q
    )
    pitch -= (0.403 + (-0.270 + 1.479 * a) * a * a) * de
    yaw = (0.142 + 0.377 * b * b) * b - 0.006 * p - 0.358 * r - 0.001 * da - 0.053 * dr
    return along, side, down, roll, pitch, yaw


# At a height of 6000 ft.
BEAVER = Airplane(
    "DHC-2 Beaver",
    2288.231,
    (5368.39, 6928.93, 11158.75, 117.64),
    23.23,
    14.63,
    1.5875,
    50.0,
    1.0270,
    beaver,
    propeller=True,
)
TRANSPORT = Airplane(
    "generic transport",
    22.5,
    (1.80, 5.77, 7.39, 0.163),
    0.548,
    2.08,
    0.279,
    42.0,
    1.19,
    generic_transport,
    servo=(60.0, 0.7),
)
PHANTOM = Airplane(
    "F-4",
    17642.0,
    (33898.0, 165669.0, 189496.0, 2952.0),
    49.239,
    11.787,
    4.889,
    190.0,
    0.7768,
    phantom,
    thrust_arm=-0.1,
)
AIRPLANES = (BEAVER, TRANSPORT, PHANTOM)
