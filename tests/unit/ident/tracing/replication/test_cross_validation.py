"""Effects that stand where what remains is not noise: found by leaving one record out, alone and as a pair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ident.tracing.candidate_model.fitted_model import FittedModel, Values
from ident.tracing.replication.by_record import Flight
from ident.tracing.replication.comparison import CrossValidatedEffect
from ident.tracing.replication.cross_validation import _at_base, cross_validate
from ident.tracing.replication.one_round import _promising, _with_fitted, weigh_all
from ident.tracing.replication.pair_instead import pair_instead
from ident.tracing.replication.weighing import within_reach, without_record
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import screen
from ident.whole_record.output_error import fit_covariance
from sim.declaration.proposal import Traceable, fitted_to
from sim.effects.disturbance.phugoid import Phugoid
from sim.effects.disturbance.speed_variation import SpeedVariation
from sim.effects.dynamics.curves.control_nonlinearity import ControlNonlinearity
from sim.effects.dynamics.curves.control_weakening import ControlWeakening
from sim.effects.dynamics.curves.moment_nonlinearity import MOMENT_NONLINEARITY
from sim.effects.guards.products import GUARDS
from sim.effects.input_path.input_deadband import InputDeadband
from sim.effects.sensor_path.sensor_delay import SensorDelay
from sim.effects.sensor_path.sensor_drift import SensorDrift
from sim.effects.sensor_path.sensor_scale import SensorScale
from tests.bases import Flight as Flown
from tests.bases import rigid_flight
from tests.tracing_problem import all_records, coloured, fit_of, planted, problem_of, root_of

LATE = SensorDelay("alpha")
SCALED = SensorScale("q")


@pytest.fixture(scope="module")
def clean() -> Flight:
    return all_records([coloured(planted([], None, seed), seed) for seed in (4, 5, 6)])


def test_a_cause_stands_in_coloured_noise_and_comes_out_alike(late: Flight) -> None:
    validated, weighed = cross_validate(late, (LATE, SCALED, *GUARDS[:3]), root_of(late))
    assert [item.best.effect.name for item in validated] == ["sensor-delay:alpha"]
    best = validated[0].best
    assert best.replication.agrees and all(change < 0 for change in best.reduction.by_record)
    for found in best.replication.values:
        assert found["delay"].value == pytest.approx(0.08, abs=4.0 * found["delay"].std)
    assert {item.effect.name for item in weighed} >= {"sensor-delay:alpha"}


def test_nothing_stands_where_there_is_only_colour(clean: Flight) -> None:
    validated, weighed = cross_validate(clean, (LATE, SCALED, InputDeadband("elevator", "rad", 0.01), *GUARDS[:3]), root_of(clean))
    assert validated == []
    assert not any(item.stands for item in weighed)


def test_leaving_a_record_out_by_one_step_is_nearly_a_fit_to_the_others(late: Flight) -> None:
    everything = fit_of(problem_of(list(late.records)), (LATE,), None, {"sensor-delay:alpha.delay": 0.07})
    others = fit_of(problem_of(list(late.records[1:])), (LATE,), None, {"sensor-delay:alpha.delay": 0.07})
    stepped = without_record(everything, 0).values.shared
    sigma = np.sqrt(np.diag(fit_covariance(others.fit)[0]))
    away = {name: abs(stepped[name] - value) / sigma[i] for i, (name, value) in enumerate(others.values.shared.items())}
    unmoved = {name: abs(everything.values.shared[name] - value) / sigma[i] for i, (name, value) in enumerate(others.values.shared.items())}
    assert max(away.values()) < 0.5, away
    assert sum(away.values()) < 0.5 * sum(unmoved.values())


def test_a_curve_is_not_asked_for_what_only_one_record_flew() -> None:
    flight = rigid_flight(8.0, 50.0)
    records = [planted([], None, seed, flight=Flown(flight.time, share * flight.u, max_step=0.02)) for seed, share in ((1, 1.0), (2, 1.0), (3, 2.0))]
    fitted = root_of(all_records(records))
    bend = fitted_to(MOMENT_NONLINEARITY, search_context(fitted))
    assert within_reach(fitted, bend) == [0, 1]
    assert within_reach(fitted, SCALED) == [0, 1, 2]
    alike = root_of(all_records(records[:2]))
    assert within_reach(alike, fitted_to(MOMENT_NONLINEARITY, search_context(alike))) == [0, 1]


def test_two_faults_that_hide_each_other_are_found_as_a_pair() -> None:
    """A scale of nz and a late q: the derivatives take in most of what either does alone."""
    values = {"sensor-scale:nz.scale": 1.35, "sensor-delay:q.delay": 0.04}
    scale, late = SensorScale("nz"), SensorDelay("q")
    flight = all_records([coloured(planted([scale, late], values, seed), seed) for seed in (1, 2, 3)])
    validated, _ = cross_validate(flight, (LATE, SCALED, scale, late, *GUARDS[:3]), root_of(flight))
    assert {item.best.effect.name for item in validated} == {"sensor-scale:nz", "sensor-delay:q"}


def test_beside_a_phugoid_an_even_change_of_speed_is_not_tried() -> None:
    """Not even where it would explain what the phugoid leaves: here it is trimmed anew at every speed."""
    even, drift = SpeedVariation(weight=False), SensorDrift("nz", "g", 5e-3)
    values = {"speed-variation.rate": 6.0, "sensor-drift:nz.slope": 0.01}
    problem = problem_of([planted([even, drift], values, seed) for seed in (1, 2)])
    fits = [fit_of(problem, known) for known in ([], [Phugoid()])]
    tried = [{finding.effect.name for finding in _promising(fit, screen(fit, [even, drift], search_context(fit)))} for fit in fits]
    assert even.name in tried[0] and tried[1] == {drift.name}


def test_all_records_are_fitted_from_where_the_same_records_were_fitted_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """From values alone a fit beside a phugoid may end in another optimum: trajectories are known, too."""
    records = [planted([Phugoid()], {}, seed) for seed in (1, 2, 3)]
    base = fit_of(problem_of(records), [Phugoid()])
    asked: list[object] = []
    fit = Flight.fit

    def spy(self: Flight, effects: Sequence[Traceable], which: Sequence[int], start: Values | None, *more: Any) -> FittedModel | None:
        asked.append(start)
        return fit(self, effects, which, start, *more)

    monkeypatch.setattr(Flight, "fit", spy)
    same = _at_base(all_records(records), base)
    assert same is not None and same.fit.cost == pytest.approx(base.fit.cost, abs=0.5) and asked[0] is not None
    fewer = fit_of(problem_of(records[:2]), [Phugoid()])
    more = _at_base(all_records(records), fewer)
    assert more is not None and asked[1] is None and more.fit.cost == pytest.approx(base.fit.cost, abs=5.0)


def test_what_a_search_found_in_full_is_tried_from_there_beside_what_a_projection_promises() -> None:
    flight = all_records([coloured(planted([LATE], {"sensor-delay:alpha.delay": 0.08}, seed), seed) for seed in (1, 2, 3)])
    root = root_of(flight)
    full = flight.fit((LATE,), range(3), root.values)
    assert full is not None
    found = {finding.effect.name: finding for finding in screen(root, [LATE, SCALED], search_context(root))}
    # As if the projection had seen little of the delay.
    weak, other = replace(found[LATE.name], gain=1.0), found[SCALED.name]
    known = {"sensor-delay:alpha.delay": full.values.shared["sensor-delay:alpha.delay"]}
    tried = _with_fitted(root, [other, weak], [other], root, [root, full])
    assert [finding.effect.name for finding in tried] == [SCALED.name, LATE.name] and tried[1].starts[0] == known
    # Pairs are proposed by projections, which no fit may replace.
    assert tried[1].gain == 1.0 and tried[1].contribution is weak.contribution
    (among,) = _with_fitted(root, [other, weak], [weak], root, [full])
    assert among.starts[0] == known
    # A fit at another set says nothing here, nor does one that brings less than what is tried anyway.
    assert _with_fitted(root, [other, weak], [other], full, [root, full]) == [other]
    strong = replace(other, gain=1e9)
    assert _with_fitted(root, [strong, weak], [strong], root, [full]) == [strong]


def test_a_pair_may_begin_with_what_was_not_chosen_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """No pair is proposed by projection here, and the first step is told that the lesser effect of two did best."""
    values = {"sensor-scale:nz.scale": 1.35, "sensor-delay:q.delay": 0.04}
    scale, late = SensorScale("nz"), SensorDelay("q")
    flight = all_records([coloured(planted([scale, late], values, seed), seed) for seed in (1, 2, 3)])
    root = root_of(flight)
    first = weigh_all(flight, (scale, late), root)
    assert first is not None and first.chosen is not None
    monkeypatch.setattr("ident.tracing.replication.pair_instead.likely_pairs", lambda *of: [])
    # As if another had been chosen that predicts no better than the declared model.
    weak = CrossValidatedEffect(replace(first.chosen.best, gain=0.1, predictions=first.before), ())
    begun = replace(first, results=[first.chosen.best], chosen=weak)
    pair, tried = pair_instead(flight, (scale, late), begun, [weak, weak])
    assert pair is not None and {item.best.effect.name for item in pair} == {scale.name, late.name} and tried
    # No round is made twice.
    assert len({(item.effect.name, item.fitted.names) for item in tried}) == len(tried)
    assert pair_instead(flight, (scale, late), begun, [weak])[0] is None, "of one effect two more are no other pair"
    assert pair_instead(flight, (scale, late), replace(begun, results=[weak.best]), [weak, weak]) == (None, [])


def test_what_stands_beside_another_that_is_not_needed_is_tried_by_itself(late: Flight, monkeypatch: pytest.MonkeyPatch) -> None:
    """A late alpha of which the first round saw nothing, proposed together with a scale that is not there."""
    root, scale = root_of(late), SensorScale("nz")
    first = weigh_all(late, (SCALED,), root)
    assert first is not None and first.chosen is None
    findings = {finding.effect.name: finding for finding in screen(root, [scale, LATE], search_context(root))}
    monkeypatch.setattr("ident.tracing.replication.pair_instead.likely_pairs", lambda *of: [(findings[scale.name], findings[LATE.name])])
    pair, tried = pair_instead(late, (LATE, SCALED), first, [])
    assert pair is not None and [item.best.effect.name for item in pair] == [LATE.name] and pair[0].best.fitted.names == (LATE.name,)
    assert pair[0].best in tried
    # Where the first round has tried it by itself, it was not chosen for a reason.
    known = replace(first, results=[*first.results, pair[0].best])
    assert pair_instead(late, (LATE, SCALED), known, [])[0] is None


def test_every_form_of_an_effect_is_tried() -> None:
    """A form that brings next to nothing has the name of one that explains the records."""
    flight = all_records([coloured(planted([], None, seed), seed) for seed in (1, 2, 3)])
    root = root_of(flight)
    forms = [fitted_to(form, search_context(root)) for form in (ControlNonlinearity(), ControlWeakening())]
    found = screen(root, forms, search_context(root))
    assert [finding.effect.name for finding in found] == ["control-nonlinearity"] * 2
    assert _with_fitted(root, found, found, root, []) == list(found)
