"""The closed loop's limits, skews and figures written a second way, where one aircraft or one sign
alone does not show an error.
"""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest

from sim.closed_loop import linear
from sim.closed_loop.airframe import load_x29
from sim.closed_loop.equations import ALL_FREE, RamMode, advance, mixing, plant, prepare
from sim.closed_loop.linear import FITTED_NAMES, equivalent_response, fit_equivalent
from sim.closed_loop.nonlinear import (
    FlightOutcome,
    fly_closed_loop,
    manual_stick,
    three_two_one_one,
)

OMEGA = np.geomspace(0.35, 14.0, 40)


def test_a_departure_is_told_nose_up_and_nose_down() -> None:
    ends = []
    for sign in (1.0, -1.0):
        _, truth = fly_closed_loop(load_x29("P"), three_two_one_one(5.0 * sign), 20.0)
        assert truth.outcome is FlightOutcome.DEPARTED
        assert np.max(np.abs(truth.alpha[:-1])) <= 1.0
        ends.append(truth.alpha[-1])
    assert min(ends) < -1.0 < 1.0 < max(ends)


@pytest.mark.parametrize("amplitude", [3.0, -3.0])
def test_commands_are_cut_where_they_leave_the_travel(amplitude: float) -> None:
    x29 = load_x29("P")
    canard, flaperon, strake = x29.surfaces
    x29 = replace(
        x29,
        surfaces=(
            canard,
            replace(flaperon, lower=3.5, upper=6.0),
            replace(strake, lower=-4.0, upper=5.0),
        ),
    )
    _, truth = fly_closed_loop(x29, three_two_one_one(amplitude, unit=0.2, start=0.1), 2.0)
    absolute = mixing(x29)[:, None] * truth.command + np.array(
        [[surface.trim] for surface in x29.surfaces]
    )
    above = absolute > np.array([[surface.upper] for surface in x29.surfaces])
    below = absolute < np.array([[surface.lower] for surface in x29.surfaces])
    assert above[1].any() and below[1].any() and above[2].any() and below[2].any()
    np.testing.assert_array_equal(truth.command_limited, above | below)


def test_a_skew_of_frames_and_a_part_is_the_part_some_frames_later() -> None:
    x29 = load_x29("F")
    every_frame = replace(x29, telemetry=replace(x29.telemetry, rate=x29.law.frame_rate))

    def skewed(frames: float) -> np.ndarray:
        flown = replace(every_frame, stick=replace(x29.stick, recorded_skew=frames * x29.frame))
        return fly_closed_loop(flown, three_two_one_one(), 8.0)[1].recorded

    part, more = skewed(0.375), skewed(2.375)
    np.testing.assert_allclose(more[:, 2:], part[:, :-2], rtol=0.0, atol=1e-12)
    assert np.max(np.abs(more[:, 1:] - part[:, :-1])) > 1e-3


@pytest.mark.parametrize(
    ("end", "mode"), [(19.75, RamMode.STOP_UPPER), (-15.0, RamMode.STOP_LOWER)]
)
def test_a_ram_on_its_stop_that_is_driven_beyond_stays_there_from_the_first_instant(
    end: float, mode: RamMode
) -> None:
    x29 = load_x29("S")
    stepper = prepare(x29, plant(x29), x29.frame, 8)
    flaperon_servo, flaperon = stepper.rams[1] - 2, stepper.rams[1]
    state = np.zeros(stepper.free.shape[0])
    state[flaperon], state[-1] = end, 1.0
    # So far beyond that a free ram would run at its rate limit of 68 deg/s.
    state[flaperon_servo] = end + 10.0 * np.sign(end)
    state[-3] = state[flaperon_servo]
    moved, _, seen = advance(stepper, state, ALL_FREE)
    assert {active[1] for active in seen} == {mode} and moved[flaperon] == end


@pytest.mark.parametrize(
    ("end", "mode"), [(19.75, RamMode.STOP_UPPER), (-15.0, RamMode.STOP_LOWER)]
)
def test_a_ram_leaves_its_stop_as_soon_as_it_is_driven_back(end: float, mode: RamMode) -> None:
    x29 = load_x29("S")
    stepper = prepare(x29, plant(x29), x29.frame, 8)
    flaperon_servo, flaperon = stepper.rams[1] - 2, stepper.rams[1]
    state = np.zeros(stepper.free.shape[0])
    state[flaperon], state[-1] = end, 1.0
    # A servo at rest 0.02 deg within the travel asks for 0.4 deg/s.
    back = -0.02 * np.sign(end)
    state[flaperon_servo] = state[-3] = end + back
    moved, modes, _ = advance(stepper, state, (RamMode.FREE, mode, RamMode.FREE))
    assert modes == ALL_FREE
    assert moved[flaperon] - end == pytest.approx(
        back * (1.0 - np.exp(-20.2 * x29.frame)), rel=1e-9
    )


def synthetic(
    monkeypatch: pytest.MonkeyPatch, zeros: list[complex], poles: list[complex], unit_gain_at: float
) -> linear.Margins:
    """Margins that the library's function finds for a loop with these zeros and poles, of gain one
    at a frequency (rad/s).
    """
    shape = control.zpk(zeros, poles, 1.0)
    loop = control.ss(shape / abs(complex(shape(1j * unit_gain_at)))).sample(0.0125, "zoh")
    monkeypatch.setattr(linear, "open_loop", lambda x29: loop)
    x29 = load_x29("S")
    found = linear.margins(x29)
    # Second writing: crossings in a fine sweep of the same loop.
    omega = np.geomspace(0.06, 250.0, 40_001)
    resolvents = np.exp(1j * omega * x29.frame)[:, None, None] * np.eye(loop.nstates) - loop.A
    response = (
        loop.C @ np.linalg.solve(resolvents, np.broadcast_to(loop.B, (omega.size, *loop.B.shape)))
        + loop.D
    )[:, 0, 0]
    turned = np.nonzero((np.diff(np.sign(response.imag)) != 0) & (response.real[:-1] < 0.0))[0]
    gains = -20.0 * np.log10(np.abs(response[turned]))
    crossed = np.nonzero(np.diff(np.sign(np.abs(response) - 1.0)) != 0)[0]
    phases = np.degrees(np.angle(-response[crossed]))
    assert gains.size > 2 or phases.size > 2, (gains, phases)
    if gains.size:
        assert found.gain_decrease == pytest.approx(
            max(gains[gains < 0.0], default=-np.inf), abs=0.01
        )
        assert found.gain_increase == pytest.approx(
            min(gains[gains > 0.0], default=np.inf), abs=0.01
        )
    assert found.phase == pytest.approx(phases[np.argmin(np.abs(phases))], abs=0.1)
    assert found.crossover == pytest.approx(omega[crossed[np.argmin(np.abs(phases))]], rel=1e-3)
    return found


def test_of_several_gain_margins_the_nearest_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    # The phase passes -180 deg three times where the gain is above one, and once below.
    found = synthetic(
        monkeypatch, [-0.1, -0.1, -8.0, -8.0], [0.0, 0.0, 0.0, -1.0, -1.0, -150.0, -150.0], 30.0
    )
    assert -40.0 < found.gain_decrease < 0.0 < found.gain_increase


def test_of_several_phase_margins_the_smallest_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    # A resonance lifts the gain above one a second time.
    synthetic(monkeypatch, [], [0.0, -0.5 + 20.0j, -0.5 - 20.0j], 4.0)


def test_mismatch_is_the_mean_square_in_decibel_and_weighted_degrees() -> None:
    truth = dict(zip(FITTED_NAMES, (-1.9, -12.0, -3.0, 0.32, 1e-3, 10.0, 0.12), strict=True))
    rng = np.random.default_rng(3)
    disturbed = equivalent_response(truth, OMEGA, 295.0, 9.8, 1.01) * np.exp(
        0.1 * rng.standard_normal((3, 40)) + 0.1j * rng.standard_normal((3, 40))
    )
    found = fit_equivalent(OMEGA, disturbed, 295.0, 9.8)
    ratio = (
        equivalent_response(
            {name: getattr(found, name) for name in FITTED_NAMES}, OMEGA, 295.0, 9.8, 1.01
        )
        / disturbed
    )
    decibel, degrees = 20.0 * np.log10(np.abs(ratio)), np.degrees(np.angle(ratio))
    assert found.mismatch == pytest.approx(np.mean(decibel**2 + 0.01745 * degrees**2), rel=1e-9)
    assert found.mismatch > 0.1


def test_a_system_without_short_period_has_neither_frequency_nor_damping() -> None:
    # M_alpha above L_alpha M_q / L_q: one real root is unstable and w^2 is negative.
    truth = dict(zip(FITTED_NAMES, (-2.0, 8.0, -3.0, 0.3, 0.0, 12.0, 0.1), strict=True))
    found = fit_equivalent(OMEGA, equivalent_response(truth, OMEGA, 295.0, 9.8, 1.01), 295.0, 9.8)
    assert found.L_alpha * found.M_q - found.L_q * found.M_alpha < 0.0
    assert (found.natural_frequency, found.damping_ratio) == (0.0, 0.0)


def test_levels_of_a_hand_flown_stick_keep_to_their_bands_on_both_sides() -> None:
    levels = np.array(
        [
            level
            for seed in range(200)
            for level in manual_stick(np.random.default_rng(seed), 30.0).levels[:-1]
        ]
    )
    resting, held = levels[np.abs(levels) <= 0.1], levels[np.abs(levels) > 0.1]
    # Even in -0.1 to 0.1 and, but for the sign, in 0.3 to 1: means within four standard errors,
    # edges met to a hundredth.
    assert abs(np.mean(resting)) < 4.0 * 0.2 / np.sqrt(12.0 * resting.size)
    assert resting.min() == pytest.approx(-0.1, abs=0.01) and resting.max() == pytest.approx(
        0.1, abs=0.01
    )
    for side in (held[held > 0.0], -held[held < 0.0]):
        assert side.min() == pytest.approx(0.3, abs=0.01) and side.max() == pytest.approx(
            1.0, abs=0.01
        )
        assert side.min() >= 0.3 and side.max() <= 1.0
    share = resting.size / levels.size
    assert share == pytest.approx(0.25, abs=4.0 * np.sqrt(0.25 * 0.75 / levels.size))
