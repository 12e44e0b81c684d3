"""The linear closed loop as python-control systems with named signals.

The reading that reproduces the reference margins of P, S and F: airframe, actuators and both sensors are sampled together by exact
hold at 80 Hz (the hold is on u_p); lead-lag and integrator by Tustin's rule; one frame of computing delay after them; nz is
taken at the centre of gravity and includes the surfaces' lift; the loop is broken at u_p, the command of the computer before mixing.

Signals: ``stick`` (in), ``r`` (g), ``u_p`` (deg), ``canard flaperon strake`` (deg), ``alpha`` (rad), ``q`` (rad/s), ``nz``
(incremental, g), ``gyro`` (deg/s), ``accelerometer`` (g). Dead band and curvature of the stick are absent here: gain K alone.
"""

from __future__ import annotations

from dataclasses import dataclass
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

if TYPE_CHECKING:
    from control import StateSpace

RESPONSE_NAMES = ("alpha", "q", "nz", *SURFACE_NAMES, "u_p")


@dataclass(frozen=True)
class Margins:
    """Stability margins of a loop.

    Attributes
    ----------
    gain_decrease, gain_increase : dB by which the loop gain may fall (negative) or rise (positive).
    phase : smallest phase margin, deg.
    crossover : frequency of that phase margin, rad/s.
    """

    gain_decrease: float
    gain_increase: float
    phase: float
    crossover: float


def continuous_plant(x29: X29) -> StateSpace:
    """Mixer, actuators, airframe and sensors: from ``u_p`` to every signal of ``OUTPUT_NAMES``; continuous, no limits."""
    import control

    blocks = [_named(Matrices(*_empty(3, 1), mixing(x29)[:, None]), ["u_p"], [f"{name}_command" for name in SURFACE_NAMES], "mixer")]
    for surface in x29.surfaces:
        blocks.append(_named(actuator_matrices(surface), [f"{surface.name}_command"], [surface.name], f"{surface.name}_actuator"))
    blocks.append(_named(airframe_matrices(x29.airframe), list(SURFACE_NAMES), ["alpha", "q", "nz"], "airframe"))
    blocks.append(_named(sensor_matrices(x29.gyro, 1.0 / DEGREE), ["q"], ["gyro"], "rate_gyro"))
    blocks.append(_named(sensor_matrices(x29.accelerometer, 1.0), ["nz"], ["accelerometer"], "nz_sensor"))
    return control.interconnect(blocks, inputs=["u_p"], outputs=list(OUTPUT_NAMES), name="plant")


def sampled_plant(x29: X29) -> StateSpace:
    """``continuous_plant`` at the frames of the computer, u_p held between them (exact)."""
    return continuous_plant(x29).sample(x29.frame, "zoh", name="sampled_plant")


def control_law(x29: X29) -> StateSpace:
    """The sampled law from ``r``, ``gyro``, ``accelerometer`` to ``u_p``, computing delay included."""
    return _named(law_matrices(x29.law), ["r", "gyro", "accelerometer"], ["u_p"], "law", x29.frame)


def stick_shaping(x29: X29) -> StateSpace:
    """From ``stick`` to ``r`` for a stick beyond no break-out: gain K, N frames of delay, lag."""
    shaping = shaping_matrices(x29.stick, x29.frame)
    gained = Matrices(shaping.A, x29.stick.gain * shaping.B, shaping.C, x29.stick.gain * shaping.D)
    return _named(gained, ["stick"], ["r"], "shaping", x29.frame)


def open_loop(x29: X29) -> StateSpace:
    """The sampled loop broken at u_p: from ``u_p`` to ``returned``, the negated command that comes back; 1 + L = 0 closes it."""
    import control

    law = law_matrices(x29.law)
    back = _named(Matrices(law.A, law.B[:, 1:], -law.C, -law.D[:, 1:]), ["gyro", "accelerometer"], ["returned"], "law", x29.frame)
    return control.interconnect([sampled_plant(x29), back], inputs=["u_p"], outputs=["returned"], check_unused=False, name="open_loop")


def closed_loop(x29: X29) -> StateSpace:
    """The sampled closed loop from ``stick`` to the signals of ``RESPONSE_NAMES``."""
    import control

    blocks = [sampled_plant(x29), control_law(x29), stick_shaping(x29)]
    return control.interconnect(blocks, inputs=["stick"], outputs=list(RESPONSE_NAMES), name="closed_loop")


def margins(x29: X29) -> Margins:
    """Margins of ``open_loop``, see ``loop_margins``."""
    return loop_margins(open_loop(x29), np.geomspace(0.05, 0.999 * np.pi / x29.frame, 4000))


def loop_margins(loop: StateSpace, omega: np.ndarray) -> Margins:
    """Margins of a sampled open loop by ``control.stability_margins`` on its frequency response at ``omega`` (rad/s), interpolated.

    The polynomial method of the library is ill conditioned for this order; 4000 points up to the folding frequency are not.
    A margin that does not exist is infinite (its crossover 0).
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
    """Linear response to a stick given at every frame, shape ``(N,)``: time ``(N,)`` and signals of ``RESPONSE_NAMES``, ``(7, N)``."""
    import control

    time = x29.frame * np.arange(len(stick))
    result = control.forced_response(closed_loop(x29), timepts=time, inputs=np.asarray(stick, dtype=float))
    return time, np.asarray(result.outputs).reshape(len(RESPONSE_NAMES), -1)


def frequency_response(x29: X29, omega: np.ndarray, recorded: bool = False) -> np.ndarray:
    """Response of alpha, q and incremental nz to the stick, complex ``(3, len(omega))``, per inch; ``omega`` in rad/s.

    Stick and outputs are taken at the same frames, so that the hold of the sampled stick is not part of it.
    With ``recorded`` the stick is the recorded one, which leads by ``recorded_skew``.
    """
    response = np.asarray(closed_loop(x29)(np.exp(1j * np.asarray(omega) * x29.frame)))[:3, 0]
    skew = x29.stick.recorded_skew if recorded else 0.0
    return np.asarray(response * np.exp(-1j * np.asarray(omega) * skew))


LOOP_TEST_NAMES = ("sweep", "command", "returned", "q", "nz")


@dataclass(frozen=True)
class LoopNoise:
    """What disturbs a test of the loop, standard deviations.

    Attributes
    ----------
    gyro, accelerometer : deg/s and g, white from frame to frame, of the sensors that the law reads.
    rough_air : deg of u_p, a disturbance of the surfaces with a time constant of ``rough_air_time`` s.
    """

    gyro: float = 0.05
    accelerometer: float = 0.005
    rough_air: float = 0.05
    rough_air_time: float = 0.3


def loop_test(x29: X29, sweep: np.ndarray, rng: np.random.Generator, noise: LoopNoise = LoopNoise()) -> np.ndarray:
    """Fly the linear loop with an excitation that is added to the computer's command.

        command = sweep - returned,   returned = L command + what noise and rough air bring back

    Parameters
    ----------
    sweep : ``(N,)``, deg of u_p at every frame. rng : of noise and rough air.

    Returns
    -------
    ``(5, N)``, the signals of ``LOOP_TEST_NAMES``: deg, deg, deg, rad/s and g (incremental), about trim.
    """
    import control

    law, frame = law_matrices(x29.law), x29.frame
    back = _named(Matrices(law.A, law.B[:, 1:], -law.C, -law.D[:, 1:]), ["read_rate", "read_load"], ["returned"], "law", frame)
    sums = [
        control.summing_junction(["sweep", "-returned"], "command", name="command_sum"),
        control.summing_junction(["command", "rough_air"], "u_p", name="surface_sum"),
        control.summing_junction(["gyro", "gyro_noise"], "read_rate", name="rate_sum"),
        control.summing_junction(["accelerometer", "load_noise"], "read_load", name="load_sum"),
    ]
    driven = ["sweep", "rough_air", "gyro_noise", "load_noise"]
    blocks = [sampled_plant(x29), back, *sums]
    loop = control.interconnect(blocks, inputs=driven, outputs=list(LOOP_TEST_NAMES[1:]), check_unused=False, name="loop_test")
    white = rng.standard_normal((3, len(sweep)))
    share = np.exp(-frame / noise.rough_air_time)
    air = np.zeros(len(sweep))
    for k in range(1, len(sweep)):
        air[k] = share * air[k - 1] + noise.rough_air * np.sqrt(1.0 - share**2) * white[0, k]
    given = np.array([sweep, air, noise.gyro * white[1], noise.accelerometer * white[2]])
    flown = control.forced_response(loop, timepts=frame * np.arange(len(sweep)), inputs=given)
    return np.concatenate([given[:1], np.asarray(flown.outputs)])


def _empty(outputs: int, inputs: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.zeros((0, 0)), np.zeros((0, inputs)), np.zeros((outputs, 0))


def _named(block: Matrices, inputs: list[str], outputs: list[str], name: str, frame: float = 0.0) -> Any:
    import control

    # Without states a block is continuous and sampled alike.
    dt = None if block.A.size == 0 else frame
    return control.ss(block.A, block.B, block.C, block.D, dt, inputs=inputs, outputs=outputs, name=name)
