"""Frequency response of the X-29-like sampled loop written a second way: transfer functions by
hand, sampling as a sum of aliases.

The transform of a continuous response that is sampled, behind a hold, is the sum over all multiples
of the sampling frequency of G(s) (1 - exp(-s T))/(s T): no exponential of a matrix, no state space,
no library.
"""

from __future__ import annotations

import numpy as np

from sim.closed_loop.airframe import X29


def signals(x29: X29, s: np.ndarray) -> dict[str, np.ndarray]:
    """Continuous responses to u_p: alpha, q, nz, gyro (deg/s), accelerometer."""
    a = x29.airframe
    surfaces = []
    for surface in x29.surfaces:
        response = surface.mixing * surface.ram / (s + surface.ram)
        if surface.servo_frequency is not None and surface.servo_damping is not None:
            response = response / (
                1.0
                + 2.0 * surface.servo_damping * s / surface.servo_frequency
                + (s / surface.servo_frequency) ** 2
            )
        surfaces.append(response)
    lift = sum(
        derivative * response for derivative, response in zip(a.L_surface, surfaces, strict=True)
    )
    moment = sum(
        derivative * response for derivative, response in zip(a.M_surface, surfaces, strict=True)
    )
    determinant = (s - a.L_alpha) * (s - a.M_q) - a.L_q * a.M_alpha
    alpha = ((s - a.M_q) * lift + a.L_q * moment) / determinant
    q = ((s - a.L_alpha) * moment + a.M_alpha * lift) / determinant
    nz = a.airspeed / a.gravity * (q - s * alpha)
    gyro = (
        180.0
        / np.pi
        * q
        / (1.0 + 2.0 * x29.gyro.damping * s / x29.gyro.frequency + (s / x29.gyro.frequency) ** 2)
    )
    lagged = nz / (
        1.0
        + 2.0 * x29.accelerometer.damping * s / x29.accelerometer.frequency
        + (s / x29.accelerometer.frequency) ** 2
    )
    return {"alpha": alpha, "q": q, "nz": nz, "gyro": gyro, "accelerometer": lagged}


def sampled(x29: X29, omega: np.ndarray, aliases: int = 4000) -> dict[str, np.ndarray]:
    """The same responses from held u_p to samples, at ``omega`` (rad/s)."""
    T = 1.0 / x29.law.frame_rate
    k = np.arange(-aliases, aliases + 1)
    s = 1j * (omega[:, None] + 2.0 * np.pi / T * k)
    hold = (1.0 - np.exp(-s * T)) / (s * T)
    return {name: np.sum(hold * response, axis=1) for name, response in signals(x29, s).items()}


def returned(x29: X29, omega: np.ndarray, aliases: int = 4000) -> np.ndarray:
    """L(exp(j omega T)): the negated command that comes back for a unit u_p."""
    law, seen = x29.law, sampled(x29, omega, aliases)
    T = 1.0 / law.frame_rate
    z = np.exp(1j * omega * T)
    s = 2.0 / T * (z - 1.0) / (z + 1.0)
    blend = (
        (1.0 + s / law.lead)
        / (1.0 + s / law.lag)
        * (law.Kn * seen["accelerometer"] + law.Kq * seen["gyro"])
    )
    return np.asarray(
        z**-law.delay_frames
        * (blend + law.Ki / s * (seen["accelerometer"] + law.Kqi * seen["gyro"]))
    )


def stick_response(x29: X29, omega: np.ndarray) -> np.ndarray:
    """alpha, q, nz per inch of stick from frame to frame, ``(3, n)``; gain K alone, no
    break-out.
    """
    T = 1.0 / x29.law.frame_rate
    z = np.exp(1j * omega * T)
    s = 2.0 / T * (z - 1.0) / (z + 1.0)
    r = x29.stick.gain * z**-x29.stick.delay_frames * x29.stick.lag / (s + x29.stick.lag)
    u_p = z**-x29.law.delay_frames * x29.law.Ki / s * r / (1.0 + returned(x29, omega))
    seen = sampled(x29, omega)
    return np.stack([seen[name] * u_p for name in ("alpha", "q", "nz")])
