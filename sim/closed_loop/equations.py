"""Equations of the closed loop: matrices of its parts, steps with rate and position limits, and any
computing delay.

``sim.closed_loop.linear`` gives the blocks signal names and joins them with python-control;
``sim.closed_loop.nonlinear`` steps them with limits.

The rams are piecewise linear: free, at their rate limit, or at an end of the travel. Within one of
these modes the whole plant is linear and is stepped exactly by a matrix exponential. The span is
checked in ``pieces`` equal steps. While no limit is reached at any of them, one exponential covers
the whole span. Where a step ends beyond a limit, the time of the change is found by halving that
step ``_HALVINGS`` times. Two errors remain: that of this time, 2^-20 of a piece, which changes the
state in second order only because the rate is continuous; and a limit that is reached and left
again within one piece, which is not detected. On flights whose surfaces run at their limits 1 to 64
pieces a frame agree to 1e-9 rad in alpha.

The computer reads its sensors at a frame and changes the command ``late`` seconds after it,
independently of ``delay_frames`` of its law. The command is held until the next one, so sampling is
exact: over a frame the old command acts for ``late`` less its whole frames, then the new one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from sim.closed_loop.airframe import (
    X29,
    Actuator,
    ControlLaw,
    Sensor,
    ShortPeriodAirframe,
    StickShaping,
)
from sim.errors import ModelError

if TYPE_CHECKING:
    from control import StateSpace


# ---- The closed loop's equations as matrices

DEGREE = math.pi / 180.0
OUTPUT_NAMES = ("alpha", "q", "nz", "canard", "flaperon", "strake", "gyro", "accelerometer")


@dataclass(frozen=True, eq=False)
class Matrices:
    """x_dot (or the next x) = A x + B u, y = C x + D u; arrays ``(n, n)``, ``(n, m)``, ``(p, n)``,
    ``(p, m)``.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray


def airframe_matrices(airframe: ShortPeriodAirframe) -> Matrices:
    """Return the short period: states alpha, q (rad, rad/s); inputs surfaces (deg); outputs alpha,
    q and incremental nz (g).
    """
    A = np.array([[airframe.L_alpha, airframe.L_q], [airframe.M_alpha, airframe.M_q]])
    B = np.array([airframe.L_surface, airframe.M_surface])
    per_g = -airframe.airspeed / airframe.gravity
    C = np.array([[1.0, 0.0], [0.0, 1.0], [per_g * airframe.L_alpha, per_g * (airframe.L_q - 1.0)]])
    D = np.vstack([np.zeros((2, 3)), per_g * B[0]])
    return Matrices(A, B, C, D)


def actuator_matrices(actuator: Actuator) -> Matrices:
    """Return a ram with its servo, if any. Input: command (deg); output and last state: surface
    (deg).
    """
    p = actuator.ram
    if actuator.servo_frequency is None or actuator.servo_damping is None:
        return Matrices(np.array([[-p]]), np.array([[p]]), np.eye(1), np.zeros((1, 1)))
    w, zeta = actuator.servo_frequency, actuator.servo_damping
    A = np.array([[0.0, 1.0, 0.0], [-w * w, -2.0 * zeta * w, 0.0], [p, 0.0, -p]])
    return Matrices(
        A, np.array([[0.0], [w * w], [0.0]]), np.array([[0.0, 0.0, 1.0]]), np.zeros((1, 1))
    )


def sensor_matrices(sensor: Sensor, gain: float) -> Matrices:
    """Return a second-order sensor with this static gain. States: output and its rate."""
    w, zeta = sensor.frequency, sensor.damping
    A = np.array([[0.0, 1.0], [-w * w, -2.0 * zeta * w]])
    return Matrices(A, np.array([[0.0], [gain * w * w]]), np.array([[1.0, 0.0]]), np.zeros((1, 1)))


@dataclass(frozen=True, eq=False)
class Plant:
    """The continuous system between the three surface commands and the outputs.

    Attributes
    ----------
    A, B : ``(n, n)`` and ``(n, 3)``; inputs are the surface commands (deg, about trim).
    C : ``(8, n)``, outputs in the order of ``OUTPUT_NAMES``; there is no feedthrough, gyro in
        deg/s, nz incremental.
    rams : states that are the three surfaces' positions.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    rams: tuple[int, int, int]


def plant(x29: X29) -> Plant:
    """Return the continuous part of the loop in the state order alpha, q, canard, flaperon, strake,
    gyro, accelerometer.
    """
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
    """Apply break-out and gearing, inches to g, to an array of any shape.

    The result is K e (1 + curvature |e|) with e = sign(stick) max(|stick| - dead band, 0).
    """
    beyond = np.maximum(np.abs(stick) - shaping.dead_band, 0.0)
    return np.asarray(shaping.gain * np.sign(stick) * beyond * (1.0 + shaping.curvature * beyond))


def shaping_matrices(shaping: StickShaping, frame: float) -> Matrices:
    """Return the sampled system from the geared stick (g) to the reference r (g): N frames of
    delay, then a lag by Tustin's rule.
    """
    a, b0, b1 = _tustin(1.0, 0.0, 1.0, 1.0 / shaping.lag, frame)
    n = shaping.delay_frames
    A, B, C = np.zeros((n + 1, n + 1)), np.zeros((n + 1, 1)), np.zeros((1, n + 1))
    D = np.zeros((1, 1))
    A[1:n, : n - 1] = np.eye(n - 1) if n > 1 else 0.0
    A[n, n], C[0, n] = a, 1.0
    if n:
        B[0, 0], A[n, n - 1], C[0, n - 1] = 1.0, b1 + a * b0, b0
    else:
        B[n, 0], D[0, 0] = b1 + a * b0, b0
    return Matrices(A, B, C, D)


def law_matrices(law: ControlLaw) -> Matrices:
    """Return the sampled law. Inputs r (g), gyro (deg/s), accelerometer (g); output u_p (deg),
    delayed by whole frames.

    States: lead-lag, integrator, then the delayed commands. The delay leaves no direct path from
    input to u_p.
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
    """Return a, b0, b1 of (n0 + n1 s)/(d0 + d1 s) with s = (2/T)(z - 1)/(z + 1), written as
    y = a y' + b0 u + b1 u' (primes: the frame before).
    """
    c = 2.0 / frame
    denominator = d0 + d1 * c
    return (d1 * c - d0) / denominator, (n0 + n1 * c) / denominator, (n0 - n1 * c) / denominator


# ---- Steps of the continuous part of the loop over a span with constant commands

_HALVINGS = 20
# Tolerance within which a limit is not yet exceeded, relative to the limit; it prevents switches of
# modes by rounding.
_LIMIT_SLACK = 1e-10


class RamMode(IntEnum):
    """State of a ram: moving freely, at its rate limit or at a stop."""

    FREE = 0
    RATE_UP = 1
    RATE_DOWN = 2
    STOP_UPPER = 3
    STOP_LOWER = 4


Modes = tuple[RamMode, RamMode, RamMode]
ALL_FREE: Modes = (RamMode.FREE, RamMode.FREE, RamMode.FREE)


@dataclass(frozen=True, eq=False)
class Stepper:
    """Prepared matrices of a step over a span of fixed length; see ``prepare``.

    Attributes
    ----------
    free : ``(m, m)``, moves the extended state (plant state, three commands, 1) over the span with
        every ram free.
    watch : ``(k, m)``, rates and positions of the rams at the ends of the pieces, scaled so that
        the limits are -1 and 1.
    ram_rate : ``(3, m)``, rates of the rams if they are free, deg/s.
    rams : positions of the rams in the state.
    rates, lower, upper : limits of the rams about trim, deg/s and deg.
    pieces : number of equal steps at whose ends limits are checked.
    powers : for a set of modes the exponentials of a piece halved 0, 1, ... times, ``(21, m, m)``;
        cached.
    """

    free: np.ndarray
    watch: np.ndarray
    ram_rate: np.ndarray
    rams: tuple[int, int, int]
    rates: tuple[float, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    pieces: int
    powers: Callable[[Modes], np.ndarray]


def prepare(x29: X29, plant: Plant, span: float, pieces: int) -> Stepper:
    """Return a stepper over ``span`` s that checks the limits ``pieces`` times."""
    from scipy.linalg import expm

    n = plant.A.shape[0]
    M = np.zeros((n + 4, n + 4))
    M[:n, :n], M[:n, n : n + 3] = plant.A, plant.B
    rams = plant.rams
    rates = tuple(surface.rate for surface in x29.surfaces)
    lower = tuple(surface.lower - surface.trim for surface in x29.surfaces)
    upper = tuple(surface.upper - surface.trim for surface in x29.surfaces)
    ram_rate = M[list(rams)].copy()

    scaled = np.zeros((6, n + 4))
    for i in range(3):
        half, middle = (upper[i] - lower[i]) / 2.0, (upper[i] + lower[i]) / 2.0
        scaled[i] = ram_rate[i] / rates[i]
        scaled[3 + i, rams[i]], scaled[3 + i, -1] = 1.0 / half, -middle / half
    at = expm(M * (span / pieces * np.arange(pieces + 1))[:, None, None])

    @cache
    def powers(modes: Modes) -> np.ndarray:
        moved = M.copy()
        for i, mode in enumerate(modes):
            if mode is not RamMode.FREE:
                moved[rams[i]] = 0.0
                moved[rams[i], -1] = {RamMode.RATE_UP: rates[i], RamMode.RATE_DOWN: -rates[i]}.get(
                    mode, 0.0
                )
        return np.asarray(
            expm(moved * (span / pieces * 0.5 ** np.arange(_HALVINGS + 1))[:, None, None])
        )

    return Stepper(
        at[-1],
        np.concatenate([scaled @ matrix for matrix in at]),
        ram_rate,
        rams,
        rates,
        lower,
        upper,
        pieces,
        powers,
    )


def advance(
    stepper: Stepper, state: np.ndarray, modes: Modes
) -> tuple[np.ndarray, Modes, tuple[Modes, ...]]:
    """Move the extended state ``(m,)`` over the span.

    Returns the state and modes at its end, and the modes that were active within it, in order
    (empty if all rams were free).
    """
    if modes == ALL_FREE and np.abs(stepper.watch @ state).max() <= 1.0 + _LIMIT_SLACK:
        return stepper.free @ state, modes, ()
    # A new command changes the rate of a ram without servo at once.
    modes = _modes_after(stepper, state, modes)
    seen = [modes]
    for _ in range(stepper.pieces):
        # Time left in this piece and the step to try, in units of the finest step.
        left = 1 << _HALVINGS
        level = 0
        while left:
            while 1 << (_HALVINGS - level) > left:
                level += 1
            trial = stepper.powers(modes)[level] @ state
            following = _modes_after(stepper, trial, modes)
            if following == modes or level == _HALVINGS:
                state = trial
                left -= 1 << (_HALVINGS - level)
                if following != modes:
                    _put_on_stops(stepper, state, following)
                    modes, level = following, 0
                    seen.append(modes)
            else:
                level += 1
    return state, modes, tuple(seen)


def _modes_after(stepper: Stepper, state: np.ndarray, modes: Modes) -> Modes:
    """Return the modes of the rams after a state that was reached in ``modes``."""
    rates = (stepper.ram_rate @ state).tolist()
    positions = [float(state[i]) for i in stepper.rams]
    return (
        _mode_after(
            modes[0], rates[0], positions[0], stepper.rates[0], stepper.lower[0], stepper.upper[0]
        ),
        _mode_after(
            modes[1], rates[1], positions[1], stepper.rates[1], stepper.lower[1], stepper.upper[1]
        ),
        _mode_after(
            modes[2], rates[2], positions[2], stepper.rates[2], stepper.lower[2], stepper.upper[2]
        ),
    )


def _mode_after(
    mode: RamMode, wanted: float, position: float, rate: float, lower: float, upper: float
) -> RamMode:
    slack = _LIMIT_SLACK * (upper - lower)
    within = lower - slack <= position <= upper + slack
    if mode is RamMode.FREE:
        stays = within and abs(wanted) <= rate * (1.0 + _LIMIT_SLACK)
    elif mode is RamMode.RATE_UP:
        stays = within and wanted >= rate
    elif mode is RamMode.RATE_DOWN:
        stays = within and wanted <= -rate
    elif mode is RamMode.STOP_UPPER:
        stays = wanted >= 0.0
    else:
        stays = wanted <= 0.0
    if stays:
        return mode
    if position >= upper and wanted > 0.0:
        return RamMode.STOP_UPPER
    if position <= lower and wanted < 0.0:
        return RamMode.STOP_LOWER
    if wanted >= rate:
        return RamMode.RATE_UP
    return RamMode.RATE_DOWN if wanted <= -rate else RamMode.FREE


def _put_on_stops(stepper: Stepper, state: np.ndarray, modes: Modes) -> None:
    for i, mode in enumerate(modes):
        if mode is RamMode.STOP_UPPER:
            state[stepper.rams[i]] = stepper.upper[i]
        elif mode is RamMode.STOP_LOWER:
            state[stepper.rams[i]] = stepper.lower[i]


# ---- The linear loop whose computing delay is no whole number of frames


@dataclass(frozen=True, eq=False)
class SampledLoop:
    """A loop in its three sampled parts.

    Attributes
    ----------
    plant : from ``u_p`` to ``OUTPUT_NAMES``.
    law : from r, gyro and accelerometer to ``u_p``, without delay.
    shaping : from stick to r.
    frame : sample time, s.
    """

    plant: StateSpace
    law: StateSpace
    shaping: StateSpace
    frame: float

    @property
    def open_loop(self) -> StateSpace:
        """The loop opened at u_p, to the law's negated command; 1 + L = 0 closes it."""
        import control

        law, plant = self.law, self.plant
        back = control.ss(law.A, law.B[:, 1:], -law.C, -law.D[:, 1:], self.frame)
        return back * control.ss(plant.A, plant.B, plant.C[6:8], plant.D[6:8], self.frame)

    def response(self, omega: np.ndarray) -> np.ndarray:
        """Return the response of alpha, q and incremental nz to the stick from frame to frame,
        complex ``(3, n)``, per inch; ``omega`` in rad/s.
        """
        z = np.exp(1j * np.asarray(omega) * self.frame)
        moved, law, shaped = (_at(block, z) for block in (self.plant, self.law, self.shaping))
        returned = -(law[:, 0, 1] * moved[:, 6, 0] + law[:, 0, 2] * moved[:, 7, 0])
        return np.asarray(moved[:, :3, 0].T * law[:, 0, 0] * shaped[:, 0, 0] / (1.0 + returned))


def sampled_loop(x29: X29, lag: float) -> SampledLoop:
    """Return the loop of ``x29`` with commands ``lag`` s after the frame whose sensors they were
    computed from. Raises ModelError for a negative one.
    """
    import control

    if not lag >= 0.0:
        raise ModelError(
            f"a computing delay of {lag:g} s", where="late_loop", remedy="give 0 or more"
        )
    law = law_matrices(replace(x29.law, delay_frames=1))
    shaping, gain = shaping_matrices(x29.stick, x29.frame), x29.stick.gain
    # The third state of a law with one frame of delay is the delayed command: its row is the law
    # without delay.
    return SampledLoop(
        _delayed_plant(x29, lag),
        control.ss(law.A[:2, :2], law.B[:2], law.A[2:3, :2], law.B[2:3], x29.frame),
        control.ss(shaping.A, gain * shaping.B, shaping.C, gain * shaping.D, x29.frame),
        x29.frame,
    )


def _at(block: StateSpace, z: np.ndarray) -> np.ndarray:
    """Return transfer matrices ``(n, outputs, inputs)`` at ``z (n,)`` by one solution for all
    points; python-control solves point by point.
    """
    resolvent = z[:, None, None] * np.eye(block.nstates) - block.A
    return np.asarray(
        block.C @ np.linalg.solve(resolvent, np.broadcast_to(block.B, (z.size, *block.B.shape)))
        + block.D
    )


def _delayed_plant(x29: X29, delay: float) -> StateSpace:
    """Return the sampled system from u_p to ``OUTPUT_NAMES``; states: the plant's, then the
    commands of earlier frames, the latest first.
    """
    import control

    system, T = plant(x29), x29.frame
    whole = int(np.floor(delay / T + 1e-9))
    rest = max(delay - whole * T, 0.0)
    continuous = control.ss(
        system.A, system.B @ mixing(x29)[:, None], system.C, np.zeros((len(OUTPUT_NAMES), 1))
    )
    after = control.sample_system(continuous, T - rest, "zoh")
    n, m = system.A.shape[0], whole + 1
    A, B = np.zeros((n + m, n + m)), np.zeros((n + m, 1))
    A[:n, :n], new = after.A, after.B
    if rest > 0.0:
        before = control.sample_system(continuous, rest, "zoh")
        A[:n, :n], A[:n, n + whole : n + whole + 1] = after.A @ before.A, after.A @ before.B
    if whole:
        A[:n, n + whole - 1 : n + whole] += new
    else:
        B[:n] = new
    B[n] = 1.0
    A[n + 1 :, n : n + m - 1] = np.eye(m - 1)
    C = np.hstack([system.C, np.zeros((len(OUTPUT_NAMES), m))])
    return control.ss(A, B, C, np.zeros((len(OUTPUT_NAMES), 1)), T)
