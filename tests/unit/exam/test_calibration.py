"""Probabilities of names held against the truth: counted by what was said, and calibrated where they were said wrongly."""

from __future__ import annotations

import json

import numpy as np
import pytest

from exam.calibration import LEAST, Statement, as_line, calibrated, loss, reliability, statement_of
from ident.tracing.name_probability import SOMETHING_ELSE, Calibration
from ident.tracing.weighed import ComparedSet, Ground, Weighed

GROUNDS = [ground.value for ground in Ground]


def said(*, temperature: float, wrong: float) -> Calibration:
    return Calibration(dict.fromkeys(GROUNDS, temperature), 0.5, 0.0, dict.fromkeys(GROUNDS, wrong))


def statement(behind: float, right: str, ground: Ground = Ground.NOISE_LEFT) -> Statement:
    """A claim of "a" with "b" behind it by so much of twice the log likelihood."""
    weighed = Weighed(ground, (ComparedSet(("a",), 0.0), ComparedSet(("b",), behind)))
    return Statement("a", (), (), weighed, frozenset({right} if right else ()))


def drawn(rng: np.random.Generator, count: int, temperature: float, wrong: float, ground: Ground = Ground.NOISE_LEFT) -> list[Statement]:
    """Claims of which "a" or "b" is right with the probability that such a calibration gives, and neither in some."""
    out = []
    for behind in rng.uniform(0.0, 8.0, count):
        share = 1.0 / (1.0 + np.exp(-0.5 * behind / temperature))
        name = "" if rng.random() < wrong else "a" if rng.random() < share else "b"
        out.append(statement(float(behind), name, ground))
    return out


def test_names_are_counted_by_what_was_said_of_them() -> None:
    """Three to one against the other and a tenth to neither: 67.5 % and 22.5 %."""
    mine = said(temperature=1.0, wrong=0.1)
    behind = 2.0 * np.log(3.0)
    bins = reliability([statement(behind, "a"), statement(behind, "a"), statement(behind, "b"), statement(behind, "")], mine)
    counted = {(item.low, item.high): item for item in bins if item.count}
    assert {key: (item.count, item.right) for key, item in counted.items()} == {(0.2, 0.5): (4, 1), (0.5, 0.8): (4, 2)}
    assert counted[(0.5, 0.8)].said == pytest.approx(0.675) and counted[(0.2, 0.5)].said == pytest.approx(0.225)
    low, high = counted[(0.5, 0.8)].interval
    assert low < 0.5 < high
    # Something else is no name, and what is less likely than one in twenty is not said.
    assert sum(item.count for item in reliability([statement(40.0, "a")], mine)) == 1


def test_the_loss_is_that_of_what_is_right() -> None:
    mine = said(temperature=1.0, wrong=0.1)
    behind = 2.0 * np.log(3.0)
    assert loss([statement(behind, "a")], mine) == pytest.approx(-np.log(0.675))
    assert loss([statement(behind, "b")], mine) == pytest.approx(-np.log(0.225))
    assert statement(behind, "").probabilities(mine)[SOMETHING_ELSE] == pytest.approx(0.1)
    assert loss([statement(behind, "")], mine) == pytest.approx(-np.log(0.1))


@pytest.mark.slow
def test_a_calibration_is_found_again_from_its_claims_each_ground_with_its_own() -> None:
    rng = np.random.default_rng(7)
    claims = [*drawn(rng, 600, 2.5, 0.15), *drawn(rng, 600, 0.5, 0.02, Ground.CROSS_VALIDATED)]
    found = calibrated(claims)
    assert found.temperature["noise left"] == pytest.approx(2.5, rel=0.3) and found.temperature["cross-validated"] == pytest.approx(0.5, rel=0.3)
    assert found.wrong["noise left"] == pytest.approx(0.15, abs=0.05) and found.wrong["cross-validated"] == pytest.approx(0.02, abs=0.015)
    # Of what was never claimed only the prior speaks: one claim in twenty.
    assert found.wrong["samples"] == pytest.approx(0.05, abs=0.02) and all(share >= LEAST for share in found.wrong.values())
    assert loss(claims, found) < loss(claims, said(temperature=1.0, wrong=0.05))
    for item in reliability(drawn(rng, 1500, 2.5, 0.15), found):
        assert item.count == 0 or abs(item.right / item.count - item.said) < 0.08


def test_a_statement_is_kept_as_plain_data() -> None:
    weighed = Weighed(Ground.ONE_STEP, (ComparedSet(("a", "c"), 1.5, 2.0, 0.25, True), ComparedSet(("b",), 0.0)), ("d",))
    told = Statement("a", ("c",), ("e",), weighed, frozenset({"a", "d"}))
    assert statement_of(json.loads(json.dumps(as_line(told)))) == told
