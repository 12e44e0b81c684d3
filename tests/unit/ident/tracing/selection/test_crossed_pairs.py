"""Pairs of which neither effect was the best alone."""

from __future__ import annotations

from ident.tracing.selection.criterion import is_white
from ident.tracing.selection.crossed_pairs import crossed_pairs
from ident.tracing.selection.ledger import Ledger
from sim.declaration.proposal import Traceable
from sim.effects.sensor_path.sensor_lag import SensorLag
from sim.effects.sensor_path.sensor_scale import SensorScale
from sim.effects.sensor_path.vane_offset import VaneOffset
from tests.tracing_problem import fit_of, planted, problem_of

LATE, SCALE, ELSE = SensorLag("alpha"), SensorScale("q"), SensorScale("nz")
SINGLES: tuple[Traceable, ...] = (ELSE, SCALE, LATE)


def searched() -> Ledger:
    """The first round as it leaves the ledger, the wrong effect with the lowest score; what was screened only is no single."""
    record = planted([LATE, SCALE], {"sensor-lag:alpha.time_constant": 0.08, "sensor-scale:q.scale": 1.15})
    problem = problem_of([record], (*SINGLES, VaneOffset()))
    root = fit_of(problem)
    ledger = Ledger(problem).kept(root, root.criterion)
    for place, effect in enumerate(SINGLES):
        ledger = ledger.kept(fit_of(problem, [effect], root), root.criterion - 100.0 + place)
    return ledger


def test_the_pair_that_explains_is_found_among_the_effects_of_the_first_round() -> None:
    ledger = searched()
    after, found = crossed_pairs(ledger, ledger.models[frozenset()])
    assert {frozenset(pair.names) for pair in found} >= {frozenset({LATE.name, SCALE.name})}
    best = min(found, key=lambda fitted: fitted.criterion)
    assert set(best.names) == {LATE.name, SCALE.name} and is_white(best)
    assert after.spent > ledger.spent and all(after.problem.holds(fitted) for fitted in found)
    # What is known is not fitted again, nor anything without means.
    _, further = crossed_pairs(after, ledger.models[frozenset()])
    assert not any(frozenset(pair.names) in after.models for pair in further)
    assert crossed_pairs(ledger.respent(ledger.problem.settings.budget), ledger.models[frozenset()])[1] == []
