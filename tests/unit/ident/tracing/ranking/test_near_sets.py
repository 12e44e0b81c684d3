"""Of sets that are near each other, the one to judge: what data that were not fitted may change in that, and when."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import pytest

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.candidate_model.problem import TraceProblem
from ident.tracing.diagnosis import Concern, Verdict
from ident.tracing.ranking.choice import Choice, alternatives_of, is_ambiguous
from ident.tracing.ranking.freer_form import _freer
from ident.tracing.ranking.near_sets import believable_choice, choose_among_near
from ident.tracing.selection.criterion import is_white
from ident.tracing.selection.ledger import Ledger
from ident.tracing.spikes.masks import measured_masks
from ident.tracing.validation.held_out import HeldOut, HeldOutData, doubted, held_out, predicted_by
from ident.tracing.verdict import ResidualTests, verdict_on
from sim.declaration.proposal import Refinable, Traceable
from sim.effects.dynamics.curves.control_nonlinearity import VARIANTS as CURVES
from sim.effects.dynamics.curves.control_weakening import ControlWeakening
from sim.effects.dynamics.curves.moment_nonlinearity import MOMENT_NONLINEARITY
from sim.effects.sensor_path.sensor_delay import SensorDelay
from sim.effects.sensor_path.sensor_lag import SensorLag
from sim.effects.sensor_path.sensor_scale import SensorScale
from sim.effects.sensor_path.time_base import TimeBase
from sim.effects.sensor_path.vane_offset import VaneOffset
from sim.record import Record
from tests.rate_in_alpha import RateInAlpha
from tests.tracing_problem import OUTPUTS, SETTINGS, fit_of, planted, problem_of

LATE, AHEAD = SensorDelay("alpha"), VaneOffset()
BEND = replace(MOMENT_NONLINEARITY, low=-0.15, high=0.15)
SHARP = {f"moment-nonlinearity.{name}": 0.0 for name in BEND.finer().absent} | {
    "moment-nonlinearity.shape1": -0.01,
    "moment-nonlinearity.shape6": 0.01,
}


def ledger_of(record: Record, *sets: Sequence[Traceable]) -> tuple[Ledger, FittedModel]:
    """A ledger with the declared model and fitted sets, scored by their criterion; the first of them is the best."""
    problem = problem_of([record], tuple({effect.name: effect for effects in sets for effect in effects}.values()))
    root = fit_of(problem)
    ledger, fitted = Ledger(problem).kept(root, root.criterion), [fit_of(problem, effects, root) for effects in sets]
    for each in fitted:
        ledger = ledger.kept(each, each.criterion)
    return ledger, fitted[0]


def data(ledger: Ledger, records: Sequence[Record], *, choosing: bool = True) -> HeldOutData:
    root = ledger.models[frozenset()]
    return HeldOutData(records, measured_masks(records, OUTPUTS), held_out(root, records, None, informed=False), choosing)


@pytest.fixture(scope="module")
def bent() -> tuple[Ledger, FittedModel, Record]:
    """A moment that bends more sharply than four shapes follow: a noisy record does not show that, a clean one does."""
    noisy, clean = planted([BEND.finer()], SHARP, 1, scale=4.0), planted([BEND.finer()], SHARP, 5)
    return *ledger_of(noisy, [BEND]), clean


def fine(fitted: FittedModel) -> bool:
    (effect,) = fitted.effects
    return getattr(effect, "fine", False) is True


def test_data_that_choose_may_ask_for_the_freer_form(bent: tuple[Ledger, FittedModel, Record]) -> None:
    ledger, best, clean = bent
    held = data(ledger, [clean])
    assert is_white(best, SETTINGS.white) and doubted(predicted_by(best, held))
    after, choice = choose_among_near(ledger, best, held)
    assert fine(choice.best) and not doubted(choice.out) and choice.best.names == best.names
    assert after.known(choice.best) is choice.best and after.score(choice.best) == ledger.score(best)
    assert after.steps[-1].sentence == "freer forms, for what the records that were not fitted show of them"
    assert choice.out.informed is not None and set(choice.totals) == {frozenset(best.names)}


def test_neither_data_that_are_held_out_nor_data_that_bear_the_plain_form_ask_for_it(bent: tuple[Ledger, FittedModel, Record]) -> None:
    ledger, best, clean = bent
    assert not fine(choose_among_near(ledger, best, data(ledger, [clean], choosing=False))[1].best)
    as_noisy = data(ledger, [planted([BEND.finer()], SHARP, 6, scale=4.0)])
    assert not doubted(predicted_by(best, as_noisy))
    after, choice = choose_among_near(ledger, best, as_noisy)
    assert not fine(choice.best) and after.steps == ledger.steps


def test_where_other_data_doubt_the_best_set_rivals_are_looked_for_farther_away() -> None:
    """The late vane wins in the fitted record by more than what is near; in the other one the vane is ahead, and more so."""
    ledger, best = ledger_of(planted([LATE], {"sensor-delay:alpha.delay": 0.05}, 2), [LATE], [AHEAD])
    behind = ledger.models[frozenset({AHEAD.name})].criterion - best.criterion
    assert SETTINGS.near < behind < SETTINGS.wide
    other = planted([AHEAD], {"vane-offset.arm": 10.0}, 9, scale=0.3)
    held = data(ledger, [other])
    assert doubted(predicted_by(best, held))
    _, choice = choose_among_near(ledger, best, held)
    assert choice.best.names == (AHEAD.name,) and len(choice.totals) == 2
    # The cost of all data, those that were not fitted included.
    for name in (LATE.name, AHEAD.name):
        fitted = ledger.models[frozenset({name})]
        informed = predicted_by(fitted, held).informed
        assert informed is not None
        assert choice.totals[frozenset({name})] == pytest.approx(fitted.criterion + 2.0 * informed.cost, abs=1.0)
        assert choice.misfits[frozenset({name})] == pytest.approx(2.0 * (fitted.fit.cost + informed.cost), abs=1.0)
    # Held out, they neither choose nor widen what is looked at; nor do data that bear the best set.
    for calm in (replace(held, choosing=False), data(ledger, [planted([LATE], {"sensor-delay:alpha.delay": 0.05}, 9)])):
        _, choice = choose_among_near(ledger, best, calm)
        assert choice.best.names == (LATE.name,) and set(choice.totals) == {frozenset({LATE.name})}


def test_a_guard_that_ties_on_the_fitted_record_and_wins_where_it_was_not_fitted_outdoes_the_set() -> None:
    """A late vane where the fitted record was flown; in the other one alpha holds a share of the pitch rate, which is no effect here."""
    guard = RateInAlpha(guard=True)
    ledger, best = ledger_of(planted([LATE], {"sensor-delay:alpha.delay": 0.02}, 2), [LATE], [guard])
    behind = ledger.models[frozenset({guard.name})].criterion - best.criterion
    assert 0.0 < behind < SETTINGS.near
    elsewhere = planted([AHEAD], {"vane-offset.arm": 12.0}, 9)
    after, choice = choose_among_near(ledger, best, data(ledger, [elsewhere]))
    assert choice.best.guards == (guard.name,) and choice.best is not best and choice.out.informed is not None
    verdict, cautions = verdict_on(after.problem, ledger.models[frozenset()], choice, [], ResidualTests(()), data(ledger, [elsewhere]))
    assert verdict is Verdict.UNEXPLAINED and cautions[0].concern is Concern.GUARD
    # Not where the other data do not choose, nor where they speak for the effect; and then what was compared is told with the guard.
    _, choice = choose_among_near(ledger, best, data(ledger, [elsewhere], choosing=False))
    assert choice.best.names == (LATE.name,) and set(choice.totals) == {frozenset({LATE.name})}
    _, choice = choose_among_near(ledger, best, data(ledger, [planted([LATE], {"sensor-delay:alpha.delay": 0.02}, 9)]))
    assert choice.best.names == (LATE.name,) and frozenset({guard.name}) in choice.totals


def test_what_training_leaves_unexplained_is_not_put_to_others() -> None:
    ledger, best = ledger_of(planted([LATE, SensorScale("nz")], {"sensor-delay:alpha.delay": 0.2, "sensor-scale:nz.scale": 1.5}, 2), [LATE], [AHEAD])
    assert not is_white(best, SETTINGS.white)
    held = data(ledger, [planted(seed=3)])
    after, choice = choose_among_near(ledger, best, held)
    assert after is ledger and choice.best is best and choice.totals == {}
    assert choice.out.frozen is not None and choice.out.informed is None


def choice_of(problem: TraceProblem, best: FittedModel, totals: Mapping[str, float]) -> Choice:
    """A choice among sets of one effect, by name, with the same figures for criterion and misfit."""
    figures = {frozenset(name.split(" + ")): value for name, value in totals.items()}
    return Choice(best, HeldOut(None, None), figures, figures)


def test_alternatives_and_ties_by_hand() -> None:
    """Two names at most, the nearest first; a guard, another size and the same sensor's other lateness make no tie."""
    guard = RateInAlpha(guard=True)
    problem = problem_of([planted([LATE], {"sensor-delay:alpha.delay": 0.02}, 2)], (LATE, guard))
    best, guards = fit_of(problem, [LATE]), frozenset({guard.name})
    choice = choice_of(problem, best, {LATE.name: 100.0, "far": 110.5, "c": 109.0, "b": 103.5, "a": 108.0, guard.name: 100.1, "b + a": 90.0})
    assert alternatives_of(choice, guards) == {LATE.name: ("b", "a")}
    assert not is_ambiguous(choice, guards)
    for name, expected in (("b", True), (SensorLag("alpha").name, False), (guard.name, False), ("b + a", False)):
        assert is_ambiguous(choice_of(problem, best, {LATE.name: 100.0, name: 102.5}), guards) is expected
    assert not is_ambiguous(choice_of(problem, best, {LATE.name: 100.0, "b": 103.5}), guards)
    assert alternatives_of(Choice(best, HeldOut(None, None)), guards) == {} and not is_ambiguous(Choice(best, HeldOut(None, None)), guards)


def test_of_exact_twins_the_likelier_cause_is_chosen_whichever_of_them_the_search_kept() -> None:
    """A clock that runs fast is an angle of attack read too small: the data cannot tell, and say so."""
    record = planted([TimeBase()], {"time-base.factor": 1.06}, 3)
    for first in (TimeBase(), SensorScale("alpha")):
        ledger, best = ledger_of(record, [first], [SensorScale("alpha") if first == TimeBase() else TimeBase()])
        _, choice = choose_among_near(ledger, best, HeldOutData())
        assert choice.best.names == ("sensor-scale:alpha",)
        assert is_ambiguous(choice, frozenset()) and alternatives_of(choice, frozenset()) == {"sensor-scale:alpha": ("time-base",)}
        assert choice.best.values.shared["sensor-scale:alpha.scale"] == pytest.approx(1.0 / 1.06, abs=0.02)


def test_a_set_of_fewer_effects_with_a_lower_criterion_takes_the_place_of_a_larger_one() -> None:
    """Scores depend on the way to a set: here the larger one has the better score."""
    ledger, larger = ledger_of(planted([LATE], {"sensor-delay:alpha.delay": 0.08}, 3), [AHEAD, SensorScale("q")], [LATE])
    smaller = ledger.models[frozenset({LATE.name})]
    assert smaller.criterion < larger.criterion
    ledger = ledger.replaced(larger, smaller.criterion - 50.0)
    _, choice = choose_among_near(ledger, larger, HeldOutData())
    assert choice.best.names == (LATE.name,)


def test_what_the_one_that_took_anothers_place_explains_is_dropped() -> None:
    """Beside an angle of attack that is read too large a scale of the pitch rate explains nothing."""
    scales = {"sensor-scale:alpha.scale": 1.15}
    ledger, wrong = ledger_of(planted([SensorScale("alpha")], scales, 3), [SensorScale("q"), SensorScale("alpha")], [SensorScale("alpha")])
    ledger = ledger.replaced(wrong, ledger.score(wrong))
    _, choice = believable_choice(ledger, wrong, HeldOutData())
    assert choice.best.names == ("sensor-scale:alpha",)


def test_a_form_without_a_freer_one_is_made_freer_by_that_of_its_name() -> None:
    weak, late = ControlWeakening(), SensorLag("q")
    curve = next(variant for variant in CURVES if variant.name == weak.name and isinstance(variant, Refinable))
    problem = problem_of([planted()], (weak, late, curve))
    best = fit_of(problem, [weak])
    ledger = Ledger(problem)
    freer = _freer(ledger, best, weak)
    assert freer.name == weak.name and type(freer) is type(curve) and isinstance(freer, Refinable)
    assert _freer(ledger, best, freer) == freer.finer() and _freer(ledger, best, late) is late
