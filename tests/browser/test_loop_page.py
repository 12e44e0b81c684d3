"""The page of the margins of a loop in a real browser, from the first row to the end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import chirp

from sim.closed_loop.airframe import load_x29
from sim.closed_loop.linear import loop_test
from tests.browser.complaints import fits, holds, keep_picture
from tests.browser.serving import PATIENCE, ROOT

if TYPE_CHECKING:
    from playwright.sync_api import Page

SHOWN = {"phase_margin": "phase margin", "gain_increase": "gain increase"}


def write_loop(folder: Path) -> Path:
    """A sweep of 60 s of the X-29-like loop."""
    x29 = load_x29("F")
    moments = x29.frame * np.arange(int(60.0 / x29.frame))
    sweep = 0.5 * chirp(moments, 0.2, 60.0, 10.0, method="logarithmic")
    rows = loop_test(x29, sweep, np.random.default_rng(1))
    path = folder / "loop.csv"
    table = np.column_stack([moments, rows[1], rows[0], rows[2]])
    np.savetxt(path, table, "%.9g", ",", header="time,command,sweep,returned", comments="")
    return path


def test_margins_are_shown_with_what_is_required(page: Page, tmp_path: Path) -> None:
    words = ["watch", str(write_loop(tmp_path)), "--until-end", "--page", "--margins", "minus"]
    words += ["--input", "command", "--output", "returned", "--excitation", "sweep"]
    process = subprocess.Popen(
        [sys.executable, "-m", "scenarios", *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"},
    )
    try:
        assert process.stderr is not None
        page.goto(process.stderr.readline().decode().split()[-1])
        ends = time.monotonic() + PATIENCE
        while page.locator("#state").inner_text() != "ended":
            assert time.monotonic() < ends
            page.wait_for_timeout(200)
        assert page.locator("#h-strips").inner_text() == "Measured"
        assert page.locator("#h-estimates").inner_text() == "Stability margins"
        assert not page.locator("#ahead").is_visible() and not page.locator("#against").is_visible()
        assert "MIL-F-9490D" in page.locator("#demand").inner_text()
        charts = page.locator("#estimates figure")
        names = {charts.nth(at).get_attribute("data-name"): at for at in range(charts.count())}
        for name, word in SHOWN.items():
            told = charts.nth(names[name]).locator("figcaption").inner_text()
            assert word in told and " to " in told and "no longer" not in told
        for width in (390, 1280):
            page.set_viewport_size({"width": width, "height": 900})
            page.wait_for_timeout(300)
            assert fits(page)
            keep_picture(page, f"loop-{width}")
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
        assert holds(page, "document.getElementById('connection').innerText.includes('ended')")
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
        if process.stderr is not None:
            process.stderr.close()
