"""The grades: what is right, noticed, missed, an alarm, false and broken."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.independent.examine import Outcome, summary, table
from tests.independent.grading import Answer, Fault, Grade, Graded, graded, worst_derivative

NOTHING = Fault("nothing")
LATE = Fault(
    "late-alpha",
    frozenset({"sensor-delay:alpha", "sensor-lag:alpha"}),
    frozenset({"vane-offset"}),
    ("alpha",),
)
SCALE = Fault("q-scale", frozenset({"sensor-scale:q"}), channels=("q",))
CLOCK = Fault("clock-fast", frozenset({"time-base"}), channels=("time_base", "clock"))
SLOWER = Fault("deceleration", frozenset({"speed-variation", "phugoid"}))


def claim(name: str, *others: str, **more: Any) -> dict[str, Any]:
    return {
        "name": name,
        "alternatives": [{"name": other, "parameters": {}} for other in others],
        "parameters": {},
        **more,
    }


def answer(verdict: str, *effects: dict[str, Any], **more: Any) -> Answer:
    return Answer(0, {"verdict": verdict, "effects": list(effects), "warnings": [], **more})


def found(sentence: str) -> dict[str, Any]:
    return {"looked_at": ["alpha.csv"], "findings": [{"sentence": sentence}]}


PHUGOID = claim("phugoid")
DELAY = claim("sensor-delay:alpha", "vane-offset")
VANE_OR_DELAY = claim("vane-offset", "sensor-lag:alpha")


@pytest.mark.parametrize(
    ("faults", "said", "grade"),
    [
        ([NOTHING], answer("consistent"), Grade.RIGHT),
        ([NOTHING], answer("traced", PHUGOID), Grade.RIGHT),
        ([NOTHING], answer("unexplained", claim("sensor-drift:nz", claimed=False)), Grade.ALARM),
        ([NOTHING], Answer(2, {}, "refused"), Grade.ALARM),
        ([NOTHING], answer("traced", PHUGOID, claim("sensor-drift:nz")), Grade.FALSE),
        ([NOTHING], answer("ambiguous", claim("sensor-drift:nz", "phugoid")), Grade.FALSE),
        ([LATE], answer("traced", DELAY), Grade.RIGHT),
        ([LATE], answer("traced", PHUGOID, DELAY), Grade.RIGHT),
        ([LATE], answer("partial", VANE_OR_DELAY), Grade.RIGHT),
        ([LATE], answer("traced", claim("vane-offset")), Grade.FALSE),
        ([LATE], answer("traced", DELAY, claim("lift-nonlinearity")), Grade.FALSE),
        ([LATE], answer("traced", claim("sensor-scale:q", "sensor-delay:alpha")), Grade.FALSE),
        ([LATE], answer("unexplained"), Grade.NOTICED),
        ([LATE], answer("ambiguous", PHUGOID), Grade.NOTICED),
        ([LATE], Answer(2, {}, "alpha is in degrees"), Grade.NOTICED),
        ([LATE], answer("consistent"), Grade.MISSED),
        ([LATE], answer("traced", PHUGOID), Grade.MISSED),
        (
            [LATE],
            answer("consistent", warnings=["held-out alpha is twice the noise"]),
            Grade.NOTICED,
        ),
        ([LATE], answer("consistent", warnings=["few samples"]), Grade.MISSED),
        ([LATE], answer("consistent", record=found("alpha stands still")), Grade.NOTICED),
        ([LATE], answer("consistent", record=found("nz stands still")), Grade.MISSED),
        ([SCALE], answer("consistent", warnings=["power at a low frequency of nz"]), Grade.MISSED),
        ([SCALE], answer("consistent", warnings=["power at 2 Hz in q"]), Grade.NOTICED),
        ([CLOCK], answer("consistent", warnings=["at the time 3 s nz jumps"]), Grade.MISSED),
        (
            [CLOCK],
            answer("consistent", record=found("the time base disagrees with the kinematics")),
            Grade.NOTICED,
        ),
        ([LATE, SCALE], answer("traced", DELAY, claim("sensor-scale:q")), Grade.RIGHT),
        ([LATE, SCALE], answer("partial", DELAY), Grade.NOTICED),
        ([LATE, SCALE], answer("traced", DELAY), Grade.NOTICED),
        ([SLOWER], answer("traced", PHUGOID), Grade.RIGHT),
        ([SLOWER], answer("traced", claim("speed-variation")), Grade.RIGHT),
        ([LATE], Answer(1, {}, "Traceback"), Grade.BROKEN),
        ([LATE], Answer(0, {}), Grade.BROKEN),
    ],
)
def test_grade(faults: list[Fault], said: Answer, grade: Grade) -> None:
    assert graded(faults, said).grade is grade


def test_worst_derivative_is_in_its_own_sigmas() -> None:
    after = {"CL_alpha": {"value": 5.2, "std": 0.1}, "Cm_q": {"value": -14.0, "std": 2.0}}
    said = answer("traced", parameters={"after": after})
    assert worst_derivative(said, {"CL_alpha": 5.0, "Cm_q": -15.0, "CL_q": 7.0}) == pytest.approx(
        2.0
    )
    assert np.isnan(worst_derivative(answer("traced"), {"CL_alpha": 5.0}))


def test_tables_count_by_fault_and_vehicle_and_in_all() -> None:
    def outcome(vehicle: str, fault: str, grade: Grade, worst: float) -> Outcome:
        return Outcome(f"{vehicle}-{fault}", vehicle, fault, Graded(grade, ""), worst, True, 3.0)

    outcomes = [
        outcome("A", "nothing", Grade.RIGHT, 1.0),
        outcome("A", "late-alpha", Grade.RIGHT, 4.0),
        outcome("B", "late-alpha", Grade.FALSE, 9.0),
    ]
    lines = table(outcomes, "fault").splitlines()
    assert lines[0].split() == ["fault", "right", "noticed", "missed", "alarm", "FALSE", "BROKEN"]
    assert [line.split() for line in lines[1:]] == [
        ["late-alpha", "1", "0", "0", "0", "1", "0"],
        ["nothing", "1", "0", "0", "0", "0", "0"],
        ["all", "2", "0", "0", "0", "1", "0"],
    ]
    assert "1 of 2 flights told right have a derivative more than 3 sigmas off" in summary(outcomes)
