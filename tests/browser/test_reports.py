"""Reports in a browser: quiet, closed to the outside, readable at every width and on paper; tables
sort and copy.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from openpyxl import load_workbook

from scenarios.report.document import Column, Number, Section, Table
from scenarios.report.folder import write_page
from tests.browser.complaints import Complaints, fits, holds, keep_picture
from tests.browser.every_page import typed
from tests.browser.paper import words_of
from tests.pages import HOSTILE, PAGE

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

WIDTHS = (390, 1280, 1920)


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A page with everything in it, and those of a study, of a diagnosis and of a comparison by the
    command line.
    """
    folder = tmp_path_factory.mktemp("reports")
    (folder / "everything").mkdir()
    write_page(folder / "everything", PAGE)
    typed(folder, "run", "rigid", "rigid-process-noise-a", "--compare", "--out", "beside")
    typed(folder, "run", "trace-delay", "--out", "diagnosis")
    named = {
        "everything": "everything",
        "study": "beside/rigid",
        "compared": "beside",
        "diagnosis": "diagnosis",
    }
    return {name: folder / where / "report.html" for name, where in named.items()}


def test_numbers_on_dark_cells_are_white(page: Page, pages: dict[str, Path]) -> None:
    page.goto(pages["study"].as_uri())
    colours = page.evaluate(
        """() => [...document.querySelectorAll('svg.mapped text[fill="#ffffff"]')].map(
            (text) => getComputedStyle(text).fill)"""
    )
    assert colours and set(colours) == {"rgb(255, 255, 255)"}


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("name", ["everything", "study", "compared", "diagnosis"])
def test_page_is_quiet_and_no_wider_than_its_window(
    chromium: Browser, pages: dict[str, Path], name: str, dark: bool
) -> None:
    for width in WIDTHS:
        context = chromium.new_context(
            viewport={"width": width, "height": 900}, color_scheme="dark" if dark else "light"
        )
        page = context.new_page()
        complaints = Complaints.of(page)
        page.goto(pages[name].as_uri())
        assert fits(page), f"{name} at {width} px"
        assert page.evaluate(
            # A drawing that stands behind a figure that zooms has no width.
            "Array.from(document.querySelectorAll('svg.full'))"
            ".map(e => e.getBoundingClientRect().width).every(w => w === 0 || w >= 570)"
        )
        ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert (sum(map(int, re.findall(r"\d+", ground)[:3])) < 200) == dark
        keep_picture(page, f"report-{name}-{width}{'-dark' if dark else ''}")
        context.close()
        assert complaints.found == []


def column(page: Page, table: int, at: int) -> list[str]:
    return (
        page.locator("table")
        .nth(table)
        .locator(f"tbody tr td:nth-child({at + 1})")
        .all_inner_texts()
    )


def test_tables_sort_numbers_by_value_whatever_is_written(
    page: Page, pages: dict[str, Path]
) -> None:
    page.goto(pages["everything"].as_uri())
    before = column(page, 0, 0)
    head = page.locator("table").nth(0).locator("th").nth(3)
    head.locator("button").focus()
    page.keyboard.press("Enter")
    assert (
        column(page, 0, 0) == ["CL_q", "Cm_alpha", "CL_alpha", "delay"]
        and head.get_attribute("aria-sort") == "ascending"
    )
    page.keyboard.press("Enter")
    # What is not determined stays behind, whichever way it is sorted.
    assert (
        column(page, 0, 0) == ["CL_alpha", "Cm_alpha", "CL_q", "delay"]
        and head.get_attribute("aria-sort") == "descending"
    )
    page.keyboard.press("Enter")
    assert column(page, 0, 0) == before and head.get_attribute("aria-sort") == "none"
    page.locator("table").nth(1).locator("th button").nth(0).click()
    assert column(page, 1, 0)[:3] == ["candidate-0", "candidate-1", "candidate-2"], (
        "numbers in words are numbers"
    )
    assert "sorted by candidate" in page.locator("#told").inner_text()


def test_tables_are_copied_with_full_numbers_and_a_column_of_sigmas(
    chromium: Browser, pages: dict[str, Path]
) -> None:
    context = chromium.new_context()
    context.grant_permissions(["clipboard-read", "clipboard-write"])
    page = context.new_page()
    complaints = Complaints.of(page)
    page.goto(pages["everything"].as_uri())
    page.locator("button.copy").nth(0).click()
    page.locator("button.copy", has_text="Copied").wait_for()
    lines = [
        line.split("\t")
        for line in page.evaluate("() => navigator.clipboard.readText()").splitlines()
    ]
    assert lines[0] == [
        "parameter",
        "unit",
        "true",
        "estimate ± σ",
        "sigma of estimate ± σ",
        "error (%)",
    ]
    assert lines[1] == ["Cm_alpha", "1/rad", "-1.66", "-1.657", "0.0018", "0.18"]
    assert lines[4] == ["delay", "s", "–", "not determined", "", "–"]
    choice = page.locator("select.formats").nth(0)
    choice.select_option("markdown")
    assert holds(page, "async () => (await navigator.clipboard.readText()).startsWith('|')")
    copied = page.evaluate("() => navigator.clipboard.readText()").splitlines()
    assert copied[0] == "| parameter | unit | true | estimate ± σ | error (%) |"
    assert copied[2] == "| Cm_alpha | 1/rad | −1.66 | −1.6570 ± 0.0018 | 0.18 |"
    choice.select_option("latex")
    assert holds(page, "async () => (await navigator.clipboard.readText()).startsWith('\\\\')")
    copied = page.evaluate("() => navigator.clipboard.readText()").splitlines()
    assert copied[0] == r"\begin{tabular}{llrrr}" and copied[-1] == r"\end{tabular}"
    assert copied[4] == r"Cm\_alpha & 1/rad & $-$1.66 & $-$1.6570 $\pm$ 0.0018 & 0.18 \\"
    with page.expect_download() as download:
        choice.select_option("xlsx")
    book = load_workbook(io.BytesIO(download.value.path().read_bytes()))
    assert [[cell.value for cell in row] for row in book.active.iter_rows(max_row=2)] == [
        lines[0],
        ["Cm_alpha", "1/rad", -1.66, -1.657, 0.0018, 0.18],
    ]
    context.close()
    assert complaints.found == []


def test_choice_of_colours_is_kept(
    page: Page, pages: dict[str, Path], serve_folder: Callable[[Path], str]
) -> None:
    address = f"{serve_folder(pages['everything'].parent)}/report.html"
    page.goto(address)
    page.get_by_role("button", name="Dark colours").click()
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"
    page.reload()
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"
    page.get_by_role("button", name="Light colours").click()
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"


def test_text_of_users_neither_runs_nor_shows_as_markup(page: Page, pages: dict[str, Path]) -> None:
    page.on(
        "dialog", lambda dialog: pytest.fail(f"a script of the page's text ran: {dialog.message}")
    )
    page.goto(pages["everything"].as_uri())
    assert page.locator("h1").inner_text() == f"rigid {HOSTILE}"
    assert page.locator("script").count() == 1


@pytest.mark.parametrize("name", ["everything", "study", "compared", "diagnosis"])
def test_paper_has_no_empty_page_and_ten_candidates(
    page: Page, pages: dict[str, Path], tmp_path: Path, name: str
) -> None:
    from shutil import which

    page.goto(pages[name].as_uri())
    page.emulate_media(media="print")
    for table in page.locator(".top10").all():
        assert sum(row.is_visible() for row in table.locator("tbody tr").all()) == 10
        assert table.locator(".more").is_visible()
    assert (
        not page.locator("nav").is_visible()
        and page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    )
    page.pdf(path=str(tmp_path / "page.pdf"), format="A4", print_background=True)
    if which("pdftotext") is None:
        pytest.skip(
            "no pdftotext (Debian: apt-get install poppler-utils): pages of the PDF are not counted"
        )
    words = words_of(tmp_path / "page.pdf")
    assert min(words) > 5, words


def test_cells_of_words_stay_wide_on_a_phone(phone: Page, tmp_path: Path) -> None:
    columns = (*(Column(f"number {i}", "1") for i in range(6)), Column("t values"))
    row: tuple[Number | str, ...] = (*[Number(123.456)] * 6, "Cm_alpha 17, Cm_q 2.9, Cm_de 16")
    block = Section("Maneuvers", (Table("Maneuvers", columns, (row,)),))
    write_page(tmp_path, replace(PAGE, sections=(block,)))
    phone.goto((tmp_path / "report.html").as_uri())
    size = float(phone.evaluate("parseFloat(getComputedStyle(document.documentElement).fontSize)"))
    box = phone.locator("td.words").bounding_box()
    assert box is not None and box["width"] >= 13 * size - 1


@pytest.mark.parametrize("caption", ["", "a caption", "a caption of many words " * 8])
@pytest.mark.parametrize("width", [390, 1280])
def test_buttons_of_a_table_cover_no_text(
    page: Page, tmp_path: Path, width: int, caption: str
) -> None:
    columns = (Column("each of the records by itself"), Column("one more, by the smoother"))
    table = Table(caption, columns, (("a", "b"),))
    write_page(tmp_path, replace(PAGE, sections=(Section("tables", (table,)),)))
    page.set_viewport_size({"width": width, "height": 900})
    page.goto((tmp_path / "report.html").as_uri())
    covered = page.evaluate(
        """() => {
            const box = document.querySelector('.table');
            const boxes = [...box.querySelectorAll('button.copy, select.formats')].map(
                (each) => each.getBoundingClientRect());
            const texts = [...box.querySelectorAll('caption, th')].flatMap((each) => {
                const range = document.createRange();
                range.selectNodeContents(each);
                return [...range.getClientRects()];
            });
            return boxes.some((a) => texts.some((b) => a.left < b.right && b.left < a.right
                && a.top < b.bottom && b.top < a.bottom));
        }"""
    )
    assert not covered


def test_rebuilt_page_is_the_same(pages: dict[str, Path]) -> None:
    for name in ("study", "diagnosis", "compared"):
        before = pages[name].read_bytes()
        assert (
            json.loads((pages[name].parent / "report.json").read_bytes())["schema"]
            == "flightid/report/1"
        )
        typed(pages[name].parent, "report", ".")
        assert pages[name].read_bytes() == before
