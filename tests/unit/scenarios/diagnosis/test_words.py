"""Effects, summaries and advice in words."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ident.tracing.diagnosis import Claim, Quantity, Verdict
from scenarios.diagnosis.tables import candidates_table, few_candidates, move_cell, moved
from scenarios.diagnosis.text import (
    diagnosis_text,
    headline,
    verdict_advice,
    where_predicted,
    wording_of,
)
from scenarios.diagnosis.wording import (
    Wording,
    group_sentence,
    kind_of_predicted,
    parameter_text,
    record_labels,
    sentence,
    separating_maneuver,
)
from scenarios.report.quantities import value_text
from scenarios.report.terminal import cell_text
from sim.declaration.proposal import Traceable, Traits
from sim.effects.library import library
from tests.diagnoses import LOES, tracing_of

TRACEABLE = [effect for effect in library() if isinstance(effect, Traceable)]


@pytest.mark.parametrize("effect", TRACEABLE, ids=lambda effect: effect.name)
def test_every_effect_of_the_library_has_a_sentence_of_its_own(effect) -> None:
    claim = Claim(
        effect.name,
        {
            item.name: Quantity(item.value, 0.05 * abs(item.value) or 0.01, item.unit)
            for item in effect.parameters
        },
    )
    told = sentence(claim, Wording())
    assert not told.startswith(effect.name), "no template of the table fits its parameters"
    assert "{" not in told and not re.search(r"\bnan\b|\binf\b|[A-Z]\w*Error", told)


def test_maneuvers_name_effects_of_the_library_only() -> None:
    bases = {effect.name.partition(":")[0] for effect in library()}
    assert {other for effect in TRACEABLE for other in effect.traits.separating} <= bases


def test_numbers_stand_in_the_units_that_people_fly_with() -> None:
    deadband = Claim(
        "input-deadband", {"half_width": Quantity(math.radians(0.41), math.radians(0.02), "rad")}
    )
    assert (
        sentence(deadband, Wording()) == "the elevator sticks within +-0.41 deg of zero (break-out)"
    )
    assert parameter_text(deadband, Wording()) == "half_width 0.410 +- 0.020 deg"
    on_stick = Claim("input-deadband", {"half_width": Quantity(0.15, 0.01, "1")})
    assert (
        sentence(on_stick, Wording("stick", "in"))
        == "the stick does nothing within +-0.15 in of zero (break-out)"
    )
    assert parameter_text(on_stick, Wording("stick", "in")) == "half_width 0.150 +- 0.010 in"
    rate = Claim(
        "actuator-rate-limit", {"rate": Quantity(math.radians(30.0), math.radians(0.4), "rad/s")}
    )
    assert sentence(rate, Wording()) == "the actuator moves no faster than 30.0 deg/s"
    mode = {
        "frequency": Quantity(18.2, 0.1, "rad/s"),
        "damping": Quantity(0.03, 0.004, "1"),
        "lift": Quantity(0.1, 0.1, "1/rad"),
    }
    assert (
        sentence(Claim("elastic-mode#2", mode), Wording())
        == "the structure bends: a mode of 18.2 rad/s (2.90 Hz), damping 0.030"
    )


def test_parameters_that_are_not_determined_are_told_together() -> None:
    def told(count: int) -> str:
        curve = {
            "trim": Quantity(0.2, 0.1, "1"),
            **{f"shape{k}": Quantity(0.1, 1e9, "1") for k in range(1, count + 1)},
            "slope": Quantity(3.0, 0.1, "1"),
        }
        return parameter_text(Claim("lift-nonlinearity", curve, (), False, ()), Wording())

    assert told(0) == "trim 0.20 +- 0.10, slope 3.00 +- 0.10"
    assert told(2) == (
        "trim 0.20 +- 0.10, slope 3.00 +- 0.10, shape1 not determined by these data, shape2 "
        "not determined by these data"
    )
    assert (
        told(9)
        == "trim 0.20 +- 0.10, slope 3.00 +- 0.10, shape1 and 8 more not determined by these data"
    )


@pytest.mark.parametrize(
    ("scale", "words"), [(1.062, "6.2 % too large"), (0.94, "6.0 % too small")]
)
def test_scale_is_told_in_per_cent(scale: float, words: str) -> None:
    assert (
        sentence(Claim("sensor-scale:nz", {"scale": Quantity(scale, 0.002, "1")}), Wording())
        == f"the load factor is read {words}"
    )


def test_effect_of_a_user_is_told_by_its_own_sentence_or_its_numbers() -> None:
    claim = Claim("vane-upwash", {"curvature": Quantity(2.0, 0.1, "1/rad")})
    assert sentence(claim, Wording()) == "vane-upwash acts: curvature 2.00 +- 0.10 1/rad"
    assert (
        sentence(claim, Wording(candidates={"vane-upwash": Traits(("bent by {curvature}",))}))
        == "bent by 2.0 1/rad"
    )
    for template in ("{missing}", "{", "{0}", "{curvature.x}"):
        assert sentence(claim, Wording(candidates={"vane-upwash": Traits((template,))})).startswith(
            "vane-upwash acts"
        )


def test_of_several_inputs_the_one_that_the_effect_acts_on_is_named() -> None:
    known = {
        "input-delay:rudder": Traits(
            ("the aircraft responds {delay} after the recorded {control}",)
        )
    }
    wording = Wording("aileron", candidates=known, controls=("aileron", "rudder"))
    assert (
        sentence(Claim("input-delay:rudder", {"delay": Quantity(0.12, 0.002, "s")}), wording)
        == "the aircraft responds 0.120 s after the recorded rudder"
    )
    assert (
        wording.control_of("input-delay:rudder#2") == "rudder"
        and wording.traits("input-delay:rudder#2") is known["input-delay:rudder"]
    )
    assert (
        wording.control_of("control-nonlinearity")
        == wording.control_of("sensor-lag:p")
        == "aileron"
    )
    assert sentence(
        Claim("sensor-scale:beta", {"scale": Quantity(1.062, 0.002, "1")}),
        replace(wording, candidates={"sensor-scale:beta": SCALE}),
    ) == ("the angle of sideslip is read 6.2 % too large")


SCALE = Traits(("the {channel} is read {scale_percent} {scale_direction}",))


def test_what_the_data_do_not_determine_is_said_in_words() -> None:
    claim = Claim("actuator-saturation", {"limit": Quantity(0.0306, 290.0, "rad")})
    assert parameter_text(claim, Wording()) == "limit not determined by these data"
    assert (
        parameter_text(
            replace(claim, parameters={"limit": Quantity(0.0002, 290.0, "rad")}), Wording()
        )
        == "limit not determined by these data"
    )
    assert value_text(-0.0002, 0.0007) == "-0.00020 +- 0.00070", (
        "zero within its sigma is knowledge"
    )


def test_spikes_are_counted_in_whole_numbers() -> None:
    claim = Claim(
        "sensor-spikes:nz", {"count": Quantity(3.0, 0.5, "1"), "size": Quantity(0.052, 0.004, "g")}
    )
    assert (
        sentence(claim, Wording()) == "the reading of the load factor has 3 spikes of about 0.052 g"
    )
    assert parameter_text(claim, Wording()) == "count 3, size 0.0520 +- 0.0040 g"


def test_a_group_does_not_repeat_the_name_of_its_first_member() -> None:
    claim = Claim(
        "input-deadband",
        {"half_width": Quantity(math.radians(0.41), math.radians(0.02), "rad")},
        ("control-nonlinearity",),
    )
    told = (
        "the elevator sticks within +-0.41 deg of zero (break-out or curved control: both "
        "fit these data equally well)"
    )
    assert group_sentence(claim, Wording()) == told


@pytest.mark.long
@given(st.floats(-1e6, 1e6), st.floats(1e-9, 1e6))
def test_value_and_sigma_share_their_digits(value: float, std: float) -> None:
    text = value_text(value, std)
    if "not determined" in text:
        assert std >= 1e3 * abs(value)
        return
    first, second = text.split(" +- ")
    assert abs(float(first) - value) <= 0.51 * std or abs(float(first) - value) <= 5e-3 * abs(value)
    assert abs(float(second) - std) <= 0.35 * std
    if "e" not in text:
        assert len(first.partition(".")[2]) == len(second.partition(".")[2])


def test_headline_names_effect_error_and_derivative() -> None:
    tracing = tracing_of(Verdict.TRACED)
    d = tracing.diagnosis
    figures = replace(d.error_before, rmse={"alpha": 0.0013, "q": 0.0061, "nz": 0.013})
    after = replace(d.error_after, rmse={"alpha": 0.0012, "q": 0.0015, "nz": 0.012})
    before = {**d.after, "Cm_q": Quantity(-24.1, 0.9, "1/rad")}
    moved = {**d.after, "Cm_q": Quantity(-17.2, 0.4, "1/rad")}
    told = replace(
        tracing,
        diagnosis=replace(d, error_before=figures, error_after=after, before=before, after=moved),
    )
    assert headline(told) == (
        "the elevator sticks within +-0.400 deg of zero (break-out); with this effect, pitch-rate "
        "error 0.350 -> 0.0859 deg/s "
        "on the held-out record validate.csv, estimated sensor noise 0.0859; Cm_q "
        "changes from -24.10 +- 0.90 to -17.20 +- 0.40"
    )


def test_headline_of_several_effects_says_with_these_effects() -> None:
    tracing = tracing_of(Verdict.TRACED)
    d = tracing.diagnosis
    figures = replace(d.error_before, rmse={"q": 0.0061})
    lag = Claim("sensor-lag:q", {"time_constant": Quantity(0.06, 0.002, "s")})
    gust = Claim("gust-turbulence", {}, one_step_gains=(40.0,))
    both = replace(d, effects=(*d.effects, lag), error_before=figures)
    assert "; with these effects, " in headline(replace(tracing, diagnosis=both))
    rough = replace(both, effects=(*both.effects, gust))
    assert "; with gust-turbulence, the log" in headline(replace(tracing, diagnosis=rough))


@pytest.mark.parametrize(
    ("parameters", "named"),
    [
        (("CL_alpha", "CL_de"), " (CL_de)"),
        (("L_alpha", "L_delta"), " (L_delta)"),
        (("CY_beta", "CY_da", "CY_dr"), " (CY_dr, CY_da)"),
        (("own",), ""),
    ],
)
def test_advice_names_parameters_of_the_declared_model_only(
    parameters: tuple[str, ...], named: str
) -> None:
    wording = Wording(parameters=parameters)
    told = separating_maneuver("accelerometer-offset:nz", "vane-offset", wording)
    assert f"the force by the control surface{named} is plausible" in told


@pytest.mark.parametrize("verdict", list(Verdict))
def test_terminal_text_is_plain_and_complete(verdict: Verdict) -> None:
    tracing = tracing_of(verdict)
    text = diagnosis_text(tracing)
    assert verdict.value.upper() in text and verdict.sentence in text
    for caution in tracing.diagnosis.warnings:
        assert caution.sentence in " ".join(text.split())
    for claim in tracing.diagnosis.effects:
        assert claim.name in text
    assert ("hint only, not claimed" in text) is (verdict is Verdict.UNEXPLAINED)
    assert text.isascii()
    assert all(line == line.rstrip() for line in text.splitlines())


def test_only_moves_beyond_two_sigmas_are_marked() -> None:
    before = {name: Quantity(1.0, 0.06, "1") for name in ("a", "b", "c")}
    after = {
        "a": Quantity(1.19, 0.08, "1"),
        "b": Quantity(1.21, 0.08, "1"),
        "c": Quantity(0.79, 0.08, "1"),
    }
    moves = [move_cell(moved(before[name], after[name])) for name in before]
    told = [cell_text(cell).strip() for cell in moves]
    assert told == ["+1.9 sigma", "+2.1 sigma *", "-2.1 sigma *"]
    assert [round(getattr(cell, "value", 0.0), 3) for cell in moves] == [1.9, 2.1, -2.1]


def test_each_round_shows_a_name_once_and_the_best_first() -> None:
    tracing = tracing_of(Verdict.TRACED)
    weaker = replace(tracing.diagnosis.candidates[0], gain=5.0)
    doubled = replace(tracing.diagnosis, candidates=(weaker, *tracing.diagnosis.candidates))
    shown = candidates_table(doubled, "", 3)
    assert [(row[1], cell_text(row[3])) for row in shown.rows] == [
        ("input-deadband", "420.0"),
        ("sensor-scale:alpha", "3.1"),
        ("vane-offset", "1.4"),
    ]


def test_a_long_search_prints_few_candidates_of_each_round() -> None:
    d = tracing_of(Verdict.UNEXPLAINED).diagnosis
    some = [replace(d.candidates[0], name=f"effect-{i}", gain=float(-i)) for i in range(10)]
    rounds = [replace(each, round=number) for number in range(1, 8) for each in some]
    one_round, seven = replace(d, candidates=tuple(some)), replace(d, candidates=tuple(rounds))
    assert few_candidates(one_round) == 6
    rows = candidates_table(seven, "", few_candidates(seven)).rows
    assert [(cell_text(row[0]), row[1]) for row in rows[:3]] == [
        ("1", "effect-0"),
        ("1", "effect-1"),
        ("2", "effect-0"),
    ]
    assert len(rows) == 14


def test_alternatives_come_with_the_maneuver_that_splits_them() -> None:
    assert [line.partition(":")[0] for line in verdict_advice(tracing_of(Verdict.AMBIGUOUS))] == [
        "to tell input-delay from actuator-lag"
    ]
    text = "\n".join(verdict_advice(tracing_of(Verdict.PARTIAL)))
    assert "airspeed" in text and "sweep" in text
    assert verdict_advice(tracing_of(Verdict.CONSISTENT)) == []


@pytest.mark.sampled
@pytest.mark.parametrize("effect", TRACEABLE, ids=lambda effect: effect.name)
def test_every_declared_alias_has_advice_that_is_the_same_both_ways(effect) -> None:
    for alias in effect.aliases:
        assert (
            separating_maneuver(effect.name, alias) == separating_maneuver(alias, effect.name) != ""
        )


def test_stick_wording_comes_from_the_record() -> None:
    wording = wording_of(tracing_of(Verdict.TRACED, LOES))
    assert (wording.control, wording.stick_unit) == ("stick", "in")


@pytest.mark.parametrize(
    ("part", "where"),
    [
        (None, "the held-out record validate.csv"),
        (12.0, "the held-out part of validate.csv, from 12 s on"),
    ],
)
def test_what_took_no_part_in_choosing_is_called_held_out(part: float | None, where: str) -> None:
    tracing = replace(tracing_of(Verdict.TRACED), held_out_from=part)
    assert where_predicted(tracing) == where and kind_of_predicted(tracing.diagnosis) == "held out"
    assert f"simulation error (rms) on {where}" in " ".join(diagnosis_text(tracing).split())
    assert record_labels(tracing) == ["train.csv"]
    fitted = replace(tracing, diagnosis=replace(tracing.diagnosis, held_out=False))
    assert (
        where_predicted(fitted) == "the fitted record"
        and kind_of_predicted(fitted.diagnosis) == "fitted"
    )
