"""Each kind of page that a command writes: light enough, painted within a second, no serious fault
by axe-core; figures show values, zoom and switch; dark, on a telephone and on paper.
"""

from __future__ import annotations

import re
from pathlib import Path
from shutil import which
from typing import TYPE_CHECKING, Any

import pytest

from scenarios.report.document import Column, Number, Reproduction, section, table
from scenarios.report.document import Page as Document
from scenarios.report.folder import write_page
from tests.browser.complaints import FIRST_PAINT, Complaints, first_paint, fits, holds, keep_picture
from tests.browser.conftest import DESKTOP, PHONE
from tests.browser.every_page import KINDS, make_pages
from tests.browser.paper import texts_of, words_of

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

SERIOUS = ("serious", "critical")
LARGEST = 3_000_000  # bytes of a page
# Their figures are bars, dots or tables in a picture, in which there is nothing to zoom into.
STILL = ("campaign", "survey")
# Captions of tables of which a part is out of sight on a wide screen.
CUT_TABLES = """[...document.querySelectorAll('.wide')]
  .filter(table => table.scrollWidth > table.clientWidth + 1).map(table => table.ariaLabel)"""
BROKEN = (
    "<html><head><title>x</title></head><body>"
    '<img src="data:image/gif;base64,R0lGODlhAQABAAAAACw="><p style="color:#ccc">pale</p></body>'
)


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return make_pages(tmp_path_factory.mktemp("every-page"), KINDS)


@pytest.fixture(scope="module")
def axe() -> str:
    """The script of axe-core; skips where it is not installed."""
    found = pytest.importorskip(
        "axe_playwright_python", reason='no axe-core: python -m pip install -e ".[browser]"'
    )
    return Path(found.__file__).with_name("axe.min.js").read_text(encoding="utf-8")


def faults(page: Page) -> list[dict[str, Any]]:
    """What axe-core, whose script is in the page, calls serious or critical: the rule, and the
    first element.
    """
    found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")["violations"]
    return [
        {"rule": each["id"], "where": each["nodes"][0]["html"][:200]}
        for each in found
        if each["impact"] in SERIOUS
    ]


def figures_answer(page: Page) -> None:
    """The first figure that zooms shows values under the pointer, zooms by its button, and hides a
    curve by its name.
    """
    figure = page.locator("figure[data-plot]").first
    figure.scroll_into_view_if_needed()
    panel = figure.locator(".panel").first
    panel.locator("canvas").wait_for()
    over = panel.locator(".u-over")
    box = over.bounding_box()
    assert box is not None
    over.hover(position={"x": 0.5 * box["width"], "y": 0.5 * box["height"]})
    values = figure.locator(".values").first.inner_text()
    assert re.search(r"\d", values), values
    figure.get_by_role("button", name="Zoom in").click()
    assert figure.get_attribute("data-zoomed") == "true"
    figure.get_by_role("button", name="Show all").click()
    assert figure.get_attribute("data-zoomed") == "false"
    for key in figure.get_by_role("button", name="Curve: ").all()[:1]:
        key.click()
        assert key.get_attribute("aria-pressed") == "false"


def ground(page: Page) -> int:
    """Red, green and blue of the page's ground, added."""
    colour = page.evaluate("getComputedStyle(document.body).backgroundColor")
    return sum(map(int, re.findall(r"\d+", colour)[:3]))


@pytest.mark.parametrize("kind", KINDS)
def test_a_page_of_each_kind(
    chromium: Browser, pages: dict[str, Path], axe: str, kind: str, tmp_path: Path
) -> None:
    assert pages[kind].stat().st_size < LARGEST
    # The policy of a page lets no script in but its own.
    context = chromium.new_context(
        bypass_csp=True, viewport={"width": DESKTOP["width"], "height": DESKTOP["height"]}
    )
    page = context.new_page()
    complaints = Complaints.of(page)
    paint = first_paint(page, pages[kind].as_uri())
    assert paint < FIRST_PAINT, f"first paint after {paint:.0f} ms"
    page.add_script_tag(content=axe)
    assert fits(page) and ground(page) > 600 and faults(page) == []
    assert page.evaluate(CUT_TABLES) == []
    assert (page.locator("figure[data-plot]").count() == 0) == (kind in STILL)
    if kind not in STILL:
        figures_answer(page)
    page.emulate_media(color_scheme="dark")
    page.set_viewport_size({"width": PHONE["width"], "height": PHONE["height"]})
    assert holds(page, "width => innerWidth === width", PHONE["width"])
    assert fits(page) and ground(page) < 200 and faults(page) == []
    keep_picture(page, f"{kind}-phone-dark")
    page.emulate_media(color_scheme="light", media="print")
    assert ground(page) == 765 and not page.locator("nav").is_visible()
    page.pdf(path=str(tmp_path / "page.pdf"), format="A4", print_background=True)
    if which("pdftotext") is not None:
        assert min(words_of(tmp_path / "page.pdf")) > 5
    context.close()
    assert complaints.found == []


def test_a_bad_page_is_found(chromium: Browser, axe: str) -> None:
    page = chromium.new_page()
    page.set_content(BROKEN)
    page.add_script_tag(content=axe)
    assert {"image-alt", "color-contrast"} <= {each["rule"] for each in faults(page)}
    page.close()


@pytest.mark.skipif(which("pdftotext") is None, reason="no pdftotext (poppler-utils)")
def test_the_head_of_a_long_table_is_on_every_sheet(chromium: Browser, tmp_path: Path) -> None:
    count = 90
    shown = table(
        "long table",
        (Column("measure"), [f"row-{at}" for at in range(count)]),
        (Column("value", "1"), [Number(float(at)) for at in range(count)]),
    )
    document = Document(
        *("Title", "kind", "converged", "good", "", (), ()),
        section("Numbers", shown),
        Reproduction(("flightid run rigid",)),
    )
    write_page(tmp_path, document)
    page = chromium.new_page()
    page.goto((tmp_path / "report.html").as_uri())
    page.pdf(path=str(tmp_path / "page.pdf"), format="A4")
    page.close()
    sheets = [text for text in texts_of(tmp_path / "page.pdf") if "row-" in text]
    assert len(sheets) > 1 and all("measure" in text for text in sheets)
