"""The linear closed loop as python-control systems, and its low-order equivalent system.

Conventions that reproduce the reference margins of P, S and F: airframe, actuators and both sensors
are sampled together by exact hold at 80 Hz (the hold is on u_p); lead-lag and integrator by
Tustin's rule; one frame of computing delay after them; nz at the centre of gravity includes the
surfaces' lift; the loop is opened at u_p, the command of the computer before mixing.

Signals: ``stick`` (in), ``r`` (g), ``u_p`` (deg), ``canard flaperon strake`` (deg), ``alpha``
(rad), ``q`` (rad/s), ``nz`` (incremental, g), ``gyro`` (deg/s), ``accelerometer`` (g). Dead band
and curvature of the stick are left out: its gain is K.

The low-order system with stick s (in): delta_dot = inv_tau (s(t - delay) - delta), alpha_dot =
L_alpha alpha + L_q q + L_delta delta, q_dot = M_alpha alpha + M_q q + M_delta delta, nz = -(V/g)
[L_alpha alpha + (L_q - 1) q + L_delta delta].
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.closed_loop.airframe import SURFACE_NAMES, X29
from sim.closed_loop.equations import (
    DEGREE,
    OUTPUT_NAMES,
    Matrices,
    actuator_matrices,
    airframe_matrices,
    law_matrices,
    mixing,
    sensor_matrices,
    shaping_matrices,
)
from sim.errors import ModelError

if TYPE_CHECKING:
    from control import StateSpace


# ---- The linear closed loop as python-control systems with named signals

_MATCHED_BAND = (0.35, 14.0)  # rad/s, in which a low-order equivalent is fitted
_MATCHED_FREQUENCIES = 40
RESPONSE_NAMES = ("alpha", "q", "nz", *SURFACE_NAMES, "u_p")


@dataclass(frozen=True)
class Margins:
    """Stability margins of a loop.

    Attributes
    ----------
    gain_decrease, gain_increase : largest decrease (negative) and increase of the loop gain, dB.
    phase : smallest phase margin, deg.
    crossover : frequency of that phase margin, rad/s.
    """

    gain_decrease: float
    gain_increase: float
    phase: float
    crossover: float


def continuous_plant(x29: X29) -> StateSpace:
    """Return mixer, actuators, airframe and sensors without limits: the continuous system from
    ``u_p`` to all signals of ``OUTPUT_NAMES``.
    """
    import control

    blocks = [
        _named(
            Matrices(*_empty(3, 1), mixing(x29)[:, None]),
            ["u_p"],
            [f"{name}_command" for name in SURFACE_NAMES],
            "mixer",
        )
    ]
    for surface in x29.surfaces:
        blocks.append(
            _named(
                actuator_matrices(surface),
                [f"{surface.name}_command"],
                [surface.name],
                f"{surface.name}_actuator",
            )
        )
    blocks.append(
        _named(
            airframe_matrices(x29.airframe), list(SURFACE_NAMES), ["alpha", "q", "nz"], "airframe"
        )
    )
    blocks.append(_named(sensor_matrices(x29.gyro, 1.0 / DEGREE), ["q"], ["gyro"], "rate_gyro"))
    blocks.append(
        _named(sensor_matrices(x29.accelerometer, 1.0), ["nz"], ["accelerometer"], "nz_sensor")
    )
    return control.interconnect(blocks, inputs=["u_p"], outputs=list(OUTPUT_NAMES), name="plant")


def sampled_plant(x29: X29) -> StateSpace:
    """Return ``continuous_plant`` sampled exactly at the computer's frames, u_p held between."""
    return continuous_plant(x29).sample(x29.frame, "zoh", name="sampled_plant")


def control_law(x29: X29) -> StateSpace:
    """Return the sampled law from ``r``, ``gyro``, ``accelerometer`` to ``u_p``, computing delay
    included.
    """
    return _named(law_matrices(x29.law), ["r", "gyro", "accelerometer"], ["u_p"], "law", x29.frame)


def stick_shaping(x29: X29) -> StateSpace:
    """Return the system from ``stick`` to ``r`` without break-out: gain K, N frames delay, lag."""
    shaping = shaping_matrices(x29.stick, x29.frame)
    gained = Matrices(shaping.A, x29.stick.gain * shaping.B, shaping.C, x29.stick.gain * shaping.D)
    return _named(gained, ["stick"], ["r"], "shaping", x29.frame)


def open_loop(x29: X29) -> StateSpace:
    """Return the sampled loop opened at u_p: from ``u_p`` to ``returned``, the law's negated
    command; 1 + L = 0 closes it.
    """
    import control

    law = law_matrices(x29.law)
    back = _named(
        Matrices(law.A, law.B[:, 1:], -law.C, -law.D[:, 1:]),
        ["gyro", "accelerometer"],
        ["returned"],
        "law",
        x29.frame,
    )
    return control.interconnect(
        [sampled_plant(x29), back],
        inputs=["u_p"],
        outputs=["returned"],
        check_unused=False,
        name="open_loop",
    )


def closed_loop(x29: X29) -> StateSpace:
    """Return the sampled closed loop from ``stick`` to the signals of ``RESPONSE_NAMES``."""
    import control

    blocks = [sampled_plant(x29), control_law(x29), stick_shaping(x29)]
    return control.interconnect(
        blocks, inputs=["stick"], outputs=list(RESPONSE_NAMES), name="closed_loop"
    )


def margins(x29: X29) -> Margins:
    """Return the margins of ``open_loop``, see ``loop_margins``."""
    return loop_margins(open_loop(x29), np.geomspace(0.05, 0.999 * np.pi / x29.frame, 4000))


def loop_margins(loop: StateSpace, omega: np.ndarray) -> Margins:
    """Return the margins of a sampled open loop by ``control.stability_margins`` on its frequency
    response at ``omega`` (rad/s), interpolated.

    The polynomial method of the library is ill conditioned for this order; 4000 points up to the
    folding frequency are not. A margin that does not exist is infinite (its crossover 0).
    """
    import control

    response = control.frd(loop, omega, smooth=True)
    gains, phases, _, _, crossovers, _ = control.stability_margins(response, returnall=True)
    decibel = 20.0 * np.log10(np.asarray(gains))
    phase, crossover = np.asarray(phases), np.asarray(crossovers)
    nearest = int(np.argmin(np.abs(phase))) if phase.size else -1
    return Margins(
        gain_decrease=float(np.max(decibel[decibel < 0.0], initial=-np.inf)),
        gain_increase=float(np.min(decibel[decibel > 0.0], initial=np.inf)),
        phase=float(phase[nearest]) if phase.size else float("inf"),
        crossover=float(crossover[nearest]) if phase.size else 0.0,
    )


def respond(x29: X29, stick: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return time ``(N,)`` and signals of ``RESPONSE_NAMES`` ``(7, N)`` of the linear response to
    a stick with one value a frame, ``(N,)``.
    """
    import control

    time = x29.frame * np.arange(len(stick))
    result = control.forced_response(
        closed_loop(x29), timepts=time, inputs=np.asarray(stick, dtype=float)
    )
    return time, np.asarray(result.outputs).reshape(len(RESPONSE_NAMES), -1)


def frequency_response(x29: X29, omega: np.ndarray, recorded: bool = False) -> np.ndarray:
    """Return the response of alpha, q and incremental nz to the stick, complex ``(3, len(omega))``,
    per inch; ``omega`` in rad/s.

    Stick and outputs are taken at the same frames, so that the hold of the sampled stick is not
    part of it. With ``recorded`` the stick is the recorded one, which leads by ``recorded_skew``.
    """
    response = np.asarray(closed_loop(x29)(np.exp(1j * np.asarray(omega) * x29.frame)))[:3, 0]
    skew = x29.stick.recorded_skew if recorded else 0.0
    return np.asarray(response * np.exp(-1j * np.asarray(omega) * skew))


LOOP_TEST_NAMES = ("sweep", "command", "returned", "q", "nz")


@dataclass(frozen=True)
class LoopNoise:
    """Standard deviations of the noise in a test of the loop.

    Attributes
    ----------
    gyro, accelerometer : deg/s and g, white from frame to frame, in the sensors of the law.
    rough_air : deg of u_p, a disturbance of the surfaces with a time constant of ``rough_air_time``
        s.
    """

    gyro: float = 0.05
    accelerometer: float = 0.005
    rough_air: float = 0.05
    rough_air_time: float = 0.3


def loop_test(
    x29: X29, sweep: np.ndarray, rng: np.random.Generator, noise: LoopNoise = LoopNoise()
) -> np.ndarray:
    """Simulate the linear loop with an excitation that is added to the computer's command.

        command = sweep - returned,   returned = L command + contribution of noise and rough air

    Parameters
    ----------
    sweep : ``(N,)``, deg of u_p at every frame.
    rng : source of the noise and of the rough air.

    Returns
    -------
    ``(5, N)``, the signals of ``LOOP_TEST_NAMES``: deg, deg, deg, rad/s and g (incremental), about
    trim.
    """
    import control

    law, frame = law_matrices(x29.law), x29.frame
    back = _named(
        Matrices(law.A, law.B[:, 1:], -law.C, -law.D[:, 1:]),
        ["read_rate", "read_load"],
        ["returned"],
        "law",
        frame,
    )
    sums = [
        control.summing_junction(["sweep", "-returned"], "command", name="command_sum"),
        control.summing_junction(["command", "rough_air"], "u_p", name="surface_sum"),
        control.summing_junction(["gyro", "gyro_noise"], "read_rate", name="rate_sum"),
        control.summing_junction(["accelerometer", "load_noise"], "read_load", name="load_sum"),
    ]
    driven = ["sweep", "rough_air", "gyro_noise", "load_noise"]
    blocks = [sampled_plant(x29), back, *sums]
    loop = control.interconnect(
        blocks,
        inputs=driven,
        outputs=list(LOOP_TEST_NAMES[1:]),
        check_unused=False,
        name="loop_test",
    )
    white = rng.standard_normal((3, len(sweep)))
    share = np.exp(-frame / noise.rough_air_time)
    air = np.zeros(len(sweep))
    for k in range(1, len(sweep)):
        air[k] = share * air[k - 1] + noise.rough_air * np.sqrt(1.0 - share**2) * white[0, k]
    given = np.array([sweep, air, noise.gyro * white[1], noise.accelerometer * white[2]])
    simulated = control.forced_response(loop, timepts=frame * np.arange(len(sweep)), inputs=given)
    return np.concatenate([given[:1], np.asarray(simulated.outputs)])


def _empty(outputs: int, inputs: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the matrices A, B and C of a block without states."""
    return np.zeros((0, 0)), np.zeros((0, inputs)), np.zeros((outputs, 0))


def _named(
    block: Matrices, inputs: list[str], outputs: list[str], name: str, frame: float = 0.0
) -> Any:
    """Return a block as a python-control system with named signals; ``frame`` is its step, s."""
    import control

    # A block without states is the same in continuous and in sampled time.
    dt = None if block.A.size == 0 else frame
    return control.ss(
        block.A, block.B, block.C, block.D, dt, inputs=inputs, outputs=outputs, name=name
    )


# ---- The low-order equivalent system of the linear loop

FITTED_NAMES = ("L_alpha", "M_alpha", "M_q", "M_delta", "L_delta", "inv_tau", "delay")
# dB per unit of the natural logarithm of a gain; weight 1 (equivalent-system matching)
_DECIBELS_PER_NEPER = 20.0 / math.log(10.0)
# square root of the usual weight 0.01745 of an error of 1 deg, per rad
_PHASE_WEIGHT_ROOT = math.sqrt(0.01745) * 180.0 / math.pi
# Start of the search, and typical magnitudes of the parameters.
_START = np.array([-2.0, -10.0, -1.0, 0.3, 0.0, 12.0, 0.1])
_SCALE = np.array([1.0, 10.0, 3.0, 0.3, 0.01, 10.0, 0.1])
_MOST_STEPS = 12  # most Gauss-Newton steps from a near start
_SETTLED_STEP_SHARE = 1e-6  # largest last step, as a share of each parameter's size


class FitOutcome(Enum):
    """Whether the search for the equivalent system ended at a minimum."""

    CONVERGED = "converged"
    NOT_CONVERGED = "not converged"


@dataclass(frozen=True)
class EquivalentSystem:
    """A fitted low-order equivalent system.

    Attributes
    ----------
    L_alpha, M_alpha, L_q, M_q : 1/s, 1/s2, 1, 1/s.
    M_delta, L_delta : per inch of stick, 1/s2/in and 1/s/in; M_delta > 0 for a nose-up stick.
    inv_tau, delay : 1/s, s.
    natural_frequency, damping_ratio : undamped short-period frequency w (rad/s) and damping, from
        w^2 = L_alpha M_q - L_q M_alpha and 2 damping w = -(L_alpha + M_q); both 0 where w^2 is not
        positive.
    mismatch : mean over channels and frequencies of (error in dB)^2 + 0.01745 (error in deg)^2.
    outcome : how the search ended.
    """

    L_alpha: float
    M_alpha: float
    L_q: float
    M_q: float
    M_delta: float
    L_delta: float
    inv_tau: float
    delay: float
    natural_frequency: float
    damping_ratio: float
    mismatch: float
    outcome: FitOutcome


def equivalent_system(x29: X29, L_q: float = 1.01) -> EquivalentSystem:
    """Fit a low-order equivalent of the recorded linear loop at 40 frequencies from 0.35 to 14
    rad/s; the skew of the recorded stick counts as delay.

    The response relates stick and outputs at the same frames, without the hold of the sampled
    stick. If the stick of a record is held between 40 Hz samples, the delay of the record is about
    half a frame (6 ms) shorter. L_delta is poorly determined: it mostly compensates an ``L_q`` that
    differs from the airframe's.
    """
    omega = np.geomspace(*_MATCHED_BAND, _MATCHED_FREQUENCIES)
    response = frequency_response(x29, omega, recorded=True)
    return fit_equivalent(omega, response, x29.airframe.airspeed, x29.airframe.gravity, L_q)


def fit_equivalent(
    omega: np.ndarray,
    response: np.ndarray,
    airspeed: float,
    gravity: float,
    L_q: float = 1.01,
    near: EquivalentSystem | None = None,
) -> EquivalentSystem:
    """Fit a low-order equivalent system to responses of alpha, q and nz per inch of stick.

    Parameters
    ----------
    omega : ``(n,)``, rad/s, positive.
    response : complex ``(3, n)``: alpha (rad/in), q (rad/s/in), incremental nz (g/in), nowhere
        zero.
    airspeed, gravity : m/s, m/s2.
    L_q : value of L_q, which is fixed.
    near : the equivalent of a similar loop. Gauss-Newton steps start from it; the full search
        follows only if they do not converge.

    Returns the least-squares fit of gain in dB and weighted phase over all three channels with
    equal weight. Raises ModelError when shapes do not agree, a frequency is not positive, or a
    response is zero or not finite.
    """
    from scipy.optimize import least_squares

    omega, response = np.asarray(omega, dtype=float), np.asarray(response, dtype=complex)
    if response.shape != (3, omega.size) or omega.size < 3 or not np.all(omega > 0):
        raise ModelError(
            f"responses of shape {response.shape} at {omega.size} frequencies",
            where="fit_equivalent",
            remedy="give (3, n) at n >= 3 positive frequencies",
        )
    if not (np.all(np.isfinite(response)) and np.all(response != 0)):
        raise ModelError(
            "a response is zero or not finite",
            where="fit_equivalent",
            remedy="leave that frequency out",
        )

    def errors(p: np.ndarray) -> np.ndarray:
        ratio = np.log(
            equivalent_response(
                dict(zip(FITTED_NAMES, p, strict=True)), omega, airspeed, gravity, L_q
            )
            / response
        )
        return np.concatenate(
            [_DECIBELS_PER_NEPER * ratio.real.ravel(), _PHASE_WEIGHT_ROOT * ratio.imag.ravel()]
        )

    if (
        near is not None
        and (settled := _from_near(near, omega, response, airspeed, gravity, L_q)) is not None
    ):
        return settled
    solution = least_squares(
        errors, _START, x_scale=_SCALE, xtol=1e-12, ftol=1e-14, gtol=1e-12, max_nfev=2000
    )
    outcome = FitOutcome.CONVERGED if solution.status > 0 else FitOutcome.NOT_CONVERGED
    return _system(solution.x, L_q, float(2.0 * solution.cost / response.size), outcome)


def _from_near(
    near: EquivalentSystem,
    omega: np.ndarray,
    response: np.ndarray,
    airspeed: float,
    gravity: float,
    L_q: float,
) -> EquivalentSystem | None:
    """Return the fit by Gauss-Newton steps from the equivalent of a similar loop; None if they do
    not converge.
    """
    p, nudge = np.array([getattr(near, name) for name in FITTED_NAMES]), 1e-7 * _SCALE

    def errors(columns: np.ndarray) -> np.ndarray:
        values = dict(zip(FITTED_NAMES, columns[:, :, None], strict=True))
        ratio = np.log(
            equivalent_response(values, omega, airspeed, gravity, L_q) / response[:, None, :]
        )
        return (
            np.concatenate([_DECIBELS_PER_NEPER * ratio.real, _PHASE_WEIGHT_ROOT * ratio.imag])
            .transpose(0, 2, 1)
            .reshape(-1, columns.shape[1])
        )

    with np.errstate(all="ignore"):
        for _ in range(_MOST_STEPS):
            result = errors(p[:, None] + np.column_stack([np.zeros(len(p)), np.diag(nudge)]))
            if not np.all(np.isfinite(result)):
                return None
            step = np.linalg.lstsq(
                (result[:, 1:] - result[:, :1]) / 1e-7, -result[:, 0], rcond=None
            )[0]
            p = p + _SCALE * step
            if np.abs(step).max() < _SETTLED_STEP_SHARE:
                return _system(
                    p, L_q, float(result[:, 0] @ result[:, 0] / response.size), FitOutcome.CONVERGED
                )
    return None


def _system(
    fitted: np.ndarray, L_q: float, mismatch: float, outcome: FitOutcome
) -> EquivalentSystem:
    """Return the system of fitted values in the order of ``FITTED_NAMES``, with its frequency and
    damping.
    """
    values = {name: float(value) for name, value in zip(FITTED_NAMES, fitted, strict=True)}
    stiffness = values["L_alpha"] * values["M_q"] - L_q * values["M_alpha"]
    frequency = math.sqrt(stiffness) if stiffness > 0 else 0.0
    damping = -(values["L_alpha"] + values["M_q"]) / (2.0 * frequency) if frequency else 0.0
    return EquivalentSystem(
        **values,
        L_q=L_q,
        natural_frequency=frequency,
        damping_ratio=damping,
        mismatch=mismatch,
        outcome=outcome,
    )


def equivalent_response(
    values: Mapping[str, Any], omega: np.ndarray, airspeed: float, gravity: float, L_q: float
) -> np.ndarray:
    """Return the response of alpha, q and incremental nz to the stick, complex ``(3, n)``, for
    values of ``FITTED_NAMES``.

    If the values have the shape ``(k, 1)``, the response has the shape ``(3, k, n)``.
    """
    L_alpha, M_alpha, M_q, M_delta, L_delta, inv_tau, delay = (
        values[name] for name in FITTED_NAMES
    )
    s = 1j * omega
    delta = inv_tau / (s + inv_tau) * np.exp(-s * delay)
    determinant = (s - L_alpha) * (s - M_q) - L_q * M_alpha
    alpha = ((s - M_q) * L_delta + L_q * M_delta) / determinant * delta
    q = ((s - L_alpha) * M_delta + M_alpha * L_delta) / determinant * delta
    nz = -(airspeed / gravity) * (L_alpha * alpha + (L_q - 1.0) * q + L_delta * delta)
    return np.stack([alpha, q, nz])
