"""A lab opened in the browser as the command opens it."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from tests.browser.complaints import holds
from tests.browser.serving import Servers, free_port

if TYPE_CHECKING:
    from playwright.sync_api import Locator, Page

LABS = range(1, 10)
TALL = 5000  # px: marimo scrolls inside its page, and a picture holds what is in view
PATIENCE = 120_000.0  # ms: the machine may be busy, and a lab computes before it shows

# A text of each lab's last part.
LAST: Mapping[int, str] = {
    **dict.fromkeys((1, 2, 3, 4, 6, 8, 9), "To think about"),
    5: "Play five seeds",
    7: "What does the model lack?",
}

# Of each lab with a figure that follows a slider: the slider's label.
SLIDERS: Mapping[int, str] = {
    1: "start of β",
    2: "amplitude, deg",
    3: "unit of the 3-2-1-1",
    4: "stick amplitude",
    6: "sensor noise assumed",
    8: "amplitude of the sweep",
    9: "sensor noise, times the usual",
}
DRAWN = "() => [...document.querySelectorAll('iframe')].map(each => each.srcdoc).join()"


def lab_address(number: int, servers: Servers, folder: Path) -> str:
    """Serve a lab as ``flightid lab N --no-browser --port P`` does; its address."""
    port = free_port()
    folder.mkdir(exist_ok=True)
    return servers.process(
        [
            sys.executable,
            "-m",
            "scenarios",
            "lab",
            str(number),
            "--no-browser",
            "--port",
            str(port),
        ],
        port,
        folder,
    )


def open_lab(page: Page, address: str, last: str) -> None:
    """Open it and wait until a text of its last part stands there; a cell that failed says so in
    words of marimo's.
    """
    page.set_default_timeout(PATIENCE)
    page.set_viewport_size(
        {"width": (page.viewport_size or {"width": 1280})["width"], "height": TALL}
    )
    page.goto(address)
    page.get_by_text(last).first.wait_for()
    page.locator("iframe").first.wait_for()
    assert holds(
        page,
        "() => document.readyState == 'complete' && ![...document.images].some(image => "
        "!image.complete)",
    )
    broken = "[...document.images].filter(image => !image.naturalWidth).map(image => image.alt)"
    assert page.evaluate(broken) == [], "images that are not drawn"
    assert_no_failure(page)


def assert_no_failure(page: Page) -> None:
    """No cell shows an exception in the place of its output."""
    failed = page.locator(
        "text=/This cell raised an exception|An internal error occurred|An ancestor "
        "raised|Traceback/"
    )
    assert failed.count() == 0, failed.first.inner_text()


def move(page: Page, label: str, key: str, times: int = 1) -> None:
    """Move the slider that stands behind a label by the keyboard."""
    slider = labelled(page, label).locator("[role=slider]")
    slider.focus()
    for _ in range(times):
        slider.press(key)


def labelled(page: Page, label: str) -> Locator:
    """The element of the page that has a label."""
    return (
        page.locator("marimo-slider, marimo-number, marimo-radio, marimo-dropdown, marimo-checkbox")
        .filter(has_text=label)
        .first
    )
