"""Criteria of pitch attitude: bandwidth and phase delay of an estimated response, dropback and step
response of a fitted one, and the pilot-in-the-loop criterion of Neal and Smith.
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
PARABOLA_HALF_WIDTH = 0.2  # half width in ln(omega) of the parabola about a crossing
_FEWEST_PARABOLA_POINTS = 5
_PHASE_DELAY_POINTS = 41  # points of the straight line of the phase delay
_STARTING_PHASE = -60.0  # deg, usual phase of an attitude at low frequency; determines its sign


@dataclass(frozen=True)
class BandwidthQuantity:
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
    delay : phase delay, s, by a straight line through the phase from ``neutral`` to twice that.
    notes : sentences that say why a quantity is None.
    """

    neutral: BandwidthQuantity | None
    phase: BandwidthQuantity | None
    gain: BandwidthQuantity | None
    delay: BandwidthQuantity | None
    notes: tuple[str, ...] = ()

    @property
    def bandwidth(self) -> BandwidthQuantity | None:
        """Smaller one of phase and gain bandwidth, which applies to rate response types; None if
        one of them is None. For attitude response types, the phase bandwidth applies.
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

    Each crossing is found by a parabola through the points about it. Errors of neighbouring points
    are correlated. ``rate`` says whether the output is a pitch rate, which is then integrated. The
    sign of a response with negative gain is reversed.
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
    there = parabola_at(curve, curve.gain, curve.gain_std, neutral.value)
    level, level_std = there.value, math.hypot(there.std, there.slope * neutral.std / neutral.value)
    gain = _crossing(
        curve, curve.gain, curve.gain_std, level + GAIN_MARGIN, level_std, before=neutral.value
    )
    if gain is None:
        notes.append(f"no gain bandwidth: the gain is nowhere 6 dB above that at -180 deg; {band}")
    if 2.0 * neutral.value > curve.omega[-1] * 1.001:
        notes.append(f"no phase delay: it needs {2.0 * neutral.value:.3g} rad/s, and {band}")
    else:
        delay = _phase_delay(curve, neutral.value)
    return Bandwidth(neutral, phase, gain, delay, tuple(notes))


PITCH_SOURCE = "MIL-STD-1797A, 4.2.1.2, category A; points of its figure not verified"
# rad/s and s. The standard prints a figure. Its points are those of MATLAB routines by C. Regan,
# 2006, after P. Stoliker, where they are marked as to be checked; the first of level 1 there, 11.2
# rad/s at no delay, lies on no boundary and is left out. Beyond the last point nothing is known:
# both limits go on level here, and are drawn broken.
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
    """
    for level, points in enumerate(PITCH_LEVELS, start=1):
        least, delays = (np.array(each) for each in zip(*points, strict=True))
        if delay <= delays[-1] and bandwidth >= float(np.interp(delay, delays, least)):
            return level
    return 3


def dropback(function: FittedResponse) -> BandwidthQuantity | None:
    """Return the dropback over the steady pitch rate, s, of a fitted response of pitch rate; None
    for a form other than ``pitch``.

    It is T_theta2 - 2 damping/frequency - delay. When the stick returns after a step, the attitude
    falls back by this time multiplied by the steady rate. A negative value is an overshoot.
    """
    if function.form is not FORMS["pitch"]:
        return None

    def value(p: Mapping[str, float]) -> float:
        return 1.0 / p["inv_T_theta2"] - 2.0 * p["damping"] / p["frequency"] - p[DELAY]

    if not all(abs(function.values[name]) > 1e-9 for name in ("inv_T_theta2", "frequency")):
        return None
    result = propagated(function, value)
    return None if result is None else BandwidthQuantity(*result)


def propagated(
    function: FittedResponse, value: Callable[[Mapping[str, float]], float]
) -> tuple[float, float] | None:
    """Return a quantity of the parameters of a fit with its standard deviation by linearisation;
    None if not finite.
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
    a rate, which is then integrated. Multiples of 180 deg are added so that the phase begins near
    ``_STARTING_PHASE``.
    """
    omega = target.omega
    response = target.response / (1j * omega) if rate else target.response
    phase = np.degrees(np.unwrap(np.angle(response)))
    phase -= 180.0 * np.round((phase[0] - _STARTING_PHASE) / 180.0)
    share = target.std / np.abs(target.response)
    gain = 20.0 * np.log10(np.abs(response))
    return AttitudeCurve(
        omega, gain, phase, 20.0 / math.log(10.0) * share, np.degrees(share), target.length
    )


def _crossing(
    curve: AttitudeCurve,
    values: np.ndarray,
    std: np.ndarray,
    level: float,
    level_std: float,
    before: float | None = None,
) -> BandwidthQuantity | None:
    """Return the first frequency at which a curve falls through a level, or the last one below the
    frequency ``before``; None if there is none.

    ``level_std`` is the standard deviation of the level itself.
    """
    below = np.flatnonzero((values[:-1] > level) & (values[1:] <= level))
    if before is not None:
        below = below[curve.omega[below] < before][::-1]
    if not below.size:
        return None
    at = float(curve.omega[below[0]])
    for _ in range(4):
        near = parabola_at(curve, values, std, at)
        if not near.slope < 0.0:
            break
        step = math.exp((level - near.value) / near.slope)
        at = float(np.clip(at * step, curve.omega[0], curve.omega[-1]))
    near = parabola_at(curve, values, std, at)
    if not near.slope < 0.0:
        return None
    return BandwidthQuantity(at, at * math.hypot(near.std, level_std) / abs(near.slope))


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
    """Return the parabola in ln(omega) through the points of a curve about the frequency ``at``,
    rad/s.

    ``values (F,)`` are those of the curve, and ``std (F,)`` their standard deviations. Errors of
    neighbouring points are correlated.
    """
    gain, covariance, near = parabola_weights(curve, std, at)
    result = gain @ values[near]
    spread = math.sqrt(max(float(covariance[0, 0]), 0.0))
    weights = np.zeros(curve.omega.size)
    weights[near] = gain[0]
    return Parabola(float(result[0]), float(result[1]), 2.0 * float(result[2]), spread, weights)


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
    gain = np.asarray(np.linalg.pinv(powers / std[near, None]) / std[near])
    return gain, np.asarray(gain @ shared_covariance(curve, std[near], near) @ gain.T), near


def _phase_delay(curve: AttitudeCurve, neutral: float) -> BandwidthQuantity:
    """Return the phase delay, s: minus half of the slope of the phase, rad over rad/s.

    The slope is that of the regression line from the frequency ``neutral`` of -180 deg to twice
    this frequency. The phase is interpolated linearly at even distances.
    """
    first = max(int(np.searchsorted(curve.omega, neutral)) - 1, 0)
    last = min(int(np.searchsorted(curve.omega, 2.0 * neutral)) + 1, curve.omega.size)
    places = np.arange(first, last)
    at = np.linspace(neutral, 2.0 * neutral, _PHASE_DELAY_POINTS)
    joined = np.array([np.interp(at, curve.omega[places], row) for row in np.eye(places.size)]).T
    gain = np.linalg.pinv(np.column_stack([np.ones(at.size), at - neutral])) @ joined
    covariance = gain @ shared_covariance(curve, curve.phase_std[places], places) @ gain.T
    half = 0.5 * math.pi / 180.0
    slope = float(gain[1] @ curve.phase[places])
    return BandwidthQuantity(-half * slope, half * math.sqrt(max(float(covariance[1, 1]), 0.0)))


def shared_covariance(curve: FrequencyPoints, std: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the covariance ``(N, N)`` of the errors of the points at the positions ``places
    (N,)``, from their standard deviations ``std (N,)`` and the correlation of neighbours.
    """
    length = np.broadcast_to(curve.length, curve.omega.shape)
    correlation = _correlation(curve.omega.tobytes(), np.asarray(length, dtype=float).tobytes())
    return correlation[np.ix_(places, places)] * np.outer(std, std)


@lru_cache(maxsize=8)
def _correlation(omega: bytes, length: bytes) -> np.ndarray:
    """Return the correlation ``(F, F)`` of the errors of a curve, from its frequencies and window
    lengths as bytes. It is cached, since all parabolas of a curve use it.
    """
    return shared_correlation(np.frombuffer(omega), np.frombuffer(length))


LARGEST_DROOP = -3.0  # dB, smallest gain of the closed loop below the bandwidth
LEVELS = (3.0, 9.0)  # dB, largest resonance of levels 1 and 2
PILOT_DELAY = 0.25  # s, delay of the pilot
RESPONSE_DRAWS = 100  # samples of the response for standard deviations
SCAN_POINTS = 60  # frequencies of a scan
SEED = 20  # seed of the random numbers
_LARGEST_COMPENSATION = 85.0  # deg of lead or lag
_COMPENSATION_POINTS = 69  # compensations that are tried


@dataclass(frozen=True)
class PilotDemand:
    """Task of the pilot: the required closed-loop ``bandwidth``, rad/s, and the ``delay`` of the
    pilot, s.
    """

    bandwidth: float
    delay: float = PILOT_DELAY


@dataclass(frozen=True)
class NealSmith:
    """Result of the Neal-Smith criterion.

    Attributes
    ----------
    demand : the task.
    resonance : peak of the closed loop, dB.
    compensation : phase of the pilot's lead (positive) or lag at the bandwidth, deg, without the
        delay.
    level : level 1, 2 or 3 by the resonance.
    best, worst : best and worst level within two standard deviations.
    droop : smallest gain of the closed loop below the bandwidth, dB.
    correlation : correlation of the errors of resonance and compensation.
    notes : sentences on limits of the result.
    """

    demand: PilotDemand
    resonance: BandwidthQuantity
    compensation: BandwidthQuantity
    level: int
    best: int
    worst: int
    droop: float
    correlation: float = 0.0
    notes: tuple[str, ...] = ()


def resonance_level(resonance: float) -> int:
    """Return the level, 1 to 3, of a resonance, dB, by MIL-STD-1797A."""
    return 1 + int(resonance > LEVELS[0]) + int(resonance > LEVELS[1])


def neal_smith(curve: AttitudeCurve, demand: PilotDemand) -> NealSmith | str:
    """Return the Neal-Smith criterion for an attitude response in its usable band, or a sentence
    that says why it cannot be applied.

    The response is smoothed by parabolas about each frequency. Standard deviations follow from
    ``RESPONSE_DRAWS`` random samples of its correlated errors: the pilot is adjusted to each.
    """
    low, high = float(curve.omega[0]), float(curve.omega[-1])
    if not low * 2.0 <= demand.bandwidth <= high / 1.2:
        return (
            f"no Neal-Smith pilot: a bandwidth of {demand.bandwidth:.3g} rad/s needs a usable band "
            f"from half of it to 1.2 times it, and it is {low:.3g} to {high:.3g} rad/s"
        )
    omega = np.unique(np.append(np.geomspace(low, high, SCAN_POINTS), demand.bandwidth))
    centre, draws = _smoothed(curve, omega)
    result = _adjusted_pilots(omega, centre[None], demand)
    if result is None:
        return "no Neal-Smith pilot: no lead or lag gives the bandwidth"
    resonance, compensation, droop = (float(each[0]) for each in result)
    sampled = _adjusted_pilots(omega, draws, demand)
    assert sampled is not None
    stds = [float(np.std(each)) for each in sampled[:2]]
    correlation = np.corrcoef(sampled[0], sampled[1])[0, 1] if min(stds) > 0.0 else 0.0
    levels = [resonance_level(resonance + sign * 2.0 * stds[0]) for sign in (-1.0, 1.0)]
    notes = []
    if droop < LARGEST_DROOP - 0.05:
        notes.append(f"the closed loop droops by {-droop:.2g} dB, more than the 3 dB allowed")
    closed = _closed_loop_gain(omega, centre[None], demand, np.array([compensation]))
    if int(np.argmax(closed[0])) == omega.size - 1:
        notes.append("the resonance lies at the end of the usable band and may be larger")
    return NealSmith(
        demand,
        BandwidthQuantity(resonance, stds[0]),
        BandwidthQuantity(compensation, stds[1]),
        resonance_level(resonance),
        levels[0],
        levels[1],
        droop,
        float(correlation),
        tuple(notes),
    )


def _smoothed(curve: AttitudeCurve, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the complex attitude response at ``omega (F,)``, smoothed by parabolas, and D random
    samples of it ``(D, F)``.
    """
    rng = np.random.default_rng(SEED)
    places = np.arange(curve.omega.size)
    rows = []
    for values, std in ((curve.gain, curve.gain_std), (curve.phase, curve.phase_std)):
        covariance = shared_covariance(curve, std, places)
        # The approximate correlations may form an indefinite matrix: negative eigenvalues are set
        # to zero before the root is taken.
        sizes, turned = np.linalg.eigh(covariance)
        root = (turned * np.sqrt(np.maximum(sizes, 0.0))) @ turned.T
        noisy = values + (root @ rng.standard_normal((values.size, RESPONSE_DRAWS))).T
        zero = np.zeros_like(std)
        matrix = np.array([parabola_at(curve, zero, std, at).weights for at in omega])
        rows.append((matrix @ values, noisy @ matrix.T))
    gain, phase = rows
    return _complex_response(gain[0], phase[0]), _complex_response(gain[1], phase[1])


def _complex_response(gain: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """Return complex responses from gains, dB, and phases, deg."""
    return np.asarray(10.0 ** (gain / 20.0) * np.exp(1j * np.radians(phase)))


def _closed_loop_gain(
    omega: np.ndarray, attitude: np.ndarray, demand: PilotDemand, compensation: np.ndarray
) -> np.ndarray:
    """Return the gain ``(D, F)`` of the closed loop, dB, for the pilot's ``compensation (D,)``, deg
    at the bandwidth. The gain of the pilot is such that the closed loop has a phase of -90 deg at
    the bandwidth; the result is NaN if no gain has this effect.
    """
    at = int(np.searchsorted(omega, demand.bandwidth))
    turn = np.tan(np.radians(np.abs(compensation)))[:, None] * omega / demand.bandwidth
    pilot = np.where(compensation[:, None] >= 0.0, 1.0 + 1j * turn, 1.0 / (1.0 + 1j * turn))
    loop = attitude * pilot * np.exp(-1j * omega * demand.delay)
    # T = L/(1 + L) is on the negative imaginary axis where |L| = -cos(angle of L).
    angle = np.angle(loop[:, at])
    size = np.where((np.cos(angle) < 0.0) & (np.sin(angle) < 0.0), -np.cos(angle), np.nan)
    loop = loop * (size / np.abs(loop[:, at]))[:, None]
    with np.errstate(invalid="ignore"):
        return np.asarray(20.0 * np.log10(np.abs(loop) / np.abs(1.0 + loop)))


def _adjusted_pilots(
    omega: np.ndarray, attitude: np.ndarray, demand: PilotDemand
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return resonance, compensation and droop, ``(D,)``, of pilots adjusted to D responses."""
    below = omega <= demand.bandwidth * (1.0 + 1e-9)
    tried = np.linspace(-_LARGEST_COMPENSATION, _LARGEST_COMPENSATION, _COMPENSATION_POINTS)
    # The droop of every compensation on a grid.
    droops = []
    for each in tried:
        closed = _closed_loop_gain(omega, attitude, demand, np.full(len(attitude), each))
        droops.append(np.min(closed[:, below], axis=1))
    table = np.array(droops)  # (C, D)
    if np.all(np.isnan(table[:, 0])):
        return None
    out = np.array([_largest_allowed_lead(tried, column) for column in table.T])
    closed = _closed_loop_gain(omega, attitude, demand, out)
    return np.max(closed, axis=1), out, np.min(closed[:, below], axis=1)


def _largest_allowed_lead(tried: np.ndarray, droop: np.ndarray) -> float:
    """Return the largest lead, deg, for which the droop is at most 3 dB, interpolated between the
    compensations ``tried (C,)``; or the compensation with the least droop if none is allowed.

    More lead makes the closed loop droop, and less makes it resonate. ``droop (C,)`` is in dB.
    """
    finite_rows = np.flatnonzero(np.isfinite(droop))
    allowed = finite_rows[droop[finite_rows] >= LARGEST_DROOP]
    if not finite_rows.size:
        return math.nan
    if not allowed.size:
        return float(tried[finite_rows[np.argmax(droop[finite_rows])]])
    best = int(allowed[-1])
    if best + 1 >= tried.size or not np.isfinite(droop[best + 1]):
        return float(tried[best])
    share = (LARGEST_DROOP - droop[best]) / (droop[best + 1] - droop[best])
    return float(tried[best] + share * (tried[best + 1] - tried[best]))


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

    ``duration`` is in s; None takes eight time constants of the slowest mode, at most 10 s.
    """
    from scipy import signal

    roots = np.roots(function.denominator)
    if not roots.size or np.max(roots.real) >= 0.0 or abs(function.numerator[-1]) < 1e-12:
        return None
    length = duration or min(8.0 / float(np.min(-roots.real)), 10.0)
    time = np.linspace(0.0, length, 301)

    def value(p: Mapping[str, float]) -> np.ndarray:
        top, bottom = function.form.polynomials(p)
        _, out = signal.step((top, bottom), T=np.linspace(0.0, length, 301))
        delayed = np.interp(time - p["delay"], time, out, left=0.0)
        return np.asarray(delayed * bottom[-1] / top[-1])

    return StepResponse(time, value(function.values), _standard_deviations(function, value))


def pitch_overshoot(function: FittedResponse) -> BandwidthQuantity | None:
    """Return the largest pitch rate over the steady one after a step; None for a form other than
    ``pitch``, or without a steady value.
    """
    if function.form is not FORMS["pitch"]:
        return None
    step = step_response(function)
    if step is None:
        return None
    peak = int(np.argmax(step.value))
    return BandwidthQuantity(float(step.value[peak]), float(step.std[peak]))


def _standard_deviations(
    function: FittedResponse, value: Callable[[Mapping[str, float]], np.ndarray]
) -> np.ndarray:
    """Return the standard deviations ``(N,)`` of the quantities ``value`` of a fitted function."""
    p, slopes = dict(function.values), []
    for name in function.std:
        step = 1e-5 * max(abs(p[name]), 1e-3)
        ends = [value({**p, name: p[name] + sign * step}) for sign in (1.0, -1.0)]
        slopes.append((ends[0] - ends[1]) / (2.0 * step))
    matrix = np.array(slopes)
    return np.asarray(
        np.sqrt(np.maximum(np.einsum("kn,kl,ln->n", matrix, function.covariance, matrix), 0.0))
    )
