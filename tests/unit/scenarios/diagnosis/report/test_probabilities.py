"""How probable a name is, as it is told: in ``diagnosis.json``, in the text, on the page."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace

import pytest

from ident.tracing.diagnosis import Claim, Verdict
from scenarios.diagnosis.diagnose import Tracing
from scenarios.diagnosis.report.content import diagnosis_content
from scenarios.diagnosis.report.files import diagnosis_page
from scenarios.diagnosis.report.text import diagnosis_text
from scenarios.diagnosis.report.wording import probability_sentence, shown_probability
from scenarios.files.writing import json_text
from scenarios.report.html import page_html
from tests.diagnoses import tracing_of

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
