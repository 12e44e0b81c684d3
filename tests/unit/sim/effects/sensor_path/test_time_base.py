"""A wrong clock, against flights on their own time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.declaration.compile import compile_model
from sim.effects.disturbance.gusts import GustTurbulence
from sim.effects.input_path.actuator import ActuatorLag
from sim.effects.library import find_effect
from sim.effects.sensor_path.sensor_calibration import SensorScale
from sim.effects.sensor_path.sensor_timing import SensorLag, TimeBase
from sim.vehicles.uncoupled import Loes, ShortPeriod
from tests.bases import Flight, fly_model, loes_flight, loes_model, rigid_flight, rigid_model

FAST = {"time-base.factor": 1.07}


def test_the_record_is_the_flight_on_another_time() -> None:
    """Recorded rows are those of the flight; only the times that stand beside them are longer."""
    for model, flight in (
        (rigid_model(), rigid_flight()),
        (loes_model({**LOES_WITHOUT_DELAY}), loes_flight()),
    ):
        recorded = Flight(1.07 * flight.time, flight.u, max_step=1.07 * flight.max_step)
        got = fly_model(model.with_effects(TimeBase()).with_values(FAST), recorded)
        for row, expected in zip(got, fly_model(model, flight), strict=True):
            np.testing.assert_allclose(
                row, expected, rtol=0.0, atol=1e-9 * np.max(np.abs(expected))
            )


LOES_WITHOUT_DELAY = {
    "L_alpha": -1.9,
    "M_alpha": -12.4,
    "L_delta": -2e-3,
    "M_delta": 0.32,
    "L_q": 1.01,
    "M_q": -3.0,
    "inv_tau": 10.6,
    "delay": 0.0,
}


def test_states_of_the_vehicle_and_of_effects_in_it_go_slower_and_those_of_the_recorder_do_not() -> (  # noqa: E501
    None
):
    mode = find_effect("elastic-mode", ShortPeriod())
    model = rigid_model().with_effects(mode, ActuatorLag(), SensorLag("q"), TimeBase())
    x, u = [0.02, 0.1, 0.01, 0.3, 0.04, 0.06], [0.05]
    rates = []
    for factor in (1.0, 2.0):
        system = compile_model(model.with_values({"time-base.factor": factor}), online=True)
        rates.append(np.array(system.f(0.0, x, u, system.parameters.values().tolist())))
    names = system.state_names
    outside = [
        names.index(name)
        for name in names
        if name not in ("alpha", "q", "bending_1", "bending_rate_1")
    ]
    inside = [i for i in range(len(names)) if i not in outside]
    np.testing.assert_array_equal(rates[1][inside], 0.5 * rates[0][inside])
    np.testing.assert_array_equal(rates[1][outside], rates[0][outside])


def test_random_forcing_has_less_time_to_act() -> None:
    model = rigid_model().with_effects(GustTurbulence(), TimeBase())
    densities = []
    for factor in (1.0, 2.0):
        system = compile_model(model.with_values({"time-base.factor": factor}))
        densities.append(np.array(system.noise(system.parameters.values().tolist())[0]))
    assert densities[0].max() > 0.0
    np.testing.assert_array_equal(densities[1], 0.5 * densities[0])


def test_it_is_an_angle_of_attack_read_too_small_with_other_derivatives() -> None:
    """Exact twins: CL_alpha, Cm_alpha and the others scale, alpha, q and nz are the same to
    rounding.
    """
    k, flight = 1.07, replace(rigid_flight(), max_step=0.005)
    model = rigid_model()
    given = model.parameters
    clock = fly_model(model.with_effects(TimeBase()).with_values(FAST), flight)
    others = {"CL_alpha": 1.0 / k, "Cm_alpha": k**-2, "Cm_q": 1.0 / k, "Cm_de": 1.0 / k}
    others = {name: factor * given[name].value for name, factor in others.items()}
    twin = model.with_effects(SensorScale("alpha")).with_values(
        {"sensor-scale:alpha.scale": 1.0 / k, **others}
    )
    for got, expected in zip(fly_model(twin, flight), clock, strict=True):
        np.testing.assert_allclose(got, expected, rtol=0.0, atol=1e-8 * np.max(np.abs(expected)))


def test_it_is_offered_where_an_airspeed_is_given_and_filters_take_it() -> None:
    assert find_effect("time-base", ShortPeriod()) == find_effect("time-base", Loes()) == TimeBase()
    system = compile_model(rigid_model().with_effects(TimeBase()), online=True)
    assert system.state_names == ("alpha", "q")
    assert "time-base.factor" not in system.output_parameters | system.input_parameters
