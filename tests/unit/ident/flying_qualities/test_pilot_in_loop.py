"""Neal and Smith's pilot against a search over all pilots, steps against python-control."""

from __future__ import annotations

import control
import numpy as np
import pytest

from ident.flying_qualities.attitude_criteria import (
    AttitudeCurve,
    pitch_bandwidth_level,
    pitch_overshoot,
    shared_covariance,
    step_response,
)
from ident.flying_qualities.pilot_in_loop import NealSmith, PilotDemand, neal_smith, resonance_level
from ident.frequency_response.transfer_function import FORMS, FittedResponse, form_of

OMEGA = np.geomspace(0.3, 25.0, 90)
DEMAND = PilotDemand(3.5, 0.25)


def attitude(omega: np.ndarray, frequency: float = 6.0, delay: float = 0.05) -> np.ndarray:
    s = 1j * omega
    bottom = s * (s**2 + 1.4 * frequency * s + frequency**2)
    return np.asarray((s + 2.0) / bottom * np.exp(-s * delay))


def curve(response: np.ndarray, share: float = 0.01) -> AttitudeCurve:
    one = np.full(OMEGA.size, share)
    phase = np.degrees(np.unwrap(np.angle(response)))
    gain = 20.0 * np.log10(np.abs(response))
    return AttitudeCurve(OMEGA, gain, phase, 8.686 * one, np.degrees(one), 30.0)


def best_pilot(frequency: float, delay: float) -> tuple[float, float]:
    """Resonance and compensation of the pilot with the least resonance of all whose closed loop has
    -90 deg at the bandwidth and droops by 3 dB at most: lead or lag and gain by brute force."""
    omega = np.unique(np.append(np.geomspace(0.3, 25.0, 600), DEMAND.bandwidth))
    at = int(np.searchsorted(omega, DEMAND.bandwidth))
    found = (np.inf, 0.0)
    for degrees in np.arange(-80.0, 80.1, 0.25):
        turn = 1j * np.tan(np.radians(abs(degrees))) * omega / DEMAND.bandwidth
        pilot = 1.0 + turn if degrees >= 0.0 else 1.0 / (1.0 + turn)
        loop = attitude(omega, frequency, delay) * pilot * np.exp(-1j * omega * DEMAND.delay)
        gains = np.geomspace(0.03, 1.0, 400) / np.abs(loop[at])
        closed = gains * loop[at] / (1.0 + gains * loop[at])
        phase = np.degrees(np.angle(closed))
        near = int(np.argmin(np.abs(phase + 90.0)))
        if abs(phase[near] + 90.0) > 1.0:
            continue
        size = 20.0 * np.log10(np.abs(gains[near] * loop / (1.0 + gains[near] * loop)))
        if np.min(size[: at + 1]) >= -3.0 and np.max(size) < found[0]:
            found = (float(np.max(size)), float(degrees))
    return found


@pytest.mark.parametrize(("frequency", "delay"), [(6.0, 0.05), (4.0, 0.1), (3.0, 0.0)])
def test_the_pilot_is_the_best_of_all(frequency: float, delay: float) -> None:
    found = neal_smith(curve(attitude(OMEGA, frequency, delay), 1e-4), DEMAND)
    assert isinstance(found, NealSmith)
    resonance, compensation = best_pilot(frequency, delay)
    assert found.resonance.value == pytest.approx(resonance, abs=0.3)
    assert found.compensation.value == pytest.approx(compensation, abs=1.0)
    assert found.droop == pytest.approx(-3.0, abs=0.1)
    assert found.level == resonance_level(resonance)


@pytest.mark.long
def test_deviations_hold_the_truth() -> None:
    exact = neal_smith(curve(attitude(OMEGA), 1e-5), DEMAND)
    assert isinstance(exact, NealSmith)
    rng, z = np.random.default_rng(1), []
    clean = curve(attitude(OMEGA), 0.02)
    roots = [
        np.linalg.cholesky(shared_covariance(clean, std, np.arange(OMEGA.size)) + 1e-9 * np.eye(90))
        for std in (clean.gain_std, clean.phase_std)
    ]
    for _ in range(25):
        drawn = AttitudeCurve(
            OMEGA,
            clean.gain + roots[0] @ rng.standard_normal(90),
            clean.phase + roots[1] @ rng.standard_normal(90),
            clean.gain_std,
            clean.phase_std,
            30.0,
        )
        found = neal_smith(drawn, DEMAND)
        assert isinstance(found, NealSmith)
        z.append((found.resonance.value - exact.resonance.value) / found.resonance.std)
        z.append((found.compensation.value - exact.compensation.value) / found.compensation.std)
    assert np.mean(np.abs(z) < 2.0) > 0.84


def test_a_band_that_ends_too_early_is_said() -> None:
    said = neal_smith(curve(attitude(OMEGA)), PilotDemand(24.0))
    assert isinstance(said, str) and "needs a usable band" in said


@pytest.mark.parametrize(
    ("bandwidth", "delay", "level"),
    [(7.0, 0.01, 1), (6.0, 0.01, 2), (7.0, 0.05, 2), (9.0, 0.05, 1), (9.0, 0.2, 3), (0.9, 0.0, 3)],
)
def test_levels_of_bandwidth_and_phase_delay(bandwidth: float, delay: float, level: int) -> None:
    assert pitch_bandwidth_level(bandwidth, delay) == level


def fitted(name: str, values: dict[str, float]) -> FittedResponse:
    form = FORMS.get(name) or form_of(name)
    top, bottom = form.polynomials(values)
    std = {key: 0.01 * abs(value) for key, value in values.items()}
    covariance = np.diag([each**2 for each in std.values()])
    return FittedResponse("q/stick", form, values, std, std, 1.0, top, bottom, covariance)


PITCH = {"gain": 6.0, "inv_T_theta2": 1.2, "frequency": 4.0, "damping": 0.6, "delay": 0.0}


def test_a_step_is_python_controls() -> None:
    one = fitted("pitch", PITCH)
    step = step_response(one, 5.0)
    assert step is not None
    system = control.tf(one.numerator, one.denominator)
    exact = control.step_response(system, step.time).outputs / control.dcgain(system)
    np.testing.assert_allclose(step.value, exact, atol=1e-3)
    over = pitch_overshoot(one)
    assert over is not None and over.value == pytest.approx(float(np.max(exact)), abs=1e-3)
    # By differences: a hundredth of each parameter, all independent.
    ends = []
    for name, value in PITCH.items():
        moved = pitch_overshoot(fitted("pitch", {**PITCH, name: 1.01 * value}))
        assert moved is not None
        ends.append(moved.value - over.value)
    assert over.std == pytest.approx(float(np.linalg.norm(ends)), rel=0.1)


def test_what_has_no_steady_value_has_no_step() -> None:
    assert step_response(fitted("0/1", {"b0": 1.0, "a0": -0.5, "delay": 0.0})) is None
    assert pitch_overshoot(fitted("0/1", {"b0": 1.0, "a0": 0.5, "delay": 0.0})) is None
