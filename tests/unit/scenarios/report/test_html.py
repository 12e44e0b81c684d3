"""The page as HTML: whole, escaped, closed to anything from outside; and made again from its
folder.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
import re
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import pytest

from scenarios.plots import style
from scenarios.report.document import (
    Bullets,
    Column,
    Page,
    Prose,
    Section,
    reproduction,
    table,
    warning_lines,
)
from scenarios.report.folder import rebuilt, write_page
from scenarios.report.html import page_html, page_of
from sim.errors import FlightidError
from tests.pages import HOSTILE, PAGE

TEXT = page_html(PAGE)
VOID = {"meta", "path", "rect"}


class Parsed(HTMLParser):
    """Balanced tags, attributes and text of a page."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str]]] = []
        self.text: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open, f"left open: {self.open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, {name: value or "" for name, value in attrs}))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert tag in VOID or (self.open and self.open.pop() == tag), (
            f"</{tag}> closes another element"
        )

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("style", "script"):
            self.text.append(data)

    def all(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.tags if name == tag]


PARSED = Parsed(TEXT)


def test_text_of_users_is_no_markup() -> None:
    words = "".join(PARSED.text)
    assert words.count(HOSTILE) == 7  # title twice, kind, summary, warning, list, command
    assert len(PARSED.all("script")) == 1 and not PARSED.all("b")


def test_an_interval_is_in_one_line() -> None:
    section = Section("margins", (Prose("Gain margin 6.987 to 7.070 dB, -4.4 to 3.8 deg."),))
    text = page_html(replace(PAGE, sections=(section,)))
    for interval in ("6.987 to 7.070", "\N{MINUS SIGN}4.4 to 3.8"):
        assert f'<span class="word">{interval}</span>' in text


def test_a_caution_is_no_warning() -> None:
    lines = warning_lines(["the residual is more than noise"], ["20 samples are few"])
    text = page_html(replace(PAGE, warnings=lines))
    assert "<strong>Warning.</strong> The residual is more than noise." in text
    assert "<strong>Caution.</strong> 20 samples are few." in text


def test_words_between_backticks_are_code_and_stay_text() -> None:
    blocks = (Prose("The record of `rigid`, and `<b>`"), *PAGE.sections[0].blocks)
    first = replace(PAGE.sections[0], blocks=blocks)
    made = page_html(replace(PAGE, sections=(first, *PAGE.sections[1:])))
    assert "The record of <code>rigid</code>, and <code>&lt;b&gt;</code>." in made


def test_an_option_in_a_text_stays_on_one_line() -> None:
    blocks = (Prose("A second record (--validate) & a 3-2-1-1"), *PAGE.sections[0].blocks)
    first = replace(PAGE.sections[0], blocks=blocks)
    made = page_html(replace(PAGE, sections=(first, *PAGE.sections[1:])))
    assert '(<span class="word">--validate</span>) &amp; a <span class="word">3-2-1-1<' in made


def test_nothing_comes_from_outside_and_only_the_own_script_runs() -> None:
    assert not re.search(r"https?://|@import|url\(|\son[a-z]+=|\sstyle=|javascript:", TEXT)
    assert not {"link", "iframe", "object", "img", "form"} & {tag for tag, _ in PARSED.tags}
    (policy,) = [
        each["content"]
        for each in PARSED.all("meta")
        if each.get("http-equiv") == "Content-Security-Policy"
    ]
    assert policy.startswith("default-src 'none'; ") and "unsafe" not in policy
    for tag in ("style", "script"):
        (content,) = re.findall(rf"<{tag}>(.*?)</{tag}>", TEXT, re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert f"{tag}-src 'sha256-{digest}'" in policy


def test_headings_are_in_order_tables_have_captions_and_names_are_unique() -> None:
    levels = [int(tag[1]) for tag, _ in PARSED.tags if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1 and levels.count(1) == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))
    assert len(PARSED.all("caption")) == len(PARSED.all("table")) == 3
    names = [attributes["id"] for _, attributes in PARSED.tags if "id" in attributes]
    assert len(names) == len(set(names)) and {"parameters", "parameters-2"} <= set(names)
    assert {each["href"][1:] for each in PARSED.all("a")} <= set(names)
    assert all(each.get("aria-label") for each in PARSED.all("svg"))
    assert len(PARSED.all("th")) == TEXT.count('class="sort"')


def test_cells_carry_their_numbers_and_every_row_its_unit() -> None:
    cells = [each for each in PARSED.all("td") if "data-value" in each]
    assert {"data-value": "-1.657", "data-sigma": "0.0018", "class": "n"} in cells
    assert TEXT.count("<td>1/rad</td>") == 3 and TEXT.count("<td>s</td>") == 1
    assert (
        "−1.6570\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}0.0018" in TEXT
        and 'error <span class="unit">(%)</span>' in TEXT
    )
    assert "a -1.csv" in TEXT and "The first 10 of 60 rows" in TEXT


def test_every_colour_of_the_figures_has_one_for_dark_pages() -> None:
    own = [
        style.BLUE,
        style.VERMILION,
        style.GREEN,
        style.PURPLE,
        style.SKY,
        style.ORANGE,
        style.BLACK,
        style.GREY,
        style.LIGHT,
        "#ffffff",
    ]
    for colour in own:
        assert (
            f'svg [stroke="{colour.lower()}"]' in TEXT and f'svg [fill="{colour.lower()}"]' in TEXT
        )
    assert not re.search(r"/\*(DARK|LIGHT)\*/", TEXT)


def luminance(colour: str) -> float:
    parts = [int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)]
    linear = [
        part / 12.92 if part <= 0.03928 else ((part + 0.055) / 1.055) ** 2.4 for part in parts
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize("dark", [False, True])
def test_words_stand_out_from_their_ground_as_wcag_aa_asks(dark: bool) -> None:
    rules = re.search(
        r':root\[data-theme="dark"\] \{(.*?)\}' if dark else r":root \{(.*?)\}", TEXT, re.DOTALL
    )
    assert rules is not None
    colours = dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6})", rules[1]))
    for ground in ("paper", "fill"):
        for words in ("ink", "soft", "accent", "good", "fair", "open"):
            bright, faint = sorted(
                (luminance(colours[words]), luminance(colours[ground])), reverse=True
            )
            assert (bright + 0.05) / (faint + 0.05) >= 4.5, (ground, words)


def test_page_is_made_again_from_its_folder_to_the_byte(tmp_path: Path) -> None:
    write_page(tmp_path, PAGE)
    first = (tmp_path / "report.html").read_bytes()
    assert first == TEXT.encode()
    (tmp_path / "report.html").unlink()
    assert (
        rebuilt(tmp_path) == tmp_path / "report.html"
        and (tmp_path / "report.html").read_bytes() == first
    )


@pytest.mark.parametrize(
    ("document", "told"),
    [
        (None, "it is no study folder"),
        (
            {"schema": "flightid/comparison/1", "scenario": "rigid", "seed": 3},
            "flightid run rigid --seed 3 --out",
        ),
        (
            {"schema": "flightid/campaign/1", "scenario": "rigid", "runs": 20, "first_seed": 5},
            "flightid campaign rigid --runs 20 --seed 5 --out",
        ),
        ({"schema": "flightid/comparison/1", "scenario": "identify"}, "run its command again"),
    ],
)
def test_folder_without_a_page_says_what_to_run(
    tmp_path: Path, document: dict[str, object] | None, told: str
) -> None:
    if document is not None:
        name = "campaign.json" if "runs" in document else "comparison.json"
        (tmp_path / name).write_text(json.dumps(document))
    with pytest.raises(FlightidError) as error:
        rebuilt(tmp_path)
    assert told in str(error.value) and "\n" not in str(error.value)


def test_spoilt_content_and_missing_folder_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(FlightidError, match="no such folder"):
        rebuilt(tmp_path / "none")
    for spoilt in ("{", "[]", '{"schema": "flightid/report/2"}', '{"schema": "flightid/report/1"}'):
        (tmp_path / "report.json").write_text(spoilt)
        with pytest.raises(FlightidError, match="no content of a page"):
            rebuilt(tmp_path)
    write_page(tmp_path, PAGE)
    first = (tmp_path / "report.html").read_bytes()
    content = json.loads((tmp_path / "report.json").read_bytes())
    # found out only when the page is made
    (tmp_path / "report.json").write_text(json.dumps({**content, "created": 5}))
    with pytest.raises(FlightidError, match="no content of a page"):
        rebuilt(tmp_path)
    assert (tmp_path / "report.html").read_bytes() == first


def test_a_file_name_that_is_no_utf_8_is_told_and_made_again(tmp_path: Path) -> None:
    page = replace(PAGE, title=os.fsdecode(b"flig\xffht.csv"))
    write_page(tmp_path, page)
    first = (tmp_path / "report.html").read_bytes()
    assert b"flig\\udcffht.csv" in first
    assert (
        rebuilt(tmp_path).read_bytes() == first
        and page_of(json.loads((tmp_path / "report.json").read_bytes())) == page
    )


def test_command_is_what_was_typed_else_what_would_be(monkeypatch: pytest.MonkeyPatch) -> None:
    for program in ("/usr/bin/flightid", "/x/scenarios/__main__.py"):
        monkeypatch.setattr("sys.argv", [program, "run", "a b", "--seed", "2"])
        assert reproduction(["flightid", "run"]).commands == ("flightid run 'a b' --seed 2",)
    for program in ("/x/pytest/__main__.py", "/x/python", ""):
        monkeypatch.setattr("sys.argv", [program, "run"])
        assert reproduction(["flightid", "run", "rigid"]).commands == ("flightid run rigid",)


def test_a_caption_does_not_repeat_the_heading_and_one_item_is_a_paragraph() -> None:
    shown = table("simulation error", (Column("channel"), ["alpha"]))
    sections = (Section("Simulation error", (shown, Bullets(("one sentence",)))),)
    text = page_html(replace(PAGE, sections=sections))
    assert "<caption></caption>" in text and 'aria-label="Simulation error"' in text
    assert "<p>One sentence.</p>" in text


def test_a_first_figure_is_as_tall_on_paper_as_the_header_leaves_room_for() -> None:
    def room(page: Page) -> int:
        found = re.search(r'<header class="room(\d+)">', page_html(page))
        return int(found[1]) if found else 0

    few = replace(PAGE, summary=("one line",), warnings=())
    more = replace(few, warnings=("a warning of many words " * 12,))
    assert 130 <= room(more) < room(few) <= 200
    assert room(replace(few, summary=("words " * 300,))) == 0
