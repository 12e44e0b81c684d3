"""Time from a slider of a lab to its new figure, against the time of the lab's opening in the same
run.

    python -m benchmarks.labs [--labs N ...]

Each lab is served as ``flightid lab N`` serves it and opened in Chromium. The times are those of
the processor that the lab's server takes, so that neither the browser nor other programs on the
machine count. A second from slider to figure is what a class waits for without impatience.
Needs ``pip install -e ".[labs,browser]"`` and a Chromium.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

from tests.browser.complaints import holds
from tests.browser.conftest import ARGUMENTS, DESKTOP, executable
from tests.browser.labs.opened import (
    DRAWN,
    LAST,
    PATIENCE,
    SLIDERS,
    lab_address,
    move,
    open_lab,
)
from tests.browser.serving import Servers

IDLE = 0.03  # s of processor time a second that a server takes for nothing


def slider_time(browser: Browser, number: int, folder: Path) -> tuple[float, float]:
    """Processor time of the server until a lab is open, and from a slider to the figure, s."""
    with Servers() as servers:
        address = lab_address(number, servers, folder)
        page = browser.new_page(viewport={"width": DESKTOP["width"], "height": DESKTOP["height"]})
        open_lab(page, address, LAST[number])
        opened, before = at_rest(servers, address), page.evaluate(DRAWN)
        move(page, SLIDERS[number], "ArrowRight")
        if not holds(page, f"before => ({DRAWN})() !== before", before, PATIENCE):
            raise SystemExit(f"lab {number}: the slider {SLIDERS[number]!r} changes no figure")
        taken = at_rest(servers, address) - opened
        page.close()
    return opened, taken


def at_rest(servers: Servers, address: str) -> float:
    """Processor time that a server has taken when it has done nothing for a second, s."""
    before, now = -1.0, servers.busy(address)
    while now - before > IDLE:
        time.sleep(1.0)
        before, now = now, servers.busy(address)
    return now


def main() -> None:
    """Print a line for each lab."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--labs", type=int, nargs="*", default=list(SLIDERS), choices=SLIDERS)
    labs = parser.parse_args().labs
    print("lab   opening   slider to figure   ratio")
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as folder:
        browser = playwright.chromium.launch(executable_path=executable(), args=[*ARGUMENTS])
        for number in labs:
            opened, taken = slider_time(browser, number, Path(folder, f"lab{number}"))
            print(f"{number:3d} {opened:8.2f} s {taken:16.2f} s {taken / opened:7.2f}", flush=True)
        browser.close()


if __name__ == "__main__":
    main()
