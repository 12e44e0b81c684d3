"""Where nothing stands, nothing is shown 'after': text, page and figures tell of the declared model
alone; the JSON keeps its keys.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from ident.tracing.diagnosis import Quantity, Verdict
from scenarios.diagnosis.files import diagnosis_page, figures_of, pictured
from scenarios.diagnosis.tables import short
from scenarios.diagnosis.text import diagnosis_content, diagnosis_text
from scenarios.diagnosis.wording import as_declared
from scenarios.report.document import signs
from scenarios.report.html import page_html
from scenarios.report.quantities import (
    derived_line,
    displayed,
    is_frequency,
    value_text,
    with_sigma,
)
from tests.diagnoses import tracing_of

OTHERS = [verdict for verdict in Verdict if verdict is not Verdict.UNEXPLAINED]


def test_no_number_of_a_hint_stands_in_the_text() -> None:
    tracing = tracing_of(Verdict.UNEXPLAINED)
    d, told = tracing.diagnosis, diagnosis_text(tracing)
    assert "declared model" in told and not re.search(r"\bafter\b|moved by", told)
    for name, old in d.before.items():
        assert value_text(old.value, old.std) in told, name
        assert value_text(d.after[name].value, d.after[name].std) not in told, name
    for channel, after in d.error_after.rmse.items():
        assert after != d.error_before.rmse[channel]
    assert " -> " not in told


@pytest.mark.parametrize("verdict", OTHERS)
def test_where_something_stands_both_are_shown(verdict: Verdict) -> None:
    tracing = tracing_of(verdict)
    told = diagnosis_text(tracing)
    assert "after" in told and "moved by" in told
    assert as_declared(tracing.diagnosis) is tracing.diagnosis


def test_where_nothing_was_missing_no_column_repeats_another() -> None:
    tracing = tracing_of(Verdict.CONSISTENT)
    d = tracing.diagnosis
    same = replace(d, after=d.before, derived_after=d.derived_before, error_after=d.error_before)
    same = replace(same, modes_after=d.modes_before)
    told = diagnosis_text(replace(tracing, diagnosis=same))
    assert "declared model" in told and not re.search(r"\bafter\b|\bbefore\b|moved by", told)
    old = d.before["Cm_q"]
    assert value_text(old.value, old.std) in told
    page = page_html(diagnosis_page(replace(tracing, diagnosis=same), []))
    assert ">after</button>" not in page and "No effect is needed" in page
    # a fit that did change keeps both
    moved = replace(same, after=d.after)
    assert re.search(r"\bafter\b", diagnosis_text(replace(tracing, diagnosis=moved)))


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.12, "0.120"),
        (0.119, "0.119"),
        (123.4, "123"),
        (5.0, "5.00"),
        (0.0, "0"),
        (25000.0, "25000"),
    ],
)
def test_the_errors_of_a_table_have_three_digits_each(value: float, shown: str) -> None:
    assert short(value) == shown


def test_the_page_has_no_column_after() -> None:
    tracing = tracing_of(Verdict.UNEXPLAINED)
    page = page_html(diagnosis_page(tracing, []))
    assert (
        ">declared model</button>" in page
        and ">after</button>" not in page
        and "<td>after</td>" not in page
    )
    after = tracing.diagnosis.after["Cm_q"]
    assert signs(value_text(after.value, after.std)) not in page
    assert ">after</button>" in page_html(diagnosis_page(tracing_of(Verdict.TRACED), []))


@pytest.mark.long
def test_its_figures_show_the_declared_model_alone() -> None:
    shown = pictured(tracing_of(Verdict.UNEXPLAINED))
    assert all(np.array_equal(item.after, item.before) for item in shown.fitted)
    assert all(np.array_equal(item.after, item.before) for item in shown.predictions)
    figures = dict(figures_of(shown))
    assert "derivatives" not in figures and "derivatives" in dict(
        figures_of(pictured(tracing_of(Verdict.PARTIAL)))
    )
    for stem in ("held_out", "residuals", "spectra"):
        figure = figures[stem]()
        texts = [text.get_text() for panel in figure.axes for text in panel.texts]
        texts += [label for panel in figure.axes for label in panel.get_legend_handles_labels()[1]]
        texts += [text.get_text() for legend in figure.legends for text in legend.get_texts()]
        assert texts and not any(re.search(r"\b(after|before)\b", text) for text in texts), stem


def test_the_json_keeps_both() -> None:
    content = diagnosis_content(tracing_of(Verdict.UNEXPLAINED), "now")
    assert (
        set(content["parameters"]["after"]) == set(content["parameters"]["before"])
        and content["error"]["after"]["rmse"]
    )
    assert content["parameters"]["after"]["Cm_q"] != content["parameters"]["before"]["Cm_q"]


def test_warnings_describe_what_the_declared_model_leaves() -> None:
    tracing = tracing_of(Verdict.UNEXPLAINED)
    silent = replace(tracing.diagnosis, tests_after=())
    one, other = (
        diagnosis_content(replace(tracing, diagnosis=d), "now")["warnings"]
        for d in (tracing.diagnosis, silent)
    )
    assert one == other and any(
        line.startswith("with the declared model, residual of the") for line in one
    )


@pytest.mark.parametrize(
    "name",
    [
        "frequency",
        "natural_frequency",
        "omega",
        "structural-mode.omega",
        "omega12",
        "elastic-mode.frequency",
    ],
)
def test_a_frequency_is_told_in_rad_and_hertz_and_never_in_degrees(name: str) -> None:
    q = Quantity(12.0, 0.3, "rad/s")
    assert displayed(q, name) == (12.0, 0.3, "rad/s")
    assert with_sigma(q, name=name) == f"12.00 +- 0.30 rad/s ({12.0 / (2.0 * math.pi):.3g} Hz)"


@pytest.mark.parametrize("name", ["bias_q", "offset", "rate_limit", "q"])
def test_an_angular_rate_is_told_in_degrees(name: str) -> None:
    assert (
        not is_frequency(name, "rad/s")
        and displayed(Quantity(0.1, 0.01, "rad/s"), name)[2] == "deg/s"
    )
    assert "Hz" not in with_sigma(Quantity(0.1, 0.01, "rad/s"), name=name)


def test_derived_frequencies_come_in_both_units() -> None:
    assert derived_line({"natural_frequency": (4.27, 0.05), "delay": (0.1, 0.01)}).startswith(
        "natural frequency 4.270 +- 0.050 rad/s (0.68 Hz); delay"
    )
    for verdict in Verdict:
        rows = [
            line.split()
            for line in diagnosis_text(tracing_of(verdict)).splitlines()
            if line.strip().startswith("natural frequency")
        ]
        assert [row[2] for row in rows] == ["rad/s", "Hz"]
        assert float(rows[1][3]) == pytest.approx(float(rows[0][3]) / (2.0 * math.pi), abs=0.01)
