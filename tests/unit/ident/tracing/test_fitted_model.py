"""Fitted models carry values from one to the next."""

from __future__ import annotations

import numpy as np
import pytest

from ident.tracing.fitted_model import (
    FitData,
    compiled_with,
    declared_priors,
    fit_set,
    quantities,
    start_and_guesses,
)
from ident.whole_record.layout import FitSettings, lay_out
from sim.declaration.compile import compile_model
from sim.effects.dynamics.elastic_mode import ElasticMode
from sim.effects.sensor_path.sensor_calibration import SensorDrift, SensorScale
from sim.effects.sensor_path.sensor_timing import SensorLag
from tests.tracing_problem import OUTPUTS, declared, fit_of, planted, problem_of
from tests.whole_axes import flown, true_model

LAG = {"sensor-lag:q.time_constant": 0.06}


def test_values_are_carried_by_name_from_one_model_to_the_next() -> None:
    """A smaller model's values begin a larger one's fit, and the other way round; what is new
    begins as told, or as declared.
    """
    records = [planted([SensorLag("q")], LAG, seed) for seed in (1, 2)]
    problem = problem_of(records)
    small = fit_of(problem, [SensorScale("nz")])
    effects = (SensorDrift("q", "rad/s", 5e-4), SensorLag("q"), SensorScale("nz"))
    _, system = compiled_with(declared(), effects, OUTPUTS)
    layout = lay_out(records, system, FitSettings(max_step=0.02), local=["sensor-drift:q.slope"])
    start, guesses = start_and_guesses(layout, small.values, {"sensor-lag:q.time_constant": 0.123})
    by_name = dict(zip(layout.names, start, strict=True))
    known = {**small.values.shared}
    for r, own in enumerate(small.values.own):
        known |= {f"{name}, record {r + 1}": value for name, value in own.items()}
    assert len(known) == len(small.fit.theta)
    assert {name: by_name[name] for name in known} == known
    assert {name: value for name, value in by_name.items() if name not in known} == {
        "sensor-lag:q.time_constant": 0.123,
        "sensor-drift:q.slope, record 1": 5e-4,
        "sensor-drift:q.slope, record 2": 5e-4,
    }
    assert guesses is not None
    for guess, line in zip(guesses, small.fit.linearisations, strict=True):
        np.testing.assert_array_equal(guess, line.states)
    # Back: what the smaller model lacks is left behind.
    large = fit_of(problem, effects, small, {"sensor-lag:q.time_constant": 0.05})
    back, _ = start_and_guesses(small.fit.layout, large.values, {})
    shared = {**large.values.shared}
    assert {name: value for name, value in zip(small.fit.layout.shared, back, strict=False)} == {
        name: shared[name] for name in small.fit.layout.shared
    }


def test_added_states_begin_at_rest() -> None:
    problem = problem_of([planted()])
    root = fit_of(problem)
    _, system = compiled_with(declared(), [ElasticMode()], OUTPUTS)
    layout = lay_out(problem.records, system, FitSettings(max_step=0.02))
    _, guesses = start_and_guesses(layout, root.values, {})
    assert guesses is not None
    np.testing.assert_array_equal(guesses[0][:2], root.fit.linearisations[0].states)
    assert not np.any(guesses[0][2:])


def test_a_fit_begun_at_its_own_end_stays_there() -> None:
    problem = problem_of([planted([SensorLag("q")], LAG)])
    fitted = fit_of(problem, [SensorLag("q")])
    again = fit_of(problem, [SensorLag("q")], fitted)
    assert again.fit.cost == pytest.approx(fitted.fit.cost, abs=1e-6)
    assert again.fit.iterations <= 3


def test_parameters_of_an_effect_of_one_record_are_local() -> None:
    """Each record has its own drift; a scale is common to both. Both come out as planted."""
    drift = SensorDrift("q", "rad/s", 5e-4)
    effects = (drift, SensorScale("nz"))
    records = [
        planted(effects, {"sensor-drift:q.slope": slope, "sensor-scale:nz.scale": 1.2}, seed)
        for seed, slope in ((1, 0.002), (2, -0.003))
    ]
    fitted = fit_of(problem_of(records), effects)
    assert "sensor-scale:nz.scale" in fitted.fit.layout.shared
    assert fitted.fit.layout.local[-1] == "sensor-drift:q.slope"
    assert [own["sensor-drift:q.slope"] for own in fitted.values.own] == [
        pytest.approx(0.002, abs=2e-4),
        pytest.approx(-0.003, abs=2e-4),
    ]
    assert fitted.values.shared["sensor-scale:nz.scale"] == pytest.approx(1.2, abs=0.02)
    shown = quantities(fitted, drift)["slope"]
    # Of the record in which it stands out most.
    assert (
        shown.value == fitted.values.own[1]["sensor-drift:q.slope"]
        and shown.std > 0
        and shown.unit == "rad/s/s"
    )


def test_bad_starts_leave_nothing_fitted() -> None:
    problem = problem_of([planted()])
    assert problem.fit([SensorScale("q")], None, {"sensor-scale:q.scale": np.nan}) is None


def test_a_bias_that_the_equations_know_of_has_its_prior_and_no_other_has() -> None:
    """A steady turn is next to a bank angle that is read wrong, with rates that are: without it the
    fit wanders along that direction.
    """
    model = true_model("lateral").with_biases(["beta", "phi", "ny"])
    layout = lay_out([flown("lateral")], compile_model(model), FitSettings())
    prior = declared_priors(model, (), layout)
    assert prior is not None
    assert [layout.names[i].partition(",")[0] for i in prior.positions] == ["bias_phi"]
    assert prior.mean == [0.0] and prior.information == pytest.approx(np.array([[0.05**-2]]))


def test_biases_of_calibrated_sensors_do_not_grow_along_with_coefficients_of_totals() -> None:
    """Near one airspeed, a bias of the airspeed is nearly the same as other coefficients."""
    names = ["airspeed", "alpha", "theta", "q", "nz", "nx"]
    model = true_model("longitudinal").with_biases(names)
    data = FitData(
        [flown("longitudinal")], [np.ones((6, len(flown("longitudinal"))), bool)], model, names
    )
    fitted = fit_set(data, (), FitSettings(max_step=0.02))
    assert fitted is not None
    layout, prior = fitted.fit.layout, fitted.fit.layout.prior
    assert prior is not None
    biases = [i for i, name in enumerate(layout.names) if name.startswith("bias_")]
    assert sorted(prior.positions) == biases
    sigmas = np.diag(prior.information) ** -0.5
    assert np.all(np.abs(fitted.fit.theta[prior.positions]) < sigmas)
