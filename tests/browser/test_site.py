"""The documentation site in a browser: home, equations, API and tables on a telephone, a laptop and
a wide screen; search off line; print.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.browser.complaints import Complaints, fits, holds, keep_picture
from tests.browser.serving import Servers

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

ROOT = Path(__file__).parents[2]
WIDTHS = {390: 844, 1280: 900, 1920: 1080}
PAGES = {
    "home": "index.html",
    "start": "start.html",
    "equations": "estimators.html",
    "nomenclature": "nomenclature.html",
    "effects": "made/effects.html",
    "api": "made/api/ident.filters.html",
    "papers": "papers.html",
}
# What is wider than its page, lies in nothing that scrolls, and so cannot be read to its end.
CUT_OFF = """() => {
    const article = document.querySelector('article'), edge = article.getBoundingClientRect().right + 2;
    const scrolls = e => e && e !== article && (['auto', 'scroll'].includes(getComputedStyle(e).overflowX) || scrolls(e.parentElement));
    const wide = [...article.querySelectorAll('table, pre, math, img, dt')].filter(e => e.getBoundingClientRect().right > edge && !scrolls(e));
    return wide.map(e => e.textContent.slice(0, 60));
}"""  # noqa: E501


@pytest.fixture(scope="module")
def site(servers: Servers, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Address of the site: the one that `FLIGHTID_SITE` names, else it is built here, which takes a
    minute or two.
    """
    folder = Path(os.environ.get("FLIGHTID_SITE", ""))
    if not (folder / "index.html").is_file():
        pytest.importorskip("sphinx", reason='no sphinx: python -m pip install -e ".[docs]"')
        folder = tmp_path_factory.mktemp("site")
        subprocess.run(
            [sys.executable, "-m", "sphinx", "-W", "-q", "-b", "html", "docs", str(folder)],
            cwd=ROOT,
            check=True,
        )
    return servers.folder(folder)


@pytest.fixture(params=WIDTHS)
def screen(chromium: Browser, request: pytest.FixtureRequest) -> Iterator[Page]:
    """A page of one of the widths, watched as the other fixtures watch theirs."""
    context = chromium.new_context(
        viewport={"width": request.param, "height": WIDTHS[request.param]}
    )
    page = context.new_page()
    complaints = Complaints.of(page)
    yield page
    context.close()
    assert complaints.found == [], "the browser complained"


@pytest.mark.parametrize("name", PAGES)
def test_pages_fit_every_screen(name: str, site: str, screen: Page) -> None:
    screen.goto(site + PAGES[name])
    assert screen.locator("h1").count() == 1
    keep_picture(
        screen, f"site-{name}-{screen.viewport_size['width'] if screen.viewport_size else 0}"
    )
    assert fits(screen)
    assert screen.evaluate(CUT_OFF) == []


# Tables that are wider than the text beside the contents, with the heading above them.
WIDER = """() => [...document.querySelectorAll('article table')].filter(table => {
    const box = table.closest('.pst-scrollable-table-container') || table.parentElement;
    return table.scrollWidth > box.clientWidth + 1;
}).map(table => table.closest('section').querySelector('h1, h2, h3, h4').textContent)"""


@pytest.mark.parametrize(
    "name", ["papers", "estimators", "own-models", "how-to/own-effect", "how-to/python"]
)
def test_tables_fit_beside_the_contents(name: str, site: str, page: Page) -> None:
    page.goto(f"{site}{name}.html")
    assert page.locator("article table").count() > 0
    assert page.evaluate(WIDER) == []


def test_equations_are_drawn_with_their_font(site: str, page: Page) -> None:
    page.goto(site + "nomenclature.html")
    assert page.locator("math").count() > 100
    assert page.evaluate(
        "document.fonts.ready.then(() => [...document.fonts].some(f => f.family.includes('STIX') "
        "&& f.status == 'loaded'))"
    )
    fraction = page.locator("math mfrac").first
    above, below = (fraction.locator(f"xpath=./*[{i}]").bounding_box() for i in (1, 2))
    assert above and below and above["y"] + above["height"] <= below["y"] + 2
    assert page.locator("merror").count() == 0


def test_search_finds_an_effect_off_line(site: str, page: Page) -> None:
    page.goto(site + "search.html?q=vane-offset")
    page.wait_for_selector("#search-results li")
    assert any("Effects" in text for text in page.locator("#search-results li a").all_inner_texts())


def test_dark_pages_are_dark(site: str, chromium: Browser) -> None:
    context = chromium.new_context(color_scheme="dark")
    page = context.new_page()
    complaints = Complaints.of(page)
    page.goto(site + "estimators.html")
    back = page.evaluate(
        "getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)"
    )
    ink = page.evaluate(
        "getComputedStyle(document.querySelector('article math')).color.match(/\\d+/g).map(Number)"
    )
    assert max(back) < 60 and min(ink) > 150
    keep_picture(page, "site-dark")
    context.close()
    assert complaints.found == []


def test_print_shows_the_article_alone(site: str, page: Page) -> None:
    page.goto(site + "estimators.html")
    page.emulate_media(media="print")
    assert page.locator("article").is_visible()
    assert (
        not page.locator(".bd-sidebar-primary").is_visible()
        and not page.locator("header.bd-header").is_visible()
    )
    keep_picture(page, "site-print")


@pytest.mark.parametrize("word", ["delay", "sweep", "residual"])
def test_search_ranks_guides_before_decisions_and_internals(
    site: str, page: Page, word: str
) -> None:
    page.goto(f"{site}search.html?q={word}")
    assert holds(page, "document.querySelectorAll('#search-results li a').length > 10")
    pages = [str(each.get_attribute("href")) for each in page.locator("#search-results li a").all()]
    assert not any("decisions/" in each or "made/api/" in each for each in pages[:8]), pages[:8]
