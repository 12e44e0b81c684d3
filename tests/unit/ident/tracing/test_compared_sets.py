"""What a judged set was weighed against: each difference of the criterion in its parts, sets of other size, guards."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.compared_sets import sets_compared, weighed
from ident.tracing.diagnosis import Concern, Verdict
from ident.tracing.loop import diagnose
from ident.tracing.name_probability import SOMETHING_ELSE
from ident.tracing.ranking.choice import Choice
from ident.tracing.selection.ledger import Ledger
from ident.tracing.spikes.masks import measured_masks
from ident.tracing.validation.held_out import HeldOut, HeldOutData, held_out
from ident.tracing.verdict import ResidualTests, verdict_on
from ident.tracing.weighed import ComparedSet, Ground
from sim.declaration.proposal import Traceable
from sim.effects.disturbance.gust_turbulence import GustTurbulence
from sim.effects.dynamics.curves.moment_nonlinearity import MOMENT_NONLINEARITY
from sim.effects.sensor_path.sensor_delay import SensorDelay
from sim.effects.sensor_path.sensor_lag import SensorLag
from sim.effects.sensor_path.sensor_scale import SensorScale
from sim.effects.sensor_path.sensor_step import SensorStep
from sim.effects.sensor_path.vane_offset import VaneOffset
from sim.record import Record
from tests.rate_in_alpha import RateInAlpha
from tests.tracing_problem import OUTPUTS, SETTINGS, declared, doublets, fit_of, planted, problem_of

LATE, LAG, SCALE, GUARD = SensorDelay("alpha"), SensorLag("q"), SensorScale("q"), RateInAlpha(guard=True)
DELAYED = {"sensor-delay:alpha.delay": 0.05}
SETS: tuple[tuple[Traceable, ...], ...] = ((), (LATE,), (SCALE,), (LATE, SCALE), (LATE, LAG), (GUARD, SCALE), (LAG, GUARD), (LATE, LAG, SCALE))


@pytest.fixture(scope="module")
def passed() -> Ledger:
    """What a search over a late angle of attack may have passed."""
    problem = problem_of([planted([LATE], DELAYED, flight=doublets(8.0, 25.0))], (LATE, LAG, SCALE, GUARD))
    ledger, root = Ledger(problem), fit_of(problem)
    for effects in SETS:
        fitted = fit_of(problem, effects, root) if effects else root
        ledger = ledger.kept(fitted, fitted.criterion)
    return ledger


def model(ledger: Ledger, effects: Sequence[Traceable]) -> FittedModel:
    return ledger.models[frozenset(effect.name for effect in effects)]


def named(sets: Sequence[ComparedSet]) -> dict[frozenset[str], ComparedSet]:
    found = {frozenset(item.names): item for item in sets}
    assert len(found) == len(sets), "none twice"
    return found


def test_sets_that_differ_in_one_effect_are_weighed_whatever_their_size_and_guards_are_marked(passed: Ledger) -> None:
    best = model(passed, (LATE, SCALE))
    found = named(sets_compared(passed, Choice(best, HeldOut(None, None))))
    mine = found[frozenset(best.names)]
    assert (mine.misfit, mine.price, mine.declared, mine.guard) == (0.0, 0.0, 0.0, False)
    # One effect fewer, one other in its place; not: two fewer, both others, one more beside.
    expected = [(LATE, SCALE), (LATE,), (SCALE,), (LATE, LAG), (GUARD, SCALE)]
    assert set(found) == {frozenset(effect.name for effect in effects) for effects in expected}
    for key, item in found.items():
        other = passed.models[key]
        assert item.misfit == pytest.approx(2.0 * (other.fit.cost - best.fit.cost)) and item.declared == 0.0
        assert item.misfit + item.price == pytest.approx(other.criterion - best.criterion)
        assert item.guard is (GUARD.name in key)
    assert found[frozenset({LATE.name})].price < 0.0 < found[frozenset({LATE.name})].misfit + 1e-6


def test_of_a_single_effect_the_declared_model_is_one_that_could_stand_in_its_place(passed: Ledger) -> None:
    found = named(sets_compared(passed, Choice(model(passed, (LATE,)), HeldOut(None, None))))
    assert set(found) == {frozenset({LATE.name}), frozenset({SCALE.name}), frozenset()}
    assert found[frozenset()].misfit > 100.0


def test_what_was_compared_counts_with_all_data_that_took_part_and_with_what_the_declared_derivatives_say(passed: Ledger) -> None:
    """Figures by hand: the misfit of the fitted and the other data, its price, and 3.5 that derivatives say against it."""
    best, other, guard = model(passed, (LATE, SCALE)), model(passed, (LATE, LAG)), model(passed, (GUARD, SCALE))
    keys = [frozenset(fitted.names) for fitted in (best, other, guard)]
    misfits = dict(zip(keys, (100.0, 112.0, 101.0), strict=True))
    price = [fitted.criterion - 2.0 * fitted.fit.cost for fitted in (best, other, guard)]
    totals = dict(zip(keys, (100.0 + price[0], 112.0 + price[1] + 3.5, 101.0 + price[2]), strict=True))
    totals |= {frozenset({"unknown to the ledger"}): 1.0}
    found = named(sets_compared(passed, Choice(best, HeldOut(None, None), totals, {**misfits, frozenset({"unknown to the ledger"}): 1.0})))
    assert (found[keys[1]].misfit, found[keys[1]].declared) == pytest.approx((12.0, 3.5))
    assert found[keys[1]].price == pytest.approx(price[1] - price[0])
    assert found[keys[2]].misfit == pytest.approx(1.0) and found[keys[2]].guard and not found[keys[1]].guard
    # What the search alone has passed stays by the fitted records, and nothing that the ledger does not have gets in.
    assert frozenset({LATE.name}) in found and not any("unknown to the ledger" in key for key in found)


def test_a_traced_claim_has_the_probability_of_what_it_was_weighed_against() -> None:
    lag = {"sensor-lag:q.time_constant": 0.06}
    d = diagnose([planted([LAG], lag)], declared(), (LAG, SCALE, SensorDelay("q")), (GUARD,), (), SETTINGS)
    (claim,) = d.effects
    assert claim.name == LAG.name and claim.weighed is not None and claim.weighed.ground is Ground.NOISE_LEFT
    assert frozenset() in named(claim.weighed.sets)
    assert sum(claim.probability.values()) == pytest.approx(1.0) and claim.probability[LAG.name] > 0.9
    # The delay of the same sensor is the same fault described twice.
    assert SensorDelay("q").name not in claim.probability and SOMETHING_ELSE in claim.probability


# Turbulence that comes and goes with the motion.

ROUGH = GustTurbulence()
CURVED = {f"moment-nonlinearity.{item.name}": 0.4 * (-1.0) ** i for i, item in enumerate(MOMENT_NONLINEARITY.parameters)}


def turbulent(record: Record, other: Record) -> tuple[Ledger, FittedModel, HeldOutData]:
    """The declared model and one with turbulence, both known to a ledger, and a record that was not fitted."""
    problem = problem_of([record], (ROUGH,))
    root = fit_of(problem)
    best = problem.fit((ROUGH,), root, None, rough=True)
    assert best is not None
    held = HeldOutData([other], measured_masks([other], OUTPUTS), held_out(root, [other], None, informed=False))
    return Ledger(problem).kept(root, root.criterion).kept(best, best.criterion), best, held


def flown(effect: Traceable, values: dict[str, float], seed: int) -> Record:
    return planted([effect], values, seed, flight=doublets(14.0, 20.0))


def test_process_noise_that_stands_for_what_goes_with_the_motion_is_no_turbulence() -> None:
    ledger, best, held = turbulent(*(flown(MOMENT_NONLINEARITY, CURVED, seed) for seed in (1, 2)))
    choice = weighed(ledger, Choice(best, HeldOut(None, None)), held)
    assert choice.uneven and choice.sets == sets_compared(ledger, choice)
    root = ledger.models[frozenset()]
    verdict, cautions = verdict_on(ledger.problem, root, choice, [], ResidualTests(()), HeldOutData())
    assert verdict is Verdict.UNEXPLAINED and [caution.concern for caution in cautions] == [Concern.GOES_WITH_MOTION]
    # A set without process noise is not asked; a plain form that nobody fitted is fitted for the question.
    assert not weighed(ledger, Choice(root, HeldOut(None, None)), held).uneven
    alone = Ledger(ledger.problem).kept(best, best.criterion)
    assert weighed(alone, Choice(best, HeldOut(None, None)), held).uneven


def test_what_is_left_as_evenly_is_not_said_to_go_with_the_motion() -> None:
    ledger, best, held = turbulent(*(flown(SCALE, {"sensor-scale:q.scale": 1.0}, seed) for seed in (3, 4)))
    assert not weighed(ledger, Choice(best, HeldOut(None, None)), held).uneven


def test_an_effect_without_which_other_data_are_predicted_better_is_idle_and_what_acts_is_not() -> None:
    """A late pitch rate in both records; a vane ahead in the fitted one alone."""
    late, ahead = {"sensor-lag:q.time_constant": 0.06}, {"vane-offset.arm": 12.0}
    effects = (SensorLag("q"), VaneOffset())
    problem = problem_of([planted(effects, late | ahead, 1)], effects)
    root = fit_of(problem)
    best = fit_of(problem, effects, root, late | ahead)
    ledger = Ledger(problem).kept(root, root.criterion).kept(best, best.criterion)
    for arm, idle in ((0.0, ("vane-offset",)), (12.0, ())):
        other = planted(effects, late | {"vane-offset.arm": arm}, 2)
        held = HeldOutData([other], measured_masks([other], OUTPUTS), held_out(root, [other], None), choosing=True)
        choice = weighed(ledger, Choice(best, held_out(best, [other], held.masks)), held)
        assert tuple(choice.idle) == idle
        if idle:
            verdict, cautions = verdict_on(problem, root, choice, [], ResidualTests(()), held)
            assert verdict is Verdict.UNEXPLAINED and [caution.concern for caution in cautions] == [Concern.NO_IMPROVEMENT]
            assert "vane-offset" in cautions[0].sentence


def test_of_three_causes_each_has_to_show_on_data_that_were_not_fitted() -> None:
    """A scale so small that other data hardly know of it: beside one other cause it may stand, beside two it may not."""
    true = {"sensor-lag:q.time_constant": 0.06, "vane-offset.arm": 12.0, "sensor-scale:q.scale": 1.006}
    every = (SensorLag("q"), VaneOffset(), SCALE)
    for effects, idle in (((SensorLag("q"), SCALE), ()), (every, ("sensor-scale:q",))):
        known = {name: value for name, value in true.items() if any(name.startswith(effect.name) for effect in effects)}
        problem = problem_of([planted(effects, known, 1)], effects)
        root = fit_of(problem)
        best = fit_of(problem, effects, root, known)
        ledger = Ledger(problem).kept(root, root.criterion).kept(best, best.criterion)
        records = [planted(effects, known, 2)]
        held = HeldOutData(records, measured_masks(records, OUTPUTS), held_out(root, records, None), choosing=True)
        choice = weighed(ledger, Choice(best, held_out(best, records, held.masks)), held)
        assert tuple(choice.idle) == idle
        if idle:
            verdict, cautions = verdict_on(problem, root, choice, [], ResidualTests(()), held)
            assert verdict is Verdict.UNEXPLAINED and "of three causes or more each has to show there" in cautions[0].sentence


def test_of_three_causes_an_event_that_brings_little_beside_the_others_is_none() -> None:
    """A zero of the pitch rate that jumps: by little beside two causes, by more, and by little beside one."""
    step = SensorStep("q", "rad/s", 0.01)
    both = {"sensor-lag:q.time_constant": 0.06, "vane-offset.arm": 12.0}
    for effects, size, slight in (
        ((SensorLag("q"), VaneOffset(), step), 5e-4, ("sensor-step:q",)),
        ((SensorLag("q"), VaneOffset(), step), 2e-2, ()),
        ((VaneOffset(), step), 5e-4, ()),
    ):
        known = {name: value for name, value in both.items() if any(name.startswith(effect.name) for effect in effects)}
        known |= {"sensor-step:q.at": 5.0, "sensor-step:q.size": size}
        problem = problem_of([planted(effects, known, 1)], effects)
        root = fit_of(problem)
        best = fit_of(problem, effects, root, known)
        ledger = Ledger(problem).kept(root, root.criterion).kept(best, best.criterion)
        choice = weighed(ledger, Choice(best, HeldOut(None, None)), HeldOutData())
        assert tuple(choice.slight) == slight
        if slight:
            verdict, cautions = verdict_on(problem, root, choice, [], ResidualTests(()), HeldOutData())
            assert verdict is Verdict.UNEXPLAINED and [caution.concern for caution in cautions] == [Concern.ONE_CAUSE]
            assert cautions[0].sentence.startswith("sensor-step:q brings hardly anything beside the others")
