"""Two effects that hide each other behind derivatives that no one believes."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ident.tracing.belief.standing import why_not
from ident.tracing.candidate_model.quantities import quantities
from ident.tracing.equivalents import misfit_to_declared
from ident.tracing.ranking.restored_belief import with_belief_restored, without_unbelievable
from ident.tracing.selection.ledger import Ledger
from sim.effects.sensor_path.accelerometer_offset import AccelerometerOffset
from sim.effects.sensor_path.sensor_delay import SensorDelay
from sim.effects.sensor_path.sensor_scale import SensorScale
from tests.tracing_problem import declared, fit_of, planted, problem_of

LATE, AHEAD, SCALE = SensorDelay("alpha"), AccelerometerOffset(), SensorScale("q")
HIDDEN = {"sensor-delay:alpha.delay": 0.12, "accelerometer-offset:nz.arm": 9.0}


@pytest.fixture(scope="module")
def hidden() -> Ledger:
    """Records of an aircraft with both; the search has kept the late angle of attack alone."""
    problem = problem_of([planted([LATE, AHEAD], HIDDEN, seed, scale=0.5) for seed in (1, 2)], [LATE, AHEAD, SCALE])
    root, alone = fit_of(problem), fit_of(problem, (LATE,))
    return Ledger(problem).kept(root, root.criterion).kept(alone, alone.criterion)


def test_the_other_one_is_found(hidden: Ledger) -> None:
    alone = hidden.models[frozenset({LATE.name})]
    ledger, best = with_belief_restored(hidden, alone)
    assert set(best.names) == {LATE.name, AHEAD.name}
    assert misfit_to_declared(best) < misfit_to_declared(alone) and best.fit.cost <= alone.fit.cost
    assert best.values.shared["accelerometer-offset:nz.arm"] == pytest.approx(9.0, rel=0.5)
    assert "vehicle file" in ledger.steps[-1].sentence


def test_where_the_derivatives_are_likely_nothing_is_fitted() -> None:
    problem = problem_of([planted([LATE], {"sensor-delay:alpha.delay": 0.12}, 1)], [LATE, AHEAD, SCALE])
    alone = fit_of(problem, (LATE,))
    ledger = Ledger(problem).kept(alone, alone.criterion)
    after, best = with_belief_restored(ledger, alone)
    assert best is alone and after is ledger


def test_a_vehicle_file_that_is_wrong_makes_no_effect() -> None:
    """A declared Cm_alpha of a third: every set moves it as far, and none is taken for that."""
    model = declared()
    wrong = model.with_values({"Cm_alpha": model.parameters["Cm_alpha"].value / 3.0})
    problem = replace(problem_of([planted([LATE], {"sensor-delay:alpha.delay": 0.12}, seed) for seed in (1, 2)], [LATE, AHEAD, SCALE]), model=wrong)
    alone = fit_of(problem, (LATE,))
    ledger = Ledger(problem).kept(alone, alone.criterion)
    assert misfit_to_declared(alone) > 30.0
    assert with_belief_restored(ledger, alone)[1] is alone


def test_a_set_that_the_search_has_passed_is_taken_before_anything_is_fitted(hidden: Ledger) -> None:
    alone, both = hidden.models[frozenset({LATE.name})], fit_of(hidden.problem, (AHEAD, LATE))
    ahead = fit_of(hidden.problem, (AHEAD,))
    # Two sets of one size: the late angle of attack with a scale, wild, and the true pair, of a worse score.
    wild_one = fit_of(hidden.problem, (LATE, SCALE), alone)
    ledger = Ledger(hidden.problem)
    for fitted in (alone, ahead, both, wild_one):
        ledger = ledger.kept(fitted, fitted.criterion)
    after, best = with_belief_restored(ledger, wild_one)
    assert set(best.names) == {LATE.name, AHEAD.name} and after.spent == ledger.spent


def test_an_effect_whose_numbers_cannot_be_claimed_leaves_a_set_that_is_noise_without_it() -> None:
    """A pitch rate that is late by nothing that the record knows, beside a late vane."""
    idle = SensorDelay("q")
    problem = problem_of([planted([LATE], {"sensor-delay:alpha.delay": 0.12}, 1)], [LATE, idle])
    both = fit_of(problem, (LATE, idle), None, {"sensor-delay:alpha.delay": 0.1, "sensor-delay:q.delay": 1e-3})
    assert why_not(idle, quantities(both, idle), both) is not None and why_not(LATE, quantities(both, LATE), both) is None
    ledger = Ledger(problem).kept(both, both.criterion)
    after, rest = without_unbelievable(ledger, both)
    assert rest.names == (LATE.name,) and "sensor-delay:q is left out" in after.steps[-1].sentence
    assert after.known(rest) is rest and after.score(rest) == pytest.approx(rest.criterion)
    # One alone stays, which is left to the verdict.
    alone = fit_of(problem, (idle,), both)
    assert without_unbelievable(ledger, alone)[1] is alone
