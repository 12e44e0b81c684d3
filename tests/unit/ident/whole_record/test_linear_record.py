"""A record with linear equations simulated by matrices against the general way, in which every
interval is integrated by itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

import ident.whole_record.linearise as general
from ident.whole_record.linear_record import LinearisationArrays, linear_record
from ident.whole_record.linearise import Linearisation, linearise
from ident.whole_record.record_problem import (
    RecordProblem,
    inputs_with_changes,
    parameter_increments,
    record_problem,
)
from sim.declaration.compile import compile_model
from sim.declaration.effect import Effect
from sim.declaration.model import Model, System
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.dynamics.control_nonlinearity import ControlNonlinearity
from sim.effects.input_path.input_delay import InputDelay
from sim.effects.sensor_path.sensor_calibration import SensorScale
from sim.effects.sensor_path.sensor_mounting import VaneOffset
from sim.effects.sensor_path.sensor_timing import SensorDelay, SensorLag
from sim.propagation import Step, euler_step, rk4_step
from sim.record import Hold, Record
from tests.linear_problem import Oscillator, oscillator, record_of
from tests.rigid_problem import (
    UNSTABLE,
    ballistic_record,
    ballistic_start,
    rigid_record,
    rigid_start,
)


@dataclass(frozen=True)
class Product(Oscillator):
    """A force times the damping, both of which are sought, and an output that holds their product
    as well.
    """

    def derivatives(self, s: Any, p: Any) -> Sequence[Any]:
        return (
            s.speed + 0.3 * s.push,
            -p.stiffness * s.position
            - p.damping * s.speed
            + s.pull
            + p.force * p.damping
            + p.force * p.force,
        )

    def measurements(self, s: Any, p: Any) -> Sequence[Any]:
        return (
            s.position,
            s.position + 0.5 * s.speed + 0.2 * p.damping * s.pull + p.force * p.stiffness,
            s.speed,
        )


def product() -> Model:
    model = replace(oscillator(), equations=Product())
    return model.with_parameters(model.parameters.release(["stiffness", "damping"]))


def biased() -> Model:
    return rigid_start().with_biases(["alpha", "q", "nz"])


def laid_out(
    record: Record, system: System, max_step: float, step: Step = rk4_step
) -> RecordProblem:
    free = [system.parameters.index(name) for name in system.parameters.free_names]
    return record_problem(record, system, max_step, free[::-1], [1, 0], exact=True, step=step)


def rigid(**changes: Any) -> Record:
    return replace(rigid_record(np.random.default_rng(1), 3.0, 25.0), **changes)


CASES: Mapping[str, tuple[Record, Model, float, Step]] = {
    "rigid": (rigid(), biased(), np.inf, rk4_step),
    "four steps between samples": (rigid(), biased(), 0.01, rk4_step),
    "Euler": (rigid(), biased(), 0.02, euler_step),
    "running away": (
        rigid_record(np.random.default_rng(1), 3.0, 25.0, UNSTABLE),
        rigid_start(values=UNSTABLE),
        np.inf,
        rk4_step,
    ),
    "products of parameters": (record_of(np.random.default_rng(2)), product(), np.inf, rk4_step),
    "nothing sought": (
        rigid(),
        rigid_start().with_parameters(rigid_start().parameters.only_free([])),
        np.inf,
        rk4_step,
    ),
}


EFFECTS: Mapping[str, tuple[Hold, Sequence[Effect]]] = {
    "inputs linear between samples": (Hold.LINEAR, ()),
    "delay of the input sought": (Hold.PREVIOUS, (InputDelay("elevator"),)),
    "delay sought, linear inputs": (Hold.LINEAR, (InputDelay("elevator"),)),
    "sensor lag and delay": (Hold.PREVIOUS, (SensorLag("alpha"), SensorDelay("q"))),
    "products of an effect and a derivative": (
        Hold.LINEAR,
        (VaneOffset(), SensorScale("q"), SensorLag("nz")),
    ),
}
CASES = {
    **CASES,
    **{
        name: (rigid(hold=hold), biased().with_effects(*effects), 0.02, rk4_step)
        for name, (hold, effects) in EFFECTS.items()
    },
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("exact", [True, False])
def test_equal_to_the_general_way(case: str, exact: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    record, model, max_step, step = CASES[case]
    system = compile_model(model)
    problem = replace(laid_out(record, system, max_step, step), exact=exact)
    rng = np.random.default_rng(3)
    p, x0 = system.parameters.values(), np.array([0.02, -0.03])
    p[list(problem.free)] *= rng.uniform(0.8, 1.2, len(problem.free))
    guess = rng.normal(0.0, 0.05, (2, len(problem.grid.nodes)))
    if system.sensor_stages:
        # Between nodes, the two ways follow different trajectories unless the guess is simulated.
        guess = linearise(problem, p, x0, guess).states
    used = fast(problem, p, x0, guess)
    assert used is not None
    found = linearise(problem, p, x0, guess)
    np.testing.assert_array_equal(found.y, used[0])
    monkeypatch.setattr(general, "linear_record", lambda *arguments: None)
    # forward differences of the general way lose half of the digits
    assert_same(found, linearise(problem, p, x0, guess), 1e-11 if exact else 2e-5)


def fast(
    problem: RecordProblem, p: np.ndarray, x0: np.ndarray, guess: np.ndarray
) -> LinearisationArrays | None:
    """Return the result of the fast way; None where it does not apply."""
    increments = parameter_increments(problem)
    inputs = inputs_with_changes(problem, p, increments)
    return linear_record(problem, p, x0, guess, inputs, increments)


def assert_same(found: Linearisation, expected: Linearisation, tolerance: float) -> None:
    for one, other in (
        (found.y, expected.y),
        (found.jacobian, expected.jacobian),
        (found.states, expected.states),
        (found.by_state, expected.by_state),
    ):
        assert one.shape == other.shape
        np.testing.assert_allclose(
            one,
            other,
            rtol=0.0,
            atol=tolerance * max(1.0, float(np.max(np.abs(other), initial=0.0))),
        )


def test_a_parameter_moved_after_laying_out_is_seen() -> None:
    """A held value that a caller changes makes another table."""
    record, system = rigid(), compile_model(rigid_start())
    problem, guess = laid_out(record, system, np.inf), np.zeros((2, len(record)))
    p = system.parameters.values()
    first = linearise(problem, p, np.zeros(2), guess)
    p[system.parameters.index("mass")] *= 1.5
    assert np.max(np.abs(linearise(problem, p, np.zeros(2), guess).y - first.y)) > 1e-4


def test_what_goes_the_general_way() -> None:
    uneven = record_of(np.random.default_rng(2), uneven=True)
    for record, model in [
        (ballistic_record(np.random.default_rng(0)), ballistic_start()),
        (rigid(), rigid_start().with_effects(ControlNonlinearity())),
        (rigid(), rigid_start().with_effects(UnmeasuredInput())),
        (uneven, oscillator()),
    ]:
        system = compile_model(model)
        problem = laid_out(record, system, 0.02)
        p = system.parameters.values()
        guess = np.zeros((2, len(problem.grid.nodes)))
        assert fast(problem, p, system.initial.values(), guess) is None


@dataclass(frozen=True)
class DeadBand(Oscillator):
    """A spring with a dead band of a width that is sought: linear only where the width is zero."""

    def derivatives(self, s: Any, p: Any) -> Sequence[Any]:
        beyond = np.sign(np.real(s.position)) * np.maximum(
            np.abs(np.real(s.position)) - np.real(p.damping), 0.0
        )
        return (s.speed + 0.3 * s.push, -p.stiffness * beyond + s.pull)


@pytest.mark.parametrize("width", [0.0, 0.01])
def test_an_unknown_that_makes_equations_nonlinear_is_noticed(width: float) -> None:
    """At a width of zero the equations are linear, but not with the width changed by a step."""
    base = oscillator()
    parameters = base.parameters.release(["damping"]).with_values({"damping": width})
    system = compile_model(replace(base, equations=DeadBand()).with_parameters(parameters))
    problem = replace(laid_out(record_of(np.random.default_rng(2)), system, 0.05), exact=False)
    guess = np.ones((2, len(problem.grid.nodes)))
    assert fast(problem, system.parameters.values(), np.zeros(2), guess) is None
