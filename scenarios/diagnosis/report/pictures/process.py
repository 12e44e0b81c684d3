"""Figures drawn by a second process, which loads the plotting library while the search still runs.

Loading it takes as long as many a diagnosis. It is started before this process has loaded NumPy.
What a diagnosis will show if its search finds nothing is drawn while it searches.
"""

from __future__ import annotations

import contextlib
import gc
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.plots.formats import USUAL, Formats

if TYPE_CHECKING:
    from scenarios.plots.display import Pictured

# drawn by one process beside the search, by two when it has ended; nothing more comes
_AHEAD, _NOW, _END = "ahead", "now", "end"


_NEW_GROUP = 0x200  # subprocess.CREATE_NEW_PROCESS_GROUP, which only Windows has


@dataclass
class Drawer:
    """The process, and the folder through which it is told what to draw.

    ``expected`` : what it was told to draw ahead, as bytes; empty where that is nothing, or not
    what came out. ``ahead`` : where it leaves that. ``untold`` : what is to be drawn now could not
    be written for it.
    """

    process: subprocess.Popen[bytes]
    aside: Path
    expected: bytes = b""
    ahead: Path = Path()
    untold: bool = False

    def draw_ahead(self, pictured: Pictured, formats: Formats) -> None:
        """Begin with all figures but that of the evidence, which may turn out to be the final
        ones.
        """
        self.expected = b""
        with contextlib.suppress(OSError):
            self.ahead = Path(tempfile.mkdtemp(prefix="ahead-", dir=self.aside))
            self.expected = self._told(_AHEAD, _without_evidence(pictured), self.ahead, formats)

    def draw(self, pictured: Pictured, folder: Path, formats: Formats) -> None:
        """Draw what is not drawn yet; ``ended`` waits for it."""
        from scenarios.diagnosis.report.pictures.handover import packed

        if self.expected and self.expected == packed(
            _without_evidence(pictured), self.ahead, formats
        ):
            pictured = replace(
                pictured, fitted=(), predictions=(), before={}, after={}, replicated=()
            )
        else:
            self.expected = b""
        try:
            self._told(_NOW, pictured, folder, formats)
        except OSError:
            self.untold = True

    def ended(self, folder: Path) -> bool:
        """Whether all figures are in the folder."""
        self._say(_END)
        if self.process.wait() != 0 or self.untold:
            return False
        try:
            for drawn in self.ahead.iterdir() if self.expected else ():
                shutil.move(drawn, folder / drawn.name)
        except OSError:
            return False
        return True

    def stop(self) -> None:
        """End the process at once, and what it forked with it."""
        if self.process.poll() is None:
            with contextlib.suppress(OSError):
                if hasattr(os, "killpg"):
                    os.killpg(self.process.pid, signal.SIGKILL)
                else:
                    self.process.terminate()
        self.process.wait()
        if self.process.stdin is not None:
            with contextlib.suppress(OSError):
                self.process.stdin.close()

    def _told(self, when: str, pictured: Pictured, folder: Path, formats: Formats) -> bytes:
        """A short line to the process, which may not listen yet, of the file that holds what it
        needs. Raises OSError where none can be written.
        """
        from scenarios.diagnosis.report.pictures.handover import packed

        content = packed(pictured, folder, formats)
        number, written = tempfile.mkstemp(prefix="told-", dir=self.aside)
        with os.fdopen(number, "wb") as file:
            file.write(content)
        self._say(f"{when} {written}")
        return content

    def _say(self, line: str) -> None:
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):  # it has died, which its exit code tells
            self.process.stdin.write(os.fsencode(f"{line}\n"))  # paths hold any byte
            self.process.stdin.flush()


def _without_evidence(pictured: Pictured) -> Pictured:
    from scenarios.plots.display import NamedEffects

    return replace(pictured, candidates=(), standing=NamedEffects())


@contextmanager
def figure_process(wanted: bool) -> Iterator[Drawer | None]:
    """A process that waits for ``drawing``; None where none is wanted or none can be started. It
    ends with the body.
    """
    if not wanted or not sys.executable:
        yield None
        return
    # The same packages as here, also where they are not installed but found from the current
    # folder.
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    # In a group of its own: Ctrl-C ends the first process, which ends this one with what it forked.
    group: dict[str, Any] = (
        {"process_group": 0} if os.name == "posix" else {"creationflags": _NEW_GROUP}
    )
    pipes: dict[str, Any] = {
        "stdin": subprocess.PIPE,
        "stdout": subprocess.DEVNULL,
        "stderr": subprocess.DEVNULL,
    }
    with contextlib.ExitStack() as stack:
        drawer: Drawer | None = None
        with contextlib.suppress(OSError):
            aside = Path(
                stack.enter_context(
                    tempfile.TemporaryDirectory(prefix="flightid-", ignore_cleanup_errors=True)
                )
            )
            command = [
                sys.executable,
                "-m",
                "scenarios.diagnosis.report.pictures.process",
                str(aside),
            ]
            drawer = Drawer(subprocess.Popen(command, env=environment, **pipes, **group), aside)
            stack.callback(drawer.stop)
        yield drawer


@contextmanager
def drawing(
    pictured: Pictured, folder: Path, drawer: Drawer | None, formats: Formats = USUAL
) -> Iterator[None]:
    """While the body runs, the process draws all figures into ``folder``; on leaving they are
    there, drawn here if it failed.

    Where the body fails it has ended: nothing writes into the folder from then on.
    """
    from scenarios.diagnosis.report.pictures.figures import draw_diagnosis

    if drawer is not None:
        drawer.draw(pictured, folder, formats)
    try:
        yield
        drawn = drawer is not None and drawer.ended(folder)
    except BaseException:
        if drawer is not None:
            drawer.stop()
        raise
    if not drawn:
        draw_diagnosis(pictured, folder, formats)


def main() -> None:
    """Load, warm up, wait for what to draw, draw it; end silently where nothing comes. Named is the
    folder through which it is told.
    """
    # and at the end ``freeze``: in a process of a second a search for garbage takes a tenth of it
    gc.disable()
    from ident.tracing.diagnosis import Quantity
    from scenarios.diagnosis.report.pictures.figures import draw_diagnosis, figures_of
    from scenarios.diagnosis.report.pictures.handover import unpacked
    from scenarios.plots.drawing import figure_png, leave_for_page
    from scenarios.plots.tracing import figure_derivatives

    one = {name: Quantity(1.0, 0.1, "1") for name in ("Cm_alpha", "CL_q", "alpha", "nz")}
    # fonts, symbols and backend are loaded by the first figure
    figure_png(figure_derivatives(one, one, "warm-up"))
    ahead: list[Path] = []
    for line in sys.stdin.buffer:
        when, _, written = os.fsdecode(line.rstrip(b"\r\n")).partition(" ")
        if when == _END:
            break
        pictured, folder, formats = unpacked(Path(written).read_bytes())
        Path(written).unlink()
        if when == _NOW:
            draw_diagnosis(pictured, folder, formats)
            continue
        ahead.append(folder)
        for figure in figures_of(pictured):
            leave_for_page([figure], folder, formats)
    else:
        _clear([*ahead, Path(sys.argv[1])])
    gc.freeze()


def _clear(folders: Sequence[Path]) -> None:
    """Leave nothing behind where the process that would do it is gone; the last folder only if it
    is empty then.
    """
    for folder in folders[:-1]:
        shutil.rmtree(folder, ignore_errors=True)
    with contextlib.suppress(OSError):
        folders[-1].rmdir()


if __name__ == "__main__":
    main()
