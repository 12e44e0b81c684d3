"""Scores follow the names, verdicts and words; the probabilities of claims are kept with whether
they are right.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from exam.aircraft import drawn_aircraft
from exam.random_cases.case import Case, CaseScore, Named
from exam.random_cases.case_scoring import (
    case_score_of,
    coverage,
    refusal_score_of,
    summary,
    summary_table,
)
from exam.random_cases.kinds import KINDS
from exam.scoring import Statement
from ident.recording.series import Certainty, RecordFinding
from ident.recording.series import Kind as FindingKind
from ident.tracing.diagnosis import Claim, Verdict
from scenarios.preparation.recording import WARNED, HandledFinding, RecordCheck
from sim.errors import ModelError, RecordError
from tests.diagnoses import tracing_of


def case(*hidden: str) -> Case:
    answers = frozenset(KINDS[name].answer for name in hidden if KINDS[name].answer)
    outside = any(not KINDS[name].answer for name in hidden)
    group = (
        KINDS[hidden[0]].group
        if outside
        else ("nothing", "one effect", "two effects")[len(answers)]
    )
    return Case(1, "fighter", hidden, answers, outside, ("alpha", "q", "nz"), 50.0, "rigid", group)


def marked(
    hidden: tuple[str, ...], verdict: Verdict, claims: tuple[Claim, ...], warned_of: str = ""
) -> CaseScore:
    tracing = tracing_of(Verdict.CONSISTENT)
    diagnosis = replace(tracing.diagnosis, verdict=verdict, effects=claims)
    finding = RecordFinding(warned_of, FindingKind.HELD, Certainty.LIKELY, "is updated late")
    look = (
        RecordCheck(("train.csv",), (HandledFinding("train.csv", finding, WARNED),))
        if warned_of
        else tracing.look
    )
    return case_score_of(
        case(*hidden),
        drawn_aircraft(np.random.default_rng(1))[1],
        replace(tracing, diagnosis=diagnosis, look=look),
        1.0,
    )


@pytest.mark.parametrize(
    ("hidden", "verdict", "claims", "right", "wrong"),
    [
        ((), Verdict.CONSISTENT, (), True, False),
        ((), Verdict.UNEXPLAINED, (), False, False),
        (("input-deadband",), Verdict.TRACED, (Claim("input-deadband", {}),), True, False),
        (
            ("input-deadband",),
            Verdict.TRACED,
            (Claim("actuator-saturation", {}, ("input-deadband",)),),
            True,
            False,
        ),
        (("input-deadband",), Verdict.TRACED, (Claim("input-backlash", {}),), False, True),
        (
            ("input-deadband",),
            Verdict.UNEXPLAINED,
            (Claim("input-backlash", {}, claimed=False),),
            False,
            False,
        ),
        (("sensor-lag:alpha",), Verdict.TRACED, (Claim("sensor-delay:alpha", {}),), True, False),
        (
            ("elastic-mode", "vane-offset"),
            Verdict.TRACED,
            (Claim("elastic-mode#2", {}), Claim("vane-offset", {})),
            True,
            False,
        ),
        (
            ("elastic-mode", "vane-offset"),
            Verdict.TRACED,
            (Claim("elastic-mode", {}),),
            False,
            False,
        ),
        # The first claim could answer for either; the second only for one, which must be left to
        # it.
        (
            ("input-deadband", "vane-offset"),
            Verdict.TRACED,
            (Claim("input-deadband", {}, ("vane-offset",)), Claim("input-deadband", {})),
            True,
            False,
        ),
        (("energy exchange",), Verdict.TRACED, (Claim("phugoid", {}),), True, False),
        (("energy exchange",), Verdict.TRACED, (Claim("speed-variation", {}),), False, True),
        (("product",), Verdict.UNEXPLAINED, (), True, False),
        (("product",), Verdict.CONSISTENT, (), False, False),
        (("product",), Verdict.PARTIAL, (Claim("vane-offset", {}),), False, True),
        (("cubic vane",), Verdict.PARTIAL, (Claim("sensor-curve:alpha", {}),), True, False),
        (("cubic vane",), Verdict.UNEXPLAINED, (), True, False),
        (("held:q",), Verdict.UNEXPLAINED, (), True, False),
        (("held:q",), Verdict.TRACED, (Claim("sensor-hold:q", {}),), True, False),
        (("held:q",), Verdict.TRACED, (Claim("sensor-hold:alpha", {}),), False, True),
        (("held:q",), Verdict.CONSISTENT, (), False, False),
        (("clock fast",), Verdict.TRACED, (Claim("time-base", {}),), True, False),
    ],
)
def test_marks(
    hidden: tuple[str, ...], verdict: Verdict, claims: tuple[Claim, ...], right: bool, wrong: bool
) -> None:
    score = marked(hidden, verdict, claims)
    assert (score.right, score.wrong) == (right, wrong)


def test_a_word_on_the_channel_is_right_for_a_recorders_fault_and_on_another_is_not() -> None:
    assert marked(("held:q",), Verdict.CONSISTENT, (), "q").right
    assert not marked(("held:q",), Verdict.CONSISTENT, (), "alpha").right
    assert not marked(("product",), Verdict.CONSISTENT, (), "alpha").right
    wrong = marked(("held:q",), Verdict.TRACED, (Claim("input-delay", {}),), "q")
    assert wrong.wrong and not wrong.right


def test_a_refusal_is_right_for_a_recorders_fault_alone() -> None:
    fault = RecordError("the sign is turned", where="train.csv, channel q")
    refused, alarm = (
        refusal_score_of(case("turned:q"), fault, 1.0),
        refusal_score_of(case(), fault, 1.0),
    )
    assert (
        refused.right
        and not refused.wrong
        and refused.verdict == "refused"
        and "sign" in refused.said
    )
    assert not alarm.right and not alarm.wrong
    failed = refusal_score_of(
        case("turned:q"), ModelError("an effect acts twice", where="model rigid"), 1.0
    )
    assert failed.verdict == "failed" and not failed.right and not failed.wrong


def test_each_name_of_a_claim_is_told_hidden_or_not() -> None:
    claims = (
        Claim("sensor-delay:alpha", {}, ("vane-offset",)),
        Claim("input-delay", {}),
        Claim("gust-discrete", {}, claimed=False),
    )
    score = marked(("sensor-lag:alpha",), Verdict.TRACED, claims)
    assert score.claims == (
        (Named("sensor-delay:alpha", True), Named("vane-offset", False)),
        (Named("input-delay", False),),
    )
    assert score.claimed == ("sensor-delay:alpha", "input-delay")


def test_derivatives_are_measured_in_their_sigmas() -> None:
    score = marked((), Verdict.CONSISTENT, ())
    after, model = (
        tracing_of(Verdict.CONSISTENT).diagnosis.after,
        drawn_aircraft(np.random.default_rng(1))[1],
    )
    assert set(score.errors) == {"CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de"}
    assert (
        score.errors["Cm_q"]
        == (after["Cm_q"].value - model.parameters["Cm_q"].value) / after["Cm_q"].std
    )
    assert score.held_out == pytest.approx(1.02)


def scores() -> list[CaseScore]:
    return [
        CaseScore(
            case("vane-offset"),
            "traced",
            ("vane-offset",),
            True,
            False,
            {"Cm_q": 1.0, "CL_q": -3.0},
            1.02,
            2.0,
        ),
        CaseScore(
            case("input-delay"), "traced", ("vane-offset",), False, True, {"Cm_q": 9.0}, 3.0, 4.0
        ),
    ]


def test_summary_counts() -> None:
    found = summary(scores())
    assert (
        found["right"] == 0.5
        and found["wrong claims"] == 0.5
        and found["derivatives within two sigmas"] == 0.5
    )
    assert found["held-out error, median"] == 1.02 and found["seconds, median"] == 3.0


def test_coverage_leaves_out_what_is_foreign_or_a_recorders() -> None:
    more = [
        CaseScore(case(name), "unexplained", (), True, False, {"Cm_q": 9.0}, 3.0, 4.0)
        for name in ("product", "held:q")
    ]
    assert coverage([*scores(), *more]) == coverage(scores())
    assert coverage(more) == (0.0, (0.0, 1.0))


def test_the_table_counts_a_case_in_its_model_its_group_and_each_thing_hidden() -> None:
    pair = CaseScore(case("vane-offset", "input-delay"), "traced", (), False, False, {}, 1.0, 1.0)
    lines = summary_table([*scores(), pair])
    rule = next(i for i, line in enumerate(lines) if set(line) <= {" ", "-"})
    rows = {line.split("  ")[1].strip(): line.split() for line in lines[rule + 1 :]}
    counts = {
        name: int(next(word for word in words[len(name.split()) :])) for name, words in rows.items()
    }
    assert counts == {
        "all": 3,
        "rigid": 3,
        "one effect": 2,
        "two effects": 1,
        "vane-offset": 2,
        "input-delay": 2,
    }


def test_statements_are_the_probabilities_that_were_printed_each_right_or_not() -> None:
    claim = Claim(
        "sensor-lag:alpha",
        {},
        ("vane-offset",),
        probability={"sensor-lag:alpha": 0.9, "vane-offset": 0.1},
    )
    hint = Claim("sensor-scale:q", {}, claimed=False, probability={"sensor-scale:q": 0.8})
    score = marked(("sensor-lag:alpha",), Verdict.AMBIGUOUS, (claim, hint))
    assert score.statements == (
        Statement("sensor-lag:alpha", 0.9, True),
        Statement("vane-offset", 0.1, False),
    )
    assert (
        marked((), Verdict.UNEXPLAINED, (Claim("vane-offset", {}, claimed=False),)).statements == ()
    )
