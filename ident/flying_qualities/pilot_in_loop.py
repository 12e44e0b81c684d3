"""Criterion of Neal and Smith: a pilot closes the loop of pitch attitude with a given bandwidth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ident.flying_qualities.attitude_criteria import (
    AttitudeCurve,
    UncertainValue,
    parabola_at,
    shared_covariance,
)

LARGEST_DROOP = -3.0  # dB, smallest gain of the closed loop below the bandwidth
LARGEST_RESONANCES = (3.0, 9.0)  # dB, of levels 1 and 2
PILOT_DELAY = 0.25  # s, delay of the pilot
_DROOP_TOLERANCE = 0.05  # dB, excess of droop that is not reported
RESPONSE_DRAWS = 100  # samples of the response for standard deviations
SCAN_POINTS = 60  # frequencies of a scan
RESPONSE_SEED = 20  # seed of the random numbers
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
    resonance: UncertainValue
    compensation: UncertainValue
    level: int
    best: int
    worst: int
    droop: float
    correlation: float = 0.0
    notes: tuple[str, ...] = ()


def resonance_level(resonance: float) -> int:
    """Return the level, 1 to 3, of a resonance, dB, by MIL-STD-1797A."""
    return 1 + int(resonance > LARGEST_RESONANCES[0]) + int(resonance > LARGEST_RESONANCES[1])


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
            f"from half to 1.2 times this frequency, and the band is {low:.3g} to {high:.3g} rad/s"
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
    if droop < LARGEST_DROOP - _DROOP_TOLERANCE:
        notes.append(f"the closed loop droops by {-droop:.2g} dB, more than the 3 dB allowed")
    closed = _closed_loop_gain(omega, centre[None], demand, np.array([compensation]))
    if int(np.argmax(closed[0])) == omega.size - 1:
        notes.append("the resonance lies at the end of the usable band and may be larger")
    return NealSmith(
        demand,
        UncertainValue(resonance, stds[0]),
        UncertainValue(compensation, stds[1]),
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
    rng = np.random.default_rng(RESPONSE_SEED)
    positions = np.arange(curve.omega.size)
    rows = []
    for values, std in ((curve.gain, curve.gain_std), (curve.phase, curve.phase_std)):
        covariance = shared_covariance(curve, std, positions)
        # The approximate correlations may form an indefinite matrix: negative eigenvalues are set
        # to zero before the root is taken.
        eigenvalues, eigenvectors = np.linalg.eigh(covariance)
        root = (eigenvectors * np.sqrt(np.maximum(eigenvalues, 0.0))) @ eigenvectors.T
        samples = values + (root @ rng.standard_normal((values.size, RESPONSE_DRAWS))).T
        zero = np.zeros_like(std)
        matrix = np.array([parabola_at(curve, zero, std, at).weights for at in omega])
        rows.append((matrix @ values, samples @ matrix.T))
    gain, phase = rows
    return _complex_response(gain[0], phase[0]), _complex_response(gain[1], phase[1])


def _complex_response(gain: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """Return complex responses from gains, dB, and phases, deg."""
    return np.asarray(10.0 ** (gain / 20.0) * np.exp(1j * np.radians(phase)))


def _closed_loop_gain(
    omega: np.ndarray, attitude: np.ndarray, demand: PilotDemand, compensation: np.ndarray
) -> np.ndarray:
    """Return the gain ``(D, F)``, dB, of the closed loop of pilot and aircraft for D responses.

    ``attitude (D, F)`` are the complex responses at ``omega (F,)``. ``compensation (D,)`` is the
    pilot's lead, or lag if negative, in deg at the bandwidth. The pilot's gain is chosen so that
    the closed loop has a phase of -90 deg at the bandwidth. Rows without such a gain are NaN.
    """
    index = int(np.searchsorted(omega, demand.bandwidth))
    tangent = np.tan(np.radians(np.abs(compensation)))[:, None] * omega / demand.bandwidth
    pilot = np.where(compensation[:, None] >= 0.0, 1.0 + 1j * tangent, 1.0 / (1.0 + 1j * tangent))
    loop = attitude * pilot * np.exp(-1j * omega * demand.delay)
    # T = L/(1 + L) is on the negative imaginary axis where |L| = -cos(angle of L).
    angle = np.angle(loop[:, index])
    loop_gain = np.where((np.cos(angle) < 0.0) & (np.sin(angle) < 0.0), -np.cos(angle), np.nan)
    loop = loop * (loop_gain / np.abs(loop[:, index]))[:, None]
    with np.errstate(invalid="ignore"):
        return np.asarray(20.0 * np.log10(np.abs(loop) / np.abs(1.0 + loop)))


def _adjusted_pilots(
    omega: np.ndarray, attitude: np.ndarray, demand: PilotDemand
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return resonance, dB, compensation, deg, and droop, dB, ``(D,)`` each, of pilots adjusted to
    the D responses ``attitude (D, F)``; None if no pilot gives the bandwidth.
    """
    below = omega <= demand.bandwidth * (1.0 + 1e-9)
    candidates = np.linspace(-_LARGEST_COMPENSATION, _LARGEST_COMPENSATION, _COMPENSATION_POINTS)
    droops = []
    for candidate in candidates:
        closed = _closed_loop_gain(omega, attitude, demand, np.full(len(attitude), candidate))
        droops.append(np.min(closed[:, below], axis=1))
    droop_table = np.array(droops)  # (C, D)
    if np.all(np.isnan(droop_table[:, 0])):
        return None
    compensation = np.array([_largest_allowed_lead(candidates, column) for column in droop_table.T])
    closed = _closed_loop_gain(omega, attitude, demand, compensation)
    return np.max(closed, axis=1), compensation, np.min(closed[:, below], axis=1)


def _largest_allowed_lead(candidates: np.ndarray, droop: np.ndarray) -> float:
    """Return the largest lead, deg, for which the droop is at most 3 dB, interpolated between the
    compensations ``candidates (C,)``; or the compensation with the least droop if none is allowed.

    More lead makes the closed loop droop, and less makes it resonate. ``droop (C,)`` is in dB.
    """
    finite_rows = np.flatnonzero(np.isfinite(droop))
    allowed = finite_rows[droop[finite_rows] >= LARGEST_DROOP]
    if not finite_rows.size:
        return math.nan
    if not allowed.size:
        return float(candidates[finite_rows[np.argmax(droop[finite_rows])]])
    best = int(allowed[-1])
    if best + 1 >= candidates.size or not np.isfinite(droop[best + 1]):
        return float(candidates[best])
    fraction = (LARGEST_DROOP - droop[best]) / (droop[best + 1] - droop[best])
    return float(candidates[best] + fraction * (candidates[best + 1] - candidates[best]))
