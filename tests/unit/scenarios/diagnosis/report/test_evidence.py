"""A partial verdict told: the group, what replicates, run-to-run scatter, what is left."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from ident.statistics.residuals import ResidualTest
from ident.tracing.diagnosis import Caution, Claim, Concern, Diagnosis, Evidence, Quantity, Verdict
from scenarios.diagnosis.report.content import diagnosis_content
from scenarios.diagnosis.report.evidence import apart_text, by_record_text, evidence_sentences, member_derivatives, warnings_of
from scenarios.diagnosis.report.tables import SIGMA_NOTE, candidate_row, weighed_rows
from scenarios.diagnosis.report.text import diagnosis_text, headline
from scenarios.diagnosis.report.wording import Wording, group_sentence
from scenarios.files.writing import json_text
from tests.diagnoses import LATE, evidence_of, spread_tracing, tracing_of


def coloured(count: int, p_value: float = 1e-30) -> tuple[ResidualTest, ...]:
    return tuple(
        ResidualTest("ljung-box", f"{name}, fitted record {r + 1}", 900.0, p_value, "not white over 25 lags, lag-1 correlation 0.90")
        for r in range(count)
        for name in ("alpha", "q", "nz")
    )


def test_headline_says_what_where_how_sure_and_what_follows() -> None:
    assert headline(spread_tracing()) == (
        "the angle of attack is read 0.061 s late (lag, delay or vane ahead: these records cannot tell); it comes out alike from each of 4 records "
        "(0.058, 0.063, 0.060, 0.062 s) and cuts the error on records that were not fitted to 0.62 +- 0.05 of what it was; "
        "Cm_q was -24.1 +- 0.9, is -17.2 +- 0.4 (run-to-run scatter 0.83); what remains is not noise"
    )


def test_values_of_their_own_are_not_said_to_be_alike() -> None:
    own = replace(evidence_of((0.037, -0.021, 0.050), unit="rad/s2", parameter="slope"), own_values=True)
    (told,) = evidence_sentences(Claim("sensor-drift:q", {"slope": Quantity(-0.021, 0.004, "rad/s2")}, evidence=own))
    assert told.startswith("each of 3 records has a value of its own (") and "alike" not in told


def test_turbulence_is_told_by_what_judged_it_and_not_by_a_free_simulation() -> None:
    tracing = tracing_of(Verdict.PARTIAL)
    gust = Claim("gust-turbulence", {"sigma": Quantity(2.1, 0.2, "m/s"), "length": Quantity(393.0, 79.0, "m")}, one_step_gains=(1139.6,))
    tracing = replace(tracing, diagnosis=replace(tracing.diagnosis, effects=(gust,)))
    told = headline(tracing)
    assert "with that, the log likelihood of one-step predictions rises by 1140 on the held-out record" in told
    assert " error " not in told and "->" not in told
    assert diagnosis_content(tracing, "")["effects"][0]["one_step_gains"] == [1139.6]


@pytest.mark.parametrize(
    ("name", "others", "words"),
    [
        ("sensor-delay:q", ("sensor-lag:q",), "the pitch rate is read 0.061 s late (delay or lag: these records cannot tell)"),
        ("sensor-delay:q", ("sensor-scale:alpha",), "(sensor-delay:q or sensor-scale:alpha: these records cannot tell)"),
        (
            "input-delay",
            ("actuator-lag",),
            "what the elevator does reaches the aircraft 0.061 s late (delay or actuator lag: these records cannot tell)",
        ),
        ("my-effect", ("elastic-mode#2",), "(my-effect or bending structure: these records cannot tell)"),
        ("sensor-delay:q", (), "the pitch rate is read 0.061 s late"),
    ],
)
def test_a_group_is_told_by_its_members(name: str, others: tuple[str, ...], words: str) -> None:
    assert group_sentence(Claim(name, {"delay": Quantity(0.061, 0.002, "s")}, others), Wording()).endswith(words)


def test_values_of_the_records_stand_with_their_unit_or_name() -> None:
    assert by_record_text(evidence_of()) == "0.058, 0.063, 0.060, 0.062 s"
    assert by_record_text(evidence_of((0.61, 0.62), unit="1", parameter="scale")) == "scale 0.610, 0.620"
    assert by_record_text(evidence_of((0.01, 0.02), unit="rad", parameter="limit")) == "0.6, 1.1 deg"
    assert by_record_text(replace(evidence_of(), by_record=())) == ""
    many = Evidence(0.7, 0.05, ({name: Quantity(1.0, 0.1, "1") for name in "abc"},) * 3, {})
    assert by_record_text(many) == ""
    assert "alike" not in evidence_sentences(Claim("lift-nonlinearity", {}, evidence=many))[0]
    assert evidence_sentences(Claim("x", {})) == []


def test_a_joint_value_apart_from_the_records_is_not_called_alike() -> None:
    def told(joint: float, std: float, values: tuple[float, ...] = LATE) -> str:
        return evidence_sentences(Claim("sensor-lag:q", {"time_constant": Quantity(joint, std, "s")}, evidence=evidence_of(values)))[0]

    assert told(0.061, 0.002).startswith("it comes out alike from each of 4 records")
    assert told(0.075, 0.002).startswith(
        "each of 4 records gives it (0.058, 0.063, 0.060, 0.062 s), but all fitted together give time_constant 0.075 +- 0.002 s, "
        "their mean is 0.061 +- 0.002 s: the two do not agree; it cuts the error"
    )
    # Records that scatter leave their mean open, and so does a joint fit that is not sure.
    assert "alike" in told(0.075, 0.002, (0.04, 0.08, 0.05, 0.09)) and "alike" in told(0.075, 0.01)
    assert apart_text(Claim("x", {"time_constant": Quantity(0.5, 0.001, "s")}, evidence=evidence_of((0.06,)))) == ""


def test_header_says_what_a_sigma_holds() -> None:
    plain, inflated = spread_tracing(), spread_tracing()
    inflated = replace(inflated, diagnosis=replace(inflated.diagnosis, inflation={"Cm_q": 1.4}))
    assert SIGMA_NOTE not in diagnosis_text(plain) and diagnosis_text(inflated).count(SIGMA_NOTE) == 1
    content = json.loads(json_text(diagnosis_content(inflated, "")))
    assert content["growth"] == {"Cm_q": 1.4}


def test_a_guard_that_helps_does_not_stand() -> None:
    d = spread_tracing().diagnosis
    guard = replace(d.candidates[-1], name="guard:damping-curve", remark="cross-validated")
    assert weighed_rows(replace(d, candidates=(guard,)))[0][2] == "helps, but is no effect of the library"


def test_what_was_asked_again_for_a_pair_stands_in_the_table_once() -> None:
    d = spread_tracing().diagnosis
    one = replace(d.candidates[-1], within=("sensor-scale:nz",), name="sensor-lag:q")
    stands, beaten, alone = (
        replace(one, remark="cross-validated"),
        replace(one, remark="cross-validated, but another does better"),
        replace(one, within=(), remark="no"),
    )
    for order in ((stands, beaten, alone), (alone, beaten, stands)):
        rows = {row[0]: row[2] for row in weighed_rows(replace(d, candidates=order))}
        assert rows == {"sensor-scale:nz + sensor-lag:q": "cross-validated", "sensor-lag:q": "no"}
        assert len(weighed_rows(replace(d, candidates=order))) == 2


def test_a_second_effect_is_measured_from_the_first() -> None:
    alone, beside = evidence_of(), replace(evidence_of(), already_in_model=("vane-offset",))
    (first,), (second,) = (evidence_sentences(Claim("x", {}, evidence=each)) for each in (alone, beside))
    assert first.endswith("0.62 +- 0.05 of what it was") and second.endswith("0.62 +- 0.05 of what it is with vane-offset alone")


def test_terminal_shows_scatter_beside_sigma_members_and_remarks() -> None:
    text = diagnosis_text(spread_tracing())
    assert text.isascii()
    (row,) = [line for line in text.splitlines() if line.split()[:1] == ["Cm_q"] and "sigma" in line]
    assert row.split()[2:] == ["-24.1", "+-", "0.9", "-17.2", "+-", "0.4", "0.83", "+7.0", "sigma", "*"]
    (members,) = [line for line in text.splitlines() if line.split()[:1] == ["Cm_q"] and "sigma" not in line]
    assert members.split()[2:] == ["-17.0", "+-", "0.4", "-18.0", "+-", "0.4", "-19.0", "+-", "0.4*"]
    assert "the records give different values" in text


def test_what_was_weighed_on_other_records_stands_by_what_it_leaves() -> None:
    d = spread_tracing().diagnosis
    better = replace(d.candidates[-1], name="sensor-scale:q", held_out_change=-0.2, remark="cross-validated")
    beside = replace(better, within=("sensor-lag:alpha",), held_out_change=-0.3)
    rows = weighed_rows(replace(d, candidates=(beside, *d.candidates, better)))
    assert [row[:3] for row in rows] == [
        ("sensor-scale:q", "-20.0 %", "cross-validated"),
        ("sensor-scale:alpha", "+0.2 %", "the records give different values"),
        ("sensor-lag:alpha + sensor-scale:q", "-30.0 %", "cross-validated"),
    ]
    assert weighed_rows(tracing_of(Verdict.TRACED).diagnosis) == []


def test_json_has_evidence_scatter_and_remarks() -> None:
    content = json.loads(json_text(diagnosis_content(spread_tracing(), "")))
    (effect,) = content["effects"]
    evidence = effect["evidence"]
    assert (evidence["error_left"], evidence["error_left_std"]) == (0.62, 0.05)
    assert evidence["records"] == ["record_1.csv", "record_2.csv", "record_3.csv", "validate.csv"]
    assert [each["time_constant"]["value"] for each in evidence["by_record"]] == list(LATE)
    assert all(each["time_constant"]["std"] > 0 for each in evidence["by_record"])
    assert set(evidence["derivatives"]) == {effect["name"], *effect["alternatives"]}
    assert evidence["derivatives"]["vane-offset"]["Cm_q"] == {"value": -19.0, "std": 0.4, "unit": "1/rad"}
    assert effect["derivatives_under"] == evidence["derivatives"]
    assert content["scatter"] == {"Cm_q": 0.83, "CL_q": 2.0}
    assert content["candidates"][-1]["remark"] == "the records give different values"
    plain = json.loads(json_text(diagnosis_content(tracing_of(Verdict.TRACED), "")))
    assert (
        plain["scatter"] == {}
        and not {"evidence", "derivatives_under"} & set(plain["effects"][0])
        and not any("remark" in c for c in plain["candidates"])
    )


def test_many_failed_tests_become_one_description_a_channel() -> None:
    tracing = spread_tracing(coloured(4))
    assert len(tracing.diagnosis.warnings) == 12
    told = warnings_of(tracing)
    assert told[0] == "12 of 12 tests for whiteness fail in alpha, q, nz"
    assert [line.partition(":")[0] for line in told[1:]] == ["left in the angle of attack", "left in the pitch rate", "left in the load factor"]
    assert told[1:] and all("Hz" in line and "rms" in line for line in told[1:])
    # Other warnings stay, and so do the tests themselves.
    other = replace(tracing, diagnosis=replace(tracing.diagnosis, warnings=(Caution(Concern.GUARD, "look here"), *tracing.diagnosis.warnings)))
    assert warnings_of(other) == ["look here", *told]
    assert len(diagnosis_content(tracing, "")["residual_tests"]["after"]) == 12


def test_few_failed_tests_are_told_as_they_are() -> None:
    tests = (*coloured(1)[:2], *coloured(2, 0.4))
    tracing = spread_tracing(tests)
    told = warnings_of(tracing)
    assert told[:2] == [caution.sentence for caution in tracing.diagnosis.warnings] and len(tracing.diagnosis.warnings) == 2
    assert [line.partition(":")[0] for line in told[2:]] == ["left in the angle of attack", "left in the pitch rate"]


def test_where_a_guard_leaves_noise_it_is_told_what_the_declared_model_leaves() -> None:
    tracing = tracing_of(Verdict.UNEXPLAINED)
    told = warnings_of(tracing)
    assert told[0] == tracing.diagnosis.warnings[0].sentence
    assert [line.partition(":")[0] for line in told[1:]] == [
        f"with the declared model, left in the {name}" for name in ("angle of attack", "pitch rate", "load factor")
    ]
    # The hand-made residual is a sine of 6 rad/s.
    assert all("near 0.9" in line or "near 1" in line for line in told[1:])
    assert warnings_of(tracing_of(Verdict.TRACED)) == [] == warnings_of(tracing_of(Verdict.CONSISTENT))


def test_members_are_compared_only_where_there_are_some() -> None:
    d: Diagnosis = spread_tracing().diagnosis
    rows = member_derivatives(d.effects[0], d.after)
    assert rows == [("Cm_q", "1/rad", "-17.0 +- 0.4", "-18.0 +- 0.4", "-19.0 +- 0.4*")]  # two of both sigmas are 1.1
    alone = Claim("x", {}, derivatives_under=evidence_of(LATE, "x").derivatives)
    assert member_derivatives(alone, d.after) == [] == member_derivatives(Claim("x", {}), d.after)


def test_residuals_beyond_all_measure_are_still_described() -> None:
    tracing = spread_tracing(coloured(4))
    item = tracing.diagnosis.fitted[0]
    after = item.after.copy()
    after[0, 5:9] = np.inf, -np.inf, np.nan, 1e200
    broken = replace(tracing, diagnosis=replace(tracing.diagnosis, fitted=(replace(item, after=after),)))
    assert not any("nan" in line for line in warnings_of(broken))


def test_a_simulation_that_runs_away_is_tenfold_and_more() -> None:
    candidate = spread_tracing().diagnosis.candidates[0]
    shown = [candidate_row(replace(candidate, held_out_change=share))[4] for share in (None, -0.293, 0.05, 8.99, 9.0, 1e54)]
    assert shown == ["-", "-29.3 %", "+5.0 %", "+899.0 %", "over +900 %", "over +900 %"]
