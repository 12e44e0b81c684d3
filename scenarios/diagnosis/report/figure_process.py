"""Figures drawn by a second process, which loads the plotting library while the search still runs.

Loading it takes as long as many a diagnosis. It is started before this process has loaded NumPy, and answers with files.
"""

from __future__ import annotations

import contextlib
import gc
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.plots.formats import USUAL, Formats

if TYPE_CHECKING:
    from scenarios.plots.tracing.pictured import Pictured

Process = subprocess.Popen[bytes]


@contextmanager
def figure_process(wanted: bool) -> Iterator[Process | None]:
    """A process that waits for ``drawing``; None where none is wanted or none can be started. It ends with the body."""
    process: Process | None = None
    if wanted and sys.executable:
        # The same packages as here, also where they are not installed but found from the current folder.
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
        command = [sys.executable, "-m", "scenarios.diagnosis.report.figure_process"]
        with contextlib.suppress(OSError):
            process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment)
    try:
        yield process
    finally:
        if process is not None:
            if process.poll() is None:
                process.kill()
            process.wait()
            if process.stdin is not None:
                with contextlib.suppress(OSError):
                    process.stdin.close()


@contextmanager
def drawing(pictured: Pictured, folder: Path, process: Process | None, formats: Formats = USUAL) -> Iterator[None]:
    """While the body runs, the process draws all figures into ``folder``; on leaving they are there, drawn here if it failed."""
    from scenarios.diagnosis.report.figure_handover import packed
    from scenarios.diagnosis.report.figures import draw_diagnosis

    sent = process is not None and process.poll() is None and _sent(process, packed(pictured, folder, formats))
    yield
    if not sent or process is None or process.wait() != 0:
        draw_diagnosis(pictured, folder, formats)


def _sent(process: Process, content: bytes) -> bool:
    assert process.stdin is not None
    try:
        process.stdin.write(content)
        process.stdin.close()
    except OSError:
        return False
    return True


def main() -> None:
    """Load, warm up, wait for what to draw, draw it; end silently where nothing comes."""
    gc.disable()  # and at the end ``freeze``: in a process of a second a search for garbage takes a tenth of it
    from ident.tracing.diagnosis import Quantity
    from scenarios.diagnosis.report.figure_handover import unpacked
    from scenarios.diagnosis.report.figures import draw_diagnosis
    from scenarios.plots.files import figure_png
    from scenarios.plots.tracing.derivatives import figure_derivatives

    one = {name: Quantity(1.0, 0.1, "1") for name in ("Cm_alpha", "CL_q", "alpha", "nz")}
    figure_png(figure_derivatives(one, one, "warm-up"))  # fonts, symbols and backend are loaded by the first figure
    content = sys.stdin.buffer.read()
    if content:
        draw_diagnosis(*unpacked(content))
    gc.freeze()


if __name__ == "__main__":
    main()
