"""The browser harness sees what it is there to see."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.browser.complaints import Complaints, fits
from tests.browser.serving import Served, Servers, free_port

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

GOOD = "<!doctype html><html lang=en><link rel=icon href='data:,'><title>page</title><h1>here</h1>"


@pytest.mark.parametrize(
    ("part", "complaint"),
    [
        ("<script>console.error('oh no')</script>", "console: oh no"),
        ("<script>throw new Error('broken')</script>", "exception in the page"),
        ("<img src=gone.png>", "answered 404"),
        ("<img src=https://example.org/there.png>", "asked another machine"),
        ("<p>nothing wrong</p>", None),
    ],
)
def test_a_complaint_is_heard(
    part: str, complaint: str | None, chromium: Browser, serve_folder: Served, tmp_path: Path
) -> None:
    (tmp_path / "index.html").write_text(GOOD + part)
    page = chromium.new_context().new_page()
    complaints = Complaints.of(page)
    page.goto(serve_folder(tmp_path))
    page.wait_for_load_state("networkidle")
    page.context.close()
    assert (
        any(complaint in found for found in complaints.found)
        if complaint
        else complaints.found == []
    )


def test_a_page_from_a_file_and_its_width(page: Page, phone: Page, tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    path.write_text(GOOD + "<div style='width: 600px'>broad</div>")
    for sheet in (page, phone):
        sheet.goto(path.as_uri())
        assert sheet.locator("h1").inner_text() == "here"
    assert fits(page)
    assert not fits(phone)


def test_a_process_serves_and_ends(tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text(GOOD)
    port = free_port()
    with Servers() as servers:
        address = servers.process(
            [sys.executable, "-m", "http.server", str(port), "--bind", "127.0.0.1"], port, tmp_path
        )
        assert address.endswith(f":{port}/")
    with Servers() as servers, pytest.raises(AssertionError, match="no such option"):
        servers.process(
            [sys.executable, "-c", "raise SystemExit('no such option')"], port, tmp_path
        )


def test_the_contact_sheet_shows_tall_pages_whole(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    from tests.browser.contact_sheet import GAP, HEAD, SCALE, TALLEST, sheet_of

    tall = image.new("RGB", (390, 2 * TALLEST + 1000), "white")
    tall.paste("red", (0, tall.height - 500, 390, tall.height))
    tall.save(tmp_path / "phone.png")
    sheet = sheet_of({"run": [tmp_path / "phone.png"]})
    width = int(390 * SCALE)
    assert sheet.width == 3 * (width + GAP)
    assert sheet.getpixel((2 * (width + GAP) + 5, HEAD + int(900 * SCALE))) == (255, 0, 0)
