"""Random motion through sensors with memory, against states of the motion and exact delays."""

from __future__ import annotations

import numpy as np
import pytest

from ident.process_noise.linear_noise import Variation, discretised_noise, linear_motion
from ident.process_noise.whitener import whitener
from ident.whole_record.record_problem import RecordProblem, record_problem
from sim.declaration.compile import compile_model
from sim.effects.sensor_path.sensor_timing import SensorDelay, SensorHold, SensorLag
from tests.linear_problem import oscillator, record_of

DENSITY = {"speed": 0.4, "position": 0.01}
VARIANCE = np.square([0.05, 0.08, 0.1])


def motion_of(effect, values, *, online=False):
    """The problem, and F and H of its random motion, with one sensor effect."""
    model = oscillator(DENSITY).with_effects(effect)
    model = model.with_values({f"{effect.name}.{name}": value for name, value in values.items()})
    system = compile_model(model, online=online)
    record = record_of(np.random.default_rng(1), 80)
    problem = record_problem(record, system, 0.05, (), ())
    at = Variation(system.parameters.values(), 1.0)
    states = np.zeros((len(system.states), len(problem.grid.nodes)))
    F, H, _, _ = linear_motion(problem, states, [at])
    return problem, F[0, 0], H[0, 0], discretised_noise(problem, states, at)


def response(F, H, row, force, frequency):
    """Of the output ``row`` to white forcing of one state, at rad/s."""
    n = len(F)
    return (H @ np.linalg.solve(1j * frequency * np.eye(n) - F, force))[row]


def evidence(problem: RecordProblem, motion) -> float:
    valid = np.ones((len(problem.grid.nodes), 3), dtype=bool)
    return whitener(motion, VARIANCE, valid).log_determinant


def test_a_lag_is_the_same_as_its_state_on_line():
    channel = compile_model(oscillator(DENSITY)).output_names[0]
    values = {"time_constant": 0.3}
    offline = motion_of(SensorLag(channel), values)
    # Memories are lengthened by a fifth of a sub-step, at right angles.
    shortest = 0.2 * float(np.mean(np.diff(offline[0].grid.nodes)))
    values = {"time_constant": float(np.hypot(0.3, shortest))}
    online = motion_of(SensorLag(channel), values, online=True)
    assert evidence(offline[0], offline[3]) == pytest.approx(
        evidence(online[0], online[3]), rel=1e-9
    )


@pytest.mark.parametrize(
    ("effect", "values", "late"),
    [(SensorDelay, {"delay": 0.2}, 0.2), (SensorHold, {"period": 0.4}, 0.2)],
)
def test_a_delay_turns_the_phase_and_keeps_the_size(effect, values, late):
    channel = compile_model(oscillator(DENSITY)).output_names[0]
    _, F, H, _ = motion_of(effect(channel), values)
    _, plain_F, plain_H, _ = motion_of(SensorDelay(channel), {"delay": 0.0})
    for frequency in (0.3, 1.0, 3.0):
        force, plain_force = np.eye(len(F))[1], np.eye(len(plain_F))[1]
        ratio = response(F, H, 0, force, frequency) / response(
            plain_F, plain_H, 0, plain_force, frequency
        )
        assert abs(ratio) == pytest.approx(1.0, abs=1e-9)
        # Pade's approximation of first order errs by the cube of the angle over twelve; the
        # sensor without a delay is late by 0.4 of a sub-step.
        assert np.angle(ratio) == pytest.approx(-frequency * late, abs=0.03 * frequency)


def test_a_late_sensor_changes_what_a_filter_expects():
    channel = compile_model(oscillator(DENSITY)).output_names[0]
    late = motion_of(SensorDelay(channel), {"delay": 0.3})
    early = motion_of(SensorDelay(channel), {"delay": 0.0})
    assert abs(evidence(late[0], late[3]) - evidence(early[0], early[3])) > 1.0


def test_a_sensor_without_delay_hardly_changes_the_filter():
    channel = compile_model(oscillator(DENSITY)).output_names[0]
    _, _, _, plain = motion_of(
        SensorDelay("mixed" if channel != "mixed" else "speed"), {"delay": 0.0}
    )
    problem, _, _, none = motion_of(SensorDelay(channel), {"delay": 0.0})
    assert np.all(np.isfinite(none.Phi)) and np.all(np.isfinite(plain.Phi))
    assert evidence(problem, none) == pytest.approx(evidence(problem, plain), rel=0.02)
