"""Moving windows over the channels: their weights and bandwidth, and the noise that remains in the
coefficients and in the signals of terms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

# rate -> reference length of the non-dimensional rate
REFERENCE_LENGTHS = {"p": "span", "q": "chord", "r": "span"}


def half_width(rate: float, bandwidth: float, widest: int = 2000) -> int:
    """Return the half-width, in samples, of the window whose slope has a given bandwidth.

    Parameters
    ----------
    rate : sampling rate, Hz.
    bandwidth : half-power bandwidth of the averaging, Hz.
    widest : largest half-width of the search.
    """
    best, beyond = 1, 2
    while bandwidth_of(beyond, rate) >= bandwidth and beyond < widest:
        best, beyond = beyond, 2 * beyond
    while beyond - best > 1:
        middle = (best + beyond) // 2
        if bandwidth_of(middle, rate) >= bandwidth:
            best = middle
        else:
            beyond = middle
    return best


def bandwidth_of(half: int, rate: float) -> float:
    """Return the half-power bandwidth, Hz, of slopes over ``2 half + 1`` samples."""
    kernel = averaging_weights(half)
    f = np.linspace(0.0, 0.5, 2001)
    n = np.arange(len(kernel)) - (len(kernel) - 1) / 2.0
    gain = np.abs(np.cos(2.0 * np.pi * np.outer(f, n)) @ kernel)
    below = np.nonzero(gain < math.sqrt(0.5))[0]
    return rate * float(f[below[0]]) if len(below) else 0.5 * rate


def slope_weights(half: int) -> np.ndarray:
    """Return the weights ``(2 half + 1,)`` of the slope of a local parabola, per sample."""
    n = np.arange(-half, half + 1, dtype=float)
    return n / float(n @ n)


def averaging_weights(half: int) -> np.ndarray:
    """Return the weights ``(2 half,)`` of the increments between samples in the slope of a
    window.
    """
    return -np.cumsum(slope_weights(half))[:-1]


def windows(values: np.ndarray, width: int, rows: np.ndarray) -> np.ndarray:
    """Return the windows of ``width`` samples that begin at ``rows``."""
    return np.lib.stride_tricks.sliding_window_view(values, width)[rows]


def noise_of(values: np.ndarray) -> float:
    """Return the standard deviation of the white noise of a channel, from the residuals of local
    quartics. The median of the residuals is robust against single jumps.

    ``values (N,)`` have equal steps.
    """
    from scipy.signal import savgol_coeffs, savgol_filter

    width = 9
    if len(values) < 3 * width:
        return float(np.std(np.diff(values)) / math.sqrt(2.0))
    residual = values - savgol_filter(values, width, 4)
    residual_share = 1.0 - float(savgol_coeffs(width, 4)[width // 2])
    # 1.4826 times the median of the sizes is the standard deviation of normal noise
    return float(1.4826 * np.median(np.abs(residual)) / math.sqrt(residual_share))


def signal_noise_levels(
    noise: Mapping[str, float],
    kernel: np.ndarray,
    half: int,
    c: Mapping[str, np.ndarray],
    s: Mapping[str, np.ndarray],
) -> dict[str, float]:
    """Return the standard deviations of the signals of terms after smoothing and averaging.

    Parameters
    ----------
    noise : channel -> standard deviation of its noise.
    kernel : weights of the averaging of the forces.
    half : half-width of the smoothing window, samples.
    c, s : constants of the airframe and channels, ``(N - 1,)`` each.
    """
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
    """Return coefficient -> standard deviation ``(M,)`` due to white noise of the channels.

    Parameters
    ----------
    force_sigmas : result of `force_noise_levels`.
    noise : channel -> standard deviation of its noise.
    slope : weights of the slope of a window, 1/s.
    c, s : constants of the airframe and channels, ``(N - 1,)`` each.
    at : ``(M,)`` centres of the windows.
    """
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
