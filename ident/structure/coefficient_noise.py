"""Noise of the coefficients, and of the signals of terms, that noise of the channels causes."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

# rate -> reference length of the non-dimensional rate
REFERENCE_LENGTHS = {"p": "span", "q": "chord", "r": "span"}


def signal_noise_levels(
    noise: Mapping[str, float],
    kernel: np.ndarray,
    half: int,
    c: Mapping[str, np.ndarray],
    s: Mapping[str, np.ndarray],
) -> dict[str, float]:
    """Return the standard deviations of the signals of terms after smoothing and averaging."""
    from scipy.signal import savgol_coeffs

    remaining_share = math.sqrt(
        float(np.sum(np.convolve(kernel, savgol_coeffs(max(2 * half + 1, 7), 4)) ** 2))
    )
    speed = float(np.mean(s["airspeed"]))
    lengths = {name: float(np.mean(c[key])) for name, key in REFERENCE_LENGTHS.items()}
    scale = {name: 0.5 * length / speed for name, length in lengths.items()}
    return {
        name: noise[name] * remaining_share * scale.get(name, 1.0)
        for name in ("alpha", "beta", *REFERENCE_LENGTHS)
    }


def force_noise_levels(
    noise: Mapping[str, float],
    kernel: np.ndarray,
    half: int,
    step: float,
    position: tuple[float, float, float],
) -> dict[str, float]:
    """Return the standard deviations of the averaged specific forces at the centre of gravity,
    m/s2.

    The noise is that of the accelerometers, and that of the rates, whose slopes correct for the
    ``position`` of the accelerometers, m from the centre of gravity.
    """
    from scipy.signal import savgol_coeffs

    force_share = math.sqrt(float(np.sum(kernel**2)))
    smooth = np.convolve(kernel, savgol_coeffs(max(2 * half + 1, 7), 4))
    sloped = np.convolve(smooth, np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / (12.0 * step))
    rate_share = math.sqrt(float(np.sum(sloped**2)))
    x, y, z = position
    p, q, r = (rate_share * noise[name] for name in "pqr")
    by_rates = {"ax": math.hypot(z * q, y * r), "ay": math.hypot(x * r, z * p)}
    by_rates["az"] = math.hypot(x * q, y * p)
    return {
        name: math.hypot(force_share * noise[name], rate_part)
        for name, rate_part in by_rates.items()
    }


def coefficient_sigmas(
    force_sigmas: Mapping[str, float],
    noise: Mapping[str, float],
    slope: np.ndarray,
    c: Mapping[str, np.ndarray],
    s: Mapping[str, np.ndarray],
    at: np.ndarray,
) -> dict[str, np.ndarray]:
    """Return the standard deviations of the coefficients due to white noise of the channels."""
    qS_windows = (0.5 * c["air_density"] * s["airspeed"] ** 2 * c["wing_area"])[at]
    sloped = math.sqrt(float(slope @ slope))
    m = c["mass"][at]
    ax, ay, az = (m * force_sigmas[name] / qS_windows for name in ("ax", "ay", "az"))
    Ix, Iy, Iz, Ixz = (
        c[name][at] for name in ("roll_inertia", "pitch_inertia", "yaw_inertia", "cross_inertia")
    )
    b, chord = c["span"][at], c["chord"][at]
    x, y, z = (c[name][at] for name in ("cg_x", "cg_y", "cg_z"))
    sine, cosine = np.sin(s["alpha"][at]), np.cos(s["alpha"][at])
    roll = np.hypot(Ix * noise["p"], Ixz * noise["r"]) * sloped / (qS_windows * b)
    yaw = np.hypot(Iz * noise["r"], Ixz * noise["p"]) * sloped / (qS_windows * b)
    pitch = Iy * noise["q"] * sloped / (qS_windows * chord)
    return {
        "CX": ax,
        "CY": ay,
        "CZ": az,
        "CD": np.hypot(ax * cosine, az * sine),
        "CL": np.hypot(ax * sine, az * cosine),
        "Cl": np.sqrt(roll**2 + (y * az / b) ** 2 + (z * ay / b) ** 2),
        "Cm": np.sqrt(pitch**2 + (z * ax / chord) ** 2 + (x * az / chord) ** 2),
        "Cn": np.sqrt(yaw**2 + (x * ay / b) ** 2 + (y * ax / b) ** 2),
    }
