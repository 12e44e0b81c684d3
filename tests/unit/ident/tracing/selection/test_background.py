"""What any record may have is offered before what imitates it, stays beside what is wrong, and is left out where nothing shows it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.special import chdtrc

from ident.tracing.candidate_model.fitted_model import added_parameters, local_names
from ident.tracing.candidate_model.quantities import quantities
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import screen
from ident.tracing.selection.background import with_background, with_known_background
from ident.tracing.selection.criterion import is_white
from ident.tracing.selection.expansion import _instead_of_motion
from ident.tracing.selection.ledger import Ledger
from sim.declaration.proposal import Traceable
from sim.effects.disturbance.phugoid import Phugoid
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.sensor_path.sensor_drift import SensorDrift
from sim.effects.sensor_path.sensor_lag import SensorLag
from sim.effects.sensor_path.vane_offset import VaneOffset
from sim.record import Record
from tests.searches import LAG, found_by, searched
from tests.tracing_problem import doublets, fit_of, planted, problem_of

SLOW = {"phugoid.attitude": 0.04, "phugoid.speed_damping": 0.012, "phugoid.induced_drag": 4.0, "phugoid.trim_moment": 0.01}
IMITATORS: tuple[Traceable, ...] = (SensorDrift("nz", "g", 5e-3), SensorDrift("alpha", "rad", 5e-4), UnmeasuredInput(), SensorLag("q"), Phugoid())


def flown(seed: int, *more: Any, attitude: float = 0.04) -> Record:
    effects, values = (more[0], more[1]) if more else ((), {})
    return planted([Phugoid(), *effects], {**SLOW, "phugoid.attitude": attitude, **values}, seed, flight=doublets(14.0, 40.0))


def test_comes_before_what_imitates_it() -> None:
    ledger, _, best = found_by([flown(1), flown(2, attitude=-0.02)], IMITATORS)
    assert best.names == ("phugoid",)
    own = [best.values.own[r]["phugoid.attitude"] for r in range(2)]
    # Drag and engines are known to their priors only, and trade off with the attitude over a short record.
    assert own == pytest.approx([0.04, -0.02], abs=0.012)
    first = ledger.evidence[0]
    assert first.name == "phugoid" and first.round == 1 and first.gain > 50.0
    assert any("belongs to the model from here on" in step.sentence for step in ledger.steps)
    assert all("phugoid" in candidate.within for candidate in ledger.evidence[1:] if candidate.name.startswith("sensor-drift"))


def test_records_may_begin_up_and_down() -> None:
    problem = problem_of([flown(9, attitude=0.1), flown(10, attitude=-0.1)], (Phugoid(),))
    _, fuller = with_background(*_begun(problem), 1)
    assert [own["phugoid.attitude"] for own in fuller.values.own] == pytest.approx([0.1, -0.1], abs=0.02)


def test_stays_beside_a_fault() -> None:
    _, _, best = found_by([flown(3, [SensorLag("q")], LAG), flown(4, [SensorLag("q")], LAG)], IMITATORS)
    assert set(best.names) == {"phugoid", "sensor-lag:q"}
    shown = quantities(best, SensorLag("q"))["time_constant"]
    assert abs(shown.value - 0.06) < 4.0 * shown.std < 0.02


def test_is_left_out_where_nothing_shows_it() -> None:
    _, root, best = found_by([planted(seed=5)], IMITATORS)
    assert best.names == () and best.fit.cost == pytest.approx(root.fit.cost, abs=1e-3)


def test_waits_where_another_cause_dwarfs_it() -> None:
    late = {"sensor-lag:q.time_constant": 0.25}
    records = [flown(6, [SensorLag("q")], late, attitude=0.01)]
    problem = problem_of(records, IMITATORS)
    ledger, best = searched(problem, fit_of(problem))
    rounds = {(candidate.name, candidate.within): candidate.round for candidate in ledger.evidence}
    assert rounds[("sensor-lag:q", ())] == 1, "the lag is looked at without it"
    assert set(best.names) == {"phugoid", "sensor-lag:q"}


def test_what_it_imitates_stands_in_its_place_where_that_brings_far_more() -> None:
    """A drift beside an arm: neither leaves noise alone, and the slow motion brings part of what the drift does."""
    drift, arm = SensorDrift("nz", "g", 5e-3), VaneOffset()
    values = {"sensor-drift:nz.slope": -0.02, "vane-offset.arm": 2.5}
    problem = problem_of([planted([drift, arm], values, flight=doublets(14.0, 40.0))], (drift, arm, Phugoid()))
    root = fit_of(problem)
    ledger = Ledger(problem).kept(root, root.criterion)
    ledger, fuller = with_background(ledger, root, 1)
    assert fuller is not root and not is_white(fuller), "the drift looks like slow motion"
    findings = screen(root, (drift, arm), search_context(root))
    _, instead = _instead_of_motion(ledger, root, fuller, findings, 1)
    assert [fitted.names for fitted in instead] == [("sensor-drift:nz",)]
    assert instead[0].fit.cost < fuller.fit.cost


def test_parameters_of_the_aircraft_are_shared_and_cost_nothing() -> None:
    effect = Phugoid()
    assert local_names(effect) == ["phugoid.attitude"] and added_parameters(effect, 3) == 3
    assert local_names(UnmeasuredInput()) == [f"unmeasured-input.{item.name}" for item in UnmeasuredInput().parameters if item.free]
    assert added_parameters(SensorLag("q"), 3) == 1
    problem = problem_of([flown(7), flown(8)], (effect,))
    ledger, fuller = with_background(*_begun(problem), 1)
    assert fuller.added == 2 and "phugoid.trim_moment" in fuller.fit.layout.shared
    assert {name.partition(", ")[0] for name in fuller.fit.layout.names[len(fuller.fit.layout.shared) :]} >= {"phugoid.attitude"}
    assert with_known_background(ledger, ledger.models[frozenset()]) is fuller
    assert np.isfinite(fuller.criterion) and fuller.background == fuller.effects and fuller.foreground == ()


def test_its_p_value_counts_every_parameter_that_the_fit_moved() -> None:
    ledger, _ = with_background(*_begun(problem_of([flown(9, attitude=0.004)], (Phugoid(),))), 1)
    (seen,) = ledger.evidence
    assert seen.p_value == pytest.approx(float(chdtrc(4, 2.0 * seen.gain)), rel=1e-9)


def _begun(problem: Any) -> tuple[Ledger, Any]:
    root = fit_of(problem)
    return Ledger(problem).kept(root, root.criterion), root
