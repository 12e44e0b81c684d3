"""How probable a claimed name is: odds of the sets that could stand in its place, worked out by hand, whatever the calibrated numbers are."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ident.tracing import thresholds
from ident.tracing.diagnosis import Claim, Evidence
from ident.tracing.name_probability import SOMETHING_ELSE, Calibration, name_probabilities, unlikely, weights_of, with_probabilities
from ident.tracing.weighed import ComparedSet, Ground, Weighed
from sim.declaration.proposal import Traceable
from sim.effects.library import effects_for, guards_for
from sim.vehicles.short_period import ShortPeriod
from tests.tracing_problem import doublets, planted, problem_of

LAG, DELAY, SCALE, GUARD = "sensor-lag:q", "sensor-delay:q", "sensor-scale:q", "guard:alpha-q"
BAR = 1.0 - 0.2  # what a ground of ``CALIBRATED`` leaves to the sets


# Numbers of our own: what is calibrated may change, what it does may not.
TEMPERATURES = {ground.value: 2.0 for ground in Ground} | {"one-step": 1.0}
CALIBRATED = Calibration(TEMPERATURES, 0.5, 4.0 * math.log(3.0), {ground.value: 0.2 for ground in Ground} | {"one-step": 0.4})


def behind(odds: float) -> float:
    """Twice the log likelihood by which a set is behind whose odds are one to ``odds``, at a temperature of two."""
    return 4.0 * math.log(odds)


def told(
    *sets: ComparedSet,
    name: str = LAG,
    others: tuple[str, ...] = (),
    twins: tuple[str, ...] = (),
    ground: Ground = Ground.NOISE_LEFT,
    same: tuple[str, ...] = (),
    calibration: Calibration = CALIBRATED,
) -> dict[str, float]:
    return dict(name_probabilities(name, others, Weighed(ground, sets, same), twins, calibration))


def of_noise(*sets: ComparedSet) -> Weighed:
    return Weighed(Ground.NOISE_LEFT, sets, ())


def test_odds_by_hand() -> None:
    """Four to one against a rival, and a fifth of all claims of this ground wrong whatever the sets say."""
    found = told(ComparedSet((LAG,), 0.0), ComparedSet((SCALE,), behind(4.0)))
    assert found == pytest.approx({LAG: BAR * 0.8, SCALE: BAR * 0.2, SOMETHING_ELSE: 0.2})
    assert told(ComparedSet((LAG,), 0.0), ground=Ground.ONE_STEP) == pytest.approx({LAG: 0.6, SOMETHING_ELSE: 0.4})


def test_prices_count_by_their_share_and_what_the_declared_derivatives_say_in_full() -> None:
    dearer, otherwise = ComparedSet((SCALE,), 0.0, price=behind(9.0)), ComparedSet((SCALE,), 0.0, declared=behind(9.0))
    whole = weights_of(of_noise(ComparedSet((LAG,), 0.0), dearer, otherwise), CALIBRATED)
    assert whole == pytest.approx([1.0, 1.0 / 3.0, 1.0 / 9.0])
    cheaper = weights_of(of_noise(ComparedSet((LAG,), 0.0), ComparedSet((SCALE,), 0.0, price=-behind(9.0))), CALIBRATED)
    assert cheaper == pytest.approx([1.0 / 3.0, 1.0])


def test_weights_of_sets_far_behind_do_not_leave_the_range_of_numbers() -> None:
    assert weights_of(of_noise(ComparedSet((LAG,), -1e6), ComparedSet((SCALE,), 0.0), ComparedSet((SCALE,), -1e6))).tolist() == [1.0, 0.0, 1.0]


def test_a_distance_counts_by_the_temperature_of_what_the_claim_rests_on() -> None:
    sets = (ComparedSet((LAG,), 0.0), ComparedSet((SCALE,), behind(4.0)))
    assert weights_of(Weighed(Ground.ONE_STEP, sets, ()), CALIBRATED) == pytest.approx([1.0, 1.0 / 16.0])


def test_guards_and_removed_effects_count_as_something_else() -> None:
    """A guard is three times less likely here than what it does; a set in which nothing takes the effect's place speaks for no name."""
    guard = told(ComparedSet((LAG,), 0.0), ComparedSet((GUARD,), 0.0, guard=True))
    assert guard == pytest.approx({LAG: BAR * 0.75, SOMETHING_ELSE: BAR * 0.25 + 0.2})
    assert told(ComparedSet((LAG,), 0.0), ComparedSet((), behind(3.0))) == pytest.approx(guard)
    # Beside another effect: the set without this one, and one in which two others would stand for it.
    beside = (ComparedSet((LAG, SCALE), 0.0), ComparedSet((SCALE,), behind(6.0)), ComparedSet((SCALE, "a", "b"), behind(6.0)))
    assert told(*beside, others=(SCALE,)) == pytest.approx(guard)


def test_twins_count_as_the_name_and_so_does_a_set_in_which_another_effect_changed() -> None:
    rival = ComparedSet((SCALE,), 0.0)
    twin = ComparedSet((DELAY,), 0.0)
    assert told(ComparedSet((LAG,), 0.0), twin, rival, twins=(DELAY,)) == pytest.approx({LAG: BAR * 2 / 3, SCALE: BAR / 3, SOMETHING_ELSE: 0.2})
    assert told(ComparedSet((LAG,), 0.0), twin, rival)[DELAY] == pytest.approx(BAR / 3)
    # With a second effect in the model: what stands in the place of that one leaves this one where it is.
    both = (ComparedSet((LAG, SCALE), 0.0), ComparedSet((LAG, "other"), behind(2.0)), ComparedSet(("other", SCALE), behind(2.0)))
    assert told(*both, others=(SCALE,)) == pytest.approx({LAG: BAR * 0.75, "other": BAR * 0.25, SOMETHING_ELSE: 0.2})
    assert told(*both, name=SCALE, others=(LAG,)) == pytest.approx({SCALE: BAR * 0.75, "other": BAR * 0.25, SOMETHING_ELSE: 0.2})


def test_what_was_weighed_against_nothing_has_the_probability_of_its_ground() -> None:
    assert told() == pytest.approx({LAG: BAR, SOMETHING_ELSE: 0.2})


def test_a_name_under_which_the_equations_are_the_same_has_half_of_it() -> None:
    found = told(ComparedSet((LAG,), 0.0), ComparedSet((SCALE,), behind(3.0)), same=("alike",))
    assert found == pytest.approx({LAG: BAR * 0.375, "alike": BAR * 0.375, SCALE: BAR * 0.25, SOMETHING_ELSE: 0.2})


def test_every_ground_has_its_share_of_wrong_claims_and_numbers_are_read_when_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    present = Calibration()
    assert set(present.wrong) == {ground.value for ground in Ground} and present.wrong == thresholds.WRONG_WHATEVER
    assert all(0.0 < share < 1.0 for share in present.wrong.values()) and present.temperature == thresholds.TEMPERATURE
    assert set(present.temperature) == set(present.wrong) and all(value > 0.0 for value in present.temperature.values())
    sets = (ComparedSet((LAG,), 0.0), ComparedSet((SCALE,), 6.0, 4.0), ComparedSet((GUARD,), 3.0, guard=True))
    assert dict(name_probabilities(LAG, (), Weighed(Ground.NOISE_LEFT, sets), ())) == told(*sets, calibration=present)
    for name, number in (
        ("TEMPERATURE", TEMPERATURES),
        ("SHARE_OF_PRICE", 0.5),
        ("AGAINST_GUARDS", CALIBRATED.against_guards),
        ("WRONG_WHATEVER", CALIBRATED.wrong),
    ):
        monkeypatch.setattr(thresholds, name, number)
    assert dict(name_probabilities(LAG, (), Weighed(Ground.NOISE_LEFT, sets), ())) == told(*sets)


NAMES = st.lists(st.sampled_from([LAG, DELAY, SCALE, GUARD, "a", "b"]), unique=True, max_size=3).map(tuple)
FIGURE = st.floats(-50.0, 50.0)
SETS = st.lists(st.builds(ComparedSet, NAMES, FIGURE, FIGURE, FIGURE, st.booleans()), max_size=6)


@given(SETS, st.sampled_from(list(Ground)), st.booleans())
def test_probabilities_sum_to_one_and_a_rival_that_fits_worse_never_lowers_the_name(sets: list[ComparedSet], ground: Ground, twins: bool) -> None:
    mine, same = ComparedSet((LAG,), 0.0), (DELAY,) if twins else ()
    before = told(mine, *sets, twins=same, ground=ground)
    assert sum(before.values()) == pytest.approx(1.0) and all(0.0 <= p <= 1.0 for p in before.values())
    assert before[SOMETHING_ELSE] >= CALIBRATED.wrong[ground.value] - 1e-12
    for i, item in enumerate(sets):
        worse = ComparedSet(item.names, item.misfit + 7.0, item.price, item.declared, item.guard)
        after = told(mine, *sets[:i], worse, *sets[i + 1 :], twins=same, ground=ground)
        if {LAG, *same}.isdisjoint(item.names):
            assert after[LAG] >= before[LAG] - 1e-12
        else:
            assert after[LAG] <= before[LAG] + 1e-12


def test_claims_get_theirs_hints_and_what_was_never_weighed_get_none() -> None:
    sets = (ComparedSet((LAG, SCALE), 0.0), ComparedSet((DELAY, SCALE), 4.0), ComparedSet((LAG, "other"), 5.0))
    weighed = Weighed(Ground.NOISE_LEFT, sets)
    lag, scale = Claim(LAG, {}, weighed=weighed), Claim(SCALE, {}, weighed=weighed)
    twins = {LAG: (DELAY,)}
    first, second, hint, unknown = with_probabilities([lag, scale, Claim("hint", {}, claimed=False, weighed=weighed), Claim("x", {})], twins)
    assert dict(first.probability) == told(*sets, others=(SCALE,), twins=(DELAY,), calibration=Calibration())
    assert dict(second.probability) == told(*sets, name=SCALE, others=(LAG,), calibration=Calibration())
    assert set(first.probability) == {LAG, SOMETHING_ELSE} and set(second.probability) >= {SCALE, "other"}
    assert hint.probability == {} and unknown.probability == {}
    # A twin counts as the name where it is said to be one, and by nothing else.
    (alone, _) = with_probabilities([lag, scale], {})
    assert alone.probability[DELAY] > 0.0


def against(*rivals: ComparedSet) -> Weighed:
    return Weighed(Ground.SAMPLES, (ComparedSet((LAG,), 0.0), *rivals))


PROVEN = Evidence(0.6, 0.05, (), {})


def test_a_claim_that_is_less_likely_with_its_alternatives_than_what_is_not_named_is_unlikely() -> None:
    guards = against(ComparedSet((GUARD,), 0.0, guard=True), ComparedSet((), 0.0))
    assert unlikely([Claim(LAG, {}, weighed=guards)], {}) == [LAG]
    # Of what was cross-validated two to one is the bar: so far behind a guard has more than a third, or less.
    for behind, doubted in ((0.4, [LAG]), (0.8, [])):
        rival = Weighed(Ground.CROSS_VALIDATED, (ComparedSet((LAG,), 0.0), ComparedSet((GUARD,), behind, guard=True)))
        assert unlikely([Claim(LAG, {}, weighed=rival, evidence=PROVEN)], {}) == doubted
        assert unlikely([Claim(LAG, {}, weighed=replace(rival, ground=Ground.NOISE_LEFT))], {}) == []
    assert unlikely([Claim(LAG, {}, claimed=False, weighed=guards), Claim("x", {})], {}) == []
    # What is named beside it counts with it; of what was cross-validated no other name is added.
    names = against(ComparedSet((SCALE,), 0.0), ComparedSet(("b",), 1.0))
    claim = Claim(LAG, {}, weighed=names)
    assert unlikely([claim], {}) == unlikely([replace(claim, evidence=PROVEN, alternatives=(SCALE,))], {}) == []
    assert unlikely([replace(claim, evidence=PROVEN)], {}) == [LAG] and unlikely([replace(claim, evidence=PROVEN)], {LAG: (SCALE,)}) == []


def test_alternatives_are_what_is_likely_enough_and_other_words_for_the_same() -> None:
    """One in twenty; two names at most, the likeliest first behind what is the same; a guard is no name."""
    weighed = against(ComparedSet(("a",), 2.0), ComparedSet(("b",), 1.0), ComparedSet(("far",), 30.0), ComparedSet((GUARD,), 0.0, guard=True))

    def named(claim: Claim, twins: Mapping[str, tuple[str, ...]] = MappingProxyType({})) -> tuple[str, ...]:
        (told,) = with_probabilities([claim], twins)
        return told.alternatives

    claim = Claim(LAG, {}, ("far", DELAY), weighed=weighed)
    assert named(claim) == ("b", "a") and named(claim, {LAG: (DELAY,)}) == (DELAY, "b")
    assert named(replace(claim, weighed=replace(weighed, same=("far",)))) == ("far", "b")
    assert named(replace(claim, evidence=PROVEN)) == () and named(replace(claim, evidence=PROVEN, alternatives=("a",))) == ("a",)


def test_a_guard_that_an_effect_contains_speaks_for_it() -> None:
    """The square of the control is a curved control surface: where it ties, nothing else is likelier."""
    curved = next(effect for effect in effects_for(ShortPeriod()) if effect.name == "control-nonlinearity")
    record = planted(flight=doublets(2.0))
    twins = problem_of([record], (cast(Traceable, curved), *guards_for(ShortPeriod()))).twins["control-nonlinearity"]
    assert twins == ("guard:control-squared",)
    mine, narrower = ComparedSet(("control-nonlinearity",), 0.0), ComparedSet(("guard:control-squared",), 0.0, guard=True)
    other = ComparedSet(("guard:alpha-q",), 0.0, guard=True)
    got = dict(name_probabilities("control-nonlinearity", (), Weighed(Ground.CROSS_VALIDATED, (mine, narrower, other)), twins))
    assert got["control-nonlinearity"] == pytest.approx(2.0 / 3.0 * (1.0 - thresholds.WRONG_WHATEVER["cross-validated"]))
