"""Errors are compared with the estimated sensor noise; a residual that is not white has a column of
its own, and bands show the noise.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from ident.statistics.residuals import ResidualTest
from ident.tracing.diagnosis import Claim, FittedRecord, Verdict
from ident.tracing.whiteness import noise_floors
from scenarios.diagnosis.diagnose import Tracing
from scenarios.diagnosis.files import diagnosis_page, pictured
from scenarios.diagnosis.tables import errors_table
from scenarios.diagnosis.text import diagnosis_content, diagnosis_text
from scenarios.diagnosis.wording import probability_sentence, shown_probability
from scenarios.files.writing import json_text
from scenarios.report.html import page_html
from scenarios.report.terminal import cell_text
from sim.record import Channel, Record
from tests.diagnoses import NOISE, tracing_of

DEGREE = math.pi / 180.0


def coloured(verdict: Verdict) -> Tracing:
    """A diagnosis whose fit leaves twice the noise."""
    tracing = tracing_of(verdict)
    left = {name: 2.0 * std for name, std in tracing.diagnosis.residual_std.items()}
    return replace(tracing, diagnosis=replace(tracing.diagnosis, residual_std=left))


def test_a_white_residual_is_the_noise_and_has_no_column_of_its_own() -> None:
    told = diagnosis_text(tracing_of(Verdict.TRACED))
    assert "estimated sensor noise" in told and "noise floor" not in told
    headings = [
        column.heading for column in errors_table(tracing_of(Verdict.TRACED).diagnosis, "").columns
    ]
    assert headings[-1] == "sensor noise (estimated)" and "residual" not in headings


@pytest.mark.parametrize("verdict", [Verdict.PARTIAL, Verdict.UNEXPLAINED])
def test_of_a_coloured_residual_the_noise_is_told_apart(verdict: Verdict) -> None:
    tracing = coloured(verdict)
    d = tracing.diagnosis
    shown = errors_table(d, "")
    headings = [column.heading for column in shown.columns]
    assert headings[-2:] == ["residual", "sensor noise (estimated)"]
    rows = {str(row[0]): [cell_text(cell) for cell in row] for row in shown.rows}
    assert rows["q"][-1] == f"{NOISE['q'] / DEGREE:.3g}"
    if verdict is Verdict.PARTIAL:
        assert rows["q"][-2] == f"{2.0 * NOISE['q'] / DEGREE:.3g}"
    for told in (diagnosis_text(tracing), page_html(diagnosis_page(tracing, []))):
        assert "noise floor" not in told and "sensor noise (estimated)" in told
    assert pictured(tracing).noise["q"] == NOISE["q"], "bands of figures are those of the noise"


def test_the_json_has_both_and_under_unexplained_the_residual_of_the_declared_model() -> None:
    error = diagnosis_content(coloured(Verdict.PARTIAL), "now")["error"]
    assert error["noise_floor"]["q"] == NOISE["q"] and error["residual"]["q"] == 2.0 * NOISE["q"]
    tracing = coloured(Verdict.UNEXPLAINED)
    said = diagnosis_content(tracing, "now")["error"]["residual"]["q"]
    parts = [
        item.before[item.channels.index("q")][
            item.used[item.channels.index("q")] & item.record["q"].valid
        ]
        for item in tracing.diagnosis.fitted
    ]
    assert said == pytest.approx(float(np.sqrt(np.mean(np.concatenate(parts) ** 2))), rel=1e-12)


def test_the_floor_is_the_fits_level_where_white_and_the_sensors_where_coloured() -> None:
    rng, count = np.random.default_rng(3), 1000
    time, noise = np.arange(count) * 0.02, rng.standard_normal((2, count))
    left = noise + np.array([[0.0], [3.0]]) * np.sin(2.0 * np.pi * 0.2 * time)
    record = Record(
        time,
        (),
        tuple(Channel.of(name, "rad", np.zeros(count)) for name in ("alpha", "theta")),
        name="r",
    )
    fitted = (
        FittedRecord(record, ("alpha", "theta"), left, left, np.ones((2, count), dtype=bool)),
    )
    levels = {"alpha": 1.0, "theta": float(left[1].std())}
    tests = [
        ResidualTest("ljung-box", "alpha", 20.0, 0.5, "white"),
        ResidualTest("ljung-box", "theta, record 1", 900.0, 0.0, "not white"),
    ]
    floors = noise_floors(fitted, tests, levels)
    assert (
        floors["alpha"] == 1.0
        and floors["theta"] == pytest.approx(1.0, abs=0.1)
        and levels["theta"] > 2.0
    )
    assert noise_floors(fitted, tests, {"theta": 0.5}) == {"theta": 0.5}, (
        "no noise is larger than the residual"
    )


LAG, DELAY = "sensor-lag:q", "sensor-delay:q"
FOUND = {DELAY: 0.0485, "sensor-scale:q": 0.0039, "vane-offset": 0.0192, LAG: 0.9284}


def claim_of(probability: Mapping[str, float]) -> Claim:
    return Claim(LAG, {}, probability=probability)


def test_the_name_comes_first_then_the_likeliest_without_what_rounds_to_nothing() -> None:
    assert list(shown_probability(claim_of({**FOUND, "a": 0.005, "b": 0.0049})).items()) == [
        (LAG, 0.928),
        (DELAY, 0.049),
        ("vane-offset", 0.019),
        ("a", 0.005),
    ]


@pytest.mark.parametrize(
    ("probability", "words"),
    [
        (FOUND, "Probability of this cause: 93 %; sensor-delay:q 5 %, vane-offset 2 %"),
        ({LAG: 1.0}, "Probability of this cause: above 99 %"),
        (
            {LAG: 0.9931, DELAY: 0.0069},
            "Probability of this cause: 99 %; sensor-delay:q 1 %",
        ),
        (
            {LAG: 0.9946, DELAY: 0.0054},
            "Probability of this cause: 99 %; sensor-delay:q 1 %",
        ),
        (
            {LAG: 0.001, DELAY: 0.989, "a": 0.01},
            "Probability of this cause: below 1 %; sensor-delay:q 99 %, a 1 %",
        ),
        ({}, ""),
        ({LAG: math.nan, DELAY: math.nan}, ""),
    ],
)
def test_the_line_for_readers(probability: Mapping[str, float], words: str) -> None:
    assert probability_sentence(claim_of(probability)) == words


def test_the_line_says_where_the_priors_alone_decide() -> None:
    """An alternative that fits as well stood below a probability of 99 % without a reason."""
    claim = replace(claim_of({LAG: 1.0, DELAY: 1e-40}), alternatives=(DELAY,))
    assert probability_sentence(claim) == (
        f"Probability of this cause: above 99 %; {DELAY} fits these data equally well, and only "
        f"the prior probabilities favour {LAG}"
    )
    other = replace(claim_of(FOUND), alternatives=(DELAY,))
    assert "priors" not in probability_sentence(other)


def told(probability: Mapping[str, float]) -> Tracing:
    """A traced flight whose first claim has this probability."""
    tracing = tracing_of(Verdict.TRACED)
    first, *rest = tracing.diagnosis.effects
    named = {first.name if name == LAG else name: p for name, p in probability.items()}
    return replace(
        tracing,
        diagnosis=replace(tracing.diagnosis, effects=(replace(first, probability=named), *rest)),
    )


def test_the_file_has_the_numbers_and_nothing_where_nothing_was_weighed() -> None:
    tracing = told({**FOUND, "odd": math.nan})
    effects = json.loads(json_text(diagnosis_content(tracing, "")))["effects"]
    assert effects[0]["probability"] == {
        tracing.diagnosis.effects[0].name: 0.928,
        DELAY: 0.049,
        "vane-offset": 0.019,
    }
    assert "probability" not in diagnosis_content(told({}), "")["effects"][0]


def test_text_and_page_say_it_below_the_claim() -> None:
    words = "Probability of this cause: 93 %; sensor-delay:q 5 %, vane-offset 2 %"
    tracing, plain = told(FOUND), told({})
    lines = diagnosis_text(tracing).splitlines()
    name = tracing.diagnosis.effects[0].name
    at = next(i for i, line in enumerate(lines) if line.startswith(f"{name}:"))
    assert f"    {words}" in lines[at + 1 : at + 3]
    assert [line for line in lines if words not in line] == diagnosis_text(plain).splitlines(), (
        "and nothing else changes"
    )
    assert f"<p>{words}.</p>" in page_html(
        diagnosis_page(tracing, [])
    ) and "Probability" not in page_html(diagnosis_page(plain, []))
