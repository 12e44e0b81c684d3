"""Limits of an input: a fit that bent to what a limit took away leads to another one, the declared values to the right one."""

from __future__ import annotations

import numpy as np
import pytest

from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import Finding, screen
from ident.tracing.selection.criterion import is_white
from ident.tracing.selection.ledger import Ledger
from ident.tracing.selection.limits import is_limit, limits_from_declared_values
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
