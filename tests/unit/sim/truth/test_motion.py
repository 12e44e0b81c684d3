"""Motion to a tolerance: against a solver at the end of double precision, piece by piece, for every
kind of vehicle and input.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim.declaration import own_model
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, Noise
from sim.effects.dynamics.derivative_jump import DerivativeJump
from sim.effects.input_path.input_delay import InputDelay
from sim.effects.sensor_path.sensor_timing import SensorLag
from sim.errors import ModelError
from sim.maneuvers import Maneuver, Sum, Sweep, schroeder_multisine, three_two_one_one
from sim.maths import cos
from sim.propagation import rk4_step
from sim.truth.flight import (
    EXACT,
    INTEGRATION_TOLERANCE,
    SMOOTH,
    Truth,
    fly,
    motion_to_tolerance,
    sample_times,
)
from sim.truth.measurement import Measurement
from sim.vehicles.factory import model_of
from sim.vehicles.library import read_parameter_set

TIME = sample_times(50.0, 8.0)
STEPS = three_two_one_one(0.05, 0.50037, 1.00021)
UNEVEN = np.cumsum(np.tile([0.01, 0.05, 0.3], 20))


def vehicle(name: str) -> Model:
    return model_of(read_parameter_set(name)).with_noise(Noise())


def flown(
    model: Model, by_input: dict[str, Maneuver], time: np.ndarray = TIME, **wishes: Any
) -> Truth:
    return fly(
        model, by_input, time, np.random.default_rng(0), measurement=Measurement(std={}), **wishes
    )[1]


def reference(
    model: Model, by_input: dict[str, Maneuver], time: np.ndarray, further: tuple[float, ...] = ()
) -> np.ndarray:
    """States ``(n, N)`` by an explicit method of order 8 at 1e-13, begun anew at each sample and
    each break.
    """
    system = compile_model(model)
    moves = [by_input.get(name, Sum()) for name in system.input_names]
    breaks = {at for at in (*Sum(tuple(moves)).breakpoints, *further) if time[0] < at < time[-1]}
    cuts = np.unique([*time.tolist(), *breaks])
    p, x = system.parameters.values().tolist(), np.array(system.initial.values())
    found = {float(time[0]): x}
    for begin, end in pairwise(cuts.tolist()):

        def rates(t: float, x: np.ndarray, begin: float = begin, end: float = end) -> list[float]:
            # A touch inside, so that no piece sees what comes before or after a break at its end.
            inside = min(max(t, begin + 2e-9 * (begin in breaks)), end - 2e-9 * (end in breaks))
            return system.f(t, x.tolist(), [float(move(inside)) for move in moves], p)

        x = solve_ivp(rates, (begin, end), x, method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
        found[end] = x
    return np.array([found[float(t)] for t in time]).T


def error(truth: Truth, expected: np.ndarray) -> float:
    """Largest difference of a state, by the largest value of it or, where it is at rest, of its
    neighbours.
    """
    found = np.array(list(truth.states.values()))
    size = np.abs(expected - expected[:, :1]).max(axis=1)
    return float(
        np.max(np.abs(found - expected).max(axis=1) / np.where(size > 0, size, size.max()))
    )


SWEEP = Sweep(0.02, 0.5, 6.0, 6.0, start=1.0)
FLIGHTS: dict[str, tuple[str, dict[str, Maneuver], np.ndarray, str]] = {
    "rigid": ("bomber_rigid", {"elevator": STEPS}, TIME, EXACT),
    "rigid, sweep": ("bomber_rigid", {"elevator": SWEEP}, TIME, EXACT),
    "rigid, uneven": ("bomber_rigid", {"elevator": STEPS}, UNEVEN, EXACT),
    "rigid, at one sample a second": ("bomber_rigid", {"elevator": SWEEP}, np.arange(9.0), EXACT),
    "flexible": ("bomber_ac2", {"elevator": STEPS}, TIME, EXACT),
    "lateral": (
        "navion_lateral",
        {"aileron": STEPS, "rudder": schroeder_multisine(0.01, 8.0, [1, 3, 7])},
        TIME,
        EXACT,
    ),
    "longitudinal": ("navion_longitudinal", {"elevator": STEPS}, TIME, SMOOTH),
    "longitudinal, smooth": (
        "navion_longitudinal",
        {"elevator": Sum((STEPS, SWEEP))},
        TIME,
        SMOOTH,
    ),
    "falling body": ("ballistic_target", {}, sample_times(10.0, 30.0), SMOOTH),
}


@pytest.mark.sampled
@pytest.mark.parametrize("case", FLIGHTS)
def test_motion_is_that_of_a_solver_at_the_end_of_double_precision(case: str) -> None:
    name, by_input, time, method = FLIGHTS[case]
    model = vehicle(name)
    truth = flown(model, by_input, time)
    assert (truth.method, truth.step) == (method, None)
    assert error(truth, reference(model, by_input, time)) < (
        INTEGRATION_TOLERANCE if method == SMOOTH else 1e-11
    )


@pytest.mark.sampled
@pytest.mark.parametrize(("bent", "method"), [(0.0, EXACT), (1e-7, SMOOTH), (1e-3, SMOOTH)])
def test_a_spring_that_stiffens_by_a_ten_millionth_is_not_taken_for_linear(
    bent: float, method: str
) -> None:
    model = own_model(
        "spring",
        states={"x": "m", "v": "m/s"},
        inputs={"force": "m/s2"},
        outputs={"x": "m"},
        parameters={"stiffness": (4.0, "1/s2")},
        rates=lambda s, p: {"x": s.v, "v": s.force - p.stiffness * s.x - bent * s.x * s.x * s.x},
        readings=lambda s, p: {"x": s.x},
    ).with_noise(Noise())
    push: dict[str, Maneuver] = {"force": three_two_one_one(4.0, 0.5, 1.0)}
    truth = flown(model, push)
    assert truth.method == method
    assert error(truth, reference(model, push, TIME)) < INTEGRATION_TOLERANCE


def test_outputs_are_those_of_the_motion_just_after_a_switch() -> None:
    model = vehicle("bomber_rigid")
    truth, system = flown(model, {"elevator": STEPS}), compile_model(model)
    x, u = list(truth.states.values()), [STEPS(TIME)]
    for name, row in zip(
        system.output_names, system.h(TIME, x, u, system.parameters.values().tolist()), strict=True
    ):
        np.testing.assert_array_equal(truth.outputs[name], row)


def test_what_jumps_in_time_is_no_constant_coefficient() -> None:
    at, width = 2.5037, 0.01
    model = vehicle("bomber_rigid")
    model = model.with_effects(DerivativeJump()).with_values(
        {"derivative-jump.time": at, "derivative-jump.Cm_alpha": 0.8}
    )
    truth = flown(model, {"elevator": STEPS})
    assert truth.method == SMOOTH
    assert (
        error(
            truth, reference(model, {"elevator": STEPS}, TIME, (at - width / 2.0, at + width / 2.0))
        )
        < 1e-7
    )


def test_sensor_with_memory_sees_the_motion_between_samples() -> None:
    model = (
        vehicle("bomber_rigid")
        .with_effects(SensorLag("q"))
        .with_values({"sensor-lag:q.time_constant": 0.05})
    )
    truth, stepped = (
        flown(model, {"elevator": STEPS}),
        flown(model, {"elevator": STEPS}, method=rk4_step, step=0.0005),
    )
    assert truth.method == EXACT
    assert np.max(np.abs(truth.outputs["q"] - stepped.outputs["q"])) < 1e-5 * np.max(
        np.abs(truth.outputs["q"])
    )


def test_what_goes_in_steps_says_so() -> None:
    plain = vehicle("bomber_rigid")
    delayed = plain.with_effects(InputDelay()).with_values({"input-delay.delay": 0.03})
    forced = plain.with_noise(Noise(process_density={"q": 1e-6}))
    for model in (delayed, forced):
        truth = flown(model, {"elevator": STEPS}, step=0.002)
        assert truth.method == "rk4_step"
        assert truth.step == pytest.approx(0.002)


def bent(law: Callable[[list[Any]], list[Any]]) -> Any:
    """A system of the rigid aircraft's signals with rates ``law(x)``."""
    return replace(compile_model(vehicle("bomber_rigid")), f=lambda t, x, u, p: law(list(x)))


@pytest.mark.parametrize(
    "law",
    [
        pytest.param(lambda x: [1.0 + x[0] ** 2, 0.0 * x[1]], id="infinite in finite time"),
        pytest.param(lambda x: [1.0 + 0.0 * x[0], 1.0 / (2.0 - x[0])], id="a pole on the way"),
    ],
)
def test_motion_that_ends_is_left_to_who_says_when(law: Callable[[list[Any]], list[Any]]) -> None:
    system = bent(law)
    assert motion_to_tolerance(system, system.parameters.values().tolist(), (STEPS,), TIME) is None


def test_weak_curvature_is_not_taken_for_a_line() -> None:
    system = bent(lambda x: [x[1], -x[0] + 1e-6 * cos(x[0])])
    found = motion_to_tolerance(system, system.parameters.values().tolist(), (STEPS,), TIME)
    assert found is not None
    assert found.method == SMOOTH


def test_diverging_flight_is_refused_with_its_time() -> None:
    model = vehicle("navion_longitudinal")
    model = model.with_initial(model.initial.with_values({"airspeed": 0.0}))
    with pytest.raises(ModelError, match="diverges at"):
        flown(model, {"elevator": STEPS})
