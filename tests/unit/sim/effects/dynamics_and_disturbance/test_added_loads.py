"""Effects that add loads, against both aircraft written a second time and integrated to the last
digits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from sim.declaration.effect import Effect
from sim.declaration.proposal import SearchContext
from sim.effects.disturbance.airspeed import SpeedVariation
from sim.effects.disturbance.gusts import GustDiscrete
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.dynamics.control_nonlinearity import (
    UNEVENNESS_VARIANTS,
    ControlNonlinearity,
    ControlUnevenness,
    ControlWeakening,
)
from sim.effects.dynamics.derivative_jump import DerivativeJump
from sim.effects.dynamics.elastic_mode import ElasticMode
from sim.effects.dynamics.load_nonlinearity import LIFT_NONLINEARITY, MOMENT_NONLINEARITY
from sim.effects.library import catch_all_terms_for, find_effect
from sim.maths import combine, natural_shapes
from sim.vehicles.uncoupled import Loes, ShortPeriod
from tests.bases import (
    LOES_CONSTANTS,
    LOES_VALUES,
    RIGID_VALUES,
    Flight,
    fly_model,
    loes_flight,
    loes_model,
    rigid_flight,
    rigid_model,
)
from tests.oracles.short_period_extras import fly_loes, fly_rigid

RIGID, LOES = (
    replace(rigid_flight(4.0), max_step=0.0025),
    replace(loes_flight(4.0), max_step=0.0025),
)


def rigid(effect: Effect, values: Mapping[str, float], flight: Flight = RIGID) -> np.ndarray:
    given = {f"{effect.name}.{local}": value for local, value in values.items()}
    return np.array(fly_model(rigid_model().with_effects(effect).with_values(given), flight))


def loes(effect: Effect, values: Mapping[str, float], flight: Flight = LOES) -> np.ndarray:
    given = {f"{effect.name}.{local}": value for local, value in values.items()}
    return np.array(fly_model(loes_model().with_effects(effect).with_values(given), flight))


def close(got: np.ndarray, expected: np.ndarray, share: float = 1e-6) -> None:
    for row, wanted in zip(got, expected, strict=True):
        np.testing.assert_allclose(row, wanted, rtol=0.0, atol=share * np.max(np.abs(wanted)))


def curve(low: float, high: float, sizes: list[float]) -> CubicSpline:
    """The same curve from its ordinates, by SciPy; its straight continuation is left to the range
    being wide enough.
    """
    knots = np.linspace(low, high, 11 if len(sizes) > 5 else 6)
    return CubicSpline(
        knots, combine(natural_shapes(low, high, len(sizes) > 5), knots, sizes), bc_type="natural"
    )


@pytest.mark.long
@pytest.mark.parametrize(
    "sizes",
    [[0.02, -0.01, 0.004, 0.003], [0.02, -0.01, 0.004, 0.003, 0.003, -0.002, 0.002, 0.001, -0.001]],
)
def test_nonlinear_moment_and_lift(sizes: list[float]) -> None:
    given = {f"shape{i + 1}": size for i, size in enumerate(sizes)}
    f = curve(-0.3, 0.25, sizes)
    fine = len(sizes) > 4
    expected, _ = fly_rigid(RIGID.time, RIGID.u[0], lambda t, a, q, u, z: (0.0, float(f(a)), ()))
    close(rigid(replace(MOMENT_NONLINEARITY, low=-0.3, high=0.25, fine=fine), given), expected)
    expected, _ = fly_rigid(RIGID.time, RIGID.u[0], lambda t, a, q, u, z: (float(f(a)), 0.0, ()))
    close(rigid(replace(LIFT_NONLINEARITY, low=-0.3, high=0.25, fine=fine), given), expected)
    g = curve(-0.05, 0.06, sizes)
    expected, _ = fly_loes(LOES.time, LOES.u[0], lambda t, a, q, u, z: (0.0, float(g(a)), ()))
    close(
        loes(
            replace(find_effect("moment-nonlinearity", Loes()), low=-0.05, high=0.06, fine=fine),  # type: ignore[type-var]
            given,
        ),
        expected,
    )
    expected, _ = fly_loes(LOES.time, LOES.u[0], lambda t, a, q, u, z: (float(g(a)), 0.0, ()))
    close(
        loes(
            replace(find_effect("lift-nonlinearity", Loes()), low=-0.05, high=0.06, fine=fine),  # type: ignore[type-var]
            given,
        ),
        expected,
    )


@pytest.mark.sampled
@pytest.mark.parametrize("share", [1.0, 0.0, 0.4])
def test_nonlinear_control_bends_moment_and_lift_alike(share: float) -> None:
    sizes = [-0.02, 0.01, 0.004, -0.003]
    given = {f"shape{i + 1}": size for i, size in enumerate(sizes)} | {"lift_share": share}
    f = curve(-0.12, 0.15, sizes)
    v = RIGID_VALUES
    expected, _ = fly_rigid(
        RIGID.time,
        RIGID.u[0],
        lambda t, a, q, u, z: (share * v["CL_de"] * float(f(u)), v["Cm_de"] * float(f(u)), ()),
    )
    close(rigid(ControlNonlinearity(low=-0.12, high=0.15), given), expected)


@pytest.mark.long
def test_a_control_that_works_more_to_one_side() -> None:
    v, e, share = RIGID_VALUES, 0.3, 0.6
    expected, _ = fly_rigid(
        RIGID.time,
        RIGID.u[0],
        lambda t, a, q, u, z: (share * v["CL_de"] * e * abs(u), v["Cm_de"] * e * abs(u), ()),
    )
    got = rigid(ControlUnevenness(width=1e-9), {"unevenness": e, "lift_share": share})
    close(got, expected)
    # Up and down are two aircraft with two derivatives.
    up = replace(RIGID, u=np.abs(RIGID.u))
    one_sided = rigid_model().with_values(
        {"Cm_de": 1.3 * v["Cm_de"], "CL_de": (1.0 + e * share) * v["CL_de"]}
    )
    close(
        rigid(ControlUnevenness(width=1e-9), {"unevenness": e, "lift_share": share}, up),
        np.array(fly_model(one_sided, up)),
    )
    rounded = rigid(ControlUnevenness(), {"unevenness": e, "lift_share": share})
    close(rounded, got, 0.02)
    w = LOES_VALUES
    expected, _ = fly_loes(
        LOES.time,
        LOES.u[0],
        lambda t, a, q, u, z: (w["L_delta"] * e * abs(u), w["M_delta"] * e * abs(u), ()),
    )
    close(loes(replace(find_effect_named("delta"), width=1e-9), {"unevenness": e}), expected, 1e-4)


def test_a_control_that_loses_power_to_both_sides() -> None:
    v, share = RIGID_VALUES, 0.6
    f = lambda u: -0.3 * u**3 / 0.12**2  # noqa: E731
    expected, _ = fly_rigid(
        RIGID.time,
        RIGID.u[0],
        lambda t, a, q, u, z: (share * v["CL_de"] * f(u), v["Cm_de"] * f(u), ()),
    )
    close(rigid(ControlWeakening(widest=0.12), {"loss": 0.3, "lift_share": share}), expected)


def find_effect_named(control: str) -> ControlUnevenness:
    return next(
        effect
        for effect in UNEVENNESS_VARIANTS
        if isinstance(effect, ControlUnevenness) and effect.control == control
    )


@pytest.mark.sampled
@pytest.mark.parametrize("time", [2.0, 2.013])
def test_derivatives_that_jump_with_an_edge_of_no_width(time: float) -> None:
    changes = {"Cm_alpha": 0.4, "Cm_q": 9.0, "Cm_de": 0.3, "CL_alpha": -0.4}
    chord, V = RIGID_VALUES["chord"], RIGID_VALUES["airspeed"]

    def extra(
        t: float, a: float, q: float, u: float, z: np.ndarray
    ) -> tuple[float, float, tuple[()]]:
        return (
            (-0.4 * a, 0.4 * a + 9.0 * q * chord / (2.0 * V) + 0.3 * u, ())
            if t > time
            else (0.0, 0.0, ())
        )

    expected, _ = fly_rigid(RIGID.time, RIGID.u[0], extra, cuts=[time])
    got = rigid(DerivativeJump(), {"time": time, **changes})
    away = np.abs(RIGID.time - time) > 0.01
    close(got[:, away], expected[:, away], 2e-4)
    assert not np.allclose(got, fly_model(rigid_model(), RIGID), rtol=0.0, atol=1e-3)


@pytest.mark.sampled
@pytest.mark.parametrize(("start", "duration"), [(1.41, 0.633), (2.2, 50.0)])
def test_lift_and_moment_that_nobody_recorded(start: float, duration: float) -> None:
    lift, moment = 0.03, -0.02
    acts = lambda t: start < t < start + duration  # noqa: E731
    cuts = [start, start + duration]
    expected, _ = fly_rigid(
        RIGID.time,
        RIGID.u[0],
        lambda t, a, q, u, z: (lift * acts(t), moment * acts(t), ()),
        cuts=cuts,
    )
    got = rigid(
        UnmeasuredInput(), {"start": start, "duration": duration, "lift": lift, "moment": moment}
    )
    away = np.min(np.abs(RIGID.time[:, None] - cuts), axis=1) > 0.01
    close(got[:, away], expected[:, away], 2e-4)
    expected, _ = fly_loes(
        LOES.time,
        LOES.u[0],
        lambda t, a, q, u, z: (lift * acts(t), moment * acts(t), ()),
        cuts=cuts,
    )
    got = loes(
        find_effect("unmeasured-input", Loes()),
        {"start": start, "duration": duration, "lift": lift, "moment": moment},
    )
    close(got[:, away], expected[:, away], 2e-4)


def test_a_pulse_beyond_the_records_end_is_a_step() -> None:
    values = {"start": 1.41, "lift": 0.03, "moment": -0.02}
    np.testing.assert_array_equal(
        rigid(UnmeasuredInput(lasting=True), values),
        rigid(UnmeasuredInput(), {**values, "duration": 50.0}),
    )


def test_airspeed_that_grows_from_the_begin() -> None:
    flight = replace(RIGID, time=RIGID.time + 7.0)
    mass, wing, density, V = (
        RIGID_VALUES[name] for name in ("mass", "wing_area", "air_density", "airspeed")
    )
    speed = lambda t: V + 6.0 * (t - 7.0)  # noqa: E731
    expected, _ = fly_rigid(flight.time, flight.u[0], speed=speed)
    close(rigid(SpeedVariation(7.0, weight=False), {"rate": 6.0}, flight), expected)

    # What carries the weight: the coefficient of the trim, less what the weight itself takes at
    # that pressure.
    def carried(
        t: float, a: float, q: float, u: float, z: np.ndarray
    ) -> tuple[float, float, tuple[()]]:
        return 2.0 * mass * 9.80665 / (density * wing) * (V**-2 - speed(t) ** -2), 0.0, ()

    expected, _ = fly_rigid(flight.time, flight.u[0], carried, speed=speed)
    close(rigid(SpeedVariation(7.0), {"rate": 6.0}, flight), expected)
    assert expected[2, -1] > 0.2, "a faster aircraft is pulled up"


def test_airspeed_that_grows_on_the_low_order_equivalent_loads_it_as_the_rigid_one() -> None:
    still = replace(LOES, u=0.0 * LOES.u)
    with_weight, without = (
        loes(SpeedVariation(), {"rate": 3.0}, still),
        loes(SpeedVariation(weight=False), {"rate": 3.0}, still),
    )
    assert not without.any()
    V, g = LOES_CONSTANTS["airspeed"], LOES_CONSTANTS["gravity"]
    speed = V + 3.0 * still.time
    # Kinematics: nz = (V/g) (q - alpha_dot) with the vane's part taken off again.
    alpha = with_weight[0] + LOES_CONSTANTS["vane_arm"] / speed * with_weight[1]
    nz = speed / g * (with_weight[1] - np.gradient(alpha, still.time))
    np.testing.assert_allclose(with_weight[2][2:-2], nz[2:-2], rtol=0.0, atol=2e-4)
    # Before the aircraft turns into its path the load is that of the pressure.
    assert with_weight[2][5] == pytest.approx((speed[5] / V) ** 2 - 1.0, rel=0.15)


@pytest.mark.sampled
@pytest.mark.parametrize("lasting", [False, True])
def test_a_gust_that_passes_and_one_that_stays(lasting: bool) -> None:
    peak, start, duration = 4.0, 1.23, 0.77

    def w(t: float) -> float:
        share = (t - start) / duration
        if share <= 0.0:
            return 0.0
        if lasting and share >= 0.5:
            return peak
        return peak * float(np.sin(np.pi * share)) ** 2 if share < 1.0 else 0.0

    expected, _ = fly_rigid(
        RIGID.time, RIGID.u[0], gust=w, cuts=[start, start + 0.5 * duration, start + duration]
    )
    close(
        rigid(GustDiscrete(lasting), {"peak": peak, "start": start, "duration": duration}),
        expected,
        1e-5,
    )


BENDING = {
    "frequency": 17.0,
    "damping": 0.04,
    "lift": 0.2,
    "moment": -0.3,
    "angle_gain": 0.7,
    "gyro": 0.03,
}
FURTHER = {"lift_rate": 0.05, "moment_rate": -0.11, "pitch_gain": 0.05, "accelerometer": 2e-3}


@pytest.mark.sampled
@pytest.mark.parametrize(("fine", "number"), [(False, 1), (True, 1), (False, 2)])
def test_an_elastic_mode_with_all_its_couplings(fine: bool, number: int) -> None:
    values = {**BENDING, **FURTHER} if fine else BENDING
    c = {**dict.fromkeys(FURTHER, 0.0), **values}
    w = c["frequency"]

    def acceleration(a: float, q: float, u: float, eta: float, rate: float) -> float:
        return -2.0 * c["damping"] * w * rate + w**2 * (
            u + c["angle_gain"] * a + c["pitch_gain"] * q - eta
        )

    def extra(
        t: float, a: float, q: float, u: float, z: np.ndarray
    ) -> tuple[float, float, list[float]]:
        eta, rate = z
        return (
            c["lift"] * eta + c["lift_rate"] * rate / w,
            c["moment"] * eta + c["moment_rate"] * rate / w,
            [rate, acceleration(a, q, u, eta, rate)],
        )

    expected, inside = fly_rigid(RIGID.time, RIGID.u[0], extra, further=2)
    eta, rate = inside.T
    bent = [
        acceleration(*row)
        for row in zip(expected[0], expected[1], RIGID.u[0], eta, rate, strict=True)
    ]
    readings = np.array(
        [
            expected[0],
            expected[1] + c["gyro"] * rate,
            expected[2] + c["accelerometer"] * np.array(bent),
        ]
    )
    close(rigid(ElasticMode(number, fine), values), readings, 2e-6)


def test_two_elastic_modes_and_one_on_the_equivalent_system() -> None:
    model = rigid_model().with_effects(ElasticMode(), ElasticMode(2))
    assert [effect.name for effect in model.effects] == ["elastic-mode", "elastic-mode#2"]
    second = {f"elastic-mode#2.{local}": 0.0 for local in ("lift", "moment", "gyro")}
    alone = fly_model(rigid_model().with_effects(ElasticMode()), RIGID)
    np.testing.assert_array_equal(fly_model(model.with_values(second), RIGID), alone)
    values = {
        "frequency": 26.0,
        "damping": 0.03,
        "lift": 0.003,
        "moment": -0.06,
        "angle_gain": -11.0,
        "gyro": 0.002,
    }

    def extra(
        t: float, a: float, q: float, u: float, z: np.ndarray
    ) -> tuple[float, float, list[float]]:
        eta, rate = z
        return (
            0.003 * eta,
            -0.06 * eta,
            [rate, 26.0**2 * (u - 11.0 * a - eta) - 2.0 * 0.03 * 26.0 * rate],
        )

    expected, inside = fly_loes(LOES.time, LOES.u[0], extra, further=2)
    expected[1] += 0.002 * inside[:, 1]
    close(loes(find_effect("elastic-mode", Loes()), values), expected, 1e-5)


@pytest.mark.long
def test_guards_are_the_terms_that_they_name() -> None:
    chord, V = RIGID_VALUES["chord"], RIGID_VALUES["airspeed"]
    products = {
        "alpha-control": lambda a, q, u: a * u,
        "control-squared": lambda a, q, u: u * u,
        "alpha-q": lambda a, q, u: a * q * chord / (2.0 * V),
    }
    found = {guard.name: guard for guard in catch_all_terms_for(ShortPeriod())}
    others = (
        "lagged-loads",
        "periodic-loads",
        "damping-curve",
        "drifting-derivatives",
        "hysteresis",
        "vane-behind",
        "vane-near-control",
    )
    assert set(found) == {f"guard:{name}" for name in (*products, *others)}
    for name, product in products.items():

        def extra(
            t: float, a: float, q: float, u: float, z: np.ndarray, product: Any = product
        ) -> tuple[float, float, tuple[()]]:
            return 2.0 * product(a, q, u), -3.0 * product(a, q, u), ()

        expected, _ = fly_rigid(RIGID.time, RIGID.u[0], extra)
        close(rigid(found[f"guard:{name}"], {"lift": 2.0, "moment": -3.0}), expected)
    expected, _ = fly_rigid(
        RIGID.time,
        RIGID.u[0],
        lambda t, a, q, u, z: (0.5 * (a - z[0]), 0.3 * (a - z[0]), [(a - z[0]) / 0.4]),
        further=1,
    )
    close(rigid(found["guard:lagged-loads"], {"lag": 0.4, "lift": 0.5, "moment": 0.3}), expected)
    remembers = lambda t, a, q, u, z: (0.02 * z[0], 0.01 * z[0], [(q - abs(q) * z[0]) / 0.05])  # noqa: E731
    expected, _ = fly_rigid(RIGID.time, RIGID.u[0], remembers, further=1)
    close(rigid(found["guard:hysteresis"], {"width": 0.05, "lift": 0.02, "moment": 0.01}), expected)

    def swinging(
        t: float, a: float, q: float, u: float, z: np.ndarray
    ) -> tuple[float, float, tuple[()]]:
        return (
            0.02 * np.cos(5.0 * t) - 0.01 * np.sin(5.0 * t),
            0.004 * np.cos(5.0 * t) + 0.003 * np.sin(5.0 * t),
            (),
        )

    def curved(
        t: float, a: float, q: float, u: float, z: np.ndarray
    ) -> tuple[float, float, tuple[()]]:
        r = q * chord / (2.0 * V)
        return 300.0 * r * abs(r), -800.0 * r * abs(r), ()

    expected, _ = fly_rigid(RIGID.time, RIGID.u[0], curved)
    close(rigid(found["guard:damping-curve"], {"lift": 300.0, "moment": -800.0}), expected)

    def drifting(
        t: float, a: float, q: float, u: float, z: np.ndarray
    ) -> tuple[float, float, tuple[()]]:
        return 0.05 * t * a, t * (0.02 * a - 0.03 * u), ()

    expected, _ = fly_rigid(RIGID.time, RIGID.u[0], drifting)
    close(
        rigid(
            found["guard:drifting-derivatives"],
            {"stability": 0.02, "control": -0.03, "slope": 0.05},
        ),
        expected,
    )
    expected, _ = fly_rigid(RIGID.time, RIGID.u[0], swinging)
    sizes = {
        "frequency": 5.0,
        "lift_cos": 0.02,
        "lift_sin": -0.01,
        "moment_cos": 0.004,
        "moment_sin": 0.003,
    }
    close(rigid(found["guard:periodic-loads"], sizes), expected)


def test_a_mode_is_driven_by_the_angle_about_as_the_aircraft_is_turned_by_it() -> None:
    """Beforehand, to three times the ratio of the fitted moments; where these are not known, to
    anything.
    """
    fitted = ElasticMode().fitted_to(
        SearchContext(0.0, 9.0, 0.02, values={"Cm_alpha": -0.9, "Cm_de": -1.2})
    )
    known = {item.name: item for item in fitted.parameters}["angle_gain"]
    assert known.value == 0.0 and known.prior_std == pytest.approx(2.25)
    unknown = ElasticMode().fitted_to(
        SearchContext(0.0, 9.0, 0.02, values={"Cm_alpha": 0.0, "Cm_de": -1.2})
    )
    assert {item.name: item for item in unknown.parameters}["angle_gain"].prior_std == math.inf
