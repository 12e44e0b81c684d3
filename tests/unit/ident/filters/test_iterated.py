"""The iterated filter: a start that is far off no longer leaves its mark."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.estimate import Outcome
from ident.filters.ekf import FilterSettings, run_ekf, run_iterated_ekf
from ident.filters.one_record import Exponential
from ident.whole_record.layout import FitSettings
from ident.whole_record.output_error import fit_output_error
from sim.declaration.compile import compile_model
from sim.declaration.effect import Parameter, ParameterSet
from sim.declaration.model import Model, Noise
from sim.record import Record
from sim.truth.flight import fly, sample_times
from sim.vehicles.factory import ballistic_model
from sim.vehicles.library import read_parameter_set

SIGMA = 7.62  # m: the paper's radar, 25 ft


@pytest.fixture(scope="module")
def fall() -> tuple[Record, Model, float]:
    """The paper's falling body, and a model started 60 % wrong with its textbook priors."""
    truth = ballistic_model(read_parameter_set("ballistic_target"), Noise({"altitude": SIGMA}))
    record, _ = fly(truth, None, sample_times(10.0, 30.0), np.random.default_rng(4), step=0.01)
    beta = truth.parameters["beta"].value
    parameters = truth.parameters.with_values({"beta": 1.6 * beta}).with_prior({"beta": 0.6 * beta})
    initial = ParameterSet(
        (
            Parameter("altitude", 60967.6, "m", prior_std=SIGMA),
            Parameter("velocity", -1874.5, "m/s", prior_std=45.7),
        ),
    )
    return record, replace(truth, parameters=parameters, initial=initial), beta


@pytest.mark.long
def test_equals_the_most_probable_parameters_where_the_plain_filter_is_far_off(
    fall: tuple[Record, Model, float],
) -> None:
    record, model, beta = fall
    system = compile_model(model, online=True)
    # Near the ground F changes much within 0.1 s: finer sub-steps, so that only the point of
    # linearisation is in question.
    settings = FilterSettings(transition=Exponential(), max_step=0.02)
    plain = run_ekf(record, system, settings)
    found = run_iterated_ekf(record, system, settings)
    reference = fit_output_error(
        [record], compile_model(model), FitSettings(max_step=0.01, use_priors=True)
    )
    assert found.outcome is Outcome.CONVERGED
    assert abs(found.values[0] - reference.values[0]) < 0.1 * reference.std[0]
    assert abs(found.values[0] - beta) < 3.0 * found.std[0]
    assert abs(plain.values[0] - beta) > 5.0 * plain.std[0]


def test_a_limit_of_passes_is_told(fall: tuple[Record, Model, float]) -> None:
    record, model, _ = fall
    found = run_iterated_ekf(record, compile_model(model, online=True), iterations=2)
    assert found.outcome is Outcome.MAX_ITERATIONS
    assert found.iterations == 2
    assert np.all(np.isfinite(found.values))


def test_a_filter_that_breaks_down_at_once_is_returned_as_it_is(
    fall: tuple[Record, Model, float],
) -> None:
    record, model, _ = fall
    wild = replace(
        model,
        initial=ParameterSet(
            (Parameter("altitude", -4.0e6, "m", prior_std=1.0), model.initial.items[1])
        ),
    )
    found = run_iterated_ekf(record, compile_model(wild, online=True))
    assert found.outcome in (Outcome.DIVERGED, Outcome.INDEFINITE)
    assert np.all(np.isfinite(found.values)) and np.all(np.isfinite(found.covariance))
