"""Flying qualities of fitted forms against their definitions on simulated steps."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import signal

from ident.flying_qualities.fitted_forms import form_levels, form_qualities
from ident.frequency_response.transfer_function import (
    FORMS,
    FittedResponse,
    ResponseTarget,
    fit_transfer_functions,
    neighbour_correlation,
    unnoticeable_envelopes,
)
from sim.maths import G0

OMEGA = np.geomspace(0.3, 20.0, 80)
PITCH = {"gain": 6.0, "inv_T_theta2": 1.2, "frequency": 4.0, "damping": 0.5, "delay": 0.08}
ROLL = {"gain": 20.0, "inv_T_roll": 2.5, "delay": 0.05}
DUTCH = {"gain": 1.0, "frequency": 2.0, "damping": 0.1, "delay": 0.0}
AIRSPEED = 90.0


def fitted(
    form: str, values: dict[str, float], noise: np.ndarray | float = 0.0, share: float = 0.01
) -> FittedResponse:
    response = FORMS[form].response(values, OMEGA) * (1.0 + noise)
    one = np.ones(OMEGA.size)
    target = ResponseTarget("y/u", OMEGA, response, 0.99 * one, share * np.abs(response), 5.0)
    return fit_transfer_functions([target], [FORMS[form]]).functions[0]


@pytest.mark.long
def test_cap_is_the_first_pitch_acceleration_over_the_steady_load_factor() -> None:
    found = {each.name: each for each in form_qualities(fitted("pitch", PITCH), AIRSPEED)}
    top, bottom = FORMS["pitch"].polynomials(PITCH)
    time = np.linspace(0.0, 20.0, 200001)
    _, rate = signal.step((top, bottom), T=time)
    acceleration = (rate[1] - rate[0]) / (time[1] - time[0])
    steady = AIRSPEED / G0 * rate[-1]  # of a steady turn in the vertical plane
    assert found["control_anticipation"].value == pytest.approx(acceleration / steady, rel=2e-3)
    # The angle of attack of a pitch rate q/alpha = s + 1/T_theta2, with the stick held.
    assert found["load_factor_slope"].value == pytest.approx(
        AIRSPEED * PITCH["inv_T_theta2"] / G0, rel=1e-3
    )
    assert found["total_delay"].value == pytest.approx(0.08, abs=1e-3) and found[
        "natural_frequency"
    ].value == pytest.approx(4.0, rel=1e-3)
    assert "control_anticipation" not in {
        each.name for each in form_qualities(fitted("pitch", PITCH))
    }


@pytest.mark.long
def test_deviations_are_the_scatter() -> None:
    rng = np.random.default_rng(2)
    apart = np.subtract.outer(OMEGA, OMEGA) / (2.0 * math.pi) * 5.0
    root = np.linalg.cholesky(neighbour_correlation(apart) + 1e-9 * np.eye(OMEGA.size))
    values, stds = [], []
    for _ in range(120):
        noise = 0.02 * root @ (rng.standard_normal((OMEGA.size, 2)) @ np.array([1.0, 1.0j]))
        found = form_qualities(fitted("pitch", PITCH, noise, 0.02), AIRSPEED)
        values.append([each.value for each in found])
        stds.append([each.std for each in found])
    ratio = np.median(stds, axis=0) / np.std(values, axis=0)
    np.testing.assert_allclose(ratio, 1.0, atol=0.25)


def test_a_roll_and_a_dutch_roll() -> None:
    roll = {each.name: each.value for each in form_qualities(fitted("roll", ROLL))}
    assert roll["roll_time_constant"] == pytest.approx(0.4, rel=1e-3)
    dutch = {each.name: each.value for each in form_qualities(fitted("dutch-roll", DUTCH))}
    assert dutch["dutch_roll_damping_rate"] == pytest.approx(0.2, rel=1e-3)
    assert form_qualities(fitted("dutch-roll", DUTCH), dutch_roll=False) == ()


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("changes", "flown", "quantity", "level"),
    [
        ({}, ("IV", "A"), "damping_ratio", 1),
        ({"damping": 0.3}, ("IV", "A"), "damping_ratio", 2),
        ({"damping": 0.18}, ("IV", "A"), "damping_ratio", 3),
        ({"delay": 0.15}, ("IV", "A"), "total_delay", 2),
        ({"frequency": 1.2}, ("IV", "A"), "control_anticipation", 3),
        ({}, ("IV", "A"), "control_anticipation", 1),
    ],
)
def test_levels(
    changes: dict[str, float], flown: tuple[str, str], quantity: str, level: int
) -> None:
    found = form_levels(
        form_qualities(fitted("pitch", PITCH | changes, share=1e-4), AIRSPEED), *flown
    )
    (one,) = [each for each in found if each.quality.name == quantity]
    if quantity == "control_anticipation":
        cap = (PITCH | changes)["frequency"] ** 2 * G0 / AIRSPEED / PITCH["inv_T_theta2"]
        limits = one.criterion.levels
        level = next((n for n, (low, high) in enumerate(limits, 1) if low <= cap <= high), 4)
    assert one.level == level and not one.uncertain


def test_a_limit_within_two_sigmas_is_said() -> None:
    found = form_levels(
        form_qualities(fitted("pitch", PITCH | {"damping": 0.35}, share=0.05), AIRSPEED), "IV", "A"
    )
    (one,) = [each for each in found if each.quality.name == "damping_ratio"]
    assert one.uncertain and (one.best, one.worst) == (1, 2)


def test_envelopes_are_those_of_a_second_copy() -> None:
    """The polynomials as NASA Dryden's routine LoesBound (C. Regan, 2006) has them, with its
    digits.
    """
    s = 1j * np.geomspace(0.1, 10.0, 30)
    copies = {
        "low_gain": ([0.095, 9.92, 2.15], [1.0, 11.6, 4.95]),
        "high_gain": ([3.16, 31.61, 22.79], [1.0, 27.14, 1.84]),
        "low_phase": ([475.32, 184100.0, 29460.0], [1.0, 11.66, 0.039]),
        "high_phase": ([68.89, 1100.12, -275.22], [1.0, 39.94, 9.99]),
    }
    ours = unnoticeable_envelopes(np.abs(s))
    for name, (top, bottom) in copies.items():
        value = np.polyval(top, s) / np.polyval(bottom, s)
        expected = 20.0 * np.log10(np.abs(value)) if "gain" in name else np.degrees(np.angle(value))
        np.testing.assert_allclose(getattr(ours, name), expected, atol=0.1)
    assert math.isclose(float(ours.high_gain[0]), 16.9, abs_tol=0.1)
