"""The page of a watch in a real browser: a stream at 40 Hz, a line that is cut in its middle, and
nothing lost.
"""

from __future__ import annotations

import signal
import time
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.browser.complaints import Complaints, fits, keep_picture
from tests.browser.streaming import RATE, Line, Watched

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

HELD = """() => {
  const held = window.held();
  return { ...held, now: Date.now() / 1000, heap: performance.memory ? performance.memory.usedJSHeapSize : 0 };
}"""  # noqa: E501
MOST_ROWS = 7200  # that a page holds: 6000 and what comes before it clears away
# s that a row may need to the page; the bank is linearised anew for two, and this machine may be
# busy
LATE = 5.0


@dataclass
class Seen:
    """What a look at the page every second gave: delays of the last row (s), the page's memory and
    the watch's (MB), rows that were missing.
    """

    late: list[float] = field(default_factory=list)
    heap: list[float] = field(default_factory=list)
    resident: list[float] = field(default_factory=list)
    missing: int = 0
    busy: float = 0.0

    def look(self, page: Page, watched: Watched) -> dict[str, Any]:
        held = page.evaluate(HELD)
        if held["rows"]:
            self.late.append(held["now"] - watched.begun - held["last"])
            self.missing += gaps(held["times"])
        self.heap.append(held["heap"] / 1e6)
        self.resident.append(watched.memory())
        self.busy = watched.busy()
        return dict(held)


def gaps(times: list[float]) -> int:
    """Rows that are missing between the first and the last."""
    at = np.round(np.array(times) * RATE).astype(int)
    return int(at[-1] - at[0] + 1 - at.size) if np.all(np.diff(at) > 0) else at.size


def connection(page: Page, word: str) -> None:
    """Wait until the page says so of its connection."""
    ends = time.monotonic() + 20.0
    while word not in page.locator("#connection").inner_text():
        assert time.monotonic() < ends, page.locator("#connection").inner_text()
        page.wait_for_timeout(100)


def follow(chromium: Browser, folder: Path, seconds: float, cut_at: float, cut_for: float) -> Seen:
    """Watch a stream to its end, the line to the page cut for a while, then end the watch."""
    context = chromium.new_context(viewport={"width": 1280, "height": 900})
    page, seen = context.new_page(), Seen()
    complaints = Complaints.of(page)
    with closing(context), Watched(folder, seconds) as watched, closing(Line(watched.port)) as line:
        page.goto(line.address)
        cut = restored = False
        while (passed := time.time() - watched.begun) < seconds + 60.0:
            if passed > cut_at and not cut:
                line.cut()
                cut = True
                connection(page, "lost")
            if passed > cut_at + cut_for and not restored:
                line.restore()
                restored = True
                connection(page, "connected")
            elif not cut or restored:
                seen.look(page, watched)
                if page.locator("#state").inner_text() == "ended":
                    break
            page.wait_for_timeout(1000)
        assert page.locator("#sentence").inner_text() in (
            "the stream ended; refined over all rows",
            "the stream ended; refined on line, delay between the grid points",
        )
        held = seen.look(page, watched)
        assert (
            page.locator("#rows").inner_text().replace(",", "") == str(watched.rows)
            and round(held["last"] * RATE) == watched.rows - 1
        )
        assert (
            held["rows"] == min(watched.rows, held["rows"])
            and held["rows"] >= min(watched.rows, 6000)
            and held["rows"] <= MOST_ROWS
        )
        for width in (390, 1280, 1920):
            page.set_viewport_size({"width": width, "height": 900})
            page.wait_for_timeout(300)
            assert fits(page)
            keep_picture(page, f"watch-{width}")
        page.emulate_media(color_scheme="dark")
        page.wait_for_timeout(300)
        keep_picture(page, "watch-dark")
        asked = time.monotonic()
        watched.process.send_signal(signal.SIGINT)
        assert watched.process.wait(10) == 0 and time.monotonic() - asked < 2.0
        connection(page, "has ended")
    # The cut itself is told; nothing else may be.
    assert [each for each in complaints.found if "/events" not in each] == []
    assert (folder / "out" / "comparison.json").is_file() and "written to" in (
        folder / "printed.txt"
    ).read_text()
    return seen


def test_a_stream_is_followed_and_comes_back(chromium: Browser, tmp_path: Path) -> None:
    seen = follow(chromium, tmp_path, 20.0, cut_at=8.0, cut_for=2.0)
    assert seen.missing == 0


@pytest.mark.slow
def test_five_minutes(chromium: Browser, tmp_path: Path) -> None:
    seen = follow(chromium, tmp_path, 300.0, cut_at=140.0, cut_for=5.0)
    print(
        "late",
        *(f"{share}: {np.quantile(seen.late, share):.2f}" for share in (0.5, 0.9, 0.99, 1.0)),
        "s at look",
        int(np.argmax(seen.late)),
    )
    print(
        f"{100.0 * seen.busy / 300.0:.0f} % of one core; page {seen.heap[len(seen.heap) // 2]:.1f} "
        f"then {seen.heap[-1]:.1f} MB"
    )
    print(
        f"watch {seen.resident[10]:.0f}, {seen.resident[len(seen.resident) // 2]:.0f}, then "
        f"{seen.resident[-1]:.0f} MB; missing {seen.missing}"
    )
    assert seen.missing == 0 and np.median(seen.late[:-10]) < LATE
    # Rings are full after two and a half minutes: what grows after that is the record itself, a row
    # 40 bytes.
    assert (
        seen.resident[-1] - seen.resident[len(seen.resident) // 2] < 40.0 and seen.heap[-1] < 60.0
    )
