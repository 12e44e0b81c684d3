"""Ends of sub-steps and instants within them: what a sensor with memory is fed, where a gap begins,
which time the rates see.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from sim.declaration.compile import compile_model
from sim.effects.input_path.input_delay import InputDelay
from sim.effects.sensor_path.sensor_timing import SensorLag
from sim.maths import complex_step_jacobian
from sim.propagation import (
    INPUT_CELL_TIME,
    drive_from_record,
    euler_step,
    make_grid,
    propagate,
    rk4_step,
)
from sim.record import Hold
from tests.bases import Flight, fly, rigid_model


def test_ends_of_a_delayed_line_are_those_of_the_line_there() -> None:
    # A corner within the record: what the delay changes differs from cell to cell of a sub-step.
    time, delay = np.arange(51) * 0.02, 0.063
    corner = 3.0 * np.maximum(time - 0.2, 0.0)
    system = compile_model(rigid_model().with_effects(InputDelay()))
    p = [float(value) for value in system.parameters.values()]
    p[system.parameters.index("input-delay.delay")] = delay
    grid = make_grid(time, 0.01)
    drive = drive_from_record(system, p, corner[None], time, Hold.LINEAR, grid)
    expected = 3.0 * np.maximum(grid.edges - delay - 0.2, 0.0)
    # A value at an edge is taken from the mean over the cell beside it.
    np.testing.assert_allclose(
        drive.begin[0], expected, rtol=0.0, atol=1.01 * 3.0 * INPUT_CELL_TIME
    )
    np.testing.assert_allclose(
        drive.end[0], expected[1:], rtol=0.0, atol=1.01 * 3.0 * INPUT_CELL_TIME
    )


def test_a_lagging_sensor_is_fed_the_input_before_its_switch() -> None:
    # nz jumps with the elevator; the lag sees it jump at the sample, not rise over the sub-step
    # before.
    lag, step, time = 0.05, 0.01, np.arange(61) * 0.02
    model = rigid_model().with_effects(SensorLag("nz"))
    system = compile_model(model)
    p = [float(value) for value in system.parameters.values()]
    p[system.parameters.index("sensor-lag:nz.time_constant")] = lag
    u = 0.1 * np.sign(np.sin(7.0 * time + 0.1))
    found = fly(system, Flight(time, u[None], Hold.PREVIOUS, step), p)[2]
    # Exact: aircraft and lag as one linear system, held input.
    plain = compile_model(rigid_model())
    q = [float(value) for value in plain.parameters.values()]
    A = complex_step_jacobian(lambda z: plain.f(0.0, z[:2], z[2:], q), [0.0, 0.0, 0.0])
    C = complex_step_jacobian(lambda z: plain.h(0.0, z[:2], z[2:], q), [0.0, 0.0, 0.0])[2]
    block = np.zeros((4, 4))
    block[:2, [0, 1, 3]] = A
    block[2, [0, 1, 3]], block[2, 2] = C / lag, -1.0 / lag
    jump, state, exact = expm(block * 0.02), np.zeros(4), []
    state[2], state[3] = C[2] * u[0], u[0]  # settled at the start
    for value in u:
        state[3] = value
        exact.append(state[2])
        state = jump @ state
    # Between edges the lag takes nz as straight: off by h^2/8 of its curvature, here 4e-5 of the
    # jump; half a sub-step early would be 0.1.
    np.testing.assert_allclose(found, exact, rtol=0.0, atol=2e-3 * abs(C[2]) * 0.2)


@pytest.mark.parametrize(("gap", "nodes"), [(1.4, 5), (1.6, 6), (2.9, 6), (3.1, 7)])
def test_a_gap_begins_at_one_and_a_half_of_the_usual_interval(gap: float, nodes: int) -> None:
    time = np.array([0.0, 1.0, 2.0, 2.0 + gap, 3.0 + gap])
    assert len(make_grid(time, 5.0).nodes) == nodes


@pytest.mark.parametrize("step", [euler_step, rk4_step])
def test_rates_see_the_time_of_their_own_sub_step(step: Any) -> None:
    # x_dot = t^3: four stages integrate it exactly, Euler sums the rates at the beginnings.
    system = compile_model(rigid_model())
    grid = make_grid(3.0 + np.arange(9) * 0.25, 0.125)
    drive = drive_from_record(system, [], np.zeros((0, 9)), grid.nodes, Hold.PREVIOUS, grid)
    found = propagate(replace(system, f=lambda t, x, u, p: [t**3]), [], [0.0], drive, grid, step)[0]
    exact, summed = (
        (grid.edges**4 - 3.0**4) / 4.0,
        np.concatenate([[0.0], np.cumsum(grid.edges[:-1] ** 3 * grid.steps)]),
    )
    np.testing.assert_allclose(found, exact if step is rk4_step else summed, rtol=1e-13, atol=1e-12)
