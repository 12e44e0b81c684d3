"""Each lab opens without a complaint; what is moved, answered and printed does what it says."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

pytest.importorskip("marimo", reason='no marimo: python -m pip install -e ".[labs]"')

from tests.browser.complaints import fits, keep_picture
from tests.browser.conftest import DESKTOP, PHONE
from tests.browser.labs.opened import (
    LABS,
    PATIENCE,
    TALL,
    assert_no_failure,
    lab_address,
    labelled,
    move,
    open_lab,
)
from tests.browser.serving import Servers

if TYPE_CHECKING:
    from playwright.sync_api import Page

# A text of each lab's last part.
LAST: Mapping[int, str] = {
    **dict.fromkeys((1, 2, 3, 4, 6, 8, 9), "To think about"),
    5: "Play five seeds",
    7: "What does the model lack?",
}


@pytest.fixture(scope="module")
def address(servers: Servers, tmp_path_factory: pytest.TempPathFactory) -> Callable[[int], str]:
    """Function of a lab's number that gives its address; a lab is served from its first use on."""

    @cache
    def served(number: int) -> str:
        return lab_address(number, servers, tmp_path_factory.mktemp(f"lab{number}"))

    return served


@pytest.mark.parametrize("number", LABS)
def test_it_opens_at_both_widths(number: int, address: Callable[[int], str], page: Page) -> None:
    open_lab(page, address(number), LAST[number])
    assert f"Lab {number}." in page.locator("h1").first.inner_text()
    assert page.locator(".katex, marimo-tex").count() > 0, "no equation"
    assert "$" not in page.locator("body").inner_text(), "an equation that is none"
    # A window made narrower shows what a telephone shows; a second visit would compute all anew.
    for size, width in ((DESKTOP, "wide"), (PHONE, "narrow")):
        page.set_viewport_size({"width": size["width"], "height": TALL})
        page.wait_for_function("width => innerWidth === width", arg=size["width"])
        assert page.locator("iframe").count() > 0, "no figure"
        assert fits(page)
        keep_picture(page, f"lab{number}_{width}")


def test_a_slider_moves_a_number_and_the_command_line(
    address: Callable[[int], str], page: Page
) -> None:
    open_lab(page, address(1), LAST[1])
    found = re.search(r"One fall: β = ([\d.]+ ± [\d.]+) lb/ft²", page.locator("body").inner_text())
    assert found is not None
    move(page, "radar noise", "ArrowRight", 2)
    page.wait_for_function(
        "before => !document.body.innerText.includes(before)", arg=found[1], timeout=PATIENCE
    )
    page.get_by_text("flight.noise_std.altitude=35 ft").first.wait_for()
    assert_no_failure(page)


def test_an_answer_is_judged(address: Callable[[int], str], page: Page) -> None:
    open_lab(page, address(2), LAST[2])
    field = labelled(page, "answer, flights").locator("input")
    field.fill("2")
    field.press("Tab")
    page.get_by_text("Not yet.").first.wait_for()
    field.fill("4")
    field.press("Tab")
    page.get_by_text("1 of 5 answers hold").wait_for()


def test_linked_surfaces_are_warned_of_and_the_check_falls(
    address: Callable[[int], str], page: Page
) -> None:
    open_lab(page, address(9), LAST[9])
    page.get_by_text("Nothing is found lacking.").first.wait_for()
    page.get_by_text("0.9992").first.wait_for()
    labelled(page, "coefficient").locator("select").select_option(label="Cn")
    page.get_by_text("0.9978").first.wait_for()
    labelled(page, "the rudder follows the aileron").locator("[role=checkbox]").click()
    page.get_by_text("aileron and rudder move together").first.wait_for()
    page.get_by_text("0.7153").first.wait_for()
    assert_no_failure(page)


def test_the_command_line_gives_the_same_numbers(
    address: Callable[[int], str], page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    from scenarios.cli import main

    open_lab(page, address(2), LAST[2])
    text = page.locator("body").inner_text()
    shown = re.search(r"Natural frequency ([\d.]+) ± ([\d.]+) rad/s", text)
    assert shown is not None
    line = page.locator("pre, code").filter(has_text="flightid run rigid").first.inner_text()
    with pytest.raises(SystemExit) as ended:
        main(shlex.split(line.replace("\\\n", " "))[1:])
    assert ended.value.code == 0
    printed = re.search(r"natural frequency ([\d.]+) \+- ([\d.]+) rad/s", capsys.readouterr().out)
    assert printed is not None
    assert float(printed[1]) == pytest.approx(float(shown[1]), abs=1e-4)


def test_a_copy_of_ones_own_runs_too(servers: Servers, page: Page, tmp_path: Path) -> None:
    import sys

    from scenarios.commands.libraries import copy_lab
    from tests.browser.serving import free_port

    own, port = copy_lab(1, tmp_path / "mine"), free_port()
    command = [
        sys.executable,
        "-m",
        "marimo",
        "run",
        str(own),
        "--host",
        "127.0.0.1",
        "--port",
        str(port),
        "--headless",
    ]
    open_lab(page, servers.process(command, port, tmp_path), LAST[1])
