"""Lab 5 walked as its page says: a guess, the loop's evidence, the truth; and nothing of the truth
before.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

pytest.importorskip("marimo", reason='no marimo: python -m pip install -e ".[labs]"')

from tests.browser.complaints import holds, keep_picture
from tests.browser.labs.opened import assert_no_failure, lab_address, open_lab
from tests.browser.serving import Servers

if TYPE_CHECKING:
    from playwright.sync_api import Page


def test_from_the_guess_to_the_truth(page: Page, servers: Servers, tmp_path: Path) -> None:
    from flightid.labs.workings.hidden_effect import FIRST_SEED, SUSPECTS, drawn

    words, values = drawn(FIRST_SEED)
    heard: list[str] = []
    page.on(
        "websocket",
        lambda socket: socket.on("framereceived", lambda frame: heard.append(str(frame))),
    )
    open_lab(page, lab_address(5, servers, tmp_path), "Play five seeds")
    show = page.get_by_role("button", name="Show what the loop finds")
    assert show.is_disabled()
    assert page.get_by_text("What the loop says").count() == 0
    # Neither what is shown nor what the page was sent tells the values, or names one of the
    # suspects more often than the others.
    sent = "".join(heard) + page.content()
    assert not any(f"{value:.4g}" in sent for value in values.values())
    assert (
        len(
            {
                sent.count(each) + sent.count(json.dumps(each)[1:-1]) * (not each.isascii())
                for each in SUSPECTS
            }
        )
        == 1
    )

    page.locator("marimo-radio").get_by_text(words, exact=True).click()
    assert holds(
        page,
        "() => ![...document.querySelectorAll('marimo-button')].some(b => "
        "b.shadowRoot?.querySelector('button[disabled]'))",
    )
    show.click()
    page.get_by_role("heading", name="What the loop says").wait_for()
    page.get_by_role("button", name="Show the truth").wait_for()
    page.get_by_text("TRACED").first.wait_for()
    assert page.get_by_text("The hidden effect:").count() == 0
    keep_picture(page, "lab5_loop")

    page.get_by_role("button", name="Show the truth").click()
    page.get_by_text("The hidden effect:").first.wait_for()
    page.get_by_text("Your guess was right").first.wait_for()
    page.get_by_text("Brier score of your guesses").first.wait_for()
    assert_no_failure(page)
    keep_picture(page, "lab5_truth")
