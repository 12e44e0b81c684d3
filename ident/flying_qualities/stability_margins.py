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
    BandwidthQuantity,
    parabola_at,
    parabola_weights,
)
from ident.frequency_response.transfer_function import ResponseTarget

REQUIRED_GAIN = 6.0  # dB, below the first structural mode
REQUIRED_PHASE = 45.0  # deg, below the first structural mode
CONFIDENCE = 0.95  # probability of an interval
NORMAL_HALF_WIDTH = 1.959964  # its half width, standard deviations of a normal distribution
_NEWTON_STEPS = 6  # of Newton's method towards a crossing
_LARGEST_SCAN_STEP = 0.02  # largest step of the scan of an interval, ln(omega)
_SCAN_STEP_SHARE = 0.2  # step as a share of the standard deviation of the crossing
_DECIBELS_PER_NEPER = 20.0 / math.log(10.0)


@dataclass(frozen=True)
class Margin:
    """A margin at one crossing.

    Attributes
    ----------
    kind : ``"gain"`` in dB, ``"phase"`` in deg, ``"delay"`` in s, ``"distance"`` from -1, no unit.
    size : the margin and its standard deviation. A gain margin is the change of the loop gain that
        makes the loop unstable: positive where it may rise, negative where it may fall.
    frequency : rad/s, of the crossing.
    low, high : ends of the 95 % interval.
    open : the interval reaches an end of the usable band, so that it may be wider.
    """

    kind: str
    size: BandwidthQuantity
    frequency: BandwidthQuantity
    low: float
    high: float
    open: bool = False


@dataclass(frozen=True)
class StabilityMargins:
    """Margins of a loop that is stable when closed; -1 is the critical point.

    Attributes
    ----------
    gains : at every phase of -180 deg (and whole turns from it).
    phases : at every gain of one.
    delay : of the gain crossing that bears the least delay.
    distance : least distance of the response from -1, the inverse of the peak of the sensitivity;
        None where it lies at an end of the usable band.
    notes : why something is not known, one sentence each.
    """

    gains: tuple[Margin, ...]
    phases: tuple[Margin, ...]
    delay: Margin | None
    distance: Margin | None
    notes: tuple[str, ...] = ()

    @property
    def gain_increase(self) -> Margin | None:
        """The least rise of the gain that makes the loop unstable."""
        return min((each for each in self.gains if each.size.value > 0.0), key=_size, default=None)

    @property
    def gain_decrease(self) -> Margin | None:
        """The least fall of the gain that makes the loop unstable; its size is negative."""
        return min((each for each in self.gains if each.size.value <= 0.0), key=_size, default=None)

    @property
    def phase(self) -> Margin | None:
        """The phase margin of least size."""
        return min(self.phases, key=_size, default=None)

    @property
    def named(self) -> dict[str, Margin]:
        """The margins that are known, by ``"gain_increase"`` and so on."""
        every = {
            "gain_increase": self.gain_increase,
            "gain_decrease": self.gain_decrease,
            "phase_margin": self.phase,
            "delay_margin": self.delay,
            "distance": self.distance,
        }
        return {name: each for name, each in every.items() if each is not None}


def _size(margin: Margin) -> float:
    return abs(margin.size.value)


@dataclass(frozen=True, eq=False)
class LoopCurve:
    """A broken-loop response ``(F,)`` over rad/s: gain in dB, phase in deg about -180 deg (zero on
    the negative real axis), distance from -1 in dB, and the deviations of each.

    ``length`` : s, effective one of the windows.
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
    """Return the curve of a broken-loop response L; 1 + L = 0 closes the loop."""
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
    """Return the margins of a broken-loop response along its usable band.

    At a crossing gain and phase are parabolas in ln(omega) through the points about it. The errors
    of gain and phase are independent (a circle in the complex plane), those of neighbours
    correlated as the windows are.

    Parameters
    ----------
    target : the response L of the returned signal to the one that enters, with its sign turned
        where the loop adds it, so that 1 + L = 0 closes the loop.
    """
    curve = loop_curve(target)
    whole = 360.0 * np.arange(
        math.ceil(curve.phase.min() / 360.0), math.floor(curve.phase.max() / 360.0) + 1
    )
    every = [_crossings(curve, curve.phase - level, curve.phase_std) for level in whole]
    turns, vague = _determined([each for crossings in every for each in crossings])
    gains = [_across(curve, "gain", *each) for each in turns]
    crossings, lost = _determined(_crossings(curve, curve.gain, curve.gain_std))
    phases = [_across(curve, "phase", *each) for each in crossings]
    delays = [_across(curve, "delay", *each) for each in crossings]
    distance = _least_distance(target)
    band = f"the usable band is {curve.omega[0]:.3g} to {curve.omega[-1]:.3g} rad/s"
    notes = []
    if not gains:
        notes.append(f"no gain margin: no phase of -180 deg; {band}")
    if not phases:
        notes.append(f"no phase margin: no gain of 0 dB; {band}")
    for what, places in (("phase of -180 deg", vague), ("gain of 0 dB", lost)):
        for at in places:
            notes.append(f"a {what} near {at:.3g} rad/s is not determined, and no margin there")
    if distance is None:
        notes.append(f"no least distance from -1: it falls towards an end of the band; {band}")
    ordered = [sorted(each, key=lambda margin: margin.frequency.value) for each in (gains, phases)]
    delay = min(delays, key=_size, default=None)
    return StabilityMargins(tuple(ordered[0]), tuple(ordered[1]), delay, distance, tuple(notes))


def _crossings(
    curve: LoopCurve, values: np.ndarray, std: np.ndarray
) -> list[tuple[float, float, float]]:
    """Frequency, slope by ln(omega) and deviation of the value, wherever a curve crosses zero.

    Points that scatter about zero at one crossing lead to the same root of their parabola.
    """
    low, high = float(curve.omega[0]), float(curve.omega[-1])
    out: list[tuple[float, float, float]] = []
    for first in np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) <= 0.0):
        at = float(curve.omega[first])
        for _ in range(_NEWTON_STEPS):
            near = parabola_at(curve, values, std, at)
            if near.slope == 0.0:
                break
            step = float(
                np.clip(-near.value / near.slope, -PARABOLA_HALF_WIDTH, PARABOLA_HALF_WIDTH)
            )
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
    """Crossings whose frequency is known to within the reach of the parabola, and where the others
    are.
    """
    determined = [
        (at, slope, std) for at, slope, std in crossings if std <= PARABOLA_HALF_WIDTH * abs(slope)
    ]
    return determined, [
        at for at, slope, std in crossings if std > PARABOLA_HALF_WIDTH * abs(slope)
    ]


def _across(curve: LoopCurve, kind: str, at: float, slope: float, std: float) -> Margin:
    """Return a gain margin at a phase crossing, a phase or delay margin at a gain crossing.

    ``slope``, ``std`` : of the curve that crosses. The deviation follows by the slopes of both
    curves; the interval holds every margin whose point of the critical line, at some frequency, is
    no further from the response than its error allows (likelihood ratio with one degree).
    """
    from scipy.stats import chi2

    limit = float(chi2.ppf(CONFIDENCE, 1))
    middle = _at(curve, kind, at)
    # Of a delay margin the crossing moves the angle and the frequency it is divided by.
    turn = middle.own_slope / slope * std
    spread = math.hypot(middle.std, turn)
    step = min(_LARGEST_SCAN_STEP, _SCAN_STEP_SHARE * std / abs(slope))
    low, high, open_ = middle.value, middle.value, False
    for direction in (-1.0, 1.0):
        there = at
        while True:
            if not curve.omega[0] <= there <= curve.omega[-1]:
                open_ = True
                break
            near = _at(curve, kind, there)
            spare = limit - near.sigmas_from_crossing**2
            if spare < 0.0:
                break
            half = near.std * math.sqrt(spare)
            low, high = min(low, near.value - half), max(high, near.value + half)
            there *= math.exp(direction * step)
    where = BandwidthQuantity(at, at * std / abs(slope))
    return Margin(kind, BandwidthQuantity(middle.value, spread), where, low, high, open_)


@dataclass(frozen=True)
class _CrossingMargin:
    """A margin if the curve crossed at a frequency: its value and deviation, its slope by
    ln(omega), and how many deviations the other curve is from crossing there."""

    value: float
    std: float
    own_slope: float
    sigmas_from_crossing: float


def _at(curve: LoopCurve, kind: str, at: float) -> _CrossingMargin:
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
    """Return the least distance from -1, where the slope of the smoothed distance is zero.

    Its interval holds every distance d whose pair (d, slope 0) is, at some frequency, no further
    from distance and slope of the response than their errors allow: the likelihood ratio with one
    degree, in which the frequency is a nuisance. It reaches further up than down, for the least of
    a noisy curve lies low.
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
        move = float(
            np.clip(
                -near.slope / near.curvature,
                -0.25 * PARABOLA_HALF_WIDTH,
                0.25 * PARABOLA_HALF_WIDTH,
            )
        )
        at = float(np.clip(at * math.exp(move), first, last))
    if (
        abs(math.log(at / start)) > PARABOLA_HALF_WIDTH
        or _critical_distance(target, at).value > _critical_distance(target, start).value
    ):
        at = start  # the parabola turned elsewhere
    middle = _critical_distance(target, at)
    limit, std = float(chi2.ppf(CONFIDENCE, 1)), math.sqrt(middle.variance)
    low, high, open_ = (
        middle.value - NORMAL_HALF_WIDTH * std,
        middle.value + NORMAL_HALF_WIDTH * std,
        False,
    )
    spread = math.sqrt(middle.slope_variance) / max(middle.curvature, 1e-12)
    step = min(_LARGEST_SCAN_STEP, max(_SCAN_STEP_SHARE * spread, 1e-4))
    for direction in (-step, step):
        there = at
        while True:
            if not first <= there <= last:
                open_ = True
                break
            near = _critical_distance(target, there)
            spare = limit - near.slope**2 / max(near.slope_variance, 1e-300)
            if spare < 0.0:
                break
            shared = near.covariance / max(near.slope_variance, 1e-300)
            centre = near.value - shared * near.slope
            half = math.sqrt(max(near.variance - shared * near.covariance, 0.0) * spare)
            low, high = min(low, centre - half), max(high, centre + half)
            there *= math.exp(direction)
    size = BandwidthQuantity(middle.value, std)
    where = BandwidthQuantity(at, at * min(spread, PARABOLA_HALF_WIDTH))
    return Margin("distance", size, where, max(low, 0.0), high, open_)


@dataclass(frozen=True)
class _CriticalDistance:
    """Distance of a smoothed response from -1 at a frequency, its slope and curvature by ln(omega),
    the variances of distance and slope, and their covariance."""

    value: float
    slope: float
    curvature: float
    variance: float
    slope_variance: float
    covariance: float


def _critical_distance(target: ResponseTarget, at: float) -> _CriticalDistance:
    """1 + L as a complex parabola in ln(omega) through the points about ``at``, rad/s.

    The distance itself is no parabola where the response passes -1 closely, the response is. Its
    errors along the distance and across it are independent.
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
    """The least of one margin over several maneuvers.

    Attributes
    ----------
    name : ``"phase_margin"`` and so on.
    margin : the least.
    maneuver : its number, from 0.
    half : half width of its interval that holds for all maneuvers together with 95 %.
    values : of every maneuver, None where it does not show the margin.
    p_value : chance that maneuvers of one and the same margin differ as much; one where fewer than
        two show it.
    """

    name: str
    margin: Margin
    maneuver: int
    half: float
    values: tuple[Margin | None, ...]
    p_value: float


def worst_margins(maneuvers: Sequence[StabilityMargins]) -> tuple[WorstMargin, ...]:
    """The least of every margin over maneuvers, with intervals that hold for all together
    (Bonferroni), and whether the maneuvers agree (chi-square)."""
    from scipy.stats import chi2, norm

    out = []
    for name in ("gain_increase", "gain_decrease", "phase_margin", "delay_margin", "distance"):
        values = [each.named.get(name) for each in maneuvers]
        known = [(n, each) for n, each in enumerate(values) if each is not None]
        if not known:
            continue
        number, least = min(known, key=lambda pair: _size(pair[1]))
        wide = float(norm.ppf(1.0 - 0.5 * (1.0 - CONFIDENCE) / len(known)))
        sizes = np.array([each.size.value for _, each in known])
        weights = np.array([max(each.size.std, 1e-300) for _, each in known]) ** -2.0
        mean = float(weights @ sizes / weights.sum())
        spread = float(weights @ (sizes - mean) ** 2)
        p = float(chi2.sf(spread, len(known) - 1)) if len(known) > 1 else 1.0
        out.append(WorstMargin(name, least, number, wide * least.size.std, tuple(values), p))
    return tuple(out)


def turned(target: ResponseTarget) -> ResponseTarget:
    """Return the target with its sign reversed, for a loop with positive feedback."""
    return replace(target, response=-target.response)
