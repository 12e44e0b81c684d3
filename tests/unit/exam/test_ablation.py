"""Rules of the tracing loop that are left out one at a time."""

from __future__ import annotations

import inspect

import pytest

from exam.ablation import ALL, RULES, ablate, left_out, noted, table
from ident.tracing import decision
from ident.tracing.decision import search_white_noise
from sim.declaration.proposal import Traceable
from sim.effects.library import effects_for
from tests.tracing_problem import declared, planted, problem_of

SCALE, LATE = "sensor-scale:q", "sensor-delay:alpha"


@pytest.mark.parametrize("name", [*RULES])
def test_every_rule_is_there_and_comes_back(name: str) -> None:
    rule = RULES[name]
    original = inspect.getattr_static(rule.owner, rule.attribute)
    assert callable(original)
    with left_out(name):
        pass
    with noted(set()):
        assert inspect.getattr_static(rule.owner, rule.attribute) is not original
    assert inspect.getattr_static(rule.owner, rule.attribute) is original


def test_a_rule_that_acts_is_noted_and_can_be_left_out() -> None:
    """A vane that is hardly late beside a wrong scale: it brings little and is a hint, and is
    named without that rule.
    """
    few = [
        each
        for each in effects_for(declared().equations)
        if each.name in (SCALE, LATE) and isinstance(each, Traceable)
    ]
    values = {f"{SCALE}.scale": 1.15, f"{LATE}.delay": 0.012}
    record = planted([each for each in few if each.name in (SCALE, LATE)], values, seed=1)
    search = search_white_noise(problem_of([record], few, model=declared()))
    acted: set[str] = set()
    with noted(acted):
        with_all = decision.decide(search)
    assert "weak members" in acted and "small events" not in acted
    with left_out("weak members"):
        without = decision.decide(search)
    assert [each.name for each in with_all.named] == [SCALE]
    assert {each.name for each in without.named} == {SCALE, LATE}


def test_the_table_counts_answers_where_a_rule_acted() -> None:
    right, wrong = {"right": True, "wrong": False}, {"right": False, "wrong": True}
    rows = [
        {ALL: right, "weak members": wrong},
        {ALL: right, "weak members": right},
        {ALL: wrong},
    ]
    lines = table(rows).splitlines()
    (line,) = [each for each in lines if RULES["weak members"].what in each]
    assert line.endswith("| 2 | 2 | 1 | 0 | 1 |")
    assert lines[-1] == "| all rules | 3 | 2 | | 1 | |"


def test_one_of_two_kinds_of_cases_is_given(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        ablate(["--out", "somewhere"])
    assert ended.value.code == 2 and "give one of --random and --flights" in capsys.readouterr().err
