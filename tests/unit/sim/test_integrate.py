"""Integrators by their measured order, inputs by the matrix exponential, batches one by one, delays
by shifts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from sim.declaration.compile import compile_model
from sim.declaration.model import System
from sim.effects.input_path.input_delay import InputDelay
from sim.effects.sensor_path.sensor_timing import SensorLag
from sim.maths import COMPLEX_STEP, complex_step_jacobian, cos
from sim.propagation import Step, drive_from_record, euler_step, make_grid, propagate, rk4_step
from sim.record import Hold
from tests.bases import Flight, ballistic_flight, ballistic_model, fly, rigid_flight, rigid_model

RIGID = compile_model(rigid_model())
FALL = compile_model(ballistic_model())


def values(system: System) -> list[Any]:
    return [float(value) for value in system.parameters.values()]


def orders(errors: list[float]) -> np.ndarray:
    return np.log2(np.divide(errors[:-1], errors[1:]))


@pytest.mark.parametrize(
    ("step", "order", "sizes"),
    [(euler_step, 1, (0.025, 0.0125, 0.00625)), (rk4_step, 4, (0.25, 0.125, 0.0625))],
)
def test_integrators_have_their_order_on_the_falling_body(
    step: Step, order: int, sizes: tuple[float, ...]
) -> None:
    p = values(FALL)
    x0 = [30000.0, -1800.0]
    flight = Flight(np.array([0.0, 5.0, 10.0]), np.zeros((0, 3)))
    reference = solve_ivp(
        lambda t, x: FALL.f(t, list(x), [], p),
        (0.0, 10.0),
        x0,
        method="DOP853",
        rtol=1e-13,
        atol=1e-12,
    ).y[0, -1]
    errors = [
        abs(float(fly(FALL, replace(flight, max_step=size), p, list(x0), step)[0][-1]) - reference)
        for size in sizes
    ]
    np.testing.assert_allclose(orders(errors), order, atol=0.25)


@pytest.mark.parametrize(("step", "order"), [(euler_step, 1), (rk4_step, 4)])
def test_time_reaches_the_stages_at_their_own_instants(step: Step, order: int) -> None:
    # x_dot = t^3 is integrated exactly by four stages in time, to first order by one.
    def rates(t: Any, x: Any, u: Any, p: Any) -> list[Any]:
        return [t**3]

    (got,) = step(rates, 1.0, [0.0], ([], [], []), [], 0.5)
    assert abs(got - (1.5**4 - 1.0) / 4.0) < (1e-14 if order == 4 else 0.6)
    assert (got == 0.5) is (order == 1)


def linear_response(time: np.ndarray, u: np.ndarray, hold: Hold) -> np.ndarray:
    """Outputs of the rigid aircraft by matrix exponentials: exact for held and for linear
    inputs.
    """
    p = values(RIGID)
    jacobian_f = complex_step_jacobian(lambda z: RIGID.f(0.0, z[:2], z[2:], p), [0.0, 0.0, 0.0])
    jacobian_h = complex_step_jacobian(lambda z: RIGID.h(0.0, z[:2], z[2:], p), [0.0, 0.0, 0.0])
    x, out = np.zeros(2), []
    for k in range(len(time)):
        out.append(jacobian_h @ [*x, u[k]])
        if k + 1 < len(time):
            dt = time[k + 1] - time[k]
            slope = (u[k + 1] - u[k]) / dt if hold is Hold.LINEAR else 0.0
            block = np.zeros((4, 4))
            block[:2, :3], block[2, 3] = jacobian_f, 1.0
            x = (expm(block * dt) @ [*x, u[k], slope])[:2]
    return np.array(out).T


@pytest.mark.parametrize("hold", list(Hold))
def test_held_and_linear_inputs_keep_the_order_of_the_integrator(hold: Hold) -> None:
    time = np.concatenate([np.arange(40) * 0.05, [2.3, 2.31, 2.5, 3.4]])
    u = 0.1 * np.random.default_rng(1).standard_normal(time.size)
    expected = linear_response(time, u, hold)
    errors, largest = [], []
    for max_step in (0.05, 0.025, 0.0125):
        got = np.array(fly(RIGID, Flight(time, u[None], hold, max_step)))
        errors.append(
            float(np.max(np.abs(got - expected) / np.max(np.abs(expected), axis=1, keepdims=True)))
        )
        largest.append(float(make_grid(time, max_step).steps.max()))
    np.testing.assert_allclose(orders(errors) / orders(largest), 4.0, atol=0.3)
    assert errors[-1] < 1e-8


def test_batches_of_parameters_and_starts_are_one_by_one() -> None:
    flight = rigid_flight(2.0)
    generator = np.random.default_rng(2)
    p = [value * generator.uniform(0.8, 1.2, 4) for value in values(RIGID)]
    alpha = generator.normal(0.0, 0.05, 4)
    together = fly(RIGID, flight, p, [alpha, 0.01])
    for run in range(4):
        alone = fly(RIGID, flight, [float(row[run]) for row in p], [float(alpha[run]), 0.01])
        for got, wanted in zip(together, alone, strict=True):
            assert got.shape == (len(flight.time), 4)
            np.testing.assert_allclose(got[:, run], wanted, rtol=1e-12, atol=1e-15)


def test_a_batch_of_one_parameter_alone_reaches_outputs_that_need_no_state() -> None:
    # nz depends on the mass directly, q not on it in this batch: every row still has all runs.
    p = values(RIGID)
    p[RIGID.parameters.index("CL_de")] = np.array([0.4, 0.5])
    for row in fly(RIGID, rigid_flight(1.0), p):
        assert row.shape == (51, 2)


def test_two_batch_axes_trail() -> None:
    flight = replace(rigid_flight(1.6), max_step=0.02)
    p, p_alone = values(RIGID), values(RIGID)
    at = RIGID.parameters.index("Cm_alpha")
    p[at] = np.array([[-1.5], [-1.7]])
    alpha = np.array([0.0, 0.01, 0.02])
    together = fly(RIGID, flight, p, [alpha, 0.0])
    p_alone[at] = -1.7
    for got, wanted in zip(together, fly(RIGID, flight, p_alone, [0.01, 0.0]), strict=True):
        assert got.shape == (len(flight.time), 2, 3)
        np.testing.assert_allclose(got[:, 1, 1], wanted, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("name", ["CL_alpha", "Cm_q", "Cm_de", "airspeed", "mass"])
def test_complex_steps_through_a_simulation_are_central_differences(name: str) -> None:
    flight, at = rigid_flight(2.0), RIGID.parameters.index(name)
    p = values(RIGID)
    value = p[at]
    p[at] = complex(value, COMPLEX_STEP)
    exact = [row.imag / COMPLEX_STEP for row in fly(RIGID, flight, p)]
    p[at] = value + 1e-5 * abs(value) * np.array([1.0, -1.0])
    for got, pair in zip(exact, fly(RIGID, flight, p), strict=True):
        wanted = (pair[:, 0] - pair[:, 1]) / (2e-5 * abs(value))
        np.testing.assert_allclose(got, wanted, rtol=1e-6, atol=1e-7 * np.max(np.abs(wanted)))


def test_complex_steps_in_the_initial_state_are_differences() -> None:
    flight = replace(ballistic_flight(), max_step=0.1)
    stepped = fly(FALL, flight, x0=[complex(60960.0, COMPLEX_STEP), -1828.8])[0].imag / COMPLEX_STEP
    ahead, back = (fly(FALL, flight, x0=[60960.0 + shift, -1828.8])[0] for shift in (1.0, -1.0))
    np.testing.assert_allclose(stepped, (ahead - back) / 2.0, rtol=1e-5)


def test_a_delay_of_whole_samples_shifts_the_response() -> None:
    flight = rigid_flight(4.0)
    delayed = compile_model(rigid_model().with_effects(InputDelay()))
    p = values(delayed)
    p[delayed.parameters.index("input-delay.delay")] = 0.06
    for late, plain in zip(fly(delayed, flight, p), fly(RIGID, flight), strict=True):
        np.testing.assert_allclose(late[3:], plain[:-3], rtol=0.0, atol=1e-12)
        np.testing.assert_array_equal(late[:3], 0.0)


def test_a_delay_within_a_step_converges_to_the_shifted_switch() -> None:
    # The same switch recorded at its true time on a finer time base is the exact answer.
    time, shift = np.arange(101) * 0.02, 0.0137
    fine = np.sort(np.concatenate([time, [1.0 + shift]]))
    exact = linear_response(fine, 0.1 * (fine >= 1.0 + shift - 1e-12), Hold.PREVIOUS)[
        :, fine != 1.0 + shift
    ]
    delayed = compile_model(rigid_model().with_effects(InputDelay()))
    p = values(delayed)
    p[delayed.parameters.index("input-delay.delay")] = shift
    u = 0.1 * (time >= 1.0 - 1e-12)[None]
    errors = []
    for max_step in (0.02, 0.01, 0.005):
        got = np.array(fly(delayed, Flight(time, u, max_step=max_step), p))
        errors.append(
            float(np.max(np.abs(got - exact) / np.max(np.abs(exact), axis=1, keepdims=True)))
        )
    assert errors[0] < 2e-3 and errors[-1] < 1e-4


def test_sensors_without_memory_and_with_a_lag_of_zero_agree() -> None:
    flight = rigid_flight(2.0)
    lagged = compile_model(rigid_model().with_effects(SensorLag("nz")))
    p = values(lagged)
    p[lagged.parameters.index("sensor-lag:nz.time_constant")] = 0.0
    for got, wanted in zip(fly(lagged, flight, p), fly(RIGID, flight), strict=True):
        np.testing.assert_array_equal(got, wanted)


def test_states_at_all_edges_begin_with_the_start_and_carry_the_batch() -> None:
    flight = rigid_flight(1.0)
    grid = make_grid(flight.time, flight.max_step)
    drive = drive_from_record(RIGID, values(RIGID), flight.u, flight.time, flight.hold, grid)
    alpha, q = propagate(RIGID, values(RIGID), [np.array([0.0, 0.1]), 0.02], drive, grid)
    assert alpha.shape == q.shape == (len(grid.edges), 2)
    np.testing.assert_array_equal(alpha[0], [0.0, 0.1])
    np.testing.assert_array_equal(q[0], 0.02)


def test_a_state_that_grows_without_limit_is_returned_as_it_is() -> None:
    # Euler with a step of five seconds overshoots until the exponential of the density overflows.
    p, flight = values(FALL), Flight(np.arange(41) * 5.0, np.zeros((0, 41)), max_step=5.0)
    altitude = fly(FALL, flight, p, [5000.0, -1800.0], euler_step)[0]
    assert np.isfinite(altitude[:2]).all() and not np.isfinite(altitude[-1])
    assert np.isfinite(fly(FALL, flight, p, [60000.0, -1800.0])[0][:5]).all()


def test_a_state_that_runs_away_is_not_finite_from_there_on_and_raises_nothing() -> None:
    """x_dot = x |x| + cos(x) leaves the floats after a second or two; a cosine of infinity is no
    error, a fault of the equations is one.
    """
    grid = make_grid(np.linspace(0.0, 40.0, 41), 0.05)
    drive = drive_from_record(
        FALL, values(FALL), np.zeros((0, 41)), grid.nodes, Hold.PREVIOUS, grid
    )

    def rates(t: Any, x: Any, u: Any, p: Any) -> list[Any]:
        return [x[0] * abs(x[0]) + cos(x[0])]

    away = propagate(replace(FALL, f=rates), [], [1.0], drive, grid)[0]
    assert (
        away[0] == 1.0
        and not np.isfinite(away[-1])
        and np.all(np.diff(np.isfinite(away).astype(int)) <= 0)
    )
    with pytest.raises(ValueError, match="zip"):
        propagate(replace(FALL, f=lambda t, x, u, p: [1.0, 2.0]), [], [1.0], drive, grid)
