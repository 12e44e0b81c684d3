"""Each lab opens without a complaint; what is moved, answered and printed does what it says."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

pytest.importorskip("marimo", reason='no marimo: python -m pip install -e ".[labs]"')

from tests.browser.complaints import Complaints, fits, holds, keep_picture
from tests.browser.conftest import DESKTOP, PHONE
from tests.browser.labs.opened import (
    DRAWN,
    LABS,
    LAST,
    PATIENCE,
    SLIDERS,
    TALL,
    assert_no_failure,
    lab_address,
    labelled,
    move,
    open_lab,
)
from tests.browser.serving import Servers

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page


@pytest.fixture(scope="module")
def address(servers: Servers, tmp_path_factory: pytest.TempPathFactory) -> Callable[[int], str]:
    """Function of a lab's number that gives its address; a lab is served from its first use on."""

    @cache
    def served(number: int) -> str:
        return lab_address(number, servers, tmp_path_factory.mktemp(f"lab{number}"))

    return served


@pytest.fixture(scope="module")
def lab(chromium: Browser, address: Callable[[int], str]) -> Iterator[Callable[[int], Page]]:
    """Function of a lab's number that gives its page, 1280 px wide. It is opened once, and a test
    goes on where the one before left it.
    """
    heard: list[Complaints] = []
    with ExitStack() as contexts:

        @cache
        def opened(number: int) -> Page:
            context = contexts.enter_context(
                chromium.new_context(
                    viewport={"width": DESKTOP["width"], "height": DESKTOP["height"]}
                )
            )
            page = context.new_page()
            heard.append(Complaints.of(page))
            open_lab(page, address(number), LAST[number])
            return page

        yield opened
    assert [each for one in heard for each in one.found] == [], "the browser complained"


@pytest.mark.parametrize("number", LABS)
def test_it_opens_at_both_widths(number: int, lab: Callable[[int], Page]) -> None:
    page = lab(number)
    assert f"Lab {number}." in page.locator("h1").first.inner_text()
    assert page.locator(".katex, marimo-tex").count() > 0, "no equation"
    assert "$" not in page.locator("body").inner_text(), "an equation that is none"
    # A window made narrower shows what a telephone shows; a second visit would compute all anew.
    for size, width in ((PHONE, "narrow"), (DESKTOP, "wide")):
        page.set_viewport_size({"width": size["width"], "height": TALL})
        assert holds(page, "width => innerWidth === width", size["width"])
        assert page.locator("iframe").count() > 0, "no figure"
        assert fits(page)
        keep_picture(page, f"lab{number}_{width}")


def test_a_slider_moves_a_number_and_the_command_line(lab: Callable[[int], Page]) -> None:
    page = lab(1)
    found = re.search(r"One fall: β = ([\d.]+ ± [\d.]+) lb/ft²", page.locator("body").inner_text())
    assert found is not None
    move(page, "radar noise", "ArrowRight", 2)
    assert holds(page, "before => !document.body.innerText.includes(before)", found[1], PATIENCE)
    page.get_by_text("flight.noise_std.altitude=35 ft").first.wait_for()
    assert_no_failure(page)


def test_an_answer_is_judged(lab: Callable[[int], Page]) -> None:
    page = lab(2)
    field = labelled(page, "answer, flights").locator("input")
    field.fill("2")
    field.press("Tab")
    page.get_by_text("Not yet.").first.wait_for()
    field.fill("4")
    field.press("Tab")
    page.get_by_text("1 of 5 answers are right").wait_for()


def test_linked_surfaces_are_warned_of(lab: Callable[[int], Page]) -> None:
    page = lab(9)
    page.get_by_text("No warning. This does not prove").first.wait_for()
    page.get_by_text("0.9991").first.wait_for()
    labelled(page, "coefficient").locator("select").select_option(label="Cn")
    page.get_by_text("0.9979").first.wait_for()
    labelled(page, "the rudder follows the aileron").locator("[role=checkbox]").click()
    page.get_by_text("aileron and rudder move together").first.wait_for()
    page.get_by_text("0.9921").first.wait_for()
    assert_no_failure(page)


def test_the_command_line_gives_the_same_numbers(
    lab: Callable[[int], Page], capsys: pytest.CaptureFixture[str]
) -> None:
    from scenarios.cli import main

    page = lab(2)
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


@pytest.mark.parametrize("number", SLIDERS)
def test_a_slider_redraws_a_figure(number: int, lab: Callable[[int], Page]) -> None:
    """How long it takes is measured by ``benchmarks/labs.py``."""
    page = lab(number)
    before = page.evaluate(DRAWN)
    move(page, SLIDERS[number], "ArrowRight")
    assert holds(page, f"before => ({DRAWN})() !== before", before, PATIENCE)
    assert_no_failure(page)


def test_a_copy_of_ones_own_runs_too(servers: Servers, page: Page, tmp_path: Path) -> None:
    import sys

    from scenarios.cli.libraries import copy_lab
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
