"""Effects on lateral and longitudinal motion, against both written a second time and integrated to
the last digits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from sim.declaration.effect import Effect
from sim.declaration.proposal import SearchContext
from sim.effects.disturbance.gusts import GustDiscrete, GustHorizontal
from sim.effects.dynamics.control_nonlinearity import (
    ControlNonlinearity,
    ControlUnevenness,
    ControlWeakening,
)
from sim.effects.dynamics.elastic_mode import ElasticMode
from sim.effects.guards.further_loads import LaggedLoads
from sim.effects.library import catch_all_terms_for, effects_for, find_effect
from sim.maths import combine, natural_shapes
from sim.vehicles.uncoupled import Lateral, Longitudinal
from tests.bases import (
    LATERAL_VALUES,
    LEVEL,
    LONGITUDINAL_VALUES,
    Flight,
    fly_model,
    lateral_flight,
    lateral_model,
    longitudinal_flight,
    longitudinal_model,
)
from tests.oracles.whole_axes import fly_lateral, fly_longitudinal

SIDE, UP = (
    replace(lateral_flight(), max_step=0.0025),
    replace(longitudinal_flight(), max_step=0.0025),
)
START = (LONGITUDINAL_VALUES["reference_airspeed"], LEVEL[0], LEVEL[0], 0.0)
SHAPES = {"shape1": 0.02, "shape2": -0.01, "shape3": 0.004, "shape4": 0.003}


def on_lateral(values: Mapping[str, float], *effects: Effect, flight: Flight = SIDE) -> np.ndarray:
    return np.array(fly_model(lateral_model().with_effects(*effects).with_values(values), flight))


def on_longitudinal(values: Mapping[str, float], *effects: Effect) -> np.ndarray:
    return np.array(fly_model(longitudinal_model().with_effects(*effects).with_values(values), UP))


def close(got: np.ndarray, expected: np.ndarray, share: float = 1e-6) -> None:
    for row, wanted in zip(got, expected, strict=True):
        np.testing.assert_allclose(row, wanted, rtol=0.0, atol=share * np.max(np.abs(wanted)))


def lateral(name: str) -> Effect:
    return find_effect(name, Lateral())


def curve(low: float, high: float, sizes: Mapping[str, float]) -> CubicSpline:
    knots = np.linspace(low, high, 6)
    return CubicSpline(
        knots, combine(natural_shapes(low, high), knots, [*sizes.values()]), bc_type="natural"
    )


def test_the_second_writings_fly_the_same() -> None:
    close(on_lateral({}), fly_lateral(SIDE.time, SIDE.u)[0], 1e-7)
    close(on_longitudinal({}), fly_longitudinal(UP.time, UP.u, START)[0], 1e-7)


def test_level_flight_is_steady() -> None:
    still = replace(UP, u=np.repeat([[LEVEL[1]], [LEVEL[2]]], UP.time.size, axis=1))
    rows = np.array(fly_model(longitudinal_model(), still))
    np.testing.assert_allclose(
        rows, np.repeat(rows[:, :1], UP.time.size, axis=1), rtol=0.0, atol=1e-9
    )


def test_a_vane_of_sideslip_and_a_lateral_accelerometer_ahead() -> None:
    expected, yaw_acceleration = fly_lateral(SIDE.time, SIDE.u)
    got = on_lateral(
        {"vane-offset.arm": 3.0, "accelerometer-offset:ny.arm": 2.0},
        lateral("vane-offset"),
        lateral("accelerometer-offset:ny"),
    )
    expected[0] += 3.0 / LATERAL_VALUES["airspeed"] * expected[2]
    expected[4] += 2.0 / 9.80665 * yaw_acceleration
    close(got, expected)


def test_a_vane_of_sideslip_behind() -> None:
    (guard,) = [
        guard for guard in catch_all_terms_for(Lateral()) if guard.name == "guard:vane-behind"
    ]
    expected, _ = fly_lateral(SIDE.time, SIDE.u)
    expected[0] -= 3.0 / LATERAL_VALUES["airspeed"] * expected[2]
    close(on_lateral({"guard:vane-behind.arm": 3.0}, guard), expected)


def test_vanes_that_read_a_control() -> None:
    """Of sideslip the rudder, of the angle of attack the elevator, and nothing else changes."""
    name = "guard:vane-near-control"
    (aside,) = [guard for guard in catch_all_terms_for(Lateral()) if guard.name == name]
    (above,) = [guard for guard in catch_all_terms_for(Longitudinal()) if guard.name == name]
    rudder = [signal.name for signal in Lateral().inputs].index("rudder")
    expected, _ = fly_lateral(SIDE.time, SIDE.u)
    expected[0] += 0.2 * SIDE.u[rudder]
    close(on_lateral({f"{name}.gain": 0.2}, aside), expected)
    elevator = [signal.name for signal in Longitudinal().inputs].index("elevator")
    expected, _ = fly_longitudinal(UP.time, UP.u, START)
    expected[1] -= 0.1 * UP.u[elevator]
    close(on_longitudinal({f"{name}.gain": -0.1}, above), expected)


def test_accelerometers_of_the_longitudinal_axis() -> None:
    nz, nx, vane = (
        find_effect(name, Longitudinal())
        for name in ("accelerometer-offset:nz", "accelerometer-offset:nx", "vane-offset")
    )
    expected, pitch_acceleration = fly_longitudinal(UP.time, UP.u, START)
    expected[1] -= 1.5 / expected[0] * expected[3]
    expected[4] += 2.0 / 9.80665 * pitch_acceleration
    expected[5] += 0.4 / 9.80665 * pitch_acceleration
    arms = {
        "accelerometer-offset:nz.arm": 2.0,
        "accelerometer-offset:nx.arm": 0.4,
        "vane-offset.arm": 1.5,
    }
    close(on_longitudinal(arms, nz, nx, vane), expected)


@pytest.mark.long
def test_a_curved_rudder_acts_on_all_three_axes_as_another_deflection() -> None:
    f, v = curve(-0.1, 0.12, SHAPES), LATERAL_VALUES
    effect = replace(lateral("control-nonlinearity:rudder"), low=-0.1, high=0.12)  # type: ignore[type-var]
    values = {f"control-nonlinearity:rudder.{name}": size for name, size in SHAPES.items()}
    expected, _ = fly_lateral(
        SIDE.time,
        SIDE.u,
        lambda t, s: {axis: v[f"{axis}_dr"] * float(f(s["dr"])) for axis in ("CY", "Cl", "Cn")},
    )
    close(on_lateral(values, effect), expected)
    # The same as the rudder moved further in the record.
    moved = replace(SIDE, u=np.array([SIDE.u[0], SIDE.u[1] + f(SIDE.u[1])]))
    close(on_lateral(values, effect), on_lateral({}, flight=moved))


def test_an_uneven_aileron_is_another_deflection() -> None:
    effect = next(
        each
        for each in effects_for(Lateral())
        if each.name == "control-nonlinearity:aileron" and isinstance(each, ControlUnevenness)
    )
    moved = replace(SIDE, u=np.array([SIDE.u[0] + 0.3 * np.abs(SIDE.u[0]), SIDE.u[1]]))
    close(
        on_lateral({"control-nonlinearity:aileron.unevenness": 0.3}, effect),
        on_lateral({}, flight=moved),
        1e-3,
    )


def test_an_aileron_that_weakens_is_another_deflection() -> None:
    context = SearchContext(0.0, 4.0, 0.04, flown={"aileron": (-0.05, 0.08)})
    plain = next(
        each
        for each in effects_for(Lateral())
        if each.name == "control-nonlinearity:aileron" and isinstance(each, ControlWeakening)
    )
    effect = plain.fitted_to(context)
    moved = replace(
        SIDE, u=np.array([SIDE.u[0] * (1.0 - 0.3 * (SIDE.u[0] / 0.08) ** 2), SIDE.u[1]])
    )
    close(
        on_lateral({"control-nonlinearity:aileron.loss": 0.3}, effect),
        on_lateral({}, flight=moved),
        1e-9,
    )


@pytest.mark.long
@pytest.mark.parametrize(("port", "axis"), [("yaw", "Cn"), ("roll", "Cl"), ("side_force", "CY")])
def test_derivatives_that_jump_and_a_load_that_nobody_recorded(port: str, axis: str) -> None:
    at, end, width = 1.21, 2.53, 0.01
    changes = {"beta": -0.03, "p": 0.05, "r": -0.04, "da": 0.02, "dr": 0.01}

    def risen(t: float, when: float) -> float:
        return min(max((t - when) / width + 0.5, 0.0), 1.0)

    cuts = [when + side * width for when in (at, end) for side in (-0.5, 0.5)]
    expected, _ = fly_lateral(
        SIDE.time,
        SIDE.u,
        lambda t, s: {axis: risen(t, at) * sum(changes[by] * value for by, value in s.items())},
        cuts=cuts,
    )
    jump = {f"derivative-jump:{port}.time": at} | {
        f"derivative-jump:{port}.{axis}_{by}": size for by, size in changes.items()
    }
    close(on_lateral(jump, lateral(f"derivative-jump:{port}")), expected, 1e-5)
    expected, _ = fly_lateral(
        SIDE.time, SIDE.u, lambda t, s: {axis: 0.004 * (risen(t, at) - risen(t, end))}, cuts=cuts
    )
    load = {"start": at, "duration": end - at, port: 0.004}
    effect = lateral(f"unmeasured-input:{port}")
    close(
        on_lateral({f"{effect.name}.{name}": value for name, value in load.items()}, effect),
        expected,
        1e-5,
    )


def gust(t: float, peak: float = 4.0, start: float = 0.8, duration: float = 1.6) -> float:
    return (
        0.5 * peak * (1.0 - math.cos(2.0 * math.pi * (t - start) / duration))
        if start < t < start + duration
        else 0.0
    )


def test_a_gust_from_the_right_is_felt_by_loads_and_vane() -> None:
    expected, _ = fly_lateral(SIDE.time, SIDE.u, wind=gust, cuts=(0.8, 2.4))
    values = {"gust-discrete.peak": 4.0, "gust-discrete.start": 0.8, "gust-discrete.duration": 1.6}
    close(on_lateral(values, GustDiscrete()), expected, 1e-5)


def test_a_gust_from_ahead_is_felt_by_loads_and_pitot_tube() -> None:
    expected, _ = fly_longitudinal(UP.time, UP.u, START, headwind=gust)
    values = {
        "gust-horizontal.peak": 4.0,
        "gust-horizontal.start": 0.8,
        "gust-horizontal.duration": 1.6,
    }
    got = on_longitudinal(values, GustHorizontal())
    assert np.max(expected[0] - on_longitudinal({})[0]) > 3.5
    close(got, expected, 1e-5)


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("name", "axis", "size"), [("yaw", "Cn", 0.03), ("roll", "Cl", 0.2), ("side-force", "CY", 0.5)]
)
def test_loads_bent_over_sideslip(name: str, axis: str, size: float) -> None:
    low, high = -0.15, 0.12
    f, wind = (
        curve(low, high, SHAPES),
        {"gust-discrete.peak": 1.0, "gust-discrete.start": 0.8, "gust-discrete.duration": 1.6},
    )
    effect = replace(lateral(f"{name}-nonlinearity"), low=low, high=high)  # type: ignore[type-var]
    expected, _ = fly_lateral(
        SIDE.time,
        SIDE.u,
        lambda t, s: {axis: size * float(f(s["beta"]))},
        wind=lambda t: gust(t, 1.0),
        cuts=(0.8, 2.4),
    )
    values = {f"{effect.name}.{local}": size * share for local, share in SHAPES.items()}
    close(on_lateral(values | wind, effect, GustDiscrete()), expected, 1e-5)


@pytest.mark.sampled
@pytest.mark.parametrize(("name", "axis"), [("drag", "CD"), ("lift", "CL"), ("moment", "Cm")])
def test_loads_of_a_total_angle_bend_about_the_middle_of_what_was_flown(
    name: str, axis: str
) -> None:
    context = SearchContext(0.0, 4.0, 0.04, flown={"alpha": (-0.06, 0.1)})
    effect = find_effect(f"{name}-nonlinearity", Longitudinal()).fitted_to(context)  # type: ignore[attr-defined]
    f = curve(-0.08, 0.08, SHAPES)
    expected, _ = fly_longitudinal(
        UP.time, UP.u, START, lambda t, s: {axis: 0.3 * float(f(s["alpha"] - 0.02))}
    )
    close(
        on_longitudinal(
            {f"{effect.name}.{local}": 0.3 * size for local, size in SHAPES.items()}, effect
        ),
        expected,
        1e-5,
    )


def test_a_bending_fin() -> None:
    expected, _ = fly_lateral(
        SIDE.time,
        SIDE.u,
        lambda t, s: {"CY": 0.08 * s["eta"], "Cn": -0.03 * s["eta"]},
        bending=(17.0, 0.04, -0.6, 0.02),
    )
    mode = {
        "frequency": 17.0,
        "damping": 0.04,
        "side_force": 0.08,
        "yaw": -0.03,
        "angle_gain": -0.6,
        "gyro": 0.02,
    }
    close(
        on_lateral(
            {f"elastic-mode.{name}": value for name, value in mode.items()}, lateral("elastic-mode")
        ),
        expected,
        1e-5,
    )


def test_an_airspeed_that_changes() -> None:
    expected, _ = fly_lateral(SIDE.time, SIDE.u, faster=1.7)
    close(on_lateral({"speed-variation.rate": 1.7}, lateral("speed-variation")), expected, 1e-5)


def test_two_actuators_at_once() -> None:
    expected, _ = fly_lateral(SIDE.time, SIDE.u, lags=(0.11, 0.19))
    values = {"actuator-lag:aileron.time_constant": 0.11, "actuator-lag:rudder.time_constant": 0.19}
    got = on_lateral(values, lateral("actuator-lag:aileron"), lateral("actuator-lag:rudder"))
    # A cell holds the mean of the lagging surface: the motion is that of the surface to second
    # order, ny at a sample only to first.
    close(got[:4], expected[:4], 1e-4)
    close(got[4:], expected[4:], 0.02)


def test_an_actuator_of_the_rudder_leaves_the_aileron_alone() -> None:
    ailerons_only = replace(SIDE, u=np.array([SIDE.u[0], 0.0 * SIDE.u[1]]))
    np.testing.assert_array_equal(
        on_lateral({}, lateral("actuator-lag:rudder"), flight=ailerons_only),
        on_lateral({}, flight=ailerons_only),
    )


@pytest.mark.long
def test_a_curved_elevator_counts_from_the_middle_of_its_deflections() -> None:
    context = SearchContext(0.0, 4.0, 0.04, flown={"elevator": (-0.05, 0.13)})
    forms = {
        type(effect): effect
        for effect in effects_for(Longitudinal())
        if effect.name == "control-nonlinearity:elevator"
    }
    curved, uneven, weakening = (
        forms[ControlNonlinearity],
        forms[ControlUnevenness],
        forms[ControlWeakening],
    )
    f, v = curve(-0.09, 0.09, SHAPES), LONGITUDINAL_VALUES
    fitted = curved.fitted_to(context)  # type: ignore[attr-defined]
    expected, _ = fly_longitudinal(
        UP.time,
        UP.u,
        START,
        lambda t, s: {axis: v[f"{axis}_de"] * float(f(s["de"] - 0.04)) for axis in ("CL", "Cm")},
    )
    close(
        on_longitudinal({f"{fitted.name}.{local}": size for local, size in SHAPES.items()}, fitted),
        expected,
        1e-5,
    )
    fitted = uneven.fitted_to(context)  # type: ignore[attr-defined]
    expected, _ = fly_longitudinal(
        UP.time,
        UP.u,
        START,
        lambda t, s: {axis: 0.2 * v[f"{axis}_de"] * abs(s["de"] - 0.04) for axis in ("CL", "Cm")},
    )
    close(on_longitudinal({f"{fitted.name}.unevenness": 0.2}, fitted), expected, 1e-3)
    fitted = weakening.fitted_to(context)  # type: ignore[attr-defined]
    assert fitted.widest == pytest.approx(0.09)
    lost = lambda de: -0.2 * (de - 0.04) ** 3 / 0.09**2  # noqa: E731
    expected, _ = fly_longitudinal(
        UP.time,
        UP.u,
        START,
        lambda t, s: {axis: v[f"{axis}_de"] * lost(s["de"]) for axis in ("CL", "Cm")},
    )
    close(on_longitudinal({f"{fitted.name}.loss": 0.2}, fitted), expected, 1e-5)


def test_nothing_rings_in_steady_flight() -> None:
    still = replace(UP, u=np.repeat([[LEVEL[1]], [LEVEL[2]]], UP.time.size, axis=1))
    context = SearchContext(
        0.0,
        4.0,
        0.04,
        flown={
            "elevator": (LEVEL[1] - 0.1, LEVEL[1] + 0.1),
            "alpha": (LEVEL[0] - 0.1, LEVEL[0] + 0.1),
        },
    )
    offered = [*effects_for(Longitudinal()), *catch_all_terms_for(Longitudinal())]
    with_states = [
        effect.fitted_to(context)
        for effect in offered
        if isinstance(effect, ElasticMode | LaggedLoads)
    ]
    assert len(with_states) == 2
    for effect in with_states:
        rows = np.array(fly_model(longitudinal_model().with_effects(effect), still))
        np.testing.assert_allclose(
            rows,
            np.repeat(rows[:, :1], UP.time.size, axis=1),
            rtol=0.0,
            atol=1e-9,
            err_msg=effect.name,
        )


def test_an_input_of_unknown_size_asks_its_record() -> None:
    context = SearchContext(0.0, 4.0, 0.04, input_peak={"thrust": 2400.0})
    names = ("actuator-rate-limit", "actuator-saturation", "input-backlash", "input-deadband")
    plain = np.array(fly_model(longitudinal_model(), UP))
    for name in names:
        effect = find_effect(f"{name}:thrust", Longitudinal()).fitted_to(context)  # type: ignore[attr-defined]
        assert {item.unit for item in effect.parameters} <= {"N", "N/s"}
        change = np.array(fly_model(longitudinal_model().with_effects(effect), UP)) - plain
        assert np.max(np.abs(change[5])) > 0.002, name
