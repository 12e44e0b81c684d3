"""What a page may not do while a test looks at it, and how a page is looked at."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

if TYPE_CHECKING:
    from playwright.sync_api import ConsoleMessage, Page, Request, Response, Route

LOCAL = ("127.0.0.1", "localhost")
FIRST_PAINT = 1000.0  # ms
PAINTED = "performance.getEntriesByName('first-contentful-paint')"
LOADS = 5


@dataclass
class Complaints:
    """Errors of one page in the order in which they came, one sentence each in `found`; `allow`
    strikes out what a test expects.
    """

    found: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, page: Page) -> Complaints:
        """Listen to a page: console errors, exceptions, failed requests, answers of 400 and more,
        and requests that leave this machine.
        """
        complaints = cls()
        page.on("console", complaints._console)
        page.on(
            "pageerror", lambda error: complaints.found.append(f"exception in the page: {error}")
        )
        page.on("requestfailed", complaints._failed)
        page.on("response", complaints._answered)
        page.context.route(lambda address: not _is_local(address), complaints._left)
        return complaints

    def _console(self, message: ConsoleMessage) -> None:
        if message.type == "error":
            self.found.append(f"console: {message.text} ({message.location.get('url', '')})")

    def _failed(self, request: Request) -> None:
        # A page that is left while it still loads breaks off its requests; that is the test's
        # doing.
        if request.failure != "net::ERR_ABORTED":
            self.found.append(f"request failed: {request.url}: {request.failure}")

    def _answered(self, response: Response) -> None:
        if response.status >= 400:
            self.found.append(f"answered {response.status}: {response.url}")

    def _left(self, route: Route) -> None:
        self.found.append(f"asked another machine: {route.request.url}")
        route.abort()


def _is_local(address: str) -> bool:
    parts = urlsplit(address)
    return parts.scheme not in ("http", "https", "ws", "wss") or parts.hostname in LOCAL


def holds(page: Page, condition: str, argument: object = None, patience: float = 30_000) -> bool:
    """Whether a JavaScript condition becomes true within ``patience`` milliseconds.

    Playwright's own `wait_for_function` asks again from within the page, which the Content Security
    Policy of our pages forbids: it works only where the first answer is already true.
    """
    deadline = time.monotonic() + patience / 1000
    while not page.evaluate(condition, argument):
        if time.monotonic() > deadline:
            return False
        page.wait_for_timeout(50)
    return True


def fits(page: Page) -> bool:
    """Whether the page needs no scrolling sideways: figures follow a new width of the window some
    frames later.
    """
    width = "document.documentElement.scrollWidth <= document.documentElement.clientWidth + 1"
    return holds(page, width, patience=3000)


def keep_picture(page: Page, name: str) -> None:
    """Keep a picture of the whole page as NAME.png in the folder that `FLIGHTID_PICTURES` names;
    without it do nothing.
    """
    folder = os.environ.get("FLIGHTID_PICTURES")
    if folder:
        Path(folder).mkdir(parents=True, exist_ok=True)
        page.screenshot(path=str(Path(folder, f"{name}.png")), full_page=True)


def first_paint(page: Page, address: str) -> float:
    """Time from the request of a page to its first picture, in milliseconds.

    Other programs on the machine can only lengthen it, so that the shortest of up to five loads
    counts.
    """
    shortest = float("inf")
    for _ in range(LOADS):
        page.goto(address)
        assert holds(page, f"{PAINTED}.length"), "the page is not painted"
        shortest = min(shortest, page.evaluate(f"{PAINTED}[0].startTime"))
        if shortest < FIRST_PAINT:
            break
    return shortest
