"""Near-aliases: what could take the place of an effect is fitted in its place, and kept where it does nearly as well."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import pytest

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Candidate
from ident.tracing.selection.ledger import Ledger
from ident.tracing.selection.near_aliases import guards_for_events, near_aliases
from sim.declaration.proposal import SearchContext, Traceable
from sim.effects.disturbance.gust_discrete import GustDiscrete
from sim.effects.disturbance.gust_turbulence import GustTurbulence
from sim.effects.disturbance.phugoid import Phugoid
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.guards.products import GUARDS
from sim.effects.sensor_path.sensor_delay import SensorDelay
from sim.effects.sensor_path.sensor_drift import SensorDrift
from sim.effects.sensor_path.sensor_lag import SensorLag
from sim.effects.sensor_path.sensor_scale import SensorScale
from sim.effects.sensor_path.vane_offset import VaneOffset
from tests.rate_in_alpha import RateInAlpha
from tests.tracing_problem import SETTINGS, doublets, fit_of, planted, problem_of

LATE, LAG, AHEAD, SCALE = SensorDelay("alpha"), SensorLag("alpha"), VaneOffset(), SensorScale("nz")


def ledger_of(candidates: Sequence[Traceable], effects: Sequence[Traceable] = (LATE,), delay: float = 0.02) -> tuple[Ledger, FittedModel]:
    """A ledger that holds the declared model and one set, of a record with a late vane and, in sets of two, a wrong scale."""
    values = {"sensor-delay:alpha.delay": delay, "sensor-scale:nz.scale": 1.3}
    problem = problem_of([planted(effects, {name: value for name, value in values.items() if name.split(".")[0] in {e.name for e in effects}}, 2)])
    problem = replace(problem, candidates=tuple(candidates))
    root = fit_of(problem)
    best = fit_of(problem, effects, root)
    return Ledger(problem).kept(root, root.criterion).kept(best, best.criterion - 3.0), best


def seen(name: str, *alike: str, within: tuple[str, ...] = ()) -> Candidate:
    return Candidate(1, within, name, 100.0, 0.0, True, True, {}, None, alike)


def test_what_an_effect_calls_alike_is_fitted_in_its_place() -> None:
    ledger, best = ledger_of((LATE, AHEAD, SCALE))
    after, (other,) = near_aliases(ledger, best, SETTINGS.near)
    assert other.names == (AHEAD.name,)
    assert 0.0 < other.criterion - best.criterion < SETTINGS.near
    # Weighed by the plain criterion: nothing says how evenly it brings what it brings.
    assert after.score(other) - after.score(best) == pytest.approx(other.criterion - best.criterion)
    assert after.known(other) is other and after.spent > ledger.spent
    (step,) = after.steps
    assert step.effects == (AHEAD.name,) and step.sentence == "vane-offset in the place of sensor-delay:alpha fits nearly as well"
    # It is there now, and not fitted again.
    assert near_aliases(after, best, SETTINGS.near) == (after, [])


def test_beside_the_rest_of_a_set() -> None:
    ledger, best = ledger_of((LATE, AHEAD, SCALE), (SCALE, LATE))
    after, found = near_aliases(ledger, best, SETTINGS.near)
    assert [frozenset(fitted.names) for fitted in found] == [frozenset({SCALE.name, AHEAD.name})]
    assert len(after.steps) == 1


def test_what_is_clearly_worse_is_not_kept() -> None:
    ledger, best = ledger_of((LATE, AHEAD), delay=0.05)
    after, found = near_aliases(ledger, best, SETTINGS.near)
    assert found == [] and after.models.keys() == ledger.models.keys() and after.steps == ()
    # By the likelihood, whatever the number of parameters: it lies some thirty below.
    assert [fitted.names for fitted in near_aliases(ledger, best, 60.0)[1]] == [(AHEAD.name,)]


def test_what_the_evidence_calls_alike_is_tried_from_either_side_and_in_like_company_only() -> None:
    stranger = RateInAlpha()
    ledger, best = ledger_of((LATE, stranger, Phugoid()))
    assert near_aliases(ledger, best, SETTINGS.near) == (ledger, [])
    for told, expected in (
        (seen(LATE.name, stranger.name), [(stranger.name,)]),
        (seen(stranger.name, LATE.name), [(stranger.name,)]),
        (seen(stranger.name, LATE.name, within=("input-delay",)), []),
        # What any record may have may have left the set since.
        (seen(stranger.name, LATE.name, within=("phugoid",)), [(stranger.name,)]),
    ):
        assert [fitted.names for fitted in near_aliases(ledger.told(evidence=[told]), best, SETTINGS.near)[1]] == expected


def test_guards_process_noise_and_a_second_fault_of_one_sensor_take_no_place() -> None:
    guard = GUARDS[0]
    ledger, best = ledger_of((LATE, LAG, guard, GustTurbulence()))
    ledger = ledger.told(evidence=[seen(LATE.name, guard.name, "gust-turbulence")])
    _, found = near_aliases(ledger, best, 1e9)
    assert [fitted.names for fitted in found] == [(LAG.name,)]
    # Beside the delay of a sensor its lag stands for nothing else.
    ledger, best = ledger_of((LATE, LAG, SCALE), (LATE, SCALE))
    ledger = ledger.told(evidence=[seen(SCALE.name, LAG.name)])
    assert not any({LATE.name, LAG.name} <= set(fitted.names) for fitted in near_aliases(ledger, best, 1e9)[1])


def test_what_promises_little_is_not_worth_a_fit() -> None:
    """A scale of nz explains nothing of a late vane, whatever the evidence says."""
    ledger, best = ledger_of((LATE, SCALE))
    ledger = ledger.told(evidence=[seen(LATE.name, SCALE.name)])
    after, found = near_aliases(ledger, best, 1e9)
    assert found == [] and SCALE.name not in {name for key in after.models for name in key}


def test_a_search_without_means_fits_none() -> None:
    ledger, best = ledger_of((LATE, AHEAD))
    spent = replace(ledger, spent=ledger.problem.settings.budget)
    assert near_aliases(spent, best, SETTINGS.near)[1] == []


def test_a_guard_is_tried_in_the_place_of_an_event_that_the_search_was_content_with(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where both were tried the guard brought half as much or more: the event is not claimed before it was tried in its place, too."""
    load, scale, guard = UnmeasuredInput(), SensorScale("nz"), GUARDS[0]
    values = {"unmeasured-input.start": 6.0, "unmeasured-input.duration": 0.8, "unmeasured-input.moment": 0.01, "sensor-scale:nz.scale": 1.3}
    problem = problem_of([planted((load, scale), values, 2)], (load, scale, guard))
    root = fit_of(problem)
    best, steady = fit_of(problem, (scale, load), root, values), fit_of(problem, (scale,), root)
    ledger = Ledger(problem).kept(root, root.criterion).kept(best, best.criterion)
    asked: list[tuple[str, set[str]]] = []

    def spy(ledger: Ledger, best: FittedModel, effect: Traceable, names: set[str], within: float) -> tuple[Ledger, list[FittedModel]]:
        asked.append((effect.name, names))
        return ledger, []

    monkeypatch.setattr("ident.tracing.selection.near_aliases._in_the_place_of", spy)
    weak = replace(seen(guard.name), gain=40.0)
    told: list[tuple[Candidate, ...]] = [(seen(load.name), weak), (seen(load.name), seen(guard.name)), (seen(guard.name),)]
    for evidence in told:
        guards_for_events(ledger.told(evidence=evidence), best, SETTINGS.near)
    assert asked == [(load.name, set()), (load.name, {guard.name}), (load.name, set())]
    guards_for_events(ledger.told(evidence=told[1]), steady, SETTINGS.near)
    assert len(asked) == 3
    known = problem.fit((scale, guard), root)
    assert known is not None
    guards_for_events(ledger.kept(known, known.criterion).told(evidence=told[1]), best, SETTINGS.near)
    assert asked[-1] == (load.name, set())


def test_an_alias_is_put_where_the_rest_stands_as_it_is_in_the_set(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fit without the effect may have bent so far that nothing leads back from there."""
    ledger, best = ledger_of((LATE, AHEAD, SCALE), (SCALE, LATE))
    monkeypatch.setattr("ident.tracing.selection.near_aliases.best_fit", lambda ledger, base, finding, starts: (ledger, None))
    _, (other,) = near_aliases(ledger, best, SETTINGS.near)
    assert frozenset(other.names) == {SCALE.name, AHEAD.name}
    assert other.values.shared["sensor-scale:nz.scale"] == pytest.approx(1.3, abs=0.02)
    # With a filter there is no residual to screen that the rest alone leaves.
    rest = ledger.problem.at_values((SCALE,), best)
    assert rest is not None and rest.fit.cost > best.fit.cost and rest.values.shared["Cm_q"] == best.values.shared["Cm_q"]


def test_an_event_that_was_missed_is_put_where_another_stands() -> None:
    pulse, gust = UnmeasuredInput(), GustDiscrete()
    values = {"gust-discrete.start": 4.0, "gust-discrete.duration": 1.0, "gust-discrete.peak": 3.0}
    problem = replace(problem_of([planted([gust], values)]), candidates=(pulse, gust))
    root = fit_of(problem)
    missed = fit_of(problem, [gust], root, {"gust-discrete.start": 8.0, "gust-discrete.peak": 0.1})
    best = fit_of(problem, [pulse], root, {"unmeasured-input.start": 4.0, "unmeasured-input.duration": 1.0, "unmeasured-input.moment": 0.001})
    ledger = Ledger(problem).kept(root, root.criterion).kept(missed, missed.criterion).kept(best, best.criterion)
    after, found = near_aliases(ledger, best, SETTINGS.near)
    assert [fitted.names for fitted in found] == [(gust.name,)] and after.known(missed) is found[0]
    assert found[0].fit.cost < min(missed.fit.cost, best.fit.cost)
    assert found[0].values.own[0]["gust-discrete.start"] == pytest.approx(4.0, abs=0.1)


@dataclass(frozen=True)
class AsFitted(VaneOffset):
    """A vane ahead that takes what is fitted from its context, as a curve takes the range that was flown; by its dictionary it has no hash."""

    seen: Mapping[str, float] = field(default_factory=dict)

    def fitted_to(self, context: SearchContext) -> AsFitted:
        return replace(self, seen=dict(context.values))


def test_an_alias_that_takes_its_ranges_from_the_fit_is_found_there_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the rest stands and where it bent the same candidate has other ranges: it is known by its name."""
    ledger, best = ledger_of((LATE, AsFitted(), SCALE), (SCALE, LATE))
    monkeypatch.setattr("ident.tracing.selection.near_aliases.best_fit", lambda ledger, base, finding, starts: (ledger, None))
    _, (other,) = near_aliases(ledger, best, SETTINGS.near)
    assert frozenset(other.names) == {SCALE.name, AHEAD.name}


def test_a_slow_fault_of_one_sensor_is_put_in_the_place_of_slow_motion() -> None:
    """A phugoid takes in a zero of alpha that drifts, and the record shows which of them it was."""
    drift, slow = SensorDrift("alpha", "rad", 1e-3), Phugoid()
    problem = problem_of([planted([drift], {"sensor-drift:alpha.slope": 0.0008}, flight=doublets(20.0, 25.0))], (drift, slow, SCALE))
    root = fit_of(problem)
    best = fit_of(problem, [slow], root)
    ledger = Ledger(problem).kept(root, root.criterion).kept(best, best.criterion)
    assert root.fit.cost - best.fit.cost > 10.0
    _, found = near_aliases(ledger, best, SETTINGS.near)
    (other,) = [fitted for fitted in found if fitted.names == (drift.name,)]
    assert other.criterion < best.criterion
