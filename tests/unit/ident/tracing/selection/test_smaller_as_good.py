"""One effect that stands for two, met beside one of them only."""

from __future__ import annotations

import pytest

from ident.tracing.selection.backward import backward_elimination, smaller_as_good
from ident.tracing.selection.ledger import Ledger
from sim.effects.input_path.actuator_lag import ActuatorLag
from sim.effects.sensor_path.sensor_lag import SensorLag
from tests.tracing_problem import fit_of, planted, problem_of, without_output

LATE = ActuatorLag()
SENSORS = (SensorLag("alpha"), SensorLag("q"))
TIME = {"actuator-lag.time_constant": 0.15}


@pytest.fixture(scope="module")
def both_late() -> Ledger:
    """A search that has fitted both sensors late, and the surface beside one of them, never the surface alone; alpha and q recorded."""
    problem = problem_of([without_output(planted([LATE], TIME), "nz")], (LATE, *SENSORS))
    root = fit_of(problem)
    ledger = Ledger(problem).kept(root, root.criterion)
    for effects in ((SENSORS[1],), SENSORS, (SENSORS[1], LATE)):
        fitted = fit_of(problem, effects, root, {"sensor-lag:q.time_constant": 0.1, "sensor-lag:alpha.time_constant": 0.1, **TIME})
        ledger = ledger.kept(fitted, fitted.criterion)
    return ledger


def test_what_stands_alone_for_two_is_met_on_the_way_back(both_late: Ledger) -> None:
    best = both_late.models[frozenset(effect.name for effect in SENSORS)]
    for search in (smaller_as_good, backward_elimination):
        after, found = search(both_late, best)
        assert found.names == (LATE.name,) and found.values.shared["actuator-lag.time_constant"] == pytest.approx(0.15, rel=0.1)
        assert after.score(found) < after.score(best) and after.steps[0].effects == (LATE.name,) and "no longer needed" in after.steps[0].sentence


def test_nothing_is_fitted_for_a_single_effect_or_without_means(both_late: Ledger) -> None:
    single = both_late.models[frozenset({SENSORS[1].name})]
    assert smaller_as_good(both_late, single) == (both_late, single)
    spent = both_late.respent(both_late.problem.settings.budget)
    best = both_late.models[frozenset(effect.name for effect in SENSORS)]
    assert smaller_as_good(spent, best) == (spent, best)
