"""Two effects at once, where one alone comes nowhere near noise."""

from __future__ import annotations

from dataclasses import replace

from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.selection.criterion import is_white
from ident.tracing.selection.ledger import Ledger
from ident.tracing.selection.pairs_at_once import pairs_at_once
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.sensor_path.sensor_delay import SensorDelay
from sim.effects.sensor_path.sensor_lag import SensorLag
from sim.effects.sensor_path.sensor_scale import SensorScale
from sim.effects.sensor_path.vane_offset import VaneOffset
from tests.tracing_problem import SETTINGS, fit_of, planted, problem_of

LATE, BOTH = SensorDelay("q"), {"sensor-delay:q.delay": 0.08, "vane-offset.arm": 9.0}
CANDIDATES = (LATE, SensorLag("q"), SensorDelay("alpha"), VaneOffset(), SensorScale("nz"), UnmeasuredInput())


def begun() -> tuple[Ledger, FittedModel]:
    problem = problem_of([planted([LATE, VaneOffset()], BOTH)], CANDIDATES)
    root = fit_of(problem)
    return Ledger(problem).kept(root, root.criterion), root


def test_the_pair_that_acts_is_found_at_once_and_only_steady_effects_are_paired() -> None:
    ledger, root = begun()
    ledger, found = pairs_at_once(ledger, root)
    best = min(found, key=ledger.score)
    assert set(best.names) == {"sensor-delay:q", "vane-offset"} and is_white(best)
    assert all("unmeasured-input" not in fitted.names and len(fitted.names) == 2 for fitted in found)
    assert len(found) <= thresholds.PAIRS_AT_ONCE + 2 * len(CANDIDATES)
    assert ledger.score(best) < ledger.score(root) - 100.0 and any(step.effects == best.names for step in ledger.steps)


def test_what_was_fitted_is_not_fitted_again_nor_anything_without_means() -> None:
    ledger, root = begun()
    once, found = pairs_at_once(ledger, root)
    again, further = pairs_at_once(once, root)
    assert found and not set(again.models) - set(once.models) and all(fitted.names not in {f.names for f in further} for fitted in found)
    spent, nothing = pairs_at_once(replace(ledger, spent=SETTINGS.budget), root)
    assert nothing == [] and spent.models == ledger.models


def test_nothing_is_paired_where_the_declared_model_leaves_noise() -> None:
    problem = problem_of([planted(seed=3)], CANDIDATES)
    root = fit_of(problem)
    assert pairs_at_once(Ledger(problem).kept(root, root.criterion), root)[1] == []
