"""Levels of flying qualities in a diagnosis: a level that changes because an effect was missing is
said first of all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ident.flying_qualities.levels import FlightPhase
from ident.flying_qualities.modes import Characteristics
from ident.tracing.diagnosis import EFFORTS, NORMAL, THOROUGH, Diagnosis, TraceSettings, Verdict
from scenarios.diagnosis.diagnose import Tracing, diagnose_files
from scenarios.diagnosis.kinematics import Kinematics
from scenarios.diagnosis.opening import effort_sentence, settings_of
from scenarios.diagnosis.text import diagnosis_content, diagnosis_text, headline
from scenarios.preparation.plan import Request
from sim.errors import DeclarationError
from sim.record import Record
from tests.diagnoses import RIGID, diagnosis_of, tracing_of, written_inputs


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


def test_thorough_looks_further_in_every_way_and_judges_alike() -> None:
    assert (
        settings_of("normal") is NORMAL == TraceSettings() and settings_of("thorough") is THOROUGH
    )
    assert THOROUGH.budget == 10 * NORMAL.budget and THOROUGH.depth > NORMAL.depth
    assert replace(THOROUGH, budget=NORMAL.budget, depth=NORMAL.depth, effort="normal") == NORMAL
    assert all(settings.effort == name for name, settings in EFFORTS.items())


def test_an_effort_that_there_is_not_is_refused_in_one_line() -> None:
    with pytest.raises(
        DeclarationError, match=r"--effort.*there is no effort 'heroic'.*normal or thorough"
    ):
        settings_of("heroic")


@pytest.mark.parametrize("effort", ["normal", "thorough"])
def test_the_request_sets_what_the_loop_is_given(
    effort: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[TraceSettings] = []

    def loop(
        records: Sequence[Record],
        model,
        candidates,
        guards,
        validation,
        settings: TraceSettings,
        progress,
        kinematics=None,
        reread=None,
    ) -> Diagnosis:
        given.append(settings)
        return diagnosis_of(Verdict.TRACED, RIGID, tuple(records), tuple(validation))

    monkeypatch.setattr(
        "scenarios.diagnosis.diagnose.kinematics_of_files",
        lambda *_: Kinematics((), None, "not run"),
    )
    train, validate, vehicle = written_inputs(tmp_path)
    tracing = diagnose_files(
        Request((train,), "rigid", vehicle, (validate,), effort=effort), trace=loop
    )
    assert given[0] == EFFORTS[effort] and tracing.effort == effort


def stopped(verdict: Verdict, effort: str) -> Tracing:
    tracing = tracing_of(verdict)
    return replace(tracing, diagnosis=replace(tracing.diagnosis, stopped=True), effort=effort)


@pytest.mark.parametrize("verdict", list(Verdict))
def test_the_hint_is_there_where_a_normal_search_ended_at_its_means_with_something_left(
    verdict: Verdict,
) -> None:
    left = verdict in (Verdict.PARTIAL, Verdict.UNEXPLAINED)
    hint = "--effort thorough would look further"
    assert (hint in effort_sentence("normal", stopped(verdict, "normal").diagnosis)) is left
    assert hint not in effort_sentence("thorough", stopped(verdict, "thorough").diagnosis)
    assert effort_sentence("normal", tracing_of(verdict).diagnosis) == "effort: normal"


def test_text_and_json_say_which_effort_was_made() -> None:
    tracing = stopped(Verdict.UNEXPLAINED, "normal")
    assert "--effort thorough would look further" in " ".join(diagnosis_text(tracing).split())
    assert diagnosis_content(tracing, "")["effort"] == {"name": "normal", "stopped": True}
    assert "effort: thorough" in diagnosis_text(replace(tracing, effort="thorough"))
