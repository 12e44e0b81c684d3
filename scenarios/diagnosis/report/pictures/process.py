"""Figures drawn by a second process, which loads the plotting library while the search still runs.

Loading it takes as long as many a diagnosis. It is started before this process has loaded NumPy. What a diagnosis will show if its search
finds nothing is drawn while it searches.
"""

from __future__ import annotations

import contextlib
import gc
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.plots.formats import USUAL, Formats

if TYPE_CHECKING:
    from scenarios.plots.tracing.pictured import Pictured

_AHEAD, _NOW = "ahead", "now"  # drawn by one process beside the search, or by two when it has ended


@dataclass
class Drawer:
    """The process, the folder through which it is told what to draw, and what it was told to draw ahead: as bytes, and where it leaves it."""

    process: subprocess.Popen[bytes]
    aside: Path
    expected: bytes = b""
    ahead: Path = Path()

    def draw_ahead(self, pictured: Pictured, formats: Formats) -> None:
        """Begin with all figures but that of the evidence, which may turn out to be the final ones."""
        self.ahead = Path(tempfile.mkdtemp(prefix="ahead-", dir=self.aside))
        self.expected = self._told(_AHEAD, _without_evidence(pictured), self.ahead, formats)

    def draw(self, pictured: Pictured, folder: Path, formats: Formats) -> None:
        """Draw what is not drawn yet; ``ended`` waits for it."""
        from scenarios.diagnosis.report.pictures.handover import packed

        if self.expected and self.expected == packed(_without_evidence(pictured), self.ahead, formats):
            pictured = replace(pictured, fitted=(), predictions=(), before={}, after={}, replicated=())
        else:
            self.expected = b""
        self._told(_NOW, pictured, folder, formats)

    def ended(self, folder: Path) -> bool:
        """Whether all figures are in the folder."""
        if self.process.stdin is not None:
            with contextlib.suppress(OSError):
                self.process.stdin.close()
        if self.process.wait() != 0:
            return False
        for drawn in self.ahead.iterdir() if self.expected else ():
            shutil.move(drawn, folder / drawn.name)
        return True

    def _told(self, when: str, pictured: Pictured, folder: Path, formats: Formats) -> bytes:
        """A short line to the process, which may not listen yet, of the file that holds what it needs."""
        from scenarios.diagnosis.report.pictures.handover import packed

        content = packed(pictured, folder, formats)
        number, written = tempfile.mkstemp(prefix="told-", dir=self.aside)
        with os.fdopen(number, "wb") as file:
            file.write(content)
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):  # it has died, which its exit code tells
            self.process.stdin.write(f"{when} {written}\n".encode())
            self.process.stdin.flush()
        return content


def _without_evidence(pictured: Pictured) -> Pictured:
    from scenarios.plots.tracing.reasons import Standing

    return replace(pictured, candidates=(), standing=Standing())


@contextmanager
def figure_process(wanted: bool) -> Iterator[Drawer | None]:
    """A process that waits for ``drawing``; None where none is wanted or none can be started. It ends with the body."""
    if not wanted or not sys.executable:
        yield None
        return
    # The same packages as here, also where they are not installed but found from the current folder.
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    command = [sys.executable, "-m", "scenarios.diagnosis.report.pictures.process"]
    with contextlib.ExitStack() as stack:
        drawer: Drawer | None = None
        with contextlib.suppress(OSError):
            aside = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="flightid-", ignore_cleanup_errors=True)))
            process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment)
            stack.callback(_end, process)
            drawer = Drawer(process, aside)
        yield drawer


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.kill()
    process.wait()
    if process.stdin is not None:
        with contextlib.suppress(OSError):
            process.stdin.close()


@contextmanager
def drawing(pictured: Pictured, folder: Path, drawer: Drawer | None, formats: Formats = USUAL) -> Iterator[None]:
    """While the body runs, the process draws all figures into ``folder``; on leaving they are there, drawn here if it failed."""
    from scenarios.diagnosis.report.pictures.figures import draw_diagnosis

    if drawer is not None:
        drawer.draw(pictured, folder, formats)
    yield
    if drawer is None or not drawer.ended(folder):
        draw_diagnosis(pictured, folder, formats)


def main() -> None:
    """Load, warm up, wait for what to draw, draw it; end silently where nothing comes."""
    gc.disable()  # and at the end ``freeze``: in a process of a second a search for garbage takes a tenth of it
    from ident.tracing.diagnosis import Quantity
    from scenarios.diagnosis.report.pictures.figures import draw_diagnosis, figures_of
    from scenarios.diagnosis.report.pictures.handover import unpacked
    from scenarios.plots.files import figure_png
    from scenarios.plots.page.drawing import leave_for_page
    from scenarios.plots.tracing.derivatives import figure_derivatives

    one = {name: Quantity(1.0, 0.1, "1") for name in ("Cm_alpha", "CL_q", "alpha", "nz")}
    figure_png(figure_derivatives(one, one, "warm-up"))  # fonts, symbols and backend are loaded by the first figure
    for line in sys.stdin:
        when, _, written = line.rstrip("\n").partition(" ")
        pictured, folder, formats = unpacked(Path(written).read_bytes())
        if when == _NOW:
            draw_diagnosis(pictured, folder, formats)
            continue
        for figure in figures_of(pictured):
            leave_for_page([figure], folder, formats)
    gc.freeze()


if __name__ == "__main__":
    main()
