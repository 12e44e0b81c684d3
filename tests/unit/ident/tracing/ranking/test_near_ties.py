"""Near ties: records made so that two causes lie a known distance apart, and what the thresholds between them decide.

A late vane and a vane ahead of the centre of gravity look much alike, so that the size of the hidden one sets by how much it wins.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest

from ident.tracing import thresholds
from ident.tracing.diagnosis import Concern, Diagnosis, Verdict
from ident.tracing.loop import diagnose
from sim.declaration.proposal import Traceable
from sim.effects.sensor_path.sensor_delay import SensorDelay
from sim.effects.sensor_path.vane_offset import VaneOffset
from sim.record import Record
from tests.rate_in_alpha import RateInAlpha
from tests.tracing_problem import SETTINGS, declared, fit_of, planted, problem_of

LATE, AHEAD = SensorDelay("alpha"), VaneOffset()
BOTH: tuple[Traceable, ...] = (LATE, AHEAD)


GUARD = RateInAlpha(guard=True)  # it beats a late vane by as little as one likes


def late(delay: float, seed: int = 2) -> Record:
    return planted([LATE], {"sensor-delay:alpha.delay": delay}, seed)


def ahead(arm: float, seed: int) -> Record:
    return planted([AHEAD], {"vane-offset.arm": arm}, seed)


def margin(record: Record, better: Traceable, worse: Traceable) -> float:
    """By how much one effect alone has the lower criterion: twice the log likelihood, both having one parameter."""
    problem = problem_of([record])
    root = fit_of(problem)
    return fit_of(problem, [worse], root).criterion - fit_of(problem, [better], root).criterion


def traced(record: Record, candidates: Sequence[Traceable], guards: Sequence[Traceable] = (), validation: Sequence[Record] = ()) -> Diagnosis:
    return diagnose([record], declared(), candidates, guards, validation, SETTINGS)


def told(diagnosis: Diagnosis) -> tuple[Verdict, list[tuple[str, tuple[str, ...]]]]:
    """The verdict, and what is claimed with its alternatives."""
    return diagnosis.verdict, [(claim.name, claim.alternatives) for claim in diagnosis.effects if claim.claimed]


def test_two_causes_within_the_odds_of_chance_are_ambiguous(monkeypatch: pytest.MonkeyPatch) -> None:
    record = late(0.01)
    assert 0.2 < margin(record, LATE, AHEAD) < thresholds.AMBIGUOUS - 1.0
    assert told(traced(record, BOTH)) == (Verdict.AMBIGUOUS, [(LATE.name, (AHEAD.name,))])
    monkeypatch.setattr(thresholds, "AMBIGUOUS", 0.0)
    assert told(traced(record, BOTH)) == (Verdict.TRACED, [(LATE.name, (AHEAD.name,))])


def test_data_that_take_part_in_choosing_resolve_a_tie() -> None:
    """The margin counts over all of them: another record tells the two apart."""
    record, other = late(0.01), late(0.01, 5)
    assert margin(record, LATE, AHEAD) < thresholds.AMBIGUOUS
    diagnosis = traced(record, BOTH, validation=[other])
    assert 2.0 * math.log(1.0 / thresholds.LIKELY_ENOUGH) < margin(other, LATE, AHEAD) + margin(record, LATE, AHEAD)
    assert diagnosis.used_to_choose and told(diagnosis) == (Verdict.TRACED, [(LATE.name, ())])


def test_a_cause_that_is_clearly_but_not_by_far_worse_is_named_beside_the_one_traced(monkeypatch: pytest.MonkeyPatch) -> None:
    """By its odds: likelier than one in twenty."""
    record = late(0.02)
    assert thresholds.AMBIGUOUS + 1.0 < margin(record, LATE, AHEAD) < thresholds.ALTERNATIVE - 1.0
    assert told(traced(record, BOTH)) == (Verdict.TRACED, [(LATE.name, (AHEAD.name,))])
    with monkeypatch.context() as none:
        none.setattr(thresholds, "LIKELY_ENOUGH", 0.5)
        assert told(traced(record, BOTH)) == (Verdict.TRACED, [(LATE.name, ())])
    monkeypatch.setattr(thresholds, "AMBIGUOUS", 2.0 * thresholds.AMBIGUOUS)
    assert traced(record, BOTH).verdict is Verdict.AMBIGUOUS


def test_a_cause_that_is_worse_by_far_is_not_named(monkeypatch: pytest.MonkeyPatch) -> None:
    record = late(0.03)
    assert thresholds.ALTERNATIVE + 1.0 < margin(record, LATE, AHEAD) < SETTINGS.near
    assert told(traced(record, BOTH)) == (Verdict.TRACED, [(LATE.name, ())])
    monkeypatch.setattr(thresholds, "LIKELY_ENOUGH", 1e-5)
    assert told(traced(record, BOTH)) == (Verdict.TRACED, [(LATE.name, (AHEAD.name,))])


def test_a_guard_that_hardly_wins_leaves_the_place_to_an_effect_of_the_library(monkeypatch: pytest.MonkeyPatch) -> None:
    record = ahead(4.0, 2)
    assert 2.0 < margin(record, GUARD, LATE) < thresholds.GUARD_TIE - 1.0
    # It is the likelier of the two for all that, unless more is held against guards: then nothing is claimed after all.
    monkeypatch.setattr(thresholds, "AGAINST_GUARDS", 0.0)
    withdrawn = traced(record, [LATE], [GUARD])
    assert told(withdrawn) == (Verdict.UNEXPLAINED, []) and withdrawn.warnings[0].concern is Concern.UNLIKELY
    monkeypatch.setattr(thresholds, "AGAINST_GUARDS", thresholds.GUARD_TIE + 2.0 * math.log(2.0))
    assert told(traced(record, [LATE], [GUARD])) == (Verdict.TRACED, [(LATE.name, ())])
    monkeypatch.setattr(thresholds, "GUARD_TIE", 0.0)
    diagnosis = traced(record, [LATE], [GUARD])
    assert told(diagnosis) == (Verdict.UNEXPLAINED, []) and diagnosis.warnings[0].concern is Concern.GUARD


def test_a_guard_that_wins_by_more_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    record = ahead(6.0, 1)
    assert thresholds.GUARD_TIE + 2.0 < margin(record, GUARD, LATE) < 2.0 * thresholds.GUARD_TIE - 2.0
    diagnosis = traced(record, [LATE], [GUARD])
    assert told(diagnosis) == (Verdict.UNEXPLAINED, []) and diagnosis.warnings[0].concern is Concern.GUARD
    monkeypatch.setattr(thresholds, "GUARD_TIE", 2.0 * thresholds.GUARD_TIE)
    monkeypatch.setattr(thresholds, "AGAINST_GUARDS", thresholds.GUARD_TIE)
    assert told(traced(record, [LATE], [GUARD])) == (Verdict.TRACED, [(LATE.name, ())])
