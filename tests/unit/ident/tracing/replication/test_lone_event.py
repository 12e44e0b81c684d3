"""An event where what remains is not noise: it stands alone in one record, or it is no event."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from ident.tracing import thresholds
from ident.tracing.candidate_model.quantities import records_of
from ident.tracing.replication import lone_event
from ident.tracing.replication.by_record import Flight
from ident.tracing.replication.cross_validation import weighed_again
from ident.tracing.replication.lone_event import _alone, _begun, event_that_stands
from ident.tracing.replication.weighing import left_out
from ident.tracing.screening.score_test import Finding
from ident.whole_record.gauss_newton import Fit
from sim.effects.disturbance.gust_discrete import GustDiscrete
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.sensor_path.sensor_scale import SensorScale
from tests.tracing_problem import all_records, coloured, doublets, planted, root_of

GUST, LOAD, WRONG = GustDiscrete(), UnmeasuredInput(), SensorScale("nz")
CROSSED = {"gust-discrete.peak": 6.0, "gust-discrete.start": 6.0, "gust-discrete.duration": 1.0}
STILL = {**CROSSED, "gust-discrete.peak": 0.0}


def flown(in_gust: Collection[int], count: int = 4) -> Flight:
    """Coloured records of an aircraft whose load factor is read a third too large, which no event explains; some cross a gust at 6 s."""
    values = [{**(CROSSED if r in in_gust else STILL), "sensor-scale:nz.scale": 1.3} for r in range(count)]
    return all_records([coloured(planted([GUST, WRONG], each, r + 1, flight=doublets(10.0, 25.0)), r + 1) for r, each in enumerate(values)])


def test_a_gust_in_one_of_four_records_stands_although_the_model_is_wrong_and_residuals_are_coloured() -> None:
    flight = flown([1])
    found, tried = event_that_stands(flight, (GUST, LOAD, WRONG), root_of(flight), 3)
    assert found is not None and found.best.effect.name == GUST.name and found.others == ()
    assert found.best.gain > thresholds.LONE_EVENT and list(found.best.predictions) == [1]
    own = [each["gust-discrete.peak"] for each in found.best.fitted.values.own]
    assert own[1] == pytest.approx(6.0, abs=1.0) and found.best.fitted.values.own[1]["gust-discrete.start"] == pytest.approx(6.0, abs=0.2)
    assert records_of(found.best.fitted, GUST) == (1,), own
    assert {item.effect.name for item in tried if item.stands} == {GUST.name} and WRONG.name not in {item.effect.name for item in tried}


def test_nothing_is_claimed_where_no_record_crosses_one() -> None:
    flight = flown([])
    found, tried = event_that_stands(flight, (GUST,), root_of(flight), 4)
    assert found is None and tried and not any(item.stands for item in tried)


def test_an_event_explains_a_good_part_of_what_its_record_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wrong model is worst in one record: an event there brings likelihood, and leaves most of the error."""
    flight = flown([1])
    monkeypatch.setattr(thresholds, "EVENT_EXPLAINS", 0.95)
    found, tried = event_that_stands(flight, (GUST,), root_of(flight), 4)
    assert found is None and [item.why for item in tried] == ["it explains little of what its record leaves"]


def test_an_event_of_a_record_that_flies_beyond_a_curve_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """The root has no curve: one is put there by name, and known in all records but the one in the gust."""
    flight = flown([1])
    root = replace(root_of(flight), effects=(WRONG,))
    monkeypatch.setattr(lone_event, "within_reach", lambda fitted, effect: [0, 2, 3] if effect is WRONG else [0, 1, 2, 3])
    monkeypatch.setattr(lone_event, "left_out", lambda flight, fitted: left_out(flight, root_of(flight)))
    found, tried = event_that_stands(flight, (GUST,), root, 4)
    assert found is None and [item.why for item in tried] == ["its record flies beyond where a curve is known: the curve goes on some way or other"]


@pytest.mark.slow
def test_on_other_samples_an_event_is_asked_for_again() -> None:
    flight, still = flown([1]), flown([])
    root = root_of(flight)
    found, _ = event_that_stands(flight, (GUST, LOAD), root, 4)
    assert found is not None
    again, tried = weighed_again(flight, (GUST, LOAD), root, [found], 4)
    assert [item.best.effect.name for item in again] == [GUST.name] and again[0] is not found and tried
    gone, tried = weighed_again(still, (GUST, LOAD), root_of(still), [found], 4)
    assert gone == [] and tried


def test_what_every_record_has_is_no_event() -> None:
    flight = flown([0, 1, 2, 3])
    found, (tried,) = event_that_stands(flight, (GUST,), root_of(flight), 4)
    assert found is None and tried.gain > thresholds.LONE_EVENT and tried.why == "other records show as much: it is no event"


def test_two_records_are_too_few_to_stand_alone_and_nothing_but_events_is_asked() -> None:
    two = flown([1], 2)
    assert event_that_stands(two, (GUST,), root_of(two), 2) == (None, [])
    three = flown([1], 3)
    assert event_that_stands(three, (WRONG,), root_of(three), 3) == (None, [])


def test_the_common_fit_begins_with_the_event_where_it_was_found_and_hardly_there_elsewhere() -> None:
    flight = flown([], 3)
    found = [5.0, 6.5, 1.2]
    there = SimpleNamespace(theta=np.array([*found, 9.0]), layout=SimpleNamespace(names=[*CROSSED, "CL_q"]))
    begun = _begun(root_of(flight), Finding(GUST, 50.0, 3, ({},), (50.0,), np.zeros(1)), 1, cast("Fit", there))
    assert [begun.own[1][name] for name in CROSSED] == found
    for r in (0, 2):
        assert [begun.own[r][name] for name in CROSSED] == pytest.approx([0.05, 6.5, 1.2])


@pytest.mark.parametrize(
    ("gain", "rest", "where", "why"),
    [
        (31.0, 10.0, 0, ""),
        (29.0, 0.0, 0, "a colour of the residual"),
        (31.0, 11.0, 0, "other records show as much"),
        (90.0, 0.0, 2, "in a record that is not fitted"),
    ],
)
def test_an_event_has_to_bring_much_and_three_times_what_any_other_record_shows(gain: float, rest: float, where: int, why: str) -> None:
    stands, told = _alone(gain, rest, where, 2, 30.0)
    assert stands is not bool(why) and why in told
