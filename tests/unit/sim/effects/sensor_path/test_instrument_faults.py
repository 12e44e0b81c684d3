"""An accelerometer off the centre of gravity, a gyro that feels load, a bent, stepped or held
channel: by hand, and with others.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from sim.declaration.compile import compile_model
from sim.declaration.model import Model
from sim.declaration.proposal import SearchContext
from sim.effects.disturbance.gusts import GustDiscrete
from sim.effects.dynamics.structural_mode import StructuralMode
from sim.effects.library import find_effect
from sim.effects.loads import at_arm
from sim.effects.sensor_path.sensor_calibration import SensorCurve, SensorScale, SensorStep
from sim.effects.sensor_path.sensor_mounting import AccelerometerOffset, SensorCoupling, VaneOffset
from sim.effects.sensor_path.sensor_timing import SensorHold
from sim.maths import COMPLEX_STEP
from tests.bases import (
    LEVEL,
    RIGID_VALUES,
    Flight,
    fly_model,
    loes_flight,
    loes_model,
    longitudinal_model,
    rigid_flight,
    rigid_model,
)
from tests.oracles.flexible_aircraft import parameters_in_si

G = 9.80665
ARM = {"accelerometer-offset:nz.arm": 4.0}


def added_by_arm(model: Model, flight: Flight) -> np.ndarray:
    """What four metres add to nz, times g0 over the arm: the pitch acceleration as the
    accelerometer has it.
    """
    before, after = (
        fly_model(model, flight),
        fly_model(model.with_effects(AccelerometerOffset()).with_values(ARM), flight),
    )
    np.testing.assert_array_equal(before[:2], after[:2])
    return (after[2] - before[2]) * G / 4.0


@pytest.mark.parametrize(
    ("model", "flight"),
    [(rigid_model(), rigid_flight()), (loes_model(), loes_flight())],
    ids=["rigid", "loes"],
)
def test_an_accelerometer_ahead_adds_the_slope_of_the_pitch_rate(
    model: Model, flight: Flight
) -> None:
    q_dot = added_by_arm(model, flight)
    q = fly_model(model, flight)[1]
    # Held inputs: q is smooth between samples at which the input does not switch.
    quiet = (
        np.flatnonzero((np.diff(flight.u[0])[:-1] == 0.0) & (np.diff(flight.u[0])[1:] == 0.0)) + 1
    )
    slope = (q[2:] - q[:-2]) / (flight.time[2:] - flight.time[:-2])
    steady = quiet[(quiet > 1) & (quiet < len(q) - 2)]
    assert np.max(np.abs(slope[steady - 1] - q_dot[steady])) < 0.08 * np.max(np.abs(q_dot))
    assert np.max(np.abs(q_dot)) > 0.05


def test_the_pitch_acceleration_is_that_of_the_moment_with_gusts_and_modes_in_it() -> None:
    v, flight = RIGID_VALUES, rigid_flight()
    alpha, q, _ = fly_model(rigid_model(), flight)
    factor = (
        0.5
        * v["air_density"]
        * v["airspeed"] ** 2
        * v["wing_area"]
        * v["chord"]
        / v["pitch_inertia"]
    )
    moment = (
        v["Cm_alpha"] * alpha
        + v["Cm_q"] * q * v["chord"] / (2 * v["airspeed"])
        + v["Cm_de"] * flight.u[0]
    )
    np.testing.assert_allclose(
        added_by_arm(rigid_model(), flight), factor * moment, rtol=0.0, atol=1e-13
    )
    gusty = rigid_model().with_effects(GustDiscrete())
    alpha, q, _ = fly_model(gusty, flight)  # the vane feels the gust as the loads do
    moment = (
        v["Cm_alpha"] * alpha
        + v["Cm_q"] * q * v["chord"] / (2 * v["airspeed"])
        + v["Cm_de"] * flight.u[0]
    )
    np.testing.assert_allclose(added_by_arm(gusty, flight), factor * moment, rtol=0.0, atol=1e-13)
    flexible = (
        rigid_model().with_effects(StructuralMode(1, (1,))).with_values(parameters_in_si(1, 1.0))
    )
    assert np.max(np.abs(added_by_arm(flexible, flight) - factor * moment)) > 0.02


def test_a_vane_at_an_arm_reads_the_turn_over_the_airspeed_at_the_time() -> None:
    """Of an aircraft that flies slower than its reference speed the same turn is a larger angle."""
    flight, arm = rigid_flight(), 3.0
    slow = longitudinal_model()
    slow = slow.with_initial(slow.initial.with_values({"airspeed": 45.0}))
    flying = Flight(
        flight.time,
        np.stack([LEVEL[1] + 0.3 * flight.u[0], np.full(len(flight.time), LEVEL[2])]),
        max_step=0.02,
    )
    effect = find_effect("vane-offset", slow.equations)
    ahead = slow.with_effects(effect).with_values({"vane-offset.arm": arm})
    speed, alpha, _, q, *_ = fly_model(slow, flying)
    read = fly_model(ahead, flying)[1]
    np.testing.assert_allclose(read - alpha, -arm * q / speed, rtol=0.0, atol=1e-12)
    assert np.max(np.abs(arm * q)) > 0.1 and np.max(np.abs(speed - 53.6)) > 3.0
    s, vehicle = SimpleNamespace(V=40.0, q=0.2), SimpleNamespace(airspeed=50.0)
    assert at_arm(s, vehicle, arm, "q", "airspeed") == pytest.approx(0.015)
    assert at_arm(SimpleNamespace(q=0.2), vehicle, arm, "q", "airspeed") == pytest.approx(0.012)


def test_an_accelerometer_at_an_arm_is_a_vane_at_minus_that_arm_with_other_derivatives() -> None:
    """The twin: the short period in alpha - (arm/V) q, whose lift has the moment's share of the
    elevator in it.
    """
    v, flight, arm = RIGID_VALUES, rigid_flight(), 6.0
    behind = (
        rigid_model()
        .with_effects(AccelerometerOffset())
        .with_values({"accelerometer-offset:nz.arm": -arm})
    )
    rate = v["chord"] / (2.0 * v["airspeed"])  # q_hat = rate q
    # lift coefficient that the reading shows for one of moment
    by_moment = arm * v["chord"] * v["mass"] / v["pitch_inertia"]
    # alpha = alpha' - slope q, alpha' = alpha + slope q: what a vane ahead takes off again
    slope = arm / v["airspeed"]
    CL_alpha, Cm_alpha = v["CL_alpha"] - by_moment * v["Cm_alpha"], v["Cm_alpha"]
    other = {
        "CL_alpha": CL_alpha,
        "Cm_alpha": Cm_alpha,
        "Cm_q": v["Cm_q"] - Cm_alpha * slope / rate,
        "CL_q": v["CL_q"] - by_moment * v["Cm_q"] - CL_alpha * slope / rate,
        "CL_de": v["CL_de"] - by_moment * v["Cm_de"],
    }
    ahead = rigid_model().with_effects(VaneOffset()).with_values({"vane-offset.arm": arm, **other})
    for one, two in zip(fly_model(behind, flight), fly_model(ahead, flight), strict=True):
        np.testing.assert_allclose(one, two, rtol=0.0, atol=2e-6 * np.max(np.abs(two)))
    # what a user who knows his tail can tell the two apart by
    assert other["CL_de"] > 3.0 * v["CL_de"]


def test_the_gyro_feels_the_true_load_factor_whatever_the_accelerometer_reads() -> None:
    flight = rigid_flight()
    _, q, nz = fly_model(rigid_model(), flight)
    effects = (SensorScale("q"), SensorScale("nz"), AccelerometerOffset(), SensorCoupling())
    values = {
        "sensor-scale:q.scale": 1.2,
        "sensor-scale:nz.scale": 0.8,
        "sensor-coupling:q.gain": 0.03,
    }
    for order in (effects, effects[::-1]):
        read = fly_model(rigid_model().with_effects(*order).with_values(values), flight)
        np.testing.assert_allclose(read[1], 1.2 * (q + 0.03 * nz), rtol=0.0, atol=1e-15)


def test_a_bent_reading_counts_from_trim_without_the_bias_and_rises_over_what_was_flown() -> None:
    model = rigid_model().with_biases(["nz"]).with_effects(SensorCurve("nz", "g", 0.1, -3.0, 3.0))
    nz = fly_model(rigid_model(), rigid_flight())[2]
    read = fly_model(
        model.with_values({"sensor-curve:nz.curvature": 0.2, "bias_nz": 1.0}), rigid_flight()
    )[2]
    np.testing.assert_allclose(read, nz + 0.2 * nz**2 + 1.0, rtol=0.0, atol=1e-15)
    context = SearchContext(0.0, 9.0, 0.02, flown={"nz": (0.5, 2.25)}, values={"bias_nz": 1.0})
    low, high = (
        SensorCurve("nz", "g", 0.1, -3.0, 3.0).fitted_to(context).traits.plausible["curvature"]
    )
    assert (low, high) == pytest.approx((-0.5 / 1.25, 0.5 / 0.5))
    for curvature, worst in ((low, 1.25), (high, -0.5)):
        assert 1.0 + 2.0 * curvature * worst == pytest.approx(0.0)


def test_a_reading_bent_to_both_sides_alike_and_its_freer_form() -> None:
    plain = SensorCurve("nz", "g", 0.1, -3.0, 3.0, bends=("cubic",))
    nz = fly_model(rigid_model(), rigid_flight())[2]
    read = fly_model(
        rigid_model().with_effects(plain).with_values({"sensor-curve:nz.cubic": 0.05}),
        rigid_flight(),
    )[2]
    np.testing.assert_allclose(read, nz + 0.05 * nz**3, rtol=0.0, atol=1e-15)
    values = {"sensor-curve:nz.cubic": 0.05, "sensor-curve:nz.curvature": -0.1}
    both = fly_model(rigid_model().with_effects(plain.finer()).with_values(values), rigid_flight())[
        2
    ]
    np.testing.assert_allclose(both, nz - 0.1 * nz**2 + 0.05 * nz**3, rtol=0.0, atol=1e-15)
    assert [item.unit for item in plain.finer().parameters] == ["1/g", "1/g2"]
    low, high = plain.fitted_to(
        SearchContext(0.0, 9.0, 0.02, flown={"nz": (-0.5, 1.25)})
    ).traits.plausible["cubic"]
    assert 1.0 + 3.0 * low * 1.25**2 == pytest.approx(0.0)
    assert high * 1.25**2 == pytest.approx(1.0)


def test_a_bent_reading_of_a_total_counts_from_the_middle_of_what_was_flown() -> None:
    """About zero the square of an airspeed of 45 to 53 m/s would be next to a scale of it."""
    context = SearchContext(0.0, 9.0, 0.02, flown={"airspeed": (45.0, 53.0)})
    fitted = SensorCurve("airspeed", "m/s", 0.01, -20.0, 20.0).fitted_to(context)
    assert (fitted.low, fitted.high, fitted.middle) == (-4.0, 4.0, 49.0)
    y = {"airspeed": np.array([45.0, 49.0, 52.0])}
    read = fitted.read(None, y, None, SimpleNamespace(curvature=0.05))["airspeed"]
    np.testing.assert_allclose(read, [45.0 + 0.05 * 16.0, 49.0, 52.0 + 0.05 * 9.0], rtol=1e-15)


def test_a_zero_that_jumps_stays_there() -> None:
    step = SensorStep("q", "rad/s", 0.01).fitted_to(SearchContext(0.0, 6.0, 0.02))
    flight = rigid_flight()
    q = fly_model(rigid_model(), flight)[1]
    read = fly_model(
        rigid_model()
        .with_effects(step)
        .with_values({"sensor-step:q.at": 2.51, "sensor-step:q.size": 0.05}),
        flight,
    )[1]
    np.testing.assert_allclose(read - q, 0.05 * (flight.time > 2.51), rtol=0.0, atol=1e-12)
    # Between two samples the edge reaches one of them, which is how a fit feels where it lies.
    s = SimpleNamespace(time=flight.time)
    slope = step.read(
        s,
        {"q": np.zeros(flight.time.size)},
        None,
        SimpleNamespace(at=2.515 + COMPLEX_STEP * 1j, size=0.05),
    )["q"].imag
    assert np.count_nonzero(slope) == 1


HOLD = SensorHold("q", interval=0.02)


def held(period: object, phase: object, values: np.ndarray, step: float = 0.02) -> np.ndarray:
    """A channel that jumps nowhere, as the hold shows it at the edges of sub-steps of one
    sample.
    """
    begin = np.asarray(values)
    return HOLD.act(
        np.full(len(begin) - 1, step), begin, begin[1:], SimpleNamespace(period=period, phase=phase)
    )[0]


@pytest.mark.parametrize(("every", "first"), [(2, 0), (3, 2), (5, 1)])
def test_a_channel_in_step_with_the_recorder_repeats_whole_samples(every: int, first: int) -> None:
    y = np.random.default_rng(1).standard_normal(60)
    k = np.arange(60)
    expected = y[np.where(k < first, 0, k - (k - first) % every)]
    for off in (-2e-7, 0.0, 2e-7):  # rounding of the times moves no sample to another update
        np.testing.assert_allclose(
            held(every * 0.02 + off / 60, first * 0.02 + off, y), expected, rtol=0.0, atol=2e-3
        )
    np.testing.assert_allclose(held(every * 0.02, first * 0.02, y), expected, rtol=0.0, atol=1e-9)


def test_a_held_ramp_is_late_by_half_a_period_in_the_mean_and_its_slope_is_that_of_the_update() -> (
    None
):
    ramp = 0.02 * np.arange(400)
    late = ramp - held(0.1, 0.0, ramp)
    # 0 to 4 of 5 samples
    assert np.mean(late[:-1].reshape(-1, 399)[:, 4:399]) == pytest.approx(0.04, abs=5e-4)
    slope = held(0.1 + COMPLEX_STEP * 1j, 0.0, ramp).imag / COMPLEX_STEP
    np.testing.assert_allclose(slope, np.arange(400) // 5, atol=1e-9)


def test_hold_comes_behind_the_lag_of_the_same_sensor() -> None:
    assert compile_model(rigid_model().with_effects(HOLD, SensorScale("q"))).sensor_stages == (
        "sensor-hold:q",
    )
    assert HOLD.path_order > 20
