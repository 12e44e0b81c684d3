"""The sampled closed loop of the X-29-like aircraft written a second way: difference equations and
Runge-Kutta at 0.1 ms.

Shares the numbers with the package and nothing else: no matrices, no exponentials, limits by
clipping inside the derivative.
"""

from __future__ import annotations

import math

import numpy as np

from sim.closed_loop.airframe import X29


def march(x29: X29, stick: np.ndarray, steps_per_frame: int = 125) -> dict[str, np.ndarray]:
    """Histories of alpha, q, nz (incremental), canard, flaperon, strake and u_p at the frames of
    ``stick``.
    """
    a, law, shaping = x29.airframe, x29.law, x29.stick
    T = 1.0 / law.frame_rate
    h = T / steps_per_frame
    low = [s.lower - s.trim for s in x29.surfaces]
    high = [s.upper - s.trim for s in x29.surfaces]

    def ram_rate(i: int, source: float, position: float) -> float:
        wanted = max(
            -x29.surfaces[i].rate,
            min(x29.surfaces[i].rate, x29.surfaces[i].ram * (source - position)),
        )
        if (position >= high[i] and wanted > 0.0) or (position <= low[i] and wanted < 0.0):
            return 0.0
        return wanted

    def lift_rate(x: list[float]) -> float:
        return a.L_surface[0] * x[4] + a.L_surface[1] * x[7] + a.L_surface[2] * x[8]

    def load(x: list[float]) -> float:
        return -a.airspeed / a.gravity * (a.L_alpha * x[0] + (a.L_q - 1.0) * x[1] + lift_rate(x))

    def slope(x: list[float], command: list[float]) -> list[float]:
        alpha, q, c, c_dot, canard, f, f_dot, flaperon, strake, g, g_dot, n, n_dot = x
        canard_servo, flaperon_servo = x29.surfaces[0], x29.surfaces[1]
        wc, wf = canard_servo.servo_frequency, flaperon_servo.servo_frequency
        zc, zf = canard_servo.servo_damping, flaperon_servo.servo_damping
        assert wc and wf and zc and zf
        wg, wn = x29.gyro.frequency, x29.accelerometer.frequency
        moment = a.M_surface[0] * canard + a.M_surface[1] * flaperon + a.M_surface[2] * strake
        return [
            a.L_alpha * alpha + a.L_q * q + lift_rate(x),
            a.M_alpha * alpha + a.M_q * q + moment,
            c_dot,
            wc**2 * (command[0] - c) - 2.0 * zc * wc * c_dot,
            ram_rate(0, c, canard),
            f_dot,
            wf**2 * (command[1] - f) - 2.0 * zf * wf * f_dot,
            ram_rate(1, f, flaperon),
            ram_rate(2, command[2], strake),
            g_dot,
            wg**2 * (math.degrees(q) - g) - 2.0 * x29.gyro.damping * wg * g_dot,
            n_dot,
            wn**2 * (load(x) - n) - 2.0 * x29.accelerometer.damping * wn * n_dot,
        ]

    x = [0.0] * 13
    queue = [0.0] * shaping.delay_frames
    commands = [0.0] * law.delay_frames
    c = 2.0 / T
    old_geared = r = old_error = integral = old_blend = filtered = 0.0
    names = ("alpha", "q", "nz", "canard", "flaperon", "strake", "u_p")
    rows: list[list[float]] = []
    for value in stick:
        # The computer at this frame: read everything, put the new command at the end of the queue,
        # send the oldest.
        u_p = commands.pop(0)
        rows.append([x[0], x[1], load(x), x[4], x[7], x[8], u_p])
        e = math.copysign(max(abs(value) - shaping.dead_band, 0.0), value)
        queue.append(shaping.gain * e * (1.0 + shaping.curvature * abs(e)))
        geared = queue.pop(0)
        # (2/T)(r - r') + wp (r + r') = wp (geared + geared'), halves cancelled; likewise below.
        r = ((c - shaping.lag) * r + shaping.lag * (geared + old_geared)) / (c + shaping.lag)
        old_geared = geared
        error = r - x[11] - law.Kqi * x[9]
        integral += T / 2.0 * (error + old_error)
        old_error = error
        blend = law.Kn * x[11] + law.Kq * x[9]
        filtered = (
            blend + old_blend + c / law.lead * (blend - old_blend) - (1.0 - c / law.lag) * filtered
        ) / (1.0 + c / law.lag)
        old_blend = blend
        commands.append(-filtered + law.Ki * integral)
        sent = [max(low[i], min(high[i], x29.surfaces[i].mixing * u_p)) for i in range(3)]
        for _ in range(steps_per_frame):
            k1 = slope(x, sent)
            k2 = slope([p + h / 2.0 * k for p, k in zip(x, k1, strict=True)], sent)
            k3 = slope([p + h / 2.0 * k for p, k in zip(x, k2, strict=True)], sent)
            k4 = slope([p + h * k for p, k in zip(x, k3, strict=True)], sent)
            x = [
                p + h / 6.0 * (i + 2.0 * j + 2.0 * k + m)
                for p, i, j, k, m in zip(x, k1, k2, k3, k4, strict=True)
            ]
    return dict(zip(names, np.array(rows).T, strict=True))
