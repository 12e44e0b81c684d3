"""Bandwidth, phase delay and dropback against definitions on exact and on noisy responses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from ident.flying_qualities.attitude_criteria import attitude_bandwidth, dropback
from ident.frequency_response.transfer_function import (
    FORMS,
    ResponseTarget,
    fit_transfer_functions,
    neighbour_correlation,
)

VALUES = {"gain": -6.0, "inv_T_theta2": 1.2, "frequency": 4.0, "damping": 0.5, "delay": 0.1}
OMEGA = np.geomspace(0.5, 30.0, 100)


def rate(omega: np.ndarray) -> np.ndarray:
    """Pitch rate over a stick that pitches down: the sign of the response is turned."""
    return FORMS["pitch"].response(VALUES, omega)


def phase(omega: float) -> float:
    """Phase of the attitude, deg, written out."""
    p = VALUES
    second = math.atan2(2 * p["damping"] * p["frequency"] * omega, p["frequency"] ** 2 - omega**2)
    turn = math.atan(omega / p["inv_T_theta2"]) - second - p["delay"] * omega
    return math.degrees(turn) - 90.0


def gain(omega: float) -> float:
    return float(20.0 * np.log10(np.abs(rate(np.array(omega)) / omega)))


NEUTRAL = brentq(lambda w: phase(w) + 180.0, 2.0, 20.0)


def target(response: np.ndarray, share: float = 0.01) -> ResponseTarget:
    one = np.ones(OMEGA.size)
    return ResponseTarget("q/de", OMEGA, response, 0.99 * one, share * np.abs(response), 60.0)


def test_definitions() -> None:
    found = attitude_bandwidth(target(rate(OMEGA)), rate=True)
    assert found.neutral is not None and found.phase is not None
    assert found.gain is not None and found.delay is not None and found.notes == ()
    assert found.neutral.value == pytest.approx(NEUTRAL, rel=2e-3)
    margin = brentq(lambda w: phase(w) + 135.0, 1.0, 20.0)
    assert found.phase.value == pytest.approx(margin, rel=2e-3)
    six = brentq(lambda w: gain(w) - gain(NEUTRAL) - 6.0, 3.5, NEUTRAL)
    assert found.gain.value == pytest.approx(six, rel=5e-3)
    assert found.bandwidth is not None
    assert found.bandwidth.value == min(found.phase.value, found.gain.value)
    at = np.linspace(NEUTRAL, 2.0 * NEUTRAL, 201)
    slope = np.polyfit(at, np.radians([phase(w) for w in at]), 1)[0]
    assert found.delay.value == pytest.approx(-0.5 * slope, rel=0.01)


def test_an_attitude_is_not_integrated() -> None:
    by_rate = attitude_bandwidth(target(rate(OMEGA)), rate=True)
    by_attitude = attitude_bandwidth(target(rate(OMEGA) / (1j * OMEGA)), rate=False)
    for name in ("neutral", "phase", "gain", "delay"):
        one, other = getattr(by_rate, name), getattr(by_attitude, name)
        assert one.value == pytest.approx(other.value) and one.std == pytest.approx(other.std)


def test_a_short_band_says_what_is_missing() -> None:
    def cut(high: float) -> ResponseTarget:
        whole, there = target(rate(OMEGA)), high >= OMEGA
        part = (each[there] for each in (whole.response, whole.coherence, whole.std))
        response, coherence, std = part
        return ResponseTarget("q/de", whole.omega[there], response, coherence, std, 60.0)

    short = attitude_bandwidth(cut(1.5 * NEUTRAL), rate=True)
    assert short.delay is None and short.gain is not None and "no phase delay" in short.notes[0]
    shorter = attitude_bandwidth(cut(0.95 * NEUTRAL), rate=True)
    assert (
        shorter.neutral is shorter.gain is shorter.bandwidth is None and shorter.phase is not None
    )
    least = attitude_bandwidth(cut(2.0), rate=True)
    assert least.phase is None and len(least.notes) == 2


def test_deviations_are_the_scatter() -> None:
    rng = np.random.default_rng(5)
    apart = np.subtract.outer(OMEGA, OMEGA) / (2.0 * math.pi) * 60.0
    root = np.linalg.cholesky(neighbour_correlation(apart) + 1e-9 * np.eye(OMEGA.size))
    values, reported = [], []
    for _ in range(150):
        noise = root @ (rng.standard_normal((OMEGA.size, 2)) @ np.array([1.0, 1.0j]))
        found = attitude_bandwidth(target(rate(OMEGA) * (1.0 + 0.01 * noise)), rate=True)
        each = [found.neutral, found.phase, found.gain, found.delay]
        values.append([one.value for one in each if one is not None])
        reported.append([one.std for one in each if one is not None])
    np.testing.assert_allclose(np.median(reported, axis=0) / np.std(values, axis=0), 1.0, atol=0.25)


def test_dropback_is_what_the_attitude_falls_back() -> None:
    """A simulated step of the stick that is taken back: attitude at the release less the last
    one.
    """
    from scipy import signal

    p = VALUES
    (one,) = fit_transfer_functions([target(rate(OMEGA))], [FORMS["pitch"]]).functions
    found = dropback(one)
    assert found is not None and found.std > 0.0
    top, bottom = FORMS["pitch"].polynomials(p)
    time = np.linspace(0.0, 20.0, 20001)
    stick = np.where((time >= p["delay"]) & (time < 10.0 + p["delay"]), 1.0, 0.0)
    _, attitude, _ = signal.lsim((top, np.polymul(bottom, [1.0, 0.0])), stick, time)
    steady = p["gain"] * p["inv_T_theta2"] / p["frequency"] ** 2
    fall = (attitude[time == 10.0][0] - attitude[-1]) / steady
    assert found.value == pytest.approx(fall, abs=3e-3)
    roll = fit_transfer_functions([target(rate(OMEGA))], [FORMS["roll"]]).functions[0]
    assert dropback(roll) is None
