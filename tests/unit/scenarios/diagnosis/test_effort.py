"""How far a diagnosis looks: the option, what it sets, and what is said of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from ident.tracing.diagnosis import EFFORTS, NORMAL, THOROUGH, Diagnosis, TraceSettings, Verdict
from scenarios.diagnosis.diagnose import Tracing, diagnose_files
from scenarios.diagnosis.kinematics import Kinematics
from scenarios.diagnosis.opening import effort_sentence, settings_of
from scenarios.diagnosis.report.content import diagnosis_content
from scenarios.diagnosis.report.text import diagnosis_text
from scenarios.preparation.plan import Request
from sim.errors import DeclarationError
from sim.record import Record
from tests.diagnoses import RIGID, diagnosis_of, tracing_of, written_inputs


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
