"""Flow separation against Goman and Khrabrov's equation and Kirchhoff's lift written a second time
and integrated by SciPy.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim.declaration.compile import compile_model
from sim.declaration.proposal import SearchContext
from sim.effects.dynamics.load_nonlinearity import FlowSeparation
from tests.bases import (
    LEVEL,
    LONGITUDINAL_VALUES,
    RIGID_VALUES,
    Flight,
    fly_model,
    longitudinal_flight,
    longitudinal_model,
    rigid_flight,
    rigid_model,
)

G = 9.80665
STALL = {"tau1": 0.31, "tau2": 0.07, "a1": 30.0, "alpha_star": 0.06, "moment": -0.04}


def flown(
    flight: Flight, rates: Callable[[Sequence[float], np.ndarray], list[float]], start: list[float]
) -> np.ndarray:
    """States at the samples, each interval with its held input integrated by itself, ``(n, N)``."""
    states = [np.array(start)]
    for k in range(len(flight.time) - 1):
        span = (0.0, float(flight.time[k + 1] - flight.time[k]))
        run = solve_ivp(
            lambda t, x, k=k: rates(x, flight.u[:, k]),
            span,
            states[-1],
            method="DOP853",
            rtol=1e-11,
            atol=1e-13,
        )
        states.append(run.y[:, -1])
    return np.array(states).T


def kirchhoff(x: float) -> float:
    return (0.5 * (1.0 + math.sqrt(x))) ** 2


def attachment_rate(x: float, alpha: float, alpha_rate: float) -> float:
    """X_dot by the hyperbolic tangent of the paper."""
    steady = 0.5 * (
        1.0 - math.tanh(STALL["a1"] * (alpha - STALL["tau2"] * alpha_rate - STALL["alpha_star"]))
    )
    return (steady - x) / STALL["tau1"]


def rigid_oracle(flight: Flight) -> np.ndarray:
    """alpha, q, nz of the rigid aircraft; lift is the total one less what carries the weight."""
    v = RIGID_VALUES
    pressure, mass, V = (
        0.5 * v["air_density"] * v["airspeed"] ** 2 * v["wing_area"],
        v["mass"],
        v["airspeed"],
    )
    carrying = mass * G / pressure

    def loads(x: Sequence[float], elevator: float) -> tuple[float, float]:
        alpha, q, attached = x
        q_hat = q * v["chord"] / (2.0 * V)
        wing = kirchhoff(attached) * (carrying + v["CL_alpha"] * alpha) - carrying
        moment = (
            v["Cm_alpha"] * alpha
            + v["Cm_q"] * q_hat
            + v["Cm_de"] * elevator
            + STALL["moment"] * (1.0 - attached)
        )
        return wing + v["CL_q"] * q_hat + v["CL_de"] * elevator, moment

    def rates(x: Sequence[float], u: np.ndarray) -> list[float]:
        lift, moment = loads(x, u[0])
        alpha_rate = x[1] - pressure * lift / (mass * V)
        return [
            alpha_rate,
            pressure * v["chord"] * moment / v["pitch_inertia"],
            attachment_rate(x[2], x[0], alpha_rate),
        ]

    states = flown(flight, rates, [0.0, 0.0, 1.0])
    nz = [
        pressure * loads(x, u)[0] / (mass * G) for x, u in zip(states.T, flight.u[0], strict=True)
    ]
    return np.vstack([states[:2], nz])


def longitudinal_oracle(flight: Flight, drag: float) -> np.ndarray:
    """Airspeed, alpha, theta, q of the whole axis by its flight path angle."""
    v = LONGITUDINAL_VALUES

    def rates(x: Sequence[float], u: np.ndarray) -> list[float]:
        V, path, theta, q, attached = x
        alpha, ratio, q_hat = (
            theta - path,
            V / v["reference_airspeed"],
            q * v["chord"] / (2.0 * v["reference_airspeed"]),
        )
        pressure = 0.5 * v["air_density"] * V * V * v["wing_area"]
        lift = (
            kirchhoff(attached) * (v["CL_0"] + v["CL_V"] * ratio + v["CL_alpha"] * alpha)
            + v["CL_q"] * q_hat
            + v["CL_de"] * u[0]
        )
        resistance = v["CD_0"] + v["CD_V"] * ratio + v["CD_alpha"] * alpha + drag * (1.0 - attached)
        moment = (
            v["Cm_0"]
            + v["Cm_V"] * ratio
            + v["Cm_alpha"] * alpha
            + v["Cm_q"] * q_hat
            + v["Cm_de"] * u[0]
            + STALL["moment"] * (1.0 - attached)
        )
        turn = (pressure * lift + u[1] * math.sin(alpha)) / (v["mass"] * V) - G / V * math.cos(path)
        return [
            (u[1] * math.cos(alpha) - pressure * resistance) / v["mass"] - G * math.sin(path),
            turn,
            q,
            (pressure * v["chord"] * moment + u[1] * v["thrust_arm"]) / v["pitch_inertia"],
            attachment_rate(attached, alpha, q - turn),
        ]

    V, path, theta, q, _ = flown(flight, rates, [v["reference_airspeed"], 0.0, LEVEL[0], 0.0, 1.0])
    return np.array([V, theta - path, theta, q])


def test_the_rigid_aircraft_is_the_second_writing() -> None:
    flight = replace(rigid_flight(5.0), max_step=0.005)
    model = (
        rigid_model()
        .with_effects(FlowSeparation())
        .with_values({f"flow-separation.{name}": value for name, value in STALL.items()})
    )
    for got, wanted in zip(fly_model(model, flight), rigid_oracle(flight), strict=True):
        np.testing.assert_allclose(got, wanted, rtol=0.0, atol=1e-6 * np.max(np.abs(wanted)))
    without = fly_model(rigid_model(), flight)
    assert np.max(np.abs(without[2] - rigid_oracle(flight)[2])) > 0.2


def test_the_whole_axis_is_the_second_writing() -> None:
    flight = replace(longitudinal_flight(3.0), max_step=0.005)
    given = {f"flow-separation.{name}": value for name, value in {**STALL, "drag": 0.11}.items()}
    model = longitudinal_model().with_effects(FlowSeparation(total=True)).with_values(given)
    expected = longitudinal_oracle(flight, 0.11)
    for got, wanted in zip(fly_model(model, flight), expected, strict=False):
        np.testing.assert_allclose(got, wanted, rtol=0.0, atol=1e-6 * np.max(np.abs(wanted)))
    assert np.max(np.abs(fly_model(longitudinal_model(), flight)[3] - expected[3])) > 0.01


def test_lift_goes_down_a_loop_over_the_angle_of_attack() -> None:
    """Slowly swept up and down: the lift on the way down is below that on the way up, and without a
    lag it is not.
    """
    effect = FlowSeparation()
    vehicle = SimpleNamespace(**RIGID_VALUES)

    def area(tau1: float) -> float:
        p, step, separated = SimpleNamespace(**{**STALL, "tau1": tau1, "tau2": 0.0}), 0.005, 0.0
        alphas, lifts = 0.06 - 0.06 * np.cos(2.0 * np.pi * np.arange(0.0, 4.0, step) / 4.0), []
        for alpha, rate in zip(alphas, np.gradient(alphas, step), strict=True):
            s = SimpleNamespace(
                alpha_air=float(alpha), alpha_dot=float(rate), separated_flow=separated
            )
            lifts.append(effect.increments(s, vehicle, p)["lift"])
            separated += step * effect.derivatives(s, vehicle, p)[0]
        return float(np.trapezoid(lifts, alphas))

    assert area(0.5) > 3.0 * area(0.05) > 0.0


@pytest.mark.parametrize("separated", [1.0, 1.0 + 1e-9, 1.3, 0.0, -1e-9])
def test_lift_and_its_derivative_are_finite_where_the_flow_is_wholly_off_or_on(
    separated: float,
) -> None:
    effect, vehicle, p = FlowSeparation(), SimpleNamespace(**RIGID_VALUES), SimpleNamespace(**STALL)
    s = SimpleNamespace(alpha_air=0.5, alpha_dot=0.0, separated_flow=complex(separated, 1e-30))
    lift = effect.increments(s, vehicle, p)["lift"]
    attached = (
        2.0
        * RIGID_VALUES["mass"]
        * G
        / (RIGID_VALUES["air_density"] * RIGID_VALUES["airspeed"] ** 2 * RIGID_VALUES["wing_area"])
    )
    attached += 0.5 * RIGID_VALUES["CL_alpha"]
    assert np.isfinite(lift.imag / 1e-30)
    assert lift.real == pytest.approx(
        -0.75 * attached if separated > 0.5 else 0.0, rel=0.01, abs=1e-9
    )


def test_far_below_the_stall_nothing_at_all_separates_whatever_the_steepness() -> None:
    """The bit for bit of absence must not hang on a1."""
    flight = rigid_flight(2.0)
    for steepness in (5.0, 300.0):
        gone = {
            "flow-separation.a1": steepness,
            "flow-separation.alpha_star": FlowSeparation.absent["alpha_star"],
        }
        model = rigid_model().with_effects(FlowSeparation()).with_values(gone)
        for got, wanted in zip(
            fly_model(model, flight), fly_model(rigid_model(), flight), strict=True
        ):
            np.testing.assert_array_equal(got, wanted)


def test_it_is_not_looked_for_where_no_wing_stalls() -> None:
    """Eight and a half degrees from zero lift, of which the trim has its share: less, the faster
    the flight.
    """
    for airspeed in (200.0, 300.0):
        values = {**RIGID_VALUES, "airspeed": airspeed}
        trim = (
            2.0
            * values["mass"]
            * G
            / (values["air_density"] * airspeed**2 * values["wing_area"])
            / values["CL_alpha"]
        )
        context = SearchContext(
            0.0, 20.0, 0.02, flown={"alpha": (-0.04, 0.151 - trim)}, values=values
        )
        assert len(FlowSeparation().probes(context)) == 24
        assert not FlowSeparation().probes(replace(context, flown={"alpha": (-0.04, 0.149 - trim)}))
        assert not FlowSeparation().probes(replace(context, flown={}))


def test_a_dynamics_effect_reads_the_rates_that_the_equations_have() -> None:
    """The rate of alpha in the equation of the flow is that of the whole model, lost lift
    included.
    """
    model = (
        rigid_model()
        .with_effects(FlowSeparation())
        .with_values({f"flow-separation.{name}": value for name, value in STALL.items()})
    )
    system = compile_model(model)
    p, x = system.parameters.values().tolist(), [0.08, 0.1, 0.4]
    rates = system.f(0.0, x, [0.02], p)
    assert rates[2] == pytest.approx(-attachment_rate(0.6, 0.08, rates[0]), rel=1e-12)
