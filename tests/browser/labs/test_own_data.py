"""Lab 7 with files from a user's disk: read, refused in one line, identified, diagnosed, and a
report to take home.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

pytest.importorskip("marimo", reason='no marimo: python -m pip install -e ".[labs]"')

from tests.browser.complaints import keep_picture
from tests.browser.labs.opened import assert_no_failure, lab_address, open_lab
from tests.browser.serving import Servers

if TYPE_CHECKING:
    from playwright.sync_api import Page


def test_from_an_uploaded_file_to_the_report(page: Page, servers: Servers, tmp_path: Path) -> None:
    from flightid.labs.workings.own_data import MAP, example

    files = tmp_path / "files"
    files.mkdir()
    for name, content in example():
        (files / name).write_bytes(content)
    open_lab(page, lab_address(7, servers, tmp_path / "server"), "What does the model lack?")
    page.get_by_text("my own files", exact=True).click()
    page.get_by_text("No file yet").first.wait_for()
    page.locator("input[type=file]").first.set_input_files(
        [str(path) for path in sorted(files.iterdir())]
    )
    # Without a map the headers are strange; the one line of the refusal stands in the place of the
    # table.
    page.get_by_text("there is no column 'time'").first.wait_for()
    text = page.get_by_label("channel map (TOML)").or_(page.locator("textarea").last)
    text.last.fill(MAP)
    text.last.press("Tab")
    page.get_by_role("heading", name="What was read").wait_for()
    page.get_by_text("the vane is 9.1").first.wait_for()
    page.get_by_text("Outcome: converged").first.wait_for()
    page.get_by_role("button", name="What does the model lack?").click()
    page.get_by_text("TRACED").first.wait_for()
    keep_picture(page, "lab7_diagnosed")
    with page.expect_download() as download:
        page.get_by_text("Download the report").click()
    report = download.value.path().read_text(encoding="utf-8")
    assert "vane-offset" in report and "<html" in report
    assert_no_failure(page)


def test_the_log_of_a_flight_computer_is_read(page: Page, servers: Servers, tmp_path: Path) -> None:
    open_lab(page, lab_address(7, servers, tmp_path / "server"), "What does the model lack?")
    page.get_by_text("a log of ArduPilot", exact=True).click()
    page.get_by_text("00000041.BIN", exact=True).first.wait_for()
    page.get_by_text("do not use these sigmas").first.wait_for()
    keep_picture(page, "lab7_log")
    assert_no_failure(page)
