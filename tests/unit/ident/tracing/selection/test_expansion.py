"""One fitted model extended: which start counts, where a fit begins that the projection led astray, and when a parent is fitted again."""

from __future__ import annotations

import numpy as np
import pytest

from ident.tracing.candidate_model.fitted_model import FittedModel, never_together
from ident.tracing.screening.score_test import Finding
from ident.tracing.selection.acceptance import _from_child, accepted
from ident.tracing.selection.expansion import best_fit, near_absence
from ident.tracing.selection.ledger import Ledger
from sim.effects.disturbance.phugoid import Phugoid
from sim.effects.disturbance.speed_variation import SpeedVariation
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.dynamics.derivative_jump import DerivativeJump
from sim.effects.input_path.actuator_saturation import ActuatorSaturation
from sim.effects.sensor_path.sensor_delay import SensorDelay
from sim.effects.sensor_path.sensor_lag import SensorLag
from sim.effects.sensor_path.sensor_scale import SensorScale
from tests.tracing_problem import fit_of, planted, problem_of

PULSE = UnmeasuredInput()
RIGHT = {"unmeasured-input.start": 6.0, "unmeasured-input.duration": 0.8, "unmeasured-input.moment": 0.01, "unmeasured-input.lift": 0.0}
WRONG = {**RIGHT, "unmeasured-input.start": 2.0, "unmeasured-input.moment": 1e-4}


def test_near_absence_is_a_hundredth_of_the_way() -> None:
    assert near_absence(SensorDelay("q"), {"sensor-delay:q.delay": 0.1}) == {"sensor-delay:q.delay": pytest.approx(0.001)}
    assert near_absence(SensorScale("q"), {"sensor-scale:q.scale": 1.5}) == {"sensor-scale:q.scale": pytest.approx(1.005)}
    # What has no absence stays.
    event = near_absence(PULSE, RIGHT)
    assert event["unmeasured-input.start"] == 6.0 and event["unmeasured-input.moment"] == pytest.approx(1e-4)


@pytest.fixture(scope="module")
def pulse() -> tuple[Ledger, FittedModel]:
    problem = problem_of([planted([PULSE], RIGHT)], (PULSE,))
    root = fit_of(problem)
    return Ledger(problem).kept(root, root.criterion), root


@pytest.mark.parametrize("starts", [(RIGHT, WRONG), (WRONG, RIGHT)], ids=["the first", "the second"])
def test_of_several_starts_the_one_that_ends_lowest_counts(pulse: tuple[Ledger, FittedModel], starts: tuple[dict[str, float], ...]) -> None:
    ledger, root = pulse
    after, child = best_fit(ledger, root, Finding(PULSE, 50.0, 4, starts, (50.0, 50.0), np.zeros(1)), 2)
    assert child is not None and child.values.own[0]["unmeasured-input.start"] == pytest.approx(6.0, abs=0.1)
    assert after.spent > ledger.spent
    # Of one start alone the first is taken, wherever that leads.
    _, first = best_fit(ledger, root, Finding(PULSE, 50.0, 4, starts, (50.0, 50.0), np.zeros(1)), 1)
    assert first is not None and (first.fit.cost < child.fit.cost + 1.0) is (starts[0] is RIGHT)


def test_a_parent_is_fitted_again_where_its_child_knows_a_better_optimum_and_only_there() -> None:
    scale = SensorScale("nz")
    problem = problem_of([planted([PULSE, scale], {**RIGHT, "sensor-scale:nz.scale": 1.2})], (PULSE, scale))
    root = fit_of(problem)
    astray = fit_of(problem, [PULSE], root, WRONG)
    child = fit_of(problem, [PULSE, scale], root, {**RIGHT, "sensor-scale:nz.scale": 1.2})
    good = fit_of(problem, [PULSE], child)
    assert good.fit.cost < astray.fit.cost - 5.0
    ledger = Ledger(problem).kept(root, root.criterion).kept(astray, 1000.0)
    after, parent = _from_child(ledger, astray, child)
    assert parent.fit.cost == pytest.approx(good.fit.cost, abs=0.5)
    assert after.known(parent) is parent and after.score(parent) == pytest.approx(1000.0 - 2.0 * (astray.fit.cost - parent.fit.cost))
    ledger = Ledger(problem).kept(root, root.criterion).kept(good, 1000.0)
    after, parent = _from_child(ledger, good, child)
    assert parent is good and after.models == ledger.models and after.scores == ledger.scores


def test_children_that_know_the_same_better_optimum_of_their_parent_lower_its_score_once() -> None:
    scale, other = SensorScale("nz"), SensorScale("alpha")
    problem = problem_of([planted([PULSE, scale, other], {**RIGHT, "sensor-scale:nz.scale": 1.2, "sensor-scale:alpha.scale": 1.1})])
    root = fit_of(problem)
    astray = fit_of(problem, [PULSE], root, WRONG)
    starts = ({**RIGHT, "sensor-scale:nz.scale": 1.2}, {**RIGHT, "sensor-scale:alpha.scale": 1.1})
    effects = (scale, other)
    children = {place: fit_of(problem, [PULSE, effect], root, start) for place, (effect, start) in enumerate(zip(effects, starts, strict=True))}
    findings = [Finding(effect, 50.0, 1, (start,), (50.0,), np.ones(1)) for effect, start in zip(effects, starts, strict=True)]
    ledger = Ledger(problem).kept(root, root.criterion).kept(astray, 1000.0)
    after, kept = accepted(ledger, astray, 2, findings, children)
    parent = after.known(astray)
    assert kept and parent.fit.cost < astray.fit.cost - 5.0
    assert after.score(parent) == pytest.approx(1000.0 - 2.0 * (astray.fit.cost - parent.fit.cost))


def test_a_phugoid_and_an_even_change_of_speed_are_never_put_side_by_side() -> None:
    """Two laws of one thing."""
    phugoid, even, scale = Phugoid(), SpeedVariation(), SensorScale("nz")
    assert never_together(phugoid, even) and never_together(even, phugoid)
    assert not never_together(phugoid, scale) and not never_together(scale, even)
    assert never_together(SensorDelay("q"), SensorLag("q")) and not never_together(SensorDelay("q"), SensorLag("alpha"))


def test_what_the_projection_loses_begins_where_another_set_found_it() -> None:
    """A limit far above what was commanded has no slope: a fit that begins there stays there."""
    limited, scale = ActuatorSaturation("elevator", "rad", 0.05), SensorScale("nz")
    name = "actuator-saturation.limit"
    problem = problem_of([planted([limited, scale], {name: 0.04, "sensor-scale:nz.scale": 1.3})], (limited, scale))
    root = fit_of(problem)
    alone, beside = fit_of(problem, [limited], root, {name: 0.045}), fit_of(problem, [scale], root)
    far = Finding(limited, 500.0, 1, ({name: 5.0},), (500.0,), np.zeros(1))
    ledger = Ledger(problem).kept(root, root.criterion).kept(beside, beside.criterion)
    _, lost = best_fit(ledger, beside, far, 1)
    assert lost is None or beside.fit.cost - lost.fit.cost < 5.0
    _, found = best_fit(ledger.kept(alone, alone.criterion), beside, far, 1)
    assert found is not None and beside.fit.cost - found.fit.cost > 100.0
    assert found.values.shared[name] == pytest.approx(0.04, rel=0.02)


def test_a_projected_step_that_leads_astray_is_shortened() -> None:
    """Ten times the right change makes the aircraft unstable; a third, a tenth of it leads there, a hundredth need not."""
    lost = DerivativeJump()
    right = {"derivative-jump.time": 4.0, "derivative-jump.Cm_alpha": 0.25}
    problem = problem_of([planted([lost], right)], (lost,))
    root = fit_of(problem)
    far = Finding(lost, 500.0, 5, ({"derivative-jump.time": 4.2, "derivative-jump.Cm_alpha": 2.5},), (500.0,), np.zeros(1))
    _, found = best_fit(Ledger(problem).kept(root, root.criterion), root, far, 1)
    assert found is not None and found.values.own[0]["derivative-jump.time"] == pytest.approx(4.0, abs=0.1)
    assert near_absence(lost, right, 0.1)["derivative-jump.Cm_alpha"] == pytest.approx(0.025)
