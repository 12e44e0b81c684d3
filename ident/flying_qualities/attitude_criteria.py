"""Criteria of pitch attitude: bandwidth and phase delay of an estimated response, dropback and step
response of a fitted one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from ident.frequency_response.transfer_function import (
    DELAY,
    FORMS,
    FittedResponse,
    ResponseTarget,
    shared_correlation,
)

NEUTRAL_PHASE = -180.0  # deg, phase of neutral stability
BANDWIDTH_PHASE_MARGIN = 45.0  # deg, phase margin that defines the bandwidth
GAIN_MARGIN = 6.0  # dB, gain margin that defines the bandwidth
PARABOLA_HALF_WIDTH = 0.2  # half width in ln(omega) of the points to which a parabola is fitted
_FEWEST_PARABOLA_POINTS = 5
_PHASE_DELAY_POINTS = 41  # points to which the straight line of the phase delay is fitted
# deg, usual phase of an attitude at low frequency; a response with a phase nearer to the opposite
# of it has its sign reversed
_STARTING_PHASE = -60.0
_BAND_TOLERANCE = 1e-3  # relative excess over the usable band that the phase delay tolerates
_CROSSING_STEPS = 4  # Newton steps to a crossing; the parabola makes them converge fast


@dataclass(frozen=True)
class UncertainValue:
    """A number with its standard deviation."""

    value: float
    std: float


@dataclass(frozen=True)
class Bandwidth:
    """Bandwidth and phase delay of an attitude response. A quantity is None if the usable band does
    not contain it.

    Attributes
    ----------
    neutral : frequency, rad/s, at which the phase is -180 deg.
    phase : phase bandwidth, rad/s, the frequency at which the phase is -135 deg.
    gain : gain bandwidth, rad/s, the frequency at which the gain is 6 dB above that at ``neutral``.
    delay : phase delay, s, by a straight line fitted to the phase from ``neutral`` to twice this
        frequency.
    notes : sentences that say why a quantity is None.
    """

    neutral: UncertainValue | None
    phase: UncertainValue | None
    gain: UncertainValue | None
    delay: UncertainValue | None
    notes: tuple[str, ...] = ()

    @property
    def bandwidth(self) -> UncertainValue | None:
        """Smaller one of phase and gain bandwidth; None if one of them is None. It applies to rate
        response types. To attitude response types, the phase bandwidth applies.
        """
        both = [each for each in (self.phase, self.gain) if each is not None]
        return min(both, key=lambda each: each.value) if len(both) == 2 else None


class FrequencyPoints(Protocol):
    """Points at frequencies ``omega (F,)``, rad/s, whose errors are correlated between neighbours
    according to the effective ``length`` of the windows, s.
    """

    @property
    def omega(self) -> np.ndarray: ...
    @property
    def length(self) -> float | np.ndarray: ...


@dataclass(frozen=True, eq=False)
class AttitudeCurve:
    """Gain, dB, and phase, deg, of an attitude response at F frequencies ``omega``, rad/s, with
    their standard deviations, ``(F,)`` each. ``length`` is the effective length of the windows, s.
    """

    omega: np.ndarray
    gain: np.ndarray
    phase: np.ndarray
    gain_std: np.ndarray
    phase_std: np.ndarray
    length: float | np.ndarray


def attitude_bandwidth(target: ResponseTarget, *, rate: bool) -> Bandwidth:
    """Return bandwidth and phase delay from an estimated response in its usable band.

    Each crossing is found by a parabola fitted to the points about it. Standard deviations account
    for the correlation of neighbouring points. ``rate`` says whether the output is a pitch rate,
    which is then integrated. The sign of a response with negative gain is reversed.
    """
    curve = attitude_curve(target, rate=rate)
    notes: list[str] = []
    band = f"the usable band ends at {curve.omega[-1]:.3g} rad/s"
    neutral = _crossing(curve, curve.phase, curve.phase_std, NEUTRAL_PHASE, 0.0)
    phase = _crossing(
        curve, curve.phase, curve.phase_std, NEUTRAL_PHASE + BANDWIDTH_PHASE_MARGIN, 0.0
    )
    if phase is None:
        notes.append(f"no phase bandwidth: the phase does not fall through -135 deg; {band}")
    gain = delay = None
    if neutral is None:
        notes.append(f"no gain bandwidth and phase delay: no phase of -180 deg; {band}")
        return Bandwidth(neutral, phase, gain, delay, tuple(notes))
    gain_at_neutral = parabola_at(curve, curve.gain, curve.gain_std, neutral.value)
    neutral_gain, neutral_gain_std = (
        gain_at_neutral.value,
        math.hypot(gain_at_neutral.std, gain_at_neutral.slope * neutral.std / neutral.value),
    )
    gain = _crossing(
        curve,
        curve.gain,
        curve.gain_std,
        neutral_gain + GAIN_MARGIN,
        neutral_gain_std,
        before=neutral.value,
    )
    if gain is None:
        notes.append(f"no gain bandwidth: the gain is nowhere 6 dB above that at -180 deg; {band}")
    if 2.0 * neutral.value > curve.omega[-1] * (1.0 + _BAND_TOLERANCE):
        notes.append(f"no phase delay: it needs {2.0 * neutral.value:.3g} rad/s, and {band}")
    else:
        delay = _phase_delay(curve, neutral.value)
    return Bandwidth(neutral, phase, gain, delay, tuple(notes))


PITCH_SOURCE = "MIL-STD-1797A, 4.2.1.2, category A; points of its figure not verified"
# Boundaries of levels 1 and 2 as points (bandwidth, rad/s; phase delay, s), read from the figure of
# the standard by MATLAB routines of C. Regan, 2006, after P. Stoliker. Those routines mark them as
# unverified. Their point of level 1 at 11.2 rad/s and no delay lies off the boundary: left out.
PITCH_LEVELS: tuple[tuple[tuple[float, float], ...], ...] = (
    (
        (6.5, 0.0),
        (6.5, 0.02),
        (6.54, 0.03),
        (6.6, 0.035),
        (6.8, 0.04),
        (7.08, 0.045),
        (7.6, 0.05),
        (8.16, 0.055),
        (8.8, 0.06),
    ),
    (
        (1.0, 0.0),
        (1.0, 0.085),
        (1.16, 0.1),
        (1.4, 0.11),
        (1.76, 0.12),
        (2.08, 0.13),
        (2.6, 0.14),
        (3.4, 0.15),
    ),
)


def pitch_bandwidth_level(bandwidth: float, delay: float) -> int:
    """Return the level, 1 to 3, for a bandwidth, rad/s, and a phase delay, s, of pitch in flight
    phases of category A.

    A boundary is not extrapolated: a delay beyond its last point does not meet its level.
    """
    for level, points in enumerate(PITCH_LEVELS, start=1):
        bandwidths, delays = (np.array(each) for each in zip(*points, strict=True))
        if delay <= delays[-1] and bandwidth >= float(np.interp(delay, delays, bandwidths)):
            return level
    return 3


def dropback(function: FittedResponse) -> UncertainValue | None:
    """Return the ratio, s, of dropback to steady pitch rate for a fitted response of pitch rate;
    None for a form other than ``pitch``.

    The ratio is T_theta2 - 2 damping/frequency - delay. When the stick returns after a step, the
    attitude falls back by this ratio multiplied by the steady rate. A negative value is an
    overshoot.
    """
    if function.form is not FORMS["pitch"]:
        return None

    def value(p: Mapping[str, float]) -> float:
        return 1.0 / p["inv_T_theta2"] - 2.0 * p["damping"] / p["frequency"] - p[DELAY]

    if not all(abs(function.values[name]) > 1e-9 for name in ("inv_T_theta2", "frequency")):
        return None
    result = propagated(function, value)
    return None if result is None else UncertainValue(*result)


def propagated(
    function: FittedResponse, value: Callable[[Mapping[str, float]], float]
) -> tuple[float, float] | None:
    """Return value and standard deviation, by linearisation, of the quantity that ``value``
    computes from the parameters of a fit; None if they are not finite.
    """
    p = dict(function.values)
    slopes = []
    try:
        centre = value(p)
        for name in function.std:
            step = 1e-6 * max(abs(p[name]), 1e-3)
            ends = [value({**p, name: p[name] + sign * step}) for sign in (1.0, -1.0)]
            slopes.append((ends[0] - ends[1]) / (2.0 * step))
    except ZeroDivisionError:
        return None
    row = np.array(slopes)
    std = math.sqrt(max(float(row @ function.covariance @ row), 0.0))
    return (centre, std) if math.isfinite(centre) and math.isfinite(std) else None


def attitude_curve(target: ResponseTarget, *, rate: bool) -> AttitudeCurve:
    """Return the attitude response of a target. ``rate`` says whether the target is the response of
    a rate, which is then integrated. A multiple of 180 deg is added to the phase so that it begins
    near ``_STARTING_PHASE``.
    """
    omega = target.omega
    response = target.response / (1j * omega) if rate else target.response
    phase = np.degrees(np.unwrap(np.angle(response)))
    phase -= 180.0 * np.round((phase[0] - _STARTING_PHASE) / 180.0)
    relative_std = target.std / np.abs(target.response)
    gain = 20.0 * np.log10(np.abs(response))
    return AttitudeCurve(
        omega,
        gain,
        phase,
        20.0 / math.log(10.0) * relative_std,
        np.degrees(relative_std),
        target.length,
    )


def _crossing(
    curve: AttitudeCurve,
    values: np.ndarray,
    std: np.ndarray,
    level: float,
    level_std: float,
    before: float | None = None,
) -> UncertainValue | None:
    """Return the first frequency, rad/s, at which a curve falls through a level, or with ``before``
    the last one below this frequency; None if there is none.

    ``level_std`` is the standard deviation of the level itself.
    """
    below = np.flatnonzero((values[:-1] > level) & (values[1:] <= level))
    if before is not None:
        below = below[curve.omega[below] < before][::-1]
    if not below.size:
        return None
    omega = float(curve.omega[below[0]])
    for _ in range(_CROSSING_STEPS):
        parabola = parabola_at(curve, values, std, omega)
        if not parabola.slope < 0.0:
            break
        ratio = math.exp((level - parabola.value) / parabola.slope)
        omega = float(np.clip(omega * ratio, curve.omega[0], curve.omega[-1]))
    parabola = parabola_at(curve, values, std, omega)
    if not parabola.slope < 0.0:
        return None
    return UncertainValue(omega, omega * math.hypot(parabola.std, level_std) / abs(parabola.slope))


@dataclass(frozen=True)
class Parabola:
    """Local parabola of a curve in ln(omega).

    Attributes
    ----------
    value, slope, curvature : value, first and second derivative with respect to ln(omega).
    std : standard deviation of the value.
    weights : ``(F,)`` weights of the points of the curve in the value.
    """

    value: float
    slope: float
    curvature: float
    std: float
    weights: np.ndarray


def parabola_at(curve: FrequencyPoints, values: np.ndarray, std: np.ndarray, at: float) -> Parabola:
    """Return the parabola in ln(omega) fitted to the points of a curve about the frequency ``at``,
    rad/s.

    ``values (F,)`` are those of the curve, and ``std (F,)`` their standard deviations. Errors of
    neighbouring points are correlated.
    """
    point_weights, covariance, near = parabola_weights(curve, std, at)
    coefficients = point_weights @ values[near]
    value_std = math.sqrt(max(float(covariance[0, 0]), 0.0))
    weights = np.zeros(curve.omega.size)
    weights[near] = point_weights[0]
    return Parabola(
        float(coefficients[0]),
        float(coefficients[1]),
        2.0 * float(coefficients[2]),
        value_std,
        weights,
    )


def parabola_weights(
    curve: FrequencyPoints, std: np.ndarray, at: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the weights ``(3, N)`` of the N points about the frequency ``at``, rad/s, in the
    coefficients of a parabola in ln(omega), the covariance ``(3, 3)`` of the coefficients, and the
    positions ``(N,)`` of these points.
    """
    x = np.log(curve.omega / at)
    near = np.argsort(np.abs(x))[
        : max(_FEWEST_PARABOLA_POINTS, int(np.count_nonzero(np.abs(x) <= PARABOLA_HALF_WIDTH)))
    ]
    near.sort()
    powers = np.column_stack([np.ones(near.size), x[near], x[near] ** 2])
    weights = np.asarray(np.linalg.pinv(powers / std[near, None]) / std[near])
    return (
        weights,
        np.asarray(weights @ shared_covariance(curve, std[near], near) @ weights.T),
        near,
    )


def _phase_delay(curve: AttitudeCurve, neutral: float) -> UncertainValue:
    """Return the phase delay, s: minus half of the slope of the phase, rad over rad/s.

    The slope is that of the regression line from the frequency ``neutral`` of -180 deg to twice
    this frequency, through phases interpolated linearly at equidistant frequencies.
    """
    first = max(int(np.searchsorted(curve.omega, neutral)) - 1, 0)
    last = min(int(np.searchsorted(curve.omega, 2.0 * neutral)) + 1, curve.omega.size)
    positions = np.arange(first, last)
    frequencies = np.linspace(neutral, 2.0 * neutral, _PHASE_DELAY_POINTS)
    interpolation = np.array(
        [np.interp(frequencies, curve.omega[positions], row) for row in np.eye(positions.size)]
    ).T
    line_weights = (
        np.linalg.pinv(np.column_stack([np.ones(frequencies.size), frequencies - neutral]))
        @ interpolation
    )
    covariance = (
        line_weights
        @ shared_covariance(curve, curve.phase_std[positions], positions)
        @ line_weights.T
    )
    half = 0.5 * math.pi / 180.0
    slope = float(line_weights[1] @ curve.phase[positions])
    return UncertainValue(-half * slope, half * math.sqrt(max(float(covariance[1, 1]), 0.0)))


def shared_covariance(curve: FrequencyPoints, std: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Return the covariance ``(N, N)`` of the errors of the points at the positions ``places
    (N,)``, from their standard deviations ``std (N,)`` and the correlation of neighbours.
    """
    length = np.broadcast_to(curve.length, curve.omega.shape)
    correlation = _correlation(curve.omega.tobytes(), np.asarray(length, dtype=float).tobytes())
    return correlation[np.ix_(positions, positions)] * np.outer(std, std)


@lru_cache(maxsize=8)
def _correlation(omega: bytes, length: bytes) -> np.ndarray:
    """Return the correlation ``(F, F)`` of the errors of a curve, from its frequencies and window
    lengths as bytes. It is cached, since all parabolas of a curve use it.
    """
    return shared_correlation(np.frombuffer(omega), np.frombuffer(length))


# ---- Steps of a fitted response


@dataclass(frozen=True, eq=False)
class StepResponse:
    """Response to a step of the stick, relative to its steady value: ``time``, s, ``value`` and
    its standard deviation ``std``, ``(N,)`` each.
    """

    time: np.ndarray
    value: np.ndarray
    std: np.ndarray


def step_response(function: FittedResponse, duration: float | None = None) -> StepResponse | None:
    """Return the step response of a fitted transfer function, relative to its steady value, with
    standard deviations by linearisation; None if it has no steady value.

    ``duration`` is in s; for None it is eight time constants of the slowest mode, but at most 10 s.
    """
    from scipy import signal

    roots = np.roots(function.denominator)
    if not roots.size or np.max(roots.real) >= 0.0 or abs(function.numerator[-1]) < 1e-12:
        return None
    length = duration or min(8.0 / float(np.min(-roots.real)), 10.0)
    time = np.linspace(0.0, length, 301)

    def value(p: Mapping[str, float]) -> np.ndarray:
        numerator, denominator = function.form.polynomials(p)
        _, response = signal.step((numerator, denominator), T=np.linspace(0.0, length, 301))
        delayed = np.interp(time - p["delay"], time, response, left=0.0)
        return np.asarray(delayed * denominator[-1] / numerator[-1])

    return StepResponse(time, value(function.values), _standard_deviations(function, value))


def pitch_overshoot(function: FittedResponse) -> UncertainValue | None:
    """Return the ratio of the largest to the steady pitch rate after a step; None for a form other
    than ``pitch``, or without a steady value.
    """
    if function.form is not FORMS["pitch"]:
        return None
    step = step_response(function)
    if step is None:
        return None
    peak = int(np.argmax(step.value))
    return UncertainValue(float(step.value[peak]), float(step.std[peak]))


def _standard_deviations(
    function: FittedResponse, value: Callable[[Mapping[str, float]], np.ndarray]
) -> np.ndarray:
    """Return the standard deviations ``(N,)``, by linearisation, of the quantities that ``value``
    computes from the parameters of a fitted function.
    """
    p, slopes = dict(function.values), []
    for name in function.std:
        step = 1e-5 * max(abs(p[name]), 1e-3)
        ends = [value({**p, name: p[name] + sign * step}) for sign in (1.0, -1.0)]
        slopes.append((ends[0] - ends[1]) / (2.0 * step))
    matrix = np.array(slopes)
    return np.asarray(
        np.sqrt(np.maximum(np.einsum("kn,kl,ln->n", matrix, function.covariance, matrix), 0.0))
    )
