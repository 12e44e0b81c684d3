"""A real browser for tests: Debian's Chromium without a window, driven by playwright; errors in its
console fail the test that caused them.

Nothing is imported from playwright before a test asks for the browser, so that the default suite
collects this folder without it.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.browser.complaints import Complaints
from tests.browser.serving import Served, Servers

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

HERE = Path(__file__).parent
CANDIDATES = ("chromium", "chromium-browser", "google-chrome")
# No sandbox: continuous integration runs as root. The rest keeps the browser from speaking to
# anybody but the page under test.
ARGUMENTS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
DESKTOP, PHONE = {"width": 1280, "height": 900}, {"width": 390, "height": 844}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Every test of this folder is marked `browser`; a test that forgot the mark would need
    Chromium in the default suite.
    """
    for item in items:
        if HERE in item.path.parents:
            item.add_marker(pytest.mark.browser)


def executable() -> str | None:
    """Path of the browser: `FLIGHTID_CHROMIUM` where set, else the first one on the search path."""
    return os.environ.get("FLIGHTID_CHROMIUM") or next(
        (found for name in CANDIDATES if (found := shutil.which(name))), None
    )


@pytest.fixture(scope="session")
def chromium() -> Iterator[Browser]:
    """One browser for the session; skips, saying why, where playwright or Chromium is absent."""
    api = pytest.importorskip(
        "playwright.sync_api", reason='no playwright: python -m pip install -e ".[browser]"'
    )
    path = executable()
    if path is None:
        pytest.skip(
            f"no browser: none of {', '.join(CANDIDATES)} is on the path (Debian: apt-get install "
            "chromium)"
        )
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=[*ARGUMENTS])
        yield browser
        browser.close()


def _watched_page(browser: Browser, size: dict[str, int]) -> Iterator[Page]:
    context = browser.new_context(
        viewport={"width": size["width"], "height": size["height"]}, accept_downloads=True
    )
    page = context.new_page()
    complaints = Complaints.of(page)
    yield page
    context.close()
    assert complaints.found == [], "the browser complained"


@pytest.fixture
def page(chromium: Browser) -> Iterator[Page]:
    """A fresh page 1280 px wide. At its end the test fails if the console saw an error, a request
    failed, or one left this machine.
    """
    yield from _watched_page(chromium, DESKTOP)


@pytest.fixture
def phone(chromium: Browser) -> Iterator[Page]:
    """The same on a telephone, 390 px wide."""
    yield from _watched_page(chromium, PHONE)


@pytest.fixture
def serve_folder() -> Iterator[Served]:
    """Function of a folder that gives the address under which its files are served until the test
    ends.
    """
    with Servers() as servers:
        yield servers.folder


@pytest.fixture(scope="module")
def servers() -> Iterator[Servers]:
    """Servers of a whole module: processes or folders on free ports of 127.0.0.1, ended with the
    module.
    """
    with Servers() as running:
        yield running
