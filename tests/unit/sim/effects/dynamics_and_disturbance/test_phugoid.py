"""The phugoid against equations written in forces and moments, its forms with a recorded attitude
or airspeed, and its frequency.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim.declaration.compile import compile_model
from sim.declaration.effect import Signal
from sim.declaration.model import Model
from sim.declaration.proposal import SearchContext
from sim.effects.disturbance.airspeed import Phugoid, SpeedVariation
from sim.maths import complex_step_jacobian
from tests.bases import RIGID_VALUES, Flight, fly, fly_model, rigid_flight, rigid_model

G = 9.80665
VALUES = {"attitude": 0.12, "speed_damping": 0.02, "induced_drag": 4.0, "trim_moment": 0.03}


def in_forces(flight: Flight, values: dict[str, float]) -> np.ndarray:
    """alpha, q, nz, speed and attitude ``(5, N)`` from lift, weight and moments in newtons, held
    inputs, no port and no coefficient shared.
    """
    v = RIGID_VALUES
    m, S, c, Iy, rho, V0 = (
        v[name]
        for name in ("mass", "wing_area", "chord", "pitch_inertia", "air_density", "airspeed")
    )

    def lift_and_moment(x: np.ndarray, e: float) -> tuple[float, float]:
        alpha, q, u = x[:3]
        V = V0 + u
        pressure, trim = 0.5 * rho * V * V, 0.5 * rho * V0 * V0
        rate = q * c / (2.0 * V)
        lift = (
            pressure * S * (v["CL_alpha"] * alpha + v["CL_q"] * rate + v["CL_de"] * e)
            + m * G * pressure / trim
        )
        engines = -values["trim_moment"] * trim * S * c
        air = (
            pressure
            * S
            * c
            * (v["Cm_alpha"] * alpha + v["Cm_q"] * rate + v["Cm_de"] * e + values["trim_moment"])
        )
        return lift, air + engines

    def rates(t: float, x: np.ndarray, e: float) -> Any:
        alpha, q, u, theta = x
        lift, moment = lift_and_moment(x, e)
        path = theta - alpha
        drag = values["speed_damping"] * u + values["induced_drag"] * alpha
        return q - (lift - m * G) / (m * (V0 + u)), moment / Iy, -G * path - drag, q

    x, out = np.array([0.0, 0.0, 0.0, values["attitude"]]), []
    for k, (a, b) in enumerate(
        zip(flight.time, np.append(flight.time[1:], flight.time[-1] + 0.02), strict=True)
    ):
        e = float(flight.u[0][k])
        out.append([x[0], x[1], (lift_and_moment(x, e)[0] - m * G) / (m * G), x[2], x[3]])
        x = solve_ivp(rates, (a, b), x, args=(e,), method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
    return np.array(out).T


def model_with(effect: Phugoid, **values: float) -> Any:
    return (
        rigid_model()
        .with_effects(effect)
        .with_values({f"phugoid.{name}": value for name, value in values.items()})
    )


def recording(signal: Signal) -> Model:
    """The rigid aircraft with a further input."""
    model = rigid_model()
    equations: Any = model.equations
    return replace(model, equations=replace(equations, inputs=(*equations.inputs, signal)))


def test_is_the_motion_of_forces_and_moments() -> None:
    flight = replace(rigid_flight(8.0, 50.0), max_step=0.005)
    expected = in_forces(flight, VALUES)
    got = fly_model(model_with(Phugoid(), **VALUES), flight)
    assert np.max(np.abs(expected[3])) > 2.0, "the speed changes enough to be tested"
    for row, truth, least in zip(got, expected, (1e-5, 1e-5, 1e-4), strict=False):
        np.testing.assert_allclose(row, truth, rtol=0.0, atol=least * 0.1)


def test_recorded_states_take_the_place_of_its_own() -> None:
    flight = replace(rigid_flight(8.0, 50.0), max_step=0.02)
    truth = in_forces(flight, VALUES)
    plain = fly_model(model_with(Phugoid(), **VALUES), flight)
    context = SearchContext(0.0, 8.0, 0.02, input_peak={"elevator": 0.1, "theta": 0.1})
    effect = Phugoid().fitted_to(context)
    assert effect.name == "phugoid" and [state.name for state in effect.states] == ["phugoid_speed"]
    wider = recording(Signal("theta", "rad"))
    # Inputs are held: the attitude over an interval is its mean there.
    theta = truth[4] - truth[4][0]
    held = np.append(0.5 * (theta[1:] + theta[:-1]), theta[-1])
    values = {f"phugoid.{name}": value for name, value in VALUES.items()}
    system = compile_model(wider.with_effects(effect).with_values(values))
    got = fly(system, replace(flight, u=np.vstack([flight.u, held])))
    for row, expected in zip(got, plain, strict=True):
        np.testing.assert_allclose(row, expected, rtol=0.0, atol=2e-3 * np.max(np.abs(expected)))


def test_a_recorded_airspeed_leaves_the_trim_moment_to_find() -> None:
    effect = Phugoid().fitted_to(
        SearchContext(0.0, 8.0, 0.02, input_peak={"airspeed_change": 4.0, "lift": 0.1})
    )
    assert (
        effect.states == ()
        and [item.name for item in effect.parameters] == ["trim_moment"]
        and effect.absent == {"trim_moment": 0.0}
    )
    wider = recording(
        next(port for port in rigid_model().equations.ports if port.name == "airspeed_change")
    )
    system = compile_model(wider.with_effects(effect).with_values({"phugoid.trim_moment": 0.03}))
    names, p = system.state_names, system.parameters.values().tolist()
    V0, u = RIGID_VALUES["airspeed"], 6.0
    without = compile_model(wider)
    expected = dict(
        zip(
            names,
            without.f(0.0, [0.0, 0.0], [0.0, u], without.parameters.values().tolist()),
            strict=True,
        )
    )
    got = dict(zip(names, system.f(0.0, [0.0, 0.0], [0.0, u], p), strict=True))
    v = RIGID_VALUES
    moment = 0.5 * v["air_density"] * ((V0 + u) ** 2 - V0**2) * v["wing_area"] * v["chord"] * 0.03
    assert got["q"] - expected["q"] == pytest.approx(moment / v["pitch_inertia"], rel=1e-12)
    assert got["alpha"] == expected["alpha"]


def test_a_steady_deceleration_is_an_attitude() -> None:
    flight = replace(rigid_flight(6.0, 50.0), u=np.zeros((1, 300)), max_step=0.02)
    held = dict.fromkeys(("speed_damping", "induced_drag", "trim_moment"), 0.0)
    climbing = fly_model(model_with(Phugoid(), attitude=0.02, **held), flight)
    slowing = fly_model(
        rigid_model()
        .with_effects(SpeedVariation())
        .with_values({"speed-variation.rate": -0.02 * G}),
        flight,
    )
    size = np.max(np.abs(slowing[2]))
    # Until the path itself bends, which takes the time of the phugoid.
    np.testing.assert_allclose(climbing[2][:50], slowing[2][:50], rtol=0.0, atol=0.02 * size)


def test_long_run_frequency_is_lanchesters() -> None:
    system = compile_model(
        model_with(Phugoid(), speed_damping=0.0, induced_drag=0.0, trim_moment=0.0, attitude=0.0)
    )
    p = system.parameters.values().tolist()
    F = complex_step_jacobian(lambda x: system.f(0.0, x, [0.0], p), [0.0] * 4)
    slowest = min((root for root in np.linalg.eigvals(F) if root.imag > 1e-9), key=abs)
    # Lanchester's, at constant angle of attack; the short period's finite stiffness lowers it.
    assert abs(slowest) == pytest.approx(math.sqrt(2.0) * G / RIGID_VALUES["airspeed"], rel=0.15)
