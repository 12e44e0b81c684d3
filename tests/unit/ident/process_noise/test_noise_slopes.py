"""Slopes of process noise: against differences of the process noise itself, smooth motion and one
with a kink.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from ident.process_noise import likelihood_slopes as module
from ident.process_noise.likelihood_slopes import NoiseSlopes, noise_slopes, slope_pairs
from ident.process_noise.linear_noise import Variation, discrete_motion, discretised_noise
from ident.whole_record.record_problem import RecordProblem, record_problem
from sim.declaration.compile import compile_model
from sim.declaration.effect import Parameter, ParameterSet
from sim.declaration.model import Model, Noise
from sim.record import Channel, Record
from tests.linear_problem import STD, Oscillator

Input = Callable[[np.ndarray], np.ndarray]
INPUTS: Mapping[str, Input] = {
    "slow": lambda time: np.sin(0.7 * time),
    "stepping": lambda time: np.sign(np.sin(0.7 * time)),
    "fast": lambda time: np.sin(30.0 * time),
}


@dataclass(frozen=True)
class Stiffened(Oscillator):
    """The oscillator, whose stiffness goes with an input: what is linearised changes along the
    record.
    """

    name: str = "stiffened"

    def derivatives(self, s: Any, p: Any) -> Sequence[Any]:
        return s.speed, -p.stiffness * (1.0 + 0.2 * s.pull) * s.position - p.damping * s.speed


def problem_with(pull: Input, samples: int = 300) -> RecordProblem:
    parameters = ParameterSet(
        (
            Parameter("stiffness", 3.0, "1/s2"),
            Parameter("damping", 0.4, "1/s"),
            Parameter("force", 0.0, "m/s2", free=False),
        )
    )
    initial = ParameterSet((Parameter("position", 0.2, "m"), Parameter("speed", -0.1, "m/s")))
    system = compile_model(Model(Stiffened(), parameters, initial, Noise(STD, {"speed": 0.4})))
    time = 0.02 * np.arange(samples)
    inputs = (Channel.of("pull", "m/s2", pull(time)), Channel.of("push", "m/s", np.zeros(samples)))
    return record_problem(
        Record(time, inputs, tuple(Channel.of(name, "m", np.zeros(samples)) for name in STD)),
        system,
        0.05,
        (),
        (),
    )


def slopes_of(problem: RecordProblem) -> NoiseSlopes:
    at = Variation(problem.system.parameters.values(), 1.0)
    pairs = slope_pairs(at, [0, 1], [3.0, 0.4], True)
    return noise_slopes(problem, np.zeros((2, len(problem.grid.nodes))), at, pairs)


@pytest.mark.parametrize("kind", INPUTS)
def test_slopes_are_differences_of_the_process_noise(kind: str) -> None:
    problem = problem_with(INPUTS[kind])
    slopes, states, step = slopes_of(problem), np.zeros((2, len(problem.grid.nodes))), 1e-4
    assert slopes.positions == (0, 1, 2)
    for i, (low, high, width) in enumerate(
        slope_pairs(
            Variation(problem.system.parameters.values(), 1.0),
            [0, 1],
            [3e5 * step, 4e4 * step],
            True,
        )
    ):
        ends = [discretised_noise(problem, states, one) for one in (low, high)]
        for name in ("Phi", "Q"):
            expected = (getattr(ends[1], name) - getattr(ends[0], name)) / width
            found = getattr(slopes.motion, name)[:, i]
            assert found == pytest.approx(
                np.broadcast_to(expected, found.shape),
                abs=2e-3 * max(float(np.max(np.abs(expected))), 1e-9),
            )


@pytest.mark.parametrize("kind", INPUTS)
def test_straight_lines_stand_for_what_bends_little_alone(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    places: list[int] = []

    def counted(F: np.ndarray, *rest: Any) -> Any:
        places.append(len(F))
        return discrete_motion(F, *rest)

    monkeypatch.setattr(module, "discrete_motion", counted)
    slopes_of(problem_with(INPUTS[kind]))
    assert places == ([39] if kind == "slow" else [299])


def test_few_steps_are_all_worked_out(monkeypatch: pytest.MonkeyPatch) -> None:
    few = slopes_of(problem_with(INPUTS["slow"], 12))
    monkeypatch.setattr(module, "_STEPS_BETWEEN_SLOPES", 1000)
    assert np.array_equal(few.motion.Phi, slopes_of(problem_with(INPUTS["slow"], 12)).motion.Phi)
