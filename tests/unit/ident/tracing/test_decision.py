"""Decisions on records of the rigid aircraft whose cause is known."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.stats import norm

from ident.estimate import Outcome
from ident.tracing import decision
from ident.tracing.decision import (
    _exchange_fault_forms,
    decide,
    search_white_noise,
)
from ident.tracing.diagnosis import Verdict
from ident.tracing.loop import diagnose
from ident.tracing.names import probabilities
from ident.tracing.problem import TraceProblem
from ident.tracing.search import CLEAR_GAIN, Search
from ident.tracing.steady_search import (
    CONFUSABLE_SETS_Z,
    gain_over_scatter,
    quiet_vuong,
    vuong,
)
from ident.whole_record.layout import FitSettings
from sim.effects.disturbance.unmeasured_input import discrepancy_for
from sim.effects.library import effects_for
from sim.record import Record
from sim.truth.measurement import coloured_noise
from tests.diagnoses import NOISE
from tests.tracing_problem import (
    ARM,
    LATE,
    OUTPUTS,
    declared,
    effect,
    offered,
    planted,
    problem_of,
    with_output,
)
from tests.turbulence import rough_record

SHORT = 1.5  # m: what so short a boom changes hides in the noise


def test_nothing_is_named_where_nothing_is_hidden() -> None:
    found = decide(search_white_noise(offered([planted(seed=4)])))
    assert found.verdict is Verdict.CONSISTENT
    assert found.named == ()


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("name", "values"),
    [
        (LATE, {"sensor-delay:alpha.delay": 0.08}),
        ("sensor-scale:q", {"sensor-scale:q.scale": 1.15}),
        ("input-deadband", {"input-deadband.half_width": 0.008}),
    ],
)
def test_what_is_hidden_is_named(name: str, values: dict[str, float]) -> None:
    found = decide(search_white_noise(offered([planted([effect(name)], values, seed=2)])))
    assert found.verdict is Verdict.TRACED
    assert [each.name for each in found.named] == [name]
    assert found.named[0].probability > 0.95


def test_rounds_of_a_second_search_count_on_from_the_first() -> None:
    problem = offered([planted(seed=4)])
    first = search_white_noise(problem)
    second = first.with_candidates([effect(LATE)], "another search").run()
    found = replace(decide(first), searches=(first, second))
    assert min(each.round for each in second.tried) == 1
    assert len(found.candidates) == len(first.tried) + len(second.tried)
    assert [each.round for each in found.candidates[len(first.tried) :]] == [
        len(first.steps) + each.round for each in second.tried
    ]


def with_slow_errors(record: Record, seed: int, size: float) -> Record:
    """The record with slow errors of q and nz, ``size`` times their noise."""
    rng = np.random.default_rng(seed)
    for name in ("q", "nz"):
        (channel,) = [each for each in record.outputs if each.name == name]
        error = coloured_noise(rng, record.time, size * NOISE[name], 1.0)
        record = with_output(record, name, channel.values + error)
    return record


@pytest.mark.long
def test_beside_a_discrepancy_what_acts_all_along_is_named() -> None:
    """Slow errors of moment and lift in no library, and a vane far ahead: the vane is named."""
    records = [
        with_slow_errors(
            planted([effect(ARM)], {"vane-offset.arm": 12.0}, seed=seed), 10 + seed, 1.5
        )
        for seed in (1, 2)
    ]
    discrepancy = discrepancy_for(effects_for(declared().equations))
    search = search_white_noise(offered(records))
    found = decide(search, discrepancy)
    assert found.verdict is Verdict.PARTIAL
    assert [each.name for each in found.named] == [ARM]
    assert found.named[0].spread is not None and found.named[0].spread > 3.5


def test_filtered_noise_is_no_cause() -> None:
    """Noise that a filter has smoothed is not white; nothing is named for it."""
    record = planted(seed=5)
    for name in OUTPUTS:
        (channel,) = [each for each in record.outputs if each.name == name]
        rng = np.random.default_rng(len(name))
        more = np.convolve(rng.normal(size=len(record) + 2), [0.5, 1.0, 0.5], "valid")
        record = with_output(record, name, channel.values + 0.8 * NOISE[name] * more)
    found = decide(
        search_white_noise(offered([record])), discrepancy_for(effects_for(declared().equations))
    )
    assert found.verdict is Verdict.CONSISTENT


def test_an_event_is_placed_to_a_sample() -> None:
    """A zero that jumps: each sample is an optimum of its time, and coarse places miss the right
    one.
    """
    values = {"sensor-step:q.at": 4.343, "sensor-step:q.size": 0.02}
    found = decide(
        search_white_noise(offered([planted([effect("sensor-step:q")], values, seed=9)]))
    )
    assert [each.name for each in found.named] == ["sensor-step:q"]
    (own,) = found.best.values.own
    assert own["sensor-step:q.at"] == pytest.approx(4.343, abs=0.03)


@pytest.mark.long
def test_rough_air_acts_while_the_aircraft_hardly_moves() -> None:
    """Gusts all along, and an error that follows the motion: a filter takes both for rough air."""
    gust = effect("gust-turbulence")
    rough = rough_record(np.random.default_rng(3), 1001)
    moved = rough_record(np.random.default_rng(3), 1001, intensity=1e-6)
    rng = np.random.default_rng(3)
    motion = {each.name: each.values for each in moved.outputs}
    share = np.abs(motion["q"]) / np.max(np.abs(motion["q"]))
    for name in OUTPUTS:
        error = coloured_noise(rng, moved.time, 8.0 * NOISE[name], 0.5) * share
        moved = with_output(moved, name, motion[name] + error)
    z = []
    for record in (rough, moved):
        problem = offered([record])
        less = problem.fit((), None)
        assert less is not None
        more = problem.fit((gust,), less)
        assert more is not None
        z.append(quiet_vuong(more, less, less, float(np.median(np.diff(record.time)))))
    # the level at which turbulence is claimed
    assert z[0] > CONFUSABLE_SETS_Z > z[1]


@pytest.mark.long
def test_white_noise_decides_where_a_discrepancy_is_less_probable() -> None:
    """Two causes of which one brings little: beside a discrepancy its scatter would leave it
    out.
    """
    names = ("sensor-delay:alpha", "input-deadband")
    values = {"sensor-delay:alpha.delay": 0.08, "input-deadband.half_width": 0.004}
    record = planted([effect(name) for name in names], values, seed=10)
    discrepancy = discrepancy_for(effects_for(declared().equations))
    found = decide(search_white_noise(offered([record])), discrepancy)
    assert found.verdict is Verdict.TRACED
    assert {each.name for each in found.named} == set(names)


def test_a_group_that_acts_is_ambiguous_though_no_member_is_certain() -> None:
    """A short boom: a vane and a late alpha look alike."""
    problem = offered([planted([effect(ARM)], {"vane-offset.arm": 2.0 * SHORT}, seed=3)])
    found = decide(search_white_noise(problem))
    (named,) = found.named
    assert found.verdict is Verdict.AMBIGUOUS
    assert {named.name, *named.alternatives} >= {ARM, LATE}
    assert named.probability < 0.95 < named.probability + sum(named.alternatives.values())


def test_effects_that_vuongs_test_does_not_tell_apart_share_their_probability() -> None:
    """The odds of each, by the sets that were fitted and the normal law, are at least its."""
    shared = 0
    for arm in (1.5 * SHORT, 2.0 * SHORT):
        search = search_white_noise(
            offered([planted([effect(ARM)], {"vane-offset.arm": arm}, seed=2)])
        )
        best = search.best()
        for named in decide(search).named:
            assert named.probability + sum(named.alternatives.values()) <= 1.0 + 1e-9
            rest = best.names - {named.name}
            for key, other in search.visited.items():
                (new, *more) = sorted(key - rest) or [named.name]
                if more or new == named.name or not rest < key or other.weight >= best.weight:
                    continue
                z = vuong(best, other, search.context.interval)
                if z < 2.0:
                    odds = named.alternatives[new] / named.probability
                    assert odds > (1.0 - 1e-9) * norm.sf(z) / norm.cdf(z)
                    shared += 1
    assert shared


def test_probabilities_of_sets_that_are_far_from_the_likeliest_add_up_to_one() -> None:
    """Of a record of 8001 samples all sets without a slight member were e^-800 as probable."""
    weights = {("a",): 1000.0, ("b",): 1.0, ("c",): 0.0, ("a", "b"): 995.0}
    visited = {frozenset(key): SimpleNamespace(weight=each) for key, each in weights.items()}
    stub = cast("Search", SimpleNamespace(visited=visited))
    found = probabilities(stub, without={"a"})
    assert found.keys() == {frozenset("b"), frozenset("c")}
    assert found[frozenset("b")] == pytest.approx(1.0 / (1.0 + np.exp(-1.0)))
    assert sum(probabilities(stub).values()) == pytest.approx(1.0)


class Hasty(TraceProblem):
    """Fits of a search that stop after one iteration."""

    @property
    def roughly(self) -> FitSettings:
        return replace(super().roughly, iterations=1)


def test_a_likely_set_is_fitted_until_it_settles() -> None:
    """The lag of an engine lost by 119 to an actuator of second order, whose fit had ended."""
    problem = offered([planted([effect(LATE)], {"sensor-delay:alpha.delay": 0.08}, seed=2)])
    given = {each.name: getattr(problem, each.name) for each in fields(problem) if each.init}
    search = Search(Hasty(**given), problem.candidates)
    whole = problem.fit([effect(LATE)], search.declared)
    rough = search.fit([effect(LATE)], search.declared, [{"sensor-delay:alpha.delay": 0.3}])
    assert rough is not None and rough.fit.outcome is Outcome.MAX_ITERATIONS
    assert whole is not None and rough.fit.cost > whole.fit.cost + 5.0
    assert search.store(rough).fitted.fit.cost < whole.fit.cost + 1.0
    # What is far from likely is not worth it.
    far = replace(search.best(), weight=search.best().weight + 1e5)
    search.visited = {frozenset({"other"}): far}
    assert search.store(rough).fitted is rough


def test_a_set_that_fits_worse_than_a_part_of_it_takes_no_part() -> None:
    """A held sensor of sideslip was named in a measured flight: its fit had ended far from the
    optimum, and the noise that it left was coloured enough to be forgiven.
    """
    problem = offered([planted([effect(LATE)], {"sensor-delay:alpha.delay": 0.08}, seed=2)])
    search = Search(problem, problem.candidates)
    root, whole = search.base_set, problem.fit([effect(LATE)], search.declared)
    assert whole is not None
    good = search.store(whole)
    worse = replace(whole, fit=replace(whole.fit, cost=root.fitted.fit.cost + CLEAR_GAIN + 1.0))
    failed = replace(good, fitted=worse, weight=good.weight + 1e3)
    for sets in ([root, failed], [failed, root]):
        search.visited = {}
        for one in sets:
            search.visited[one.names] = one
            search._exclude_failed(one)
        assert search.best() is root and search.visited[good.names].weight == -math.inf
        assert search.with_prior_odds(search.visited[good.names]).weight == -math.inf
    # The set is fitted again from the part, once, and takes part again.
    repaired = search.set_without(failed, "of a larger set")
    assert repaired is not None and repaired.weight == pytest.approx(good.weight, abs=0.1)
    assert search.best().names == good.names
    search.visited[good.names] = replace(repaired, weight=-math.inf)
    again = search.set_without(failed, "of a larger set")
    assert again is not None and again.weight == -math.inf
    # So does a better fit of the set.
    assert search.store(whole).weight == good.weight and search.best().names == good.names


@pytest.mark.long
def test_the_loop_reports_what_is_decided() -> None:
    records = [planted([effect(LATE)], {"sensor-delay:alpha.delay": 0.08}, seed=7)]
    validation = [planted([effect(LATE)], {"sensor-delay:alpha.delay": 0.08}, seed=8)]
    problem = offered(records)
    told = diagnose(records, problem.model, problem.candidates, (), validation)
    (claim,) = told.effects
    assert told.verdict is Verdict.TRACED
    assert claim.name == LATE
    assert claim.probability[LATE] > 0.95
    assert claim.parameters["delay"].value == pytest.approx(0.08, abs=0.01)
    assert told.error_after.rmse["alpha"] < told.error_before.rmse["alpha"]


@pytest.mark.long
def test_a_second_cause_that_brings_little_is_named_where_kinematics_name_it() -> None:
    """A scale of q and a vane that is hardly late: the second is a hint, or named with support."""
    both = [effect("sensor-scale:q"), effect(LATE)]
    values = {"sensor-scale:q.scale": 1.15, "sensor-delay:alpha.delay": 0.012}
    problem = offered([planted(both, values, seed=1)])
    alone = decide(search_white_noise(problem))
    assert [each.name for each in alone.named] == ["sensor-scale:q"]
    assert [each.name for each in alone.hints] == [ARM], "it stands for a late vane"
    assert "gain in likelihood" in alone.hints[0].reason
    backed = decide(search_white_noise(problem).with_kinematics([(LATE, ARM)]))
    assert {each.name for each in backed.named} == {"sensor-scale:q", ARM}
    assert LATE in {name for each in backed.named for name in each.alternatives}


def test_names_need_a_residual_that_is_noise_on_data_that_were_not_fitted() -> None:
    """Without a discrepancy nothing is named where held-out data say that no set is true."""
    search = search_white_noise(
        offered([planted([effect(LATE)], {"sensor-delay:alpha.delay": 0.08}, seed=2)])
    )
    assert [each.name for each in decide(search).named] == [LATE]
    doubted = decide(search, leaves_noise=lambda fitted: False)
    assert doubted.verdict is Verdict.UNEXPLAINED and doubted.named == ()
    assert "not fitted" in doubted.hints[0].reason


def test_a_declared_model_that_does_not_predict_other_data_is_not_consistent() -> None:
    search = search_white_noise(offered([planted(seed=4)]))
    assert decide(search).verdict is Verdict.CONSISTENT
    doubted = decide(search, leaves_noise=lambda fitted: False)
    assert doubted.verdict is Verdict.UNEXPLAINED and doubted.named == ()


def test_data_that_were_not_fitted_choose_among_likely_sets() -> None:
    """A vane that is slightly late: an arm describes it nearly as well, and is named where what
    the delay predicts is not noise.
    """
    hidden = planted([effect(LATE)], {"sensor-delay:alpha.delay": 0.02}, seed=2)
    search = search_white_noise(problem_of([hidden], [effect(LATE), effect(ARM)], model=declared()))
    (likeliest,) = search.best().names
    (other,) = {LATE, ARM} - {likeliest}
    assert likeliest in {each.name for each in decide(search).named}
    found = decide(search, leaves_noise=lambda fitted: likeliest not in fitted.names)
    assert found.verdict is Verdict.TRACED
    assert [(each.name, dict(each.alternatives)) for each in found.named] == [(other, {})]


def test_what_brings_little_is_named_where_data_that_were_not_fitted_need_it() -> None:
    both = [effect("sensor-scale:q"), effect(LATE)]
    values = {"sensor-scale:q.scale": 1.15, "sensor-delay:alpha.delay": 0.012}
    search = search_white_noise(offered([planted(both, values, seed=1)]))
    assert [each.name for each in decide(search).named] == ["sensor-scale:q"]
    found = decide(search, leaves_noise=lambda fitted: len(fitted.names) > 1)
    assert {each.name for each in found.named} == {"sensor-scale:q", ARM}


def test_a_right_set_stays_where_it_leaves_hardly_more_than_noise_of_other_data() -> None:
    hidden = planted([effect(LATE)], {"sensor-delay:alpha.delay": 0.08}, seed=2)
    search = search_white_noise(offered([hidden]))
    found = decide(search, None, lambda fitted: False, lambda fitted: True)
    assert [each.name for each in found.named] == [LATE]


def late(record: Record, channel: str, samples: int) -> Record:
    """The record with one output that shows earlier values."""
    values = record[channel].values
    moved = np.concatenate([np.full(samples, values[0]), values[:-samples]])
    return with_output(record, channel, moved)


def test_a_late_gyro_is_late_for_gusts_too() -> None:
    """A filter that takes random motion as not late has no evidence for the delay."""
    record = late(rough_record(np.random.default_rng(3), 801, intensity=1.5), "q", 5)
    problem = offered([record])
    gust, delay = effect("gust-turbulence"), effect("sensor-delay:q")
    search = Search(problem, (gust, delay))
    rough = search.fit((gust,), search.declared)
    assert rough is not None
    both = search.fit((gust, delay), rough)
    assert both is not None
    gain = search.store(both).evidence - search.store(rough).evidence
    assert gain > 30.0
    assert both.values.shared["sensor-delay:q.delay"] == pytest.approx(0.1, abs=0.02)


def test_turbulence_of_the_maneuvers_vetoes_no_other_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Turbulence without evidence in steady flight becomes a hint; the others are tested again."""
    record = late(rough_record(np.random.default_rng(3), 801, intensity=1.5), "q", 5)
    gust, delay = effect("gust-turbulence"), effect("sensor-delay:q")
    search = Search(offered([record]), (gust, delay))
    both = search.fit((gust, delay), search.declared)
    assert both is not None
    best, spread = decision._drop_local_evidence(search, search.store(both))
    assert set(spread) == {gust.name, delay.name}
    kept = decision._drop_turbulence_of_maneuvers(search, search, best, spread)
    assert kept == (best, spread, ())  # it acts in steady flight too
    monkeypatch.setattr(decision, "_acts_when_quiet", lambda *_: False)
    monkeypatch.setattr(decision, "vuong", lambda *_: 9.0)
    smaller, others, hints = decision._drop_turbulence_of_maneuvers(search, search, best, spread)
    assert smaller.names == {delay.name} and others == {delay.name: 9.0}
    assert [each.name for each in hints] == [gust.name]
    assert "maneuvers alone" in hints[0].reason and hints[0].within is best.fitted


def test_z_of_few_blocks_is_rarely_large() -> None:
    """Without an effect, z is a normal deviate also where few blocks determine the scatter."""
    rng = np.random.default_rng(4)
    for blocks in (4, 8, 60):
        draws = rng.normal(0.0, 10.0, (4000, blocks))
        z = np.array([gain_over_scatter(float(each.sum()), each) for each in draws])
        shares = [float(np.mean(z > level)) for level in (1.0, 2.0, 2.5)]
        assert shares[0] < 0.18 and shares[1] < 0.03 and shares[2] < 0.01


@pytest.mark.long
@pytest.mark.parametrize(("z", "hinted"), [(2.0, True), (5.0, False), (-1.0, False)])
def test_a_probable_effect_with_local_evidence_is_a_hint(
    monkeypatch: pytest.MonkeyPatch, z: float, hinted: bool
) -> None:
    """Beside a discrepancy: the set with it is likelier, and Vuong's test does not support it."""
    scale = effect("sensor-scale:q")
    hidden = {"sensor-delay:alpha.delay": 0.08, "sensor-scale:q.scale": 1.15}
    search = search_white_noise(offered([planted([effect(LATE), scale], hidden, seed=2)]))
    monkeypatch.setattr(decision, "vuong", lambda *_: z)
    late = search.set_without(search.visited[frozenset({LATE, "sensor-scale:q"})], "sensor-scale:q")
    assert late is not None
    hints = decision._local_hints(search, late)
    assert [each.name for each in hints] == (["sensor-scale:q"] if hinted else [])
    if hinted:
        assert "2.0" in hints[0].reason and "3.5" in hints[0].reason
        assert hints[0].within is search.visited[frozenset({LATE, "sensor-scale:q"})].fitted


def test_another_fault_of_the_sensor_takes_the_place_of_what_kinematics_name() -> None:
    """A gyro's threshold: kinematics know a scale of it, but the threshold is likelier."""
    shown = effect("sensor-deadband:q")
    record = planted([shown], {"sensor-deadband:q.half_width": 0.02}, seed=7)
    scale = effect("sensor-scale:q")
    problem = replace(
        problem_of([record], [shown, scale], model=declared()), kinematic=(("sensor-scale:q",),)
    )
    discrepancy = discrepancy_for(effects_for(declared().equations))
    assert discrepancy is not None
    search = Search(problem, (shown, scale), (discrepancy,))
    named = search.set_named_by_kinematics()
    assert named is not None and search.added(named) == {"sensor-scale:q"}
    assert search.added(_exchange_fault_forms(search, named)) == {"sensor-deadband:q"}


@pytest.mark.long
def test_a_search_that_offers_more_goes_on_from_the_sets_that_are_fitted() -> None:
    """It ends where a search among all candidates from the beginning ends, with fewer fits."""
    both = [effect("sensor-scale:q"), effect(LATE)]
    values = {"sensor-scale:q.scale": 1.15, "sensor-delay:alpha.delay": 0.08}
    problem = offered([planted(both, values, seed=1)])
    few = [each for each in problem.candidates if each.name != LATE]
    further = Search(problem, few).run().with_candidates(problem.candidates, "all candidates").run()
    whole = Search(problem, problem.candidates).run()
    assert further.best().names == whole.best().names == {"sensor-scale:q", LATE}
    assert further.best().weight == pytest.approx(whole.best().weight, abs=0.5)
    assert further.fits < whole.fits
