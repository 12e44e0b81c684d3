"""The declared model as it is fitted before anything is searched for, and data that are not
fitted.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.tracing.loop import fit_declared, held_out_data
from sim.effects.sensor_path.sensor_spikes import InputSpikes, SensorSpikes
from sim.errors import ModelError
from sim.record import Channel, Record
from tests.tracing_problem import OUTPUTS, fit_of, planted, problem_of, with_output

SPIKES = (SensorSpikes("q", "rad/s", 0.05), InputSpikes("elevator"))


def with_wrong_inputs(record: Record) -> Record:
    elevator = record["elevator"].values.copy()
    elevator[[160, 333]] += np.array([0.2, -0.3])
    return replace(record, inputs=(Channel.of("elevator", "rad", elevator),))


def test_a_sound_record_is_fitted_as_it_is() -> None:
    problem = problem_of([planted(seed=1)], SPIKES)
    found = fit_declared(problem)
    assert found.spikes == () and found.steps == ()
    assert found.fitted.fit.cost == pytest.approx(fit_of(problem).fit.cost, abs=1e-6)
    np.testing.assert_array_equal(found.problem.masks[0], problem.masks[0])


def test_wrong_samples_of_an_input_are_mended_claimed_and_told_as_a_step() -> None:
    sound = planted(seed=3)
    found = fit_declared(problem_of([with_wrong_inputs(sound)], SPIKES))
    (claim,) = found.spikes
    assert claim.name == "sensor-spikes:elevator" and claim.parameters["count"].value == 2
    np.testing.assert_allclose(
        found.problem.records[0]["elevator"].values, sound["elevator"].values, atol=1e-12
    )
    (step,) = found.steps
    assert step.effects == () and np.isfinite(step.log_evidence) and "elevator" in step.sentence
    # What no candidate may name is not mended.
    assert fit_declared(problem_of([with_wrong_inputs(sound)])).spikes == ()


def test_wrong_samples_of_an_output_are_set_aside_while_it_is_searched() -> None:
    record = planted(seed=1)
    values = record["q"].values.copy()
    values[[77, 320]] += 0.3
    found = fit_declared(problem_of([with_output(record, "q", values)], SPIKES))
    assert np.flatnonzero(~found.problem.masks[0][1]).tolist() == [77, 320]
    assert np.all(found.problem.masks[0][[0, 2]])
    np.testing.assert_array_equal(found.fitted.fit.layout.problems[0].valid, found.problem.masks[0])


def test_what_cannot_be_simulated_is_refused_with_the_record_in_one_line() -> None:
    record = planted(seed=1)
    elevator = Channel.of("elevator", "rad", 1e300 * record["elevator"].values)
    wild = replace(record, inputs=(elevator,), name="wild.csv")
    with pytest.raises(ModelError, match=r"wild\.csv"):
        fit_declared(problem_of([wild]))


def test_data_that_are_not_fitted_are_mended_masked_and_predicted_by_the_declared_model() -> None:
    found = fit_declared(problem_of([with_wrong_inputs(planted(seed=3))], SPIKES))
    other = planted(seed=4)
    values = other["q"].values.copy()
    values[100] += 0.5
    mended = held_out_data(found, [with_wrong_inputs(other)])
    np.testing.assert_allclose(
        mended.records[0]["elevator"].values, other["elevator"].values, atol=1e-12
    )
    held = held_out_data(found, [with_output(other, "q", values)])
    assert held.masks is not None and np.flatnonzero(
        ~held.masks[0][OUTPUTS.index("q")]
    ).tolist() == [100]
    fit = held.declared.frozen
    assert fit is not None and held.declared.informed is None
    assert np.sqrt(fit.variance[1]) == pytest.approx(0.002, rel=0.15)
    assert held_out_data(found, []).records == ()
