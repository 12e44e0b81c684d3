"""Which effects of the most probable set are named, and which are hints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import pytest

from ident.tracing.decision import (
    _decide_under_white_noise,
    decide,
    search_white_noise,
)
from ident.tracing.diagnosis import Verdict
from ident.tracing.evidence import WeighedSet
from ident.tracing.names import EVENT_ODDS, _likeliest_without, is_physical_effect
from ident.tracing.search import CLEAR_GAIN, Search
from ident.tracing.whiteness import is_noise
from sim.declaration.proposal import Traceable
from sim.effects.library import effects_for
from tests.tracing_problem import (
    ARM,
    LATE,
    declared,
    effect,
    offered,
    planted,
    problem_of,
)

SHORT = 1.5  # m: what so short a boom changes hides in the noise


def give_weights(search: Search, weights: Mapping[tuple[Traceable, ...], float]) -> None:
    """Leave a search with the declared model and these sets, at weights above the model's."""
    root, weighed = search.base_set, {search.base_set.names: search.base_set}
    for effects, weight in weights.items():
        fitted = search.fit(effects, root.fitted)
        assert fitted is not None
        one = replace(search.store(fitted), weight=root.weight + weight)
        weighed[one.names] = one
    search.visited = weighed


def test_motion_that_any_record_may_have_is_offered_in_the_place_of_a_member() -> None:
    """A pulse stood for a phugoid: what it brings counts from the set with the phugoid."""
    weights = {("a", "pulse"): 100.0, ("a",): 10.0, ("a", "phugoid"): 72.0, ("phugoid",): 80.0}
    visited = {
        frozenset(key): SimpleNamespace(names=frozenset(key), weight=weight)
        for key, weight in weights.items()
    }
    stub = SimpleNamespace(
        visited=visited, set_without=lambda best, name: visited[frozenset(best.names - {name})]
    )
    search, best = cast("Search", stub), cast("WeighedSet", visited[frozenset({"a", "pulse"})])
    found = _likeliest_without(search, best, "pulse", {"phugoid"})
    assert found is not None and found.names == {"a", "phugoid"}
    found = _likeliest_without(search, best, "pulse", ())
    assert found is not None and found.names == {"a"}


@pytest.mark.parametrize(("odds", "named"), [(4.0, []), (10.0, ["phugoid"])])
def test_uncertain_motion_that_any_record_may_have_leaves_the_declared_model_standing(
    odds: float, named: list[str]
) -> None:
    """A clean flight was ``unexplained`` because a phugoid was neither certain nor excluded."""
    search = search_white_noise(offered([planted([], {}, seed=1)]))
    root = search.base_set
    assert is_noise(root.fitted.fit)
    other, one = (
        replace(search.store(fitted), weight=root.weight + weight)
        for name, weight in (("sensor-scale:q", 3.0), ("phugoid", odds))
        if (fitted := search.fit([effect(name)], root.fitted)) is not None
    )
    search.visited = {each.names: each for each in (root, other, one)}
    found = _decide_under_white_noise(search, one)
    assert [each.name for each in found.named] == named
    assert found.verdict is (Verdict.AMBIGUOUS if named else Verdict.CONSISTENT)
    hinted = {each.name: each for each in found.hints}
    if not named:
        assert found.best is root.fitted
        assert hinted["phugoid"].within is one.fitted


def test_what_is_not_certain_is_left_out_where_a_weak_member_is_gone() -> None:
    """An accelerometer ahead with 1800 in its favour was not named: beside it stood a phugoid of
    one half, once a third effect was gone.
    """
    search = search_white_noise(
        offered([planted([effect(LATE)], {"sensor-delay:alpha.delay": 0.08}, seed=2)])
    )
    late, slow, scale = map(effect, (LATE, "phugoid", "sensor-scale:q"))
    give_weights(search, {(late,): 500.0, (late, slow): 500.5, (late, scale): 505.0})
    found = _decide_under_white_noise(search, search.best())
    assert found.verdict is Verdict.TRACED
    assert [each.name for each in found.named] == [LATE]


@pytest.mark.parametrize(("size", "named"), [(0.005, False), (0.03, True)])
def test_a_passing_load_is_named_where_its_odds_are_large(size: float, named: bool) -> None:
    """In random cases false loads in passing had log odds up to 185, true ones from 220 on. A small
    one stays a hint, and no likelier name takes its place.
    """
    every = effects_for(declared().equations)
    pulse = next(each for each in every if each.name == "unmeasured-input")
    assert isinstance(pulse, Traceable)
    values = {"start": 4.0, "duration": 1.2, "lift": size, "moment": 0.5 * size}
    record = planted(
        [pulse, effect(LATE)],
        {f"{pulse.name}.{key}": each for key, each in values.items()} | {f"{LATE}.delay": 0.08},
        seed=3,
    )
    offered_too = (LATE, ARM, "sensor-step:q", "sensor-scale:q", pulse.name)
    few = [each for each in every if each.name in offered_too and isinstance(each, Traceable)]
    search = search_white_noise(problem_of([record], few, model=declared()))
    best = search.best()
    smaller = search.set_without(best, pulse.name)
    assert smaller is not None
    log_odds = best.weight - smaller.weight
    assert log_odds > EVENT_ODDS if named else CLEAR_GAIN < log_odds < EVENT_ODDS
    found = decide(search)
    assert {each.name for each in found.named} == ({LATE, pulse.name} if named else {LATE})
    hints = {each.name: each.reason for each in found.hints}
    told = f"its log posterior odds are {log_odds:.0f}; {EVENT_ODDS:.0f} are required"
    assert named or told in hints[pulse.name]


def test_of_two_alternatives_in_the_likeliest_set_one_stands() -> None:
    """A vane 8 m ahead of the centre of gravity was not named: the likeliest set had a lag of
    alpha as well, and neither was certain beside the other.
    """
    search = search_white_noise(
        offered([planted([effect(LATE)], {"sensor-delay:alpha.delay": 0.08}, seed=2)])
    )
    late, arm = effect(LATE), effect(ARM)
    give_weights(search, {(late,): 498.1, (arm,): 498.0, (late, arm): 500.0})
    found = _decide_under_white_noise(search, search.best())
    assert found.verdict is Verdict.AMBIGUOUS
    (named,) = found.named
    assert named.name == LATE and ARM in named.alternatives


def test_what_brings_little_where_the_declared_model_leaves_noise_is_a_hint() -> None:
    """The equations of any model are a little wrong; where they leave no noise something acts."""
    shorter, short = (
        offered([planted([effect(ARM)], {"vane-offset.arm": arm}, seed=2)])
        for arm in (SHORT, 1.5 * SHORT)
    )
    search = search_white_noise(shorter)
    assert is_noise(search.base_set.fitted.fit)
    assert 3.0 < search.best().weight - search.base_set.weight < 30.0
    found = decide(search)
    assert found.verdict is Verdict.CONSISTENT and not found.named
    (hint,) = found.hints
    assert hint.name == ARM and "gain in likelihood" in hint.reason
    search = search_white_noise(short)
    assert not is_noise(search.base_set.fitted.fit)
    assert [each.name for each in decide(search).named] == [ARM]


def test_a_frequency_above_half_the_sampling_rate_is_no_cause() -> None:
    servo = effect("actuator-second-order")
    search = search_white_noise(offered([planted(seed=4)]))
    for frequency, cause in ((40.0, True), (200.0, False)):
        values = {"actuator-second-order.frequency": frequency}
        fitted = SimpleNamespace(fitted=SimpleNamespace(values=SimpleNamespace(shared=values)))
        assert is_physical_effect(servo, cast(WeighedSet, fitted), 0.02) is cause
    assert decide(search).hints == ()


def test_a_phugoid_that_takes_the_place_of_a_small_event_hides_no_cause() -> None:
    """An elevator that followed 0.09 s late was not named: a small load in passing was left out,
    and the phugoid in its place was uncertain.
    """
    pulse = next(
        each for each in effects_for(declared().equations) if each.name == "unmeasured-input"
    )
    assert isinstance(pulse, Traceable)
    search = search_white_noise(
        offered([planted([effect(LATE)], {"sensor-delay:alpha.delay": 0.08}, seed=2)])
    )
    late, slow = effect(LATE), effect("phugoid")
    give_weights(search, {(late, pulse): 500.0, (late, slow): 470.0, (late,): 440.0})
    found = _decide_under_white_noise(search, search.best())
    assert [each.name for each in found.named] == [LATE]
    assert found.verdict is Verdict.TRACED and {*found.best.names} == {LATE, "phugoid"}
    assert [each.name for each in found.hints] == ["unmeasured-input"]
