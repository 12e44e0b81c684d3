"""The sampled loop with limits: equal to the linear loop for small sticks, and to a brute-force
march for large ones.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim.closed_loop.airframe import X29, load_x29
from sim.closed_loop.linear import RESPONSE_NAMES, respond
from sim.closed_loop.nonlinear import (
    ClosedLoopTruth,
    FlightOutcome,
    SmoothStick,
    SteppedStick,
    doublet,
    fly_closed_loop,
    three_two_one_one,
)
from sim.errors import ModelError
from tests.oracles.x29_march import march


def without_break_out(name: str) -> X29:
    x29 = load_x29(name)
    return replace(x29, stick=replace(x29.stick, dead_band=0.0))


def with_rates(x29: X29, rate: float) -> X29:
    canard, flaperon, strake = (replace(surface, rate=rate) for surface in x29.surfaces)
    return replace(x29, surfaces=(canard, flaperon, strake))


def histories(truth: ClosedLoopTruth) -> dict[str, np.ndarray]:
    values = (truth.alpha, truth.q, truth.nz - 1.0, *truth.surfaces, truth.command)
    return dict(zip(RESPONSE_NAMES, values, strict=True))


@pytest.mark.parametrize("name", ["P", "S", "F"])
def test_small_stick_gives_the_linear_response(name: str) -> None:
    x29 = without_break_out(name)
    _, truth = fly_closed_loop(x29, three_two_one_one(1e-6), 20.0)
    _, expected = respond(x29, truth.stick)
    # The gearing's curvature alone accounts for 5e-8.
    for found, wanted in zip(histories(truth).values(), expected, strict=True):
        assert np.max(np.abs(found - wanted)) <= 1e-7 * np.max(np.abs(wanted))


@pytest.mark.parametrize("name", ["P", "F"])
def test_unlimited_flight_equals_the_march(name: str) -> None:
    x29 = load_x29(name)
    _, truth = fly_closed_loop(x29, three_two_one_one(unit=0.2, start=0.1), 2.0)
    assert not (truth.rate_limited.any() or truth.command_limited.any() or truth.stopped.any())
    expected = march(x29, truth.stick, steps_per_frame=25)
    for signal, found in histories(truth).items():
        assert np.max(np.abs(found - expected[signal])) <= 1e-7 * np.max(
            np.abs(expected[signal])
        ), signal


def test_limited_flight_equals_the_march() -> None:
    # Rates and travels so small that commands are cut and all rams run at their limits, yet the
    # aircraft stays in the air.
    x29 = with_rates(load_x29("P"), 20.0)
    canard, flaperon, strake = x29.surfaces
    x29 = replace(
        x29,
        surfaces=(
            replace(canard, rate=60.0),
            replace(flaperon, rate=8.0),
            replace(strake, lower=-4.0, upper=5.0),
        ),
    )
    _, truth = fly_closed_loop(x29, three_two_one_one(2.5, unit=0.2, start=0.1), 2.0, pieces=32)
    assert truth.outcome is FlightOutcome.COMPLETED
    assert truth.command_limited[2].any() and truth.rate_limited.any(axis=1).all()
    expected = march(x29, truth.stick, steps_per_frame=125)
    for signal, found in histories(truth).items():
        assert np.max(np.abs(found - expected[signal])) <= 2e-6 * np.max(
            np.abs(expected[signal])
        ), signal


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("name", "amplitude", "rates"),
    [("P", 3.0, None), ("P", 2.0, 30.0), ("P", 5.0, None), ("S", 5.0, None), ("F", 5.0, 10.0)],
)
def test_switching_is_exact_whatever_the_pieces(
    name: str, amplitude: float, rates: float | None
) -> None:
    x29 = load_x29(name) if rates is None else with_rates(load_x29(name), rates)
    coarse, default, fine = (
        fly_closed_loop(x29, three_two_one_one(amplitude), 7.0, pieces=pieces)[1]
        for pieces in (1, 8, 64)
    )
    assert fine.rate_limited.sum() > 10
    for other in (coarse, default):
        assert np.max(np.abs(other.alpha - fine.alpha)) < 1e-9
        assert np.max(np.abs(other.surfaces - fine.surfaces)) < 1e-7


def test_a_ram_at_its_rate_limit_moves_at_exactly_that_rate() -> None:
    x29 = load_x29("P")
    _, truth = fly_closed_loop(x29, three_two_one_one(3.0), 8.0)
    whole = (
        truth.rate_limited[2, :-1]
        & np.roll(truth.rate_limited[2], 1)[:-1]
        & np.roll(truth.rate_limited[2], -1)[:-1]
    )
    step = np.abs(np.diff(truth.surfaces[2]))
    assert whole.sum() > 10
    assert np.max(step) <= 30.0 * x29.frame * (1.0 + 1e-9)
    assert np.median(step[whole]) == pytest.approx(30.0 * x29.frame, rel=1e-9)


def test_surfaces_stay_within_their_travel_and_the_departure_is_told() -> None:
    x29 = load_x29("P")
    record, truth = fly_closed_loop(x29, three_two_one_one(5.0), 20.0, np.random.default_rng(0))
    assert truth.outcome is FlightOutcome.DEPARTED
    assert truth.command_limited.any(axis=1).all()
    assert abs(truth.alpha[-1]) > 1.0 and np.max(np.abs(truth.alpha[:-1])) <= 1.0
    assert record.time[-1] <= truth.time[-1] < 20.0
    for surface, deflection in zip(x29.surfaces, truth.surfaces, strict=True):
        assert np.min(deflection) >= surface.lower - surface.trim - 1e-9
        assert np.max(deflection) <= surface.upper - surface.trim + 1e-9


def test_stick_within_the_break_out_does_nothing() -> None:
    _, truth = fly_closed_loop(load_x29("S"), doublet(0.05), 4.0)
    assert not np.any(truth.reference) and not np.any(truth.alpha) and np.all(truth.nz == 1.0)
    _, moved = fly_closed_loop(load_x29("S"), doublet(0.06), 4.0)
    # 0.01 in beyond the break-out, with hardly any curvature.
    assert np.max(moved.reference) == pytest.approx(1.4 * 0.01 * (1.0 + 0.05 * 0.01), rel=1e-6)


def test_response_is_odd_while_no_limit_is_met() -> None:
    _, up = fly_closed_loop(load_x29("S"), three_two_one_one(), 6.0)
    _, down = fly_closed_loop(load_x29("S"), three_two_one_one(-1.0), 6.0)
    np.testing.assert_allclose(down.alpha, -up.alpha, atol=1e-15)


def test_record_holds_vane_total_load_factor_and_stick_at_40_hz() -> None:
    x29 = load_x29("S")
    record, truth = fly_closed_loop(x29, three_two_one_one(), 20.0)
    assert len(record) == 801 and record.time[1] == 0.025 and record.time[-1] == 20.0
    assert [(c.name, c.unit) for c in record.channels] == [
        ("stick", "in"),
        ("alpha", "rad"),
        ("q", "rad/s"),
        ("nz", "g"),
    ]
    vane = truth.alpha - 24.0 / 969.6 * truth.q
    np.testing.assert_allclose(record["alpha"].values, vane[::2], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(record["q"].values, truth.q[::2])
    # The product with three rows of C and that with all of them add up in an order of the
    # processor's own.
    np.testing.assert_allclose(record["nz"].values, truth.nz[::2], rtol=1e-13)
    np.testing.assert_array_equal(record["stick"].values, three_two_one_one()(record.time))
    np.testing.assert_allclose(truth.recorded, record.output_array()[0])


def test_kinematics_of_the_recorded_load_factor() -> None:
    # nz - 1 = (V/g)(q - alpha_dot), with alpha_dot by central difference over two frames.
    x29 = load_x29("S")
    smooth = SmoothStick((0.5, 2.0), (1.0, -1.0), 5.0)
    _, truth = fly_closed_loop(x29, smooth, 6.0)
    alpha_dot = (truth.alpha[2:] - truth.alpha[:-2]) / (2.0 * x29.frame)
    kinematic = x29.airframe.airspeed / x29.airframe.gravity * (truth.q[1:-1] - alpha_dot)
    np.testing.assert_allclose(
        truth.nz[1:-1] - 1.0, kinematic, atol=2e-3 * np.max(np.abs(truth.nz - 1.0))
    )


def test_skewed_record_takes_its_outputs_before_the_stick() -> None:
    stick = three_two_one_one()
    flown = load_x29("F")
    late, truth = fly_closed_loop(flown, stick, 8.0)
    assert flown.stick.recorded_skew == 0.005
    plain, same = fly_closed_loop(
        replace(flown, stick=replace(flown.stick, recorded_skew=0.0)), stick, 8.0
    )
    np.testing.assert_allclose(truth.q, same.q, atol=1e-14)
    np.testing.assert_array_equal(late["stick"].values, plain["stick"].values)
    whole = fly_closed_loop(
        replace(flown, stick=replace(flown.stick, recorded_skew=2 * flown.frame)), stick, 8.0
    )[0]
    np.testing.assert_allclose(whole["q"].values[1:], plain["q"].values[:-1], atol=1e-14)
    assert whole["q"].values[0] == 0.0 and whole["nz"].values[0] == 1.0
    # RecordScatter frames the truth is not kept: linear interpolation is off by an eighth of the
    # second difference at most.
    between = np.interp(late.time - 0.005, truth.time, truth.q)
    curvature = np.max(np.abs(np.diff(truth.q, 2))) / 8.0
    assert np.max(np.abs(late["q"].values - between)) <= 1.05 * curvature
    assert np.max(np.abs(late["q"].values - plain["q"].values)) > 20.0 * curvature


def test_noise_has_the_declared_levels_and_comes_from_the_generator() -> None:
    x29 = load_x29("S")
    record, truth = fly_closed_loop(x29, three_two_one_one(), 20.0, np.random.default_rng(7))
    again, _ = fly_closed_loop(x29, three_two_one_one(), 20.0, np.random.default_rng(7))
    noise = record.output_array()[0] - truth.recorded
    # 801 samples: the standard deviation is known to 2.5 %, and five sigmas are allowed.
    np.testing.assert_allclose(noise.std(axis=1), [0.001, 0.002, 0.02], rtol=0.125)
    np.testing.assert_array_equal(record.output_array()[0], again.output_array()[0])
    np.testing.assert_array_equal(record["stick"].values, truth.stick[::2])


def test_stick_as_function_and_as_array_are_the_same() -> None:
    x29 = load_x29("S")
    _, one = fly_closed_loop(x29, doublet(), 3.0)
    _, other = fly_closed_loop(x29, doublet()(np.arange(241) / 80.0), 3.0)
    np.testing.assert_array_equal(one.alpha, other.alpha)


@pytest.mark.parametrize(
    ("change", "stick", "duration", "message"),
    [
        ({}, doublet(), 0.001, "duration of 0.001 s"),
        ({}, doublet(), float("nan"), "duration of nan s"),
        ({}, np.zeros(10), 1.0, "10 stick values for 81 frames"),
        ({}, np.full(81, np.nan), 1.0, "not finite"),
        ({"rate": 30.0}, doublet(), 1.0, "does not fall on frames"),
        ({"recorded_skew": -0.001}, doublet(), 1.0, "recorded_skew -0.001 s"),
    ],
)
def test_what_cannot_be_flown_is_refused(
    change: dict[str, float], stick: SteppedStick | np.ndarray, duration: float, message: str
) -> None:
    x29 = load_x29("S")
    if "rate" in change:
        x29 = replace(x29, telemetry=replace(x29.telemetry, **change))
    elif change:
        x29 = replace(x29, stick=replace(x29.stick, recorded_skew=change["recorded_skew"]))
    with pytest.raises(ModelError, match=message):
        fly_closed_loop(x29, stick, duration)
    with pytest.raises(ModelError, match="0 pieces"):
        fly_closed_loop(load_x29("S"), doublet(), 1.0, pieces=0)
