"""A record simulated by the matrices of its table against the general way: every interval by
itself, derivatives by complex steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

import ident.whole_record.linearise as general
from ident.whole_record.linear_record import linear_record
from ident.whole_record.linearise import Linearisation, linearise
from ident.whole_record.record_problem import RecordProblem, record_problem
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, System
from sim.effects.input_path.input_delay import InputDelay
from sim.effects.sensor_path.sensor_timing import SensorLag
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


@pytest.mark.parametrize("case", CASES)
def test_equal_to_the_general_way(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    record, model, max_step, step = CASES[case]
    system = compile_model(model)
    problem = laid_out(record, system, max_step, step)
    rng = np.random.default_rng(3)
    p, x0 = system.parameters.values(), np.array([0.02, -0.03])
    p[list(problem.free)] *= rng.uniform(0.8, 1.2, len(problem.free))
    guess = rng.normal(0.0, 0.05, (2, len(problem.grid.nodes)))
    found = linearise(problem, p, x0, guess)
    by_table = linear_record(problem, p, x0, guess)
    assert by_table is not None
    np.testing.assert_array_equal(found.y, by_table[0])
    monkeypatch.setattr(general, "linear_record", lambda *arguments: None)
    assert_same(found, linearise(problem, p, x0, guess))


def assert_same(found: Linearisation, expected: Linearisation) -> None:
    for one, other in (
        (found.y, expected.y),
        (found.jacobian, expected.jacobian),
        (found.states, expected.states),
        (found.by_state, expected.by_state),
    ):
        assert one.shape == other.shape
        np.testing.assert_allclose(
            one, other, rtol=0.0, atol=1e-11 * max(1.0, float(np.max(np.abs(other), initial=0.0)))
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
    delay = rigid_start().with_effects(InputDelay("elevator"))
    uneven = record_of(np.random.default_rng(2), uneven=True)
    for record, model in [
        (rigid(hold=Hold.LINEAR), rigid_start()),
        (rigid(), delay),
        (rigid(), rigid_start().with_effects(SensorLag("alpha"))),
        (ballistic_record(np.random.default_rng(0)), ballistic_start()),
        (uneven, oscillator()),
    ]:
        system = compile_model(model)
        problem = laid_out(record, system, 0.02)
        assert (
            linear_record(
                problem,
                system.parameters.values(),
                system.initial.values(),
                np.zeros((2, len(problem.grid.nodes))),
            )
            is None
        )
    held = delay.with_parameters(delay.parameters.hold(["input-delay.delay"]))
    system = compile_model(held)
    problem = laid_out(rigid(), system, 0.02)
    guess = np.zeros((2, len(problem.grid.nodes)))
    assert linear_record(problem, system.parameters.values(), np.zeros(2), guess) is not None
    wider = replace(problem, free=(*problem.free, system.parameters.index("mass")))
    assert linear_record(wider, system.parameters.values(), np.zeros(2), guess) is None, (
        "a held parameter that is sought after all"
    )
