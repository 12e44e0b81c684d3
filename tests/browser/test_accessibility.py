"""Pages of every form by axe-core: no serious fault on a light or dark ground and on a telephone;
light enough, and painted within a second.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.browser.conftest import DESKTOP, PHONE
from tests.browser.every_page import FEW, make_pages

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

SERIOUS = ("serious", "critical")
LARGEST = 3_000_000  # bytes of a page
FIRST_PAINT = 1000.0  # ms
BROKEN = (
    "<html><head><title>x</title></head><body>"
    '<img src="data:image/gif;base64,R0lGODlhAQABAAAAACw="><p style="color:#ccc">pale</p></body>'
)


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return make_pages(tmp_path_factory.mktemp("every-page"), FEW)


@pytest.fixture(scope="module")
def axe() -> str:
    """The script of axe-core; skips where it is not installed."""
    found = pytest.importorskip(
        "axe_playwright_python", reason='no axe-core: python -m pip install -e ".[browser]"'
    )
    return Path(found.__file__).with_name("axe.min.js").read_text(encoding="utf-8")


def faults(page: Page, script: str) -> list[dict[str, Any]]:
    """What axe-core calls serious or critical: the rule, and the first element."""
    page.add_script_tag(content=script)
    found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")["violations"]
    return [
        {"rule": each["id"], "where": each["nodes"][0]["html"][:200]}
        for each in found
        if each["impact"] in SERIOUS
    ]


@pytest.mark.parametrize("kind", FEW)
def test_no_serious_fault_and_a_quick_light_page(
    chromium: Browser, pages: dict[str, Path], axe: str, kind: str
) -> None:
    assert pages[kind].stat().st_size < LARGEST
    for size, scheme in ((DESKTOP, "light"), (DESKTOP, "dark"), (PHONE, "light")):
        # The policy of a page lets no script in but its own.
        context = chromium.new_context(
            bypass_csp=True,
            color_scheme="dark" if scheme == "dark" else "light",
            viewport={"width": size["width"], "height": size["height"]},
        )
        page = context.new_page()
        page.goto(pages[kind].as_uri())
        page.wait_for_function("performance.getEntriesByName('first-contentful-paint').length")
        paint = page.evaluate("performance.getEntriesByName('first-contentful-paint')[0].startTime")
        assert paint < FIRST_PAINT, f"first paint after {paint:.0f} ms"
        assert faults(page, axe) == [], f"{kind}, {scheme}, {size['width']} px"
        context.close()


def test_a_bad_page_is_found(chromium: Browser, axe: str) -> None:
    page = chromium.new_page()
    page.set_content(BROKEN)
    assert {"image-alt", "color-contrast"} <= {each["rule"] for each in faults(page, axe)}
    page.close()
