"""The closed loop's equations as matrices: continuous airframe, surfaces and sensors; sampled shaping and control law.

Every block is written here once. ``sim.closed_loop.linear`` gives the blocks signal names and joins them with python-control;
``sim.closed_loop.nonlinear`` steps them with limits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sim.closed_loop.airframe import X29, Actuator, Airframe, ControlLaw, Sensor, StickShaping

DEGREE = math.pi / 180.0
OUTPUT_NAMES = ("alpha", "q", "nz", "canard", "flaperon", "strake", "gyro", "accelerometer")


@dataclass(frozen=True, eq=False)
class Matrices:
    """x_dot (or the next x) = A x + B u, y = C x + D u; arrays ``(n, n)``, ``(n, m)``, ``(p, n)``, ``(p, m)``."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray


def airframe_matrices(airframe: Airframe) -> Matrices:
    """Short period. States alpha, q (rad, rad/s); inputs the surfaces (deg); outputs alpha, q, incremental nz (g)."""
    A = np.array([[airframe.L_alpha, airframe.L_q], [airframe.M_alpha, airframe.M_q]])
    B = np.array([airframe.L_surface, airframe.M_surface])
    per_g = -airframe.airspeed / airframe.gravity
    C = np.array([[1.0, 0.0], [0.0, 1.0], [per_g * airframe.L_alpha, per_g * (airframe.L_q - 1.0)]])
    D = np.vstack([np.zeros((2, 3)), per_g * B[0]])
    return Matrices(A, B, C, D)


def actuator_matrices(actuator: Actuator) -> Matrices:
    """Servo (where there is one) and ram. Input: command (deg); output and last state: the surface (deg)."""
    p = actuator.ram
    if actuator.servo_frequency is None or actuator.servo_damping is None:
        return Matrices(np.array([[-p]]), np.array([[p]]), np.eye(1), np.zeros((1, 1)))
    w, zeta = actuator.servo_frequency, actuator.servo_damping
    A = np.array([[0.0, 1.0, 0.0], [-w * w, -2.0 * zeta * w, 0.0], [p, 0.0, -p]])
    return Matrices(A, np.array([[0.0], [w * w], [0.0]]), np.array([[0.0, 0.0, 1.0]]), np.zeros((1, 1)))


def sensor_matrices(sensor: Sensor, gain: float) -> Matrices:
    """Second order: output ``gain`` times the input at rest. States: output and its rate."""
    w, zeta = sensor.frequency, sensor.damping
    A = np.array([[0.0, 1.0], [-w * w, -2.0 * zeta * w]])
    return Matrices(A, np.array([[0.0], [gain * w * w]]), np.array([[1.0, 0.0]]), np.zeros((1, 1)))


@dataclass(frozen=True, eq=False)
class Plant:
    """Everything between the three surface commands and the outputs, continuous.

    Attributes
    ----------
    A, B : ``(n, n)`` and ``(n, 3)``; inputs are the surface commands (deg, about trim).
    C : ``(8, n)``, outputs in the order of ``OUTPUT_NAMES``; there is no feedthrough, gyro in deg/s, nz incremental.
    rams : states that are the three surfaces' positions.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    rams: tuple[int, int, int]


def plant(x29: X29) -> Plant:
    """The continuous part of the loop in the state order alpha, q, canard, flaperon, strake, gyro, accelerometer."""
    short_period = airframe_matrices(x29.airframe)
    actuators = [actuator_matrices(surface) for surface in x29.surfaces]
    sensors = [sensor_matrices(x29.gyro, 1.0 / DEGREE), sensor_matrices(x29.accelerometer, 1.0)]
    sizes = [2, *(block.A.shape[0] for block in (*actuators, *sensors))]
    ends = np.cumsum(sizes)
    n = int(ends[-1])
    A, B, C = np.zeros((n, n)), np.zeros((n, 3)), np.zeros((len(OUTPUT_NAMES), n))
    A[:2, :2] = short_period.A
    rams = tuple(int(end) - 1 for end in ends[1:4])
    for column, (block, end) in enumerate(zip(actuators, ends[1:4], strict=True)):
        rows = slice(end - block.A.shape[0], end)
        A[rows, rows], B[rows, column : column + 1] = block.A, block.B
        A[:2, end - 1] = short_period.B[:, column]
        C[:3, end - 1] = short_period.D[:, column]
        C[3 + column, end - 1] = 1.0
    C[:3, :2] = short_period.C
    for block, end, source, row in zip(sensors, ends[4:], (1, 2), (6, 7), strict=True):
        rows = slice(end - 2, end)
        A[rows, rows] = block.A
        A[rows, :] += block.B @ C[source : source + 1, :]
        C[row, rows] = block.C
    return Plant(A, B, C, (rams[0], rams[1], rams[2]))


def mixing(x29: X29) -> np.ndarray:
    """Surface commands (deg) per degree of u_p, shape ``(3,)``."""
    return np.array([surface.mixing for surface in x29.surfaces])


def shape_stick(stick: np.ndarray, shaping: StickShaping) -> np.ndarray:
    """Break-out and gearing: inches to g, any shape; K e (1 + curvature |e|) with e = sign(stick) max(|stick| - dead band, 0)."""
    beyond = np.maximum(np.abs(stick) - shaping.dead_band, 0.0)
    return np.asarray(shaping.gain * np.sign(stick) * beyond * (1.0 + shaping.curvature * beyond))


def shaping_matrices(shaping: StickShaping, frame: float) -> Matrices:
    """From the geared stick (g) to the reference r (g): N frames of delay, then the lag by Tustin's rule; sampled."""
    a, b0, b1 = _tustin(1.0, 0.0, 1.0, 1.0 / shaping.lag, frame)
    n = shaping.delay_frames
    A, B, C, D = np.zeros((n + 1, n + 1)), np.zeros((n + 1, 1)), np.zeros((1, n + 1)), np.zeros((1, 1))
    A[1:n, : n - 1] = np.eye(n - 1) if n > 1 else 0.0
    A[n, n], C[0, n] = a, 1.0
    if n:
        B[0, 0], A[n, n - 1], C[0, n - 1] = 1.0, b1 + a * b0, b0
    else:
        B[n, 0], D[0, 0] = b1 + a * b0, b0
    return Matrices(A, B, C, D)


def law_matrices(law: ControlLaw) -> Matrices:
    """The sampled law. Inputs r (g), gyro (deg/s), accelerometer (g); output u_p (deg), delayed by whole frames.

    States: lead-lag, integrator, then the commands on their way out. The delay leaves no direct path from input to u_p.
    """
    frame = 1.0 / law.frame_rate
    a, b0, b1 = _tustin(1.0, 1.0 / law.lead, 1.0, 1.0 / law.lag, frame)
    _, i0, i1 = _tustin(1.0, 0.0, 0.0, 1.0, frame)
    proportional = np.array([0.0, law.Kq, law.Kn])
    integral = law.Ki * np.array([1.0, -law.Kqi, -1.0])
    n = law.delay_frames
    A, B, C = np.zeros((2 + n, 2 + n)), np.zeros((2 + n, 3)), np.zeros((1, 2 + n))
    A[0, 0], B[0] = a, (b1 + a * b0) * proportional
    A[1, 1], B[1] = 1.0, (i1 + i0) * integral
    A[2, :2], B[2] = (-1.0, 1.0), i0 * integral - b0 * proportional
    A[3:, 2 : n + 1] = np.eye(n - 1)
    C[0, n + 1] = 1.0
    return Matrices(A, B, C, np.zeros((1, 3)))


def _tustin(n0: float, n1: float, d0: float, d1: float, frame: float) -> tuple[float, float, float]:
    """(n0 + n1 s)/(d0 + d1 s) as y = a y' + b0 u + b1 u' (primes: the frame before), s = (2/T)(z - 1)/(z + 1); returns a, b0, b1."""
    c = 2.0 / frame
    denominator = d0 + d1 * c
    return (d1 * c - d0) / denominator, (n0 + n1 * c) / denominator, (n0 - n1 * c) / denominator
