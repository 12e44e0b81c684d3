"""A pilot who closes the loop of pitch attitude (Neal and Smith), and steps of a fitted response.

The pilot is K exp(-delay s) (lead s + 1) / (lag s + 1), adjusted so that the closed loop of
attitude has a phase of -90 deg at the bandwidth and droops below it by 3 dB, which leaves the least
resonance. Neal and Smith, "An In-Flight Investigation to Develop Control
System Design Criteria for Fighter Airplanes", AFFDL-TR-70-74, 1970; limits of the resonance, usual
bandwidths and delay: MIL-STD-1797A, section 4.2.1.2, closed-loop criterion.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ident.flying_qualities.bandwidth import (
    AttitudeCurve,
    BandwidthQuantity,
    parabola_at,
    shared_covariance,
)
from ident.frequency_response.transfer_function import FORMS, FittedResponse

DROOP = -3.0  # dB
LEVELS = (3.0, 9.0)  # dB, of the resonance: limits of levels 1 and 2
# rad/s by category of the flight phase, and s
BANDWIDTHS: Mapping[str, float] = {"A": 3.5, "B": 1.5, "C": 1.5}
PILOT_DELAY = 0.25
DRAWS, POINTS, SEED = 100, 60, 20
_STEEPEST = 85.0  # deg of lead or lag
_GRID = 69  # compensations that are tried


@dataclass(frozen=True)
class PilotDemand:
    """What is asked of the pilot: closed-loop ``bandwidth``, rad/s, and own ``delay``, s."""

    bandwidth: float
    delay: float = PILOT_DELAY


@dataclass(frozen=True)
class NealSmith:
    """The pilot that the criterion finds.

    Attributes
    ----------
    demand : what was asked. resonance : dB, the peak of the closed loop. compensation : deg, phase
        of the pilot's lead (positive) or lag at the bandwidth, without the delay.
    level : 1, 2 or 3, by the resonance; best, worst : within two standard deviations.
    droop : dB, the least of the closed loop below the bandwidth. correlation : of both errors.
    notes : one sentence each.
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
    """Level 1 to 3 of a resonance in dB, MIL-STD-1797A."""
    return 1 + int(resonance > LEVELS[0]) + int(resonance > LEVELS[1])


def neal_smith(curve: AttitudeCurve, demand: PilotDemand) -> NealSmith | str:
    """The criterion for an attitude response along its usable band; a sentence where it cannot be
    applied.

    The response is smoothed by parabolas about each frequency. Its errors, which neighbours share,
    are drawn 100 times, and the pilot is adjusted to each draw.
    """
    low, high = float(curve.omega[0]), float(curve.omega[-1])
    if not low * 2.0 <= demand.bandwidth <= high / 1.2:
        return (
            f"no Neal-Smith pilot: a bandwidth of {demand.bandwidth:.3g} rad/s needs a usable band "
            f"from half of it to 1.2 times it, and it is {low:.3g} to {high:.3g} rad/s"
        )
    omega = np.unique(np.append(np.geomspace(low, high, POINTS), demand.bandwidth))
    centre, draws = _smoothed(curve, omega)
    found = _adjusted(omega, centre[None], demand)
    if found is None:
        return "no Neal-Smith pilot: no lead or lag gives the bandwidth"
    resonance, compensation, droop = (float(each[0]) for each in found)
    drawn = _adjusted(omega, draws, demand)
    assert drawn is not None
    stds = [float(np.std(each)) for each in drawn[:2]]
    alike = np.corrcoef(drawn[0], drawn[1])[0, 1] if min(stds) > 0.0 else 0.0
    levels = [resonance_level(resonance + sign * 2.0 * stds[0]) for sign in (-1.0, 1.0)]
    notes = []
    if droop < DROOP - 0.05:
        notes.append(f"the closed loop droops by {-droop:.2g} dB, more than the 3 dB allowed")
    edge = int(np.argmax(_closed(omega, centre[None], demand, np.array([compensation]))[0]))
    if edge == omega.size - 1:
        notes.append("the resonance lies at the end of the usable band and may be larger")
    return NealSmith(
        demand,
        BandwidthQuantity(resonance, stds[0]),
        BandwidthQuantity(compensation, stds[1]),
        resonance_level(resonance),
        levels[0],
        levels[1],
        droop,
        float(alike),
        tuple(notes),
    )


def _smoothed(curve: AttitudeCurve, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The attitude at ``omega`` ``(F,)`` by parabolas, and draws of it ``(D, F)``."""
    rng = np.random.default_rng(SEED)
    places = np.arange(curve.omega.size)
    rows = []
    for values, std in ((curve.gain, curve.gain_std), (curve.phase, curve.phase_std)):
        covariance = shared_covariance(curve, std, places)
        # Correlations that were estimated pair by pair need not be those of any variables: the
        # symmetric root of the nearest covariance that is.
        sizes, turned = np.linalg.eigh(covariance)
        root = (turned * np.sqrt(np.maximum(sizes, 0.0))) @ turned.T
        noisy = values + (root @ rng.standard_normal((values.size, DRAWS))).T
        zero = np.zeros_like(std)
        matrix = np.array([parabola_at(curve, zero, std, at).weights for at in omega])
        rows.append((matrix @ values, noisy @ matrix.T))
    gain, phase = rows
    return _complex(gain[0], phase[0]), _complex(gain[1], phase[1])


def _complex(gain: np.ndarray, phase: np.ndarray) -> np.ndarray:
    return np.asarray(10.0 ** (gain / 20.0) * np.exp(1j * np.radians(phase)))


def _closed(
    omega: np.ndarray, attitude: np.ndarray, demand: PilotDemand, compensation: np.ndarray
) -> np.ndarray:
    """Gain of the closed loop ``(D, F)``, dB, under ``compensation`` ``(D,)``, deg at the
    bandwidth, with the pilot's gain that gives a phase of -90 deg there; NaN where none does."""
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


def _adjusted(
    omega: np.ndarray, attitude: np.ndarray, demand: PilotDemand
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Resonance, compensation and droop ``(D,)`` of the pilots; None where no compensation gives
    the bandwidth."""
    below = omega <= demand.bandwidth * (1.0 + 1e-9)
    tried = np.linspace(-_STEEPEST, _STEEPEST, _GRID)
    # The droop of every compensation on a grid.
    droops = []
    for each in tried:
        closed = _closed(omega, attitude, demand, np.full(len(attitude), each))
        droops.append(np.min(closed[:, below], axis=1))
    table = np.array(droops)  # (C, D)
    if np.all(np.isnan(table[:, 0])):
        return None
    out = np.array([_least(tried, column) for column in table.T])
    closed = _closed(omega, attitude, demand, out)
    return np.max(closed, axis=1), out, np.min(closed[:, below], axis=1)


def _least(tried: np.ndarray, droop: np.ndarray) -> float:
    """The most lead with a droop of 3 dB at most, between the grid's points: more would droop, less
    resonates. Of none the one that droops least."""
    known = np.flatnonzero(np.isfinite(droop))
    fit = known[droop[known] >= DROOP]
    if not known.size:
        return math.nan
    if not fit.size:
        return float(tried[known[np.argmax(droop[known])]])
    best = int(fit[-1])
    if best + 1 >= tried.size or not np.isfinite(droop[best + 1]):
        return float(tried[best])
    share = (DROOP - droop[best]) / (droop[best + 1] - droop[best])
    return float(tried[best] + share * (tried[best + 1] - tried[best]))


# ---- Steps of a fitted response


@dataclass(frozen=True, eq=False)
class StepResponse:
    """Response to a unit step of the stick, over its steady value: ``time`` s, ``value`` and
    ``std`` ``(N,)``."""

    time: np.ndarray
    value: np.ndarray
    std: np.ndarray


def step_response(function: FittedResponse, duration: float | None = None) -> StepResponse | None:
    """The step of a fitted response over its steady value, with deviations by linearisation; None
    where it has no steady value.

    ``duration`` : s; None takes eight times the slowest mode's time constant, 10 s at most.
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
        late = np.interp(time - p["delay"], time, out, left=0.0)
        return np.asarray(late * bottom[-1] / top[-1])

    return StepResponse(time, value(function.values), _spread(function, value))


def pitch_overshoot(function: FittedResponse) -> BandwidthQuantity | None:
    """Largest over steady pitch rate of a step, of the form ``pitch``; None for any other form."""
    if function.form is not FORMS["pitch"]:
        return None
    step = step_response(function)
    if step is None:
        return None
    peak = int(np.argmax(step.value))
    return BandwidthQuantity(float(step.value[peak]), float(step.std[peak]))


def _spread(
    function: FittedResponse, value: Callable[[Mapping[str, float]], np.ndarray]
) -> np.ndarray:
    """Deviations of a quantity ``(N,)`` by the covariance of a function's parameters."""
    p, slopes = dict(function.values), []
    for name in function.std:
        step = 1e-5 * max(abs(p[name]), 1e-3)
        ends = [value({**p, name: p[name] + sign * step}) for sign in (1.0, -1.0)]
        slopes.append((ends[0] - ends[1]) / (2.0 * step))
    matrix = np.array(slopes)
    return np.asarray(
        np.sqrt(np.maximum(np.einsum("kn,kl,ln->n", matrix, function.covariance, matrix), 0.0))
    )
