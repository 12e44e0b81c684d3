"""Figures that zoom in a browser: values under the pointer, one time axis for all panels, curves
and panels that can be switched off, both colour schemes, telephone, paper, and no scripts at all.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from scenarios.plots.drawing import draw_for_page
from scenarios.plots.style import make_sheet
from scenarios.report.document import Page as Document
from scenarios.report.document import Reproduction, section
from scenarios.report.folder import figures, write_page
from tests.browser.complaints import FIRST_PAINT, Complaints, first_paint, fits, holds, keep_picture

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page


@pytest.fixture(scope="module")
def plots(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with two figures: two and three panels over time."""
    from tests.unit.scenarios.plots.test_drawing import noisy
    from tests.unit.scenarios.plots.test_interactive import history

    folder = tmp_path_factory.mktemp("plots")
    named = [("fit", history), ("fit_2", lambda: noisy(2000, 1)[0])]
    drawn = draw_for_page(named, folder, ())
    document = Document(
        *("Figures", "Study of figures", "converged", "good", "", (), ()),
        section("Figures", *figures(drawn)),
        Reproduction(("flightid run rigid",)),
    )
    write_page(folder, document)
    return folder / "report.html"


def opened(page: Page, plots: Path) -> Locator:
    page.goto(plots.as_uri())
    figure = page.locator("#figure-fit")
    figure.locator("canvas").first.wait_for()
    return figure


def drag(page: Page, panel: Locator, start: float, stop: float) -> None:
    box = panel.locator(".u-over").bounding_box()
    assert box is not None
    height = box["y"] + 0.5 * box["height"]
    page.mouse.move(box["x"] + start * box["width"], height)
    page.mouse.down()
    page.mouse.move(box["x"] + stop * box["width"], height, steps=4)
    page.mouse.up()


def test_a_drag_zooms_all_panels_and_a_double_click_shows_all(page: Page, plots: Path) -> None:
    figure = opened(page, plots)
    panels = figure.locator(".panel")
    assert panels.count() == 2 and figure.locator(".drawing").is_hidden()
    before = [panel.screenshot() for panel in panels.all()]
    drag(page, panels.nth(0), 0.25, 0.5)
    assert figure.get_attribute("data-zoomed") == "true"
    low, high = _range(page)
    assert 1.0 < low < 2.5 and 3.5 < high < 4.5
    page.mouse.move(0, 0)
    zoomed = [panel.screenshot() for panel in panels.all()]
    assert zoomed[0] != before[0] and zoomed[1] != before[1]
    panels.nth(1).locator(".u-over").dblclick()
    assert figure.get_attribute("data-zoomed") == "false"


def _range(page: Page) -> tuple[float, float]:
    words = page.locator("#told").inner_text().split()
    assert (words[0], words[2]) == ("from", "to")
    return float(words[1].replace("−", "-")), float(words[3])


def test_keys_zoom_and_move(page: Page, plots: Path) -> None:
    figure = opened(page, plots)
    figure.get_by_role("button", name="Zoom in").focus()
    page.keyboard.press("Enter")
    first = _range(page)
    figure.get_by_role("button", name="Move right").focus()
    page.keyboard.press("Enter")
    second = _range(page)
    assert second[0] > first[0] and second[1] - second[0] == pytest.approx(
        first[1] - first[0], 1e-3
    )
    figure.get_by_role("button", name="Show all").click()
    assert page.locator("#told").inner_text() == "all is shown"


def test_the_pointer_shows_values_in_every_panel(page: Page, plots: Path) -> None:
    from math import sin

    figure = opened(page, plots)
    box = figure.locator(".u-over").first.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 20)
    told = figure.locator(".values").first.inner_text()
    found = dict(part.rsplit(" ", 1) for part in told.split(" · "))
    numbers = {name.strip(): float(value.replace("−", "-")) for name, value in found.items()}
    assert numbers["estimated"] == pytest.approx(sin(numbers["time"]), abs=1e-4)
    assert numbers["measured"] == pytest.approx(sin(numbers["time"]) + 0.01, abs=1e-4)
    assert figure.locator(".values").nth(1).inner_text().startswith("time")


def test_curves_and_panels_are_switched(page: Page, plots: Path) -> None:
    figure = opened(page, plots)
    panel = figure.locator(".panel").first
    before = panel.screenshot()
    key = figure.get_by_role("button", name="Curve: measured")
    key.click()
    assert key.get_attribute("aria-pressed") == "false"
    page.mouse.move(0, 0)
    assert panel.screenshot() != before
    other = page.locator("#figure-fit_2")
    other.scroll_into_view_if_needed()
    other.locator("canvas").first.wait_for()
    other.locator("summary").click()
    other.locator(".channels input").first.uncheck()
    assert other.locator(".panel").first.is_hidden()


@pytest.fixture(scope="module")
def over_frequency(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with a figure over frequencies that begin just below a power of ten."""
    from scenarios.plots.style import finish, make_sheet

    sheet = make_sheet([1.5])
    frequency = np.geomspace(0.0997369636415, 4.7222, 60)
    sheet.panels[0].plot(frequency, np.log(frequency))
    sheet.panels[0].plot([1.0, 1.0], [0.0, 1.0], label="upright")
    sheet.panels[0].set_xscale("log")
    sheet.panels[0].set_xlim(frequency[0], frequency[-1])
    sheet.panels[0].set_xlabel("frequency (Hz)")
    figure = finish(sheet, "a response")
    folder = tmp_path_factory.mktemp("frequency")
    drawn = draw_for_page([("response", lambda: figure)], folder, ())
    document = Document(
        *("Figures", "Study of figures", "converged", "good", "", (), ()),
        section("Figures", *figures(drawn)),
        Reproduction(("flightid run rigid",)),
    )
    write_page(folder, document)
    return folder / "report.html"


def test_a_logarithmic_axis_begins_anywhere(page: Page, over_frequency: Path) -> None:
    found: list[str] = []
    page.on("pageerror", lambda error: found.append(str(error)))
    page.goto(over_frequency.as_uri())
    panel = page.locator("#figure-response .panel")
    panel.locator("canvas").wait_for()
    assert found == []
    before = panel.screenshot()
    page.get_by_role("button", name="Curve: upright").click()
    page.mouse.move(0, 0)
    assert panel.screenshot() != before


DRAWN_TEXTS = """window.drawn = [];
const write = CanvasRenderingContext2D.prototype.fillText;
CanvasRenderingContext2D.prototype.fillText = function (text, ...place) {
  window.drawn.push(text);
  return write.call(this, text, ...place);
};"""


def test_ticks_of_small_values_keep_their_digits(page: Page, tmp_path: Path) -> None:
    sheet = make_sheet([1.0])
    time = np.linspace(0.0, 8.0, 81)
    sheet.panels[0].plot(time, 0.00045 * np.sin(time), label="small")
    drawn = draw_for_page([("small", lambda: sheet.figure)], tmp_path, ())
    document = Document(
        *("Figures", "Study of figures", "converged", "good", "", (), ()),
        section("Figures", *figures(drawn)),
        Reproduction(("flightid run rigid",)),
    )
    write_page(tmp_path, document)
    page.add_init_script(DRAWN_TEXTS)
    page.goto((tmp_path / "report.html").as_uri())
    page.locator("#figure-small canvas").wait_for()
    ticks = [
        float(text) for text in page.evaluate("window.drawn") if text and text[0] in "-0123456789"
    ]
    small = {abs(tick) for tick in ticks if 0.0 < abs(tick) < 0.01}
    # uPlot by itself writes three decimals, so that all of these would read 0.
    assert small and max(small) < 0.001


@pytest.fixture(scope="module")
def frame(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page of a notebook: a figure with an upright line in the frame that a notebook shows."""
    from flightid.labs.figures import figure_input_spectrum
    from scenarios.api.plot import interactive

    time = np.linspace(0.0, 12.0, 601)
    values = np.where((time > 1.0) & (time < 2.5), 0.1, 0.0)
    shown = interactive(figure_input_spectrum(time, values, 2.0, "short period"), "a pulse")
    path = tmp_path_factory.mktemp("frame") / "notebook.html"
    path.write_text(f"<!DOCTYPE html><title>x</title>{shown._repr_html_()}", encoding="utf-8")
    return path


def test_a_figure_of_a_notebook_zooms_in_its_frame(page: Page, frame: Path) -> None:
    page.goto(frame.as_uri())
    within = page.frame_locator("iframe")
    within.locator("canvas").first.wait_for()
    assert within.locator("canvas").count() == 2
    # The frame is as high as the figure: nothing is cut off, and nothing has to be scrolled.
    assert holds(
        page,
        "() => { const f = document.querySelector('iframe'), body = f.contentDocument.body;"
        " return Math.abs(f.clientHeight - body.scrollHeight) <= 1; }",
    )
    within.get_by_role("button", name="Zoom in").click()
    assert within.locator("figure").get_attribute("data-zoomed") == "true"


def test_an_upright_line_is_drawn(page: Page, frame: Path) -> None:
    page.goto(frame.as_uri())
    within = page.frame_locator("iframe")
    panel = within.locator(".panel").nth(1)
    panel.locator("canvas").wait_for()
    before = panel.screenshot()
    within.get_by_role("button", name="Curve: short period").click()
    page.mouse.move(0, 0)
    assert panel.screenshot() != before


def test_a_window_made_narrow_has_its_panels_below_each_other(page: Page, frame: Path) -> None:
    page.goto(frame.as_uri())
    panels = page.frame_locator("iframe").locator(".panel")
    panels.nth(1).locator("canvas").wait_for()

    def places() -> list[float]:
        return [box["x"] for each in panels.all() if (box := each.bounding_box())]

    assert places()[0] < places()[1]
    page.set_viewport_size({"width": 390, "height": 900})
    assert holds(
        page,
        "() => { const [a, b] = document.querySelector('iframe').contentDocument"
        ".querySelectorAll('.panel'); return a.offsetLeft === b.offsetLeft; }",
    )
    assert places()[0] == places()[1] and panels.locator("canvas").count() == 2


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [390, 1280])
def test_plots_fit_and_are_quiet(chromium: Browser, plots: Path, width: int, dark: bool) -> None:
    context = chromium.new_context(
        viewport={"width": width, "height": 900}, color_scheme="dark" if dark else "light"
    )
    page = context.new_page()
    complaints = Complaints.of(page)
    opened(page, plots)
    assert fits(page)
    page.get_by_role("button", name="colours").click()
    assert page.locator("#figure-fit canvas").count() == 2
    keep_picture(page, f"plots-{width}{'-dark' if dark else ''}")
    context.close()
    assert complaints.found == []


def test_paper_and_pages_without_scripts_have_the_drawing(chromium: Browser, plots: Path) -> None:
    context = chromium.new_context()
    page = context.new_page()
    figure = opened(page, plots)
    page.emulate_media(media="print")
    assert figure.locator(".drawing").is_visible() and figure.locator(".plot").is_hidden()
    context.close()
    context = chromium.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(plots.as_uri())
    assert page.locator("#figure-fit .drawing").is_visible()
    assert page.locator("#figure-fit canvas").count() == 0
    context.close()


def test_first_paint_comes_within_a_second(page: Page, plots: Path) -> None:
    assert first_paint(page, plots.as_uri()) < FIRST_PAINT
    assert plots.stat().st_size < 3_000_000
