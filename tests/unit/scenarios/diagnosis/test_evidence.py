"""A partial verdict told: the group, how its evidence is spread, run-to-run scatter, what is
left.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from html import unescape

import numpy as np
import pytest

from ident.statistics.residuals import ResidualTest
from ident.tracing.diagnosis import (
    Candidate,
    Caution,
    Claim,
    Concern,
    Diagnosis,
    OneStep,
    Quantity,
    Verdict,
)
from scenarios.diagnosis.evidence import (
    by_record_text,
    disagreement_text,
    evidence_sentences,
    warnings_of,
)
from scenarios.diagnosis.files import REPLICATION_NOTE, diagnosis_page
from scenarios.diagnosis.tables import (
    SIGMA_NOTE,
    candidates_table,
    errors_table,
    member_tables,
    one_step_table,
    simulation_note,
)
from scenarios.diagnosis.text import diagnosis_content, diagnosis_text, headline
from scenarios.diagnosis.wording import RESIDUAL, Wording, group_sentence
from scenarios.files.writing import json_text
from scenarios.report.html import page_html
from scenarios.report.terminal import cell_text
from tests.diagnoses import LATE, each_record, spread_tracing, tracing_of


def coloured(count: int, p_value: float = 1e-30) -> tuple[ResidualTest, ...]:
    return tuple(
        ResidualTest(
            "ljung-box",
            f"{name}, fitted record {r + 1}",
            900.0,
            p_value,
            "not white over 25 lags, lag-1 correlation 0.90",
        )
        for r in range(count)
        for name in ("alpha", "q", "nz")
    )


SCALE = {"scale": Quantity(1.15, 0.01, "1")}
SPREAD = "Vuong's z over blocks of a second is 5.2"


def late(values: tuple[float, ...] = LATE, spread: float = 5.2) -> Claim:
    """A late sensor with these values from each record."""
    return Claim(
        "sensor-lag:q",
        {"time_constant": Quantity(0.061, 0.002, "s")},
        by_record=each_record(values),
        spread=spread,
    )


def test_headline_says_what_where_how_sure_and_what_follows() -> None:
    told = headline(spread_tracing())
    assert told.startswith(
        "the angle of attack is read 0.061 s late (lag; less likely: delay or vane ahead); "
        f"{SPREAD}; from each of 3 records: 0.058, 0.063, 0.060 s"
    )
    assert told.endswith(
        "Cm_q changes from -24.10 +- 0.90 to -17.20 +- 0.40 (run-to-run scatter 0.83); part "
        "of the misfit is not explained"
    )


def test_a_claim_beside_noise_has_nothing_to_say_of_blocks_or_records() -> None:
    assert evidence_sentences(Claim("x", {})) == []
    assert evidence_sentences(Claim("x", {}, by_record=each_record())) == []
    assert "blocks of a second" not in headline(tracing_of(Verdict.TRACED))


def test_the_spread_and_the_values_of_each_record_are_told() -> None:
    assert evidence_sentences(late()) == [SPREAD, "from each of 3 records: 0.058, 0.063, 0.060 s"]
    assert evidence_sentences(replace(late(), by_record=())) == [SPREAD]
    # Where the set without it could not be fitted there is no number to tell.
    assert evidence_sentences(late(spread=math.inf)) == [
        "from each of 3 records: 0.058, 0.063, 0.060 s"
    ]


def test_values_that_differ_between_records_are_said_to() -> None:
    """0.040 and 0.080, each to 0.004: they lie 5 sigmas on either side of their mean, so that the
    root of chi-squared is 7.1.
    """
    assert disagreement_text(late()) == ""
    told = disagreement_text(late((0.040, 0.080)))
    assert told == "time_constant differs between them by 7.1 of their sigmas"
    assert (
        evidence_sentences(late((0.040, 0.080)))[1]
        == f"from each of 2 records: 0.040, 0.080 s, but {told}"
    )
    vague = tuple(
        {"time_constant": Quantity(value, std, "s")}
        for value, std in ((0.06, np.inf), (0.5, 0.004))
    )
    assert disagreement_text(replace(late(), by_record=vague)) == ""
    assert disagreement_text(late((0.060,))) == "" == disagreement_text(Claim("x", {}))


def test_most_likely_is_said_of_the_most_likely_effect() -> None:
    tracing = tracing_of(Verdict.AMBIGUOUS)

    def told(probability: dict[str, float]) -> str:
        claim = Claim("sensor-scale:q", SCALE, ("time-base",), probability=probability)
        return headline(replace(tracing, diagnosis=replace(tracing.diagnosis, effects=(claim,))))

    assert told({"sensor-scale:q": 0.6, "time-base": 0.4}).startswith("most likely the pitch rate")
    other = told({"sensor-scale:q": 0.1, "time-base": 0.9})
    assert other.startswith("the pitch rate is read 15 % too large (")
    assert "; time-base is more likely than sensor-scale:q; " in other


def test_turbulence_is_told_by_what_judged_it_and_not_by_a_free_simulation() -> None:
    tracing = tracing_of(Verdict.PARTIAL)
    gust = Claim(
        "gust-turbulence",
        {"sigma": Quantity(2.1, 0.2, "m/s"), "length": Quantity(393.0, 79.0, "m")},
        one_step_gains=(1139.6,),
    )
    tracing = replace(tracing, diagnosis=replace(tracing.diagnosis, effects=(gust,)))
    told = headline(tracing)
    assert (
        "with this effect, the log likelihood of one-step predictions rises by 1140 on the "
        "held-out record" in told
    )
    assert " error " not in told and "->" not in told
    assert diagnosis_content(tracing, "")["effects"][0]["one_step_gains"] == [1139.6]


@pytest.mark.parametrize("gain", [math.inf, -math.inf])
def test_a_prediction_that_diverges_is_told_and_stored_as_a_finite_number(gain: float) -> None:
    tracing = tracing_of(Verdict.PARTIAL)
    gust = Claim("gust-turbulence", {"sigma": Quantity(2.1, 0.2, "m/s")}, one_step_gains=(gain,))
    tracing = replace(tracing, diagnosis=replace(tracing.diagnosis, effects=(gust,)))
    assert "inf" not in headline(tracing)
    (stored,) = diagnosis_content(tracing, "")["effects"][0]["one_step_gains"]
    assert math.isfinite(stored) and math.copysign(1.0, stored) == math.copysign(1.0, gain)


@pytest.mark.parametrize(
    ("name", "others", "words"),
    [
        (
            "sensor-delay:q",
            ("sensor-lag:q",),
            "the pitch rate is read 0.061 s late (delay or lag: both fit these data equally well)",
        ),
        (
            "sensor-delay:q",
            ("sensor-scale:alpha",),
            "(sensor-delay:q or sensor-scale:alpha: both fit these data equally well)",
        ),
        (
            "input-delay",
            ("actuator-lag",),
            "the aircraft responds 0.061 s after the recorded elevator (delay or actuator lag: "
            "both fit these data equally well)",
        ),
        (
            "my-effect",
            ("elastic-mode#2",),
            "(my-effect or bending structure: both fit these data equally well)",
        ),
        ("sensor-delay:q", (), "the pitch rate is read 0.061 s late"),
    ],
)
def test_a_group_is_told_by_its_members(name: str, others: tuple[str, ...], words: str) -> None:
    assert group_sentence(
        Claim(name, {"delay": Quantity(0.061, 0.002, "s")}, others), Wording()
    ).endswith(words)


def test_values_of_the_records_stand_with_their_unit_or_name() -> None:
    assert by_record_text(each_record()) == "0.058, 0.063, 0.060 s"
    assert by_record_text(each_record((0.61, 0.62), "scale", "1")) == "scale 0.610, 0.620"
    assert by_record_text(each_record((0.01, 0.02), "limit", "rad")) == "0.6, 1.1 deg"
    assert by_record_text(()) == ""
    many = ({name: Quantity(1.0, 0.1, "1") for name in "abc"},) * 3
    assert by_record_text(many) == "", "numbers of a curve trade off"


def test_header_says_what_a_sigma_holds() -> None:
    plain, inflated = spread_tracing(), spread_tracing()
    inflated = replace(inflated, diagnosis=replace(inflated.diagnosis, inflation={"Cm_q": 1.4}))
    assert (
        SIGMA_NOTE not in diagnosis_text(plain) and diagnosis_text(inflated).count(SIGMA_NOTE) == 1
    )
    content = json.loads(json_text(diagnosis_content(inflated, "")))
    assert content["growth"] == {"Cm_q": 1.4}


def test_terminal_shows_scatter_beside_sigma_and_members() -> None:
    text = diagnosis_text(spread_tracing())
    assert text.isascii()
    (row,) = [
        line for line in text.splitlines() if line.split()[:1] == ["Cm_q"] and "sigma" in line
    ]
    assert row.split()[2:] == [
        "-24.10",
        "+-",
        "0.90",
        "-17.20",
        "+-",
        "0.40",
        "0.83",
        "+7.0",
        "sigma",
        "*",
    ]
    (members,) = [
        line for line in text.splitlines() if line.split()[:1] == ["Cm_q"] and "sigma" not in line
    ]
    assert members.split()[2:] == [
        "-17.00",
        "+-",
        "0.40",
        "-18.00",
        "+-",
        "0.40",
        "-19.00",
        "+-",
        "0.40*",
    ]


def test_a_candidate_has_its_gain_and_the_same_with_its_odds() -> None:
    text = diagnosis_text(spread_tracing())
    best, scale, vane, speed = (
        spread_tracing().diagnosis.candidates[:1] + spread_tracing().diagnosis.candidates[2:]
    )
    d = spread_tracing().diagnosis

    def row_of(candidate: Candidate) -> list[str]:
        (row,) = candidates_table(replace(d, candidates=(candidate,)), "", 1).rows
        return [cell_text(cell) for cell in row]

    assert row_of(best)[:5] == ["1", "sensor-lag:alpha", "declared model", "420.0", "414.9"]
    assert row_of(scale)[3:] == ["3.1", "-2.0", "scale 1.0100 +- 0.0040", ""]
    assert row_of(vane)[5:] == ["", "linearised; like sensor-lag:alpha"]
    assert row_of(speed)[3:5] == ["-2.5", "-7.6"]
    assert "log odds" in text and "linearised" in text
    named = row_of(replace(scale, within=("vane-offset", "phugoid")))[1:3]
    assert named == ["sensor-scale:alpha", "vane-offset + phugoid"]


def test_json_has_spread_values_of_each_record_and_scatter() -> None:
    content = json.loads(json_text(diagnosis_content(spread_tracing(), "")))
    (effect,) = content["effects"]
    assert effect["spread"] == 5.2
    assert list(effect["by_record"]) == ["record_1.csv", "record_2.csv", "record_3.csv"]
    assert [each["time_constant"] for each in effect["by_record"].values()] == [
        {"value": value, "std": 0.004, "unit": "s"} for value in LATE
    ]
    assert set(effect["derivatives_under"]) == {effect["name"], *effect["alternatives"]}
    assert effect["derivatives_under"]["vane-offset"]["Cm_q"] == {
        "value": -19.0,
        "std": 0.4,
        "unit": "1/rad",
    }
    assert content["scatter"] == {"Cm_q": 0.83, "CL_q": 2.0}
    assert {"gain", "weight", "fitted"} < set(content["candidates"][-1]) and content["steps"][0][
        "log_evidence"
    ] == 100.0
    plain = json.loads(json_text(diagnosis_content(tracing_of(Verdict.TRACED), "")))
    assert plain["scatter"] == {} and not {"spread", "by_record", "derivatives_under"} & set(
        plain["effects"][0]
    )


def test_the_page_has_a_section_on_the_spread_where_what_remains_is_not_noise() -> None:
    page, plain = (
        page_html(diagnosis_page(tracing, []))
        for tracing in (spread_tracing(), tracing_of(Verdict.TRACED))
    )
    told = f"{SPREAD}; from each of 3 records: 0.058, 0.063, 0.060 s."
    assert told in unescape(page) and REPLICATION_NOTE in unescape(page)
    assert "Replication" not in plain


def test_many_failed_tests_become_one_description_a_channel() -> None:
    tracing = spread_tracing(coloured(4))
    assert len(tracing.diagnosis.warnings) == 12
    told = warnings_of(tracing)
    assert told[0] == "12 of 12 tests for whiteness fail in alpha, q, nz"
    assert [line.partition(":")[0] for line in told[1:]] == [
        "residual of the angle of attack",
        "residual of the pitch rate",
        "residual of the load factor",
    ]
    assert told[1:] and all("Hz" in line and "rms" in line for line in told[1:])
    # Other warnings stay, and so do the tests themselves.
    other = replace(
        tracing,
        diagnosis=replace(
            tracing.diagnosis,
            warnings=(Caution(Concern.GUARD, "look here"), *tracing.diagnosis.warnings),
        ),
    )
    assert warnings_of(other) == ["look here", *told]
    assert len(diagnosis_content(tracing, "")["residual_tests"]["after"]) == 12


def test_few_failed_tests_are_told_as_they_are() -> None:
    tests = (*coloured(1)[:2], *coloured(2, 0.4))
    tracing = spread_tracing(tests)
    told = warnings_of(tracing)
    assert (
        told[:2] == [caution.sentence for caution in tracing.diagnosis.warnings]
        and len(tracing.diagnosis.warnings) == 2
    )
    assert [line.partition(":")[0] for line in told[2:]] == [
        "residual of the angle of attack",
        "residual of the pitch rate",
    ]


def test_where_a_guard_leaves_noise_it_is_told_what_the_declared_model_leaves() -> None:
    tracing = tracing_of(Verdict.UNEXPLAINED)
    told = warnings_of(tracing)
    assert told[0] == tracing.diagnosis.warnings[0].sentence
    assert [line.partition(":")[0] for line in told[1:]] == [
        f"with the declared model, residual of the {name}"
        for name in ("angle of attack", "pitch rate", "load factor")
    ]
    # The hand-made residual is a sine of 6 rad/s.
    assert all("near 0.9" in line or "near 1" in line for line in told[1:])
    assert (
        warnings_of(tracing_of(Verdict.TRACED)) == [] == warnings_of(tracing_of(Verdict.CONSISTENT))
    )


def test_predictions_one_step_ahead_have_a_table_beside_random_loads() -> None:
    """The residual of the fit is one of such predictions, and stands in neither table."""
    d: Diagnosis = spread_tracing().diagnosis
    assert one_step_table(d) is None and simulation_note(d) == ""
    assert "one_step" not in diagnosis_content(spread_tracing(), "")["error"]
    whole = errors_table(d, "")
    before = replace(d.error_before, rmse={name: 0.02 for name in d.error_before.rmse})
    after = replace(before, rmse={name: 0.01 for name in before.rmse})
    filtered = replace(d, one_step=OneStep(before, after, (30.0, -4.0)))
    shown = one_step_table(filtered)
    assert shown is not None and simulation_note(filtered)
    headings = [column.heading for column in shown.columns]
    assert headings == [column.heading for column in errors_table(filtered, "").columns]
    assert RESIDUAL not in headings and {*headings} <= {column.heading for column in whole.columns}
    assert "rises by 26 (+30, -4 by record)" in shown.caption
    row = next(row for row in shown.rows if row[0] == "q")
    assert [cell_text(cell) for cell in row[1:3]] == ["1.15", "0.573"]
    unnamed = replace(filtered, effects=())
    assert one_step_table(unnamed) is None


def test_members_are_compared_only_where_there_are_some() -> None:
    d: Diagnosis = spread_tracing().diagnosis
    (shown,) = member_tables(d, "")
    ((name, *values),) = shown.rows
    # two of both sigmas are 1.1
    told = [cell_text(cell) for cell in values]
    assert name == "Cm_q" and told == ["-17.00 +- 0.40", "-18.00 +- 0.40", "-19.00 +- 0.40*"]
    assert shown.units == ("1/rad",)
    alone = Claim("x", {}, derivatives_under={"x": {"Cm_q": Quantity(-17.0, 0.4, "1/rad")}})
    for claim in (alone, Claim("x", {})):
        assert member_tables(replace(d, effects=(claim,)), "") == []


def test_residuals_beyond_all_measure_are_still_described() -> None:
    tracing = spread_tracing(coloured(4))
    item = tracing.diagnosis.fitted[0]
    after = item.after.copy()
    after[0, 5:9] = np.inf, -np.inf, np.nan, 1e200
    broken = replace(
        tracing, diagnosis=replace(tracing.diagnosis, fitted=(replace(item, after=after),))
    )
    assert not any("nan" in line for line in warnings_of(broken))
