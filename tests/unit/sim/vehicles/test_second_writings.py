"""Equations and figures of vehicles written a second way: other airspeeds, rising bodies, direct
paths, closed forms, limits of numbers.
"""

from __future__ import annotations

import inspect
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import cont2discrete, dlsim
from scipy.stats import norm

from sim.declaration.compile import compile_model
from sim.maneuvers import three_two_one_one
from sim.vehicles import flexibility
from sim.vehicles.factory import (
    ballistic_model,
    flexible_model,
    linearise,
    model_from_constants,
    rigid_model,
    zero_order_hold_response,
)
from sim.vehicles.flexibility import condense, with_frequency_factor
from sim.vehicles.library import VehicleData, read_parameter_set
from sim.vehicles.uncoupled import Loes, Longitudinal, ShortPeriod
from tests.bases import LOES_CONSTANTS, LOES_VALUES, LONGITUDINAL_VALUES, RIGID_VALUES
from tests.oracles.loes import rates_and_readings

OFFSETS = {"L_0": 0.003, "M_0": -0.05, "delta_0": 0.2, "nz_0": 1.0}
number = st.floats(-2.0, 2.0)


@given(number, number, number, number, st.floats(-60.0, 60.0))
def test_another_airspeed_is_an_aircraft_with_the_derivatives_of_that_airspeed(
    alpha: float, q: float, delta: float, stick: float, change: float
) -> None:
    # Constant coefficients: forces go with V^2, divided by m V in alpha_dot; a rate's moment has
    # one V less.
    values = {**LOES_CONSTANTS, **LOES_VALUES, **OFFSETS}
    ratio = (values["airspeed"] + change) / values["airspeed"]
    powers = {"airspeed": 1, "L_alpha": 1, "L_delta": 1, "M_alpha": 2, "M_delta": 2, "M_q": 1}
    rates, readings = rates_and_readings(
        {name: value * ratio ** powers.get(name, 0) for name, value in values.items()},
        alpha,
        q,
        delta,
        stick,
    )
    equations, p = Loes(), SimpleNamespace(**values)
    s = SimpleNamespace(
        alpha=alpha,
        q=q,
        delta=delta,
        stick=stick,
        airspeed_change=change,
        gust=0.0,
        lift=0.0,
        moment=0.0,
    )
    s = SimpleNamespace(**vars(s), **equations.flow(s, p))
    np.testing.assert_allclose(equations.derivatives(s, p), rates, rtol=1e-11, atol=1e-10)
    np.testing.assert_allclose(equations.measurements(s, p), readings, rtol=1e-11, atol=1e-10)


@given(number, number, number, st.floats(-60.0, 60.0))
def test_a_change_of_airspeed_is_an_aircraft_declared_at_that_airspeed(
    alpha: float, q: float, elevator: float, change: float
) -> None:
    equations = ShortPeriod()
    moved, declared = (
        SimpleNamespace(**{**RIGID_VALUES, "airspeed": RIGID_VALUES["airspeed"] + by})
        for by in (0.0, change)
    )
    found = []
    for p, by in ((moved, change), (declared, 0.0)):
        ports = {
            "airspeed_change": by,
            "density_change": 0.0,
            "gust": 0.0,
            "lift": 0.0,
            "moment": 0.0,
        }
        s = SimpleNamespace(alpha=alpha, q=q, elevator=elevator, **ports)
        s = SimpleNamespace(**vars(s), **equations.flow(s, p))
        found.append([*equations.derivatives(s, p), *equations.measurements(s, p)])
    np.testing.assert_allclose(found[0], found[1], rtol=1e-12, atol=1e-12)


@given(
    st.floats(-0.3, 0.3), st.floats(-0.5, 0.5), number, st.floats(-20.0, 20.0), st.floats(-0.1, 0.1)
)
def test_air_loads_act_at_the_airspeed_and_turn_the_path_of_the_mass(
    alpha: float, theta: float, q: float, headwind: float, gust: float
) -> None:
    """m V_dot = T cos(alpha) - D - m g sin(gamma), m V gamma_dot = L + T sin(alpha) - m g
    cos(gamma).
    """
    v, speed, elevator, thrust, g = LONGITUDINAL_VALUES, 50.0, -0.04, 2000.0, 9.80665
    p, equations = SimpleNamespace(**v), Longitudinal()
    ports = {"headwind": headwind, "gust": gust, "drag": 0.001, "lift": 0.02, "moment": 0.003}
    s = SimpleNamespace(
        airspeed=speed, alpha=alpha, theta=theta, q=q, elevator=elevator, thrust=thrust, **ports
    )
    s = SimpleNamespace(**vars(s), **equations.flow(s, p))
    V_dot, alpha_dot, theta_dot, q_dot = equations.derivatives(s, p)
    air, seen, gamma = speed + headwind, alpha + gust, theta - alpha
    ratio, rate = air / v["reference_airspeed"], q * v["chord"] / (2.0 * v["reference_airspeed"])
    CD = v["CD_0"] + v["CD_V"] * ratio + v["CD_alpha"] * seen + 0.001
    CL = (
        v["CL_0"]
        + v["CL_V"] * ratio
        + v["CL_alpha"] * seen
        + v["CL_q"] * rate
        + v["CL_de"] * elevator
        + 0.02
    )
    Cm = (
        v["Cm_0"]
        + v["Cm_V"] * ratio
        + v["Cm_alpha"] * seen
        + v["Cm_q"] * rate
        + v["Cm_de"] * elevator
        + 0.003
    )
    qS, m = 0.5 * v["air_density"] * air**2 * v["wing_area"], v["mass"]
    along = thrust * math.cos(alpha) - qS * CD - m * g * math.sin(gamma)
    across = qS * CL + thrust * math.sin(alpha) - m * g * math.cos(gamma)
    assert m * V_dot == pytest.approx(along, rel=1e-9, abs=1e-6)
    assert m * speed * (theta_dot - alpha_dot) == pytest.approx(across, rel=1e-9, abs=1e-6)
    assert v["pitch_inertia"] * q_dot == pytest.approx(
        qS * v["chord"] * Cm + thrust * v["thrust_arm"], rel=1e-9
    )
    read = dict(
        zip(
            (signal.name for signal in equations.outputs), equations.measurements(s, p), strict=True
        )
    )
    body_x = thrust + qS * (CL * math.sin(alpha) - CD * math.cos(alpha))
    body_z = -qS * (CL * math.cos(alpha) + CD * math.sin(alpha))
    assert (read["airspeed"], read["alpha"], read["theta"], read["q"]) == pytest.approx(
        (air, seen, theta, q)
    )
    assert (read["nx"], read["nz"]) == pytest.approx((body_x / (m * g), -body_z / (m * g)))


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_a_stiffer_structure_has_all_modal_frequencies_by_one_factor_and_nothing_else(
    factor: float,
) -> None:
    data = read_parameter_set("bomber_ac1")
    assert with_frequency_factor(data, factor).values == pytest.approx(
        stiffened(factor).values, rel=1e-12
    )


@given(altitude=st.floats(0.0, 60000.0), velocity=st.floats(-2000.0, 2000.0))
def test_drag_is_against_the_motion_up_and_down(altitude: float, velocity: float) -> None:
    model = ballistic_model(read_parameter_set("ballistic_target"))
    p = {name: model.parameters[name].value for name in model.parameters.names}
    density = p["air_density_reference"] * math.exp(-altitude / p["density_scale_height"])
    drag = 0.5 * density * velocity**2 / p["beta"]
    system = compile_model(model)
    climb, rate = system.f(0.0, [altitude, velocity], [], system.parameters.values().tolist())
    assert climb == velocity
    assert rate == pytest.approx(-math.copysign(drag, velocity) - p["gravity"], rel=1e-12)


def test_held_response_is_that_of_another_library_direct_path_included() -> None:
    linear, step = linearise(rigid_model(read_parameter_set("bomber_rigid"))), 0.02
    assert np.any(linear.D), "the elevator's lift acts on nz at once"
    u = np.random.default_rng(1).standard_normal(200)
    discrete = cont2discrete((linear.A, linear.B, linear.C, linear.D), step, "zoh")
    expected = dlsim(discrete, u)[1].T
    np.testing.assert_allclose(
        zero_order_hold_response(linear, u, step),
        expected,
        rtol=0.0,
        atol=1e-9 * np.max(np.abs(expected)),
    )


ELEVATOR = three_two_one_one(0.10471, 0.5, 1.0)(np.arange(801) * 0.01)
NOISE = math.radians(math.sqrt(0.016))


def stiffened(factor: float) -> VehicleData:
    data = read_parameter_set("bomber_ac1")
    return replace(
        data,
        numbers=tuple(
            replace(n, value=n.value * factor) if n.name.startswith("omega") else n
            for n in data.numbers
        ),
    )


def documented_figures() -> dict[float, tuple[str, ...]]:
    """Rows of the table in the module's text: factor -> stiffness lost, separation, degree,
    distance, misfit.
    """
    text = inspect.getdoc(flexibility) or ""
    rows = [
        line.replace("AC1", "").replace("AC2", "").split()
        for line in text.split("rigid is adequate\n")[1].splitlines()
    ]
    return {float(row[0]): tuple(row[2:7]) for row in rows if len(row) > 7 and row[0][0].isdigit()}


@pytest.mark.parametrize("factor", [4.0, 1.0, 0.5])
def test_figures_of_flexibility_are_those_of_the_table_in_the_modules_text(factor: float) -> None:
    found = flexibility.flexibility(stiffened(factor), ELEVATOR, 0.01, {"alpha": NOISE, "q": NOISE})
    figures = (found.stiffness_loss, found.separation, found.degree, found.distance, found.misfit)
    for value, text in zip(figures, documented_figures()[factor], strict=True):
        assert value == pytest.approx(
            float(text), abs=0.501 * 10.0 ** -len(text.partition(".")[2])
        ), text


def test_stiffness_lost_and_separation_in_closed_form() -> None:
    data = read_parameter_set("bomber_ac1")
    found = flexibility.flexibility(data, ELEVATOR, 0.01, {"alpha": NOISE, "q": NOISE})

    def stiffness(d: dict[str, float]) -> float:
        # w^2 = L_alpha M_q - L_q M_alpha with dimensional derivatives from eqs. 22-25 of the paper.
        v = data.values
        force = 0.5 * v["air_density"] * v["airspeed"] ** 2 * v["wing_area"]
        lift, moment, rate = (
            force / (v["mass"] * v["airspeed"]),
            force * v["chord"] / v["pitch_inertia"],
            v["chord"] / (2.0 * v["airspeed"]),
        )
        return (
            -lift * d["CL_alpha"] * moment * d["Cm_q"] * rate
            - (1.0 - lift * d["CL_q"] * rate) * moment * d["Cm_alpha"]
        )

    condensed, rigid = (
        stiffness(dict(condense(data.values, 4).derivatives)),
        stiffness(dict(data.values)),
    )
    assert found.short_period == pytest.approx(math.sqrt(condensed), rel=1e-9)
    assert found.stiffness_loss == pytest.approx(1.0 - condensed / rigid, rel=1e-9)
    roots = np.linalg.eigvals(linearise(flexible_model(data)).A)
    lowest = min(abs(root) for root in roots if abs(root) > 2.0 * found.short_period)
    assert found.separation == pytest.approx(lowest / math.sqrt(condensed), rel=1e-9)


def test_what_is_detectable_is_what_a_chi_squared_test_finds_nineteen_times_in_twenty() -> None:
    found = flexibility.flexibility(
        read_parameter_set("bomber_ac1"), ELEVATOR, 0.01, {"alpha": NOISE, "q": NOISE}
    )
    n = 2 * ELEVATOR.size
    # The energy of n residuals has mean n and standard deviation sqrt(2 n); 5 % false alarms and 95
    # % power are two of z.
    assert found.detectable**2 * n == pytest.approx(
        (norm.ppf(0.95) + norm.ppf(0.95)) * math.sqrt(2 * n), rel=1e-9
    )


def test_numbers_that_may_be_zero() -> None:
    model = model_from_constants(
        "loes", LOES_CONSTANTS, {**LOES_VALUES, "delay": 0.0, "inv_tau": 0.0}
    )
    assert (model.parameters["delay"].value, model.parameters["inv_tau"].value) == (0.0, 0.0)
    data = read_parameter_set("bomber_ac1")
    undamped = replace(
        data, numbers=tuple(replace(n, value=0.0) if n.name == "zeta1" else n for n in data.numbers)
    )
    assert flexible_model(undamped).parameters["zeta1"].value == 0.0
