"""Every study begins with a summary of five lines at most, each within the terminal, its numbers
whole.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from ident.statistics.residuals import ResidualTest
from ident.tracing.diagnosis import Verdict
from scenarios.diagnosis.text import details_text, diagnosis_summary, diagnosis_text
from scenarios.report.summary import (
    Summary,
    details_in,
    residual_phrase,
    result_phrase,
    summary_lines,
    value_phrase,
)
from scenarios.studies.catalogue import load_scenario
from scenarios.studies.study import run_scenario
from scenarios.studies.text import print_study
from tests.diagnoses import tracing_of

LABELS = ("study", "outcome", "result", "residual", "details")


def begins_with_a_summary(text: str, width: int) -> list[str]:
    """The lines above the first empty one, checked."""
    lines = text.split("\n\n")[0].splitlines()
    labels = [line.split()[0] for line in lines]
    assert (
        len(lines) <= 5
        and labels == [label for label in LABELS if label in labels]
        and {"study", "outcome", "details"} <= set(labels)
    )
    assert all(len(line) <= width for line in lines[:-1]), "a path stays whole"
    return lines


@given(
    st.lists(
        st.tuples(st.sampled_from(["Cm_q", "CL_alpha"]), st.floats(-50, 50), st.floats(1e-4, 1.0)),
        min_size=1,
        max_size=6,
    ),
    st.integers(40, 130),
)
def test_no_number_is_cut_at_any_width(values: list[tuple[str, float, float]], width: int) -> None:
    whole = result_phrase([(name, value, std, "1/rad") for name, value, std in values], {})
    (line,) = [
        each for each in summary_lines(Summary("a", "b", whole), width) if each.startswith("result")
    ]
    assert len(line) <= width
    numbers = set(re.findall(r"[-\d.e+]*\d", whole))
    assert set(re.findall(r"[-\d.e+]*\d", line)) <= numbers
    assert line.endswith("...") or whole in line


def test_values_stand_in_the_units_that_people_read() -> None:
    assert (
        value_phrase("half_width", 0.00872665, 0.0000872665, "rad")
        == "half_width 0.5000 +- 0.0050 deg"
    )
    assert (
        value_phrase("frequency", 12.0, 0.1, "rad/s") == "frequency 12.00 +- 0.10 rad/s (1.91 Hz)"
    )
    assert (
        value_phrase("Cm_q", -3.0, 1e4, "1/rad") == "Cm_q not determined"
        and value_phrase("held", 2.0, 0.0, "1") == "held 2"
    )


def test_the_residuals_state_names_the_channels() -> None:
    tests = [
        ResidualTest("ljung-box", name, 1.0, p, "")
        for name, p in (("alpha", 0.5), ("q", 1e-9), ("nz", 0.2), ("q, record 2", 0.5))
    ]
    assert [test.passed for test in tests] == [True, False, True, True]
    assert residual_phrase(tests) == "more than noise in q; consistent with noise in alpha and nz"
    assert (
        residual_phrase(tests[:1]) == "consistent with noise in alpha" and residual_phrase([]) == ""
    )
    assert residual_phrase([tests[0], ResidualTest("nis", "all", 9.0, 1e-9, "")]).startswith(
        "not consistent with noise"
    )


@pytest.mark.sampled
@pytest.mark.parametrize("verdict", list(Verdict))
def test_a_diagnosis_begins_with_it(verdict: Verdict) -> None:
    tracing = tracing_of(verdict)
    for width in (80, 118):
        lines = begins_with_a_summary(
            diagnosis_text(tracing, width, "below; in study/report.html"), width
        )
        assert verdict.value.upper() in lines[1] and lines[-1].endswith("study/report.html")
        assert diagnosis_text(tracing, width).endswith(details_text(tracing, width))
    assert all(
        claim.name in diagnosis_summary(tracing).outcome
        for claim in tracing.diagnosis.effects
        if claim.claimed
    )


def printed(show: Callable[[Console], None], width: int) -> str:
    out = Console(file=io.StringIO(), width=width, no_color=True, markup=False)
    show(out)
    assert isinstance(out.file, io.StringIO)
    return out.file.getvalue()


@pytest.mark.long
@pytest.mark.parametrize("width", [80, 120])
def test_a_run_begins_with_it(width: int) -> None:
    study = run_scenario(load_scenario("ballistic", ()), 1)
    lines = begins_with_a_summary(printed(lambda out: print_study(study, out), width), width)
    (row, *_) = study.main.rows
    assert (
        f"{row.name} " in lines[2]
        and "kg/m2" in lines[2]
        and "sigma" in lines[1]
        and details_in(None) in lines[-1]
    )


def test_the_derivatives_that_are_asked_for_are_named_before_the_constant_of_drag() -> None:
    names = ("CD_0", "CD_alpha", "CD_alpha2", "CL_alpha", "Cm_alpha", "Cm_q")
    told = result_phrase([(name, 1.0, 0.1, "1") for name in names], {})
    assert [part.split()[0] for part in told.split("; ")] == ["CL_alpha", "Cm_alpha", "Cm_q", "3"]
    assert told.endswith("3 more in the table")
