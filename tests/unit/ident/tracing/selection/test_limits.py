"""Limits of an input: a fit that bent to what a limit took away leads to another one, the declared values to the right one."""

from __future__ import annotations

import numpy as np
import pytest

from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import Finding, screen
from ident.tracing.selection.criterion import is_white
from ident.tracing.selection.ledger import Ledger
from ident.tracing.selection.limits import is_limit, limit_in_place, limits_from_declared_values
from sim.effects.dynamics.curves.control_nonlinearity import ControlNonlinearity
from sim.effects.input_path.actuator_lag import ActuatorLag
from sim.effects.input_path.actuator_rate_limit import ActuatorRateLimit
from sim.effects.input_path.actuator_saturation import ActuatorSaturation
from sim.effects.input_path.input_deadband import InputDeadband
from sim.effects.sensor_path.sensor_hold import SensorHold
from sim.effects.sensor_path.sensor_scale import SensorScale
from tests.tracing_problem import fit_of, planted, problem_of

SLOW = ActuatorRateLimit()
RATE = "actuator-rate-limit.rate"
NOWHERE = (np.zeros(1),)


def test_a_limit_is_an_input_that_goes_on_unchanged_until_it_is_large() -> None:
    assert is_limit(SLOW) and is_limit(ActuatorSaturation())
    assert not any(is_limit(effect) for effect in (ActuatorLag(), InputDeadband(), SensorHold("q"), SensorScale("q")))


@pytest.fixture(scope="module")
def slowed() -> tuple[Ledger, float]:
    """A search at the declared model of a record whose surface is always behind; the cost of the right fit."""
    problem = problem_of([planted([SLOW], {RATE: 0.08})], (SLOW, SensorScale("q")))
    root = fit_of(problem)
    right = fit_of(problem, [SLOW], None, {RATE: 0.08})
    assert is_white(right) and root.fit.cost > right.fit.cost + 100.0
    return Ledger(problem).kept(root, root.criterion), right.fit.cost


def test_it_is_found_from_the_declared_values(slowed: tuple[Ledger, float]) -> None:
    ledger, cost = slowed
    root = ledger.models[frozenset()]
    findings = screen(root, ledger.problem.candidates, search_context(root))
    place = next(i for i, finding in enumerate(findings) if finding.effect.name == SLOW.name)
    after, children = limits_from_declared_values(ledger, root, findings, {})
    assert set(children) == {place} and after.spent > ledger.spent
    assert children[place].fit.cost == pytest.approx(cost, abs=0.5) and children[place].values.shared[RATE] == pytest.approx(0.08, rel=0.05)


def test_a_better_child_stays_and_a_spent_search_tries_nothing(slowed: tuple[Ledger, float]) -> None:
    ledger, _ = slowed
    root = ledger.models[frozenset()]
    finding = Finding(SLOW, 50.0, 1, ({RATE: 0.08},), (50.0,), *NOWHERE)
    best = fit_of(ledger.problem, [SLOW], None, {RATE: 0.08})
    _, children = limits_from_declared_values(ledger, root, [finding], {0: best})
    assert children[0].fit.cost <= best.fit.cost
    spent = ledger.respent(ledger.problem.settings.budget)
    assert limits_from_declared_values(spent, root, [finding], {}) == (spent, {})
    # Where something leaves noise already, a limit that brought less than half of it, or was not fitted, is no rival.
    assert limits_from_declared_values(ledger, root, [finding], {}, rivals=True) == (ledger, {})
    found = limits_from_declared_values(ledger, root, [finding], {0: best}, rivals=True)
    assert found[1][0].fit.cost <= best.fit.cost and found[0].spent > ledger.spent
    # Beside another effect a set has values of its own to start from.
    scaled = fit_of(ledger.problem, [SensorScale("q")], root)
    assert limits_from_declared_values(ledger, scaled, [finding], {}) == (ledger, {})


def test_in_the_place_of_another_cause_it_begins_from_the_declared_derivatives_and_the_rest_where_it_stands() -> None:
    stop, curve, scale = ActuatorSaturation(), ControlNonlinearity(-0.1, 0.1), SensorScale("alpha")
    truth = {"actuator-saturation.limit": 0.04, "sensor-scale:alpha.scale": 1.2}
    problem = problem_of([planted([stop, scale], truth)], (stop, curve, scale))
    root = fit_of(problem)
    best = fit_of(problem, [scale, curve], root, {"sensor-scale:alpha.scale": 1.2})
    ledger = Ledger(problem).kept(root, root.criterion)
    # Where every deflection reaches the stop only its product with the effectiveness is known, and no slope leads away from there.
    stuck = fit_of(problem, [scale, stop], best, {"actuator-saturation.limit": 0.01})
    after, found = limit_in_place(ledger, best, curve, stop, stuck)
    assert found is not None and set(found.names) == {scale.name, stop.name} and after.spent > ledger.spent
    assert found.values.shared["actuator-saturation.limit"] == pytest.approx(0.04, rel=0.02)
    assert found.fit.cost < best.fit.cost + 5.0
    assert limit_in_place(ledger.respent(problem.settings.budget), best, curve, stop, stuck)[1] is stuck
