"""Histories of the aerodynamic coefficients from measured motion.

Accelerometers measure the forces without weight. Angular accelerations are slopes of local
parabolas through the measured rates (Savitzky and Golay [1]_). Such a slope is a weighted mean of
the true angular acceleration. All other terms of the equations are averaged with the same weights,
so that smoothing causes no bias. In body axes,

    CX = (m ax - X_T) / (q S),   Cl = (Ix p' - Ixz (p q + r') + (Iz - Iy) q r) / (q S b)

and so on, with moments about the reference point and not the centre of gravity [2]_.

References
----------
.. [1] A. Savitzky and M. J. E. Golay, Analytical Chemistry 36(8), 1964.
.. [2] V. Klein and E. A. Morelli, Aircraft System Identification, AIAA 2006, section 5.2 and
   appendix B.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sim.aerodynamics import Term
from sim.errors import RecordError

# ---- Moving windows over the channels: weights, bandwidth, and the noise that remains

# constants of an airframe that does not give them
_DEFAULT_CONSTANTS = dict.fromkeys(("cg_x", "cg_y", "cg_z", "thrust_arm", "thrust_angle"), 0.0) | {
    "speed_of_sound": 340.294
}
_INERTIAS = ("roll_inertia", "pitch_inertia", "yaw_inertia", "cross_inertia")
# rate -> reference length of the non-dimensional rate
REFERENCE_LENGTHS = {"p": "span", "q": "chord", "r": "span"}


def half_width(rate: float, bandwidth: float, widest: int = 2000) -> int:
    """Return the half-width, in samples, at most ``widest``, of the window whose slope has the
    half-power ``bandwidth``, Hz, at the sampling ``rate``, Hz.
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
    """Return the weights ``(2 half,)`` of the increments between samples in such a slope."""
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


def _signal_noise_levels(
    noise: Mapping[str, float],
    kernel: np.ndarray,
    half: int,
    c: Mapping[str, np.ndarray],
    s: Mapping[str, np.ndarray],
) -> dict[str, float]:
    """Return the standard deviations of the signals of terms after smoothing and averaging.

    ``noise`` maps a channel to the standard deviation of its noise. ``kernel`` are the weights of
    the averaging of the forces, ``half`` is the half-width of the smoothing window, samples, and
    ``c`` and ``s`` are the constants of the airframe and the channels, ``(N - 1,)`` each.
    """
    from scipy.signal import savgol_coeffs

    smooth = np.convolve(kernel, savgol_coeffs(max(2 * half + 1, 7), 4))
    remaining_share = math.sqrt(float(np.sum(smooth**2)))
    speed = float(np.mean(s["airspeed"]))
    lengths = {name: float(np.mean(c[key])) for name, key in REFERENCE_LENGTHS.items()}
    scale = {name: 0.5 * length / speed for name, length in lengths.items()}
    return {
        name: noise[name] * remaining_share * scale.get(name, 1.0)
        for name in ("alpha", "beta", *REFERENCE_LENGTHS)
    }


def _force_noise_levels(
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
    by_rates = {"ax": (z * q, y * r), "ay": (x * r, z * p), "az": (x * q, y * p)}
    return {
        name: math.hypot(force_share * noise[name], math.hypot(*parts))
        for name, parts in by_rates.items()
    }


def _coefficient_sigmas(
    force_sigmas: Mapping[str, float],
    noise: Mapping[str, float],
    slope: np.ndarray,
    c: Mapping[str, np.ndarray],
    s: Mapping[str, np.ndarray],
    at: np.ndarray,
) -> dict[str, np.ndarray]:
    """Return coefficient -> standard deviation ``(M,)`` due to white noise of the channels.

    ``force_sigmas`` is the result of `_force_noise_levels`, ``slope`` are the weights of the slope
    of a window, 1/s, and ``at (M,)`` the centres of the windows.
    """
    qS_windows = (0.5 * c["air_density"] * s["airspeed"] ** 2 * c["wing_area"])[at]
    sloped = math.sqrt(float(slope @ slope))
    m = c["mass"][at]
    ax, ay, az = (m * force_sigmas[name] / qS_windows for name in ("ax", "ay", "az"))
    Ix, Iy, Iz, Ixz = (c[name][at] for name in _INERTIAS)
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


# ---- Histories of the coefficients

BODY, WIND, MOMENTS = ("CX", "CY", "CZ"), ("CD", "CY", "CL"), ("Cl", "Cm", "Cn")
DERIVATIVE_BANDWIDTH = 3.0  # Hz, half-power bandwidth of the smoothed derivative
NEEDED_CHANNELS = ("airspeed", "alpha", "beta", "p", "q", "r", "ax", "ay", "az")
_ZERO = (0.0, 0.0, 0.0)
_SIMPSON_WEIGHTS = np.array([1.0, 4.0, 1.0]) / 6.0  # weights of the mean over an interval
_SMOOTHED_CHANNELS = ("airspeed", "alpha", "beta", "p", "q", "r")
Point = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Airframe:
    """Constants that convert motion to coefficients, in SI units and body axes.

    Attributes
    ----------
    constants : mass, wing_area, chord, span, the four inertias, air_density, speed_of_sound,
        thrust_arm, thrust_angle, and the position of the centre of gravity relative to the
        reference point, cg_x, cg_y and cg_z. Each is a number or ``(N,)``.
    sensors : positions of ``airspeed``, ``alpha``, ``beta`` and ``accelerometer`` relative to the
        centre of gravity, m.
    wind_axes : whether forces are CD, CY, CL instead of CX, CY, CZ.
    """

    constants: Mapping[str, Any]
    sensors: Mapping[str, Point] = field(default_factory=dict)
    wind_axes: bool = False

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the six coefficients."""
        return (*(WIND if self.wind_axes else BODY), *MOMENTS)


@dataclass(frozen=True, eq=False)
class Histories:
    """Coefficients of one maneuver of N samples, averaged over M windows that overlap by half.

    Attributes
    ----------
    name : name of the record.
    time : ``(M,)`` middle of the windows, s.
    signals : signal of terms -> ``(3, N - 1)`` values at the begin, the middle and the end of each
        interval between samples; used for moments. Rates are non-dimensional.
    samples : signal of terms -> ``(N,)`` values at the samples; used for forces.
    coefficients : coefficient -> ``(M,)``.
    sigma : coefficient -> ``(M,)`` standard deviation of its noise.
    averaging : ``(W,)`` weights over a window, with sum 1.
    rows : ``(M,)`` first sample of each window.
    bandwidth : half-power bandwidth of the averaging, Hz.
    signal_noise : signal -> standard deviation of its noise after smoothing and averaging.
    slopes : coefficient -> signal -> ``(M,)`` derivative of the measured coefficient with respect
        to the signal. In wind axes, alpha turns the measured forces into lift and drag.
    """

    name: str
    time: np.ndarray
    signals: Mapping[str, np.ndarray]
    samples: Mapping[str, np.ndarray]
    coefficients: Mapping[str, np.ndarray]
    sigma: Mapping[str, np.ndarray]
    averaging: np.ndarray
    rows: np.ndarray
    bandwidth: float
    signal_noise: Mapping[str, float] = field(default_factory=dict)
    slopes: Mapping[str, Mapping[str, np.ndarray]] = field(default_factory=dict)

    def coefficient_noise(self, axis: str) -> np.ndarray:
        """Return the error ``(s, M)`` of a measured coefficient that an error of one standard
        deviation in each signal causes, in the order of ``signal_noise``.
        """
        slopes, zero = self.slopes.get(axis, {}), np.zeros(len(self.time))
        rows = [std * slopes.get(name, zero) for name, std in self.signal_noise.items()]
        return np.array(rows).reshape(-1, len(self.time))

    def noise_variance(self, table: Mapping[Term, float], axis: str) -> np.ndarray:
        """Return the variance ``(M,)`` that the noise of the signals causes in the coefficient
        ``axis`` minus the sum of its terms. ``table`` maps the terms to their values.
        """
        total = np.zeros(len(self.time))
        coefficient_errors = self.coefficient_noise(axis)
        for row, (name, std) in zip(coefficient_errors, self.signal_noise.items(), strict=True):
            terms = {term: value for term, value in table.items() if name in term.signals}
            if std == 0.0 or not terms:
                total += 0.0 if std == 0.0 else row**2
                continue
            changed = (
                replace(
                    self,
                    signals={**self.signals, name: self.signals[name] + sign * std},
                    samples={**self.samples, name: self.samples[name] + sign * std},
                )
                for sign in (0.5, -0.5)
            )
            high, low = (
                sum(value * history.column(term, axis) for term, value in terms.items())
                for history in changed
            )
            total += (row - (high - low)) ** 2
        return total

    def column(self, term: Term, axis: str) -> np.ndarray:
        """Return the means ``(M,)`` of a term over the windows, averaged as the coefficient
        ``axis`` is.
        """
        if axis in MOMENTS:
            between = np.broadcast_to(term.of(self.signals), self.signals["alpha"].shape)
            values, kernel = _SIMPSON_WEIGHTS @ between, self.averaging
        else:
            values = np.broadcast_to(term.of(self.samples), self.samples["alpha"].shape)
            kernel = np.convolve(self.averaging, (0.5, 0.5))
        return np.asarray(windows(values.astype(float), len(kernel), self.rows) @ kernel)


def histories_of(
    name: str,
    time: np.ndarray,
    channels: Mapping[str, np.ndarray],
    airframe: Airframe,
    surfaces: Mapping[str, np.ndarray],
    thrust: np.ndarray | float = 0.0,
    bandwidth: float = DERIVATIVE_BANDWIDTH,
    *,
    held: bool = False,
) -> Histories:
    """Return the coefficients of a maneuver from its channels, moments about the reference point.

    Parameters
    ----------
    name : name of the record, for messages.
    time : ``(N,)``, s, with equal steps.
    channels : each of ``NEEDED_CHANNELS`` -> ``(N,)`` finite values in m/s, rad, rad/s or m/s2.
        Accelerations are without weight.
    surfaces : further signal of terms -> ``(N,)``.
    thrust : N, a number or ``(N,)``.
    bandwidth : half-power bandwidth of the angular accelerations, Hz.
    held : whether surfaces and thrust are constant until the next sample; otherwise they are linear
        between samples.

    Raises
    ------
    RecordError : where a channel is missing, or the record is too short for the bandwidth.
    """
    step = float(np.median(np.diff(time)))
    half = half_width(1.0 / step, bandwidth, len(time) // 4)
    _refuse_incomplete(name, channels, len(time), half, bandwidth)
    smooth = _smooth(channels, half)
    jumps = _acceleration_jumps(channels, smooth, surfaces, step) if held else {}
    s = _at_centre_of_gravity(smooth, airframe, step, jumps)
    constants = {**_DEFAULT_CONSTANTS, **airframe.constants}
    c = {key: np.broadcast_to(np.asarray(v, float), time.shape) for key, v in constants.items()}
    rows = np.arange(0, len(time) - 2 * half, half)
    kernel = averaging_weights(half)
    at = rows + half
    slope = slope_weights(half) / step
    angular_acceleration = {
        rate: windows(channels[rate], len(slope), rows) @ slope for rate in ("p", "q", "r")
    }

    def mean(values: np.ndarray) -> np.ndarray:
        return np.asarray(windows(_SIMPSON_WEIGHTS @ values, len(kernel), rows) @ kernel)

    T = np.broadcast_to(np.asarray(thrust, dtype=float), time.shape)
    samples = {**_common_signals(s, c), **surfaces}
    force = _forces(s, c, T, airframe)
    force_kernel = np.convolve(kernel, (0.5, 0.5))
    coefficients = {
        axis: windows(force[axis], len(force_kernel), rows) @ force_kernel
        for axis in airframe.axes[:3]
    }
    c = {key: _on_intervals(row) for key, row in c.items()}
    slope_jumps = {key: 2.0 * step * row for key, row in jumps.items()}
    s = {
        key: _on_intervals(row, slope_jumps.get(key, 0.0), smooth=key in _SMOOTHED_CHANNELS)
        for key, row in s.items()
    }
    T = _on_intervals(T, held=held)
    surface_signals = {key: _on_intervals(row, held=held) for key, row in surfaces.items()}
    signals = {**_common_signals(s, c), **surface_signals}
    s1, c1 = ({key: row[1] for key, row in each.items()} for each in (s, c))
    coefficients |= _moments(s, c, angular_acceleration, mean, at, T)
    noises = {key: noise_of(channels[key]) for key in NEEDED_CHANNELS}
    position = airframe.sensors.get("accelerometer", _ZERO)
    sigma = _coefficient_sigmas(
        _force_noise_levels(noises, force_kernel, half, step, position), noises, slope, c1, s1, at
    )
    signal_noise = _signal_noise_levels(noises, force_kernel, half, c1, s1)
    slopes = {}
    if airframe.wind_axes:
        slopes = {"CD": {"alpha": coefficients["CL"]}, "CL": {"alpha": -coefficients["CD"]}}
    return Histories(
        name,
        time[at],
        signals,
        samples,
        coefficients,
        {axis: sigma[axis] for axis in coefficients},
        kernel,
        rows,
        bandwidth_of(half, 1.0 / step),
        signal_noise,
        slopes,
    )


def _refuse_incomplete(
    name: str, channels: Mapping[str, np.ndarray], count: int, half: int, bandwidth: float
) -> None:
    """Raise RecordError where a channel is missing, or ``count`` samples are too few."""
    for channel in NEEDED_CHANNELS:
        if channel not in channels:
            raise RecordError(
                f"it has no {channel}, without which there are no coefficients",
                where=name,
                remedy="record it, or map its column with --channels",
            )
    if count < 8 * half + 1:
        raise RecordError(
            f"{count} samples are too few for slopes with a bandwidth of {bandwidth:g} Hz",
            where=name,
            remedy="give a longer record or a larger --bandwidth",
        )


def _on_intervals(
    values: np.ndarray,
    slope_jumps: np.ndarray | float = 0.0,
    *,
    smooth: bool = False,
    held: bool = False,
) -> np.ndarray:
    """Return a channel at the beginning, the middle and the end of each interval, ``(3, N - 1)``.

    Parameters
    ----------
    values : ``(N,)`` of the channel.
    slope_jumps : ``(N,)`` jumps of its slope at the samples, times the step between samples.
    smooth : whether the channel is a cubic through four samples; otherwise it is linear between
        samples.
    held : whether the channel is constant until the next sample.
    """
    first, last = values[:-1], values[:-1] if held else values[1:]
    middle = 0.5 * (first + last)
    if smooth and len(values) > 3:
        second = _second_differences(values, slope_jumps)
        middle[1:-1] -= (second[1:] + second[:-1]) / 16.0
    return np.array([first, middle, last])


def _smooth(channels: Mapping[str, np.ndarray], half: int) -> dict[str, np.ndarray]:
    """Return the channels without noise above the bandwidth, by local polynomials of degree 4."""
    from scipy.signal import savgol_filter

    width = max(2 * half + 1, 7)
    return {**channels, **{k: savgol_filter(channels[k], width, 4) for k in _SMOOTHED_CHANNELS}}


def _acceleration_jumps(
    channels: Mapping[str, np.ndarray],
    smooth: Mapping[str, np.ndarray],
    surfaces: Mapping[str, np.ndarray],
    step: float,
) -> dict[str, np.ndarray]:
    """Return half of the jump of each angular acceleration at each sample, zero where no held
    surface steps.

    At a step, a central difference gives the mean of the accelerations before and after it, but an
    accelerometer reads the later one. The difference of both is found by regression on the steps
    and on the smooth motion.
    """
    moves = [np.diff(row)[:-1] for row in surfaces.values()]
    moves = [row for row in moves if np.any(row)]
    if not moves:
        return {}
    flow = [step * np.gradient(smooth[name], step)[1:-1] for name in (*"pqr", "alpha", "beta")]
    columns = np.array([*moves, *flow]).T
    scale = np.maximum(np.max(np.abs(columns), axis=0), 1e-300)
    jumps = {}
    for rate in ("p", "q", "r"):
        sides = np.diff(channels[rate], 2) / step
        values = np.linalg.lstsq(columns / scale, sides, rcond=1e-10)[0] / scale
        jumps[rate] = np.pad(0.5 * columns[:, : len(moves)] @ values[: len(moves)], 1)
    return jumps


def _at_centre_of_gravity(
    s: dict[str, np.ndarray], airframe: Airframe, step: float, jumps: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Return the channels as sensors at the centre of gravity would read them."""
    s = dict(s)
    p, q, r = s["p"], s["q"], s["r"]
    V = s["airspeed"]
    for name in ("alpha", "beta"):
        x, y, z = airframe.sensors.get(name, _ZERO)
        if (x, y, z) == _ZERO:
            continue
        if name == "alpha":
            s[name] = np.arctan(np.tan(s[name]) - (p * y - q * x) / (V * np.cos(s[name])))
        else:
            s[name] = s[name] - (r * x - p * z) / V
    x, y, z = airframe.sensors.get("accelerometer", _ZERO)
    if (x, y, z) != _ZERO:
        dp, dq, dr = (
            _slope(s[rate], step, 2.0 * step * jumps.get(rate, 0.0)) + jumps.get(rate, 0.0)
            for rate in ("p", "q", "r")
        )
        s["ax"] = s["ax"] + x * (q * q + r * r) - y * (p * q - dr) - z * (p * r + dq)
        s["ay"] = s["ay"] - x * (p * q + dr) + y * (p * p + r * r) - z * (q * r - dp)
        s["az"] = s["az"] - x * (p * r - dq) - y * (q * r + dp) + z * (p * p + q * q)
    return s


def _slope(values: np.ndarray, step: float, slope_jumps: np.ndarray | float = 0.0) -> np.ndarray:
    """Return the time derivative ``(N,)`` of a channel by differences that are exact for
    polynomials of degree 4, except at both ends. ``slope_jumps`` is that of `_on_intervals`.
    """
    slope = np.gradient(values, step)
    second = _second_differences(values, slope_jumps)
    slope[2:-2] -= (second[2:] - second[:-2]) / (12.0 * step)
    return np.asarray(slope)


def _second_differences(values: np.ndarray, slope_jumps: np.ndarray | float) -> np.ndarray:
    """Return the second differences ``(N - 2,)`` of a channel without the jumps of its slope."""
    return np.asarray(np.diff(values, 2) - np.broadcast_to(slope_jumps, values.shape)[1:-1])


def _common_signals(
    s: Mapping[str, np.ndarray], c: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Return the signals of every aircraft: flow angles, Mach number, non-dimensional rates."""
    half = 0.5 / s["airspeed"]
    return {
        "alpha": s["alpha"],
        "beta": s["beta"],
        "mach": s["airspeed"] / c["speed_of_sound"],
        "p": s["p"] * c["span"] * half,
        "q": s["q"] * c["chord"] * half,
        "r": s["r"] * c["span"] * half,
    }


def _forces(
    s: Mapping[str, np.ndarray], c: Mapping[str, np.ndarray], T: np.ndarray, airframe: Airframe
) -> dict[str, np.ndarray]:
    """Return the coefficients of the forces at the samples, in body or wind axes."""
    qS = 0.5 * c["air_density"] * s["airspeed"] ** 2 * c["wing_area"]
    CX = (c["mass"] * s["ax"] - T * np.cos(c["thrust_angle"])) / qS
    CY = c["mass"] * s["ay"] / qS
    CZ = (c["mass"] * s["az"] + T * np.sin(c["thrust_angle"])) / qS
    if not airframe.wind_axes:
        return {"CX": CX, "CY": CY, "CZ": CZ}
    sine, cosine = np.sin(s["alpha"]), np.cos(s["alpha"])
    return {"CD": -CX * cosine - CZ * sine, "CY": CY, "CL": CX * sine - CZ * cosine}


def _moments(
    s: Mapping[str, np.ndarray],
    c: Mapping[str, np.ndarray],
    angular_acceleration: Mapping[str, np.ndarray],
    mean: Any,
    at: np.ndarray,
    T: np.ndarray,
) -> dict[str, np.ndarray]:
    """Return the coefficients of the moments about the reference point, at the windows."""
    p, q, r = s["p"], s["q"], s["r"]
    Ix, Iy, Iz, Ixz = (c[name] for name in _INERTIAS)
    qS = 0.5 * c["air_density"] * s["airspeed"] ** 2 * c["wing_area"]
    X = c["mass"] * s["ax"] - T * np.cos(c["thrust_angle"])
    Y = c["mass"] * s["ay"]
    Z = c["mass"] * s["az"] + T * np.sin(c["thrust_angle"])
    x, y, z = c["cg_x"], c["cg_y"], c["cg_z"]
    other_moments = {
        "Cl": (Iz - Iy) * q * r - Ixz * p * q + (y * Z - z * Y),
        "Cm": (Ix - Iz) * p * r + Ixz * (p * p - r * r) - T * c["thrust_arm"] + (z * X - x * Z),
        "Cn": (Iy - Ix) * p * q + Ixz * q * r + (x * Y - y * X),
    }
    qS_windows, span, chord = qS[1, at], c["span"], c["chord"]
    dp, dq, dr = (angular_acceleration[rate] for rate in "pqr")
    inertial_moments = {
        "Cl": (Ix[1, at] * dp - Ixz[1, at] * dr) / (qS_windows * span[1, at]),
        "Cm": Iy[1, at] * dq / (qS_windows * chord[1, at]),
        "Cn": (Iz[1, at] * dr - Ixz[1, at] * dp) / (qS_windows * span[1, at]),
    }
    return {
        axis: inertial_moments[axis] + mean(row / (qS * (chord if axis == "Cm" else span)))
        for axis, row in other_moments.items()
    }


def filled(values: np.ndarray, valid: np.ndarray, name: str, where: str) -> np.ndarray:
    """Return a channel ``(N,)`` with straight lines over missing samples.

    Raises
    ------
    RecordError : where more than half of the samples are missing.
    """
    if int(np.sum(valid)) * 2 < len(valid):
        raise RecordError(
            f"more than half of {name} is missing", where=where, remedy="give a better record"
        )
    if valid.all():
        return np.asarray(values, dtype=float)
    n = np.arange(len(values))
    return np.interp(n, n[valid], values[valid])
