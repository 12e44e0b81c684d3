"""Levels of flying qualities in a diagnosis: a level that changes because an effect was missing is
said first of all.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.flying_qualities.levels import FlightPhase
from ident.flying_qualities.modes import Characteristics
from ident.tracing.diagnosis import Verdict
from scenarios.diagnosis.diagnose import Tracing
from scenarios.diagnosis.report.content import diagnosis_content
from scenarios.diagnosis.report.text import diagnosis_text, headline
from tests.diagnoses import tracing_of


def with_damping(
    before: float, after: float, verdict: Verdict = Verdict.TRACED, std: float = 0.005
) -> Tracing:
    """A diagnosis whose short period has these damping ratios at 3 rad/s."""
    tracing = tracing_of(verdict)

    def of(damping: float) -> Characteristics:
        values = np.array([2.0 * damping * 3.0, 9.0, 10.0])
        names = ("short_period_rate", "short_period_stiffness", "load_factor_slope")
        return Characteristics(names, values, np.diag([(6.0 * std) ** 2, 1e-6, 1e-6]))

    return replace(
        tracing,
        diagnosis=replace(tracing.diagnosis, modes_before=of(before), modes_after=of(after)),
        flown=FlightPhase("IV", "A", ()),
    )


def test_a_level_that_an_effect_changes_is_in_the_headline_and_in_the_file() -> None:
    tracing = with_damping(0.28, 0.45)
    assert headline(tracing).endswith(
        "; the short period was level 2 (> 99.9 %), is level 1 (> 99.9 %)"
    )
    told = diagnosis_text(tracing)
    assert (
        "levels by MIL-F-8785C, class IV, category A\n" in told
        and "short period  level 2 (> 99.9 %)  level 1 (> 99.9 %)" in told
    )
    content = diagnosis_content(tracing, "now")["flying_qualities"]
    assert [content[when]["modes"]["short period"]["level"] for when in ("before", "after")] == [
        2,
        1,
    ]
    missed = content["before"]["modes"]["short period"]["decided_by"]
    assert missed == {"quantity": "damping_ratio", "estimate": pytest.approx(0.28), "limit": 0.35}


@pytest.mark.parametrize(
    ("before", "after", "verdict", "std"),
    [
        (0.45, 0.46, Verdict.TRACED, 0.005),  # the same level
        (0.28, 0.36, Verdict.TRACED, 0.02),  # level 1 or 2: these data do not tell
        (0.28, 0.45, Verdict.UNEXPLAINED, 0.005),  # no effect stands that could change it
    ],
)
def test_nothing_else_is_said_of_levels(
    before: float, after: float, verdict: Verdict, std: float
) -> None:
    assert "short period was" not in headline(with_damping(before, after, verdict, std))


def test_what_these_data_do_not_tell_is_told_as_such() -> None:
    told = diagnosis_text(with_damping(0.28, 0.355, std=0.02))
    assert "not determined (level 1 60 %, level 2 40 %)" in told
    assert (
        "after"
        not in diagnosis_text(with_damping(0.28, 0.45, Verdict.UNEXPLAINED))
        .split("levels by")[1]
        .split("\n")[1]
    )


def test_a_file_without_modes_says_nothing() -> None:
    tracing = tracing_of(Verdict.TRACED)
    assert "flying_qualities" not in diagnosis_content(
        tracing, "now"
    ) and "levels by" not in diagnosis_text(tracing)
