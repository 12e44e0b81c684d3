"""The report: one page that needs nothing else and that no input can break."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from ident.tracing.diagnosis import Verdict
from scenarios.diagnosis.files import captioned, diagnosis_page
from scenarios.diagnosis.kinematics import Kinematics
from scenarios.report.html import page_html
from tests.diagnoses import RIGID, spread_tracing, tracing_of

VOID = {"meta", "img", "br", "hr", "link", "input"}
SCRIPTS = 1  # the page's own


class Page(HTMLParser):
    """Checks that tags are balanced; gathers attributes and text."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.sources: list[str] = []
        self.tags: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()
        assert not self.open, f"left open: {self.open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.sources += [
            value or ""
            for name, value in attrs
            if name in ("src", "href", "action", "data", "srcset")
        ]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open.pop() == tag, f"</{tag}> closes another element"

    def handle_data(self, data: str) -> None:
        if not self.open or self.open[-1] not in ("style", "script"):
            self.text += data


def page_of(verdict: Verdict, stems: Sequence[str] = (), **changes: object) -> tuple[str, Page]:
    tracing = replace(tracing_of(verdict), **changes)  # type: ignore[arg-type]
    drawn = captioned({stem: f'<svg aria-label="{stem}"></svg>' for stem in stems})
    text = page_html(
        diagnosis_page(tracing, [caution.sentence for caution in tracing.diagnosis.warnings], drawn)
    )
    return text, Page(text)


@pytest.mark.parametrize("verdict", list(Verdict))
def test_page_is_whole_and_says_what_was_found(verdict: Verdict) -> None:
    text, page = page_of(verdict)
    words = " ".join(page.text.split())
    assert (
        text.startswith("<!DOCTYPE html>") and 'name="viewport"' in text and "@media print" in text
    )
    assert verdict.value in words and verdict.sentence in words
    for claim in tracing_of(verdict).diagnosis.effects:
        assert claim.name in words
    for name in RIGID.derivatives:
        assert name in words
    assert "+-" not in words and "->" not in words


def test_page_needs_nothing_from_outside_and_shows_its_own_figures_once() -> None:
    text, page = page_of(Verdict.PARTIAL, ["residuals", "held_out", "held_out_2", "unrelated"])
    assert [
        text.count(f'aria-label="{stem}"')
        for stem in ("residuals", "held_out", "held_out_2", "unrelated")
    ] == [1, 1, 1, 0]
    assert all(source.startswith("#") for source in page.sources)
    assert not re.search(r"https?://|@import|url\(", text)
    assert (
        not {"link", "iframe", "object", "img"} & set(page.tags)
        and page.tags.count("script") == SCRIPTS
    )


def test_names_from_files_are_text_and_no_markup() -> None:
    hostile = replace(RIGID, name='<script>alert("x")</script> & <b>')
    text, page = page_of(Verdict.TRACED, vehicle=hostile)
    assert page.tags.count("script") == SCRIPTS and "b" not in page.tags
    assert hostile.name in page.text
    assert text.count("<script") == SCRIPTS


def test_page_of_a_partial_verdict_shows_how_the_evidence_is_spread_and_what_was_weighed() -> None:
    tracing = replace(
        spread_tracing(),
        kinematics=Kinematics((), None, "no record measures <alpha> and q together"),
    )
    text = page_html(diagnosis_page(tracing, [], captioned({"replication": "<svg></svg>"})))
    page = Page(text)
    words = " ".join(page.text.split())
    spread = (
        "Vuong's z over blocks of a second is 5.2; from each of 3 records: 0.058, 0.063, 0.060 s."
    )
    assert f"Replication sensor-lag:alpha: {spread}" in words
    assert (
        "run-to-run" in words
        and "0.83" in words
        and "Under " in words
        and "These data cannot tell them apart" in words
    )
    assert "log odds" in words and "linearised" in words
    assert "Kinematics alone No record measures <alpha> and q together." in words
    # The figure stands in its section, once.
    places = [
        text.index(mark)
        for mark in (
            '<h2 id="replication-title',
            'id="figure-replication"',
            '<h2 id="simulation-error',
        )
    ]
    assert text.count("<svg") == 1 and places == sorted(places)
    assert "+-" not in words


def test_page_of_another_verdict_has_no_word_of_replication() -> None:
    _, page = page_of(Verdict.TRACED)
    assert (
        "Replication" not in page.text
        and "run-to-run" not in page.text
        and "Kinematics" not in page.text
    )
