"""Stability margins of an estimated broken-loop response, with the errors of the response.

Broken-loop responses from flight: Tischler and Remple, "Aircraft and Rotorcraft System
Identification", 2nd edition, AIAA 2012; Bosworth and West, "Real-Time Open-Loop Frequency Response
Analysis of Flight Test Data", AIAA 86-9738, 1986, as flown on the X-29A (Clarke, Burken, Bosworth
and Bauer, "X-29 Flight Control System: Lessons Learned", NASA TM-4598, 1994). Required margins:
MIL-F-9490D, "Flight Control Systems - Design, Installation and Test of Piloted Aircraft", 1975,
table III, and SAE AS94900.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.flying_qualities.attitude_criteria import (
    PARABOLA_HALF_WIDTH,
    UncertainValue,
    parabola_at,
    parabola_weights,
)
from ident.frequency_response.transfer_function import ResponseTarget

REQUIRED_GAIN = 6.0  # dB, below the first structural mode
REQUIRED_PHASE = 45.0  # deg, below the first structural mode
CONFIDENCE = 0.95  # probability of an interval
NORMAL_HALF_WIDTH = 1.959964  # half width of this interval of a normal distribution, in sigmas
_NEWTON_STEPS = 6  # steps of Newton's method towards a crossing
_LARGEST_SCAN_STEP = 0.02  # largest step of the scan for an interval, in ln(omega)
_SCAN_STEP_SHARE = 0.2  # step of this scan, over the standard deviation of the crossing
_DECIBELS_PER_NEPER = 20.0 / math.log(10.0)


@dataclass(frozen=True)
class Margin:
    """A margin at one crossing.

    Attributes
    ----------
    kind : ``"gain"`` in dB, ``"phase"`` in deg, ``"delay"`` in s, or ``"distance"`` from -1,
        without unit.
    size : the margin and its standard deviation. A gain margin is the change of the loop gain that
        makes the loop unstable: positive for an increase, negative for a decrease.
    frequency : frequency of the crossing, rad/s.
    low, high : ends of the 95 % interval.
    open : whether the interval reaches an end of the usable band, so that it may be wider.
    """

    kind: str
    size: UncertainValue
    frequency: UncertainValue
    low: float
    high: float
    open: bool = False


@dataclass(frozen=True)
class StabilityMargins:
    """Margins of a loop that is stable when closed; -1 is the critical point.

    Attributes
    ----------
    gains : gain margins at all crossings of a phase of -180 deg, or -180 deg plus whole turns.
    phases : phase margins at all crossings of a gain of one.
    delay : smallest delay margin of the gain crossings; None without one.
    distance : smallest distance of the response from -1, the inverse of the peak of the
        sensitivity; None if it is at an end of the usable band.
    notes : sentences that say why a margin is not known.
    """

    gains: tuple[Margin, ...]
    phases: tuple[Margin, ...]
    delay: Margin | None
    distance: Margin | None
    notes: tuple[str, ...] = ()

    @property
    def gain_increase(self) -> Margin | None:
        """Smallest increase of the gain that makes the loop unstable."""
        increases = [each for each in self.gains if each.size.value > 0.0]
        return min(increases, key=_absolute_size, default=None)

    @property
    def gain_decrease(self) -> Margin | None:
        """Smallest decrease of the gain that makes the loop unstable; its size is negative."""
        decreases = [each for each in self.gains if each.size.value <= 0.0]
        return min(decreases, key=_absolute_size, default=None)

    @property
    def phase(self) -> Margin | None:
        """Phase margin with the smallest absolute value."""
        return min(self.phases, key=_absolute_size, default=None)

    @property
    def named(self) -> dict[str, Margin]:
        """Name -> margin, for the known ones of ``"gain_increase"``, ``"gain_decrease"``,
        ``"phase_margin"``, ``"delay_margin"`` and ``"distance"``.
        """
        every = {
            "gain_increase": self.gain_increase,
            "gain_decrease": self.gain_decrease,
            "phase_margin": self.phase,
            "delay_margin": self.delay,
            "distance": self.distance,
        }
        return {name: each for name, each in every.items() if each is not None}


def _absolute_size(margin: Margin) -> float:
    """Return the absolute value of a margin."""
    return abs(margin.size.value)


@dataclass(frozen=True, eq=False)
class LoopCurve:
    """A broken-loop response at F frequencies.

    Attributes
    ----------
    omega : ``(F,)`` frequencies, rad/s.
    gain : ``(F,)`` dB.
    phase : ``(F,)`` deg, relative to -180 deg, so that it is zero on the negative real axis.
    distance : ``(F,)`` distance from -1, dB.
    gain_std, phase_std, distance_std : ``(F,)`` their standard deviations.
    length : effective length of the windows, s, one or ``(F,)``.
    """

    omega: np.ndarray
    gain: np.ndarray
    phase: np.ndarray
    distance: np.ndarray
    gain_std: np.ndarray
    phase_std: np.ndarray
    distance_std: np.ndarray
    length: float | np.ndarray


def loop_curve(target: ResponseTarget) -> LoopCurve:
    """Return the curve of a broken-loop response L. The closed loop has the characteristic equation
    1 + L = 0.
    """
    share = target.std / np.abs(target.response)
    away = np.abs(1.0 + target.response)
    return LoopCurve(
        target.omega,
        20.0 * np.log10(np.abs(target.response)),
        np.degrees(np.unwrap(np.angle(-target.response))),
        20.0 * np.log10(away),
        _DECIBELS_PER_NEPER * share,
        np.degrees(share),
        _DECIBELS_PER_NEPER * target.std / away,
        target.length,
    )


def stability_margins(target: ResponseTarget) -> StabilityMargins:
    """Return the margins of a broken-loop response in its usable band.

    About a crossing, gain and phase are approximated by parabolas in ln(omega). The errors of gain
    and phase are independent, since the error region in the complex plane is a circle. Errors of
    neighbouring points are correlated according to the windows.

    Parameters
    ----------
    target : response L from the signal that enters the loop to the signal that it returns, for
        negative feedback, so that the closed loop has the characteristic equation 1 + L = 0. For
        positive feedback, see `turned`.
    """
    curve = loop_curve(target)
    whole_turns = 360.0 * np.arange(
        math.ceil(curve.phase.min() / 360.0), math.floor(curve.phase.max() / 360.0) + 1
    )
    every = [_crossings(curve, curve.phase - level, curve.phase_std) for level in whole_turns]
    phase_crossings, undetermined_phases = _determined(
        [each for crossings in every for each in crossings]
    )
    gains = [_margin_at_crossing(curve, "gain", *each) for each in phase_crossings]
    gain_crossings, undetermined_gains = _determined(_crossings(curve, curve.gain, curve.gain_std))
    phases = [_margin_at_crossing(curve, "phase", *each) for each in gain_crossings]
    delays = [_margin_at_crossing(curve, "delay", *each) for each in gain_crossings]
    distance = _least_distance(target)
    band = f"the usable band is {curve.omega[0]:.3g} to {curve.omega[-1]:.3g} rad/s"
    notes = []
    if not gains:
        notes.append(f"no gain margin: no phase of -180 deg; {band}")
    if not phases:
        notes.append(f"no phase margin: no gain of 0 dB; {band}")
    for what, places in (
        ("phase of -180 deg", undetermined_phases),
        ("gain of 0 dB", undetermined_gains),
    ):
        for at in places:
            notes.append(f"no margin at the {what} near {at:.3g} rad/s: it is not determined")
    if distance is None:
        notes.append(f"no least distance from -1: it decreases towards an end of the band; {band}")
    ordered = [sorted(each, key=lambda margin: margin.frequency.value) for each in (gains, phases)]
    delay = min(delays, key=_absolute_size, default=None)
    return StabilityMargins(tuple(ordered[0]), tuple(ordered[1]), delay, distance, tuple(notes))


def _crossings(
    curve: LoopCurve, values: np.ndarray, std: np.ndarray
) -> list[tuple[float, float, float]]:
    """Return for each crossing of zero by a curve the frequency, rad/s, the derivative with respect
    to ln(omega), and the standard deviation of the value.

    Several sign changes by scatter about one crossing lead to the same root of the parabola, which
    is returned once.
    """
    low, high = float(curve.omega[0]), float(curve.omega[-1])
    out: list[tuple[float, float, float]] = []
    for first in np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) <= 0.0):
        at = float(curve.omega[first])
        for _ in range(_NEWTON_STEPS):
            near = parabola_at(curve, values, std, at)
            if near.slope == 0.0:
                break
            most = PARABOLA_HALF_WIDTH
            step = float(np.clip(-near.value / near.slope, -most, most))
            at = float(np.clip(at * math.exp(step), low, high))
        near = parabola_at(curve, values, std, at)
        if near.slope == 0.0 or abs(near.value) > near.std:
            continue
        if all(abs(math.log(at / other)) > 0.5 * PARABOLA_HALF_WIDTH for other, _, _ in out):
            out.append((at, near.slope, near.std))
    return out


def _determined(
    crossings: list[tuple[float, float, float]],
) -> tuple[list[tuple[float, float, float]], list[float]]:
    """Return the crossings known to half the parabola's width, and the other frequencies."""
    determined = [each for each in crossings if each[2] <= PARABOLA_HALF_WIDTH * abs(each[1])]
    return determined, [each[0] for each in crossings if each not in determined]


def _margin_at_crossing(curve: LoopCurve, kind: str, at: float, slope: float, std: float) -> Margin:
    """Return a gain margin at a phase crossing, or a phase or delay margin at a gain crossing.

    ``at`` is the frequency of the crossing, ``slope`` and ``std`` are those of the curve that
    crosses. The standard deviation of the margin follows from the slopes of both curves. The
    interval contains all margins that some frequency makes consistent with the response and its
    errors, by the likelihood ratio with one degree of freedom.
    """
    from scipy.stats import chi2

    limit = float(chi2.ppf(CONFIDENCE, 1))
    middle = _margin_at(curve, kind, at)
    # An error of the crossing frequency changes the margin by the slope of the other curve.
    turn = middle.slope / slope * std
    spread = math.hypot(middle.std, turn)
    step = min(_LARGEST_SCAN_STEP, _SCAN_STEP_SHARE * std / abs(slope))
    low, high, open_ = middle.value, middle.value, False
    for direction in (-1.0, 1.0):
        frequency = at
        while True:
            if not curve.omega[0] <= frequency <= curve.omega[-1]:
                open_ = True
                break
            near = _margin_at(curve, kind, frequency)
            spare = limit - near.sigmas_from_crossing**2
            if spare < 0.0:
                break
            half = near.std * math.sqrt(spare)
            low, high = min(low, near.value - half), max(high, near.value + half)
            frequency *= math.exp(direction * step)
    where = UncertainValue(at, at * std / abs(slope))
    return Margin(kind, UncertainValue(middle.value, spread), where, low, high, open_)


@dataclass(frozen=True)
class _CrossingMargin:
    """Margin under the assumption of a crossing at a given frequency.

    Attributes
    ----------
    value, std : the margin and its standard deviation.
    slope : derivative of the margin with respect to ln(omega).
    sigmas_from_crossing : distance of the crossing curve from zero, in standard deviations.
    """

    value: float
    std: float
    slope: float
    sigmas_from_crossing: float


def _margin_at(curve: LoopCurve, kind: str, at: float) -> _CrossingMargin:
    """Return the margin of a ``kind`` if the other curve crosses at the frequency ``at``, rad/s."""
    gain = parabola_at(curve, curve.gain, curve.gain_std, at)
    phase = parabola_at(curve, curve.phase, curve.phase_std, at)
    turned_by = math.remainder(phase.value, 360.0)
    if kind == "gain":
        return _CrossingMargin(-gain.value, gain.std, gain.slope, turned_by / phase.std)
    if kind == "phase":
        return _CrossingMargin(turned_by, phase.std, phase.slope, gain.value / gain.std)
    angle = math.radians(turned_by) % (2.0 * math.pi)
    slope = (math.radians(phase.slope) - angle) / at
    return _CrossingMargin(angle / at, math.radians(phase.std) / at, slope, gain.value / gain.std)


def _least_distance(target: ResponseTarget) -> Margin | None:
    """Return the smallest distance from -1, at which the slope of the smoothed distance is zero;
    None if it is at an end of the usable band.

    The interval contains all distances d for which, at some frequency, the pair (d, slope 0) is
    consistent with distance and slope of the response and their errors: by the likelihood ratio
    with one degree of freedom, with the frequency as nuisance parameter. The interval extends
    further up than down, since noise makes the minimum of a curve smaller.
    """
    from scipy.stats import chi2

    distances = np.abs(1.0 + target.response)
    least = int(np.argmin(distances))
    if least in (0, distances.size - 1):
        return None
    first, last = float(target.omega[0]), float(target.omega[-1])
    start = float(target.omega[least])
    at = start
    for _ in range(_NEWTON_STEPS):
        near = _critical_distance(target, at)
        if not near.curvature > 0.0:
            break
        most = 0.25 * PARABOLA_HALF_WIDTH
        move = float(np.clip(-near.slope / near.curvature, -most, most))
        at = float(np.clip(at * math.exp(move), first, last))
    if (
        abs(math.log(at / start)) > PARABOLA_HALF_WIDTH
        or _critical_distance(target, at).value > _critical_distance(target, start).value
    ):
        at = start  # Newton's method has left the minimum
    middle = _critical_distance(target, at)
    limit, std = float(chi2.ppf(CONFIDENCE, 1)), math.sqrt(middle.variance)
    reach, open_ = NORMAL_HALF_WIDTH * std, False
    low, high = middle.value - reach, middle.value + reach
    spread = math.sqrt(middle.slope_variance) / max(middle.curvature, 1e-12)
    step = min(_LARGEST_SCAN_STEP, max(_SCAN_STEP_SHARE * spread, 1e-4))
    for direction in (-step, step):
        frequency = at
        while True:
            if not first <= frequency <= last:
                open_ = True
                break
            near = _critical_distance(target, frequency)
            spare = limit - near.slope**2 / max(near.slope_variance, 1e-300)
            if spare < 0.0:
                break
            shared = near.covariance / max(near.slope_variance, 1e-300)
            centre = near.value - shared * near.slope
            half = math.sqrt(max(near.variance - shared * near.covariance, 0.0) * spare)
            low, high = min(low, centre - half), max(high, centre + half)
            frequency *= math.exp(direction)
    size = UncertainValue(middle.value, std)
    where = UncertainValue(at, at * min(spread, PARABOLA_HALF_WIDTH))
    return Margin("distance", size, where, max(low, 0.0), high, open_)


@dataclass(frozen=True)
class _CriticalDistance:
    """Distance of a smoothed response from -1 at a frequency.

    Attributes
    ----------
    value, slope, curvature : the distance, its first and second derivative with respect to
        ln(omega).
    variance, slope_variance, covariance : variances of distance and slope, and their covariance.
    """

    value: float
    slope: float
    curvature: float
    variance: float
    slope_variance: float
    covariance: float


def _critical_distance(target: ResponseTarget, at: float) -> _CriticalDistance:
    """Return the distance |1 + L| at the frequency ``at``, rad/s, from a complex parabola of 1 + L
    in ln(omega) through the points about it.

    Near -1 the response L is well approximated by a parabola, but its distance from -1 is not. The
    errors in the direction of the distance and across it are independent.
    """
    gain, covariance, near = parabola_weights(target, target.std, at)
    a = gain @ (1.0 + target.response[near])
    size = abs(a[0])
    along = np.conj(a / size) if size > 0.0 else np.ones(3)
    turn = float((along[0] * a[1]).imag) if size > 0.0 else 0.0
    share = turn / size if size > 0.0 else 0.0
    return _CriticalDistance(
        float(size),
        float((along[0] * a[1]).real),
        float((along[0] * 2.0 * a[2]).real) + turn * share,
        float(covariance[0, 0]),
        float(covariance[1, 1] + share**2 * covariance[0, 0]),
        float(covariance[0, 1]),
    )


@dataclass(frozen=True)
class WorstMargin:
    """Smallest value of one margin in several maneuvers.

    Attributes
    ----------
    name : name of the margin, a key of `StabilityMargins.named`.
    margin : smallest margin.
    maneuver : number of its maneuver, from 0.
    half : half width of its 95 % interval, simultaneous for all maneuvers.
    values : margin in each maneuver; None if the maneuver does not show it.
    p_value : probability that the margins of the maneuvers differ as much by chance; one if fewer
        than two maneuvers show it.
    """

    name: str
    margin: Margin
    maneuver: int
    half: float
    values: tuple[Margin | None, ...]
    p_value: float


def worst_margins(maneuvers: Sequence[StabilityMargins]) -> tuple[WorstMargin, ...]:
    """Return the smallest value of each margin over all maneuvers, with simultaneous intervals
    (Bonferroni) and the p-value of the agreement of the maneuvers (chi-square).
    """
    from scipy.stats import chi2, norm

    out = []
    for name in ("gain_increase", "gain_decrease", "phase_margin", "delay_margin", "distance"):
        values = [each.named.get(name) for each in maneuvers]
        known = [(n, each) for n, each in enumerate(values) if each is not None]
        if not known:
            continue
        number, least = min(known, key=lambda pair: _absolute_size(pair[1]))
        sigmas = float(norm.ppf(1.0 - 0.5 * (1.0 - CONFIDENCE) / len(known)))
        sizes = np.array([each.size.value for _, each in known])
        weights = np.array([max(each.size.std, 1e-300) for _, each in known]) ** -2.0
        mean = float(weights @ sizes / weights.sum())
        spread = float(weights @ (sizes - mean) ** 2)
        p = float(chi2.sf(spread, len(known) - 1)) if len(known) > 1 else 1.0
        out.append(WorstMargin(name, least, number, sigmas * least.size.std, tuple(values), p))
    return tuple(out)


def turned(target: ResponseTarget) -> ResponseTarget:
    """Return the target with its sign reversed, for a loop with positive feedback."""
    return replace(target, response=-target.response)
